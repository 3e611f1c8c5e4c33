"""What is wrong with a prediction, as far as its reference shows: a mistake that, undone, would raise its score.

A few frames of each camera and factor are looked at (:func:`chosen_frames`). On some blocks of each, the orders of
channels, shifts, flips and curves that mistakes leave behind are tried (:func:`mistake_in`); what stands out there is
undone on the whole frame and scored as the protocol does. What most frames show alike is a suspicion
(:func:`suspicions_of`).

A prediction that is merely poor is not to be accused. So a mistake has to be worth at least a decibel (a shift half of
one), most frames have to show the same one, and a curve has to be the mistake's own: the mean prediction at each level
of the reference lies on it, which neither noise nor the lifted shadows of clipped inputs do.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.evaluation.scores import mean
from eldata.raw.cfa import BAYER_CHANNELS, XTRANS_CFA, pack, unpack
from eldata.raw.levels import PUBLISHED_WHITE_LEVEL_DN, with_levels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.metrics.image_score import Score
    from eldata.protocols.protocol import Protocol
    from eldata.raw.cfa import CfaRows
    from eldata.records import Sensor

    Array: TypeAlias = NDArray[Any]
    Change: TypeAlias = Callable[[Array], Array]

EACH, MOST_FACTORS = 3, 4
"""How many frames of a camera and factor are looked at, and as many times of a camera with more factors."""

_SHARE = 2 / 3  # of the frames looked at that have to show the same mistake

_SIDE, _MARGIN, _BLOCKS = 32, 2, 8  # blocks in packed pixels: their side, the largest shift, their number
_SMALLEST_SIDE = 8
_CELL = 4
_GRID = (6, 8)

_GAIN_DB = 1.0  # what a mistake is worth at least
_SHIFT_GAIN_DB = 0.5
_SCREENED_GAIN_DB = 0.5  # of the blocks alone
_ALIKE = 1.03  # errors within this factor are alike: the likelier mistake is named

_BINS = 48


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake that would explain the score of one prediction.

    Attributes
    ----------
    words
        What it is: ``as if packed R, G1, G2, B``.
    psnr_db, without_db
        The score, and that with the mistake undone; ``None`` if it cannot be, or the score does not show it.
    """

    words: str
    psnr_db: float
    without_db: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """A frame whose prediction was looked at.

    Attributes
    ----------
    path, camera, ratio
        Of its pair.
    psnr_db
        What it scored.
    mistake
        What it shows by itself, if anything.
    prediction, reference
        Both in a few hundred values (:func:`sketch`): a prediction of another frame shows among the others.
    """

    path: str
    camera: str
    ratio: float | None
    psnr_db: float
    mistake: Mistake | None
    prediction: NDArray[np.float32]
    reference: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A mistake that most of the predictions looked at show.

    Attributes
    ----------
    words
        What it is.
    where
        The camera, or camera and factor, that it is limited to; empty: all.
    shown, looked
        How many predictions show it, of how many looked at there.
    psnr_db, without_db
        Means over those that show it: the score, and that with the mistake undone, if known.
    example
        The noisy frame of one of them.
    """

    words: str
    where: str
    shown: int
    looked: int
    psnr_db: float
    without_db: float | None
    example: str

    def __str__(self) -> str:
        where = f"{self.where}: " if self.where else ""
        score = f"{self.psnr_db:.2f} dB"
        if self.without_db is not None:
            score += f" becomes {self.without_db:.2f}"
        return f"SUSPECT: {where}{self.words}: {score} in {self.shown} of {self.looked} looked at"


# --- which frames, and what they say together -------------------------------------------------------------------------

_GOLDEN = (math.sqrt(5) - 1) / 2


def chosen_frames(frames: Iterable[tuple[str, str, float | None, float]]) -> frozenset[str]:
    """Return the paths of the frames to look at: up to :data:`EACH` of each camera and factor, spread over ISOs.

    Of a camera with more than :data:`MOST_FACTORS` factors they are spread over these too, and as many as of so many.

    Parameters
    ----------
    frames
        Path, camera, factor and ISO of each.
    """
    cameras: dict[str, dict[float, list[tuple[float, str]]]] = defaultdict(lambda: defaultdict(list))
    for path, camera, ratio, iso in frames:
        cameras[camera][ratio or 0.0].append((iso, path))
    parts: list[tuple[list[tuple[float, str]], int]] = []
    for camera in sorted(cameras):
        groups = [sorted(cameras[camera][ratio]) for ratio in sorted(cameras[camera])]
        if len(groups) <= MOST_FACTORS:
            parts += [(members, EACH) for members in groups]
        else:
            parts.append(([member for members in groups for member in members], EACH * MOST_FACTORS))
    return frozenset(path for turn, (members, most) in enumerate(parts) for path in _spread(members, most, turn))


def _spread(members: Sequence[tuple[float, str]], most: int, turn: int) -> Iterator[str]:
    """Yield paths from all over a list, others each turn and not at equal distances: there the scenes repeat."""
    count = min(most, len(members))
    for index in range(count):
        part = (turn + index + 0.5) * _GOLDEN % 1
        yield members[int((index + part) / count * len(members))][1]


def suspicions_of(inspections: Sequence[Inspection]) -> tuple[Suspicion, ...]:
    """Return the mistakes that most frames show alike: of all, else of a camera, else of a camera and factor.

    A prediction of another frame is a mistake wherever it occurs.
    """
    found = _exchanged(inspections)
    least = min(2, len(inspections))
    shared = _shared(inspections, "", least)
    if shared is not None:
        return (*found, shared)
    for camera, of in _grouped(inspections, lambda one: one.camera).items():
        shared = _shared(of, camera, least)
        if shared is not None:
            found.append(shared)
            continue
        for ratio, those in _grouped(of, lambda one: one.ratio).items():
            shared = _shared(those, camera if ratio is None else f"{camera} x{ratio:g}", least)
            if shared is not None:
                found.append(shared)
    return tuple(found)


def sketch(image: Array) -> NDArray[np.float32]:
    """Return the means over channels at the points of a grid, clipped to [0, 1], with mean 0 and length 1.

    Parameters
    ----------
    image
        (C, h, w).
    """
    rows, columns = (
        np.linspace(0, size - 1, count).astype(int) for size, count in zip(image.shape[1:], _SKETCH, strict=True)
    )
    points = np.clip(image[:, rows[:, None], columns], 0, 1)
    values: NDArray[np.float32] = points.mean(axis=0, dtype=np.float32).ravel()
    values -= values.mean()
    length = np.float32(np.linalg.norm(values))
    if length > 0:
        values /= length
    return values


_SKETCH = (24, 36)
_LIKE, _LIKER = 0.7, 0.3  # the correlation with another reference, at least, and by how much it is the higher one


def _exchanged(inspections: Sequence[Inspection]) -> list[Suspicion]:
    """Return the suspicion that predictions are those of other frames, if some are like another one's reference."""
    references = np.stack([one.reference for one in inspections]) if inspections else np.empty((0, 0))
    found = []
    for one in inspections:
        likeness = references @ one.prediction
        other = int(likeness.argmax())
        if likeness[other] >= max(_LIKE, float(one.reference @ one.prediction) + _LIKER):
            found.append((one, inspections[other]))
    if not found:
        return []
    first, its = found[0]
    words = f"as if of another frame: that of {first.path} is like the reference of {its.path}"
    score = mean([one.psnr_db for one, _ in found])
    return [Suspicion(words, "", len(found), len(inspections), score, None, first.path)]


