"""Where a prediction's values lie: blocks of its frame, and the orders of channels, shifts and flips of mistakes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.raw.levels import (
    BAYER_CHANNELS,
    BAYER_PHASES,
    PUBLISHED_WHITE_LEVEL_DN,
    bayer_cfa,
    pack,
    packing_sites,
    unpack,
    with_levels,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.metrics.image_score import Score
    from eldata.protocols.protocol import Protocol
    from eldata.raw.levels import CfaRows
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


def levels_taken(sensor: Sensor, protocol: Protocol) -> tuple[float, tuple[float, ...]]:
    """Return black level and white level of a protocol and of files that such a sensor wrote, in DN.

    After the white level come those that may be taken instead.
    """
    levels = protocol.levels
    leveled = with_levels(sensor, "metadata" if levels == "metadata-per-channel" else levels)
    whites = dict.fromkeys((leveled.white_level_dn, sensor.white_level_dn, PUBLISHED_WHITE_LEVEL_DN))
    return float(np.mean(leveled.black_level_dn)), tuple(whites)


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


# --- orders, shifts, flips --------------------------------------------------------------------------------------------

_SHIFT_GAIN_DB = 0.5  # what undoing a shift is worth at least
_SCREENED_GAIN_DB = 0.5  # of the blocks alone
_ALIKE = 1.03  # errors within this factor are alike: the likelier mistake is named

_COLOURS = ("R", "G", "B")

# What codes that take a 2x2 cell of another phase for R, G, B, G make of it, row by row or around the cell, and R and B
# exchanged: by the place in the prediction, the channel that lies there.
_USUAL_ORDERS: dict[int, tuple[tuple[int, ...], ...]] = {
    4: (
        *((0, 1, 3, 2), (2, 1, 0, 3), (2, 3, 0, 1), (2, 3, 1, 0)),
        *((1, 0, 3, 2), (1, 0, 2, 3), (3, 2, 1, 0), (3, 2, 0, 1)),
    ),
    9: ((2, 1, 0, 4, 3, 5, 6, 7, 8),),
    3: ((2, 1, 0),),
}


def _of_blocks(order: Sequence[int], count: int) -> tuple[int, ...]:
    """Return an order of Bayer's channels as one of blocks of so many channels."""
    return tuple(count * at + site for at in order for site in range(count))


