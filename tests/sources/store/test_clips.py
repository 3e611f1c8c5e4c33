"""Stores of clips: what they hold, RGB frames and mosaics, versions, resuming, what verification finds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from eldata.base.pixels import read_rgb16
from eldata.errors import ArgumentError, DatasetError, FileError
from eldata.manifest.layouts import scan_raw
from eldata.raw import read_raw
from eldata.records import Exposure
from eldata.sources.store import build_store, open_store, source_of_dataset, verify_store
from eldata.sources.store.build import pixels_digest
from eldata.sources.store.format import PackedFile, StoredFrame, rgb_sensor
from eldata.sources.store.read import StoreFrames
from tests.drv_tree import SmallDrv, small_drv, write_raw_clip
from tests.sources.store.helpers import pack_tree

if TYPE_CHECKING:
    from pathlib import Path

FRAMES = 7
SIZE = (301, 270)  # above a chunk, no multiple of one


@pytest.fixture(scope="module")
def drv(tmp_path_factory: pytest.TempPathFactory) -> SmallDrv:
    return small_drv(tmp_path_factory.mktemp("drv"), ("0007", "0013", "M0003"), FRAMES, size=SIZE)


@pytest.fixture(scope="module")
def packed(drv: SmallDrv, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack_tree(drv, tmp_path_factory.mktemp("store") / "drv.h5", compression="lz4").store


def test_rgb_frames_are_held_as_decoded(drv: SmallDrv, packed: Path) -> None:
    store = open_store(packed)
    assert store.dataset == "drv"
    assert len(store.frames) == 3 * FRAMES + 2
    with h5py.File(packed, locking=False) as file:
        for frame in store.frames:
            pixels = read_rgb16(drv.data / frame.path).transpose(2, 0, 1)
            np.testing.assert_array_equal(file[f"frames/{frame.key}"][...], pixels)
            kept = pixels_digest(pixels), PackedFile.of(drv.data / frame.path)
            found = StoredFrame(frame.key, frame.path, frame.role, rgb_sensor(*SIZE), Exposure(), *kept)
            assert frame == found


def test_parts_of_rgb_frames(drv: SmallDrv, packed: Path) -> None:
    reader = StoreFrames(packed)._reader
    for frame in open_store(packed).frames:
        pixels = read_rgb16(drv.data / frame.path).transpose(2, 0, 1)
        part = slice(3, 290), slice(200, 270)
        np.testing.assert_array_equal(reader.read(frame.key, *part), pixels[:, 3:290, 200:270])


def test_the_manifest_lists_the_files_in_the_place_of_patterns(packed: Path) -> None:
    store = open_store(packed)
    assert store.manifest is not None
    assert {record.path for record in store.manifest.records} == {frame.path for frame in store.frames}
    assert store.manifest.card.counts == {"noisy": 3 * FRAMES, "reference": 2}
    by_path = {record.path: record for record in store.manifest.records}
    assert by_path["VBM4D_rawRGB/0007/0003.png"].reference == "long/0007/half0001_0.png"
    assert by_path["VBM4D_rawRGB/M0003/0003.png"].reference is None


def test_frames_stand_in_order_with_their_reference_first(packed: Path) -> None:
    paths = [frame.path for frame in open_store(packed).frames]
    clip = [f"VBM4D_rawRGB/0013/{number:04d}.png" for number in range(1, FRAMES + 1)]
    start = paths.index("long/0013/half0001_0.png")
    assert paths[start : start + 1 + FRAMES] == ["long/0013/half0001_0.png", *clip]


def test_raw_clips_are_mosaics_in_a_store(tmp_path: Path) -> None:
    for clip in ("0007", "M0003"):
        write_raw_clip(tmp_path / "DRV", clip, 3)
    (tmp_path / "DRV" / "long" / "0007" / "other.ARW").write_bytes(
        (tmp_path / "DRV" / "long" / "0007" / "DSC00001.ARW").read_bytes()
    )
    with pytest.raises(DatasetError, match="has 2 long exposures"):
        source_of_dataset("drv-raw", root=tmp_path)
    listed = scan_raw(tmp_path / "DRV", reference="DSC*").save(tmp_path / "drv-raw.csv")
    source = source_of_dataset("drv-raw", root=tmp_path, manifest=listed.path)
    assert len(source.files) == 7  # and not the unused one
    build_store(source, tmp_path / "raw.h5")
    store = open_store(tmp_path / "raw.h5")
    with h5py.File(tmp_path / "raw.h5") as file:
        for frame in store.frames:
            np.testing.assert_array_equal(
                file[f"frames/{frame.key}"][...], read_raw(tmp_path / "DRV" / frame.path).mosaic
            )
    assert verify_store(tmp_path / "raw.h5", level="full").ok


def test_what_cannot_be_packed(drv: SmallDrv, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="no subset is called 'test'; known are none"):
        source_of_dataset("drv", root=drv.root, manifest=drv.csv, subset="test")
    with pytest.raises(ArgumentError, match="no clip has split x; known are dynamic, test"):
        source_of_dataset("drv", root=drv.root, manifest=drv.csv, split=["x"])
    # The shipped list has 225 clips: what is not there is not left out in silence.
    with pytest.raises(DatasetError, match=r"no frames of 222 clips.*choose those that you have with ids"):
        source_of_dataset("drv", root=drv.root)
    assert len(source_of_dataset("drv", root=drv.root, ids=["0007"]).files) == FRAMES + 1
    spoilt = small_drv(tmp_path / "spoilt", ("0007",), 3)
    frame = spoilt.data / "VBM4D_rawRGB" / "0007" / "0002.png"
    frame.write_bytes(frame.read_bytes()[:-50])
    with pytest.raises(FileError, match=r"0002\.png: does not end as a PNG does"):
        pack_tree(spoilt, tmp_path / "x.h5")
    assert open_store(pack_tree(drv, tmp_path / "y.h5").store).frames


def test_problems_of_clips_are_found(drv: SmallDrv, packed: Path, tmp_path: Path) -> None:
    store = pack_tree(drv, tmp_path / "store.h5").store
    assert verify_store(store, level="full", workers=2).ok
    assert verify_store(packed, level="full").datasets[0].files_hashed == 3 * FRAMES + 2
    by_path = {frame.path: frame.key for frame in open_store(store).frames}
    with h5py.File(store, "r+") as file:
        file[f"frames/{by_path['VBM4D_rawRGB/0007/0002.png']}"][2, 300, 200] ^= 1
    assert verify_store(store).ok
    (problem,) = verify_store(store, level="full").problems
    assert (problem.path, problem.field) == ("VBM4D_rawRGB/0007/0002.png", "sha256 of the pixels")


def test_a_clip_without_its_reference_is_found(drv: SmallDrv, tmp_path: Path) -> None:
    source = source_of_dataset("drv", root=drv.root, manifest=drv.csv, ids=["0007"])
    lone = replace(source, files=tuple(file for file in source.files if file[1] == "noisy"))
    build_store(lone, tmp_path / "lone.h5")
    found = [(problem.path, problem.field, problem.found) for problem in verify_store(tmp_path / "lone.h5").problems]
    assert found == [(f"VBM4D_rawRGB/0007/{number:04d}.png", "reference", "nothing") for number in range(1, FRAMES + 1)]
