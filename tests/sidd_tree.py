"""SIDD's files on disk: the published names, with small arrays in MATLAB's 7.3 format inside, made from seeds."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from eldata.manifest.catalogue import Manifest
from eldata.records import FrameRecord
from tests.trees import place_of

SHAPE = (40, 48)


def shares_of(record: FrameRecord) -> NDArray[np.float32]:
    """Pixels of a frame, (H, W) as MATLAB shows them, in [0, 1]; of a noisy frame some are clipped at either end."""
    clean = np.random.default_rng(zlib.crc32((record.reference or record.path).encode())).random(SHAPE, np.float32)
    if record.reference is None:
        return clean
    noise = np.random.default_rng(zlib.crc32(record.path.encode())).normal(0, 0.05, SHAPE)
    return np.clip(clean + noise, 0, 1).astype(np.float32)


def save_matlab_73(path: Path, mosaic: NDArray[Any]) -> None:
    """Write as MATLAB does: HDF5 behind a block of 512 bytes, columns first, beside what is not an array."""
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("x", data=mosaic.T, compression="gzip", chunks=(16, 16))
        file.create_group("#refs#")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def write_frames(folder: Path, records: Iterable[FrameRecord]) -> None:
    """Write frames below the dataset's folder, each with pixels of its own."""
    for record in records:
        save_matlab_73(place_of(record, folder), shares_of(record))


def write_corrected(folder: Path, records: Iterable[FrameRecord]) -> None:
    """Write frames as SIDD-CC lays them out, black subtracted and left unclipped, below its folder."""
    for record in records:
        path = folder / record.path.replace("SIDD_Medium_Raw", "Raw/train")
        path.parent.mkdir(parents=True, exist_ok=True)
        save_matlab_73(path, (shares_of(record) - np.float32(0.02)))


def build_sidd_tree(manifest: Manifest, folder: Path) -> None:
    """Write every file of SIDD's medium set that the manifest lists."""
    write_frames(folder, manifest.records)


def blocks_of(name: str, shape: tuple[int, ...] = (40, 32, 24, 26)) -> NDArray[np.float32]:
    """An array of blocks, (images, blocks, H, W) in [0, 1]: noisy ones are the validation's truth and noise."""
    clean = np.random.default_rng(7).random(shape, np.float32)
    if "Gt" in name:
        return clean
    noise = np.random.default_rng(zlib.crc32(name.encode())).normal(0, 0.05, shape)
    return np.clip(clean + noise, 0, 1).astype(np.float32)


def build_blocks_tree(manifest: Manifest, folder: Path) -> None:
    """Write every block that the manifest lists, as unpacked."""
    made = cache(blocks_of)
    for record in manifest.records:
        array = record.path.split("/")[1]
        path = place_of(record, folder)
        image, block = map(int, path.stem.split("_"))
        np.save(path, made(array)[image, block])
