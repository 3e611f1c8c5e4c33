"""Which assumptions of the estimates the frames of one ISO do not keep: checks of bias frames, of their fit, of flats.

The chance that a check of bias frames speaks without its fault is below one in 100,000, so that a camera of a dozen
ISOs does not meet one; thresholds follow from that and from the number of blocks, pixels and frames.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from eldata.calibration import iso_results as findings
from eldata.calibration.bias_sums import LAGS, BiasStatistics, BiasSums, ColourBias, LineNoise, RowNoise
from eldata.calibration.flats import FlatPairs, PhotonTransfer, PhotonTransferLine, straight_line
from eldata.calibration.iso_results import Finding, IsoCalibration, Quantity, fill_sentence
from eldata.calibration.residuals import ReadNoise, read_noise
from eldata.calibration.tukey_lambda import NEARLY_NORMAL, Ripple
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldata.calibration.bias_sums import ResidualHistogram
    from eldata.calibration.sums import Counts, Mask, Values

# --- bias frames ------------------------------------------------------------------------------------------------------

_OF_LIGHTER_TAILS = 2.0  # what is added to the noise makes its tails lighter: sigma_TL goes up by so much of sigma_G's


def bias_findings(
    statistics: BiasStatistics, bias: ColourBias, rows: RowNoise, read: ReadNoise, step_dn: float = 1.0
) -> tuple[Finding, ...]:
    """Check the bias frames' noise for light, for correlation of neighbours, and for coarse values.

    Parameters
    ----------
    statistics
        Of the frames two by two.
    bias, rows, read
        The figures from the same frames, with their errors: a finding that matters less is a remark.
    step_dn
        By how many DN the values step: what :func:`code_step` says, or of uneven steps :func:`mean_step`.
    """
    ripple = Ripple.of(read.tukey_lambda, read.sigma_tl_dn / step_dn)
    return (
        *_find_light(statistics, bias, read, ripple),
        *_find_correlation(statistics, rows, read, ripple),
        *_find_steps(rows, read, step_dn),
    )


def _share_errors(read: ReadNoise, share: float) -> dict[Quantity, tuple[float, float]]:
    """Return the share by which each figure of the read noise may be off, and the smallest relative error of them."""
    of_scales = read.sigma_tl_error_dn / read.sigma_tl_dn, read.sigma_gauss_error_dn / read.sigma_gauss_dn
    error = min(read.tukey_lambda_error, *of_scales)
    return {"shape": (share, error), "read noise": (share, error)}


def _find_light(statistics: BiasStatistics, bias: ColourBias, read: ReadNoise, ripple: Ripple) -> Iterator[Finding]:
    """Yield a finding if the variance of blocks grows with their level, as with light and dark current.

    Shading without light has no such slope. Least squares over the blocks; their variances are means of thousands of
    squares clipped at four standard deviations, so that the slope over its standard error follows Student's t. A smooth
    shading (of second order) would hide a faint light, so the slope is also taken with one allowed for: two tests.
    """
    level, variance = statistics.level_dn, statistics.variance.ravel()
    _, rows, columns = level.shape
    _, y, x = np.meshgrid((0, 1), np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    flat = np.ones((level.size, 1))
    smooth = np.stack([part.ravel() for part in (np.ones_like(x), x, y, x * y, x**2, y**2)], axis=1)
    slopes = (_fit_slope(level.ravel(), variance, shading, ripple) for shading in (flat, smooth))
    statistic, slope, over_dark = max(slopes, key=lambda test: test[0])
    threshold = float(special.stdtrit(level.size - 7, 1 - findings.CHANCE / 2))
    if statistic <= threshold:
        return
    share = 0.5 * slope * over_dark
    text = fill_sentence("findings.light", slope=slope * statistics.sigma_dn**2, share=share)
    yield from findings.LIGHT.judge(statistic, threshold, text, _share_errors(read, share))
    # Half a DN may be in the colour bias, or in loud noise a fifth of its standard deviation.
    if over_dark > max(0.5, 0.2 * statistics.sigma_dn):
        yield findings.LIGHT.withhold(statistic, threshold, text, ("colour bias",), over_dark)
    elif over_dark > min(bias.standard_error_dn):
        yield findings.LIGHT.find(statistic, threshold, text, "wider", ("colour bias",), over_dark)


def _fit_slope(level: Values, variance: Values, shading: Values, ripple: Ripple) -> tuple[float, float, float]:
    """Return t of the slope of variance over level, the slope, and the mean level over the darkest twentieth's.

    A variance that ripples with the level by r, from rounding, has a slope over the level in standard deviations of r /
    2 at most.
    """
    own, noise = (values - shading @ np.linalg.lstsq(shading, values, rcond=None)[0] for values in (level, variance))
    spread = float(own @ own)
    slope = float(own @ noise) / spread
    left = noise - slope * own
    error = math.sqrt(float(left @ left) / (level.size - shading.shape[1] - 1) / spread)
    by_rounding = ripple.variance / 2 / math.sqrt(spread / level.size)
    return (slope - by_rounding) / error, slope, float(own.mean() - np.quantile(own, 0.05))


def _find_correlation(statistics: BiasStatistics, rows: RowNoise, read: ReadNoise, ripple: Ripple) -> Iterator[Finding]:
    """Yield a finding if neighbouring pixels share noise in the bias frames.

    Beside what a filter takes from the pixels, the mean of a row's pixels scatters by more, or less, than that of as
    many independent ones, which the row noise is measured against.
    """
    correlation, error = statistics.correlation, statistics.correlation_error
    # Each correlation, and their two sums along the axes. The error needs no assumption on the distribution, and sums
    # of so many products are normal. Where row noise moves neighbours of one level over the steps of the values
    # together, they share a mean that ripples by r, and so a correlation of r^2 / 4 at most.
    along = [np.equal(LAGS, lag).all(axis=1) | np.equal(LAGS, lag[::-1]).all(axis=1) for lag in ((0, 1), (0, 2))]
    axes = [float(correlation[chosen].sum()) / math.sqrt(2) for chosen in along]
    tests = (np.abs(np.array([*correlation, *axes])) - ripple.mean**2 / 4) / error
    statistic, threshold = float(tests.max()), -float(special.ndtri(findings.CHANCE / 2 / tests.size))
    if statistic <= threshold:
        return
    is_clear = np.abs(correlation) > 3 * error

    def sum_of(chosen: Mask) -> float:
        """Return the sum of correlations, above -1/2; a filter leaves 1 / (1 + 2 sum) of independent noise."""
        return max(float(correlation[chosen].sum()), -0.49)

    share = abs(math.sqrt(1 + 2 * sum_of(is_clear)) - 1)
    line = rows.rows
    of_pixels = 2 * sum_of(is_clear & (LAGS[:, 0] == 0)) * rows.pixel_variance_dn2 / len(rows.columns.fixed_dn)
    of_rows = math.hypot(share, of_pixels / (2 * max(line.variance_dn2, 1e-12)))
    shares = {**_share_errors(read, share), "row noise": (of_rows, line.relative_error)}
    text = fill_sentence("findings.correlated", largest=correlation[np.abs(correlation).argmax()])
    yield from findings.CORRELATED.judge(statistic, threshold, text, shares)


# --- steps of the values ----------------------------------------------------------------------------------------------

_UNEVEN_DN = 1.02
_STRAY = 1e-3  # of the pixels: values that the camera has made up


def _find_steps(rows: RowNoise, read: ReadNoise, step_dn: float) -> Iterator[Finding]:
    """Yield a finding if the values step by more than a DN: by some DN everywhere, or unevenly.

    Rounding to steps of s adds ``(s^2 - 1) / 12`` more to the variance than the model's rounding to whole DN.
    """
    if step_dn <= _UNEVEN_DN:
        return
    added = (step_dn**2 - 1) / 12
    kind = "even-steps" if step_dn.is_integer() else "uneven-steps"
    text = fill_sentence(f"findings.{kind}", step=step_dn, added=added)
    share = _OF_LIGHTER_TAILS * (1 - math.sqrt(max(1 - added / max(read.sigma_gauss_dn, 1e-12) ** 2, 0.0)))
    shares = _share_errors(read, share)
    if not step_dn.is_integer():  # the mean does not follow the level evenly
        shares["row noise"] = (share / _OF_LIGHTER_TAILS, rows.rows.relative_error)
    yield from findings.COARSE.judge(step_dn, _UNEVEN_DN, text, shares)


def mean_step(codes: Counts) -> float:
    """Return the mean step of the values of frames over the pixels, DN, in the channel where it is widest.

    1 of a plain converter. Lossy compression by a curve, multiplication after the conversion and fewer bits than the
    file has room for leave out values between others. Wider gaps lie between two levels.

    Parameters
    ----------
    codes
        (channels, values) pixels by value.
    """
    worst = 1.0
    for counts in codes:
        below = np.cumsum(counts)
        low, high = (int(np.searchsorted(below, share * int(below[-1]))) for share in (0.05, 0.95))
        if int(counts[low : high + 1].sum()) < 30 * (high + 1 - low):
            continue  # too few of each to tell a gap from chance
        used = np.flatnonzero(counts > _STRAY * int(counts.max()))
        used = used[max(0, np.searchsorted(used, low) - 1) : np.searchsorted(used, high, "right") + 1]
        gaps, pixels = np.diff(used), counts[used[1:]] + counts[used[:-1]]
        if gaps.size:
            near = gaps <= 4 * gaps[np.argmax(pixels)]
            worst = max(worst, float(np.average(gaps[near], weights=pixels[near])))
    return worst


def code_step(codes: Counts) -> int:
    """Return the step of the values of frames, DN: 1, or 4 where 12 bits are stored as 14; 0 if it is not known.

    The greatest common divisor, up to 64 DN, of the distances from each channel's most frequent value, of all but one
    in a thousand of the pixels that have another; of fewer than a thousand such pixels it is not known.

    Parameters
    ----------
    codes
        (channels, values) pixels by value.
    """
    away = np.zeros(codes.shape[1], dtype=np.int64)
    for counts in codes:
        usual = int(counts.argmax())
        away[1 : usual + 1] += counts[:usual][::-1]
        away[1 : len(counts) - usual] += counts[usual + 1 :]
    changed = int(away.sum())
    if changed < 1000:
        return 0
    return next(step for step in range(64, 0, -1) if away[::step].sum() >= (1 - _STRAY) * changed)


def read_noise_in_steps(residuals: ResidualHistogram, step: int) -> ReadNoise | None:
    """Estimate the read noise of values rounded to steps of several DN; rounding errors count as uniform.

    ``None`` for a step of 1 DN, or where rounding depends on the noise: where the noise that is found would ripple by a
    fiftieth of its variance from one step to the next.
    """
    if step <= 1:
        return None
    read = read_noise(replace(residuals, rounding_dn=float(step), level_waves=np.zeros(1, complex)))
    ripple = Ripple.of(read.tukey_lambda, read.sigma_tl_dn / step)
    return read if read.converged and ripple.variance < 0.02 else None


def take_step(record: IsoCalibration) -> IsoCalibration:
    """Replace the ISO's read noise by its estimate without rounding to steps, if that is known."""
    if record.stepped is None:
        return record
    step, read = record.step_dn, record.stepped
    replaced = {check.name for check in (findings.COARSE, findings.FIT, findings.SHAPE, findings.ROUNDING)}
    others = (finding for finding in record.findings if finding.check not in replaced)
    of_steps = read_noise_findings(read, record.bias, record.rows.rows, step, step)
    found = (*others, *of_steps, findings.COARSE.find(step, 1.0, fill_sentence("findings.common-step", step=step)))
    return replace(record, read=read, findings=found, quantisation_step_dn=float(step))


