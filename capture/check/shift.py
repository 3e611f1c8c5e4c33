"""Did the camera move, or its focus? Phase correlation of tiles, and the contrast of their fine detail.

Both frames are cut into the same tiles of the luminance (:func:`capture.check.frames.luminance`), windowed and
transformed. For a shift d, measured in packed pixels, and independent noise, the spectra are
``F2(k) = B(k) F1(k) exp(-2 pi i k d) + noise``.

Shift
    The peak of the phase correlation, summed over the tiles, gives d to a packed pixel. From there each tile's d is the
    least-squares solution over the frequencies of the scene, ``min sum |F2 - F1 exp(-2 pi i k d)|^2`` (Gauss-Newton):
    each frequency counts by its power over the white noise, none is interpolated and no phase is unwrapped. The
    residual gives the noise and with it the standard error. Frequencies below 3 cycles per tile, where the window
    shows, and above 0.2 cycles per packed pixel, where aliasing shows, are left out.
Focus
    With P1, P2 the powers and C the real part of the cross power after undoing the shift, all summed over the band of
    fine detail, equal noise N in both: ``P1 = S + N, P2 = B^2 S + N, C = B S``. So ``(P1 - P2) / C = (1 - B^2) / B``,
    whatever N is, and ``B = (sqrt(q^2 + 4) - q) / 2`` with q that quotient. Standard error: jackknife over tiles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from capture.check.result import Estimate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Spectra = NDArray[np.complexfloating[Any, Any]]
    # How far the second frame lies below the first and to its right, in packed pixels; tiles where something in the
    # scene moved are left out.
    Shift = tuple[Estimate, Estimate]

_SIDES: Final = (256, 128, 64, 32)
_LEAST_TILES_A_SIDE: Final = 3  # with the largest tiles; smaller frames take smaller tiles
_MOST_TILES: Final = (4, 6)
_SHIFT_FROM, _SHIFT_UP_TO = 3.0, 0.2  # cycles per tile, cycles per packed pixel
_FOCUS_BAND: Final = (0.1, 0.4)  # cycles per packed pixel
# A Hann window's independent frequencies are fewer than the frequencies by sum(w^4) n / sum(w^2)^2 in each direction,
# w^2 being the noise's variance along the tile: (35/128) / (3/8)^2 = 1.94.
_HANN_CORRELATION: Final = (35 / 128 / (3 / 8) ** 2) ** 2
_ROUNDS: Final = 6
_FURTHEST: Final = 1.5  # packed pixels: the peak is certain to one
_WORST_ERROR: Final = 0.25  # packed pixels: a tile that is less certain has no detail to tell a shift by
_ODD_TILE_SIGMAS: Final = 6.0
_ODD_TILE_LEAST: Final = 0.5  # packed pixels


@dataclass(frozen=True, slots=True, eq=False)
class Tiles:
    """Windowed spectra of a frame's tiles, (tiles, side, side // 2 + 1), and where the tiles begin, (tiles, 2)."""

    spectra: Spectra
    starts: NDArray[np.intp]
    side: int


def shift_length(shift: Shift, pixels: tuple[int, int], scale: int) -> Estimate:
    """Return the distance between two frames, which lie ``pixels`` more apart than a shift, times ``scale``.

    Its standard error is the larger of the two.
    """
    moved = [estimate.value + whole for estimate, whole in zip(shift, pixels, strict=True)]
    return Estimate(
        scale * float(np.hypot(moved[0], moved[1])), scale * max(estimate.standard_error for estimate in shift)
    )


