"""Plots of a calibration over its ISOs: how the figures go together."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.numbers import counted
from eldata.plots.axes import MARKERS, Theme, bar, bars, gain_over_iso, iso_axis, legend_above, scale_over_gain
from eldata.reports.calibration_iso import GAUSSIAN_LAMBDA
from eldata.reports.html import Plot, digits, draw_plot

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes

    from eldata.calibration.iso_results import IsoCalibration, IsoGain
    from eldata.calibration.results import Calibration, ScalePanel

_BIN_DN = 0.5  # as in the paper
_LINES = ("-", "--", "-.", ":")  # one per channel
_CHANNEL_STEP = 0.07  # of ln ISO: side by side, where the channels' values are alike


def joint_plots(calibration: Calibration) -> tuple[Plot, ...]:
    """Draw every plot over the ISOs that there is data for."""
    isos = calibration.isos
    plots = [_plot_scale(panel, _name_gaps(isos, "gain", panel.quantity)) for panel in calibration.scale_panels]
    if with_gain := [record for record in calibration.all_isos if record.gain is not None]:
        plots.append(_plot_gain(with_gain, calibration.usual_gain_per_iso, _name_gaps(calibration.all_isos, "gain")))
    if shaped := [record for record in isos if record.tukey_lambda is not None]:
        plots.append(_plot_shape(shaped, _name_gaps(isos, "shape")))
    if biased := [record for record in isos if record.colour_bias is not None]:
        more = _name_gaps(isos, "colour bias")
        plots += [_plot_colour_bias(biased, more), _plot_frame_bias(biased, more)]
    return tuple(plots)


def _name_gaps(isos: Sequence[IsoGain], *figures: str) -> str:
    """Name the ISOs that a plot lacks because a figure is withheld, as a further sentence; empty if none."""
    names = [f"{record.iso:g}" for record in isos if not record.withheld.isdisjoint(figures)]
    return f" Not shown, since withheld: ISO {', '.join(names)}." if names else ""


def _plot_scale(panel: ScalePanel, more: str) -> Plot:
    """Plot one noise component's scale over the gain K, with the fitted line of each gain mode."""
    name, lines, points = panel.name, panel.lines, panel.points
    scales = [scale for _, scale, _ in points]
    span = f"from {digits(min(scales))} to {digits(max(scales))} DN"
    alt = f"σ {name} over the gain K at {counted(len(points), 'ISO')}, {span}"
    if not lines:
        alt += "; too few for a line with its spread."
    for mode, estimate in lines:
        of_mode = f" of {mode}" if len(lines) > 1 else ""
        alt += (
            f", and the fitted line{of_mode} of slope {digits(estimate.fit.slope)} with bands of 1 and 2 residual "
            f"deviations of {digits(estimate.fit.sigma)}; R² {digits(estimate.r_squared, 4)}"
        )
    alt += "." if lines else ""

    def draw(axes: Axes, theme: Theme) -> None:
        """Draw the scales, fitted lines and bands."""
        scale_over_gain(axes, name, panel.spans, points, theme)

    options: dict[str, Any] = {"name": f"sigma-{name.lower()}", "words": {"name": name}, "more": more}
    return draw_plot("calibration", "scale", alt, draw, caption="caption" if lines else "without_line", **options)


def _plot_by_iso(
    kind: str, isos: Sequence[float], alt: str, draw: Callable[..., object], *, ratio: float | None = None, more: str
) -> Plot:
    """Return a plot, with the words of its kind, whose (lower) axes have a logarithmic axis of ISOs."""

    def draw_with_isos(*axes_and_theme: Any) -> None:
        """Draw, then give the lower axes ISO ticks."""
        draw(*axes_and_theme)
        iso_axis(axes_and_theme[-2], isos)

    return draw_plot("calibration", kind, alt, draw_with_isos, ratio=ratio, more=more)


