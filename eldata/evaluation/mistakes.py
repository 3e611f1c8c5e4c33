"""The mistakes that a prediction may show on some blocks of its frame, and how each is undone.

Three kinds: the channels' order and the place of values (:func:`find_place`); curves between the true values and the
predicted ones (:func:`find_curve`); the noisy input's own values (:func:`is_copied_input`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations, product
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from eldata.raw.levels import BAYER_CHANNELS, PUBLISHED_WHITE_LEVEL_DN, pack, packing_sites, unpack, with_levels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.metrics.image_score import Score
    from eldata.protocols.protocol import Protocol
    from eldata.raw.levels import CfaRows
    from eldata.records import Sensor

    Array: TypeAlias = NDArray[Any]
    Change: TypeAlias = Callable[[Array], Array]
    Undoing: TypeAlias = tuple[str, Change | None, float]
    """A mistake in words; what undoes it on a whole frame, if anything can; the least gain in dB that shows it."""

MARGIN = 2
"""The largest shift that is tried, in packed pixels: so much lies around a block."""

GAIN_DB, SHIFT_GAIN_DB = 1.0, 0.5
"""The least gain from undoing a mistake, and from undoing a shift."""

_SIDE, _BLOCKS = 32, 8  # blocks in packed pixels: their side, their number
_SMALLEST_SIDE = 8
_CELL = 4
_GRID = (6, 8)


@dataclass(frozen=True, slots=True, eq=False)
class Circumstances:
    """The facts of a frame's evaluation that decide which mistakes are possible.

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