# --- read noise -------------------------------------------------------------------------------------------------------

_MOST_ERROR = 0.15  # of lambda, and of sigma_TL as a share: beyond, neither figure nor error means anything
_MOST_RIPPLE = 0.3  # of the variance: beyond, not even sigma_G is known
_MOST_IN_ROWS = 0.3  # of sigma_row
# Measured, from 0.3 to 0.8 DN, with the ripple of the variance, peak to peak, for 1: of bodies without fixed pattern,
# shifts of lambda and sigma_TL are up to 2 (relative ones) and of sigma_G up to 0.4; where levels lie anywhere, 0.2 and
# 0.04 with its square for 1, as the noise of pixels then differs.
_OF_RIPPLE, _OF_RIPPLE_IN_SIGMA = 2.0, 0.5
_OF_SQUARE, _OF_SQUARE_IN_SIGMA = 0.2, 0.05


def find_clipping(sums: BiasSums) -> Finding:
    """Return the finding that values end at the floor, so that the noise below is gone."""
    fixed = sums.fixed
    share = sums.at_floor / (fixed.frames * fixed.total_dn.size)
    text = fill_sentence("findings.clipped", floor=fixed.floor_dn, percent=100 * share)
    return findings.CLIPPED.withhold(share, 0.0, text)


def read_noise_findings(
    read: ReadNoise, bias: ColourBias, rows: LineNoise, step_dn: float = 1.0, rounding_dn: float = 1.0
) -> tuple[Finding, ...]:
    """Check the fit of the read noise, and what rounding does to the figures.

    It is to steps of ``step_dn`` in the mean; the read noise is beside one to steps of ``rounding_dn``.

    The fit's chi^2 has as many degrees of freedom as cells, less the parameters. What it is above 1 per degree, the
    errors are to be larger: a misfit of that size along the direction that a parameter moves would shift it so far.
    """
    limit = float(special.chdtri(read.chi2_freedom, 1e-6)) / read.chi2_freedom  # by chance once in a million fits
    misfit = math.sqrt(read.chi2_per_dof - 1) if read.chi2_per_dof > limit else 0.0
    error = math.hypot(1.0, misfit) * read.largest_error
    found = list(_find_rounding(read, bias, rows, step_dn, rounding_dn))
    if not read.converged:
        text = fill_sentence("findings.no-end", residuals=read.residuals)
        found.append(findings.SHAPE.withhold(math.inf, _MOST_ERROR, text))
    elif not error < _MOST_ERROR:
        of_misfit = f", {math.hypot(1, misfit):.1f} times as much by their misfit" if misfit else ""
        errors = {"shape": read.tukey_lambda_error, "scale": read.sigma_tl_error_dn / read.sigma_tl_dn}
        text = fill_sentence("findings.no-shape", residuals=read.residuals, misfit=of_misfit, **errors)
        found.append(findings.SHAPE.withhold(error, _MOST_ERROR, text))
    elif misfit:
        text = fill_sentence("findings.misfit", chi2=read.chi2_per_dof, limit=limit)
        found.append(
            findings.FIT.find(read.chi2_per_dof, limit, text, "wider", findings.READ, misfit * read.largest_error)
        )
    return tuple(found)


