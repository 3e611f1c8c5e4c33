"""Row noise sigma_row: the standard deviation of one random offset per mosaic row and frame; column noise likewise.

And the colour bias mu_c: by how much the mean of a bias frame differs from the recorded black level, per channel.

The second pass over the bias frames, after :mod:`eldata.calibration.core.defects`: each pixel's own mean over the
frames is taken off, which removes every fixed row and column pattern; the factor n / (n - 1) makes up for what that
takes from the noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.core._frames import (
    channels_of,
    checked_black_level,
    checked_mosaic,
    classes_of_rows,
    sums_by_line,
)
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Mosaic, Values
    from eldata.calibration.core.defects import FixedPattern

    LineSums: TypeAlias = tuple[Counts, Counts, Counts]

_BY_CHANCE = 1e-3  # of the frames' scatter
SHAPIRO_VALUES = 5000
"""The Shapiro-Wilk test's p is accurate up to this many values; more are thinned evenly."""


@dataclass(frozen=True, slots=True, eq=False)
class LineNoise:
    """Noise of the rows, or of the columns.

    Attributes
    ----------
    sigma_dn, sigma_error_dn
        Standard deviation and its standard error, DN; 0 where the pixels' own noise explains all of it, with the error
        then the scale that would just have been seen.
    variance_dn2, variance_error_dn2
        Of the lines' recorded means, less the share of the pixels' noise; may be negative.
    fixed_sigma_dn
        Standard deviation of the fixed pattern of the lines (shading included), the noise's share taken off.
    shapiro_p, shapiro_values
        P-value of the Shapiro-Wilk test of normality, and of how many values.
    excess_kurtosis
        Of the line means; 0 for a normal distribution.
    quantiles, ordered_dn
        Normal probability plot: theoretical quantiles and ordered line means.
    r_squared
        Of that plot.
    frequency, power_dn2
        Average periodogram of the lines, cycles per line and DN^2; white noise of variance s^2 gives s^2 throughout.
    deviations_dn
        (frames, lines): the line means themselves.
    fixed_dn
        (lines,): the fixed pattern.
    """

    sigma_dn: float
    sigma_error_dn: float
    variance_dn2: float
    variance_error_dn2: float
    fixed_sigma_dn: float
    shapiro_p: float
    shapiro_values: int
    excess_kurtosis: float
    quantiles: Values = field(repr=False)
    ordered_dn: Values = field(repr=False)
    r_squared: float
    frequency: Values = field(repr=False)
    power_dn2: Values = field(repr=False)
    deviations_dn: Values = field(repr=False)
    fixed_dn: Values = field(repr=False)

    @property
    def normal_line_dn(self) -> tuple[float, float]:
        """Slope and level of the straight line through the normal probability plot, DN."""
        slope, level = np.polyfit(self.quantiles, self.ordered_dn, 1)
        return float(slope), float(level)

    def smoothed_power_dn2(self, period: int) -> tuple[Values, Values]:
        """Return the periodogram in neighbouring frequencies together, for a CFA of this period."""
        return smoothed_power(self.frequency, self.power_dn2, period)


@dataclass(frozen=True, slots=True, eq=False)
class RowNoise:
    """Row and column noise, and the variance of the pixels around their rows.

    Attributes
    ----------
    rows, columns
        Of mosaic rows over all their channels, and of mosaic columns.
    pixel_variance_dn2
        Variance of a pixel over time around its row's offset; with quantisation.
    frames
        Number of frames.
    """

    rows: LineNoise
    columns: LineNoise
    pixel_variance_dn2: float
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class ColourBias:
    """Colour bias per CFA channel, DN: R, G1, B, G2 for Bayer, R, G, B for X-Trans.

    Attributes
    ----------
    bias_dn
        Mean of all pixels of all frames minus black level, as in the paper: with the defects.
    standard_error_dn
        Of what changes from frame to frame: from the noise of pixels, rows and columns, or where the frames' own means
        scatter by more, as with drift, from these.
    drifts
        Whether the frames' means scatter by more than noise gives them once in a thousand times.
    of_defects_dn
        What the mean of the sound pixels lacks of it.
    frame_bias_dn
        (frames, channels): each frame's own.
    frames
        Number of frames.
    """

    bias_dn: tuple[float, ...]
    standard_error_dn: tuple[float, ...]
    of_defects_dn: tuple[float, ...]
    drifts: bool
    frame_bias_dn: Values = field(repr=False)
    frames: int


