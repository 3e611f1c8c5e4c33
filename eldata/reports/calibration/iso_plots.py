"""Plots of what was measured at one ISO: the figures with which the paper judges its noise model."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.reports.figures import (
    MARKERS,
    Plot,
    Theme,
    deviation_band,
    drawn,
    figure,
    legend_above,
    log_ticks,
    one_axes,
    quantile_plot,
    thinned,
)
from eldata.reports.html import digits, measured

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from eldata.calibration.photon_transfer import PhotonTransfer
    from eldata.calibration.reproduction import Reproduction
    from eldata.calibration.results import IsoCalibration

GAUSSIAN_LAMBDA = 0.14
"""The shape at which the Tukey-lambda distribution is nearest to the normal one."""

_LEVELS_SHOWN = 20  # of a channel; more are pooled
_SINGLE_FRAMES_SHOWN = 48
_ROOM_ABOVE = 1.7
_AROUND_MAXIMUM = 0.27  # of lambda
_FRAMES_SHOWN = 32


def channel_names(channels: int) -> tuple[str, ...]:
    """Return the names of the CFA's channels: of Bayer's four, or of X-Trans' three."""
    return ("R", "G1", "B", "G2") if channels == 4 else ("R", "G", "B")


# --- photon transfer ----------------------------------------------------------------------------------------------


def transfer_plot(one: IsoCalibration, transfer: PhotonTransfer) -> Plot:
    """Draw the variance over the signal, the fitted lines, and the deviations from them."""
    spatial = one.spatial
    published = ""
    if spatial is not None:
        published = f" The published single-frame method gives {digits(spatial.gain_dn_per_e, 4)} DN/e⁻."
    worst = max((line.chi2_per_dof for line in transfer.channels if math.isfinite(line.chi2_per_dof)), default=math.nan)
    caption = (
        "Variance over time of flats, by channel; the slope is K. Good: points on the line, deviations within the "
        "band. A bend is flicker, compression or a sensor that is not linear."
    )
    if spatial is not None:
        caption += (
            " Rings, or arrows where far above: the published way, variance inside of single frames, which takes "
            "unevenness of sensor and light for noise."
        )
    return drawn(
        f"transfer-{one.iso:g}",
        "Photon transfer",
        f"Variance against signal of the flats at ISO {one.iso:g}, by channel, with the fitted lines: K is "
        f"{measured(transfer.gain_dn_per_e, transfer.gain_error, 'DN/e⁻')}, chi² per degree of freedom at most "
        f"{digits(worst, 2)}.{published}",
        caption,
        lambda theme: _transfer(transfer, spatial, theme),
    )


def _transfer(transfer: PhotonTransfer, spatial: PhotonTransfer | None, theme: Theme) -> Figure:
    drawing = figure()
    main, below = drawing.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [2.6, 1]})
    names = channel_names(len(transfer.channels))
    furthest = 0.0
    for index, line in enumerate(transfer.channels):
        signal, variance, error = line.pooled(_LEVELS_SHOWN)
        deviation = (variance - line.variance_at(signal)) / error
        furthest = max(furthest, float(np.abs(deviation).max()))
        main.errorbar(
            signal,
            variance,
            yerr=error,
            fmt=MARKERS[index],
            markersize=4,
            color=theme.channels[index],
            label=names[index],
        )
        below.plot(signal, deviation, MARKERS[index], markersize=3.5, color=theme.channels[index])
    ends = np.array([0.0, max(float(line.signal_dn.max()) for line in transfer.channels)])
    for index, line in enumerate(transfer.channels):
        main.plot(ends, line.variance_at(ends), color=theme.theory, label="fitted" if index == 0 else "_")
    if spatial is not None:
        _single_frames(main, spatial, theme)
    main.set_ylabel("variance [DN²]")
    legend_above(main)
    deviation_band(below, furthest, theme)
    below.set_xlabel("signal [DN]")
    return drawing