# What a pixel_unshuffle gives: the sites of the pattern row by row, of each phase.
_BY_ROW = {
    tuple(map(int, packing_sites(bayer_cfa(first, block)).table[:, 2])) for first in BAYER_PHASES for block in (2, 3)
}
_USUAL_ORDERS |= {
    channels: (
        *(_of_blocks(order, channels // 4) for order in _USUAL_ORDERS[4]),
        *sorted(order for order in _BY_ROW if len(order) == channels),
    )
    for channels in {len(order) for order in _BY_ROW}
}


def _orders(agreement: Array) -> Iterator[tuple[int, ...]]:
    """Yield orders of channels, likelier ones first: which channel of the reference lies at each place.

    Parameters
    ----------
    agreement
        (C, C): the products of each of the prediction's channels with each of the reference's.
    """
    count = len(agreement)
    usual = [order for order in _USUAL_ORDERS.get(count, ()) if len(order) == count]
    yield from usual
    if count <= 4:
        yield from (
            order for order in permutations(range(count)) if order != tuple(range(count)) and order not in usual
        )
        return
    from scipy.optimize import linear_sum_assignment

    yield tuple(int(channel) for channel in linear_sum_assignment(agreement, maximize=True)[1])


def _order_words(order: Sequence[int], *, colours: bool) -> str:
    if len(order) == len(BAYER_CHANNELS):
        return f"packed {', '.join(BAYER_CHANNELS[channel] for channel in order)}"
    if tuple(order) in _BY_ROW:
        return "packed with the sites of the pattern row by row"
    count = len(order) // len(BAYER_CHANNELS)
    blocks = [channel // count for channel in order[::count]] if count else []
    if tuple(order) == _of_blocks(blocks, count):
        return f"packed in the order {', '.join(BAYER_CHANNELS[channel] for channel in blocks)} of its blocks"
    if colours:
        return f"in the order {', '.join(_COLOURS[channel] for channel in order)}"
    return f"packed in the order {', '.join(map(str, order))} of its channels"


def _reordered(order: Sequence[int]) -> Change:
    back = np.argsort(np.array(order))
    return lambda image: image[back]


def _shifted_back(down: int, right: int) -> Change:
    """Return what moves an image back; at the edges it is mirrored, which keeps a mosaic's phase."""

    def undo(image: Array) -> Array:
        for axis, by in ((-2, down), (-1, right)):
            last = image.shape[axis] - 1
            index = np.abs(np.arange(last + 1) + by)
            image = np.take(image, np.where(index > last, 2 * last - index, index), axis=axis)
        return image

    return undo


def _chained(first: Change, then: Change) -> Change:
    return lambda image: then(first(image))


_FLIPS: tuple[tuple[str, Change], ...] = (
    ("flipped left to right", lambda image: image[:, :, ::-1]),
    ("flipped upside down", lambda image: image[:, ::-1]),
    ("turned by 180 degrees", lambda image: image[:, ::-1, ::-1]),
)
_SQUARE: tuple[tuple[str, Change], ...] = (
    ("transposed", lambda image: image.transpose(0, 2, 1)),
    ("turned by 90 degrees", lambda image: image[:, ::-1].transpose(0, 2, 1)),
    ("turned by 270 degrees", lambda image: image[:, :, ::-1].transpose(0, 2, 1)),
    ("transposed and turned by 180 degrees", lambda image: image[:, ::-1, ::-1].transpose(0, 2, 1)),
)


def _from_channels_last(image: Array) -> Array:
    channels, height, width = image.shape
    return image.reshape(height, width, channels).transpose(2, 0, 1)


def best_place(
    prediction: Array, blocks: Blocks, p: NDArray[np.float32], g: NDArray[np.float32], now: Circumstances
) -> Candidate | None:
    """Return the order, shift, flip or transposition with the least error on the blocks, if it is worth trying.

    Parameters
    ----------
    prediction
        Of the whole frame.
    p, g
        Its blocks, and those of the reference without margin, (C, entries).
    """
    rules, colours = now.protocol.rules, now.sensor is None
    low, high = rules.treatment(1.0)[:2]
    reference = g.ravel()
    power_of_g = float(reference @ reference)

    def clamped(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return values if math.isinf(high) else np.clip(values, np.float32(low), np.float32(high))

    def error(product: float, power: float) -> float:
        """Return the squared error, given <p, g> and <p, p>, as the protocol brings p to g."""
        if rules.rescaling == "none":
            return max(power - 2 * product + power_of_g, 0.0)
        return max(power_of_g - product * product / power, 0.0) if power > 0 and product > 0 else power_of_g

    def plain(values: NDArray[np.float32]) -> float:
        flat = values.ravel()
        return error(float(flat @ reference), float(flat @ flat))

    p = clamped(p)
    now_error = plain(inner_entries(p))
    found: list[tuple[float, Candidate]] = []

    def reorder(values: NDArray[np.float32], words: str, undo: Change | None) -> None:
        agreement = values @ g.T
        power = float(np.vdot(values, values))
        if undo is not None:
            found.append((error(float(np.trace(agreement)), power), Candidate(f"as if {words}", undo)))
        for order in _orders(agreement):
            product = float(agreement[np.arange(len(order)), order].sum())
            text, back = _order_words(order, colours=colours), _reordered(order)
            text = f"as if {words} and {text}" if words else f"as if {text}"
            candidate = Candidate(text, back if undo is None else _chained(undo, back))
            found.append((error(product, power), candidate))

    reorder(inner_entries(p), "", None)
    steps = range(-MARGIN, MARGIN + 1)
    unit = "pixels" if colours else "packed pixels"
    for down in steps:
        for right in steps:
            if (down, right) != (0, 0):
                words = f"as if shifted by ({down}, {right}) {unit} (down, right)"
                candidate = Candidate(words, _shifted_back(down, right), _SHIFT_GAIN_DB)
                found.append((plain(inner_entries(p, down, right)), candidate))
    if now.sensor is not None:
        found += [(plain(values), candidate) for values, candidate in _mosaic_shifts(p, now.sensor)]
    square = _SQUARE if prediction.shape[1] == prediction.shape[2] else ()
    for words, flip in (*_FLIPS, *square):
        reorder(inner_entries(clamped(blocks.cut(flip(prediction)))), words, flip)
    last = _from_channels_last(prediction)
    words = "as if reshaped from (h, w, C), not transposed"
    found.append((plain(inner_entries(clamped(blocks.cut(last)))), Candidate(words, _from_channels_last)))

    least = min(left for left, _ in found)
    if least * 10 ** (_SCREENED_GAIN_DB / 10) > now_error:
        return None
    return next(candidate for left, candidate in found if left <= _ALIKE * least)


def _mosaic_shifts(p: NDArray[np.float32], sensor: Sensor) -> Iterator[tuple[NDArray[np.float32], Candidate]]:
    """Yield the blocks moved back by a pixel of the mosaic, which changes colours too."""
    cfa = packing_sites(sensor.cfa).cfa  # as the packed area has it
    flat = p.ravel()
    for (down, right), entries in _moved_entries(cfa, p.shape).items():
        back = _shifted_back(down, right)

        def undo(image: Array, back: Change = back) -> Array:
            return pack(back(unpack(np.ascontiguousarray(image), cfa)), cfa)

        words = f"as if shifted by ({down}, {right}) pixels of the mosaic (down, right)"
        yield flat[entries], Candidate(words, undo, _SHIFT_GAIN_DB)


@lru_cache(maxsize=4)
def _moved_entries(cfa: CfaRows, shape: tuple[int, ...]) -> dict[tuple[int, int], NDArray[np.intp]]:
    """Return for each shift of the mosaic by a pixel which entries of the blocks lie without their margin then."""
    entries = np.arange(math.prod(shape), dtype=np.float64).reshape(shape[0], shape[1], -1)
    mosaic = unpack(entries, cfa)
    steps = (-1, 0, 1)
    return {
        (down, right): inner_entries(pack(np.roll(mosaic, (-down, -right), (0, 1)), cfa).reshape(shape)).astype(np.intp)
        for down in steps
        for right in steps
        if (down, right) != (0, 0)
    }
