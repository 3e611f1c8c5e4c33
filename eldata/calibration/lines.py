"""Row noise sigma_row and colour bias mu_c, from the second pass over the bias frames.

sigma_row is the standard deviation of one random offset per mosaic row and frame (Wei et al., TPAMI 2021, section
3.2.1, figures 5 and 6); noise of the columns is measured likewise. Each pixel's own mean over the frames is taken off,
which removes every fixed row and column pattern; the factor n / (n - 1) makes up for what that takes from the noise.

mu_c is by how much the mean of a bias frame differs from the recorded black level, per channel (section 3.2.1,
figure 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.sums import channels_of, levels_and_lines, sites
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.calibration.bias_sums import BiasSums
    from eldata.calibration.defects import FixedPattern
    from eldata.calibration.sums import Counts, Mosaic, Plane, Values

_BY_CHANCE = 1e-3  # of the frames' scatter
_FREQUENCIES = 80
_FREQUENCIES_TOGETHER = 4  # at least: a single one scatters by all of itself
_SHAPIRO_VALUES = 5000  # up to which the Shapiro-Wilk test's p is accurate; more are thinned evenly


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
    def relative_error(self) -> float:
        """Standard error of sigma as a share of it."""
        return self.sigma_error_dn / max(self.sigma_dn, 1e-12)

    @property
    def normal_line_dn(self) -> tuple[float, float]:
        """Slope and level of the straight line through the normal probability plot, DN."""
        slope, level = np.polyfit(self.quantiles, self.ordered_dn, 1)
        return float(slope), float(level)

    def smoothed_power_dn2(self, period: int) -> tuple[Values, Values]:
        """Return the means of neighbouring frequencies and of their power, for a CFA of this period.

        Without 0 and the multiples of one over the period, which taking off the channels' means has emptied.
        """
        places = self.frequency * period
        kept = np.flatnonzero(np.abs(places - np.rint(places)) > period * self.frequency[1] / 2)
        groups = np.array_split(kept, max(1, min(_FREQUENCIES, kept.size // _FREQUENCIES_TOGETHER)))
        frequency, power = (np.array([each[g].mean() for g in groups]) for each in (self.frequency, self.power_dn2))
        return frequency, power


@dataclass(frozen=True, slots=True, eq=False)
class RowNoise:
    """Row and column noise, and the variance of the pixels around their rows.

    Attributes
    ----------
    rows, columns
        Of mosaic rows over all their channels, and of mosaic columns.
    pixel_variance_dn2
        Variance of a pixel over time around its row's offset; with quantisation.
    """

    rows: LineNoise
    columns: LineNoise
    pixel_variance_dn2: float


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


def row_noise(sums: BiasSums) -> RowNoise:
    """Estimate sigma_row (and the columns' sigma) from the line means over time.

    With r the mean of one mosaic row over its channels, less the channels' means and the row's mean over the n frames,
    ``sigma_row^2 = sum r^2 / nu - sigma_pixel^2 / n_columns``, nu = (n - 1) (rows - classes of rows): the maximum
    likelihood for normal offsets, made unbiased, less what the mean of finitely many pixels scatters.
    Its variance is ``2 (sum r^2 / nu)^2 / nu``.

    Raises
    ------
    DatasetError
        If the frames added are not those of the fixed pattern.
    """
    sums.check_frames()
    fixed, frames = sums.fixed, sums.fixed.frames
    pixels = sums.row_pixels.sum(axis=1)
    # Per pixel and row 1/n and 1/m of the freedom are gone.
    freedom = (frames - 1) * float(np.maximum(pixels - 1, 0).sum())
    pixel_variance = sums.squares / freedom
    lines = (
        (sums.rows_dn, sums.row_pixels, sums.row_totals, fixed.pattern),
        (sums.columns_dn, sums.column_pixels, sums.column_totals, fixed.pattern.T),
    )
    of_rows, of_columns = (
        _line_noise(np.array(deviations), counts, totals / frames, pattern, pixel_variance)
        for deviations, counts, totals, pattern in lines
    )
    return RowNoise(of_rows, of_columns, pixel_variance)


def _line_noise(
    deviations: Values, pixels: Counts, fixed_sums: Values, pattern: Counts, pixel_variance: float
) -> LineNoise:
    from scipy import stats

    counts = pixels.sum(axis=1)
    used = counts > 0
    deviations = deviations[:, used]
    frames, lines = deviations.shape
    freedom = (frames - 1) * (lines - _classes_of_rows(pattern))
    if freedom < 2:
        raise DatasetError("too few sound rows or columns are left")
    scatter = float((deviations**2).sum()) / freedom
    of_pixels = pixel_variance * float((1 / counts[used]).mean())
    variance, variance_error = scatter - of_pixels, scatter * math.sqrt(2 / freedom)
    sigma, error = _sigma(variance, variance_error)
    values = deviations.ravel() * math.sqrt(frames / (frames - 1))
    thinned = values[np.linspace(0, values.size - 1, min(values.size, _SHAPIRO_VALUES)).astype(np.int64)]
    (quantiles, ordered), (_, _, correlation) = stats.probplot(thinned)
    fixed = levels_and_lines(fixed_sums, pixels)[1]
    fixed_variance = float((fixed[used] ** 2).sum()) / (lines - _classes_of_rows(pattern)) - scatter / frames
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


def _classes_of_rows(pattern: Counts) -> int:
    """Return the degrees of freedom that channel means take from row means: the rank of the rows' composition."""
    composition = np.stack([np.bincount(row, minlength=channels_of(pattern)) for row in pattern])
    return int(np.linalg.matrix_rank(composition))


def _sigma(variance: float, error: float) -> tuple[float, float]:
    """Return the standard deviation of offsets whose variance is given with its error, and its error."""
    if variance <= 0:
        return 0.0, math.sqrt(error)
    step = 1e-3 * variance
    slope = (math.sqrt(variance + step) - math.sqrt(variance - step)) / (2 * step)
    return math.sqrt(variance), min(error * slope, math.sqrt(error))


def colour_bias(sums: BiasSums, noise: RowNoise, black_level_dn: Sequence[float]) -> ColourBias:
    """Return mu_c: the mean of each channel over all frames minus its recorded black level.

    Independent noise of pixels, rows and columns gives the mean of a channel of N pixels, m of them in a line, over n
    frames the variance ``(sigma_pixel^2 / N + sum over lines of sigma_line^2 (m / N)^2) / n``. What the frames' means
    scatter by beyond that, over all channels together, enlarges it.

    Parameters
    ----------
    sums
        The bias frames.
    noise
        Their row noise.
    black_level_dn
        As recorded, one for each CFA channel.
    """
    from scipy.special import chdtri, ndtri, stdtrit

    table = np.array(sums.means_dn)
    frames = len(table)
    bias = table - np.asarray(black_level_dn)
    lines = ((sums.row_pixels, noise.rows), (sums.column_pixels, noise.columns))
    pixels = sums.row_pixels.sum(axis=0)
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
        of_defects_dn=tuple((table - np.array(sums.sound_means_dn)).mean(axis=0).tolist()),
        frame_bias_dn=bias,
        frames=frames,
    )


