"""Plots of a calibration over its ISOs: how the figures go together."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.reports.calibration.iso_plots import GAUSSIAN_LAMBDA, channel_names
from eldata.reports.figures import (
    MARKERS,
    Plot,
    Theme,
    bars,
    drawn,
    figure,
    fit_band,
    legend_above,
    log_log,
    log_ticks,
    one_axes,
    plain_ticks,
)
from eldata.reports.html import digits

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.calibration.joint import LogLogEstimate
    from eldata.calibration.results import Calibration, IsoCalibration

_ISOS_LABELLED = 5
_CHANNEL_STEP = 0.07  # of ln ISO: side by side, where the channels' values are alike

Point = tuple[float, float, float]
"""Gain, scale and the scale's standard error."""


def joint_plots(calibration: Calibration) -> tuple[Plot, ...]:
    """Draw every plot over the ISOs that there is data for."""
    known = [(one.gain_dn_per_e, one) for one in calibration.isos if one.gain_dn_per_e is not None]
    scales = (
        (
            ("sigma-tl", "σ TL", r"$\sigma_\mathrm{TL}$ [DN]", calibration.tukey_lambda_fit),
            [(gain, one.read.sigma_tl_dn, one.read.sigma_tl_error_dn) for gain, one in known],
        ),
        (
            ("sigma-g", "σ G", r"$\sigma_\mathrm{G}$ [DN]", calibration.gauss_fit),
            [(gain, one.read.sigma_gauss_dn, one.read.sigma_gauss_error_dn) for gain, one in known],
        ),
        (
            ("sigma-row", "σ row", r"$\sigma_\mathrm{row}$ [DN]", calibration.row_fit),
            [(gain, one.rows.rows.sigma_dn, one.rows.rows.sigma_error_dn) for gain, one in known],
        ),
    )
    found = [
        _scale_plot(*what, [point for point in points if point[1] > 0 and math.isfinite(point[1])])
        for what, points in scales
        if any(scale > 0 for _, scale, _ in points)
    ]
    if known:
        found.append(_gain_plot(calibration))
    return (*found, _lambda_plot(calibration), _bias_plot(calibration))


def _scale_plot(name: str, letters: str, label: str, estimate: LogLogEstimate | None, points: Sequence[Point]) -> Plot:
    measured = (
        f"{letters} over the gain K at {len(points)} ISO(s), from {digits(min(scale for _, scale, _ in points))} "
    )
    measured += f"to {digits(max(scale for _, scale, _ in points))} DN"
    caption = "Points: measured, bars one standard error. "
    if estimate is None:
        alt = f"{measured}; too few for a line with its spread."
        caption += "Three ISOs or more would give the line with the spread around it that the noise model draws from."
    else:
        alt = (
            f"{measured}, and the fitted line of slope {digits(estimate.fit.slope)} with bands of 1 and 2 residual "
            f"deviations of {digits(estimate.fit.sigma)}; R² {digits(estimate.r_squared, 4)}."
        )
        caption += (
            "Line and bands: the fit that the noise model draws from, 1 and 2 residual deviations. Good: points within "
            "narrow bands. A kink is a camera that changes its amplifier; then nearby ISOs say more than the line."
        )
    return drawn(name, f"{letters} over the gain", alt, caption, lambda theme: _scale(label, estimate, points, theme))


def _scale(label: str, estimate: LogLogEstimate | None, points: Sequence[Point], theme: Theme) -> Figure:
    drawing, axes = one_axes()
    gains = [gain for gain, _, _ in points]
    if estimate is not None:
        fit_band(axes, estimate.fit, np.geomspace(min(gains) / 1.15, max(gains) * 1.15, 50), theme)
    # A bar down to 0 has no end on a logarithmic axis.
    errors = [_bar(min(error, 0.9 * scale)) for _, scale, error in points]
    bars(axes, gains, [scale for _, scale, _ in points], errors, theme)
    log_log(axes, label)
    if len(points) == 1:
        gain, scale, _ = points[0]
        axes.set_xlim(gain / 2.2, gain * 2.2)
        axes.set_ylim(scale / 2.2, scale * 2.2)
    axes.legend(loc="upper left")
    return drawing


def _bar(error: float) -> float:
    return error if math.isfinite(error) and error > 0 else 0.0


def _by_iso(axes: Axes, isos: Sequence[float]) -> None:
    """Set up a logarithmic axis of ISOs."""
    axes.set_xscale("log")
    axes.set_xlabel("ISO")
    plain_ticks(axes.xaxis, isos[:: math.ceil(len(isos) / _ISOS_LABELLED)])
    axes.set_xlim(isos[0] / 1.4, isos[-1] * 1.4)


