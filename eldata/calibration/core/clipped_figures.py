"""The figures of bias frames that clip at black, in the records of those that do not; and what cannot be had."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core.colour_bias import ColourBias
from eldata.calibration.core.findings import Finding
from eldata.calibration.core.read_noise import ProbabilityPlot, ReadNoise
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.calibration.core.clipped_black import ClippedFit
    from eldata.calibration.core.defects import FixedPattern

    Values: TypeAlias = NDArray[np.float64]

MOST_ZEROS = 0.75
"""Share of a channel's values that may be 0: of more, what is left is a tail, and which one is not known."""

_STEP = 1e-3


def clipped_read_noise(fit: ClippedFit) -> ReadNoise:
    """Return the read noise. What takes residuals, PPCC, there is none of: ``nan``."""
    plot = clipped_plot(fit)
    weights = np.exp(-0.5 * plot.normal**2)
    gauss = fit.scale * math.sqrt(tukey_lambda_variance(fit.shape))
    growth = math.log(tukey_lambda_variance(fit.shape + _STEP) / tukey_lambda_variance(fit.shape - _STEP)) / (4 * _STEP)
    slopes = np.array([growth, 1.0])  # of ln sigma_G by shape and ln scale
    covariance = fit.covariance[:2, :2]
    errors = np.sqrt(np.diag(covariance))
    return ReadNoise(
        tukey_lambda=fit.shape,
        tukey_lambda_error=float(errors[0]),
        sigma_tl_dn=fit.scale,
        sigma_tl_error_dn=float(errors[1]) * fit.scale,
        correlation=float(covariance[0, 1] / (errors[0] * errors[1])),
        information_errors=(math.sqrt(fit.information[0, 0]), math.sqrt(fit.information[1, 1]) * fit.scale),
        sigma_gauss_dn=gauss,
        sigma_gauss_error_dn=gauss * math.sqrt(float(slopes @ covariance @ slopes)),
        ppcc_lambda=math.nan,
        ppcc_sigma_tl_dn=math.nan,
        ppcc_lambda_plain=math.nan,
        ppcc_sigma_plain_dn=math.nan,
        curve=np.zeros((2, 0)),
        r_squared_tl=_correlation(plot.tukey_lambda, plot.ordered_dn, weights) ** 2,
        r_squared_gauss=_correlation(plot.normal, plot.ordered_dn, weights) ** 2,
        chi2_per_dof=fit.chi2_per_dof,
        chi2_freedom=fit.freedom,
        residuals=fit.values,
        beyond=0,
        converged=fit.converged,
        response=fit.response,
    )


def _correlation(first: Values, second: Values, weights: Values) -> float:
    one, two = (values - np.average(values, weights=weights) for values in (first, second))
    return float(weights @ (one * two) / math.sqrt(float(weights @ one**2) * float(weights @ two**2)))


def clipped_plot(fit: ClippedFit) -> ProbabilityPlot:
    """Return the probability plots of what lies above 0: values less their channel's level.

    The fitted quantiles are those of read noise, pattern and row noise together, over the read noise's scale.
    """
    weights = np.exp(-0.5 * fit.normal_quantiles**2)
    normal_slope = float(weights @ (fit.quantiles_dn * fit.normal_quantiles) / (weights @ fit.normal_quantiles**2))
    return ProbabilityPlot(
        ordered_dn=fit.quantiles_dn,
        normal=fit.normal_quantiles,
        tukey_lambda=fit.fitted_quantiles_dn / fit.scale,
        shape=fit.shape,
        slope_normal_dn=normal_slope,
        slope_tukey_lambda_dn=fit.scale,
    )


def clipped_bias(fit: ClippedFit, recorded: ColourBias, fixed: FixedPattern) -> ColourBias:
    """Return the colour bias: the fitted levels, which lie below the recorded means, over the recorded black.

    Parameters
    ----------
    fit
        Of the frames.
    recorded
        The bias of the recorded means.
    fixed
        Whose levels are these recorded means.
    """
    black = np.array(fixed.level_dn) - recorded.bias_dn  # up to drift, which the mean over frames holds as well
    deviations = (recorded.frame_bias_dn - np.array(recorded.bias_dn)) / fit.recorded_slope
    # What frames drift by, beyond what their pixels and rows scatter by, is not in the scatter between groups of rows.
    by_rows = np.array(recorded.row_error_dn) ** 2 * recorded.frames / fit.recorded_slope**2
    drift = np.maximum((deviations**2).sum(axis=0) / max(recorded.frames - 1, 1) - by_rows, 0.0)
    errors = np.sqrt(np.diag(fit.covariance)[2:] + drift / recorded.frames)
    bias = fit.level_dn - black
    return ColourBias(
        bias_dn=tuple(bias.tolist()),
        standard_error_dn=tuple(errors.tolist()),
        row_error_dn=tuple((np.array(recorded.row_error_dn) / fit.recorded_slope).tolist()),
        frame_bias_dn=bias + deviations,
        frames=recorded.frames,
    )


def unclipped_pattern(fixed: FixedPattern, fit: ClippedFit) -> FixedPattern:
    """Return the fixed pattern with levels, non-uniformity and shading as they are behind the clip."""
    summary = replace(
        fixed.summary,
        dsnu_dn=tuple(fit.dsnu_dn.tolist()),
        dsnu_error_dn=tuple(fit.dsnu_error_dn.tolist()),
        shading_dn=fit.shading_dn,
    )
    return replace(fixed, level_dn=tuple(fit.level_dn.tolist()), summary=summary)


def clipped_findings(fit: ClippedFit, read: ReadNoise, bias: ColourBias) -> Iterator[Finding]:
    """Yield what the clip leaves of the figures."""
    zeros = float(fit.zeros.max())
    if zeros > MOST_ZEROS:
        yield Finding(
            "clipped black",
            ("read noise", "row noise", "colour bias"),
            "withheld",
            zeros,
            MOST_ZEROS,
            f"{zeros:.0%} of the values of a channel are 0, so that only a tail of the noise is recorded: neither its "
            "shape nor the level that it belongs to is known from that; use raw files that keep the black level, or "
            "state this camera's noise from another source",
        )
        return
    yield Finding(
        "clipped black",
        (),
        "remark",
        zeros,
        0.0,
        f"the camera clips at black: {zeros:.1%} of the values are 0. The noise is fitted to what lies above, taken "
        "to be symmetric, with a normal pattern; light, dark current, unlike pixels and lopsided noise cannot be told "
        "from the clip and were not looked for",
    )
    # As standard errors: with 1/sqrt(3) of it, that a pattern as far from normal as Laplace's makes lies within 1.96.
    allowed = np.abs(fit.if_laplace) / math.sqrt(3)
    shape, scale, level = float(allowed[0]), float(allowed[1]), float(allowed[2:].max())
    errors = max(shape / read.tukey_lambda_error, scale * read.sigma_tl_dn / read.sigma_tl_error_dn)
    if errors > 1:
        yield Finding(
            "pattern behind the clip",
            ("read noise",),
            "wider",
            errors,
            1.0,
            "the pixels' own levels, which cannot be taken off below the clip, are not small beside the noise, and "
            f"were taken to be normal: if their distribution is another, lambda is off by some {shape:.2g} and "
            f"sigma_TL by {scale:.1%}",
            allowance=max(shape, scale),
        )
    if level > min(bias.standard_error_dn):
        yield Finding(
            "pattern behind the clip",
            ("colour bias",),
            "wider",
            level,
            min(bias.standard_error_dn),
            f"the level below the clip follows from the same distribution: it may be off by {level:.2g} DN",
            allowance=level,
        )
