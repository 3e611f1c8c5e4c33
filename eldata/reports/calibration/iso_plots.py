"""Plots of what was measured at one ISO: the figures with which the paper judges its noise model."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.acceptance.verdicts import LIMIT
from eldata.plots.axes import (
    MARKERS,
    Theme,
    deviation_band,
    evenly,
    legend_above,
    log_ticks,
    one_axes,
    quantile_plot,
    thinned,
    two_axes,
)
from eldata.plots.gains import transfer_lines
from eldata.reports.figures import Plot, drawn
from eldata.reports.html import digits, measured, plot_words

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from eldata.calibration.acceptance.reproduction import Reproduction
    from eldata.calibration.core.findings import GivenFigure
    from eldata.calibration.core.photon_transfer import PhotonTransfer
    from eldata.calibration.iso_results import IsoCalibration, IsoGain

GAUSSIAN_LAMBDA = 0.14
"""The shape at which the Tukey-lambda distribution is nearest to the normal one."""

_SINGLE_FRAMES_SHOWN = 48
_ROOM_ABOVE = 1.7
_AROUND_MAXIMUM = 0.27  # of lambda
_FRAMES_SHOWN = 32


def estimated(figure: GivenFigure | None, unit: str = "") -> str:
    """Return a figure with its error and unit, or "withheld"."""
    if figure is None:
        return "withheld"
    return measured(figure.value, figure.error, unit) + (" (stated)" if figure.is_stated else "")


def _plot(kind: str, one: IsoGain, alt: str, draw: Callable[[Theme], Figure], more: str = "") -> Plot:
    """Return a plot of one ISO, with the words of its kind."""
    said = plot_words("calibration")[kind]
    return drawn(f"{kind}-{one.iso:g}", said["title"], alt, said["caption"] + more, draw)


# --- photon transfer ----------------------------------------------------------------------------------------------


def transfer_plot(one: IsoGain, transfer: PhotonTransfer) -> Plot:
    """Draw the variance over the signal, the fitted lines, and the deviations from them."""
    spatial, spatial_gain = one.spatial, one.spatial_gain
    worst = max((line.chi2_per_dof for line in transfer.channels if math.isfinite(line.chi2_per_dof)), default=math.nan)
    alt = (
        f"Variance against signal of the flats at ISO {one.iso:g}, by channel, with the fitted lines: K is "
        f"{estimated(one.gain, 'DN/e⁻')}, chi² per degree of freedom at most "
        f"{digits(worst, 2)}."
    )
    more = ""
    if spatial is not None:
        if spatial_gain is not None:
            alt += f" The published single-frame method gives {digits(spatial_gain.value, 4)} DN/e⁻."
        more = plot_words("calibration")["transfer"]["single_frames"]

    def draw(theme: Theme) -> Figure:
        drawing, main, below = two_axes(2.6)
        furthest = transfer_lines(main, below, one.channels, transfer.channels, theme)
        if spatial is not None:
            _single_frames(main, spatial, theme)
            legend_above(main)
        deviation_band(below, furthest, LIMIT, theme)
        below.set_xlabel("signal [DN]")
        return drawing

    return _plot("transfer", one, alt, draw, more)


def _single_frames(axes: Axes, spatial: PhotonTransfer, theme: Theme) -> None:
    """Draw the published method's points; those far above the others as arrows, or they would flatten the rest."""
    signal = np.concatenate([line.signal_dn for line in spatial.channels])
    variance = np.concatenate([line.variance_dn2 for line in spatial.channels])
    shown = evenly(signal.size, _SINGLE_FRAMES_SHOWN)
    signal, variance = signal[shown], variance[shown]
    low, high = axes.get_ylim()
    high *= _ROOM_ABOVE
    beyond = variance > high
    axes.set_ylim(low, high)
    style: dict[str, Any] = {"linestyle": "none", "markersize": 6, "color": theme.ink}
    inside = ~beyond
    axes.plot(signal[inside], variance[inside], marker="o", markerfacecolor="none", label="single frames", **style)
    if beyond.any():
        axes.plot(signal[beyond], np.full(beyond.sum(), 0.97 * high), marker="^", label="beyond", **style)


# --- colour bias --------------------------------------------------------------------------------------------------


