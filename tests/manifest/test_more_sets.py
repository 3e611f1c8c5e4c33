"""LRID, SIDD and CRVD, and the sets that have a card alone."""

from __future__ import annotations

import pickle
import re
from collections import Counter
from fractions import Fraction
from pathlib import Path

import pytest

from eldata import evaluate
from eldata.datasets import PairDataset
from eldata.errors import ManifestError
from eldata.manifest.catalogue import carded_names, shipped_card, shipped_manifest, shipped_names
from eldata.manifest.pairs import Choice
from manifests.published_lrid import bursts_from_infos
from tests.bait import Bait

ALONE = ("aim25", "aim25-video", "fivek", "lld", "mipi24", "sidd-cc")


# --- LRID -------------------------------------------------------------------------------------------------------------

# Scenes and gains of infos/<part>_short.info and <part>_GT_align_ours.info; ten frames each, but eight of one burst.
LRID = {"indoor_x5": (60, (1, 2, 4, 8, 16)), "outdoor_x3": (57, (1, 2, 4)), "indoor_x3": (22, (1, 2, 4))}


def test_lrid_has_the_files_of_the_info_files() -> None:
    records = shipped_manifest("lrid").records
    for part, (scenes, gains) in LRID.items():
        of_part = [record for record in records if record.path.startswith(f"{part}/")]
        references = [record for record in of_part if record.role == "reference"]
        assert [one.path for one in references] == [f"{part}/npy/GT_align_ours/{n:03d}.npy" for n in range(scenes)]
        found = Counter((record.ratio, record.scene) for record in of_part if record.role == "noisy")
        expected = {(Fraction(gain), f"{part}-{number:03d}"): 10 for gain in gains for number in range(scenes)}
        if part == "indoor_x5":
            expected[Fraction(4), "indoor_x5-024"] = 8
        assert found == expected
    assert Counter(record.role for record in records) == {"noisy": 3000 + 1710 + 660 - 2, "reference": 139, "bias": 2}
    assert not [record for record in records if "outdoor_x5" in record.path], "which the authors abandoned"


def test_lrid_states_what_its_names_do() -> None:
    name = "005062_exp-8000000_iso-6400_2022_08_17_05_33_48_461_9688422862537_orientation_0_camera-0.dng"
    by_path = {record.path: record for record in shipped_manifest("lrid").records}
    first = by_path[f"indoor_x5/6400/1/000/{name}"]
    assert (first.iso, first.exposure_s, first.ratio) == (Fraction(6400), Fraction(1, 125), Fraction(1))
    for record in by_path.values():
        if record.role == "noisy":
            part, iso, gain, scene, file = record.path.split("/")
            stated = re.search(r"_exp-(\d+)_iso-(\d+)_", file)
            assert stated is not None
            assert record.exposure_s == Fraction(int(stated[1]), 10**9)
            assert record.iso == int(stated[2]) == int(iso)
            assert (record.scene, record.ratio) == (f"{part}-{scene}", Fraction(gain))
            assert record.reference == f"{part}/npy/GT_align_ours/{scene}.npy"


