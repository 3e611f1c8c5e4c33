"""The ways in which people read random crop pairs for training today, beside which the store is timed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lmdb
import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.raw import pack
from eldata.raw.levels import pack_normalised

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.records import RawFrame

CROP = 512


class Crops(Dataset[dict[str, torch.Tensor]]):
    """Crops of pairs at places drawn once: (pair, top, left) in packed pixels, input and target alike."""

    def __init__(self, pairs: int, sides: tuple[int, int], count: int) -> None:
        generator = np.random.default_rng(0)
        self.places = [
            (number % pairs, int(generator.integers(sides[0] - CROP + 1)), int(generator.integers(sides[1] - CROP + 1)))
            for number in range(count)
        ]

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        pair, top, left = self.places[index]
        return {
            side: torch.from_numpy(self.crop(pair, number, top, left))
            for number, side in enumerate(("input", "target"))
        }

    def crop(self, pair: int, number: int, top: int, left: int) -> NDArray[Any]:
        raise NotImplementedError


class Memmap(Crops):
    """Memory maps of packed uint16, to float32 by one multiplication: neither black level nor clip."""

    def __init__(self, folder: Path, frames: Sequence[Sequence[RawFrame]], count: int) -> None:
        packed = [[pack(frame.mosaic, frame.sensor.cfa) for frame in pair] for pair in frames]
        super().__init__(len(packed), packed[0][0].shape[1:], count)
        self.frames = []
        for number, pair in enumerate(packed):
            paths = [folder / f"{number}-{side}.packed" for side in range(2)]
            for path, pixels in zip(paths, pair, strict=True):
                pixels.tofile(path)
            self.frames.append([np.memmap(path, np.uint16, "r", shape=pair[0].shape) for path in paths])

    def crop(self, pair: int, number: int, top: int, left: int) -> NDArray[Any]:
        part = self.frames[pair][number][:, top : top + CROP, left : left + CROP]
        return np.multiply(part, np.float32(1 / 16383), dtype=np.float32)


class SameValues(Crops):
    """Mosaics in anything that numpy can slice, by our kernel: the very values of the store's crops."""

    def __init__(
        self,
        mosaics: Sequence[Sequence[Any]],
        frames: Sequence[Sequence[RawFrame]],
        ratios: Sequence[float],
        count: int,
    ) -> None:
        height, width = mosaics[0][0].shape
        super().__init__(len(mosaics), (height // 2, width // 2), count)
        self.mosaics, self.ratios = mosaics, ratios
        self.sensors = [[frame.sensor for frame in pair] for pair in frames]

    def crop(self, pair: int, number: int, top: int, left: int) -> NDArray[Any]:
        part = self.mosaics[pair][number][2 * top : 2 * (top + CROP), 2 * left : 2 * (left + CROP)]
        sensor = self.sensors[pair][number]
        gain = self.ratios[pair] if number == 0 else 1.0
        return pack_normalised(part, sensor.cfa, sensor.black_level_dn, 16383.0, gain=gain)


class Lmdb(Crops):
    """Fixed patches, stored and read whole, as the published loaders do it: the ELD repository's LMDBDataset."""

    def __init__(self, folder: Path, frames: Sequence[Sequence[RawFrame]], count: int) -> None:
        self.folders = [folder / "input.lmdb", folder / "target.lmdb"]
        self.patches = 0
        for number, path in enumerate(self.folders):
            self.patches = _write_patches(path, [pack(pair[number].mosaic, pair[number].sensor.cfa) for pair in frames])
        super().__init__(self.patches, (CROP, CROP), count)
        self._opened: list[Any] = []

    def crop(self, pair: int, number: int, top: int, left: int) -> NDArray[Any]:  # noqa: ARG002 # fixed patches
        if not self._opened:
            self._opened = [lmdb.open(str(path), readonly=True, lock=False, readahead=False) for path in self.folders]
        with self._opened[number].begin(write=False) as transaction:
            flat = np.frombuffer(transaction.get(f"{pair:08d}".encode()), np.uint16)
        patch: NDArray[np.float32] = np.clip(flat.reshape(4, CROP, CROP) / 65535, 0, 1).astype(np.float32)
        return patch


def _write_patches(folder: Path, frames: Sequence[NDArray[np.uint16]]) -> int:
    """Write the whole patches of a grid; return their number."""
    count = 0
    with (
        lmdb.open(str(folder), map_size=2 * sum(frame.nbytes for frame in frames)) as database,
        database.begin(write=True) as transaction,
    ):
        for frame in frames:
            for top in range(0, frame.shape[1] - CROP + 1, CROP):
                for left in range(0, frame.shape[2] - CROP + 1, CROP):
                    patch = np.ascontiguousarray(frame[:, top : top + CROP, left : left + CROP])
                    transaction.put(f"{count:08d}".encode(), patch.tobytes())
                    count += 1
    return count