def bias_plot(one: IsoCalibration, given: Sequence[GivenFigure]) -> Plot:
    """Draw the colour bias, and below how much the frames' own means scatter around it."""
    bias = one.bias
    channels = len(bias.channels)
    found = ", ".join(f"{name} {estimated(figure, 'DN')}" for name, figure in zip(bias.channels, given, strict=True))
    alt = (
        f"Mean of the bias frames over the recorded black level at ISO {one.iso:g}: {found}; and the means of "
        f"{bias.frames} single frames around it."
    )

    def draw(theme: Theme) -> Figure:
        drawing, main, below = two_axes(1 / 1.4)
        frames = evenly(bias.frames, _FRAMES_SHOWN)
        across = np.linspace(-0.3, 0.3, frames.size) if frames.size > 1 else np.zeros(1)
        main.axhline(0, color=theme.theory)
        below.axhline(0, color=theme.theory, linewidth=1)
        for channel in range(channels):
            mean, error = given[channel].value, given[channel].error
            style: dict[str, Any] = {"marker": MARKERS[channel], "color": theme.channels[channel], "linestyle": "none"}
            main.errorbar(channel, mean, yerr=error if math.isfinite(error) else None, capsize=4, **style)
            below.plot(channel + across, bias.frame_bias_dn[frames, channel] - mean, markersize=3.5, **style)
            own = bias.row_error_dn[channel] * math.sqrt(bias.frames)  # of one frame
            if own > 0 and math.isfinite(own):
                heights = np.linspace(-3, 3, 61)
                width = 0.42 * np.exp(-(heights**2) / 2)
                below.fill_betweenx(
                    heights * own, channel - width, channel + width, color=theme.theory, alpha=0.2, linewidth=0
                )
        main.margins(y=0.25)
        main.set_ylabel("mean [DN]")
        below.set_ylabel("frame − mean [DN]")
        below.set_xticks(range(channels), bias.channels)
        below.set_xlim(-0.5, channels - 0.5)
        return drawing

    return _plot("bias", one, alt, draw)


# --- rows ---------------------------------------------------------------------------------------------------------


def rows_plot(one: IsoCalibration) -> Plot:
    """Draw the normal probability plot of the row means."""
    rows = one.rows.rows
    shown = thinned(rows.quantiles.size)
    r_squared, p = digits(rows.r_squared, 5), digits(rows.shapiro_p, 2)
    alt = (
        f"Ordered row means against normal quantiles at ISO {one.iso:g}: R² {r_squared}, Shapiro-Wilk p {p} of "
        f"{rows.shapiro_values} values, excess kurtosis {digits(rows.excess_kurtosis, 2)}."
    )
    draw = partial(
        quantile_plot,
        rows.quantiles[shown],
        rows.ordered_dn[shown],
        rows.normal_line_dn,
        names=("normal", "row means"),
        labels=("normal quantile", "row mean [DN]"),
        note=f"R² {r_squared}\nShapiro-Wilk p {p}",
    )
    return _plot("rows", one, alt, draw)


def line_spectrum_plot(one: IsoCalibration) -> Plot:
    """Draw the periodograms of row and column means, over what the pixels alone would give."""
    rows, columns = one.rows.rows, one.rows.columns
    alt = (
        f"Power of row and column means over what pixel noise alone gives, at ISO {one.iso:g}: σ row "
        f"{estimated(one.sigma_row_dn, 'DN')}, σ column {estimated(one.sigma_column_dn, 'DN')}."
    )

    def draw(theme: Theme) -> Figure:
        drawing, axes = one_axes()
        variance = one.rows.pixel_variance_dn2 or 1.0
        of_pixels = variance / columns.deviations_dn.shape[1]
        for line, alone, colour, style, name in (
            (columns, variance / rows.deviations_dn.shape[1], theme.ink, ":", "columns"),
            (rows, of_pixels, theme.found, "-", "rows"),
        ):
            frequency, power = line.smoothed_power_dn2(len(one.sensor.cfa))
            axes.plot(frequency, power / alone, style, color=colour, label=name)
        if one.sigma_row_dn is not None:
            white = 1 + one.sigma_row_dn.value**2 / of_pixels
            axes.axhline(white, color=theme.theory, label="white noise of σ row")
        axes.axhline(1, color=theme.theory, linewidth=1, linestyle="--", label="pixels alone")
        _log_power(axes)
        axes.set(xlabel="frequency [cycles per line]", ylabel="power / pixels' own")
        axes.legend(loc="best", ncols=2)
        return drawing

    return _plot("line-spectrum", one, alt, draw)


