"""How far does a noisy frame lie from its reference? One shift for all tiles, fitted by least squares.

As in :mod:`capture.check.shift`, for a shift d of packed pixels, ``F2(k) = g F1(k) exp(-2 pi i k d) + noise``, but no
tile of a dark frame tells d alone: gain g and shift are common to all tiles (Lucas and Kanade's fit, in frequencies),
and a tile counts by the inverse of its own noise, which the residual gives. Frequencies along rows and columns, where
row noise and banding stand, are left out.

The whole pixels come from the peak of the plain correlation, which is the likeliest place under white noise. Where that
peak is not well above what noise alone gives, nothing is said of the shift: texture or light is too weak.

What is left of the noisy frame after its reference is noise, and a sensor's is white but for rows and columns: as
strong at 0.35 to 0.5 cycles per packed pixel as at 0.15 to 0.3. Noise reduction and filters against stars take the
finer part. Standard error: jackknife over tiles.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from capture.check.measures import Estimate
from capture.check.shift import (
    HANN_CORRELATION,
    Shift,
    Tiles,
    counted_twice,
    cut_tiles,
    find_peak,
    frequencies,
    jackknife_error,
    moved_starts,
    on_lines,
    shift_band,
    unshift,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_ROUNDS: Final = 8
_FURTHEST: Final = 1.5  # packed pixels: the peak is certain to one
_LEAST_PEAK: Final = 7.0  # standard deviations of the correlation's noise: 1e-12 a place, at some 10,000 places
_ODD_SIGMAS: Final = 6.0
_ODD_LEAST: Final = 0.5  # packed pixels
_ROUNDING: Final = 1e-9  # of the power of the tile that has most
_MIDDLE: Final = (0.15, 0.3)  # cycles per packed pixel
_FINE: Final = (0.35, 0.5)
_LEAST_TILES: Final = 4


def common_shift(first: Tiles, image: NDArray[np.float32]) -> tuple[Shift, tuple[int, int], tuple[Tiles, Tiles]] | None:
    """Return by how much a noisy frame's scene lies below and to the right of that of a reference's tiles.

    The shift and the pixels are what :meth:`capture.check.shift.Shift.length` takes; after them the tiles that they
    come from. ``None`` if texture or light is too weak to tell, or nothing of the tiles is left in the frame.
    """
    band = shift_band(first.side) & ~on_lines(first.side)
    here = _with_detail(first, replace(first, spectra=cut_tiles(image, first.starts, first.side)), band)
    place = None if here is None else _peak(here[0], here[1].spectra, band)
    moved = None if place is None else moved_starts(first, image, place)
    cut = None if moved is None else _with_detail(*moved, band)
    if place is None or cut is None:
        return None
    shift = _fitted(*cut, band)
    return None if shift is None else (shift, place, cut)


def _with_detail(first: Tiles, second: Tiles, band: NDArray[np.bool_]) -> tuple[Tiles, Tiles] | None:
    """Return the tiles in which both frames have more than one value; ``None`` if there is none.

    Of a window or a lamp that is saturated all over, or of black that is cut at 0, nothing is left but rounding.
    """
    powers = [np.mean(np.abs(one.spectra[:, band]) ** 2, axis=1, dtype=np.float64) for one in (first, second)]
    kept = np.logical_and.reduce([power > _ROUNDING * power.max() for power in powers])
    if not kept.any():
        return None
    left, right = (Tiles(one.spectra[kept], one.starts[kept], one.side) for one in (first, second))
    return left, right


def _peak(first: Tiles, second: NDArray[Any], band: NDArray[np.bool_]) -> tuple[int, int] | None:
    """Return the peak of the tiles' correlation, in whole pixels, if it stands above the noise of it."""
    import scipy.fft

    side = first.side
    # With the signal in it: a careful limit.
    noise: Array = np.mean(np.abs(second[:, band]) ** 2, axis=1, dtype=np.float64)
    cross = np.where(band, np.conj(first.spectra) * second, 0) / noise[:, None, None]
    surface = scipy.fft.irfft2(cross.sum(axis=0), s=(side, side))
    height, place = find_peak(surface)
    power = (np.abs(first.spectra[:, band]) ** 2 @ counted_twice(side, band)) / noise
    deviation = float(np.sqrt(power.sum() * HANN_CORRELATION)) / side**2
    return None if height < _LEAST_PEAK * deviation else place


