"""PackedClips and CleanClips: bit for bit what the files give, by whatever process."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.datasets import CleanClips, SyntheticClips
from eldata.datasets.clips import ClipSample, UnpairedClipSample
from eldata.datasets.crops import Crop
from eldata.datasets.packed import PackedClips
from eldata.datasets.published import DRVDataset
from eldata.errors import ArgumentError, DatasetError
from eldata.raw.dng import write_dng
from eldata.sources.frames import Frame
from eldata.sources.store import build_store, source_of_dataset
from tests.datasets.comparing import same, same_frames
from tests.drv_tree import RGB_SIZE, SENSOR, SmallDrv, write_raw_clip
from tests.raw.helpers import BAYER, EXPOSURE, XTRANS, make_sensor, random_mosaic
from tests.sources.store.helpers import pack_folder, pack_tree

if TYPE_CHECKING:
    from pathlib import Path


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


@pytest.mark.parametrize(
    "options",
    [{}, {"window": 3, "stride": 2}, {"frames": "evaluation"}, {"ids": ["0013"]}, {"dynamic": True, "window": 4}],
)
def test_whole_rgb_windows_are_those_of_the_files(options: dict[str, Any], rgb: Path, drv: SmallDrv) -> None:
    ours = PackedClips(rgb, crop=None, augment=False, **options)
    theirs = DRVDataset(drv.data, manifest=drv.csv, **options)
    assert ours.records == theirs.records
    assert ours.frame.equals(theirs.frame)
    kind = UnpairedClipSample if options.get("dynamic") else ClipSample
    for mine, other in zip(ours, theirs, strict=True):
        same(mine, other)
        assert set(mine) == set(kind.__annotations__)


@pytest.mark.parametrize(("levels", "clip"), [("metadata", "both"), ("published", "upper"), ("metadata", "none")])
def test_whole_raw_windows_are_those_of_the_files(levels: Any, clip: Any, raw: Path, raw_files: Path) -> None:
    for dynamic, channels in ((False, {4, 9}), (True, {4})):
        options: dict[str, Any] = {"levels": levels, "clip": clip, "window": 3, "dynamic": dynamic}
        ours = PackedClips(raw, crop=None, augment=False, **options)
        for mine, other in zip(ours, DRVDataset(raw_files / "DRV", form="raw", **options), strict=True):
            same(mine, other)
        assert {sample["input"].shape[1] for sample in ours} == channels


def test_crops_of_rgb_windows_are_parts_of_the_files_turned_alike(rgb: Path, drv: SmallDrv) -> None:
    """Each frame and the reference at the drawn place, turned by numpy."""
    ours, theirs = PackedClips(rgb, crop=21, crops_per_window=6, seed=4), DRVDataset(drv.data, manifest=drv.csv)
    ours.set_epoch(2)
    assert len(ours) == 6 * len(theirs)
    like = Frame.of_rgb(np.zeros((3, *RGB_SIZE), np.uint16), "")
    for index, sample in enumerate(ours):
        crop = Crop.draw(like, np.random.default_rng([4, 2, index]), crop=21, augment=True)
        rows, columns = (
            slice(None, None, -1 if flip else 1) for flip in (crop.orientation.flip_rows, crop.orientation.flip_columns)
        )
        for name in ("input", "target"):
            part = theirs[index % len(theirs)][name][(..., *crop.slices)].numpy()
            part = np.swapaxes(part, -1, -2) if crop.orientation.transpose else part
            np.testing.assert_array_equal(sample[name].numpy(), part[..., rows, columns])


# --- choices and refusals -----------------------------------------------------------------------------------------


def test_choices_and_refusals(rgb: Path, raw: Path) -> None:
    dataset = PackedClips(rgb, crop=16, ids=["0013"], window=2)
    assert {record.scene for record in dataset.records} == {"0013"}
    assert PackedClips(rgb, crop=16, scenes=["0013"], window=2).records == dataset.records
    for part in ("PackedClips", "1 clips, 6 windows of 2 frames", "crop=16", "augment=True", "seed=0", "levels="):
        assert part in repr(dataset)
    for options, word in (
        ({"split": ["train"]}, "no clip has split train; known are test"),
        ({"crops_per_window": 0}, "crops_per_window must be 1 or more"),
        ({"crop": 9, "region": (0, 0, 4, 4)}, "give a region or a crop, not both"),
    ):
        with pytest.raises(ArgumentError, match=word):
            PackedClips(rgb, **options)
    for store, crop in ((rgb, 49), (raw, 400)):
        with pytest.raises(DatasetError, match=f"too few for a crop of {crop if crop == 49 else 2 * crop}"):
            PackedClips(store, crop=crop, augment=False)[0]


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


# --- clean clips --------------------------------------------------------------------------------------------------


def test_clean_clips_are_those_of_the_raw_files(tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    for clip, cfa in (("a", BAYER["GBRG"]), ("b", BAYER["RGGB"])):
        (folder / clip).mkdir(parents=True)
        for number in (9, 10, 11):
            mosaic = random_mosaic(70, 90, seed=number)
            write_dng(folder / clip / f"{number}.dng", mosaic, make_sensor(cfa, 70, 90), EXPOSURE)
    store = pack_folder(folder, tmp_path / "clean.h5", compression="lz4").store
    levels: Any
    for levels in ("metadata", "published"):
        ours, theirs = (CleanClips(source, levels=levels) for source in (store, folder))
        assert len(ours) == len(theirs) == 2
        for number in range(2):
            same_frames(ours.clip(number), theirs.clip(number))
        made = [SyntheticClips(clips, "SonyA7S2", frames=2, crop=8, seed=2)[1] for clips in (ours, theirs)]
        same(*(dict(sample) | {"path": ""} for sample in made))
    assert "2 clips" in repr(ours)
    with pytest.raises(ArgumentError, match="levels must be one of"):
        CleanClips(store, levels="x")  # type: ignore[arg-type]
    (folder / "a" / "10.dng").unlink()
    gap = pack_folder(folder, tmp_path / "gap.h5").store
    with pytest.raises(DatasetError, match="expected the frames of one clip, numbered without a gap"):
        CleanClips(gap)