def test_lrid_subsets_are_first_frames_of_bursts() -> None:
    """As the published code takes them: frame 0 of the sorted names, each gain."""
    manifest = shipped_manifest("lrid")
    for subset, split, gains in (("indoor-first", "eval", (1, 2, 4, 8, 16)), ("outdoor-first", "test", (1, 2, 4))):
        found = Choice(subset=subset).pairs(manifest.records, manifest.card.subsets)
        bursts: dict[str, list[str]] = {}
        for record in manifest.records:
            if record.role == "noisy" and record.split == split:
                bursts.setdefault(record.path.rpartition("/")[0], []).append(record.path)
        assert [pair.path for pair in found] == sorted(min(paths) for paths in bursts.values())
        assert Counter(pair.ratio for pair in found) == dict.fromkeys(map(Fraction, gains), len(found) // len(gains))


def test_lrid_says_which_scenes_the_sensor_was_warm_in() -> None:
    """The numbers that hot_check has: 8, 14 and 25 scenes; the two outdoor ones that are scored among them."""
    records = shipped_manifest("lrid").records
    warm = {record.scene for record in records if record.role == "noisy" and "warm-sensor" in record.flags}
    parts = Counter(str(scene).partition("-")[0] for scene in warm)
    assert parts == {"indoor_x5": 8, "indoor_x3": 14, "outdoor_x3": 25}
    scored = {record.scene for record in records if record.split in ("eval", "test")}
    assert warm & scored == {"outdoor_x3-022", "outdoor_x3-051"}
    biases = {record.path: record.flags for record in records if record.role == "bias"}
    assert biases == {"bias/6400/*.dng": (), "bias-hot/6400/*.dng": ("warm-sensor",)}
    assert all("nominal-ratio" in record.flags for record in records if record.role == "noisy")


def test_an_info_file_is_not_run(tmp_path: Path) -> None:
    """Pickles in the form of the published ones, with more in them than paths."""
    file = "000000_exp-40000000_iso-6400_2022_08_20_23_41_54_31_0_orientation_180_camera-0.dng"
    for part in LRID:
        burst = {"scene": "000", "dgain": 1, "ISO": 6400, "data": [f"E:/datasets/LRID\\{part}\\6400\\1\\000\\{file}"]}
        reference = {"name": f"{part}_gt_000", "data": f"E:/datasets/LRID\\{part}\\npy\\GT_align_ours\\000.npy"}
        shorts = {1: [burst | {"metadata": [{"name": "x"}, Bait(tmp_path / "ran")]}]}
        (tmp_path / f"{part}_short.info").write_bytes(pickle.dumps(shorts, protocol=4))
        (tmp_path / f"{part}_GT_align_ours.info").write_bytes(pickle.dumps([reference], protocol=4))
    assert len(bursts_from_infos(tmp_path)) == len(LRID)
    assert not (tmp_path / "ran").exists()


# --- SIDD -------------------------------------------------------------------------------------------------------------


def test_sidd_is_what_its_readme_says() -> None:
    """320 image pairs, 160 scene instances, two images of each; ten scenes, five phones.

    Of names the example: instance 52, scene 2, Galaxy S6 Edge, ISO 1600, 1/1000 s.
    """
    by_path = {record.path: record for record in shipped_manifest("sidd").records}
    assert Counter(record.role for record in by_path.values()) == {"noisy": 320, "reference": 320}
    assert len({path.split("/")[2] for path in by_path}) == 160
    assert {record.scene for record in by_path.values()} == {f"{number:03d}" for number in range(1, 11)}
    assert len({record.camera for record in by_path.values()}) == 5
    folder = "SIDD_Medium_Raw/Data/0052_002_S6_01600_01000_5500_N"
    record = by_path[f"{folder}/0052_NOISY_RAW_011.MAT"]
    assert (record.camera, record.scene) == ("GalaxyS6Edge", "002")
    assert (record.iso, record.exposure_s) == (Fraction(1600), Fraction(1, 1000))
    assert record.reference == f"{folder}/0052_GT_RAW_011.MAT"
    assert record.ratio == 1


def test_sidd_subsets_of_sfrn() -> None:
    manifest = shipped_manifest("sidd")
    for phone in ("S6", "GP", "IP"):
        pairs = Choice(subset=f"sfrn-{phone.lower()}").pairs(manifest.records, manifest.card.subsets)
        instances = {pair.path.split("/")[2] for pair in pairs}
        assert {instance.split("_")[2] for instance in instances} == {phone}
        assert {instance.split("_")[1] for instance in instances} == {"002", "003", "005"}
        assert len(pairs) == 2 * len(instances)


# --- CRVD -------------------------------------------------------------------------------------------------------------


def test_crvd_has_55_groups_of_seven_frames() -> None:
    """The abstract's 55 groups; 7 frames and 10 noisy shots in the loops of the published code."""
    manifest = shipped_manifest("crvd")
    noisy = [record for record in manifest.records if record.role == "noisy"]
    groups = Counter((record.scene, record.iso) for record in noisy)
    assert len(groups) == 55
    assert set(groups.values()) == {70}
    assert Counter(record.role for record in manifest.records) == {"noisy": 3850, "reference": 385}
    assert {record.scene for record in noisy if record.split == "test"} == {f"scene{number}" for number in range(7, 12)}
    first = Choice(subset="test-first").pairs(manifest.records, manifest.card.subsets)
    assert len(first) == 5 * 5 * 7
    assert first[0].path.endswith("_noisy0.tiff")
    assert first[0].reference.startswith("indoor_raw_gt/")
    assert first[0].reference.endswith("_clean_and_slightly_denoised.tiff")


# --- cards alone ------------------------------------------------------------------------------------------------------


def test_every_set_has_a_card_and_some_have_it_alone() -> None:
    assert set(carded_names()) - set(shipped_names()) == set(ALONE)
    for card in map(shipped_card, ALONE):
        for text in (card.title, card.licence, card.citation, card.contents):
            assert text
        assert card.homepage.startswith("https://")
        for texts in (card.sources, card.known_defects, card.unknown, card.scored, card.downloads):
            assert texts
        assert card.counts == {}


@pytest.mark.parametrize("name", ALONE)
def test_a_set_without_a_manifest_is_told_from_an_unknown_one(name: str, tmp_path: Path) -> None:
    for use in (lambda: shipped_manifest(name), lambda: evaluate(tmp_path, name), lambda: PairDataset(tmp_path, name)):
        with pytest.raises(ManifestError, match=f"knows '{name}' by its card alone.*eldata info {name}"):
            use()
    with pytest.raises(ManifestError, match="no dataset is called 'lrb'; known are aim25, aim25-video, crvd, drv"):
        shipped_card("lrb")
    with pytest.raises(ManifestError, match="no dataset is called 'lrb'; known are crvd, drv"):
        shipped_manifest("lrb")
