"""The shipped SID manifests against facts written down again here, and verify on trees with the published names."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from pathlib import Path, PurePosixPath

import pytest

from eldata.errors import ArgumentError, ManifestError
from eldata.manifest.card import find_subset
from eldata.manifest.catalogue import shipped_folder, shipped_manifest
from eldata.manifest.pairs import Choice
from eldata.manifest.verify import verify
from eldata.manifest.verify_report import Problem
from eldata.records import PairRecord
from manifests.sid_scenes import SID_CAMERAS, save_scenes, scenes_from_lists
from tests.sid_tree import NAMES, SmallTree, build_small_tree
from tests.trees import scale_exposure

FACTS = shipped_folder() / "facts"
NAMED = pytest.mark.parametrize("name", NAMES)
FOLDERS = {"sid-sony": ("Sony", ".ARW"), "sid-fuji": ("Fuji", ".RAF")}

# Short and long frames, and short ones per ratio 100, 250, 300; in all, and of the first shots alone.
COUNTS = {
    ("sid-sony", "train"): (1865, 161, (587, 457, 821), (85, 85, 110)),
    ("sid-sony", "val"): (234, 20, (72, 62, 100), (11, 11, 14)),
    ("sid-sony", "test"): (598, 50, (182, 180, 236), (29, 29, 35)),
    ("sid-fuji", "train"): (1655, 135, (805, 427, 423), (135, 81, 70)),
    ("sid-fuji", "val"): (218, 17, (109, 67, 42), (17, 13, 8)),
    ("sid-fuji", "test"): (524, 41, (203, 156, 165), (41, 27, 26)),
}
INDOOR = (
    *("10185", "10187", "10191", "10193", "10198", "10213", "10217", "10226", "10227", "10228"),
    *("20188", "20201", "20208", "20210", "20211"),
)


def per_ratio(pairs: tuple[PairRecord, ...]) -> tuple[int, ...]:
    counts = Counter(pair.ratio for pair in pairs)
    assert set(counts) <= {100, 250, 300}
    return tuple(counts[Fraction(ratio)] for ratio in (100, 250, 300))


def first_shot(path: str) -> bool:
    return PurePosixPath(path).name.split("_")[1] == "00"


# --- rows ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "split"), COUNTS)
def test_counts_per_split_and_ratio(name: str, split: str) -> None:
    manifest = shipped_manifest(name)
    short, long, ratios, first = COUNTS[name, split]
    roles = Counter(record.role for record in manifest.records if record.split == split)
    assert roles == {"noisy": short, "reference": long}
    pairs = Choice(split=[split]).pairs(manifest.records)
    assert per_ratio(pairs) == ratios
    assert per_ratio(tuple(pair for pair in pairs if first_shot(pair.path))) == first


@NAMED
def test_rows_say_what_their_names_say(name: str) -> None:
    """Decimal times from the names, the cap of the published code, and 1/30 s for 0.033."""
    manifest = shipped_manifest(name)
    folder, extension = FOLDERS[name]
    (camera,) = manifest.card.cameras
    by_path = {record.path: record for record in manifest.records}
    for record in manifest.records:
        place, _, rest = record.path.rpartition("/")
        scene, burst, time = rest.removesuffix(f"s{extension}").split("_")
        assert place == f"{folder}/{'long' if record.role == 'reference' else 'short'}"
        assert (record.camera, record.scene) == (camera, scene)
        assert record.split == {"0": "train", "1": "test", "2": "val"}[scene[0]]
        assert record.exposure_s == (Fraction(1, 30) if time == "0.033" else Fraction(time))
        assert {record.width, record.height, record.size_bytes, record.sha256} == {None}
        if record.role == "reference":
            assert (burst, record.ratio, record.reference, record.flags) == ("00", None, None, ())
            assert time in ("10", "30")
            continue
        assert record.reference is not None
        reference = by_path[record.reference]
        assert reference.scene == scene
        long_time = PurePosixPath(record.reference).name.split("_")[2].removesuffix(f"s{extension}")
        assert record.ratio == min(Fraction(long_time) / Fraction(time), 300)
        if "uncertain-iso" not in record.flags:
            assert record.iso == reference.iso
        assert reference.exposure_s is not None
        assert record.exposure_s is not None
        assert reference.exposure_s / record.exposure_s == record.ratio, "with the true times the cap changes nothing"


def test_some_rows_of_the_official_lists() -> None:
    isos = {
        "Sony/short/00001_00_0.04s.ARW": 200,
        "Sony/short/10172_09_0.1s.ARW": 160,
        "Sony/long/00207_00_10s.ARW": 25600,
        "Fuji/short/00001_03_0.1s.RAF": 1000,
        "Fuji/long/20015_00_10s.RAF": 1000,
    }
    records = [record for name in NAMES for record in shipped_manifest(name).records]
    assert {record.path: record.iso for record in records if record.path in isos} == isos


def test_flags() -> None:
    flagged: dict[tuple[str, str], set[str]] = {}
    for name in NAMES:
        for record in shipped_manifest(name).records:
            for flag in record.flags:
                assert record.role == "noisy"
                flagged.setdefault((name, flag), set()).add(record.scene)
    assert flagged == {
        ("sid-sony", "misaligned"): {"10034", "10045", "10172"},
        ("sid-sony", "misaligned-unconfirmed"): {"00108", "00183"},
        ("sid-sony", "uncertain-iso"): {"00207"},
        ("sid-fuji", "misaligned-unconfirmed"): {"10172"},
    }
    for name, flag in flagged:
        assert any(flag in defect for defect in shipped_manifest(name).card.known_defects)


# --- subsets ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "subset", "ratios", "misaligned"),
    [
        ("sid-sony", "eval-first", (40, 40, 49), (2, 2, 1)),
        ("sid-sony", "test-first", (29, 29, 35), (2, 2, 1)),
        ("sid-sony", "indoor-15", (15, 15, 15), (0, 0, 0)),
        ("sid-sony", "all", (841, 699, 1157), None),
        ("sid-fuji", "test-first", (41, 27, 26), (0, 0, 0)),
        ("sid-fuji", "eval-first", (58, 40, 34), (0, 0, 0)),
        ("sid-fuji", "all", (1117, 650, 630), None),
    ],
)
def test_subsets(name: str, subset: str, ratios: tuple[int, ...], misaligned: tuple[int, ...] | None) -> None:
    manifest = shipped_manifest(name)
    pairs = Choice(subset=subset).pairs(manifest.records, manifest.card.subsets)
    assert per_ratio(pairs) == ratios
    assert len(pairs) == find_subset(manifest.card.subsets, subset).pairs == sum(ratios)
    if misaligned is not None:
        assert all(first_shot(pair.path) for pair in pairs)
        assert per_ratio(tuple(pair for pair in pairs if "misaligned" in pair.flags)) == misaligned


def test_the_indoor_subset_is_15_scenes_at_each_ratio() -> None:
    manifest = shipped_manifest("sid-sony")
    pairs = Choice(subset="indoor-15").pairs(manifest.records, manifest.card.subsets)
    assert Counter(pair.scene for pair in pairs) == dict.fromkeys(INDOOR, 3)
    times = {pair.path.rpartition("_")[2]: pair.ratio for pair in pairs}
    assert times == {"0.1s.ARW": 100, "0.04s.ARW": 250, "0.033s.ARW": 300}


def test_an_unknown_subset_lists_the_known() -> None:
    known = shipped_manifest("sid-sony").card.subsets
    with pytest.raises(ArgumentError, match="'first'; known are eval-first, test-first, indoor-15, all"):
        find_subset(known, "first")
    with pytest.raises(ArgumentError, match="known are none"):
        find_subset((), "all")


def test_a_subset_that_lost_pairs_is_refused() -> None:
    manifest = shipped_manifest("sid-sony")
    records = [record for record in manifest.records if record.path != "Sony/short/10185_00_0.1s.ARW"]
    with pytest.raises(ManifestError, match="'indoor-15': the card expects 45 pairs, the manifest has 44"):
        Choice(subset="indoor-15").pairs(records, manifest.card.subsets)


# --- the generator ------------------------------------------------------------------------------------------------


@NAMED
def test_the_official_lists_condense_to_the_table_of_scenes(name: str, tmp_path: Path) -> None:
    """Lists in the official form, written from the manifest, give the committed table of scenes."""
    folder, _ = FOLDERS[name]
    pairs = Choice().pairs(shipped_manifest(name).records)
    lists = []
    for split in ("train", "val", "test"):
        lists.append(tmp_path / f"{folder}_{split}_list.txt")
        lines = [f"./{one.path} ./{one.reference} ISO{one.iso or 12800} F8\n" for one in pairs if one.split == split]
        lists[-1].write_text("".join(lines), encoding="utf-8")
    save_scenes(tmp_path / "scenes.csv", scenes_from_lists(SID_CAMERAS[name], lists))
    assert (tmp_path / "scenes.csv").read_bytes() == (FACTS / f"{name}.csv").read_bytes()


# --- verify -------------------------------------------------------------------------------------------------------

# A scene of each split with shots at all three ratios, or two.
SCENES = {"sid-sony": ("10185", "20201"), "sid-fuji": ("10019", "20015")}
LEFT = {"sid-sony": "Sony/short/10185_00_", "sid-fuji": "Fuji/short/10019_00_"}


@pytest.fixture(params=NAMES)
def tree(request: pytest.FixtureRequest, tmp_path: Path) -> SmallTree:
    """Some scenes of either half."""
    return build_small_tree(request.param, tmp_path, SCENES[request.param])


def problems(tree: SmallTree) -> list[Problem]:
    return list(verify([tree.manifest], tree.root, level="metadata").problems)


def frame(tree: SmallTree, exposure: str) -> str:
    return f"{LEFT[tree.manifest.name]}{exposure}s{FOLDERS[tree.manifest.name][1]}"


def test_the_capped_ratio_and_exif(tree: SmallTree) -> None:
    """EXIF of 1/30 s gives a ratio of 300, of 0.033 s 303: both are the pair of the name. A ratio of 250 is not."""
    path = tree.data / frame(tree, "0.033")
    assert problems(tree) == []
    scale_exposure(path, Fraction(33, 1000) * 30)
    assert problems(tree) == []
    scale_exposure(path, Fraction(1000, 33) / 25)
    assert {problem.field for problem in problems(tree)} == {"exposure_s", "ratio"}


def test_a_reference_of_30_s_is_not_hidden_by_the_cap(tree: SmallTree) -> None:
    """min(30 / 0.04, 300) is 300 too, but the lists have no such pair."""
    (reference,) = [r.reference for r in tree.manifest.records if r.path == frame(tree, "0.1")]
    assert reference is not None
    scale_exposure(tree.data / reference, Fraction(3))
    fields = [problem.field for problem in problems(tree)]
    assert fields.count("exposure_s") == 1
    assert set(fields) == {"exposure_s", "ratio"}
