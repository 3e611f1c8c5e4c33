"""Plots of a calibration over its ISOs: how the figures go together."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.reports.calibration.iso_plots import GAUSSIAN_LAMBDA
from eldata.reports.figures import (
    MARKERS,
    Plot,
    Theme,
    bars,
    drawn,
    fit_bands,
    legend_above,
    log_log,
    log_ticks,
    one_axes,
    plain_ticks,
    two_axes,
)
from eldata.reports.html import digits, plot_words

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.calibration.audit import GivenFigure
    from eldata.calibration.joint import LogLogEstimate
    from eldata.calibration.results import Calibration, IsoGain
    from eldata.noise.gain_modes import GainMode

_ISOS_LABELLED = 5
_CHANNEL_STEP = 0.07  # of ln ISO: side by side, where the channels' values are alike

Point = tuple[float, float, float]
"""Gain, scale and the scale's standard error."""


def joint_plots(calibration: Calibration) -> tuple[Plot, ...]:
    """Draw every plot over the ISOs that there is data for."""
    modes = calibration.modes
    known = [(one.gain_dn_per_e, one) for one in calibration.isos if one.gain_dn_per_e is not None]
    isos = calibration.isos
    found = [
        _scale_plot(
            name,
            [(one.mode, line) for one, line in zip(modes, lines, strict=True) if line],
            usable,
            _left_out(isos, "gain", figure),
        )
        for name, figure, lines, scales in (
            ("TL", "read noise", [one.tukey_lambda_fit for one in modes], [one.sigma_tl_dn for _, one in known]),
            ("G", "read noise", [one.gauss_fit for one in modes], [one.sigma_gauss_dn for _, one in known]),
            ("row", "row noise", [one.row_fit for one in modes], [one.sigma_row_dn for _, one in known]),
        )
        if (usable := _points([gain for gain, _ in known], scales))
    ]
    with_gain = [one for one in calibration.all_isos if one.gain is not None]
    if with_gain:
        more = _left_out(calibration.all_isos, "gain")
        found.append(_gain_plot(with_gain, calibration.usual_gain_per_iso, more))
    shapes = [(one.iso, shape) for one in isos if (shape := one.tukey_lambda) is not None]
    biases = [(one.iso, bias) for one in isos if (bias := one.colour_bias) is not None]
    if shapes:
        found.append(_lambda_plot(shapes, _left_out(isos, "read noise")))
    if biases:
        found.append(_bias_plot(isos[0].channels, biases, _left_out(isos, "colour bias")))
    return tuple(found)


def _left_out(isos: Sequence[IsoGain], *figures: str) -> str:
    """Return which ISOs a plot lacks, since a figure that it needs is withheld, as a further sentence."""
    names = [f"{one.iso:g}" for one in isos if not one.withheld.isdisjoint(figures)]
    return f" Not shown, since withheld: ISO {', '.join(names)}." if names else ""


def _points(gains: Sequence[float], scales: Sequence[GivenFigure | None]) -> list[Point]:
    """Return what a logarithmic axis can show of the scales that are given."""
    return [
        (gain, scale.value, scale.error)
        for gain, scale in zip(gains, scales, strict=True)
        if scale is not None and 0 < scale.value < math.inf
    ]


def _scale_plot(
    name: str, lines: Sequence[tuple[GainMode, LogLogEstimate]], points: Sequence[Point], more: str
) -> Plot:
    said = plot_words("calibration")["scale"]
    title = said["title"].format(name=name)
    scales = [scale for _, scale, _ in points]
    alt = f"{title} K at {len(points)} ISO(s), from {digits(min(scales))} to {digits(max(scales))} DN"
    if not lines:
        alt += "; too few for a line with its spread."
    for mode, estimate in lines:
        of_mode = f" of {mode}" if len(lines) > 1 else ""
        alt += (
            f", and the fitted line{of_mode} of slope {digits(estimate.fit.slope)} with bands of 1 and 2 residual "
            f"deviations of {digits(estimate.fit.sigma)}; R² {digits(estimate.r_squared, 4)}"
        )
    alt += "." if lines else ""

    def draw(theme: Theme) -> Figure:
        drawing, axes = one_axes()
        gains = [gain for gain, _, _ in points]
        fit_bands(axes, [(line.fit, *_ends(gains, mode)) for mode, line in lines], theme)
        # A bar down to 0 has no end on a logarithmic axis.
        bars(axes, gains, scales, [_bar(min(error, 0.9 * scale)) for _, scale, error in points], theme)
        log_log(axes, name)
        if len(points) == 1:
            axes.set_xlim(gains[0] / 2.2, gains[0] * 2.2)
            axes.set_ylim(scales[0] / 2.2, scales[0] * 2.2)
        axes.legend(loc="upper left")
        return drawing

    caption = said["caption" if lines else "without_line"] + more
    return drawn(f"sigma-{name.lower()}", title, alt, caption, draw)


