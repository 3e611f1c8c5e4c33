"""Plots and pictures of what was measured at one ISO: those with which the paper judges its noise model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.fields import shipped_toml
from eldata.plots import axes as plots
from eldata.plots.pictures import block_means, grey_png, limits
from eldata.reports.html import TEMPLATES, Plot, digits, draw_plot, format_measured, typeset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from eldata.calibration.flats import PhotonTransfer
    from eldata.calibration.held_out import Reproduction
    from eldata.calibration.iso_results import IsoCalibration, IsoGain, MeasuredFigure
    from eldata.calibration.residuals import ProbabilityPlot, ReadNoise

GAUSSIAN_LAMBDA = 0.14
"""The shape at which the Tukey-lambda distribution is nearest to the normal one."""

_LIMIT = 4.0  # standard errors of a point's deviation from its line
_AROUND_MAXIMUM = 0.27  # of lambda
_FRAMES_SHOWN = 32
_SHADING_SHOWN = 72  # rows or columns


def format_figure(figure: MeasuredFigure | None, unit: str | None = None) -> str:
    """Write a figure with its error and a unit, by default its own; or "withheld"."""
    if figure is None or math.isnan(figure.value):
        return "withheld"
    unit = typeset(figure.unit) if unit is None else unit
    return format_measured(figure.value, figure.error, unit) + (" (stated)" if figure.is_stated else "")


def _plot(kind: str, record: IsoGain, alt: str, draw: Callable[..., object], **options: Any) -> Plot:
    """Return a plot of one ISO, with the words of its kind."""
    return draw_plot("calibration", kind, alt, draw, name=f"{kind}-{record.iso:g}", **options)


# --- photon transfer ----------------------------------------------------------------------------------------------


def transfer_plot(record: IsoGain, transfer: PhotonTransfer) -> Plot:
    """Draw the variance over the signal, the fitted lines, and the deviations from them."""
    worst = max((line.chi2_per_dof for line in transfer.channels if math.isfinite(line.chi2_per_dof)), default=math.nan)
    alt = (
        f"Variance against signal of the flats at ISO {record.iso:g}, by channel, with the fitted lines: K is "
        f"{format_figure(record.gain)}, chi² per degree of freedom at most {digits(worst, 2)}."
    )

    def draw(main: Axes, below: Axes, theme: plots.Theme) -> None:
        """Draw variances and fitted lines above, the deviations from the lines below."""
        furthest = plots.transfer_lines(main, below, record.channels, transfer.channels, theme)
        plots.deviation_band(below, furthest, _LIMIT, theme)

    return _plot("transfer", record, alt, draw, ratio=2.6)


# --- colour bias --------------------------------------------------------------------------------------------------


def bias_plot(record: IsoCalibration, figures: Sequence[MeasuredFigure]) -> Plot:
    """Draw the colour bias, and below how much the frames' own means scatter around it."""
    bias = record.bias
    channels = len(record.channels)
    values = ", ".join(f"{name} {format_figure(figure)}" for name, figure in zip(record.channels, figures, strict=True))
    alt = (
        f"Mean of the bias frames over the recorded black level at ISO {record.iso:g}: {values}; and the means of "
        f"{bias.frames} single frames around it."
    )

    def draw(main: Axes, below: Axes, theme: plots.Theme) -> None:
        """Draw the channels' means above, the frames' own means below."""
        frames = plots.spread_evenly(bias.frames, _FRAMES_SHOWN)
        across = np.linspace(-0.3, 0.3, frames.size) if frames.size > 1 else np.zeros(1)
        main.axhline(0, color=theme.theory)
        below.axhline(0, color=theme.theory, linewidth=1)
        for channel in range(channels):
            mean, error = figures[channel].value, figures[channel].error
            style: dict[str, Any] = {
                "marker": plots.MARKERS[channel],
                "color": theme.channels[channel],
                "linestyle": "none",
            }
            main.errorbar(channel, mean, yerr=error if math.isfinite(error) else None, capsize=4, **style)
            below.plot(channel + across, bias.frame_bias_dn[frames, channel] - mean, markersize=3.5, **style)
            own = bias.standard_error_dn[channel] * math.sqrt(bias.frames)  # of one frame
            if own > 0 and math.isfinite(own):
                heights = np.linspace(-3, 3, 61)
                width = 0.42 * np.exp(-(heights**2) / 2)
                below.fill_betweenx(
                    heights * own, channel - width, channel + width, color=theme.theory, alpha=0.2, linewidth=0
                )
        main.margins(y=0.25)
        main.set_ylabel("mean [DN]")
        below.set_ylabel("frame − mean [DN]")
        below.set_xticks(range(channels), record.channels)
        below.set_xlim(-0.5, channels - 0.5)

    return _plot("bias", record, alt, draw, ratio=1 / 1.4)


