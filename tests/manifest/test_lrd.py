"""The shipped LRD manifest against facts written down again here, from the lists of its repository."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from eldata.manifest.catalogue import save_manifest, shipped_folder, shipped_manifest
from eldata.manifest.pairs import Choice
from eldata.manifest.verify import verify
from manifests.published_lrd import LrdScene, load_lrd_scenes, lrd_scenes_from_lists
from tests.cases import in_one_test
from tests.lrd_tree import write_frames
from tests.trees import swap

# Lines of datalist/LRD_<split>_list.txt (wc -l).
LINES = {"train": 1440, "val": 180, "test": 180}
TEST_LIST = """\
./LRD/Clean/00541_00_0.05s.DNG ./LRD/Noisy/00541_01_0.01s.DNG ISO200 -1EV
./LRD/Clean/00541_00_0.05s.DNG ./LRD/Noisy/00541_02_0.00417s.DNG ISO200 -2EV
./LRD/Clean/00541_00_0.05s.DNG ./LRD/Noisy/00541_03_0.0025s.DNG ISO200 -3EV
"""
TRAIN_LIST = """\
./LRD/Clean/00001_00_0.25s.DNG ./LRD/Noisy/00001_01_0.00625s.DNG ISO1600 -1EV
./LRD/Clean/00001_00_0.25s.DNG ./LRD/Noisy/00001_02_0.00313s.DNG ISO1600 -2EV
./LRD/Clean/00001_00_0.25s.DNG ./LRD/Noisy/00001_03_0.002s.DNG ISO1600 -3EV
"""


def test_counts_are_those_of_the_lists() -> None:
    manifest = shipped_manifest("lrd")
    noisy = [record for record in manifest.records if record.role == "noisy"]
    assert Counter(record.split for record in noisy) == LINES
    assert Counter((record.split, record.iso) for record in noisy) == {
        (split, Fraction(iso)): count // 6
        for split, count in LINES.items()
        for iso in (200, 400, 800, 1600, 3200, 6400)
    }
    references = [record for record in manifest.records if record.role == "reference"]
    assert sorted(record.scene for record in references) == [f"{number:05d}" for number in range(1, 601)]
    assert {record.iso for record in references} == {100}
    assert {record.scene for record in references if record.split == "test"} == {f"{n:05d}" for n in range(541, 601)}


@in_one_test("line", (TRAIN_LIST + TEST_LIST).splitlines())
def test_lines_of_the_lists(line: str) -> None:
    clean, noisy, iso, bias = line.split()
    by_path = {record.path: record for record in shipped_manifest("lrd").records}
    record = by_path[noisy.removeprefix("./LRD/")]
    assert record.reference == clean.removeprefix("./LRD/")
    assert f"ISO{record.iso}" == iso
    assert f"-{int(record.path.split('_')[1])}EV" == bias
    clean_s, noisy_s = (Fraction(name.rpartition("_")[2].removesuffix("s.DNG")) for name in (clean, noisy))
    assert record.exposure_s == noisy_s
    assert record.iso is not None
    assert record.ratio == 100 * clean_s / (record.iso * noisy_s)


def test_ratios_are_not_the_exposure_biases() -> None:
    pairs = Choice().pairs(shipped_manifest("lrd").records)
    spans = {1: (1.49, 3.31), 2: (2.98, 8.0), 3: (5.97, 20.32)}  # of the lists, by their code's formula
    for bias, (low, high) in spans.items():
        ratios = [float(pair.ratio) for pair in pairs if f"_{bias:02d}_" in pair.path]
        assert len(ratios) == 600
        assert low < min(ratios) < low + 0.02
        assert high - 0.02 < max(ratios) < high


def test_subsets_are_one_bias_of_the_test_scenes() -> None:
    manifest = shipped_manifest("lrd")
    for bias in (1, 2, 3):
        pairs = Choice(subset=f"test-{bias}ev").pairs(manifest.records, manifest.card.subsets)
        assert len(pairs) == 60
        assert {pair.path.split("_")[1] for pair in pairs} == {f"{bias:02d}"}
        assert {pair.split for pair in pairs} == {"test"}
    assert manifest.card.subsets[0].name == "test-3ev", "the published code's default"


# --- the lists --------------------------------------------------------------------------------------------------------


def test_scenes_from_lists(tmp_path: Path) -> None:
    lists = {"train": tmp_path / "train.txt", "test": tmp_path / "test.txt"}
    lists["train"].write_text(TRAIN_LIST)
    lists["test"].write_text(TEST_LIST)
    assert lrd_scenes_from_lists(lists) == (
        LrdScene("00001", "train", 1600, "0.25", ("0.00625", "0.00313", "0.002")),
        LrdScene("00541", "test", 200, "0.05", ("0.01", "0.00417", "0.0025")),
    )
    known = {scene.scene: scene for scene in load_lrd_scenes(shipped_folder() / "facts" / "lrd.csv")}
    assert all(known[scene.scene] == scene for scene in lrd_scenes_from_lists(lists))


# --- on the disk ------------------------------------------------------------------------------------------------------


def test_swapped_frames_are_found_and_the_camera_is_not_judged(tmp_path: Path) -> None:
    shipped = shipped_manifest("lrd")
    records = [record for record in shipped.records if record.scene in ("00541", "00001")]
    card = replace(shipped.card, counts={"noisy": 6, "reference": 2}, subsets=())
    manifest = save_manifest(tmp_path / "lrd.csv", card, records)
    write_frames(tmp_path / "LRD", records)
    assert verify([manifest], tmp_path, level="full").ok
    one, other = (tmp_path / "LRD" / f"Noisy/00541_0{bias}_{time}s.DNG" for bias, time in ((1, "0.01"), (3, "0.0025")))
    swap(one, other)
    report = verify([manifest], tmp_path, level="metadata")
    assert {(problem.path.partition("/")[2], problem.field) for problem in report.problems} == {
        (path.name, field) for path in (one, other) for field in ("exposure_s", "ratio")
    }, "and no problem of any camera's model, which no public text states"
