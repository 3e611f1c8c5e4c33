"""Damage to raw files as disks, downloads and cables do it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eldata.raw.reading import read_raw
from eldata.raw.tiff import read_directories
from eldata.records import RawFrame

PAGE = 4096
LOSSES = ("hole of zeros", "hole of one page", "tail of zeros", "tail of zeros, EXIF whole", "hole of 0xFF")


@dataclass(frozen=True)
class Whole:
    """An undamaged file: its bytes, where in them the mosaic's data lie, and what it decodes to."""

    content: bytes
    first: int
    behind: int
    frame: RawFrame

    @classmethod
    def read(cls, path: Path) -> Whole:
        mosaics = [directory for directory in read_directories(path) if directory.is_mosaic]
        extents = [extent for mosaic in mosaics for extent in mosaic.extents]
        return cls(path.read_bytes(), min(extents)[0], max(map(sum, extents)), read_raw(path))

    def lose(self, loss: str, generator: np.random.Generator) -> bytes:
        """Overwrite a part of the image data: their end, or a hole of a page to some hundred KB."""
        data, held = bytearray(self.content), self.behind - self.first
        if loss.startswith("tail"):
            least, most = min(PAGE, 0.9 * held), 0.9 * held
            start = self.behind - round(least * (most / least) ** float(generator.uniform()))
            stop = self.behind if loss.endswith("EXIF whole") else len(data)
        else:
            pages = 1.0 if loss == "hole of one page" else float(generator.uniform(1, 2) * 2.0 ** generator.integers(7))
            size = min(round(PAGE * pages), held // 2)
            start = int(generator.integers(self.first, self.behind - size + 1))
            if generator.integers(2):  # a page of the disk, and whole ones
                size = size // PAGE * PAGE or size
                start = max(-(-self.first // PAGE) * PAGE, start // PAGE * PAGE)
                start = start if start + size <= self.behind else self.first
            stop = start + size
        data[start:stop] = (b"\xff" if loss == "hole of 0xFF" else b"\0") * (stop - start)
        return bytes(data)
