"""DRV: items against plain numpy, windows, refusals, DataLoader workers, memory."""

from __future__ import annotations

import math
import os
import shutil
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader

from eldata.datasets.base import SourcePairs
from eldata.datasets.published import DRVDataset
from eldata.errors import ArgumentError, DatasetError, FileError, RawFileError
from eldata.records import PairRecord
from eldata.sources.frames import Files
from tests.datasets.comparing import pack_plainly, same_bits
from tests.datasets.conftest import CLIPS
from tests.drv_tree import (
    NOISY,
    REFERENCE,
    RGB_SIZE,
    SENSOR,
    SmallDrv,
    rgb_frame_of,
    still_of,
    write_png,
    write_raw,
    write_raw_clip,
)

HEIGHT, WIDTH = RGB_SIZE


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("raw")
    for clip in CLIPS:
        write_raw_clip(folder, clip, 7)
    return folder


def opened(drv: SmallDrv, **options: Any) -> DRVDataset:
    return DRVDataset(drv.data, manifest=drv.csv, **{"split": "test"} | options)


def normalised(pixels: NDArray[np.uint16]) -> NDArray[np.float32]:
    return pixels.transpose(2, 0, 1).astype(np.float32) / np.float32(65535)


# --- preprocessed -----------------------------------------------------------------------------------------------------


def test_items_are_the_files_pixels(drv: SmallDrv) -> None:
    dataset = opened(drv)
    assert len(dataset) == 4  # two windows of five in each of two clips of thirteen
    for index, (clip, start) in enumerate((clip, start) for clip in ("0007", "0013") for start in (0, 5)):
        sample = dataset[index]
        expected = np.stack([normalised(rgb_frame_of(clip, number)) for number in range(start + 1, start + 6)])
        np.testing.assert_array_equal(sample["input"].numpy(), expected)
        np.testing.assert_array_equal(sample["target"].numpy(), normalised(still_of(clip)))
        assert sample["input"].dtype == sample["target"].dtype == torch.float32
        assert sample["input"].shape == (5, 3, HEIGHT, WIDTH)
        assert (sample["scene"], sample["split"], sample["start"]) == (clip, "test", start)
        assert sample["path"] == f"VBM4D_rawRGB/{clip}/{start + 1:04d}.png"
        assert sample["reference"] == f"long/{clip}/half0001_0.png"
        assert sample["camera"] == "SonyRX100M6"
        assert all(math.isnan(sample[name]) for name in ("ratio", "iso", "exposure_s"))
        assert dataset.records[index].frames[0] == sample["path"]
    (batch,) = DataLoader(dataset, batch_size=4)
    assert torch.equal(batch["input"], torch.stack([sample["input"] for sample in dataset]))
    sample = DRVDataset(drv.data, dynamic=True, manifest=drv.csv, window=2)[1]  # which is input alone
    assert ("target" in sample, sample["reference"]) == (False, "")
    np.testing.assert_array_equal(sample["input"][0].numpy(), normalised(rgb_frame_of("M0003", 3)))
    assert (sample["scene"], sample["split"]) == ("M0003", "dynamic")


def test_a_region_is_cut_from_every_frame(drv: SmallDrv) -> None:
    whole, part = opened(drv)[1], opened(drv, region=(4, 6, 10, 20))[1]
    assert torch.equal(part["input"], whole["input"][..., 4:14, 6:26])
    assert torch.equal(part["target"], whole["target"][..., 4:14, 6:26])
    for region in ((0, 0, HEIGHT + 1, 4), (40, 0, 20, 4), (0, WIDTH, 1, 1)):
        with pytest.raises(DatasetError, match="is not inside of"):
            opened(drv, region=region)[0]
    for region in ((-1, 0, 4, 4), (0, 0, 0, 4)):
        with pytest.raises(ArgumentError, match="region must be"):
            opened(drv, region=region)


def test_damage_is_named(drv: SmallDrv, tmp_path: Path) -> None:
    shutil.copytree(drv.data, tmp_path / "DRV")
    copy = replace(drv, root=tmp_path)
    frame = tmp_path / "DRV/VBM4D_rawRGB/0007/0002.png"
    write_png(frame, rgb_frame_of("0007", 2, (40, 40)))
    with pytest.raises(DatasetError, match=r"0002\.png: has 40 x 40 pixels of RGB.*has 48 x 56"):
        opened(copy)[0]
    write_png(frame, rgb_frame_of("0007", 2).astype(np.uint8))
    with pytest.raises(FileError, match="expected a 16-bit RGB PNG, found 8-bit RGB"):
        opened(copy)[0]
    dataset = opened(copy, window=2)
    assert len(dataset) == 12
    frame.unlink()
    with pytest.raises(FileError, match="cannot be read"):
        dataset[0]
    assert [record.start for record in opened(copy, window=3, stride=1, ids=["0007"]).records] == list(range(1, 10))


