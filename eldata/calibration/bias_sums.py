"""The second pass over the bias frames, a frame at a time: row noise sigma_row, colour bias mu_c, sums for the rest.

:class:`BiasSums` takes each pixel's own mean off, and with it every fixed pattern
(:mod:`eldata.calibration.defects`); what is left tells colour bias, row noise and read noise. :class:`BiasPairs`
sums up, of frames taken two by two, what the checks look at.

sigma_row is the standard deviation of one random offset per mosaic row and frame (Wei et al., TPAMI 2021, section
3.2.1, figures 5 and 6); noise of the columns is measured likewise. The factor n / (n - 1) makes up for what taking off
each pixel's mean takes from the noise. mu_c is by how much the mean of a bias frame differs from the recorded black
level, per channel (section 3.2.1, figure 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import special, stats

from eldata.calibration import sums as loops
from eldata.calibration.sums import channels_of, checked_mosaic, groups_of_rows, levels_and_lines, sites, sums_by_row
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.calibration.defects import FixedPattern
    from eldata.calibration.sums import Counts, Mosaic, Plane, Values

CELLS_PER_SIGMA = 20
"""Of a histogram of residuals."""

_HALF = 8192  # cells on each side of 0: 400 standard deviations


@dataclass(frozen=True, slots=True, eq=False)
class ResidualHistogram:
    """Counts of residuals.

    Attributes
    ----------
    counts
        (groups, cells): cell j is centred on (j - cells // 2) ``cell_dn``; the first and last hold all beyond. Whole
        numbers, or estimates of them, which in the tails may be negative.
    cell_dn
        Width of a cell.
    frames
        Over how many frames each pixel's mean was taken off; 1 if none was.
    row_pixels
        Over how many pixels each row's mean was taken off; infinity if none was.
    rounding_dn
        Step that the values had been rounded to before other things were taken off; 0 if the cells are that rounding
        (whole DN, counted as they are).
    is_cut
        Whether recorded values end below, so that the residuals above 0 alone tell the noise.
    squares_dn2
        (groups,) exact sums of the squared residuals; without, the counts tell them.
    level_waves
        By channel, how alike the fractions of a DN are that the pixels' means over the frames have: the mean of
        exp(2 pi i mean), near 0 where they lie everywhere between whole DN.
    """

    counts: NDArray[Any] = field(repr=False)
    cell_dn: float
    frames: int = 1
    row_pixels: float = math.inf
    rounding_dn: float = 1.0
    is_cut: bool = False
    squares_dn2: Values | None = field(default=None, repr=False)
    level_waves: NDArray[np.complexfloating[Any, Any]] = field(repr=False, default_factory=lambda: np.zeros(1, complex))

    @property
    def folded(self) -> Counts:
        """Counts of abs(residual), as the distribution is symmetric; where it is cut, of half of them."""
        centre = self.counts.shape[1] // 2
        both: Counts = self.counts[:, centre:].copy()
        if self.is_cut:
            both[:, 0] //= 2
        else:
            both[:, 1:] += self.counts[:, :centre][:, ::-1]
        return both

    @property
    def values_dn(self) -> Values:
        """Centre of each cell."""
        cells = self.counts.shape[1]
        return np.asarray((np.arange(cells) - cells // 2) * self.cell_dn, dtype=np.float64)


class BiasSums:
    """The bias frames that made a fixed pattern, summed up for row noise, colour bias and read noise.

    A residual is a pixel's value less its mean over the n frames, the channel's drift in this frame and the row's
    offset. Where the noise reaches a floor, at which values end, none are counted.

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
    at_floor
        Where the noise reaches the floor: values that lie on it.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        self.fixed = fixed
        sound, total = ~fixed.defects, np.where(fixed.defects, 0, fixed.total_dn)
        self.row_pixels, self.row_totals = (sums_by_row(values, fixed.pattern) for values in (sound, total))
        self.column_pixels, self.column_totals = (sums_by_row(each.T, fixed.pattern.T) for each in (sound, total))
        lists: tuple[list[Values], ...] = [], [], [], []
        self.rows_dn, self.columns_dn, self.means_dn, self.sound_means_dn = lists
        self.squares, self.at_floor = 0.0, 0
        self._defects = np.flatnonzero(fixed.defects)
        down, across = np.divmod(self._defects, fixed.defects.shape[1])
        self._defect_channels = fixed.pattern[down % len(fixed.pattern), across % len(fixed.pattern)]
        sigma = math.sqrt(float(np.mean(fixed.temporal_variance_dn2)))
        step = round(fixed.frames * sigma / CELLS_PER_SIGMA)
        self._step = max(1, step - 1 + step % 2)  # odd, so that cell 0 is symmetric; in units of 1/n DN
        self._group = groups_of_rows(len(self.row_pixels))
        self._counts = np.zeros((int(self._group.max()) + 1, 2 * _HALF + 1), dtype=np.int64)
        self._group_squares = np.zeros(len(self._counts))  # of residuals, in units of 1/n DN

    def add(self, mosaic: Mosaic) -> None:
        """Add a bias frame."""
        fixed, (height, width) = self.fixed, self.fixed.defects.shape
        checked_mosaic(mosaic, (height, width), len(fixed.pattern))
        # Of n times the deviation from the pixel's own mean: by (row, channel), squares by row, by (column, channel).
        rows, columns = np.zeros_like(self.row_pixels), np.zeros_like(self.column_pixels)
        squares = np.zeros(height, dtype=np.int64)
        loops.residual_sums(mosaic, fixed.total_dn, fixed.defects, fixed.frames, fixed.pattern, rows, squares, columns)
        self._add_lines(mosaic, rows, squares, columns)
        if fixed.clips_at_black:
            self.at_floor += int(np.count_nonzero(mosaic <= (fixed.floor_dn or 0)))
        else:
            self._count_residuals(mosaic, rows, squares)

    def _add_lines(self, mosaic: Mosaic, rows: Counts, squares: Counts, columns: Counts) -> None:
        """Keep a frame's means by row, by column and by channel, in DN."""
        frames = self.fixed.frames
        sums, pixels = rows.sum(axis=1), self.row_pixels.sum(axis=1)
        self.squares += float((squares - sums**2 / np.maximum(pixels, 1)).sum()) / frames**2
        self.rows_dn.append(levels_and_lines(rows / frames, self.row_pixels)[1])
        self.columns_dn.append(levels_and_lines(columns / frames, self.column_pixels)[1])
        values = (rows + self.row_totals).sum(axis=0) // frames  # of the pixels themselves, exactly
        of_channel = self.row_pixels.sum(axis=0)
        of_defects = mosaic.ravel()[self._defects]
        added, number = (np.bincount(self._defect_channels, of, of_channel.size) for of in (of_defects, None))
        self.sound_means_dn.append(values / of_channel)
        self.means_dn.append((values + added) / (of_channel + number))

    def _count_residuals(self, mosaic: Mosaic, rows: Counts, squares: Counts) -> None:
        """Count a frame's residuals, less the means of its channels and rows, by value."""
        fixed = self.fixed
        level, line = levels_and_lines(rows, self.row_pixels)
        by_channel = line[:, None] + level
        left = squares - 2 * (by_channel * rows).sum(axis=1) + (by_channel**2 * self.row_pixels).sum(axis=1)
        self._group_squares += np.bincount(self._group, left, minlength=len(self._group_squares))
        phases = np.arange(len(line)) % len(fixed.pattern)
        offsets = np.rint(line[:, None] + level[fixed.pattern[phases]]).astype(np.int64)
        loops.residual_histogram(mosaic, fixed.total_dn, fixed.defects, fixed.frames, offsets, self._step, self._counts)

    def check_frames(self) -> None:
        """Raise a DatasetError unless the second pass saw as many frames as the first."""
        if (added := len(self.means_dn)) != (frames := self.fixed.frames):
            raise DatasetError(f"{added} frames were added, the pattern is of {frames}: add the same frames again")

    def residuals(self) -> ResidualHistogram:
        """Return the histogram of the residuals so far.

        Raises
        ------
        DatasetError
            If the frames added are not those of the fixed pattern.
        """
        self.check_frames()
        fixed, frames = self.fixed, self.fixed.frames
        return ResidualHistogram(
            self._counts.copy(),
            self._step / frames,
            frames,
            float(self.row_pixels.sum(axis=1).mean()),
            is_cut=fixed.floor_dn is not None,
            squares_dn2=None if fixed.floor_dn is not None else self._group_squares / frames**2,
            level_waves=self._level_waves(),
        )

    def _level_waves(self) -> NDArray[np.complexfloating[Any, Any]]:
        """Return by channel the mean of exp(2 pi i mean level)."""
        fixed, frames = self.fixed, self.fixed.frames
        remainders = np.zeros((1, len(fixed.level_dn), frames), dtype=np.int64)
        of_pixels = np.empty(fixed.total_dn.shape, dtype=np.uint16)
        np.remainder(fixed.total_dn, frames, out=of_pixels, casting="unsafe")
        loops.channel_histograms(of_pixels, fixed.defects, fixed.pattern, remainders)
        turns = np.exp(2j * math.pi * np.arange(frames) / frames)
        return np.asarray(remainders[0] @ turns / np.maximum(remainders[0].sum(axis=1), 1))


# --- row noise and colour bias ----------------------------------------------------------------------------------------

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
    rows = sums.rows_dn, sums.row_pixels, sums.row_totals / frames, fixed.pattern
    columns = sums.columns_dn, sums.column_pixels, sums.column_totals / frames, fixed.pattern.T
    return RowNoise(_measure_lines(*rows, pixel_variance), _measure_lines(*columns, pixel_variance), pixel_variance)


def _measure_lines(
    means: list[Values], pixels: Counts, fixed_sums: Values, pattern: Counts, pixel_variance: float
) -> LineNoise:
    """Measure the noise of rows, or of columns, from their means in each frame, and test if it is normal."""
    deviations, counts = np.array(means), pixels.sum(axis=1)
    used = counts > 0
    deviations = deviations[:, used]
    frames, lines = deviations.shape
    independent = lines - _count_classes(pattern)
    freedom = (frames - 1) * independent
    scatter = float((deviations**2).sum()) / freedom
    of_pixels = pixel_variance * float((1 / counts[used]).mean())
    variance, variance_error = scatter - of_pixels, scatter * math.sqrt(2 / freedom)
    sigma, error = _sigma(variance, variance_error)
    values = deviations.ravel() * math.sqrt(frames / (frames - 1))
    thinned = values[np.linspace(0, values.size - 1, min(values.size, _SHAPIRO_VALUES)).astype(np.int64)]
    (quantiles, ordered), (_, _, correlation) = stats.probplot(thinned)
    fixed = levels_and_lines(fixed_sums, pixels)[1]
    fixed_variance = float((fixed[used] ** 2).sum()) / independent - scatter / frames
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


def _count_classes(pattern: Counts) -> int:
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
    if drifts := drift > special.chdtri(frames - 1, _BY_CHANCE) / (frames - 1):
        error *= special.stdtrit(frames - 1, 0.975) / special.ndtri(0.975)  # so few frames know little of their scatter
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


# --- frames two by two ------------------------------------------------------------------------------------------------

BLOCK = 48
"""Pixels a side of the blocks by whose scatter errors are told: whole periods of every CFA."""

# Differences are standardised, and held in sixteenths of a standard deviation, up to eight of them: no single outlier
# decides anything. Their squares are summed up to four, so that heavy tails do no harm.
_UNITS = 16
_LIMIT, _CLIP = 8 * _UNITS - 1, 4 * _UNITS
_MOST_PIXELS = 1 << 22  # of a frame; of larger ones evenly spread bands of rows are looked at

LAGS = np.array([(0, 1), (0, 2), (1, -2), (1, -1), (1, 0), (1, 1), (1, 2), (2, -2), (2, -1), (2, 0), (2, 1), (2, 2)])
"""Rows and columns between two neighbours; one of each two opposite directions."""

# What pixels far apart share, in the same row, in the same column, and in neither: drift, and what rounding makes of
# row noise that is larger than the pixels' own. 36 columns are beyond the reach of any filter in a raw file, and whole
# periods of Bayer and of X-Trans.
_FAR = np.array([(0, 36), (0, 48), (12, 0), (18, 0), (1, 36), (2, 36), (1, -36), (2, -36)])
_FAR_KINDS = np.array([0, 0, 1, 1, 2, 2, 2, 2])


@dataclass(frozen=True, slots=True, eq=False)
class BiasStatistics:
    """What pairs of bias frames show, by block of 48 x 48 pixels.

    A block counts twice: with the level of every second period of its columns and the variance of the others, and the
    other way round. So a pixel that is both brighter and noisier than the others, by telegraph noise or dark current of
    its own, does not tie the two.

    Attributes
    ----------
    sigma_dn
        Standard deviation of the noise of a frame, with rounding.
    level_dn
        (2, rows, columns): mean of one half of the block over its channels' means.
    variance
        (2, rows, columns): of the other half's noise over time, clipped at four standard deviations; the mean one
        counts as 1.
    correlation, correlation_error
        (lags,) of the temporal noise of neighbours (:data:`LAGS`), less that of pixels far apart; and the standard
        error of each where there is none.
    codes
        (channels, 65536) sound pixels by value.
    """

    sigma_dn: float
    level_dn: Values = field(repr=False)
    variance: Values = field(repr=False)
    correlation: Values
    correlation_error: float
    codes: Counts = field(repr=False)


class BiasPairs:
    """The bias frames that made a fixed pattern, two by two: half of a squared difference is the noise's variance.

    The memory is a copy of every second frame, of 4 megapixels at most.

    Parameters
    ----------
    fixed
        The first pass's result. Add the same frames again, each once.
    """

    def __init__(self, fixed: FixedPattern) -> None:
        height, width = fixed.total_dn.shape
        self._fixed, rows = fixed, height // BLOCK
        self._width = width // BLOCK * BLOCK
        step = max(1, math.ceil(rows * BLOCK * width / _MOST_PIXELS))
        self._bands = [slice(place * BLOCK, (place + 1) * BLOCK) for place in range(0, rows, step)]
        sigma = np.sqrt(np.maximum(fixed.temporal_variance_dn2, 1e-6))
        self._sigma_dn = math.sqrt(float(np.mean(sigma**2)))
        self._scale = (_UNITS / (math.sqrt(2) * sigma)).astype(np.float32)
        self._halves = [np.arange(self._width) // len(fixed.pattern) % 2 == half for half in (0, 1)]
        self._first: Mosaic | None = None
        self._squares = np.zeros((2, len(self._bands), self._width // BLOCK))
        self._pairs = 0
        self._codes = np.zeros((len(fixed.level_dn), 65536), dtype=np.int64)
        self._lags = np.concatenate([LAGS, _FAR])
        self._products = np.zeros(len(self._lags), dtype=np.int64)
        self._lag_pairs, self._induced = np.zeros((2, len(self._lags)))
        self._by_means = np.array([0.0 if down else _induce(fixed.pattern, across) for down, across in self._lags])
        self._all_squares = self._pixels = 0

    def add(self, mosaic: Mosaic) -> None:
        """Add a bias frame."""
        defects, pattern = self._fixed.defects, self._fixed.pattern
        for rows in self._bands:
            loops.channel_histograms(mosaic[rows], defects[rows], pattern, self._codes[None])
        if self._first is None:
            self._first = np.stack([mosaic[rows] for rows in self._bands])
            return
        for index, rows in enumerate(self._bands):
            band = np.empty(self._first[index].shape, dtype=np.int16)
            loops.standardise(self._first[index], mosaic[rows], defects[rows], pattern, self._scale, _LIMIT, band)
            self.add_neighbours(band)
            values = np.clip(band[:, : self._width], -_CLIP, _CLIP).astype(np.int32)
            values *= values
            for half, chosen in enumerate(self._halves):
                self._squares[half, index] += _sum_by_block(values * ~chosen)
        self._first = None
        self._pairs += 1

    def add_neighbours(self, band: NDArray[np.int16]) -> None:
        """Add rows of the standardised difference of two frames; they start with the pattern's first."""
        height, width = band.shape
        loops.lag_products(band, self._lags, self._products)
        self._all_squares += int(np.einsum("ij,ij->", band, band, dtype=np.int64))
        self._pixels += band.size
        pairs = (height - self._lags[:, 0]) * (width - np.abs(self._lags[:, 1]))
        self._lag_pairs += pairs
        self._induced += pairs * self._by_means / width

    def correlation(self) -> tuple[Values, float]:
        """Return the correlation of the noise of neighbours, and the largest standard error of it."""
        variance = self._all_squares / self._pixels
        correlation = self._products / (self._lag_pairs * variance) - self._induced / self._lag_pairs
        near = len(LAGS)
        kinds = np.where(LAGS[:, 0] == 0, 0, np.where(LAGS[:, 1] == 0, 1, 2))
        far = np.array([correlation[near:][kind == _FAR_KINDS].mean() for kind in range(3)])
        # The product of two independent values has the variance of the one times that of the other, whatever their
        # tails. The mean of the far ones adds to it.
        error = np.sqrt((1 + 1 / np.bincount(_FAR_KINDS)[kinds]) / self._lag_pairs[:near])
        return correlation[:near] - far[kinds], float(error.max())

    def statistics(self) -> BiasStatistics:
        """Return the statistics of the pairs so far."""
        fixed, width, period = self._fixed, self._width, len(self._fixed.pattern)
        own = np.array(fixed.level_dn)[np.tile(fixed.pattern, (BLOCK // period, width // period))]
        levels, pixels = np.zeros((2, *self._squares.shape))
        for index, rows in enumerate(self._bands):
            sound = ~fixed.defects[rows, :width]
            above = np.where(sound, fixed.total_dn[rows, :width] / fixed.frames - own, 0.0)
            for half, chosen in enumerate(self._halves):
                levels[half, index] = _sum_by_block(above * chosen) / np.maximum(_sum_by_block(sound & chosen), 1)
                pixels[half, index] = np.maximum(_sum_by_block(sound & ~chosen), 1)
        variance = self._squares / (self._pairs * pixels) / _UNITS**2
        return BiasStatistics(self._sigma_dn, levels, variance, *self.correlation(), self._codes)


def _sum_by_block(band: NDArray[Any]) -> NDArray[Any]:
    """Return the sums over each block of columns of a band."""
    return np.asarray(band.reshape(len(band), -1, BLOCK).sum(axis=(0, 2)))


def _induce(pattern: Counts, across: int) -> float:
    """Return the correlation that taking off the mean of each row and channel makes at a lag, times the columns."""
    share = np.array([[np.count_nonzero(row == channel) for channel in row] for row in pattern]) / len(pattern)
    alike = np.roll(pattern, -across, axis=1) == pattern
    return -float(np.where(alike, 1 / share, 0.0).mean())