def make_tiles(image: NDArray[np.float32]) -> Tiles | None:
    """Return the spectra of an image's tiles; ``None`` if the frame is too small for a tile."""
    shortest = min(image.shape)
    fitting = [side for side in _SIDES if side <= shortest]
    if not fitting:
        return None
    side = next((side for side in fitting if _LEAST_TILES_A_SIDE * side <= shortest), fitting[-1])
    tops, lefts = (
        np.linspace(0, size - side, min(most, size // side)).astype(np.intp)
        for size, most in zip(image.shape, _MOST_TILES, strict=True)
    )
    starts = np.stack(np.meshgrid(tops, lefts, indexing="ij"), axis=-1).reshape(-1, 2)
    return Tiles(_cut_tiles(image, starts, side), starts, side)


def _cut_tiles(image: NDArray[np.float32], starts: NDArray[np.intp], side: int) -> Spectra:
    """Return the windowed spectra of the tiles of an image that begin at these places, without their means."""
    import scipy.fft

    tiles = np.stack([image[top : top + side, left : left + side] for top, left in starts])
    tiles -= tiles.mean(axis=(1, 2), keepdims=True)
    hann = np.hanning(side + 2)[1:-1].astype(np.float32)
    tiles *= hann[:, None] * hann
    spectra: Spectra = scipy.fft.rfft2(tiles)
    return spectra


def cut_moved_tiles(first: Tiles, image: NDArray[np.float32]) -> tuple[Tiles, Tiles, tuple[int, int]] | None:
    """Return the tiles of two frames that show the same part of the scene, and the whole pixels between them.

    The window stays where it is when the scene moves, which pulls a shift towards 0 by some percent. So the second
    frame's tiles are cut where the first's have moved to; tiles that leave the frame are left out. ``None`` if all do.
    """
    place = _find_whole_shift(first, _cut_tiles(image, first.starts, first.side))
    starts = first.starts + np.array(place)
    inside = np.all((starts >= 0) & (starts + first.side <= np.array(image.shape)), axis=1)
    if not inside.any():
        return None
    same = Tiles(first.spectra[inside], first.starts[inside], first.side)
    return same, Tiles(_cut_tiles(image, starts[inside], first.side), starts[inside], first.side), place


def _list_frequencies(side: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the frequencies of a tile's spectrum along both axes, cycles per packed pixel, to be broadcast."""
    down, right = (frequencies.astype(np.float64) for frequencies in (np.fft.fftfreq(side), np.fft.rfftfreq(side)))
    return down[:, None], right[None, :]


def _make_unshift_factors(down: NDArray[np.float64], right: NDArray[np.float64], side: int) -> Spectra:
    """Make the factors that undo each tile's shift, on the spectrum."""
    fy, fx = _list_frequencies(side)
    turns = down[:, None, None] * fy + right[:, None, None] * fx
    factors: Spectra = np.exp(2j * np.pi * turns)
    return factors


def _choose_frequencies(side: int, lowest: float, highest: float) -> NDArray[np.bool_]:
    """Choose the frequencies of a tile between two limits, cycles per packed pixel, as a mask."""
    radius = np.hypot(*_list_frequencies(side))
    return (radius >= lowest) & (radius <= highest)


def _find_whole_shift(first: Tiles, second: Spectra) -> tuple[int, int]:
    """Find the shift at the peak of all tiles' phase correlation, in whole pixels within half a tile."""
    import scipy.fft

    side = first.side
    cross = np.where(_choose_frequencies(side, _SHIFT_FROM / side, _SHIFT_UP_TO), np.conj(first.spectra) * second, 0)
    magnitude = np.abs(cross)
    # Well below the mean magnitude a frequency is mostly noise: it counts in proportion instead of fully.
    floor = magnitude.mean(axis=(1, 2), keepdims=True) / 10 + np.finfo(np.float32).tiny
    surface = scipy.fft.irfft2((cross / (magnitude + floor)).sum(axis=0), s=(side, side))
    row, column = np.unravel_index(int(np.argmax(surface)), surface.shape)
    down, right = (int((index + side // 2) % side - side // 2) for index in (row, column))
    return down, right


def measure_shift(first: Tiles, second: Tiles) -> Shift | None:
    """Measure how far the second tiles' scene lies below and to the right of the first's, within 1.5 packed pixels.

    ``None`` if no tile has enough detail. The shift between the frames is that and the pixels between the tiles.
    """
    side = first.side
    fy, fx = _list_frequencies(side)
    band = _choose_frequencies(side, _SHIFT_FROM / side, _SHIFT_UP_TO)
    cross = np.conj(first.spectra).astype(np.complex128) * second.spectra
    down = right = np.zeros(len(cross))
    wave_y, wave_x = (2 * np.pi * np.broadcast_to(axis, band.shape)[band] for axis in (fy, fx))
    # The half of the plane that a real transform stores counts twice but for its own mirror, the columns 0 and side/2.
    twice = np.broadcast_to(np.where((fx == 0) | (fx == 0.5), 1.0, 2.0), band.shape)[band]
    # One round: Im(C exp(2 pi i k d)) is about -Re(...) 2 pi k (d_true - d), linear in what is left of the shift.
    for _ in range(_ROUNDS):
        turned = (cross * _make_unshift_factors(down, right, side))[:, band]
        # Of the real part, noise has the mean 0: the information of a tile without detail is about 0, not above.
        yy, xy, xx = (turned.real @ (twice * product) for product in (wave_y**2, wave_y * wave_x, wave_x**2))
        by, bx = (-(turned.imag @ (twice * wave)) for wave in (wave_y, wave_x))
        determinant = yy * xx - xy**2
        regular = (yy > 0) & (xx > 0) & (determinant > 0)
        determinant = np.where(regular, determinant, np.inf)
        down = np.clip(down + (xx * by - xy * bx) / determinant, -_FURTHEST, _FURTHEST)
        right = np.clip(right + (yy * bx - xy * by) / determinant, -_FURTHEST, _FURTHEST)
    before = first.spectra[:, band]
    gain = (turned.real @ twice) / np.maximum(np.abs(before) ** 2 @ twice, 1e-300)  # a tile of one value tells nothing
    residual = (second.spectra * _make_unshift_factors(down, right, side))[:, band] - gain[:, None] * before
    noise = (np.abs(residual) ** 2 @ twice) / twice.sum() * _HANN_CORRELATION
    regular &= gain > 0
    information = np.where(regular, np.stack([xx, yy]), 1) / np.where(regular, determinant, 1)
    errors = np.where(regular, np.sqrt(noise / np.where(regular, gain, 1) * information), np.inf)
    return _combine_tiles(np.stack([down, right]), errors)


def _combine_tiles(values: NDArray[np.float64], errors: NDArray[np.float64]) -> Shift | None:
    """Combine the tiles' shifts into the frame's: the weighted mean of the tiles that agree with the median."""
    certain = np.all(np.isfinite(errors) & (errors > 0) & (errors < _WORST_ERROR), axis=0)
    if not certain.any():
        return None
    values, errors = values[:, certain], errors[:, certain]
    middle = np.array([_weighted_median(value, error**-2.0) for value, error in zip(values, errors, strict=True)])
    distance = np.abs(values - middle[:, None])
    odd = np.any(distance > np.maximum(_ODD_TILE_SIGMAS * errors, _ODD_TILE_LEAST), axis=0)
    if odd.all():
        return None
    weights = np.where(odd, 0, errors**-2.0)
    mean = (weights * values).sum(axis=1) / weights.sum(axis=1)
    count = int((~odd).sum())
    # Where the tiles scatter more than their errors say, the scatter counts.
    chi2 = (weights * (values - mean[:, None]) ** 2).sum(axis=1) / max(1, count - 1)
    errors = np.sqrt(np.maximum(chi2, 1) / weights.sum(axis=1))
    down, right = (Estimate(float(value), float(error)) for value, error in zip(mean, errors, strict=True))
    return down, right


def _weighted_median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Find the value that half of the total weight lies below."""
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(summed, summed[-1] / 2)])


def measure_focus(first: Tiles, second: Tiles, shift: Shift, brightness: float) -> Estimate | None:
    """Measure the second frame's contrast of fine detail over the first's.

    Parameters
    ----------
    first, second
        The frames.
    shift
        From :func:`measure_shift`.
    brightness
        Ratio of the frames' brightness, which is taken off.
    """
    side = first.side
    band = _choose_frequencies(side, *_FOCUS_BAND)
    down, right = (np.array([estimate.value]) for estimate in shift)
    undo = _make_unshift_factors(down, right, side)[0][band] / brightness
    before, after = first.spectra[:, band], second.spectra[:, band] * undo
    power_1, power_2 = (np.sum(np.abs(spectra) ** 2, axis=1, dtype=np.float64) for spectra in (before, after))
    cross = np.sum((np.conj(before) * after).real, axis=1, dtype=np.float64)
    if cross.size < 2 or cross.sum() <= 0:
        return None
    value = float(_solve_contrast((power_1 - power_2).sum(), cross.sum()))
    left_out = _solve_contrast((power_1 - power_2).sum() - (power_1 - power_2), np.maximum(cross.sum() - cross, 1e-30))
    tiles = len(left_out)
    error = np.sqrt((tiles - 1) / tiles * np.sum((left_out - left_out.mean()) ** 2))  # jackknife
    return Estimate(value, float(error))


def _solve_contrast(difference: Any, cross: Any) -> Any:
    """Solve 1/c - c = difference / cross for the contrast c, second frame over first."""
    quotient = difference / cross
    return (np.sqrt(quotient**2 + 4) - quotient) / 2