# --- rows ---------------------------------------------------------------------------------------------------------


def rows_plot(record: IsoCalibration) -> Plot:
    """Draw the normal probability plot of the row means."""
    rows = record.rows.rows
    shown = plots.thin_out(rows.quantiles.size)
    r_squared, p = digits(rows.r_squared, 5), digits(rows.shapiro_p, 2)
    alt = (
        f"Ordered row means against normal quantiles at ISO {record.iso:g}: R² {r_squared}, Shapiro-Wilk p {p} of "
        f"{rows.shapiro_values} values, excess kurtosis {digits(rows.excess_kurtosis, 2)}."
    )
    draw = partial(
        plots.draw_quantiles,
        points=(rows.quantiles[shown], rows.ordered_dn[shown]),
        line=rows.normal_line_dn,
        names=("normal", "row means"),
        labels=("normal quantile", "row mean [DN]"),
        note=f"R² {r_squared}\nShapiro-Wilk p {p}",
    )
    return _plot("rows", record, alt, draw)


def line_spectrum_plot(record: IsoCalibration) -> Plot:
    """Draw the periodograms of row and column means, over what the pixels alone would give."""
    rows, columns = record.rows.rows, record.rows.columns
    alt = (
        f"Power of row and column means over what pixel noise alone gives, at ISO {record.iso:g}: σ row "
        f"{format_figure(record.sigma_row_dn)}, σ column {format_figure(record.find_figure('sigma_column_dn'))}."
    )

    def draw(axes: Axes, theme: plots.Theme) -> None:
        """Draw the power of column and row means, over the pixels' own."""
        variance = record.rows.pixel_variance_dn2 or 1.0
        of_pixels = variance / columns.deviations_dn.shape[1]
        for line, alone, colour, style, name in (
            (columns, variance / rows.deviations_dn.shape[1], theme.ink, ":", "columns"),
            (rows, of_pixels, theme.found, "-", "rows"),
        ):
            frequency, power = line.smoothed_power_dn2(len(record.sensor.cfa))
            axes.plot(frequency, power / alone, style, color=colour, label=name)
        if record.sigma_row_dn is not None:
            white = 1 + record.sigma_row_dn.value**2 / of_pixels
            axes.axhline(white, color=theme.theory, label="white noise of σ row")
        axes.axhline(1, color=theme.theory, linewidth=1, linestyle="--", label="pixels alone")
        _set_up_power(axes)
        axes.set(xlabel="frequency [cycles per line]", ylabel="power / pixels' own")
        axes.legend(loc="best", ncols=2)

    return _plot("line-spectrum", record, alt, draw)


def _set_up_power(axes: Axes) -> None:
    """Set up a logarithmic axis of power with room for the legend."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    low, high = low / 1.3, high * max(1.6, (high / low) ** 0.35)
    axes.set_ylim(low, high)
    plots.log_ticks(axes.yaxis, max(1, round(math.log10(high / low))))


# --- read noise ---------------------------------------------------------------------------------------------------


def ppcc_plot(record: IsoCalibration, read: ReadNoise, shape: MeasuredFigure) -> Plot:
    """Draw the correlation of the probability plot over the shape, and the shape that is given."""
    alt = (
        f"Correlation of the probability plot over the shape λ at ISO {record.iso:g}: highest at "
        f"{digits(read.ppcc_lambda_plain)} on the residuals, {digits(read.ppcc_lambda)} allowing for rounding and the "
        f"mean over frames; λ by maximum likelihood {format_figure(shape)}."
    )

    def draw(axes: Axes, theme: plots.Theme) -> None:
        """Draw the correlation over the shape; mark its maximum, the reported shape and the Gaussian."""
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
        plots.legend_above(axes)

    return _plot("ppcc", record, alt, draw)


def read_noise_plots(record: IsoCalibration, read: ReadNoise, plot: ProbabilityPlot) -> list[Plot]:
    """Draw the probability plots of the residuals against the normal and the Tukey-lambda distribution."""
    shape = "" if record.tukey_lambda is None else f" of shape {digits(plot.shape)}"
    of_shape = f"those of the Tukey-lambda distribution{shape}"
    drawn = []
    for kind, family, words, quantiles, slope, r_squared in (
        ("gaussian", "normal", "normal ones", plot.normal, plot.slope_normal_dn, read.r_squared_gauss),
        ("tukey-lambda", "Tukey-lambda", of_shape, plot.tukey_lambda, plot.slope_tukey_lambda_dn, read.r_squared_tl),
    ):
        draw = partial(
            plots.draw_quantiles,
            points=(quantiles, plot.ordered_dn),
            line=(slope, 0.0),
            names=(family, "read noise"),
            labels=(f"{family} quantile", "read noise [DN]"),
            note=f"R² {digits(r_squared, 6)}",
        )
        alt = f"Quantiles of the read noise against {words} at ISO {record.iso:g}: R² {digits(r_squared, 6)}."
        drawn.append(_plot(kind, record, alt, draw))
    return drawn


# --- real against simulated ---------------------------------------------------------------------------------------


def reproduced_plot(record: IsoCalibration, kept: Reproduction) -> Plot:
    """Draw the quantiles of a real bias frame over the quantiles of a simulated one."""
    r_squared = digits(kept.r_squared, 6)
    alt = (
        f"Quantiles of the held-out bias frame against those of a simulated one at ISO {record.iso:g}, from 0.00001 to "
        f"0.99999: R² {r_squared}."
    )
    draw = partial(
        plots.draw_quantiles,
        points=(kept.quantiles_simulated_dn, kept.quantiles_real_dn),
        line=(1.0, 0.0),
        names=("alike", "quantiles"),
        labels=("simulated [DN]", "real [DN]"),
        note=f"R² {r_squared}",
    )
    return _plot("reproduced-quantiles", record, alt, draw)


# --- pictures -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures on one scale: heading, what to look for, and what the darkest and the lightest grey stand for.

    Each of ``pictures`` has a label, what it shows in words, its PNG, columns and rows. ``pixelated``: whether pixels
    are to stay squares when enlarged.
    """

    title: str
    caption: str
    pictures: list[tuple[str, str, bytes, int, int]]
    black: str
    white: str
    pixelated: bool


