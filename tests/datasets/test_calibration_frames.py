"""Bias and flat frames by folder and by manifest: what is found, what is refused, and that nothing is read early."""

from __future__ import annotations

import shutil
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rawpy

from eldata import CalibrationFrames
from eldata.datasets.calibration_frames import flat_pairs
from eldata.errors import ArgumentError, DatasetError, RawFileError
from eldata.manifest.table import load_records
from eldata.records import FrameRecord
from tests.calibration import conftest
from tests.calibration.trees import CAMERA, FrameTree, make_tree, named

ISOS = (100, 1600)
SIZE = (64, 96)  # these tests measure nothing


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> FrameTree:
    """Two ISOs, three bias frames and two pairs of flats each. Not to be changed."""
    folder = tmp_path_factory.mktemp("calibration") / "tree"
    return make_tree(folder, isos=ISOS, bias_frames=3, flat_levels=2, size=SIZE)


tree = conftest.tree


# --- finding --------------------------------------------------------------------------------------------------------


def listed(tree: FrameTree) -> list[FrameRecord]:
    """The manifest's rows, which the simulator wrote: the truth about the folders."""
    return sorted(load_records(tree.manifest), key=lambda record: record.path)


def test_the_folders_hold_what_was_made(pristine: FrameTree) -> None:
    frames = CalibrationFrames(pristine.root, CAMERA)
    assert [(r.path, r.role, r.camera, r.iso) for r in frames.records] == [
        (r.path, r.role, r.camera, r.iso) for r in listed(pristine)
    ]
    assert all(record.exposure_s is None for record in frames.records), "folders do not say it"
    assert (len(frames), list(frames.isos), frames.camera, frames.skipped) == (14, [*map(Fraction, ISOS)], CAMERA, ())
    assert [len(frames.of("bias", iso)) for iso in ISOS] == [3, 3]
    assert [len(frames.of("flat", iso)) for iso in ISOS] == [4, 4]


def test_the_cameras_own_folder_will_do(pristine: FrameTree) -> None:
    """Its name is the camera's, unless another is given; paths are then relative to it."""
    whole, own = CalibrationFrames(pristine.root), CalibrationFrames(pristine.camera)
    assert own.camera == whole.camera == CAMERA
    assert [f"{CAMERA}/{path}" for path in named(own.records)] == named(whole.records)
    assert own[0]["mosaic"].tobytes() == whole[0]["mosaic"].tobytes()
    renamed = CalibrationFrames(pristine.camera, "Mine")
    assert renamed.camera == "Mine"
    assert {record.camera for record in renamed.records} == {"Mine"}


def test_the_manifest_route(pristine: FrameTree, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = CalibrationFrames(pristine.root, manifest=pristine.manifest)
    assert frames.records == tuple(listed(pristine)), "with their exposure times"
    monkeypatch.setenv("ELDATA_ROOT", str(pristine.folder / "data"))
    assert CalibrationFrames(manifest=pristine.manifest).root == pristine.root
    assert frames[3]["exposure_s"] == float(frames.records[3].exposure_s or 0)


def test_a_choice_of_cameras(tree: FrameTree) -> None:
    shutil.copytree(tree.camera, tree.root / "Other")
    (tree.root / "notes").mkdir()
    (tree.root / "readme.txt").write_text("x")
    with pytest.raises(DatasetError, match=f"frames of 2 cameras; choose one: {CAMERA}, Other"):
        CalibrationFrames(tree.root)
    assert {record.path.split("/")[0] for record in CalibrationFrames(tree.root, "Other").records} == {"Other"}
    with pytest.raises(DatasetError, match=f"no camera 'Sony'; there is {CAMERA}, Other"):
        CalibrationFrames(tree.root, "Sony")
    with pytest.raises(DatasetError, match=f"no camera 'Sony'; there is {CAMERA}"):
        CalibrationFrames(tree.root, "Sony", manifest=tree.manifest)


def test_a_choice_of_isos(pristine: FrameTree) -> None:
    frames = CalibrationFrames(pristine.root, isos=[1600])
    assert list(frames.isos) == [Fraction(1600)]
    assert len(frames) == 7
    assert len(CalibrationFrames(pristine.root, isos=(100, Fraction(1600)))) == 14  # type: ignore[arg-type] # equal
    with pytest.raises(DatasetError, match="no frames of ISO 200; there are 100, 1600"):
        CalibrationFrames(pristine.root, isos=[100, 200])
    with pytest.raises(ArgumentError, match="isos is empty; there are 100, 1600"):
        CalibrationFrames(pristine.root, isos=[])


def refused(root: Path, *words: str) -> None:
    with pytest.raises(DatasetError) as raised:
        CalibrationFrames(root)
    assert all(word in str(raised.value) for word in words)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("found", "moved", "words"),
    [
        (CAMERA, "../elsewhere", ["holds no folder bias or flat", "<camera>/flat/ISO100/"]),
        ("*/bias/ISO100", f"{CAMERA}/bias/iso100", ["iso100/IMG_0001.dng: lies in no folder", "bias/ISO100/IMG_0001"]),
        ("*/bias/ISO100", f"{CAMERA}/bias/ISO100-again", ["lies in no folder that names its ISO"]),
        ("*/flat/ISO100/*", f"{CAMERA}/flat/a.dng", ["flat/a.dng: lies in no folder", "flat/ISO100/a.dng"]),
    ],
)
def test_frames_that_lie_elsewhere(found: str, moved: str, words: list[str], tree: FrameTree) -> None:
    min(tree.root.glob(found)).rename(tree.root / moved)
    refused(tree.root, *words)