# --- blocks -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Blocks:
    """Where the blocks lie, by their first row and column without the margin, which is even: X-Trans repeats so."""

    places: tuple[tuple[int, int], ...]
    side: int

    @classmethod
    def of(cls, target: Array, crop: tuple[slice, ...]) -> Blocks | None:
        """Return blocks in a region: half of them where the reference has most detail, half spread over the rest."""
        (top, bottom), (left, right) = (
            (max(span.indices(size)[0], MARGIN), min(span.indices(size)[1], size - MARGIN))
            for span, size in zip(crop[1:], target.shape[1:], strict=True)
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
        grid = list(product(rows, columns))
        detail = [float(np.ptp(target[1, row + side // 2, column : column + side])) for row, column in grid]
        by_detail = sorted(range(len(grid)), key=lambda index: -detail[index])
        most, rest = by_detail[: _BLOCKS // 2], sorted(by_detail[_BLOCKS // 2 :])
        count = min(_BLOCKS - len(most), len(rest))
        spread = [rest[int((index + 0.5) * len(rest) / count)] for index in range(count)]
        return cls(tuple(grid[index] for index in (*most, *spread)), side)

    def cut(self, image: Array) -> NDArray[np.float32]:
        """Return the blocks of an image with their margin, (C, side + 4, blocks, side + 4)."""
        size = self.side + 2 * MARGIN
        corners = [(row - MARGIN, column - MARGIN) for row, column in self.places]
        parts = [image[:, top : top + size, left : left + size] for top, left in corners]
        return np.stack(parts, axis=2).astype(np.float32, copy=False)


def cut_margin(blocks: Array, down: int = 0, right: int = 0) -> Array:
    """Cut the margin off the blocks, or take the pixels so far down and right of there, (C, entries)."""
    side = blocks.shape[1] - 2 * MARGIN
    y, x = MARGIN + down, MARGIN + right
    return blocks[:, y : y + side, :, x : x + side].reshape(len(blocks), -1)


def _average_cells(blocks: Array) -> Array:
    """Return the means of the cells of 4 x 4 pixels in the blocks without their margin."""
    channels, side, count, _ = blocks.shape
    inner = blocks[:, MARGIN : side - MARGIN, :, MARGIN : side - MARGIN]
    cells = inner.shape[1] // _CELL
    parts = inner.reshape(channels, cells, _CELL, count, cells, _CELL)
    means: Array = parts.mean(axis=(2, 5), dtype=np.float32).ravel()
    return means


# --- orders of channels, shifts --------------------------------------------------------------------------------

_SCREENED_GAIN_DB = 0.5  # of the blocks alone
_ALIKE = 1.03  # errors within this factor are alike: the likelier mistake is named

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


def find_place(p: NDArray[np.float32], g: NDArray[np.float32], now: Circumstances) -> Undoing | None:
    """Return the order or shift with the least error on the blocks, if it is worth trying.

    Parameters
    ----------
    p, g
        The prediction's blocks, and those of the reference without margin, (C, entries).
    """
    rules = now.protocol.rules
    low, high = rules.treatment(1.0)[:2]
    power_of_g = float(np.vdot(g, g))

    def squared_error(product: float, power: float) -> float:
        """Return the squared error, given <p, g> and <p, p>, as the protocol brings p to g."""
        if rules.rescaling == "none":
            return max(power - 2 * product + power_of_g, 0.0)
        return max(power_of_g - product * product / power, 0.0) if power > 0 and product > 0 else power_of_g

    error_now = math.inf
    candidates: list[tuple[float, Undoing]] = []
    for words, moved, undo, least_db in _list_shifts(p, now):
        values = moved if math.isinf(high) else np.clip(moved, np.float32(low), np.float32(high))
        power = float(np.vdot(values, values))
        error = squared_error(float(np.vdot(values, g)), power)
        if undo is None:
            error_now = error
        else:
            candidates.append((error, (f"as if {words}", undo, least_db)))
        if least_db == SHIFT_GAIN_DB:
            continue
        agreement = values @ g.T
        for order in _list_orders(agreement):
            error = squared_error(float(agreement[np.arange(len(order)), order].sum()), power)
            both = " and ".join(filter(None, (words, _describe_order(order, now.sensor))))
            candidates.append((error, (f"as if {both}", _undo_order(order, undo), GAIN_DB)))
    least = min(error for error, _ in candidates)
    if least * 10 ** (_SCREENED_GAIN_DB / 10) > error_now:
        return None
    return next(undoing for error, undoing in candidates if error <= _ALIKE * least)


def _list_shifts(p: NDArray[np.float32], now: Circumstances) -> Iterator[tuple[str, Array, Change | None, float]]:
    """Yield possible shifts, likelier ones first: words, the blocks moved back, the remedy, its gain."""
    yield "", cut_margin(p), None, GAIN_DB
    steps, unit = range(-MARGIN, MARGIN + 1), "pixels" if now.sensor is None else "packed pixels"
    for down, right in product(steps, steps):
        if (down, right) != (0, 0):
            words = f"shifted by ({down}, {right}) {unit} (down, right)"
            yield words, cut_margin(p, down, right), _undo_shift(down, right), SHIFT_GAIN_DB
    if now.sensor is not None:
        cfa, flat = packing_sites(now.sensor.cfa).cfa, p.ravel()  # as the packed area has it
        for (down, right), entries in _list_mosaic_entries(cfa, p.shape).items():
            words = f"shifted by ({down}, {right}) pixels of the mosaic (down, right)"
            yield words, flat[entries], _undo_mosaic_shift(down, right, cfa), SHIFT_GAIN_DB


@lru_cache(maxsize=4)
def _list_mosaic_entries(cfa: CfaRows, shape: tuple[int, ...]) -> dict[tuple[int, int], NDArray[np.intp]]:
    """Return the entries of blocks that lie inside when the mosaic is moved by a pixel, which changes colours too."""
    mosaic = unpack(np.arange(math.prod(shape), dtype=np.float64).reshape(*shape[:2], -1), cfa)
    return {
        (down, right): cut_margin(pack(np.roll(mosaic, (-down, -right), (0, 1)), cfa).reshape(shape)).astype(np.intp)
        for down, right in product((-1, 0, 1), repeat=2)
        if (down, right) != (0, 0)
    }


def _list_orders(agreement: Array) -> Iterator[Sequence[int]]:
    """Yield orders of channels, likelier ones first: which channel of the reference lies at each place.

    Parameters
    ----------
    agreement
        (C, C): the products of each of the prediction's channels with each of the reference's.
    """
    count = len(agreement)
    usual = _USUAL_ORDERS.get(count, ())
    yield from usual
    if count <= 4:
        yield from (order for order in permutations(range(count)) if order not in (tuple(range(count)), *usual))
        return
    from scipy.optimize import linear_sum_assignment

    yield tuple(int(channel) for channel in linear_sum_assignment(agreement, maximize=True)[1])


def _describe_order(order: Sequence[int], sensor: Sensor | None) -> str:
    """Describe an order of channels in words."""
    if sensor is None:
        return f"in the order {', '.join('RGB'[channel] for channel in order)}"
    if len(order) == len(BAYER_CHANNELS):
        return f"packed {', '.join(BAYER_CHANNELS[channel] for channel in order)}"
    return f"packed in the order {', '.join(map(str, order))} of its channels"


def _undo_order(order: Sequence[int], first: Change | None) -> Change:
    """Return the function that puts channels back into order, after another change is undone."""
    back = np.argsort(np.array(order))
    return lambda image: (image if first is None else first(image))[back]


def _undo_shift(down: int, right: int) -> Change:
    """Return the function that moves an image back, mirrored at the edges, which keeps a mosaic's phase."""

    def undo(image: Array) -> Array:
        """Move an image (..., H, W) back."""
        for axis, by in ((-2, down), (-1, right)):
            last = image.shape[axis] - 1
            index = np.abs(np.arange(last + 1) + by)
            image = np.take(image, np.where(index > last, 2 * last - index, index), axis=axis)
        return image

    return undo


def _undo_mosaic_shift(down: int, right: int, cfa: CfaRows) -> Change:
    """Return the function that moves a packed image back, unpacked to its mosaic."""
    back = _undo_shift(down, right)
    return lambda image: pack(back(unpack(np.ascontiguousarray(image), cfa)), cfa)


# --- curves between true and predicted values -------------------------------------------------------------------------

# A smaller factor cannot be told from an error of brightness, and below it every DNG's values are whole DN too.
_LEAST_RATIO = 2.0
_FAR, _NEAR = 1.5, 1.05  # no error of brightness is as far from 1; any could be as near
_BRIGHTNESS = 1.18  # a factor that honest predictions may be off by, or its inverse
_EXACT = 1.015  # how exactly a factor that could be an error of brightness has to be met
_LEAST_OFF = 0.005  # of full scale: a smaller departure explains nothing
_COARSE = 0.6  # share of the departure that may remain from the curve, before the mistake is undone
_REMAINS, _OFFSET_REMAINS = 0.3, 0.22  # and after: the shadows of clipped inputs are lifted too
_BINS, _FEWEST_LEVELS, _FEWEST_AT_A_LEVEL = 48, 3, 4


@dataclass(frozen=True, slots=True, eq=False)
class _Curve:
    """A curve that a mistake puts between the true values and the predicted ones.

    ``undo`` is ``None`` where nothing can; ``scale``: it is only this factor; ``remains``: the share of the departure
    from the reference that may remain.
    """

    words: str
    curve: Change
    undo: Change | None
    scale: float | None = None
    remains: float = _REMAINS

    def is_scale_within(self, factor: float) -> bool:
        """Whether the curve is a mere factor, nearer to 1 than this one."""
        return self.scale is not None and 1 / factor < self.scale < factor


def _encode_srgb(linear: Array) -> Array:
    """Apply the sRGB transfer curve to linear values."""
    linear = np.clip(linear, 0, None)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _decode_srgb(encoded: Array) -> Array:
    """Linearise values that have the sRGB transfer curve."""
    encoded = np.clip(encoded, 0, None)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _make_power(exponent: float) -> Change:
    """Make the function that raises values to an exponent."""
    return lambda values: np.clip(values, 0, None) ** exponent


def _make_line(words: str, slope: float, offset: float) -> _Curve:
    """Make the curve of a line, with the inverse that undoes it."""
    back, start = 1 / slope, -offset / slope
    return _Curve(words, lambda t: slope * t + offset, lambda p: back * p + start, remains=_OFFSET_REMAINS)


def _make_factor(words: str, scale: float) -> _Curve:
    """Make the curve of a mere factor, with the inverse that undoes it."""
    return _Curve(words, lambda t: scale * t, lambda p: 1 / scale * p, scale)


def _find_levels(now: Circumstances, sensor: Sensor) -> tuple[float, tuple[float, ...]]:
    """Return black and white in DN, as the protocol has them; after the white those that may be taken instead."""
    levels = now.protocol.levels
    leveled = with_levels(sensor, "metadata" if levels == "metadata-per-channel" else levels)
    whites = dict.fromkeys((leveled.white_level_dn, sensor.white_level_dn, PUBLISHED_WHITE_LEVEL_DN))
    return float(np.mean(leveled.black_level_dn)), tuple(whites)


def _list_curves(now: Circumstances) -> Iterator[_Curve]:
    """Yield the curves to try, likelier ones first."""
    encoded, again = "as if encoded for a screen (gamma)", "as if made linear once more (gamma)"
    yield _Curve(encoded, _encode_srgb, _decode_srgb)
    yield _Curve(encoded, _make_power(1 / 2.2), _make_power(2.2))
    yield _Curve(again, _decode_srgb, _encode_srgb)
    yield _Curve(again, _make_power(2.2), _make_power(1 / 2.2))
    yield _make_line("as if inverted (1 - value)", -1, 1)
    yield _make_line("as if in [-1, 1], not in [0, 1]", 2, -1)
    if now.sensor is None:
        return
    black, whites = _find_levels(now, now.sensor)
    span = whites[0] - black
    if black > 0:
        for white in whites:
            yield _make_line("as if black were not subtracted", span / white, black / white)
        yield _make_line("as if DN were divided by 65535", span / 65535, black / 65535)
        twice = black / span
        yield _Curve("as if black were subtracted twice", lambda t: np.maximum(t - twice, 0), None)
    yield _make_factor("as if DN were divided by 65535", span / 65535)
    for white in whites:
        if black > 0:
            yield _make_factor(f"as if DN were divided by {white:g}, black included", span / white)
        yield _make_factor(f"as if normalised with white level {white:g}, not {whites[0]:g}", span / (white - black))
    if now.ratio is not None and now.ratio >= _LEAST_RATIO:
        ratio = now.ratio
        yield _make_factor("as if not amplified", 1 / ratio)
        yield _Curve("as if amplified twice", lambda t: np.clip(t * ratio, 0, 1), None)


def find_curve(p: NDArray[np.float32], g: NDArray[np.float32], now: Circumstances) -> Undoing | None:
    """Return the mistake on whose curve the mean predictions lie, by level of the reference."""
    rescales = now.protocol.rules.rescaling != "none"
    response = _Response(_average_cells(g))
    levels, means = response.levels, response.means(_average_cells(p))
    if len(levels) < _FEWEST_LEVELS:
        return None
    best: tuple[float, Undoing] | None = None
    for mistake in _list_curves(now):
        is_large = mistake.scale is not None and not mistake.is_scale_within(_FAR)
        if mistake.scale is not None and not is_large:
            off = response.factor(means, levels) / mistake.scale
            if mistake.is_scale_within(_NEAR) or rescales or not 1 / _EXACT < off < _EXACT:
                continue
        # The factor between prediction and reference: the protocol's, an error of brightness, or none.
        most = _BRIGHTNESS if is_large else math.inf if rescales else 1.0
        before = response.distance(means, levels, most)
        if response.distance(means, mistake.curve(levels), _BRIGHTNESS) > _COARSE * before:
            continue
        if mistake.undo is None:  # exact where the curve is bent within a cell
            after = response.distance(means, response.means(_average_cells(mistake.curve(g))), _BRIGHTNESS)
        else:  # where noise is strong too, and of the reference's size
            before = response.distance(levels, means, most)
            after = response.distance(levels, response.means(_average_cells(mistake.undo(p))), _BRIGHTNESS)
        if before > _LEAST_OFF and after < mistake.remains * before and (best is None or after < best[0]):
            best = after, (mistake.words, None if is_large and rescales else mistake.undo, GAIN_DB)
    return None if best is None else best[1]


class _Response:
    """The reference's levels, and what a prediction is there in the mean, where neither its noise nor its blur shows.

    Levels are means of cells, and finer in the dark. The weight of each is the root of its cells' number, so that what
    is bright counts in dark scenes too.
    """

    def __init__(self, g: NDArray[np.float32]) -> None:
        self._bins = (np.sqrt(np.clip(g, 0, 1)) * np.float32(_BINS)).astype(np.intp)  # what is saturated comes last
        counts = np.bincount(self._bins, minlength=_BINS + 1)[:_BINS]
        self._used = counts >= _FEWEST_AT_A_LEVEL
        self._counts = counts[self._used]
        self._weights = np.sqrt(self._counts) / np.sqrt(self._counts).sum()
        self.levels = self.means(g)

    def means(self, p: Array) -> Array:
        """Return the mean of a prediction's cells at each level."""
        return np.bincount(self._bins, p, _BINS + 1)[:_BINS][self._used] / self._counts

    def factor(self, means: Array, curve: Array) -> float:
        """Return the factor that brings a curve nearest to means."""
        power = float((self._weights * curve**2).sum())
        return float((self._weights * curve * means).sum()) / power if power > 0 else 1.0

    def distance(self, means: Array, curve: Array, most: float) -> float:
        """Return the root mean square distance between means and a curve, times a factor of up to ``most``."""
        factor = min(max(self.factor(means, curve), 1 / most), most)
        return math.sqrt(float((self._weights * (means - factor * curve) ** 2).sum()))


# --- the noisy input --------------------------------------------------------------------------------------------------

_LEAST_VALUES = 256
_OFF_WHOLE_DN = 0.1
_WHOLE_SHARE = 0.9
_SAME_ERRORS = 0.99


def is_copied_input(p: NDArray[np.float32], g: NDArray[np.float32], blocks: Blocks, now: Circumstances) -> bool:
    """Recognise the amplified noisy input: values are whole DN, and errors are the input's.

    Parameters
    ----------
    p, g
        The prediction's blocks, and those of the reference without margin, (C, entries).
    """
    if not _is_of_whole_dn(p, now):
        return False
    amplified = blocks.cut(now.amplified())
    errors: Array = np.stack([np.clip(cut_margin(image), 0, 1) - g for image in (p, amplified)]).reshape(2, -1)
    return bool(np.corrcoef(errors)[0, 1] > _SAME_ERRORS)


def _is_of_whole_dn(p: NDArray[np.float32], now: Circumstances) -> bool:
    """Check whether values divided by the factor are whole DN, before a noisy file is read."""
    if now.sensor is None or now.ratio is None or now.ratio < _LEAST_RATIO:
        return False
    values = p[(p > 0) & (p < 1)][: 8 * _LEAST_VALUES].astype(np.float64)
    if values.size < _LEAST_VALUES:
        return False
    black, whites = _find_levels(now, now.sensor)
    for white in whites:
        steps = values * ((white - black) / now.ratio)
        steps -= np.rint(steps)
        # The black levels of channels may differ by fractions of a DN.
        if np.mean(np.abs(steps - np.median(steps)) < _OFF_WHOLE_DN) > _WHOLE_SHARE:
            return True
    return False
