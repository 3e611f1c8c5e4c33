"""The rows' offsets over the frame: waves, slow drift, and their spectrum, where the model draws each row by itself."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core.findings import BANDING, CHANCE, ROW_DRIFT
from eldata.noise.structure import RowSpectrum, RowWave

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldata.calibration.audit.bias_sums import BiasSeen
    from eldata.calibration.core._frames import Values
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.row_noise import LineNoise

_SLOW, _FAST = 1 / 8, 1 / 4  # cycles per row
_LEAST_WAVES = 8  # over a frame; fewer, and a wave is not told from drift
_LEAKED = 0.02  # share of the ground that a wave may leak to a frequency
_PERIODS = 6  # of the rows' composition: a multiple of Bayer's and X-Trans' own
_NEAR = 15  # frequencies on each side, whose median is a wave's ground
_HANN_NOISE = 1.5  # equivalent noise bandwidth of the window, in frequencies
_HANN_LOBE = 2  # frequencies on each side of a wave's own


def row_waves(seen: BiasSeen) -> Iterator[Finding]:
    """Yield findings if the rows' offsets hold a wave or drift slowly, where the model draws each row by itself."""
    line, shape = seen.rows.rows, seen.rows.frames - 1
    error = line.sigma_error_dn / max(line.sigma_dn, 1e-12)
    frequency, power, ground, threshold = standing_out(line, shape)
    is_wave = (power > threshold * ground) & (frequency > _LEAST_WAVES / line.deviations_dn.shape[1])
    yield from _slow_drift(line, shape, error, frequency[is_wave], (power / ground)[is_wave])
    if is_wave.any():
        variance = float((power - ground)[is_wave].sum()) / power.size
        highest = int(np.where(is_wave, power / ground, 0.0).argmax())
        text = (
            f"bands in the rows, one every {1 / frequency[highest]:.3g} rows, of {math.sqrt(2 * variance):.2g} DN "
            "amplitude; the model draws row by row; look for interference (another charger, lamp or card)"
        )
        statistic = float(power[highest] / ground[highest])
        share = _share_of_sigma(variance, line)
        yield from BANDING.judged(statistic, threshold, text, {"row noise": (share, error)})


def standing_out(line: LineNoise, shape: int) -> tuple[Values, Values, Values, float]:
    """Return frequencies, the power under a Hann window, its ground, and the ratio of the two that makes a wave.

    An ordinate of white noise, averaged over n frames whose mean is taken off, follows a Gamma distribution of shape
    n - 1. The ground is the median of its neighbours, of a relative error of 1.25 / sqrt(m shape); four of them.
    """
    from scipy.special import gammainccinv, gammaincinv

    lines = line.deviations_dn.shape[1]
    window = np.hanning(lines + 1)[:-1]
    frequency, power = periodogram(line, window * math.sqrt(lines / float(window @ window)), blurred_over=2.5)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(power, _NEAR, mode="reflect"), 2 * _NEAR + 1)
    ground = np.median(windows, axis=1) * shape / float(gammaincinv(shape, 0.5))
    threshold = float(gammainccinv(shape, CHANCE / power.size)) / shape
    return frequency, power, ground, threshold * (1 + 5 / math.sqrt((2 * _NEAR + 1) * shape))


def _slow_drift(line: LineNoise, shape: int, error: float, waves: Values, heights: Values) -> Iterator[Finding]:
    """Yield a finding if slow waves over the rows have more power than fast ones.

    The sum of the periodogram over its fast part's mean, each ordinate weighted by 1/f: the sharpest test for 1/f. Of
    white noise it is a weighted sum of Gamma variables, whose upper quantile comes from that of chi^2 with the same
    three moments (Imhof). What waves leak to, as the inverse square of the distance, is left out. How much of the row
    noise it is says a fit of the periodogram by white noise, 1/f and 1/f^2.
    """
    from scipy.optimize import nnls
    from scipy.special import chdtri

    lines = line.deviations_dn.shape[1]
    frequency, power = periodogram(line, np.ones(lines), blurred_over=0.5)
    distance = np.maximum(np.abs(frequency[:, None] - waves) * lines, 0.5)
    left = (heights / (math.pi * distance) ** 2).sum(axis=1) < _LEAKED
    slow, fast = left & (frequency < _SLOW), left & (frequency > _FAST)
    if slow.sum() < _LEAST_WAVES or fast.sum() < _LEAST_WAVES:
        return
    ground = float(power[fast].mean())
    weights = 1 / (frequency[slow] * lines)
    statistic = float(weights @ power[slow]) / ground
    mean, second, third = weights.sum(), (weights**2).sum() / shape, (weights**3).sum() / shape**2
    second += mean**2 / (shape * int(fast.sum()))  # the ground's own error
    freedom = 2 * second**3 / third**2
    limit = float(mean + (chdtri(freedom, CHANCE) - freedom) * math.sqrt(second / (2 * freedom)))
    if statistic <= limit:
        return
    parts = np.stack([frequency**0, 1 / frequency, frequency**-2.0], axis=1)
    scale = np.maximum(ground, np.convolve(power, np.ones(7) / 7, mode="same"))  # an ordinate scatters by itself
    amounts, _ = nnls((parts / scale[:, None])[left], (power / scale)[left])
    variance = float((parts[:, 1:] @ amounts[1:]).sum()) / power.size
    text = (
        f"black drifts slowly down the frame: slow waves over the rows have {statistic / mean:.1f} times the power of "
        "fast ones; the model draws row by row, so simulated frames show less of them"
    )
    share = _share_of_sigma(variance, line)
    yield from ROW_DRIFT.judged(statistic / mean, limit / mean, text, {"row noise": (share, error)})


