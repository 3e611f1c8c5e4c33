"""A frame as its diagnosis sees it: how it is scored, some blocks of it, and the candidates for its mistake."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.raw.levels import PUBLISHED_WHITE_LEVEL_DN, with_levels

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.metrics.image_score import Score
    from eldata.protocols.protocol import Protocol
    from eldata.records import Sensor

    Array: TypeAlias = NDArray[Any]
    Change: TypeAlias = Callable[[Array], Array]

MARGIN = 2
"""The largest shift that is tried, in packed pixels: so much lies around a block."""

GAIN_DB = 1.0
"""What undoing a mistake is worth at least."""

_SIDE, _BLOCKS = 32, 8  # blocks in packed pixels: their side, their number
_SMALLEST_SIDE = 8
_CELL = 4
_GRID = (6, 8)


@dataclass(frozen=True, slots=True, eq=False)
class Circumstances:
    """What of a frame's evaluation decides which mistakes are possible.

    Attributes
    ----------
    protocol
        How it is scored.
    sensor
        Of packed raw; ``None`` of colours.
    ratio
        The factor by which its input is amplified, if it is known.
    score
        Scores another prediction of the whole frame.
    amplified
        Returns the amplified noisy input of the whole frame.
    """

    protocol: Protocol
    sensor: Sensor | None
    ratio: float | None
    score: Callable[[Array], Score]
    amplified: Callable[[], Array]


@dataclass(frozen=True, slots=True)
class LevelsTaken:
    """Black and white level of a protocol, and the white levels that may be taken instead."""

    black: float
    white: float
    whites: tuple[float, ...]

    @classmethod
    def of(cls, sensor: Sensor, protocol: Protocol) -> LevelsTaken:
        """Return those of a protocol and of files that such a sensor wrote."""
        levels = protocol.levels
        leveled = with_levels(sensor, "metadata" if levels == "metadata-per-channel" else levels)
        black = float(np.mean(leveled.black_level_dn))
        white = leveled.white_level_dn
        return cls(black, white, tuple(dict.fromkeys((white, sensor.white_level_dn, PUBLISHED_WHITE_LEVEL_DN))))


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A mistake that may have been made, and how it is undone on a whole frame.

    ``undo`` is ``None`` where nothing can, or where the protocol's factor does it already.
    """

    words: str
    undo: Change | None
    least_db: float = GAIN_DB


@dataclass(frozen=True, slots=True)
class Blocks:
    """Where the blocks lie, by their first row and column without the margin, which is even: X-Trans repeats so."""

    places: tuple[tuple[int, int], ...]
    side: int

    @classmethod
    def of(cls, target: Array, crop: tuple[slice, ...]) -> Blocks | None:
        """Return blocks in a region: half of them where the reference has most detail, half spread over the rest."""
        height, width = target.shape[1:]
        (top, bottom), (left, right) = (
            (max(span.indices(size)[0], MARGIN), min(span.indices(size)[1], size - MARGIN))
            for span, size in zip(crop[1:], (height, width), strict=True)
        )
        top, left = top + top % 2, left + left % 2
        side = min(_SIDE, bottom - top, right - left) // _CELL * _CELL
        if side < _SMALLEST_SIDE:
            return None
        rows, columns = (
            [first + int(step * (last - side - first) / max(count - 1, 1)) // 2 * 2 for step in range(count)]
            for first, last, most in ((top, bottom, _GRID[0]), (left, right, _GRID[1]))
            for count in (min(most, (last - first) // side),)
        )
        grid = [(row, column) for row in rows for column in columns]
        middle = side // 2
        detail = [float(np.ptp(target[1, row + middle, column : column + side])) for row, column in grid]
        by_detail = sorted(range(len(grid)), key=lambda index: -detail[index])
        most, rest = by_detail[: _BLOCKS // 2], sorted(by_detail[_BLOCKS // 2 :])
        count = min(_BLOCKS - len(most), len(rest))
        spread = [rest[int((index + 0.5) * len(rest) / count)] for index in range(count)]
        return cls(tuple(grid[index] for index in (*most, *spread)), side)

    def cut(self, image: Array) -> NDArray[np.float32]:
        """Return the blocks of an image with their margin, (C, side + 4, blocks, side + 4)."""
        side = self.side + 2 * MARGIN
        found = np.empty((image.shape[0], side, len(self.places), side), np.float32)
        for index, (row, column) in enumerate(self.places):
            y, x = row - MARGIN, column - MARGIN
            found[:, :, index] = image[:, y : y + side, x : x + side]
        return found


def inner_entries(blocks: Array, down: int = 0, right: int = 0) -> Array:
    """Return the blocks without their margin, or what lies so far from there, (C, entries)."""
    side = blocks.shape[1] - 2 * MARGIN
    y, x = MARGIN + down, MARGIN + right
    return blocks[:, y : y + side, :, x : x + side].reshape(len(blocks), -1)


def cell_means(blocks: Array) -> Array:
    """Return the means of the cells of 4 x 4 pixels in the blocks without their margin."""
    channels, side, count, _ = blocks.shape
    inner = blocks[:, MARGIN : side - MARGIN, :, MARGIN : side - MARGIN]
    cells = inner.shape[1] // _CELL
    parts: Array = inner.reshape(channels, cells, _CELL, count, cells, _CELL)
    means: Array = parts.mean(axis=(2, 5), dtype=np.float32).ravel()
    return means