def _gain_plot(calibration: Calibration) -> Plot:
    known = [one for one in calibration.isos if one.gain_dn_per_e is not None]
    ratios = [(one.gain_dn_per_e or 0.0) / one.iso for one in known]
    usual = calibration.usual_gain_per_iso
    spread = max(abs(ratio / usual - 1) for ratio in ratios)
    return drawn(
        "gain",
        "K over ISO",
        f"K at {len(known)} ISO(s), {digits(min(one.gain_dn_per_e or 0.0 for one in known), 4)} to "
        f"{digits(max(one.gain_dn_per_e or 0.0 for one in known), 4)} DN/e⁻. K / ISO stays within {spread:.1%} of its "
        "median.",
        (
            "Top: K by ISO and the line of constant K / ISO. Below: K / ISO over its median. Good: at 1 throughout. "
            "Extended ISOs, which only multiply numbers, and frames in the wrong folder stand apart."
        ),
        lambda theme: _gain(known, usual, theme),
    )


def _gain(known: Sequence[IsoCalibration], usual: float, theme: Theme) -> Figure:
    drawing = figure()
    main, below = drawing.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1.8, 1]})
    isos = [one.iso for one in known]
    gains = [one.gain_dn_per_e or 0.0 for one in known]
    errors = [0.0 if one.transfer is None else _bar(one.transfer.gain_error) for one in known]
    ends = np.array([isos[0] / 1.3, isos[-1] * 1.3])
    main.plot(ends, usual * ends, color=theme.theory, label="constant K / ISO")
    bars(main, isos, gains, errors, theme)
    below.axhline(1, color=theme.theory, linewidth=1)
    relative = [gain / iso / usual for gain, iso in zip(gains, isos, strict=True)]
    bars(below, isos, relative, [error / iso / usual for error, iso in zip(errors, isos, strict=True)], theme)
    main.set_yscale("log")
    low, high = main.get_ylim()
    log_ticks(main.yaxis, round(math.log10(high / low)))
    main.set_ylabel("K [DN/e⁻]")
    main.legend(loc="upper left")
    reach = max(0.02, *(1.2 * abs(ratio - 1) for ratio in relative))
    below.set_ylim(1 - reach, 1 + reach)
    below.set_ylabel("K / ISO [median]")
    _by_iso(below, isos)
    return drawing


def _lambda_plot(calibration: Calibration) -> Plot:
    shapes = [one.read.tukey_lambda for one in calibration.isos]
    return drawn(
        "lambda",
        "λ over ISO",
        f"Shape λ of the read noise at {len(shapes)} ISO(s), from {digits(min(shapes))} to {digits(max(shapes))}.",
        (
            "Bars: one standard error. 0.14 is nearly the Gaussian, 0 the logistic distribution; the lower, the longer "
            "the tails. The noise model takes λ and the colour bias of one ISO together."
        ),
        lambda theme: _shapes(calibration, theme),
    )


def _shapes(calibration: Calibration, theme: Theme) -> Figure:
    drawing, axes = one_axes()
    axes.axhline(GAUSSIAN_LAMBDA, color=theme.ink, linewidth=1, linestyle=":", label="Gaussian, 0.14")
    axes.axhline(0, color=theme.theory, linewidth=1, label="logistic, 0")
    isos = [one.iso for one in calibration.isos]
    shapes = [one.read.tukey_lambda for one in calibration.isos]
    bars(axes, isos, shapes, [_bar(one.read.tukey_lambda_error) for one in calibration.isos], theme)
    _by_iso(axes, isos)
    axes.set_ylabel("λ")
    axes.margins(y=0.1)
    legend_above(axes)
    return drawing


def _bias_plot(calibration: Calibration) -> Plot:
    values = [value for one in calibration.isos for value in one.bias.bias_dn]
    return drawn(
        "bias",
        "Colour bias over ISO",
        f"Colour bias by channel at {len(calibration.isos)} ISO(s), from {digits(min(values))} to "
        f"{digits(max(values))} DN.",
        (
            "Mean of the bias frames over the recorded black level, bars one standard error. Good: near 0, channels "
            "together. Channels that part tint dark pictures, the more the higher the ISO."
        ),
        lambda theme: _biases(calibration, theme),
    )


def _biases(calibration: Calibration, theme: Theme) -> Figure:
    drawing, axes = one_axes()
    axes.axhline(0, color=theme.theory, linewidth=1)
    names = channel_names(len(calibration.isos[0].bias.bias_dn))
    for channel, name in enumerate(names):
        aside = math.exp((channel - (len(names) - 1) / 2) * _CHANNEL_STEP)
        axes.errorbar(
            [one.iso * aside for one in calibration.isos],
            [one.bias.bias_dn[channel] for one in calibration.isos],
            yerr=[_bar(one.bias.standard_error_dn[channel]) for one in calibration.isos],
            fmt=MARKERS[channel],
            color=theme.channels[channel],
            label=name,
        )
    _by_iso(axes, [one.iso for one in calibration.isos])
    axes.set_ylabel("colour bias [DN]")
    axes.margins(y=0.1)
    legend_above(axes)
    return drawing