def _single_frames(axes: Axes, spatial: PhotonTransfer, theme: Theme) -> None:
    """Draw the published method's points; those far above the others as arrows, or they would flatten the rest."""
    signal = np.concatenate([line.signal_dn for line in spatial.channels])
    variance = np.concatenate([line.variance_dn2 for line in spatial.channels])
    shown = np.linspace(0, signal.size - 1, min(signal.size, _SINGLE_FRAMES_SHOWN)).round().astype(np.int64)
    signal, variance = signal[shown], variance[shown]
    low, high = axes.get_ylim()
    high *= _ROOM_ABOVE
    beyond = variance > high
    axes.set_ylim(low, high)
    axes.plot(
        signal[~beyond],
        variance[~beyond],
        "o",
        markersize=6,
        markerfacecolor="none",
        color=theme.ink,
        label="single frames",
    )
    if beyond.any():
        axes.plot(
            signal[beyond], np.full(beyond.sum(), 0.97 * high), "^", markersize=6, color=theme.ink, label="beyond"
        )


# --- colour bias --------------------------------------------------------------------------------------------------


def bias_plot(one: IsoCalibration) -> Plot:
    """Draw the colour bias, and below how much the frames' own means scatter around it."""
    bias = one.bias
    names = channel_names(len(bias.bias_dn))
    found = ", ".join(
        f"{name} {measured(value, error, 'DN')}"
        for name, value, error in zip(names, bias.bias_dn, bias.standard_error_dn, strict=True)
    )
    return drawn(
        f"bias-{one.iso:g}",
        "Colour bias",
        f"Mean of the bias frames over the recorded black level at ISO {one.iso:g}: {found}; and the means of "
        f"{bias.frames} single frames around it.",
        (
            "Top: mean over the recorded black level, the line. Channels that differ tint dark pictures. Below: each "
            "frame's own mean around that, in the order of the files; the shape is the spread that a frame's own "
            "noise gives. Good: dots within the shapes, no trend. A trend is black that drifts."
        ),
        lambda theme: _bias(one, theme),
    )


def _bias(one: IsoCalibration, theme: Theme) -> Figure:
    bias = one.bias
    drawing = figure()
    main, below = drawing.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1, 1.4]})
    channels = len(bias.bias_dn)
    frames = np.linspace(0, bias.frames - 1, min(bias.frames, _FRAMES_SHOWN)).round().astype(np.int64)
    across = np.linspace(-0.3, 0.3, frames.size) if frames.size > 1 else np.zeros(1)
    main.axhline(0, color=theme.theory)
    below.axhline(0, color=theme.theory, linewidth=1)
    for channel in range(channels):
        colour = theme.channels[channel]
        error = bias.standard_error_dn[channel]
        main.errorbar(
            channel,
            bias.bias_dn[channel],
            yerr=error if math.isfinite(error) else None,
            fmt=MARKERS[channel],
            color=colour,
            capsize=4,
        )
        below.plot(
            channel + across,
            bias.frame_bias_dn[frames, channel] - bias.bias_dn[channel],
            MARKERS[channel],
            markersize=3.5,
            color=colour,
        )
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
    below.set_xticks(range(channels), channel_names(channels))
    below.set_xlim(-0.5, channels - 0.5)
    return drawing


# --- rows ---------------------------------------------------------------------------------------------------------


def rows_plot(one: IsoCalibration) -> Plot:
    """Draw the normal probability plot of the row means."""
    rows = one.rows.rows
    return drawn(
        f"rows-{one.iso:g}",
        "Row noise, normal probability plot",
        f"Ordered row means against normal quantiles at ISO {one.iso:g}: R² {digits(rows.r_squared, 5)}, Shapiro-Wilk "
        f"p {digits(rows.shapiro_p, 2)} of {rows.shapiro_values} values, excess kurtosis "
        f"{digits(rows.excess_kurtosis, 2)}.",
        (
            "Good: on the line, p above 0.05; then one normal σ row says it all. Ends that turn away are single odd "
            "rows; steps are rows in groups."
        ),
        lambda theme: _rows(one, theme),
    )


def _rows(one: IsoCalibration, theme: Theme) -> Figure:
    rows = one.rows.rows
    shown = thinned(rows.quantiles.size)
    return quantile_plot(
        rows.quantiles[shown],
        rows.ordered_dn[shown],
        rows.normal_line_dn,
        theme,
        names=("normal", "row means"),
        labels=("normal quantile", "row mean [DN]"),
        note=f"R² {digits(rows.r_squared, 5)}\nShapiro-Wilk p {digits(rows.shapiro_p, 2)}",
    )