def periodogram(line: LineNoise, window: Values, blurred_over: float) -> tuple[Values, Values]:
    """Return frequencies, cycles per line, and power, DN^2: white noise of variance s^2 gives s^2 throughout.

    Taking off the channels' means empties the multiples of a half, for X-Trans of a sixth; these are left out, and what
    the window blurs them over.
    """
    frames, lines = line.deviations_dn.shape
    power = (np.abs(np.fft.rfft(line.deviations_dn * window, axis=1)) ** 2).mean(axis=0) / lines * frames / (frames - 1)
    frequency = np.fft.rfftfreq(lines)
    places = frequency * _PERIODS
    kept = np.abs(places - np.rint(places)) > blurred_over * _PERIODS / lines
    return frequency[kept], power[kept]


def _share_of_sigma(variance_dn2: float, line: LineNoise) -> float:
    """Return which share of a line noise's sigma comes from this part of its variance."""
    return 1 - math.sqrt(max(1 - max(variance_dn2, 0.0) / max(line.variance_dn2, 1e-12), 0.0))


def row_spectrum(
    line: LineNoise, frames: int, *, is_banded: bool
) -> tuple[RowSpectrum, tuple[float, ...], tuple[float, ...]]:
    """Return the spectrum of the rows' offsets, in octaves, and the errors of its powers and of its waves' amplitudes.

    The pixels' own noise has the same power at every frequency, and is taken off. An ordinate averaged over n frames,
    whose mean is taken off, follows a Gamma distribution of shape n - 1: a band of m has a relative error of
    1 / sqrt(m (n - 1)). Rounding hides or enlarges offsets: all powers are scaled as sigma_row is.
    """
    lines, shape = line.deviations_dn.shape[1], frames - 1
    scale = line.sigma_dn**2 / line.variance_dn2 if line.variance_dn2 > 0 else 1.0
    lowest = 0.5 / lines
    if not is_banded:
        error = 2 * line.sigma_dn * line.sigma_error_dn
        return RowSpectrum((lowest, 0.5), (line.sigma_dn**2,)), (error,), ()
    waves, wave_errors = _waves(line, shape, scale)
    frequency, power = periodogram(line, np.ones(lines), blurred_over=0.5)
    of_pixels = float((line.deviations_dn**2).sum()) / line.deviations_dn.size * frames / shape - line.variance_dn2
    kept = np.ones(frequency.size, dtype=np.bool_)
    for wave in waves:
        # The power that a wave leaks to, without a window, falls with the square of the distance.
        height = lines * wave.amplitude_dn**2 / 4 / scale
        distance = np.maximum(np.abs(frequency - wave.frequency_per_row) * lines, 0.5)
        kept &= height / (math.pi * distance) ** 2 < _LEAKED * np.median(power)
    edges, powers, errors = [lowest], list[float](), list[float]()
    upper = 1.5 / lines
    while edges[-1] < 0.5:
        upper = 0.5 if 2 * upper > 0.5 else upper
        chosen = kept & (frequency > edges[-1]) & (frequency <= upper)
        if chosen.any():
            mean = float(power[chosen].mean())
            powers.append(scale * max(mean - of_pixels, 0.0))
            errors.append(scale * mean / math.sqrt(shape * int(chosen.sum())))
            edges.append(upper)
        elif upper == 0.5:
            edges[-1] = 0.5
        upper = 2 * upper
    if not powers:  # a wave at every frequency that is left
        return RowSpectrum((lowest, 0.5), (0.0,), waves), (0.0,), wave_errors
    return RowSpectrum(tuple(edges), tuple(powers), waves), tuple(errors), wave_errors


def _waves(line: LineNoise, shape: int, scale: float) -> tuple[tuple[RowWave, ...], tuple[float, ...]]:
    """Return the waves that stand out under a Hann window, and the errors of their amplitudes.

    A wave's power is that of the frequencies around its own, over the ground; its amplitude in one frame of N rows over
    white noise of power g scatters by sqrt(2 g / N), under the window by sqrt(1.5) of it. With the pixels' own means
    goes what the mean of the n frames holds of a wave of free phase: of its square an exponential share, of mean and
    scatter 1 / n.
    """
    lines = line.deviations_dn.shape[1]
    frequency, power, ground, threshold = standing_out(line, shape)
    places = np.flatnonzero((power > threshold * ground) & (frequency > _LEAST_WAVES / lines))
    waves, errors = [], []
    for group in np.split(places, np.flatnonzero(np.diff(places) > _HANN_LOBE) + 1) if places.size else []:
        around = slice(max(int(group[0]) - _HANN_LOBE, 0), int(group[-1]) + _HANN_LOBE + 1)
        excess = (power - ground)[around]
        variance = float(excess.sum()) * 2 / lines
        middle = float(np.maximum(excess, 0) @ frequency[around] / np.maximum(excess, 0).sum())
        waves.append(RowWave(middle, math.sqrt(scale * 2 * max(variance, 0.0))))
        by_ground = scale * 2 * _HANN_NOISE * float(ground[around].mean()) / (lines * (shape + 1))
        errors.append(math.hypot(math.sqrt(by_ground), waves[-1].amplitude_dn / (2 * shape)))
    return tuple(waves), tuple(errors)