def test_unusable_folders_say_what_is_expected(tree: FrameTree) -> None:
    refused(tree.root / "none", "none: there is no such folder", "<camera>/bias/ISO100/")
    (tree.camera / "flat" / "ISO100").rename(tree.folder / "elsewhere")
    (tree.camera / "flat" / "ISO100").symlink_to(tree.folder / "elsewhere")
    refused(tree.root, "flat/ISO100: is a link to a folder")  # whose frames would be missing without a word
    (tree.camera / "flat" / "ISO100").unlink()
    for path in tree.root.rglob("*.dng"):
        path.rename(path.with_suffix(".jpg"))
    refused(tree.root, "holds no raw file", ".arw", ".dng")


def test_a_row_without_an_iso_is_refused(tree: FrameTree) -> None:
    tree.manifest.write_text(tree.manifest.read_text().replace(",1600,", ",,", 1))
    with pytest.raises(DatasetError, match="a calibration frame's row needs its ISO"):
        CalibrationFrames(tree.root, manifest=tree.manifest)


def test_what_is_no_raw_file_is_left_alone_and_listed(tree: FrameTree) -> None:
    """The JPEG beside a raw file, sidecars; hidden files are not worth a word, in hidden folders neither."""
    bias = tree.camera / "bias"
    for name in ("ISO100/IMG_0001.JPG", "ISO100/IMG_0001.xmp", "notes.txt"):
        (bias / name).write_bytes(b"x")
    for name in ("ISO100/.DS_Store", "ISO100/._IMG_0001.dng", ".thumbnails/a.dng", "ISO100/.trash/b.dng"):
        (bias / name).parent.mkdir(exist_ok=True)
        (bias / name).write_bytes(b"x")
    frames = CalibrationFrames(tree.root)
    assert frames.skipped == tuple(
        f"{CAMERA}/bias/{name}" for name in ("ISO100/IMG_0001.JPG", "ISO100/IMG_0001.xmp", "notes.txt")
    )
    assert len(frames) == 14


# --- samples --------------------------------------------------------------------------------------------------------


def test_samples_are_what_libraw_reads(pristine: FrameTree) -> None:
    frames = CalibrationFrames(pristine.root)
    for sample, row in zip(frames, listed(pristine), strict=True):
        with rawpy.imread(str(pristine.root / row.path)) as raw:
            np.testing.assert_array_equal(sample["mosaic"], raw.raw_image_visible, strict=True)
        assert (sample["role"], sample["camera"], sample["path"]) == (row.role, row.camera, row.path)
        assert (sample["iso"], sample["exposure_s"]) == (float(row.iso or 0), float(row.exposure_s or 0))
    assert len(list(frames)) == 14, "it can be iterated twice"
    with pytest.raises(IndexError):
        frames[14]


# --- nothing early --------------------------------------------------------------------------------------------------


def test_choosing_reads_no_file(tree: FrameTree) -> None:
    for path in tree.root.rglob("*.dng"):
        path.write_bytes(b"")
    for frames in (CalibrationFrames(tree.root), CalibrationFrames(tree.root, manifest=tree.manifest)):
        assert len(frames) == len(frames.frame) == 14
        with pytest.raises(RawFileError, match="empty"):
            frames[0]


# --- pairs ----------------------------------------------------------------------------------------------------------


def numbers(*records: FrameRecord) -> tuple[int, ...]:
    return tuple(int(record.path[:4]) for record in records)


@pytest.mark.parametrize(
    ("exposures", "pairs", "single"),
    [
        ("", [], ()),
        ("aaa", [(1, 2)], (3,)),
        ("aaaa", [(1, 2), (3, 4)], ()),
        ("abab", [(1, 3), (2, 4)], ()),
        ("abbcca", [(1, 6), (2, 3), (4, 5)], ()),
        ("abc", [], (1, 2, 3)),
        ("??", [], (1, 2)),
        ("a?a?", [(1, 3)], (2, 4)),
    ],
)
def test_pairs(exposures: str, pairs: list[tuple[int, int]], single: tuple[int, ...]) -> None:
    """Letters are exposure times, ? an unknown one: two of those may differ. Given in another order than taken."""
    time = {"a": Fraction(1, 10), "b": Fraction(2, 10), "c": Fraction(3, 10), "?": None}
    shot = partial(FrameRecord, role="flat", camera="C")
    flats = [shot(f"{index:04d}.dng", exposure_s=time[letter]) for index, letter in enumerate(exposures, 1)]
    found, left = flat_pairs(flats[::-1])
    assert [numbers(pair.first, pair.second) for pair in found] == pairs
    assert tuple(sorted(numbers(*left))) == single
