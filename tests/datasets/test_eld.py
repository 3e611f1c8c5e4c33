"""ELDDataset: samples equal to a plain route bit for bit, in every kind of worker, and clear refusals."""

from __future__ import annotations

import shutil
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from eldata.datasets import ELDDataset
from eldata.demo.camera import CAMERAS
from eldata.errors import DatasetError, RawFileError
from eldata.manifest.verify import verify
from tests.datasets.comparing import pack_plainly, same_bits
from tests.trees import Tree, scale_exposure

CAMERA_OF = {camera.name: camera for camera in CAMERAS}


def demo(tree: Tree, **options: Any) -> ELDDataset:
    return ELDDataset(tree.data, manifest=tree.csv, **options)


# --- pixels -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", ["published", "metadata"])
@pytest.mark.parametrize("clip", ["both", "upper", "none"])
def test_samples_equal_a_plain_route_bit_for_bit(pristine: Tree, levels: Any, clip: Any) -> None:
    low, high = {"both": (0, 1), "upper": (-np.inf, 1), "none": (-np.inf, np.inf)}[clip]
    dataset = demo(pristine, levels=levels, clip=clip, ratios=None)
    assert len(dataset) == 24
    for record, sample in zip(dataset.records, dataset, strict=True):
        white = 16383.0 if levels == "published" else CAMERA_OF[record.camera].sensor.white_level_dn
        noisy = np.clip(pack_plainly(pristine.data / record.path, white), low, high)
        same_bits(sample["input"], np.clip(noisy * np.float32(record.ratio), low, high))
        target = pack_plainly(pristine.data / record.reference, white)
        same_bits(sample["target"], np.clip(target, 0, 1))  # the clip is of the input
        assert sample["ratio"] == sample["nominal_ratio"] == float(record.ratio)
        assert sample["iso"] == float(record.iso or 0) > 0
        assert sample["exposure_s"] == float(record.exposure_s or 0) > 0
        for name in ("camera", "scene", "split", "path", "reference"):
            assert sample[name] == getattr(record, name)
        assert sample["flags"] == ""


# --- wrong files --------------------------------------------------------------------------------------------------


def test_a_wrong_ratio_names_the_file(tree: Tree) -> None:
    scale_exposure(tree.file(4), Fraction(5, 4))
    dataset = demo(tree, cameras=["DemoAlpha"])
    with pytest.raises(DatasetError, match=r"IMG_0004\.dng: expected an exposure ratio of 100 .* 80; .*eldata verify"):
        dataset[0]
    dataset[1]  # its neighbour is fine


@pytest.mark.parametrize("number", [4, 6])
def test_a_missing_or_broken_file_is_named(tree: Tree, number: int) -> None:
    """A noisy frame, a reference."""
    path, dataset = tree.file(number), demo(tree)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(RawFileError, match=str(path)):
        dataset[0]
    path.unlink()
    with pytest.raises(RawFileError, match=f"{path}: .*No such file"):
        dataset[0]


def test_missing_files_are_named_as_the_set_is_made(tree: Tree) -> None:
    """Of the chosen pairs alone: 12, which share 6 references."""
    for number in (4, 6):
        tree.file(number).unlink()
    with pytest.raises(DatasetError) as raised:
        demo(tree)
    assert str(raised.value) == (
        f"{tree.data}: lacks 2 of the 18 files of these records, first DemoAlpha/scene-1/IMG_0004.dng; eldata verify "
        'eld-demo names all; check="never" makes the dataset all the same'
    )
    assert len(demo(tree, cameras=["DemoBeta"])) == 6
    assert len(demo(tree, check="never")) == 12


# --- wrong arguments ----------------------------------------------------------------------------------------------


def test_the_default_root(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tree.root.parent))
    assert len(ELDDataset(f"~/{tree.root.name}/{tree.folder}", manifest=tree.csv)) == 12
    monkeypatch.setenv("ELDATA_ROOT", str(tree.root))
    assert ELDDataset(manifest=tree.csv).root == tree.data


def test_a_missing_camera_folder_says_what_to_choose(tree: Tree) -> None:
    shutil.rmtree(tree.data / "DemoBeta")
    with pytest.raises(DatasetError, match="no folder 'DemoBeta'") as raised:
        demo(tree)
    assert "cameras=['DemoAlpha']" in str(raised.value)
    assert len(demo(tree, cameras=["DemoAlpha"])) == 6


@pytest.mark.parametrize("place", ["eld-demo", "archive/ELD-demo", "."])
def test_a_copy_that_lies_otherwise_is_found(place: str, tree: Tree) -> None:
    """In other capitals, one level off, in an archive's own folder, without its own folder; by verify and by class.

    A folder of predictions has the same folders, and none of the files.
    """
    aside, expected = tree.root.parent / "aside", tree.root / place
    tree.data.rename(aside)
    for one in aside.rglob("*.dng"):
        prediction = (tree.root / "preds" / one.relative_to(aside)).with_suffix(".npy")
        prediction.parent.mkdir(parents=True, exist_ok=True)
        prediction.touch()
    expected.mkdir(parents=True, exist_ok=True)
    for one in aside.iterdir():
        one.rename(expected / one.name)
    (report,) = verify(tree.csv, tree.root).datasets
    assert (report.folder.resolve(), report.problems) == (expected.resolve(), ())
    for root in (tree.root, expected):
        dataset = ELDDataset(root, manifest=tree.csv)
        assert (dataset.root.resolve(), len(dataset)) == (expected.resolve(), 12)