class LineMeans:
    """Accumulates what bias frames show by row, column and channel, for :func:`row_noise` and :func:`colour_bias`.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.

    Attributes
    ----------
    rows_dn, columns_dn
        Mean of each line over its channels, each channel less its own mean in the frame; an entry per frame, as all.
    means_dn, sound_means_dn
        Mean of each channel over all pixels, and over the sound ones.
    squares
        Sum over pixels and frames of the squared deviation from the pixel's mean and its row's, DN^2.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self.fixed = fixed
        self.row_pixels, self.column_pixels = sums_by_line(~fixed.defects, fixed.pattern)
        self.row_totals, self.column_totals = sums_by_line(np.where(fixed.defects, 0, fixed.total_dn), fixed.pattern)
        self.rows_dn: list[Values] = []
        self.columns_dn: list[Values] = []
        self.means_dn: list[Values] = []
        self.sound_means_dn: list[Values] = []
        self.squares = 0.0
        self._defects = np.flatnonzero(fixed.defects)
        down, across = np.divmod(self._defects, fixed.defects.shape[1])
        self._defect_channels = fixed.pattern[down % len(fixed.pattern), across % len(fixed.pattern)]

    def add(self, mosaic: Mosaic) -> LineSums:
        """Add a bias frame, and return its sums."""
        found = line_sums(mosaic, self.fixed)
        rows, squares, columns = found
        frames = self.fixed.frames
        sums = rows.sum(axis=1)
        pixels = self.row_pixels.sum(axis=1)
        self.squares += float((squares - sums**2 / np.maximum(pixels, 1)).sum()) / frames**2
        self.rows_dn.append(levels_and_lines(rows / frames, self.row_pixels)[1])
        self.columns_dn.append(levels_and_lines(columns / frames, self.column_pixels)[1])
        values = (rows + self.row_totals).sum(axis=0) // frames  # of the pixels themselves, exactly
        of_channel = self.row_pixels.sum(axis=0)
        of_defects = mosaic.ravel()[self._defects]
        added, number = (np.bincount(self._defect_channels, of, of_channel.size) for of in (of_defects, None))
        self.sound_means_dn.append(values / of_channel)
        self.means_dn.append((values + added) / (of_channel + number))
        return found


def check_same_frames(added: int, fixed: FixedPattern) -> None:
    """Raise a DatasetError unless the second pass saw as many frames as the first."""
    if added != fixed.frames:
        raise DatasetError(
            f"{added} frames were added and the fixed pattern comes from {fixed.frames}: add the same frames again"
        )


def line_sums(mosaic: Mosaic, fixed: FixedPattern) -> LineSums:
    """Return sums of one frame's residuals (n times the deviation from the pixel's mean) over its sound pixels.

    By (row, channel), their squares by row, and by (column, channel).
    """
    from eldata.calibration.core._kernels import residual_sums

    height, width = fixed.total_dn.shape
    checked_mosaic(mosaic, (height, width), len(fixed.pattern))
    channels = channels_of(fixed.pattern)
    rows, columns = np.zeros((height, channels), dtype=np.int64), np.zeros((width, channels), dtype=np.int64)
    squares = np.zeros(height, dtype=np.int64)
    residual_sums(mosaic, fixed.total_dn, fixed.defects, fixed.frames, fixed.pattern, rows, squares, columns)
    return rows, squares, columns


def levels_and_lines(sums: NDArray[Any], pixels: Counts) -> tuple[Values, Values]:
    """Return each channel's mean in the frame, and that of each line over its channels, each less its own."""
    level = sums.sum(axis=0) / np.maximum(pixels.sum(axis=0), 1)
    return level, (sums - pixels * level).sum(axis=1) / np.maximum(pixels.sum(axis=1), 1)


def row_noise(means: LineMeans) -> RowNoise:
    """Estimate sigma_row (and the columns' sigma) from the line means over time.

    With r the mean of one mosaic row over its channels, less the channels' means and the row's mean over the n frames,
    ``sigma_row^2 = sum r^2 / nu - sigma_pixel^2 / n_columns``, nu = (n - 1) (rows - classes of rows): the maximum
    likelihood for normal offsets, made unbiased, less what the mean of finitely many pixels scatters.
    Its variance is ``2 (sum r^2 / nu)^2 / nu``.

    Parameters
    ----------
    means
        Of the same frames as the fixed pattern's.

    Raises
    ------
    DatasetError
        If the frames added are not those of the fixed pattern.
    """
    fixed, frames = means.fixed, means.fixed.frames
    check_same_frames(len(means.rows_dn), fixed)
    pixels = means.row_pixels.sum(axis=1)
    # Per pixel and row 1/n and 1/m of the freedom are gone.
    freedom = (frames - 1) * float(np.maximum(pixels - 1, 0).sum())
    pixel_variance = means.squares / freedom
    lines = (
        (means.rows_dn, means.row_pixels, means.row_totals, fixed.pattern),
        (means.columns_dn, means.column_pixels, means.column_totals, fixed.pattern.T),
    )
    of_rows, of_columns = (
        _line_noise(np.array(deviations), counts, sums / frames, pattern, pixel_variance)
        for deviations, counts, sums, pattern in lines
    )
    return RowNoise(
        rows=of_rows,
        columns=of_columns,
        pixel_variance_dn2=pixel_variance,
        frames=frames,
    )