def _grouped(inspections: Sequence[Inspection], key: Callable[[Inspection], Any]) -> dict[Any, list[Inspection]]:
    groups: dict[Any, list[Inspection]] = defaultdict(list)
    for one in inspections:
        groups[key(one)].append(one)
    return groups


def _shared(inspections: Sequence[Inspection], where: str, least: int) -> Suspicion | None:
    """Return the mistake that most of these frames show, if there is one."""
    showing: dict[str, list[tuple[str, Mistake]]] = defaultdict(list)
    for one in inspections:
        if one.mistake is not None:
            showing[one.mistake.words].append((one.path, one.mistake))
    words, most = max(showing.items(), key=lambda item: len(item[1]), default=("", []))
    if not most or len(most) < max(_SHARE * len(inspections), least):
        return None
    without = [mistake.without_db for _, mistake in most if mistake.without_db is not None]
    return Suspicion(
        words=words,
        where=where,
        shown=len(most),
        looked=len(inspections),
        psnr_db=mean([mistake.psnr_db for _, mistake in most]),
        without_db=mean(without) if len(without) == len(most) else None,
        example=most[0][0],
    )


# --- one frame --------------------------------------------------------------------------------------------------------


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


def mistake_in(prediction: Array, target: Array, psnr_db: float, now: Circumstances) -> Mistake | None:
    """Return the mistake that would explain the score of a prediction, if there is one that stands out.

    Parameters
    ----------
    prediction, target
        (C, h, w) of the whole frame; the prediction as it was loaded.
    psnr_db
        What it scored.
    now
        How it was scored.
    """
    if math.isinf(psnr_db) or math.isnan(psnr_db):
        return None
    blocks = _Blocks.of(target, now.protocol.crop(target.shape))
    if blocks is None:
        return None
    p, g = blocks.cut(prediction), blocks.cut(target)
    inner = _inner(g)
    if float(inner.max()) - float(inner.min()) < 1e-6:  # nothing to tell by
        return None
    if float(p.max()) == float(p.min()) and float(prediction.max()) == float(prediction.min()):
        return Mistake(f"every value is {float(p.flat[0]):.4g}", psnr_db)
    if _is_of_whole_dn(p, now) and _is_input(_inner(p), inner, _inner(blocks.cut(now.amplified()))):
        return Mistake("as if the noisy input, amplified, were copied", psnr_db)
    found: list[tuple[float, Mistake]] = []
    for candidate in (_best_curve(p, g, now), _best_place(prediction, blocks, p, inner, now)):
        if candidate is None:
            continue
        if candidate.undo is None:
            found.append((_GAIN_DB, Mistake(candidate.words, psnr_db)))
            continue
        undone = np.ascontiguousarray(candidate.undo(prediction), prediction.dtype)
        without_db = now.score(undone).psnr_db
        if without_db - psnr_db >= candidate.least_db:
            found.append((without_db - psnr_db, Mistake(candidate.words, psnr_db, without_db)))
    return max(found, key=lambda one: one[0])[1] if found else None


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """A mistake that may have been made, and how it is undone on a whole frame.

    ``undo`` is ``None`` where nothing can, or where the protocol's factor does it already.
    """

    words: str
    undo: Change | None
    least_db: float = _GAIN_DB