def _plot_gain(known: Sequence[IsoGain], usual: float, more: str) -> Plot:
    """Plot the gain K over the ISO, and below it K / ISO over its median."""
    by_iso = {record.iso: gain for record in known if (gain := record.gain) is not None}
    isos, gains = list(by_iso), [gain.value for gain in by_iso.values()]
    errors = [bar(gain.error) for gain in by_iso.values()]
    relative, apart = ([value / iso / usual for value, iso in zip(each, isos, strict=True)] for each in (gains, errors))
    alt = (
        f"K at {counted(len(known), 'ISO')}, {digits(min(gains), 4)} to {digits(max(gains), 4)} DN/e⁻. K / ISO stays "
        f"within {max(abs(ratio - 1) for ratio in relative):.1%} of its median."
    )

    def draw(main: Axes, below: Axes, theme: Theme) -> None:
        """Draw K above, and K / ISO over its median below."""
        gain_over_iso(main, isos, gains, errors, usual, theme)
        below.axhline(1, color=theme.theory, linewidth=1)
        bars(below, isos, relative, apart, theme)
        # With the bars: one that was made longer, for what a finding may cost, would pass the axes' ends.
        reach = 1.1 * max(0.018, *(abs(ratio - 1) + error for ratio, error in zip(relative, apart, strict=True)))
        below.set_ylim(1 - reach, 1 + reach)
        below.set_ylabel("K / ISO [median]")

    return _plot_by_iso("gain", isos, alt, draw, ratio=1.8, more=more)


def _plot_shape(isos: Sequence[IsoCalibration], more: str) -> Plot:
    """Plot the read noise's Tukey-lambda shape over the ISO."""
    figures = [record.figures["tukey_lambda"] for record in isos]
    at, shapes = [record.iso for record in isos], [figure.value for figure in figures]
    alt = (
        f"Shape λ of the read noise at {counted(len(shapes), 'ISO')}, from {digits(min(shapes))} to "
        f"{digits(max(shapes))}."
    )

    def draw(axes: Axes, theme: Theme) -> None:
        """Draw the shape at each ISO, and lines at the Gaussian and the logistic shape."""
        axes.axhline(GAUSSIAN_LAMBDA, color=theme.ink, linewidth=1, linestyle=":", label="Gaussian, 0.14")
        axes.axhline(0, color=theme.theory, linewidth=1, label="logistic, 0")
        bars(axes, at, shapes, [bar(figure.error) for figure in figures], theme)
        axes.set_ylabel("λ")
        axes.margins(y=0.1)
        legend_above(axes)

    return _plot_by_iso("lambda", at, alt, draw, more=more)


def _plot_colour_bias(isos: Sequence[IsoCalibration], more: str) -> Plot:
    """Plot the colour bias of each channel over the ISO."""
    channels = list(zip(*(record.colour_bias or () for record in isos), strict=True))
    values = [figure.value for channel in channels for figure in channel]
    alt = (
        f"Colour bias by channel at {counted(len(isos), 'ISO')}, from {digits(min(values))} to {digits(max(values))} "
        "DN."
    )

    def draw(axes: Axes, theme: Theme) -> None:
        """Draw the channels' biases side by side at each ISO."""
        axes.axhline(0, color=theme.theory, linewidth=1)
        for place, (name, channel) in enumerate(zip(isos[0].channels, channels, strict=True)):
            aside = math.exp((place - (len(channels) - 1) / 2) * _CHANNEL_STEP)
            style: dict[str, Any] = {"fmt": MARKERS[place], "color": theme.channels[place], "label": name}
            errors = [bar(figure.error) for figure in channel]
            axes.errorbar(
                [record.iso * aside for record in isos], [figure.value for figure in channel], yerr=errors, **style
            )
        axes.set_ylabel("colour bias [DN]")
        axes.margins(y=0.1)
        legend_above(axes)

    return _plot_by_iso("biases", [record.iso for record in isos], alt, draw, more=more)


def _plot_frame_bias(isos: Sequence[IsoCalibration], more: str) -> Plot:
    """Draw the histogram of the frames' own colour biases (figure 4 of the paper); each ISO weighs alike."""
    values = np.concatenate([record.bias.frame_bias_dn for record in isos])
    weights = np.concatenate([np.full(record.bias.frames, 1 / record.bias.frames) for record in isos])
    low, high = math.floor(values.min() / _BIN_DN), math.floor(values.max() / _BIN_DN) + 1
    alt = (
        f"Histogram of the colour biases of {len(values)} bias frames at {counted(len(isos), 'ISO')}, by channel, from "
        f"{digits(values.min())} to {digits(values.max())} DN."
    )

    def draw(axes: Axes, theme: Theme) -> None:
        """Draw a histogram for each channel."""
        edges = [place * _BIN_DN for place in range(low, high + 1)]
        for channel, name in enumerate(isos[0].channels):
            style: dict[str, Any] = {"color": theme.channels[channel], "linestyle": _LINES[channel], "label": name}
            axes.hist(values[:, channel], edges, weights=weights, density=True, histtype="step", **style)
        axes.set_xlabel("colour bias of a frame [DN]")
        axes.set_ylabel("density [1/DN]")
        legend_above(axes)

    return draw_plot("calibration", "frames", alt, draw, more=more)