def _ends(gains: Sequence[float], mode: GainMode) -> tuple[float, float]:
    """Return the lowest and the highest of the gains that lie in a mode."""
    inside = [gain for gain in gains if mode.distance(gain) == 0]
    return min(inside), max(inside)


def _bar(error: float) -> float:
    return error if math.isfinite(error) and error > 0 else 0.0


def _by_iso(
    name: str, isos: Sequence[float], alt: str, draw: Callable[[Theme], tuple[Figure, Axes]], more: str
) -> Plot:
    """Return a plot, with the words of its name, whose (lower) axes have a logarithmic axis of ISOs."""

    def with_isos(theme: Theme) -> Figure:
        drawing, axes = draw(theme)
        axes.set_xscale("log")
        axes.set_xlabel("ISO")
        plain_ticks(axes.xaxis, isos[:: math.ceil(len(isos) / _ISOS_LABELLED)])
        axes.set_xlim(isos[0] / 1.4, isos[-1] * 1.4)
        return drawing

    said = plot_words("calibration")[name]
    return drawn(name, said["title"], alt, said["caption"] + more, with_isos)


def _gain_plot(known: Sequence[IsoGain], usual: float, more: str) -> Plot:
    isos, gains = [one.iso for one in known], [one.gain_dn_per_e or 0.0 for one in known]
    relative = [gain / iso / usual for gain, iso in zip(gains, isos, strict=True)]
    errors = [0.0 if one.gain is None else _bar(one.gain.error) for one in known]
    apart = [error / iso / usual for error, iso in zip(errors, isos, strict=True)]
    alt = (
        f"K at {len(known)} ISO(s), {digits(min(gains), 4)} to {digits(max(gains), 4)} DN/e⁻. K / ISO stays within "
        f"{max(abs(ratio - 1) for ratio in relative):.1%} of its median."
    )

    def draw(theme: Theme) -> tuple[Figure, Axes]:
        drawing, main, below = two_axes(1.8)
        ends = np.array([isos[0] / 1.3, isos[-1] * 1.3])
        main.plot(ends, usual * ends, color=theme.theory, label="constant K / ISO")
        bars(main, isos, gains, errors, theme)
        below.axhline(1, color=theme.theory, linewidth=1)
        bars(below, isos, relative, apart, theme)
        main.set_yscale("log")
        low, high = main.get_ylim()
        log_ticks(main.yaxis, round(math.log10(high / low)))
        main.set_ylabel("K [DN/e⁻]")
        main.legend(loc="upper left")
        # With the bars: one that was made longer, for what a finding may cost, would pass the axes' ends.
        reach = 1.1 * max(0.018, *(abs(ratio - 1) + error for ratio, error in zip(relative, apart, strict=True)))
        below.set_ylim(1 - reach, 1 + reach)
        below.set_ylabel("K / ISO [median]")
        return drawing, below

    return _by_iso("gain", isos, alt, draw, more)


def _lambda_plot(given: Sequence[tuple[float, GivenFigure]], more: str) -> Plot:
    isos, shapes = [iso for iso, _ in given], [shape.value for _, shape in given]
    alt = f"Shape λ of the read noise at {len(shapes)} ISO(s), from {digits(min(shapes))} to {digits(max(shapes))}."

    def draw(theme: Theme) -> tuple[Figure, Axes]:
        drawing, axes = one_axes()
        axes.axhline(GAUSSIAN_LAMBDA, color=theme.ink, linewidth=1, linestyle=":", label="Gaussian, 0.14")
        axes.axhline(0, color=theme.theory, linewidth=1, label="logistic, 0")
        bars(axes, isos, shapes, [_bar(shape.error) for _, shape in given], theme)
        axes.set_ylabel("λ")
        axes.margins(y=0.1)
        legend_above(axes)
        return drawing, axes

    return _by_iso("lambda", isos, alt, draw, more)


def _bias_plot(names: Sequence[str], given: Sequence[tuple[float, Sequence[GivenFigure]]], more: str) -> Plot:
    isos = [iso for iso, _ in given]
    values = [channel.value for _, bias in given for channel in bias]
    alt = f"Colour bias by channel at {len(isos)} ISO(s), from {digits(min(values))} to {digits(max(values))} DN."

    def draw(theme: Theme) -> tuple[Figure, Axes]:
        drawing, axes = one_axes()
        axes.axhline(0, color=theme.theory, linewidth=1)
        for channel, name in enumerate(names):
            aside = math.exp((channel - (len(names) - 1) / 2) * _CHANNEL_STEP)
            axes.errorbar(
                [iso * aside for iso in isos],
                [bias[channel].value for _, bias in given],
                yerr=[_bar(bias[channel].error) for _, bias in given],
                fmt=MARKERS[channel],
                color=theme.channels[channel],
                label=name,
            )
        axes.set_ylabel("colour bias [DN]")
        axes.margins(y=0.1)
        legend_above(axes)
        return drawing, axes

    return _by_iso("biases", isos, alt, draw, more)