# --- raw --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("clip", ["both", "upper"])
def test_raw_items_are_packed_and_amplified_exactly(clip: str, raw: Path) -> None:
    dataset = DRVDataset(raw, form="raw", split="test", window=3, clip=clip)  # type: ignore[arg-type]
    assert len(dataset) == 4
    sample = dataset[1]
    paths = [raw / f"short/0007/DSC0{number}.ARW" for number in (1001, 1002, 1003)]
    noisy, low = np.stack([pack_plainly(path, SENSOR.white_level_dn) for path in paths]), 0 if clip == "both" else -9e9
    same_bits(sample["input"], np.clip(np.clip(noisy, low, 1) * np.float32(100), low, 1))
    target = pack_plainly(raw / "long/0007/DSC00001.ARW", SENSOR.white_level_dn)
    same_bits(sample["target"], np.clip(target, 0, 1))
    assert (sample["ratio"], sample["iso"], sample["exposure_s"]) == (100.0, 6400.0, 0.02)
    assert (sample["path"], sample["start"]) == ("short/0007/DSC01001.ARW", 3)
    assert (sample["input"].min() < 0) == (clip == "upper")


def test_raw_damage_is_named(raw: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(raw, tmp_path / "DRV"))
    frame = folder / "short/0007/DSC00999.ARW"
    write_raw(frame, replace(NOISY, iso=Fraction(3200)))
    with pytest.raises(DatasetError, match=r"DSC00999\.ARW: its exposure ratio is 200, that of DSC00998\.ARW 100"):
        DRVDataset(folder, form="raw")[0]
    write_raw(frame, NOISY, sensor=replace(SENSOR, width=100))
    with pytest.raises(DatasetError, match=r"96 x 100 pixels.*96 x 112"):
        DRVDataset(folder, form="raw")[0]
    frame.write_bytes(frame.read_bytes()[:2000])
    with pytest.raises(RawFileError, match="truncated"):
        DRVDataset(folder, form="raw")[0]
    shutil.copy(folder / "short/0013/DSC00998.ARW", folder / "aside")
    (folder / "long/0013/DSC00001.ARW").rename(folder / "short/0013/DSC00998.ARW")
    (folder / "aside").rename(folder / "long/0013/DSC00001.ARW")
    with pytest.raises(DatasetError, match=r"exposed 100 times as much as its reference.*swapped"):
        DRVDataset(folder, form="raw", ids=["0013"])[0]
    (folder / "long/0013/DSC00001.ARW").unlink()
    with pytest.raises(DatasetError, match="no reference of 1 clips: 0013"):
        DRVDataset(folder, form="raw", ids=["0013"])


# --- loaders ----------------------------------------------------------------------------------------------------------


@pytest.mark.memory
def test_memory_does_not_grow_with_the_number_of_frames(tmp_path: Path) -> None:
    """Twelve megapixels, of which a part is kept: thirty windows of five frames (48 MB a packed frame), and the pairs.

    A frame decodes into a mosaic of 24 MB and a packed one of 48 MB, and the reference is held beside it: 120 MB. Whole
    frames of one window would take 240 MB.
    """
    sensor = replace(SENSOR, height=3000, width=4000)
    write_raw(tmp_path / "short/0007/DSC00001.ARW", NOISY, sensor=sensor)
    for number in range(2, 35):
        os.link(tmp_path / "short/0007/DSC00001.ARW", tmp_path / f"short/0007/DSC{number:05d}.ARW")
    write_raw(tmp_path / "long/0007/DSC00001.ARW", REFERENCE, sensor=sensor)
    windows = DRVDataset(tmp_path, form="raw", window=5, stride=1, region=(100, 100, 256, 256))
    of_clip = {"reference": "long/0007/DSC00001.ARW", "camera": "", "scene": "", "split": "", "iso": None}
    pairs = SourcePairs(
        Files(tmp_path),
        [PairRecord(path, **of_clip, exposure_s=None, ratio=Fraction(100)) for path in windows.clips[0].frames],  # type: ignore[arg-type]
        crop=256,
    )
    assert (len(windows), len(pairs)) == (30, 34)
    process = psutil.Process()
    before = process.memory_info().rss
    largest = 0
    for dataset in (windows, pairs):
        for index in (0, 10, 20, 29, 1, 2):
            assert dataset[index]["input"].shape[-3:] == (4, 256, 256)
            largest = max(largest, process.memory_info().rss)
    assert largest - before < 200e6
