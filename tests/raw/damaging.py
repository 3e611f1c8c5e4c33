"""Damage to raw files as disks, downloads and cables do it, and how much of it is noticed."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import RawFileError
from eldata.raw.reading import read_raw
from eldata.raw.tiff import read_directories

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

PAGE = 4096


@dataclass(frozen=True)
class Whole:
    """An undamaged file: its bytes, where in them the mosaic's data lie, and what it decodes to."""

    content: bytes
    first: int
    behind: int
    mosaic: NDArray[np.uint16]
    exposure: object

    @classmethod
    def read(cls, path: Path) -> Whole:
        content = path.read_bytes()
        extents = [extent for found in read_directories(path) if found.is_mosaic for extent in found.extents]
        first = min((offset for offset, _ in extents), default=0)
        behind = max((offset + count for offset, count in extents), default=len(content))
        frame = read_raw(path)
        return cls(content, first, behind, frame.mosaic, frame.exposure)


def _place(whole: Whole, size: int, generator: np.random.Generator, *, aligned: bool = False) -> slice:
    """Somewhere wholly inside the image data; where these are shorter, their second half."""
    size = min(size, (whole.behind - whole.first) // 2)
    at = int(generator.integers(whole.first, whole.behind - size + 1))
    if aligned:
        at = max(-(-whole.first // PAGE) * PAGE, at // PAGE * PAGE)
        at = at if at + size <= whole.behind else whole.first
    return slice(at, at + size)


def hole(data: bytearray, whole: Whole, generator: np.random.Generator, fill: int = 0) -> None:
    """A page to some hundred KB, at a page of the disk or anywhere."""
    size = round(PAGE * float(generator.uniform(1, 2) * 2.0 ** generator.integers(0, 7)))
    aligned = bool(generator.integers(2))
    place = _place(whole, size // PAGE * PAGE if aligned else size, generator, aligned=aligned)
    data[place] = bytes([fill]) * (place.stop - place.start)


def page_hole(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    """One page."""
    place = _place(whole, PAGE, generator, aligned=bool(generator.integers(2)))
    data[place] = bytes(place.stop - place.start)


def hole_of_ones(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    """As erased flash memory has it."""
    hole(data, whole, generator, 0xFF)


def tail(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    """One page to 90 % of the image data, with all that follows them in the file."""
    longest = 0.9 * (whole.behind - whole.first)
    size = round(min(PAGE, longest) * (longest / min(PAGE, longest)) ** float(generator.uniform()))
    data[whole.behind - size :] = bytes(len(data) - (whole.behind - size))


def tail_of_data(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    """The same, but what follows the image data is whole, EXIF among it."""
    rest = data[whole.behind :]
    tail(data, whole, generator)
    data[whole.behind :] = rest


HARMS: dict[str, Callable[[bytearray, Whole, np.random.Generator], None]] = {
    "hole of zeros": hole,
    "hole of one page": page_hole,
    "tail of zeros": tail,
    "tail of zeros, EXIF whole": tail_of_data,
    "hole of 0xFF": hole_of_ones,
}


def noticed(path: Path, whole: Whole) -> str:
    """How a damaged file fares: refused when read, harmless, or wrong without a word."""
    try:
        frame = read_raw(path)
    except RawFileError:
        return "read"
    same = np.array_equal(frame.mosaic, whole.mosaic) and frame.exposure == whole.exposure
    return "harmless" if same else "silent"


def rates(paths: Sequence[Path], name: str, trials: int, seed: int, folder: Path) -> Counter[str]:
    """Damage files ``trials`` times in one way, and count how that is noticed."""
    generator = np.random.default_rng([seed, list(HARMS).index(name)])
    wholes = [Whole.read(path) for path in paths]
    counts: Counter[str] = Counter()
    for trial in range(trials):
        index = trial % len(paths)
        data = bytearray(wholes[index].content)
        HARMS[name](data, wholes[index], generator)
        damaged = folder / f"damaged{paths[index].suffix}"
        damaged.write_bytes(data)
        counts[noticed(damaged, wholes[index])] += 1
    return counts