# --- spectra ----------------------------------------------------------------------------------------------------------

_TILE = 256
_MOST_TILES = 64


def power_spectrum(mosaic: Mosaic, fixed: FixedPattern) -> Plane:
    """Return the centred power spectrum of a bias frame less its channels' means, DN^2 per pixel.

    The average over tiles of 256 x 256 pixels (up to 64 of them, evenly spread): white noise of variance s^2 gives s^2
    throughout. Noise that a row shares lies on the column of horizontal frequency 0, that of a column on the row of
    vertical frequency 0. Defects count as their channel's mean; fixed patterns stay in.

    Raises
    ------
    DatasetError
        If the frame is smaller than a tile.
    """
    height, width = mosaic.shape
    if height < _TILE or width < _TILE:
        raise DatasetError(f"the spectrum needs a frame of {_TILE} x {_TILE} pixels or more; found {height} x {width}")
    down, across = height // _TILE, width // _TILE
    step = max(1, round((down * across / _MOST_TILES) ** 0.5))
    power = np.zeros((_TILE, _TILE))
    tiles = 0
    for y in range(0, down, step):
        for x in range(0, across, step):
            place = slice(y * _TILE, (y + 1) * _TILE), slice(x * _TILE, (x + 1) * _TILE)
            tile = mosaic[place].astype(np.float64)
            tile[fixed.defects[place]] = np.nan
            for within, _ in sites(fixed.pattern):  # by site, not by channel: the two greens of Bayer may differ
                tile[within] -= np.nanmean(tile[within])
            power += np.abs(np.fft.fft2(np.nan_to_num(tile))) ** 2
            tiles += 1
    spectrum: Plane = np.fft.fftshift(power / (tiles * _TILE * _TILE)).astype(np.float32)
    return spectrum