def _find_rounding(
    read: ReadNoise, bias: ColourBias, rows: LineNoise, step_dn: float, rounding_dn: float
) -> Iterator[Finding]:
    """Yield the findings on quiet noise, whose figures rounding to steps of so many DN changes.

    It adds a twelfth to the variance, whatever the noise, only where the pixels' levels lie everywhere between two
    steps, or the noise is wide. Where they share a fraction of one, it makes noise smaller or larger, moves the mean,
    and hides offsets of rows or enlarges them, by what :class:`Ripple` says; the rows' own offsets spread the levels.
    """
    added_dn = math.sqrt(max(step_dn**2 - rounding_dn**2, 0.0) / 12)
    sigma = math.sqrt(max(read.sigma_gauss_dn**2 - added_dn**2, 0.0))
    quietest = 0.4 * step_dn  # below, rounding decides what is recorded
    steps = f"steps of {step_dn:.3g}" if step_dn > 1 else "whole"
    if not sigma >= quietest:
        text = fill_sentence("findings.too-quiet", sigma=sigma, quietest=quietest, steps=steps)
        yield findings.ROUNDING.withhold(sigma, quietest, text, ("shape",))
    # How alike the levels' fractions of a DN are says nothing of wider steps.
    alike = (1.0 if step_dn > 1 else read.alike) * math.exp(-2 * (math.pi * rows.sigma_dn / step_dn) ** 2)
    # Rounding itself makes tails light: lighter ones than a normal distribution's are not taken for the noise's.
    shape = min(read.tukey_lambda, NEARLY_NORMAL)
    scale = sigma / math.sqrt(tukey_lambda_variance(shape)) / step_dn
    ripple, lower = Ripple.of(shape, scale), 1.0
    recorded = 1 + (step_dn / max(sigma, 1e-12)) ** 2 / 12  # with rounding, of the variance without
    for _ in range(20):  # of the noise as quiet as it may be, if rounding has made it larger
        lower = math.sqrt(max(1 - ripple.variance * alike / 2 * recorded, 0.1))
        ripple = Ripple.of(shape, lower * scale)
    width, shift = ripple.variance * alike, ripple.mean_steps / 2 * step_dn * alike
    changed = "decides whether a pixel changes at all, and changes"
    if math.isfinite(width):
        changed = (
            f"changes the variance of a pixel's noise by up to {ripple.variance / 2:.1%}, as its level lies between "
            f"two values, that of all by up to {width / 2:.1%}, and"
        )
    text = fill_sentence("findings.quiet", sigma=sigma, steps=steps, changed=changed, shift=shift)
    square, of_rows, of_sigma = ripple.variance**2, rows.relative_error, read.sigma_gauss_error_dn / max(sigma, 1e-12)
    off: dict[Quantity, tuple[float, float, float]] = {  # by so much; what is too much, and what is in the error
        "shape": (_OF_RIPPLE * width + _OF_SQUARE * square, _MOST_ERROR, read.largest_error),
        "read noise": (_OF_RIPPLE_IN_SIGMA * width + _OF_SQUARE_IN_SIGMA * square, math.inf, of_sigma),
        "row noise": (2 * math.pi * shift / step_dn, _MOST_IN_ROWS if read.converged else of_rows, of_rows),
        "colour bias": (shift, math.inf, min(filter(math.isfinite, bias.standard_error_dn), default=math.inf)),
    }
    of_width = () if width <= _MOST_RIPPLE else findings.READ if math.isfinite(width) else (*findings.READ, "row noise")
    if lost := tuple(figure for figure, (share, most, _) in off.items() if share > most or figure in of_width):
        yield findings.ROUNDING.withhold(width, _MOST_RIPPLE, text, lost)
    for figure, (share, _, least) in off.items():
        if figure not in lost and share > least:
            yield findings.ROUNDING.find(share, least, text, "wider", (figure,), share)


