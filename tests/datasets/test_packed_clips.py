"""PackedClips and CleanClips: bit for bit what the files give, by whatever process."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from eldata.datasets import CleanClips, SyntheticClips
from eldata.datasets.clips import ClipSample, UnpairedClipSample
from eldata.datasets.crops import ORIENTATIONS, Crop
from eldata.datasets.packed import PackedClips
from eldata.datasets.published.clips import DRVDataset
from eldata.errors import ArgumentError, DatasetError
from eldata.raw.dng import write_dng
from eldata.sources.frames import Frame
from eldata.sources.store import build_store, source_of_dataset
from tests.datasets.comparing import same
from tests.datasets.methods import FORK, workers
from tests.drv_tree import NOISY, REFERENCE, RGB_SIZE, SENSOR, SmallDrv, mosaic_of, small_drv, write_raw, write_raw_clip
from tests.raw.helpers import BAYER, EXPOSURE, XTRANS, make_sensor, random_mosaic
from tests.sources.store.helpers import pack_folder, pack_tree
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

# Python 3.12 and later warn of any fork in a process that has threads.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")

CLIPS = ("0007", "0013", "M0003")
FRAMES = 13


@pytest.fixture(scope="module")
def drv(tmp_path_factory: pytest.TempPathFactory) -> SmallDrv:
    return small_drv(tmp_path_factory.mktemp("drv"), CLIPS, FRAMES)


@pytest.fixture(scope="module")
def rgb(drv: SmallDrv, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack_tree(drv, tmp_path_factory.mktemp("store") / "rgb.h5").store


@pytest.fixture(scope="module")
def raw_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that holds DRV: Bayer clips, and an X-Trans one of another size and phase."""
    root = tmp_path_factory.mktemp("raw")
    for clip in ("0007", "M0003"):
        write_raw_clip(root / "DRV", clip, 7)
    xtrans = replace(SENSOR, cfa=XTRANS["xtrans-42"], black_level_dn=(801.0,) * 3, height=83, width=94)
    write_raw_clip(root / "DRV", "0013", 7, sensor=xtrans)
    return root