def _log_power(axes: Axes) -> None:
    """Set up a logarithmic axis of power with room for the legend."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    low, high = low / 1.3, high * max(1.6, (high / low) ** 0.35)
    axes.set_ylim(low, high)
    log_ticks(axes.yaxis, max(1, round(math.log10(high / low))))


# --- read noise ---------------------------------------------------------------------------------------------------


def ppcc_plot(one: IsoCalibration, shape: GivenFigure) -> Plot:
    """Draw the correlation of the probability plot over the shape, and the shape that is given."""
    read = one.read
    alt = (
        f"Correlation of the probability plot over the shape λ at ISO {one.iso:g}: highest at "
        f"{digits(read.ppcc_lambda_plain)} on the residuals, {digits(read.ppcc_lambda)} allowing for rounding and the "
        f"mean over frames; λ by maximum likelihood {estimated(shape)}."
    )

    def draw(theme: Theme) -> Figure:
        drawing, axes = one_axes()
        shapes, correlations = read.curve
        best, at = read.highest_correlation, read.ppcc_lambda_plain
        axes.plot(shapes, correlations, color=theme.found)
        axes.axvline(at, color=theme.theory, label=f"maximum {digits(at, 2)}")
        axes.plot(at, max(best, float(correlations.max())), "o", color=theme.theory)
        reported = f"reported {digits(shape.value, 2)}"
        axes.axvline(shape.value, color=theme.ink, linestyle="--", label=reported)
        axes.axvline(GAUSSIAN_LAMBDA, color=theme.ink, linewidth=1, linestyle=":", label="Gaussian 0.14")
        # The far left falls so deep that the maximum would not be seen.
        floor = float(correlations[np.abs(shapes - at) < _AROUND_MAXIMUM].min())
        axes.set_ylim(floor, best + 0.1 * (best - floor))
        axes.set(xlabel="λ", ylabel="correlation")
        legend_above(axes)
        return drawing

    return _plot("ppcc", one, alt, draw)


def gaussian_plot(one: IsoCalibration) -> Plot:
    """Draw the probability plot of the residuals against the normal distribution."""
    r_squared = digits(one.read.r_squared_gauss, 6)
    alt = f"Quantiles of the read noise against normal ones at ISO {one.iso:g}: R² {r_squared}."
    draw = _probability(one, one.plot.normal, one.plot.slope_normal_dn, r_squared, "normal")
    return _plot("gaussian", one, alt, draw)


def tukey_lambda_plot(one: IsoCalibration) -> Plot:
    """Draw the probability plot of the residuals against the Tukey-lambda distribution."""
    r_squared = digits(one.read.r_squared_tl, 6)
    shape = "" if one.tukey_lambda is None else f" of shape {digits(one.plot.shape)}"
    alt = (
        f"Quantiles of the read noise against those of the Tukey-lambda distribution{shape} at ISO {one.iso:g}: R² "
        f"{r_squared}."
    )
    draw = _probability(one, one.plot.tukey_lambda, one.plot.slope_tukey_lambda_dn, r_squared, "Tukey-lambda")
    return _plot("tukey-lambda", one, alt, draw)


def _probability(
    one: IsoCalibration, quantiles: NDArray[np.float64], slope: float, r_squared: str, family: str
) -> Callable[[Theme], Figure]:
    return partial(
        quantile_plot,
        quantiles,
        one.plot.ordered_dn,
        (slope, 0.0),
        names=(family, "read noise"),
        labels=(f"{family} quantile", "read noise [DN]"),
        note=f"R² {r_squared}",
    )


# --- real against simulated ---------------------------------------------------------------------------------------


def reproduced_quantiles_plot(one: IsoCalibration, found: Reproduction) -> Plot:
    """Draw the quantiles of a real bias frame over those of a simulated one."""
    r_squared = digits(found.r_squared, 6)
    alt = (
        f"Quantiles of the held-out bias frame against those of a simulated one at ISO {one.iso:g}, from 0.00001 to "
        f"0.99999: R² {r_squared}."
    )
    draw = partial(
        quantile_plot,
        found.quantiles_simulated_dn,
        found.quantiles_real_dn,
        (1.0, 0.0),
        names=("alike", "quantiles"),
        labels=("simulated [DN]", "real [DN]"),
        note=f"R² {r_squared}",
    )
    return _plot("reproduced-quantiles", one, alt, draw)


def reproduced_rows_plot(one: IsoCalibration, found: Reproduction) -> Plot:
    """Draw the periodograms of the row means of a real and of a simulated bias frame."""
    alt = (
        f"Power of the row means of the held-out bias frame and of a simulated one at ISO {one.iso:g}. Standard "
        f"deviation of the row means: real {digits(found.row_sigma_real_dn)} DN, simulated "
        f"{digits(found.row_sigma_simulated_dn)} DN."
    )

    def draw(theme: Theme) -> Figure:
        drawing, axes = one_axes()
        frequency, real, simulated = found.smoothed_row_powers_dn2(len(one.sensor.cfa))
        axes.plot(frequency, simulated, "--", color=theme.theory, label="simulated")
        axes.plot(frequency, real, "-", color=theme.found, label="real")
        _log_power(axes)
        axes.set(xlabel="frequency [cycles per row]", ylabel="power [DN²]")
        axes.legend(loc="upper right", ncols=2)
        return drawing

    return _plot("reproduced-rows", one, alt, draw)