def line_spectrum_plot(one: IsoCalibration) -> Plot:
    """Draw the periodograms of row and column means, over what the pixels alone would give."""
    rows, columns = one.rows.rows, one.rows.columns
    return drawn(
        f"line-spectrum-{one.iso:g}",
        "Row and column noise by frequency",
        f"Power of row and column means over what pixel noise alone gives, at ISO {one.iso:g}: σ row "
        f"{measured(rows.sigma_dn, rows.sigma_error_dn, 'DN')}, σ column "
        f"{measured(columns.sigma_dn, columns.sigma_error_dn, 'DN')}.",
        (
            "1 is what the pixels' noise alone gives the means. Good: rows flat at the line of σ row, columns at 1. A "
            "peak is banding with a period; a rise to the left is slow drift along the rows, which independent row "
            "noise does not model."
        ),
        lambda theme: _line_spectrum(one, theme),
    )


def _line_spectrum(one: IsoCalibration, theme: Theme) -> Figure:
    rows, columns = one.rows.rows, one.rows.columns
    drawing, axes = one_axes()
    variance = one.rows.pixel_variance_dn2 or 1.0
    of_pixels = variance / columns.deviations_dn.shape[1]
    for line, alone, colour, style, name in (
        (columns, variance / rows.deviations_dn.shape[1], theme.ink, ":", "columns"),
        (rows, of_pixels, theme.found, "-", "rows"),
    ):
        frequency, power = line.smoothed_power_dn2(len(one.sensor.cfa))
        axes.plot(frequency, power / alone, style, color=colour, label=name)
    axes.axhline(1 + rows.sigma_dn**2 / of_pixels, color=theme.theory, label="white noise of σ row")
    axes.axhline(1, color=theme.theory, linewidth=1, linestyle="--", label="pixels alone")
    _log_power(axes)
    axes.set_xlabel("frequency [cycles per line]")
    axes.set_ylabel("power / pixels' own")
    axes.legend(loc="best", ncols=2)
    return drawing