@pytest.fixture(scope="module")
def raw(raw_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = tmp_path_factory.mktemp("store") / "raw.h5"
    build_store(source_of_dataset("drv-raw", root=raw_files), store, compression="lz4")
    return store


# --- the files ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"window": 3, "stride": 2}, {"frames": "evaluation"}, {"ids": ["0013"]}])
def test_whole_rgb_windows_are_those_of_the_files(options: dict[str, Any], rgb: Path, drv: SmallDrv) -> None:
    ours = PackedClips(rgb, crop=None, augment=False, split=["test"], **options)
    theirs = DRVDataset(drv.data, manifest=drv.csv, split="test", **options)
    assert ours.records == theirs.records
    assert ours.frame.equals(theirs.frame)
    for mine, other in zip(ours, theirs, strict=True):
        same(mine, other)
        assert set(mine) == set(ClipSample.__annotations__)


def test_whole_windows_without_a_reference_are_those_of_the_files(rgb: Path, drv: SmallDrv) -> None:
    theirs = DRVDataset(drv.data, dynamic=True, manifest=drv.csv, window=4)
    for mine, other in zip(PackedClips(rgb, dynamic=True, crop=None, augment=False, window=4), theirs, strict=True):
        same(mine, other)
        assert set(mine) == set(UnpairedClipSample.__annotations__)


@pytest.mark.parametrize(("levels", "clip"), [("metadata", "both"), ("published", "upper"), ("metadata", "none")])
def test_whole_raw_windows_are_those_of_the_files(levels: Any, clip: Any, raw: Path, raw_files: Path) -> None:
    options: dict[str, Any] = {"levels": levels, "clip": clip, "window": 3}
    folder = raw_files / "DRV"
    paired = PackedClips(raw, crop=None, augment=False, **options)
    for mine, other in zip(paired, DRVDataset(folder, form="raw", **options), strict=True):
        same(mine, other)
    assert {sample["input"].shape[1] for sample in paired} == {4, 9}
    unpaired = PackedClips(raw, dynamic=True, crop=None, augment=False, **options)
    for lone, lone_other in zip(unpaired, DRVDataset(folder, form="raw", dynamic=True, **options), strict=True):
        same(lone, lone_other)


def test_crops_of_rgb_windows_are_parts_of_the_files_turned_alike(rgb: Path, drv: SmallDrv) -> None:
    """Each frame and the reference at the drawn place, turned by numpy."""
    ours = PackedClips(rgb, crop=21, crops_per_window=12, seed=4)
    ours.set_epoch(2)
    theirs = DRVDataset(drv.data, manifest=drv.csv)
    assert len(ours) == 12 * len(theirs)
    like = Frame.of_rgb(np.zeros((3, *RGB_SIZE), np.uint16), "")
    places, turns = set(), set()
    for index, sample in enumerate(ours):
        other = theirs[index % len(theirs)]
        drawn = Crop.draw(like, np.random.default_rng([4, 2, index]), crop=21, augment=True)
        for name in ("input", "target"):
            part = other[name][..., drawn.slices[0], drawn.slices[1]].numpy()
            part = np.swapaxes(part, -1, -2) if drawn.orientation.transpose else part
            rows, columns = drawn.orientation.flip_rows, drawn.orientation.flip_columns
            part = part[..., :: -1 if rows else 1, :: -1 if columns else 1]
            np.testing.assert_array_equal(sample[name].numpy(), part)
        places.add((drawn.slices[0].start, drawn.slices[1].start))
        turns.add(drawn.orientation)
    # 48 items: of 8 orientations one is missing with probability 8 (7/8)^48 = 1.3 %, for seeds in general; the
    # starts are two of 28 and 36 possible, so 48 equal pairs are out of the question.
    assert turns == set(ORIENTATIONS)
    assert len(places) > 30


@pytest.mark.parametrize("clip", ["0007", "0013"])
def test_crops_of_raw_windows_are_parts_of_the_files(clip: str, raw: Path, raw_files: Path) -> None:
    """Not turned, a crop is a region of the packed frame; turned ones are Crop's, whose tests look at the CFA."""
    options: dict[str, Any] = {"ids": [clip], "clip": "none", "window": 3}
    ours = PackedClips(raw, crop=6, augment=False, crops_per_window=8, seed=1, **options)
    ours.set_epoch(0)
    starts = set()
    for index, sample in enumerate(ours):
        drawn = ours.item(index).crop
        area = DRVDataset(raw_files / "DRV", form="raw", **options)
        scale = 2 if clip == "0007" else 3
        whole = Crop.draw(  # where the packed area begins: the crop of all of it
            ours_clean(ours, index), np.random.default_rng(0), crop=None, augment=False
        )
        top, left = ((part.start - all_.start) // scale for part, all_ in zip(drawn.slices, whole.slices, strict=True))
        wanted = area[index % len(area)]
        for name in ("input", "target"):
            part = wanted[name][..., top : top + 6, left : left + 6]
            assert torch.equal(sample[name], part)
        starts.add((top, left))
    assert len(starts) > 4


def ours_clean(dataset: PackedClips, index: int) -> Any:
    return next(iter(dataset.item(index).parts)).frame


# --- determinism --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "which"),
    [
        *(pytest.param("fork", which, marks=FORK.marks) for which in ("rgb", "raw")),
        pytest.param("spawn", "raw", marks=pytest.mark.study),
    ],
)
def test_workers_and_batches_change_nothing(method: str, which: str, rgb: Path, raw: Path) -> None:
    ids = ["0007"] if which == "raw" else None  # X-Trans and Bayer make no batch together
    dataset = PackedClips({"rgb": rgb, "raw": raw}[which], crop=8, crops_per_window=5, seed=6, ids=ids)
    dataset.set_epoch(3)
    reference = list(dataset)
    options: dict[str, Any] = {"num_workers": workers(method), "multiprocessing_context": method, "timeout": PATIENCE_S}
    for item, wanted in zip(DataLoader(dataset, batch_size=None, **options), reference, strict=True):
        same(item, wanted)
    together = [item for batch in DataLoader(dataset, batch_size=3, **options) for item in items_of(batch)]
    for item, wanted in zip(together, reference, strict=True):
        same(item, wanted)


def items_of(batch: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Take a batch apart again; numbers come back as they were."""
    return [
        {
            name: value[place].item() if isinstance(value, torch.Tensor) and value.ndim == 1 else value[place]
            for name, value in batch.items()
        }
        for place in range(len(batch["path"]))
    ]


# --- choices and refusals -----------------------------------------------------------------------------------------


def test_choices_and_refusals(rgb: Path, raw: Path, tmp_path: Path) -> None:
    dataset = PackedClips(rgb, crop=16, ids=["0013"], window=2)
    assert {record.scene for record in dataset.records} == {"0013"}
    for part in ("PackedClips", "1 clips, 6 windows of 2 frames", "crop=16", "augment=True", "seed=0", "levels="):
        assert part in repr(dataset)
    for options, word in (
        ({"ids": ["0008"]}, "known are 0007, 0013"),
        ({"split": ["train"]}, "no clip has split train; known are test"),
        ({"levels": "camera"}, "levels must be one of"),
        ({"clip": "lower"}, "clip must be one of"),
        ({"seed": -1}, "seed must be 0 or more"),
        ({"crop": 1}, "crop 2 or more"),
        ({"crops_per_window": 0}, "crops_per_window must be 1 or more"),
        ({"window": 0}, "window and stride must be 1 or more"),
        ({"frames": "some"}, "frames must be one of"),
    ):
        with pytest.raises(ArgumentError, match=word):
            PackedClips(rgb, **options)
    with pytest.raises(DatasetError, match="no 14 continuous frames"):
        PackedClips(rgb, window=14)
    with pytest.raises(DatasetError, match="too few for a crop of 49 x 49"):
        PackedClips(rgb, crop=49)[0]
    with pytest.raises(DatasetError, match="too few for a crop"):
        PackedClips(raw, crop=400)[0]


def test_stores_of_other_things_are_refused(rgb: Path, drv: SmallDrv, tmp_path: Path) -> None:
    source = source_of_dataset("drv", root=drv.root, manifest=drv.csv, ids=["M0003"])
    build_store(source, tmp_path / "dynamic.h5")
    with pytest.raises(DatasetError, match="holds no clip with a reference; read it with dynamic=True"):
        PackedClips(tmp_path / "dynamic.h5")
    (tmp_path / "raws").mkdir()
    sensor = make_sensor(BAYER["RGGB"], 64, 64)
    write_dng(tmp_path / "raws" / "1.dng", random_mosaic(64, 64), sensor, EXPOSURE)
    clean = pack_folder(tmp_path / "raws", tmp_path / "clean.h5").store
    with pytest.raises(DatasetError, match="holds clean frames, not clips; read it with CleanFrames or CleanClips"):
        PackedClips(clean)
    with pytest.raises(DatasetError, match="holds a dataset, not clean clips"):
        CleanClips(rgb)


def packed_raw(root: Path) -> Path:
    build_store(source_of_dataset("drv-raw", root=root), root / "store.h5")
    return root / "store.h5"


def test_frames_that_are_not_of_one_clip_are_refused(tmp_path: Path) -> None:
    """Found as the store is opened, before any pixel is read."""
    other_exposure, swapped, other_size = (tmp_path / name for name in ("exposure", "swapped", "size"))
    for root in (other_exposure, swapped, other_size):
        write_raw_clip(root / "DRV", "0007", 5)
    write_raw(other_exposure / "DRV" / "short" / "0007" / "DSC01000.ARW", replace(NOISY, exposure_s=Fraction(1, 25)))
    with pytest.raises(DatasetError, match=r"DSC01000\.ARW: its exposure ratio is 50, that of .*DSC00998.ARW 100"):
        PackedClips(packed_raw(other_exposure))
    for number in range(998, 1003):
        write_raw(swapped / "DRV" / "short" / "0007" / f"DSC{number:05d}.ARW", REFERENCE)
    write_raw(swapped / "DRV" / "long" / "0007" / "DSC00001.ARW", NOISY)
    with pytest.raises(DatasetError, match=r"is exposed 100 times as much as its reference .*are they swapped"):
        PackedClips(packed_raw(swapped))
    write_raw(other_size / "DRV" / "short" / "0007" / "DSC01001.ARW", NOISY, sensor=replace(SENSOR, height=80))
    with pytest.raises(DatasetError, match=r"DSC01001\.ARW: has 80 x 112 pixels .*has 96 x 112"):
        PackedClips(packed_raw(other_size))


# --- clean clips --------------------------------------------------------------------------------------------------


def test_clean_clips_are_those_of_the_raw_files(tmp_path: Path) -> None:
    """SyntheticClips cannot tell the two sources apart, in items and in batches."""
    folder = tmp_path / "clips"
    for clip, cfa in (("a", BAYER["GBRG"]), ("b", BAYER["RGGB"])):
        (folder / clip).mkdir(parents=True)
        sensor = make_sensor(cfa, 70, 90)
        for number in (9, 10, 11):
            write_dng(
                folder / clip / f"{number}.dng", mosaic_of(f"{clip}{number}", REFERENCE, sensor), sensor, EXPOSURE
            )
    store = pack_folder(folder, tmp_path / "clean.h5", compression="lz4").store
    levels: Any
    for levels in ("metadata", "published"):
        options: dict[str, Any] = {"frames": 2, "crop": 8, "windows_per_clip": 4, "seed": 2}
        source = CleanClips(store, levels=levels)
        assert (len(source), len(source.clip(1))) == (2, 3)
        ours = SyntheticClips(source, "SonyA7S2", **options)
        theirs = SyntheticClips(CleanClips(folder, levels=levels), "SonyA7S2", **options)
        for mine, other in zip(ours, theirs, strict=True):
            assert mine["path"].rpartition("/")[2] == other["path"].rpartition("/")[2]
            same(dict(mine) | {"path": ""}, dict(other) | {"path": ""})
        batches = DataLoader(ours, batch_size=3)
        together = torch.cat([batch["input"] for batch in batches])
        assert torch.equal(together, torch.stack([sample["input"] for sample in theirs]))
    assert "2 clips" in repr(source)
    with pytest.raises(ArgumentError, match="levels must be one of"):
        CleanClips(store, levels="x")  # type: ignore[arg-type]
    (folder / "a" / "10.dng").unlink()
    gap = pack_folder(folder, tmp_path / "gap.h5").store
    with pytest.raises(DatasetError, match="expected the frames of one clip, numbered without a gap"):
        CleanClips(gap)
