"""Damage to raw files as disks, downloads and cables do it, and how much of it is noticed.

``python -m tests.raw.damaging FILE... --trials 1000`` prints the rates of docs/raw-files.md.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import RawFileError
from eldata.raw.damage import check_streams
from eldata.raw.reading import read_raw
from eldata.raw.tiff import read_directories

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

PAGE, SECTOR = 4096, 512


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


Harm = "Callable[[bytearray, Whole, np.random.Generator], None]"


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


def random_sector(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    place = _place(whole, SECTOR, generator)
    data[place] = generator.bytes(place.stop - place.start)


def random_page(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    place = _place(whole, PAGE, generator)
    data[place] = generator.bytes(place.stop - place.start)


def copied_page(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    """A page of the same data in place of another."""
    here, there = _place(whole, PAGE, generator), _place(whole, PAGE, generator)
    data[here] = data[there]


def lost_page(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    """What follows has moved up, and the file ends in zeros that make its old size."""
    place = _place(whole, PAGE, generator)
    end = data[whole.behind :]
    data[place.start :] = data[place.stop : whole.behind] + bytes(place.stop - place.start) + end


def interleaved(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    """Every second page is that of a shifted copy of the data, as if two files had been written into each other."""
    start = int(generator.integers(whole.first, (whole.first + whole.behind) // 2))
    other = bytes(data[whole.first : whole.behind])
    for at in range(start, whole.behind, 2 * PAGE):
        size = min(PAGE, whole.behind - at)
        source = (at - whole.first + len(other) // 3) % (len(other) - size + 1)
        data[at : at + size] = other[source : source + size]


def flipped_bit(data: bytearray, whole: Whole, generator: np.random.Generator) -> None:
    data[int(generator.integers(whole.first, whole.behind))] ^= 1 << int(generator.integers(8))


HARMS: dict[str, Callable[[bytearray, Whole, np.random.Generator], None]] = {
    "hole of zeros": hole,
    "hole of one page": page_hole,
    "tail of zeros": tail,
    "tail of zeros, EXIF whole": tail_of_data,
    "hole of 0xFF": hole_of_ones,
    "sector of random bytes": random_sector,
    "page of random bytes": random_page,
    "page copied from elsewhere": copied_page,
    "page lost, the rest moved up": lost_page,
    "two files interleaved": interleaved,
    "one bit flipped": flipped_bit,
}


def noticed(path: Path, whole: Whole) -> str:
    """How a damaged file fares: refused when read, refused by the full check, harmless, or wrong without a word."""
    try:
        frame = read_raw(path)
    except RawFileError:
        return "read"
    if np.array_equal(frame.mosaic, whole.mosaic) and frame.exposure == whole.exposure:
        return "harmless"
    try:
        check_streams(path, read_directories(path))
    except RawFileError:
        return "full"
    return "silent"


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


def main() -> None:
    """Print one line a kind of damage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--harm", action="append", choices=HARMS)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in options.harm or HARMS:
            counts = rates(options.files, name, options.trials, options.seed, Path(folder))
            wrong = options.trials - counts["harmless"]
            upper = 1 - 0.05 ** (1 / max(1, wrong)) if not counts["silent"] else counts["silent"] / wrong
            print(
                f"{name:30s} changed {wrong:5d}  read {counts['read']:5d}  full {counts['full']:5d}  "
                f"silent {counts['silent']:5d} ({upper:.2%}{'' if counts['silent'] else ' at most, 95 %'})",
                flush=True,
            )


if __name__ == "__main__":
    main()