# --- blocks of a frame ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Where the blocks lie, by their first row and column without the margin, which is even: X-Trans repeats so."""

    places: tuple[tuple[int, int], ...]
    side: int

    @classmethod
    def of(cls, target: Array, crop: tuple[slice, ...]) -> _Blocks | None:
        """Return blocks in a region: half of them where the reference has most detail, half spread over the rest."""
        height, width = target.shape[1:]
        (top, bottom), (left, right) = (
            (max(span.indices(size)[0], _MARGIN), min(span.indices(size)[1], size - _MARGIN))
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
        side = self.side + 2 * _MARGIN
        found = np.empty((image.shape[0], side, len(self.places), side), np.float32)
        for index, (row, column) in enumerate(self.places):
            y, x = row - _MARGIN, column - _MARGIN
            found[:, :, index] = image[:, y : y + side, x : x + side]
        return found


def _inner(blocks: Array, down: int = 0, right: int = 0) -> Array:
    """Return the blocks without their margin, or what lies so far from there, (C, entries)."""
    side = blocks.shape[1] - 2 * _MARGIN
    y, x = _MARGIN + down, _MARGIN + right
    return blocks[:, y : y + side, :, x : x + side].reshape(len(blocks), -1)


def _cells(blocks: Array) -> Array:
    """Return the means of the cells of 4 x 4 pixels in the blocks without their margin."""
    channels, side, count, _ = blocks.shape
    inner = blocks[:, _MARGIN : side - _MARGIN, :, _MARGIN : side - _MARGIN]
    cells = inner.shape[1] // _CELL
    parts: Array = inner.reshape(channels, cells, _CELL, count, cells, _CELL)
    means: Array = parts.mean(axis=(2, 5), dtype=np.float32).ravel()
    return means


# --- the noisy input --------------------------------------------------------------------------------------------------

_LEAST_RATIO = 2.0  # below it every DNG's values are whole DN too
_LEAST_VALUES = 256
_OFF_WHOLE_DN = 0.1
_WHOLE_SHARE = 0.9
_SAME_ERRORS = 0.99


def _is_of_whole_dn(p: NDArray[np.float32], now: Circumstances) -> bool:
    """Return whether values, divided by the factor, are whole DN: those of the input, or a choice of them."""
    sensor, ratio = now.sensor, now.ratio
    if sensor is None or ratio is None or ratio < _LEAST_RATIO:
        return False
    values = p.ravel()
    values = values[(values > 0) & (values < 1)][: 8 * _LEAST_VALUES].astype(np.float64)
    if values.size < _LEAST_VALUES:
        return False
    levels = _Levels.of(sensor, now.protocol)
    for white in levels.whites:
        steps = values * ((white - levels.black) / ratio)
        steps -= np.rint(steps)
        # The black levels of channels may differ by fractions of a DN.
        if np.mean(np.abs(steps - np.median(steps)) < _OFF_WHOLE_DN) > _WHOLE_SHARE:
            return True
    return False


def _is_input(p: NDArray[np.float32], g: NDArray[np.float32], amplified: NDArray[np.float32]) -> bool:
    """Return whether a prediction errs as the input does."""
    errors = np.stack([np.clip(image, 0, 1) - g for image in (p, amplified)]).reshape(2, -1)
    return bool(np.corrcoef(errors)[0, 1] > _SAME_ERRORS)


# --- curves -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Levels:
    """Black and white level of a protocol, and the white levels that may be taken instead."""

    black: float
    white: float
    whites: tuple[float, ...]

    @classmethod
    def of(cls, sensor: Sensor, protocol: Protocol) -> _Levels:
        levels = protocol.levels
        leveled = with_levels(sensor, "metadata" if levels == "metadata-per-channel" else levels)
        black = float(np.mean(leveled.black_level_dn))
        white = leveled.white_level_dn
        return cls(black, white, tuple(dict.fromkeys((white, sensor.white_level_dn, PUBLISHED_WHITE_LEVEL_DN))))


@dataclass(frozen=True, slots=True, eq=False)
class _CurveMistake:
    """A curve that a mistake puts between the true values and the predicted ones.

    ``undo`` is ``None`` where nothing can; ``scale``: it is only this factor; ``remains``: the share of the departure
    from the reference that may remain.
    """

    words: str
    curve: Change
    undo: Change | None
    scale: float | None = None
    remains: float = 0.3

    @property
    def is_large(self) -> bool:
        """Whether it is a factor that no error of brightness is."""
        return self.scale is not None and not 1 / _FAR < self.scale < _FAR

    @property
    def is_small(self) -> bool:
        """Whether it is a factor that any error of brightness could be."""
        return self.scale is not None and 1 / _NEAR < self.scale < _NEAR


_FAR, _NEAR = 1.5, 1.05
_BRIGHTNESS = 1.18  # a factor that honest predictions may be off by, or its inverse
_EXACT = 1.015  # how exactly a factor that could be an error of brightness has to be met
_LEAST_OFF = 0.005  # of full scale: a smaller departure explains nothing
_COARSE = 0.6  # share of the departure that may remain from the curve, before the mistake is undone
_OFFSET_REMAINS = 0.22  # the shadows of clipped inputs are lifted too


def _srgb_encode(linear: Array) -> Array:
    linear = np.clip(linear, 0, None)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _srgb_decode(encoded: Array) -> Array:
    encoded = np.clip(encoded, 0, None)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _power(exponent: float) -> Change:
    return lambda values: np.clip(values, 0, None) ** exponent


def _affine(slope: float, offset: float) -> Change:
    return lambda values: slope * values + offset


def _line(words: str, slope: float, offset: float) -> _CurveMistake:
    undo = _affine(1 / slope, -offset / slope)
    return _CurveMistake(words, _affine(slope, offset), undo, remains=_OFFSET_REMAINS)


def _scaled(words: str, scale: float) -> _CurveMistake:
    return _CurveMistake(words, _affine(scale, 0), _affine(1 / scale, 0), scale)


def _curve_mistakes(now: Circumstances) -> Iterator[_CurveMistake]:
    """Yield the curves to try, likelier ones first."""
    encoded, again = "as if encoded for a screen (gamma)", "as if made linear once more (gamma)"
    yield _CurveMistake(encoded, _srgb_encode, _srgb_decode)
    yield _CurveMistake(encoded, _power(1 / 2.2), _power(2.2))
    yield _CurveMistake(again, _srgb_decode, _srgb_encode)
    yield _CurveMistake(again, _power(2.2), _power(1 / 2.2))
    yield _line("as if inverted (1 - value)", -1, 1)
    yield _line("as if in [-1, 1], not in [0, 1]", 2, -1)
    if now.sensor is None:
        return
    levels = _Levels.of(now.sensor, now.protocol)
    black, span = levels.black, levels.white - levels.black
    if black > 0:
        for white in levels.whites:
            yield _line("as if black were not subtracted", span / white, black / white)
        yield _line("as if DN were divided by 65535", span / 65535, black / 65535)
        twice = black / span
        yield _CurveMistake("as if black were subtracted twice", lambda t: np.maximum(t - twice, 0), None)
    yield _scaled("as if DN were divided by 65535", span / 65535)
    for white in levels.whites:
        if black > 0:
            yield _scaled(f"as if DN were divided by {white:g}, black included", span / white)
        yield _scaled(f"as if normalised with white level {white:g}, not {levels.white:g}", span / (white - black))
    if now.ratio is not None and now.ratio >= _LEAST_RATIO:
        ratio = now.ratio
        yield _scaled("as if not amplified", 1 / ratio)
        yield _CurveMistake("as if amplified twice", lambda t: np.clip(t * ratio, 0, 1), None)


def _best_curve(p: NDArray[np.float32], g: NDArray[np.float32], now: Circumstances) -> _Candidate | None:
    """Return the mistake on whose curve the mean predictions lie, by level of the reference."""
    rescales = now.protocol.rules.rescaling != "none"
    response = _Response.of(_cells(g))
    if len(response.levels) < _FEWEST_LEVELS:
        return None
    means, levels = response.means(_cells(p)), response.levels
    best: tuple[float, _CurveMistake] | None = None
    for mistake in _curve_mistakes(now):
        if mistake.scale is not None and not mistake.is_large:
            off = response.factor(means, levels) / mistake.scale
            if mistake.is_small or rescales or not 1 / _EXACT < off < _EXACT:
                continue
        # The factor between prediction and reference: the protocol's, an error of brightness, or none.
        most = _BRIGHTNESS if mistake.is_large else math.inf if rescales else 1.0
        before = response.apart(means, levels, most)
        after = response.apart(means, mistake.curve(levels), _BRIGHTNESS)
        if after > _COARSE * before:
            continue
        if mistake.undo is None:  # exact where the curve is bent within a cell
            after = response.apart(means, response.means(_cells(mistake.curve(g))), _BRIGHTNESS)
        else:  # where noise is strong too, and of the reference's size
            before = response.apart(levels, means, most)
            after = response.apart(levels, response.means(_cells(mistake.undo(p))), _BRIGHTNESS)
        if before > _LEAST_OFF and after < mistake.remains * before and (best is None or after < best[0]):
            best = after, mistake
    if best is None:
        return None
    mistake = best[1]
    return _Candidate(mistake.words, None if mistake.is_large and rescales else mistake.undo)


_FEWEST_LEVELS = 3
_FEWEST_AT_A_LEVEL = 4


@dataclass(frozen=True, slots=True, eq=False)
class _Response:
    """The reference's levels; what a prediction is there in the mean, where neither its noise nor its blur shows.

    Levels are those of cells, and finer in the dark. The weight of each is the root of its cells' number, so that what
    is bright counts in dark scenes too.
    """

    index: NDArray[np.intp]
    there: NDArray[np.bool_]
    counts: Array
    weights: Array
    levels: Array

    @classmethod
    def of(cls, g: NDArray[np.float32]) -> _Response:
        index = (np.sqrt(np.clip(g, 0, 1)) * np.float32(_BINS)).astype(np.intp)  # what is saturated comes last
        counts = np.bincount(index, minlength=_BINS + 1)[:_BINS]
        there = counts >= _FEWEST_AT_A_LEVEL
        levels = np.bincount(index, g, _BINS + 1)[:_BINS][there] / counts[there]
        weights = np.sqrt(counts[there])
        return cls(index, there, counts[there], weights / weights.sum(), levels)

    def means(self, p: Array) -> Array:
        """Return the mean of a prediction's cells at each level."""
        return np.bincount(self.index, p, _BINS + 1)[:_BINS][self.there] / self.counts

    def factor(self, means: Array, curve: Array) -> float:
        """Return the factor that brings a curve nearest to means."""
        power = float((self.weights * curve**2).sum())
        return float((self.weights * curve * means).sum()) / power if power > 0 else 1.0

    def apart(self, means: Array, curve: Array, most: float) -> float:
        """Return the root mean square of what is left between means and a curve, times a factor of up to ``most``."""
        factor = min(max(self.factor(means, curve), 1 / most), most)
        return math.sqrt(float((self.weights * (means - factor * curve) ** 2).sum()))


# --- where values lie -------------------------------------------------------------------------------------------------

_COLOURS = ("R", "G", "B")

# What codes that take a 2x2 cell of another phase for R, G, B, G make of it, row by row or around the cell, and R and B
# exchanged: by the place in the prediction, the channel that lies there.
_USUAL_ORDERS = {
    4: (
        *((0, 1, 3, 2), (2, 1, 0, 3), (2, 3, 0, 1), (2, 3, 1, 0)),
        *((1, 0, 3, 2), (1, 0, 2, 3), (3, 2, 1, 0), (3, 2, 0, 1)),
    ),
    9: ((2, 1, 0, 4, 3, 5, 6, 7, 8),),
    3: ((2, 1, 0),),
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


def _best_place(
    prediction: Array, blocks: _Blocks, p: NDArray[np.float32], g: NDArray[np.float32], now: Circumstances
) -> _Candidate | None:
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
    now_error = plain(_inner(p))
    found: list[tuple[float, _Candidate]] = []

    def reorder(values: NDArray[np.float32], words: str, undo: Change | None) -> None:
        agreement = values @ g.T
        power = float(np.vdot(values, values))
        if undo is not None:
            found.append((error(float(np.trace(agreement)), power), _Candidate(f"as if {words}", undo)))
        for order in _orders(agreement):
            product = float(agreement[np.arange(len(order)), order].sum())
            text, back = _order_words(order, colours=colours), _reordered(order)
            text = f"as if {words} and {text}" if words else f"as if {text}"
            candidate = _Candidate(text, back if undo is None else _chained(undo, back))
            found.append((error(product, power), candidate))

    reorder(_inner(p), "", None)
    steps = range(-_MARGIN, _MARGIN + 1)
    unit = "pixels" if colours else "packed pixels"
    for down in steps:
        for right in steps:
            if (down, right) != (0, 0):
                words = f"as if shifted by ({down}, {right}) {unit} (down, right)"
                candidate = _Candidate(words, _shifted_back(down, right), _SHIFT_GAIN_DB)
                found.append((plain(_inner(p, down, right)), candidate))
    if now.sensor is not None:
        found += [(plain(values), candidate) for values, candidate in _mosaic_shifts(p, now.sensor)]
    square = _SQUARE if prediction.shape[1] == prediction.shape[2] else ()
    for words, flip in (*_FLIPS, *square):
        reorder(_inner(clamped(blocks.cut(flip(prediction)))), words, flip)
    last = _from_channels_last(prediction)
    words = "as if reshaped from (h, w, C), not transposed"
    found.append((plain(_inner(clamped(blocks.cut(last)))), _Candidate(words, _from_channels_last)))

    least = min(left for left, _ in found)
    if least * 10 ** (_SCREENED_GAIN_DB / 10) > now_error:
        return None
    return next(candidate for left, candidate in found if left <= _ALIKE * least)


def _mosaic_shifts(p: NDArray[np.float32], sensor: Sensor) -> Iterator[tuple[NDArray[np.float32], _Candidate]]:
    """Yield the blocks moved back by a pixel of the mosaic, which changes colours too."""
    cfa = XTRANS_CFA if len(sensor.cfa) == len(XTRANS_CFA) else sensor.cfa  # the packed area begins with its pattern
    flat = p.ravel()
    for (down, right), entries in _moved_entries(cfa, p.shape).items():
        back = _shifted_back(down, right)

        def undo(image: Array, back: Change = back) -> Array:
            return pack(back(unpack(np.ascontiguousarray(image), cfa)), cfa)

        words = f"as if shifted by ({down}, {right}) pixels of the mosaic (down, right)"
        yield flat[entries], _Candidate(words, undo, _SHIFT_GAIN_DB)


@lru_cache(maxsize=4)
def _moved_entries(cfa: CfaRows, shape: tuple[int, ...]) -> dict[tuple[int, int], NDArray[np.intp]]:
    """Return for each shift of the mosaic by a pixel which entries of the blocks lie without their margin then."""
    entries = np.arange(math.prod(shape), dtype=np.float64).reshape(shape[0], shape[1], -1)
    mosaic = unpack(entries, cfa)
    steps = (-1, 0, 1)
    return {
        (down, right): _inner(pack(np.roll(mosaic, (-down, -right), (0, 1)), cfa).reshape(shape)).astype(np.intp)
        for down in steps
        for right in steps
        if (down, right) != (0, 0)
    }
