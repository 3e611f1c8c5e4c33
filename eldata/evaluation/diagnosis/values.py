"""What mistakes make of true values: curves of gamma, levels or a missing amplification; the input's own values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.evaluation.diagnosis.places import Candidate, cell_means, inner_entries, levels_taken

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.evaluation.diagnosis.places import Blocks, Change, Circumstances

    Array: TypeAlias = NDArray[Any]

# A smaller factor cannot be told from an error of brightness, and below it every DNG's values are whole DN too.
_LEAST_RATIO = 2.0
_BINS = 48


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
    black, whites = levels_taken(now.sensor, now.protocol)
    span = whites[0] - black
    if black > 0:
        for white in whites:
            yield _line("as if black were not subtracted", span / white, black / white)
        yield _line("as if DN were divided by 65535", span / 65535, black / 65535)
        twice = black / span
        yield _CurveMistake("as if black were subtracted twice", lambda t: np.maximum(t - twice, 0), None)
    yield _scaled("as if DN were divided by 65535", span / 65535)
    for white in whites:
        if black > 0:
            yield _scaled(f"as if DN were divided by {white:g}, black included", span / white)
        yield _scaled(f"as if normalised with white level {white:g}, not {whites[0]:g}", span / (white - black))
    if now.ratio is not None and now.ratio >= _LEAST_RATIO:
        ratio = now.ratio
        yield _scaled("as if not amplified", 1 / ratio)
        yield _CurveMistake("as if amplified twice", lambda t: np.clip(t * ratio, 0, 1), None)


def best_curve(p: NDArray[np.float32], g: NDArray[np.float32], now: Circumstances) -> Candidate | None:
    """Return the mistake on whose curve the mean predictions lie, by level of the reference."""
    rescales = now.protocol.rules.rescaling != "none"
    response = _Response.of(cell_means(g))
    if len(response.levels) < _FEWEST_LEVELS:
        return None
    means, levels = response.means(cell_means(p)), response.levels
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
            after = response.apart(means, response.means(cell_means(mistake.curve(g))), _BRIGHTNESS)
        else:  # where noise is strong too, and of the reference's size
            before = response.apart(levels, means, most)
            after = response.apart(levels, response.means(cell_means(mistake.undo(p))), _BRIGHTNESS)
        if before > _LEAST_OFF and after < mistake.remains * before and (best is None or after < best[0]):
            best = after, mistake
    if best is None:
        return None
    mistake = best[1]
    return Candidate(mistake.words, None if mistake.is_large and rescales else mistake.undo)


_FEWEST_LEVELS, _FEWEST_AT_A_LEVEL = 3, 4


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


# --- the noisy input --------------------------------------------------------------------------------------------------

_LEAST_VALUES = 256
_OFF_WHOLE_DN = 0.1
_WHOLE_SHARE = 0.9
_SAME_ERRORS = 0.99


def is_copied_input(p: NDArray[np.float32], g: NDArray[np.float32], blocks: Blocks, now: Circumstances) -> bool:
    """Return whether a prediction is the noisy input, amplified: of whole DN, and with the errors of the input.

    Parameters
    ----------
    p, g
        The prediction's blocks, and those of the reference without margin, (C, entries).
    """
    if not _is_of_whole_dn(p, now):
        return False
    amplified = blocks.cut(now.amplified())
    errors: Array = np.stack([np.clip(inner_entries(image), 0, 1) - g for image in (p, amplified)]).reshape(2, -1)
    return bool(np.corrcoef(errors)[0, 1] > _SAME_ERRORS)


def _is_of_whole_dn(p: NDArray[np.float32], now: Circumstances) -> bool:
    """Return whether values, divided by the factor, are whole DN: those of the input, or a choice of them."""
    sensor, ratio = now.sensor, now.ratio
    if sensor is None or ratio is None or ratio < _LEAST_RATIO:
        return False
    values = p.ravel()
    values = values[(values > 0) & (values < 1)][: 8 * _LEAST_VALUES].astype(np.float64)
    if values.size < _LEAST_VALUES:
        return False
    black, whites = levels_taken(sensor, now.protocol)
    for white in whites:
        steps = values * ((white - black) / ratio)
        steps -= np.rint(steps)
        # The black levels of channels may differ by fractions of a DN.
        if np.mean(np.abs(steps - np.median(steps)) < _OFF_WHOLE_DN) > _WHOLE_SHARE:
            return True
    return False