def _fitted(first: Tiles, second: Tiles, band: NDArray[np.bool_]) -> Shift | None:
    side = first.side
    fy, fx = frequencies(side)
    waves = np.stack([2 * np.pi * np.broadcast_to(axis, band.shape)[band] for axis in (fy, fx)])
    twice = counted_twice(side, band)
    one = first.spectra[:, band].astype(np.complex128)
    two = second.spectra[:, band].astype(np.complex128)
    power = np.abs(one) ** 2
    # Of each tile: what a gain of 1 and a noise of 1 would tell, (tiles, 2, 2).
    each = np.einsum("tk,ik,jk->tij", power * twice, waves, waves, optimize=True)
    kept = np.ones(len(one), dtype=bool)
    noise = np.maximum(np.mean(np.abs(two) ** 2, axis=1), 1e-300)
    shift, gain = np.zeros(2), 0.0
    for number in range(2 * _ROUNDS):
        undo = unshift(shift[:1], shift[1:], side)[0][band]
        turned = np.conj(one) * two * undo
        weight = kept / noise
        gain = float(weight @ (turned.real @ twice)) / float(weight @ (power @ twice))
        if gain <= 0:
            return None
        residual = two * undo - gain * one
        noise = np.maximum(np.abs(residual) ** 2 @ twice / twice.sum() * HANN_CORRELATION, 1e-300)
        scores = -(turned.imag * twice) @ waves.T / noise[:, None]
        information = gain * each / noise[:, None, None]
        whole = information[kept].sum(axis=0)
        if np.linalg.det(whole) <= 0:
            return None
        shift = np.clip(shift + np.linalg.solve(whole, scores[kept].sum(axis=0)), -_FURTHEST, _FURTHEST)
        if number == _ROUNDS - 1:
            kept = ~_odd(scores, information, gain)
            if 2 * np.count_nonzero(kept) < len(kept):
                return None
    # A score has the variance information / gain: chi squared of the tiles tells what else scatters.
    chi2 = float(np.einsum("ti,tij,tj->", scores[kept], np.linalg.inv(information[kept] / gain), scores[kept]))
    freedom = 2 * int(np.count_nonzero(kept)) - 2
    variance = np.diag(np.linalg.inv(whole)) / gain * max(1.0, chi2 / freedom if freedom > 0 else 1.0)
    return Shift(*(Estimate(float(v), float(e)) for v, e in zip(shift, np.sqrt(variance), strict=True)))


def _odd(scores: Array, information: Array, gain: float) -> NDArray[np.bool_]:
    """Return which tiles lie elsewhere than the frame: something in them moved."""
    own = np.linalg.solve(information, scores[:, :, None])[:, :, 0]
    chi2 = np.einsum("ti,tij,tj->t", own, information * gain, own)
    odd: NDArray[np.bool_] = (chi2 > _ODD_SIGMAS**2) & (np.hypot(own[:, 0], own[:, 1]) > _ODD_LEAST)
    return odd


def fine_noise(shift: Shift, first: Tiles, second: Tiles) -> Estimate | None:
    """Return the power of the finest noise over that of coarser noise, 1 for white noise; ``None`` of too few tiles."""
    side = first.side
    if len(first.spectra) < _LEAST_TILES:
        return None
    fy, fx = frequencies(side)
    radius = np.hypot(fy, fx)
    lines = on_lines(side)
    undo = shift.undo(side)
    powers: list[NDArray[np.float64]] = []
    for low, high in (_FINE, _MIDDLE):
        band = (radius >= low) & (radius <= high) & ~lines
        one, two = first.spectra[:, band], (second.spectra * undo)[:, band]
        # The gain of the band itself: lenses and the luminance's filter are in both frames.
        gain = np.sum((np.conj(one) * two).real) / np.sum(np.abs(one) ** 2)
        powers.append(np.mean(np.abs(two - gain * one) ** 2, axis=1, dtype=np.float64))
    fine, middle = powers
    value = fine.sum() / middle.sum()
    left_out = (fine.sum() - fine) / (middle.sum() - middle)
    return Estimate(float(value), jackknife_error(left_out))