def _pictures(
    kind: str,
    planes: Iterable[tuple[str, str, NDArray[Any]]],
    scale: tuple[float, float],
    unit: str,
    ends: tuple[float, float] | None = None,
    **words: str,
) -> Pictures:
    """Gather labelled and described planes on one scale; ``ends`` are its values where the planes are logarithms."""
    of_kind = shipped_toml(TEMPLATES / "calibration.toml")[kind]
    black, white = (f"{digits(limit)} {unit}" for limit in ends or scale)
    pictures = [(label, alt, grey_png(plane, *scale), *plane.shape[::-1]) for label, alt, plane in planes]
    caption = of_kind["caption"].format(**words)
    return Pictures(of_kind["title"], caption, pictures, black, white, pixelated=unit == "DN")


def spectrum_picture(record: IsoCalibration) -> Pictures:
    """Show the centred power spectrum of a bias frame, in which row noise is a line."""
    spectrum = np.asarray(record.spectrum_dn2, dtype=np.float64)
    ground, rows, columns = record.spectrum_lines
    low, high = limits([spectrum], 0.01, 0.999)
    low = max(low, ground / 8, 1e-9)  # of a single tile, chance alone goes far down
    high = max(high, 2 * low)
    of_rows = f"{digits(rows / ground)} times the ground" if ground > 0 else f"{digits(rows)} DN²"
    of_columns = f"{digits(columns / ground)} times" if ground > 0 else f"{digits(columns)} DN²"
    alt = (
        f"Centred power spectrum of a bias frame at ISO {record.iso:g}: the vertical line of rows is {of_rows}, the "
        f"horizontal one of columns {of_columns}; the ground is {digits(ground)} DN²."
    )
    scale = (float(np.log(low)), float(np.log(high)))
    plane = np.log(np.maximum(spectrum, low))
    return _pictures("spectrum", [("", alt, plane)], scale, "DN²", (low, high), rows=of_rows, columns=of_columns)


def reproduced_pictures(record: IsoCalibration, kept: Reproduction) -> Pictures:
    """Show the same piece of a real bias frame and of a simulated one, on one scale."""
    frames, sigmas = (kept.real_dn, kept.simulated_dn), map(digits, kept.shown_sigmas_dn)
    planes = (
        (name, f"Piece of the {name} bias frame at ISO {record.iso:g}, standard deviation {sigma} DN.", frame)
        for name, frame, sigma in zip(("real", "simulated"), frames, sigmas, strict=True)
    )
    return _pictures("reproduced", planes, limits(frames, 0.002, 0.998), "DN")


def shading_pictures(record: IsoCalibration) -> Pictures:
    """Show the level of blocks of the sensor over each channel's mean."""
    planes = [block_means(plane, max(1, -(-max(plane.shape) // _SHADING_SHOWN))) for plane in record.pattern.shading_dn]
    limit = limits([abs(plane) for plane in planes], 0, 0.99)[1]
    described = (
        (name, f"Shading of {name} at ISO {record.iso:g}: blocks from {low} to {high} DN around the mean.", plane)
        for name, plane in zip(record.channels, planes, strict=True)
        for low, high in [(digits(float(plane.min())), digits(float(plane.max())))]
    )
    return _pictures("shading", described, (-limit, limit), "DN")