def _log_power(axes: Axes) -> None:
    """Set up a logarithmic axis of power with room for the legend."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    low, high = low / 1.3, high * max(1.6, (high / low) ** 0.35)
    axes.set_ylim(low, high)
    log_ticks(axes.yaxis, max(1, round(math.log10(high / low))))


# --- read noise ---------------------------------------------------------------------------------------------------


def ppcc_plot(one: IsoCalibration) -> Plot:
    """Draw the correlation of the probability plot over the shape."""
    read = one.read
    return drawn(
        f"ppcc-{one.iso:g}",
        "Shape of the read noise (PPCC)",
        f"Correlation of the probability plot over the shape λ at ISO {one.iso:g}: highest at "
        f"{digits(read.ppcc_lambda_plain)} on the residuals, {digits(read.ppcc_lambda)} allowing for rounding and the "
        f"mean over frames; λ by maximum likelihood {measured(read.tukey_lambda, read.tukey_lambda_error)}.",
        (
            "The maximum is the best shape; 0.14 is nearly the Gaussian, 0 the logistic distribution, below are longer "
            "tails. Good: one clear maximum close to the reported λ. Far apart, the read noise is not of this family."
        ),
        lambda theme: _ppcc(one, theme),
    )


def _ppcc(one: IsoCalibration, theme: Theme) -> Figure:
    read = one.read
    drawing, axes = one_axes()
    shapes, correlations = read.curve
    best = read.highest_correlation
    axes.plot(shapes, correlations, color=theme.found)
    axes.axvline(read.ppcc_lambda_plain, color=theme.theory, label=f"maximum {digits(read.ppcc_lambda_plain, 2)}")
    axes.plot(read.ppcc_lambda_plain, max(best, float(correlations.max())), "o", color=theme.theory)
    axes.axvline(read.tukey_lambda, color=theme.ink, linestyle="--", label=f"reported {digits(read.tukey_lambda, 2)}")
    axes.axvline(GAUSSIAN_LAMBDA, color=theme.ink, linewidth=1, linestyle=":", label="Gaussian 0.14")
    # The far left falls so deep that the maximum would not be seen.
    floor = float(correlations[np.abs(shapes - read.ppcc_lambda_plain) < _AROUND_MAXIMUM].min())
    axes.set_ylim(floor, best + 0.1 * (best - floor))
    axes.set_xlabel("λ")
    axes.set_ylabel("correlation")
    legend_above(axes)
    return drawing


def gaussian_plot(one: IsoCalibration) -> Plot:
    """Draw the probability plot of the residuals against the normal distribution."""
    return drawn(
        f"gaussian-{one.iso:g}",
        "Read noise against the Gaussian",
        f"Quantiles of the read noise against normal ones at ISO {one.iso:g}: "
        f"R² {digits(one.read.r_squared_gauss, 6)}.",
        (
            "Good for the Gaussian model: on the line to both ends. Where the ends leave it as an S, tails are longer, "
            "and that model makes too few extreme values."
        ),
        lambda theme: _probability(
            one.plot.normal, one.plot.ordered_dn, one.plot.slope_normal_dn, one.read.r_squared_gauss, "normal", theme
        ),
    )


def tukey_lambda_plot(one: IsoCalibration) -> Plot:
    """Draw the probability plot of the residuals against the Tukey-lambda distribution."""
    return drawn(
        f"tukey-lambda-{one.iso:g}",
        "Read noise against Tukey lambda",
        f"Quantiles of the read noise against those of the Tukey-lambda distribution of shape {digits(one.plot.shape)} "
        f"at ISO {one.iso:g}: R² {digits(one.read.r_squared_tl, 6)}.",
        (
            "Good: on the line to both ends, R² closer to 1 than the Gaussian's. Steps are values that the camera "
            "never writes; a second slope is a second kind of pixel."
        ),
        lambda theme: _probability(
            one.plot.tukey_lambda,
            one.plot.ordered_dn,
            one.plot.slope_tukey_lambda_dn,
            one.read.r_squared_tl,
            "Tukey-lambda",
            theme,
        ),
    )


def _probability(
    quantiles: NDArray[np.float64],
    ordered: NDArray[np.float64],
    slope: float,
    r_squared: float,
    family: str,
    theme: Theme,
) -> Figure:
    return quantile_plot(
        quantiles,
        ordered,
        (slope, 0.0),
        theme,
        names=(family, "read noise"),
        labels=(f"{family} quantile", "read noise [DN]"),
        note=f"R² {digits(r_squared, 6)}",
    )


# --- real against simulated ---------------------------------------------------------------------------------------


def reproduced_quantiles_plot(one: IsoCalibration, reproduction: Reproduction) -> Plot:
    """Draw the quantiles of a real bias frame over those of a simulated one."""
    return drawn(
        f"reproduced-quantiles-{one.iso:g}",
        "Quantiles, real over simulated",
        f"Quantiles of the held-out bias frame against those of a simulated one at ISO {one.iso:g}, from 0.00001 to "
        f"0.99999: R² {digits(reproduction.r_squared, 6)}.",
        (
            "Good: on the diagonal. Ends above it on the right and below on the left: the camera has longer tails than "
            "the model. A turned line: another scale."
        ),
        lambda theme: _reproduced_quantiles(reproduction, theme),
    )


def _reproduced_quantiles(reproduction: Reproduction, theme: Theme) -> Figure:
    return quantile_plot(
        reproduction.quantiles_simulated_dn,
        reproduction.quantiles_real_dn,
        (1.0, 0.0),
        theme,
        names=("alike", "quantiles"),
        labels=("simulated [DN]", "real [DN]"),
        note=f"R² {digits(reproduction.r_squared, 6)}",
    )


def reproduced_rows_plot(one: IsoCalibration, reproduction: Reproduction) -> Plot:
    """Draw the periodograms of the row means of a real and of a simulated bias frame."""
    return drawn(
        f"reproduced-rows-{one.iso:g}",
        "Rows by frequency, real and simulated",
        f"Power of the row means of the held-out bias frame and of a simulated one at ISO {one.iso:g}. Standard "
        f"deviation of the row means: real {digits(reproduction.row_sigma_real_dn)} DN, simulated "
        f"{digits(reproduction.row_sigma_simulated_dn)} DN.",
        (
            "Good: two ragged lines at one height; single frames scatter much. A peak of the real one alone is banding "
            "with a period."
        ),
        lambda theme: _reproduced_rows(reproduction, len(one.sensor.cfa), theme),
    )


def _reproduced_rows(reproduction: Reproduction, period: int, theme: Theme) -> Figure:
    drawing, axes = one_axes()
    frequency, real, simulated = reproduction.smoothed_row_powers_dn2(period)
    axes.plot(frequency, simulated, "--", color=theme.theory, label="simulated")
    axes.plot(frequency, real, "-", color=theme.found, label="real")
    _log_power(axes)
    axes.set_xlabel("frequency [cycles per row]")
    axes.set_ylabel("power [DN²]")
    axes.legend(loc="upper right", ncols=2)
    return drawing