# --- flats ------------------------------------------------------------------------------------------------------------

# Blur of a share w gives neighbours of one colour a correlation of w, or of w / 2 if it goes along rows and columns
# both, and takes 2 w from the variance: at most four times the correlation.
_LOST_PER_CORRELATION = 4.0
_PILED = 3.0  # times as many pixels as at the values below
_SIGNIFICANT = 5.0  # standard errors
_OF_ERROR = 0.2  # of K: less is in it


def find_saturation(flats: FlatPairs) -> Iterator[Finding]:
    """Yield a finding if pixels pile up at a value below the recorded white level, as where a sensor saturates.

    The upper end of noise, whatever its light, falls towards the top: there a value is rarer than those below it.
    """
    piles = list(filter(None, (_find_pile(counts, flats.limit_dn) for counts in flats.counts)))
    if not piles:
        return
    levels, overs = zip(*piles, strict=True)
    over = max(overs)
    where = f"{levels[0]} DN" if len(set(levels)) == 1 else f"{min(levels)} to {max(levels)} DN"
    where += "" if len(piles) == flats.channels else f" in {len(piles)} of {flats.channels} channels"
    yield findings.SATURATION.withhold(over, _PILED, fill_sentence("findings.saturation", where=where, over=over))


def _find_pile(counts: Counts, limit_dn: float) -> tuple[int, float] | None:
    """Return the value at which pixels end in a pile, and how many times the counts below it; ``None`` if none do."""
    above = np.cumsum(counts[::-1])[::-1] - counts
    # A hundred pixels, of which chance moves 10 %, and a hundredth of them above; compared with 2 to 34 DN below.
    places = np.flatnonzero((counts >= 100) & (above <= 0.01 * counts))
    for place in places[(places >= 34) & (places < limit_dn)][::-1].tolist():
        over = float(counts[place]) / max(1, int(counts[place - 34 : place - 2].max()))
        if over > _PILED:
            return place, over
    return None