def _line_noise(
    deviations: Values,
    pixels: Counts,
    fixed_sums: Values,
    pattern: Counts,
    pixel_variance: float,
) -> LineNoise:
    from scipy import stats

    counts = pixels.sum(axis=1)
    used = counts > 0
    deviations = deviations[:, used]
    frames, lines = deviations.shape
    freedom = (frames - 1) * (lines - classes_of_rows(pattern))
    if freedom < 2:
        raise DatasetError("too few sound rows or columns are left: raise the threshold of the defects")
    scatter = float((deviations**2).sum()) / freedom
    of_pixels = pixel_variance * float((1 / counts[used]).mean())
    variance, variance_error = scatter - of_pixels, scatter * math.sqrt(2 / freedom)
    sigma, error = _sigma(variance, variance_error)
    values = deviations.ravel() * math.sqrt(frames / (frames - 1))
    thinned = values[np.linspace(0, values.size - 1, min(values.size, SHAPIRO_VALUES)).astype(np.int64)]
    (quantiles, ordered), (_, _, correlation) = stats.probplot(thinned)
    fixed = levels_and_lines(fixed_sums, pixels)[1]
    fixed_variance = float((fixed[used] ** 2).sum()) / (lines - classes_of_rows(pattern)) - scatter / frames
    return LineNoise(
        sigma_dn=sigma,
        sigma_error_dn=error,
        variance_dn2=variance,
        variance_error_dn2=variance_error,
        fixed_sigma_dn=math.sqrt(max(fixed_variance, 0.0)),
        shapiro_p=float(stats.shapiro(thinned).pvalue),
        shapiro_values=thinned.size,
        excess_kurtosis=float(stats.kurtosis(values)),
        quantiles=quantiles,
        ordered_dn=ordered,
        r_squared=float(correlation) ** 2,
        frequency=np.asarray(np.fft.rfftfreq(lines), dtype=np.float64),
        power_dn2=(np.abs(np.fft.rfft(deviations, axis=1)) ** 2).mean(axis=0) / lines * (frames / (frames - 1)),
        deviations_dn=deviations,
        fixed_dn=fixed,
    )


def _sigma(variance: float, error: float) -> tuple[float, float]:
    """Return the standard deviation of offsets whose variance is given with its error, and its error."""
    if variance <= 0:
        return 0.0, math.sqrt(error)
    step = 1e-3 * variance
    slope = (math.sqrt(variance + step) - math.sqrt(variance - step)) / (2 * step)
    return math.sqrt(variance), min(error * slope, math.sqrt(error))


def colour_bias(means: LineMeans, noise: RowNoise, black_level_dn: Sequence[float]) -> ColourBias:
    """Return mu_c: the mean of each channel over all frames minus its recorded black level.

    Independent noise of pixels, rows and columns gives the mean of a channel of N pixels, m of them in a line, over n
    frames the variance ``(sigma_pixel^2 / N + sum over lines of sigma_line^2 (m / N)^2) / n``. What the frames' means
    scatter by beyond that, over all channels together, enlarges it.

    Raises
    ------
    ArgumentError
        If there is not one black level per channel.
    DatasetError
        If the frames added are not those of the fixed pattern.
    """
    from scipy.special import chdtri, ndtri, stdtrit

    check_same_frames(len(means.means_dn), means.fixed)
    table = np.array(means.means_dn)
    frames, channels = table.shape
    bias = table - checked_black_level(black_level_dn, channels)
    lines = ((means.row_pixels, noise.rows), (means.column_pixels, noise.columns))
    pixels = means.row_pixels.sum(axis=0)
    of_frame = noise.pixel_variance_dn2 / pixels + sum(
        max(line.variance_dn2, 0.0) * ((counts / pixels) ** 2).sum(axis=0) for counts, line in lines
    )
    drift = float((bias.var(axis=0, ddof=1) / of_frame).mean())
    error = np.sqrt(of_frame * max(drift, 1.0) / frames)
    if drifts := drift > chdtri(frames - 1, _BY_CHANCE) / (frames - 1):
        error *= stdtrit(frames - 1, 0.975) / ndtri(0.975)  # so few frames know little of their scatter
    return ColourBias(
        bias_dn=tuple(bias.mean(axis=0).tolist()),
        standard_error_dn=tuple(error.tolist()),
        drifts=bool(drifts),
        of_defects_dn=tuple((table - np.array(means.sound_means_dn)).mean(axis=0).tolist()),
        frame_bias_dn=bias,
        frames=frames,
    )


# --- spectra ----------------------------------------------------------------------------------------------------------

_FREQUENCIES = 80
_FREQUENCIES_TOGETHER = 4  # at least: a single one scatters by all of itself


def smoothed_power(frequency: Values, power: Values, period: int) -> tuple[Values, Values]:
    """Return means of neighbouring frequencies, without those that taking off the channels' means has emptied.

    These are 0 and the multiples of one over the CFA's period.
    """
    places = frequency * period
    kept = np.flatnonzero(np.abs(places - np.rint(places)) > period * frequency[1] / 2)
    groups = np.array_split(kept, max(1, min(_FREQUENCIES, kept.size // _FREQUENCIES_TOGETHER)))
    return np.array([frequency[g].mean() for g in groups]), np.array([power[g].mean() for g in groups])