def find_uneven_steps(flats: FlatPairs, transfer: PhotonTransfer) -> Iterator[Finding]:
    """Yield a finding if the values step by more DN the brighter they are, as of files compressed by a curve.

    Rounding to steps of s DN adds s^2 / 12 to the variance; its slope over the light is in K.
    """
    added, largest, together = [], 1.0, 8  # neighbouring codes that show a step, of ten pixels each at least
    for channel, line in enumerate(transfer.channels):
        counts = flats.counts[channel, : math.ceil(flats.limit_dn)]
        codes = np.flatnonzero(counts)
        pixels = np.convolve(counts[codes], np.ones(together + 1), "valid")
        known = pixels >= 10 * (together + 1)
        if not known.any():
            return
        # The median: between flats of two levels there may be nothing.
        steps = np.median(np.lib.stride_tricks.sliding_window_view(np.diff(codes), together), axis=1)[known]
        places = codes[together // 2 : -together // 2][known] - flats.black[channel]
        rounding, errors = np.interp(line.signal_dn, places, steps**2 / 12), line.variance_error_dn2
        added.append(straight_line(line.signal_dn, rounding, errors**-2, errors**2)[0])
        largest = max(largest, float(steps.max()))
    share, error = float(np.mean(added)) / transfer.gain_dn_per_e, transfer.gain_error / transfer.gain_dn_per_e
    if abs(share) > _OF_ERROR * error:
        text = fill_sentence("findings.curve", largest=largest, share=share)
        yield from findings.COARSE.judge(abs(share), _OF_ERROR * error, text, {"gain": (abs(share), _OF_ERROR * error)})


def find_flat_correlation(transfer: PhotonTransfer) -> Iterator[Finding]:
    """Yield a finding if noise of neighbouring pixels is correlated in the flats."""
    correlation, error = transfer.correlation, transfer.correlation_error
    # By chance once in 10,000 ISOs; of 0.2 % of K, a correlation is not worth a word.
    threshold = float(-special.ndtri(1e-4 / 2)) * error + 0.002 / _LOST_PER_CORRELATION
    if not abs(correlation) > threshold:
        return
    smoothed = "the frames were smoothed or resampled, or the picture moved between the two of a pair"
    why = smoothed if correlation > 0 else "the frames were sharpened"
    text = fill_sentence("findings.flats-correlated", correlation=correlation, why=why)
    off: dict[Quantity, tuple[float, float]] = {"gain": (_LOST_PER_CORRELATION * abs(correlation), 0.0)}
    yield from findings.FLATS_CORRELATED.judge(abs(correlation), threshold, text, off)


def find_bent_line(transfer: PhotonTransfer) -> Iterator[Finding]:
    """Yield a finding if medians of the pairs' segments have no line of variance over signal, or another one than K.

    Edges that move between the two frames of a pair are in the mean and, up to a half of the segments, not in the
    median; a response that is not linear, or that saturates by degrees, bends the line of both.
    """
    pairs = zip(transfer.channels, transfer.medians, strict=True)
    lines = [_fit_medians(line, *points) for line, points in pairs if points.shape[1] >= 3 and np.ptp(points[0]) > 0]
    if not lines:
        return
    gain = transfer.gain_dn_per_e
    slopes, errors, bends, bend_errors = np.array(lines).T
    tests = []
    for off, error in ((slopes / gain - 1, errors / gain), (bends, bend_errors)):
        weights = error**-2.0
        if (total := weights.sum()) > 0:
            its_error = math.hypot(float(total**-0.5), transfer.gain_error / gain)
            tests.append((abs(float(weights @ off / total)), its_error))
    share, error = max(tests, key=lambda test: test[0] / test[1])
    if not share > _SIGNIFICANT * error:
        return
    text = fill_sentence("findings.bent", off=slopes.mean() / gain - 1, bend=bends.mean())
    yield from findings.NO_LINE.judge(
        share / error, _SIGNIFICANT, text, {"gain": (max(test[0] for test in tests), 0.0)}
    )


def _fit_medians(
    line: PhotonTransferLine, x: Values, v: Values, relative_error: Values
) -> tuple[float, float, float, float]:
    """Return slope and error of the line through points, and how far a parabola's slope at no light is off it."""
    error = relative_error * np.maximum(line.variance_at(x), 1e-9)  # of a variance's own: high ones would weigh less
    slope, _, (of_slope, _) = straight_line(x, v, error**-2, error**2)
    if len(x) < 4:
        return slope, math.sqrt(of_slope), 0.0, math.inf
    powers = np.stack([x**2, x, np.ones_like(x)], axis=1) / error[:, None]
    # Of v = a + b x + q x^2, b is the slope at no light; the line takes `tilt` q of the square for slope.
    of_square = np.linalg.pinv(powers / np.abs(powers).max(axis=0))[0] / np.abs(powers[:, 0]).max()
    tilt, _, _ = straight_line(x, x**2, error**-2, error**2)
    q, q_error = float(of_square @ (v / error)), float(np.linalg.norm(of_square))
    return slope, math.sqrt(of_slope), -q * tilt / slope, abs(tilt * q_error / slope)
