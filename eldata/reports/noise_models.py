"""Noise models as one HTML page each: the diagnostics of a profile, and the acceptance test against held-out frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from eldata.calibration.acceptance.verdicts import CHANNELS, LIMIT, SIGNALS_E, parameter_rows, read_fit
from eldata.plots.axes import (
    MARKERS,
    deviation_band,
    draw_quantiles,
    fit_bands,
    log_log,
    log_ticks,
    plain_ticks,
    thinned,
)
from eldata.reports.figures import draw_plot
from eldata.reports.html import plot_words, rendered

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from eldata.calibration.acceptance.results import Acceptance, Curve, IsoAcceptance
    from eldata.calibration.acceptance.verdicts import Diagnostics, TheoryCheck
    from eldata.plots.axes import Theme
    from eldata.reports.figures import Plot

_MEAN, _VARIANCE, _READ = "mean over signal", "variance over signal", "read noise alone"
_BIAS, _ROWS = "bias frame, mean by channel", "bias frame, row means"


def profile_page(diagnostics: Diagnostics) -> str:
    """Return the page; the same diagnostics give the same text."""
    groups = [
        _Group.of(check, tuple(comparisons))
        for check, comparisons in groupby(diagnostics.comparisons, lambda item: item.check)
    ]
    return rendered(
        "profile.html",
        diagnostics=diagnostics,
        profile=diagnostics.profile,
        parameters=parameter_rows(diagnostics.parameters),
        groups=groups,
        plots=plots(diagnostics),
        channels=CHANNELS,
        limit=LIMIT,
    )


@dataclass(frozen=True, slots=True)
class _Group:
    """A table: its caption, the heading and the labels of its first column, and the comparisons."""

    title: str
    heading: str
    labels: tuple[str, ...]
    comparisons: tuple[TheoryCheck, ...]

    @classmethod
    def of(cls, check: str, comparisons: tuple[TheoryCheck, ...]) -> _Group:
        units = {item.unit for item in comparisons}
        unit = comparisons[0].unit if len(units) == 1 else ""
        title = check[:1].upper() + check[1:] + (f" [{unit}]" if unit not in ("", "1") else "")
        labels = [item.symbol if unit else f"{item.symbol} [{item.unit}]" for item in comparisons]
        # What all labels begin with is said once.
        for heading, start in (("signal", "at "), ("quantile", "quantile ")):
            if all(label.startswith(start) for label in labels):
                return cls(title, heading, tuple(label.removeprefix(start) for label in labels), comparisons)
        return cls(title, "quantity", tuple(labels), comparisons)

    @property
    def off(self) -> tuple[TheoryCheck, ...]:
        return tuple(item for item in self.comparisons if item.verdict == "off")

    @property
    def worst(self) -> TheoryCheck:
        return max(self.comparisons, key=lambda item: abs(item.deviation or 0.0))


# --- plots -----------------------------------------------------------------------------------------------------------


def plots(diagnostics: Diagnostics) -> tuple[Plot, ...]:
    """Draw every plot that the diagnostics have data for, in the order of the report."""
    of_rows, read = f"{len(diagnostics.profile.rows)} calibration rows", _read_letters(diagnostics)
    fit = (
        "over the gain: the profile's line with its bands of 1 and 2 standard deviations, and where "
        f"{len(diagnostics.draws)} sampled parameters fall."
    )
    mean, variance, bias, rows = map(diagnostics.of, (_MEAN, _VARIANCE, _BIAS, _ROWS))
    biases = f"Mean of a bias frame in R, G1, B and G2, found and expected. {_worst(bias)}"
    below = 2.6  # of the heights, with deviations in standard errors below
    wanted: list[tuple[str, str, Callable[..., None], float | None]] = [
        ("mean", _over_signal_alt("Mean of D", mean), _draw_mean, below),
        ("variance", _over_signal_alt("Variance of D", variance), _draw_variance, below),
        ("colour-bias", biases, _draw_colour_bias, below),
        ("row-means", f"Normal probability plot of the row means. {_worst(rows)}", _draw_row_means, None),
        ("read-fit", f"σ {read} {fit}", partial(_draw_fit, "read"), None),
        ("row-fit", f"σ row {fit}", partial(_draw_fit, "row"), None),
        ("lambda-rows", f"Lambda of the profile's {of_rows} by ISO.", _draw_lambda_rows, None),
        (
            "bias-rows",
            f"Colour bias of the profile's {of_rows} by ISO and channel.",
            _draw_bias_rows,
            None,
        ),
    ]
    if diagnostics.quantiles_dn is not None:
        alt = "Probability plot of the read noise alone against its model. " + _worst(diagnostics.of(_READ))
        wanted.insert(4, ("read-noise", alt, partial(_draw_read_noise, diagnostics.quantiles_dn), below))
    return tuple(
        draw_plot("profile", kind, alt, partial(draw, diagnostics), ratio=ratio, words={"read": read})
        for kind, alt, draw, ratio in wanted
    )


def _read_letters(diagnostics: Diagnostics) -> str:
    return "G" if diagnostics.model.components.read == "gaussian" else "TL"


def _over_signal_alt(what: str, comparisons: Sequence[TheoryCheck]) -> str:
    return (
        f"{what} against the signal from {SIGNALS_E[0]:g} to {SIGNALS_E[-1]:g} electrons, simulated and by the closed "
        f"form. {_worst(comparisons)}"
    )


def _worst(comparisons: Sequence[TheoryCheck]) -> str:
    deviations = [abs(item.deviation) for item in comparisons if item.deviation is not None]
    if not deviations:
        return "No standard errors."
    return f"Largest deviation {max(deviations):.2g} standard errors."


def _draw_deviations(below: Axes, comparisons: Sequence[TheoryCheck], at: Sequence[float], theme: Theme) -> None:
    """Draw deviations in standard errors."""
    points = [
        (x, item.deviation, item.verdict) for x, item in zip(at, comparisons, strict=True) if item.deviation is not None
    ]
    deviation_band(below, max([0.0, *(abs(y) for _, y, _ in points)]), LIMIT, theme)
    _draw_verdicts(below, points, color=theme.found)


def _draw_verdicts(axes: Axes, points: Sequence[tuple[float, float, str]], **style: Any) -> None:
    """Draw points (x, y, verdict), those that are off by another sign."""
    for verdict, marker in (("ok", "o"), ("off", "X")):
        chosen = [(x, y) for x, y, which in points if which == verdict]
        if chosen:
            axes.plot(*zip(*chosen, strict=True), marker, **style)


def _draw_over_signal(
    both: tuple[Axes, Axes],
    comparisons: Sequence[TheoryCheck],
    theory: Callable[[float], float],
    label: str,
    theme: Theme,
) -> None:
    """Draw something against the signal; both axes are logarithmic, but for the neighbourhood of 0."""
    main, below = both
    _draw_deviations(below, comparisons, SIGNALS_E, theme)
    main.set_xscale("asinh", linear_width=1)
    top = SIGNALS_E[-1]
    grid = np.sinh(np.linspace(0, math.asinh(top), 120))
    curve = [theory(float(signal)) for signal in grid]
    main.plot(grid, curve, color=theme.theory, label="closed form")
    found = [item.found for item in comparisons]
    main.plot(SIGNALS_E, found, "o", color=theme.found, label="simulated")
    values = [*found, *curve]
    if min(values) > 0:
        main.set_yscale("log")
        log_ticks(main.yaxis, sum(1 for power in range(-9, 10) if min(values) < 10.0**power < max(values)))
    else:
        width = max(max(map(abs, values)) / top, 1e-6)
        main.set_yscale("asinh", linear_width=width)
        first = math.ceil(math.log10(2 * width))
        powers = [10.0 ** (first + step) for step in range(6)]
        plain_ticks(main.yaxis, [0, *powers, *(-power for power in powers)])
        main.set_ylim(*main.get_ylim())
    main.set_ylabel(label)
    main.legend(loc="upper left")
    below.set_xlabel("signal [e⁻]")
    plain_ticks(below.xaxis, [0, 1, 3, 10, 30, 100, 300])
    below.set_xlim(-0.2, top * 1.25)


def _draw_mean(diagnostics: Diagnostics, main: Axes, below: Axes, theme: Theme) -> None:
    _draw_over_signal((main, below), diagnostics.of(_MEAN), diagnostics.expected_mean_dn, "mean of D [DN]", theme)


def _draw_variance(diagnostics: Diagnostics, main: Axes, below: Axes, theme: Theme) -> None:
    expected = diagnostics.expected_variance_dn2
    _draw_over_signal((main, below), diagnostics.of(_VARIANCE), expected, "variance of D [DN²]", theme)


def _draw_colour_bias(diagnostics: Diagnostics, main: Axes, below: Axes, theme: Theme) -> None:
    places = list(range(4))
    _draw_deviations(below, diagnostics.of(_BIAS), places, theme)
    for place, item in zip(places, diagnostics.of(_BIAS), strict=True):
        # matplotlib leaves labels with an underscore out of the legend: one entry for four channels.
        label = ("closed form", "simulated") if place == 0 else ("_", "_")
        main.hlines(item.expected, place - 0.3, place + 0.3, color=theme.theory, linewidth=2, label=label[0])
        main.errorbar(
            place, item.found, yerr=item.standard_error, fmt="o", color=theme.found, capsize=4, label=label[1]
        )
    main.set_ylabel("mean [DN]")
    main.margins(y=0.25)
    main.legend(loc="best")
    below.set_xticks(places, CHANNELS)
    below.set_xlim(-0.5, 3.5)


def _draw_row_means(diagnostics: Diagnostics, axes: Axes, theme: Theme) -> None:
    means = diagnostics.row_means_dn
    shown = thinned(means.size)
    draw_quantiles(
        axes,
        theme,
        expected=diagnostics.normal_quantiles[shown],
        found=means[shown],
        line=(diagnostics.of(_ROWS)[0].expected, 0.0),
        names=("closed form", "simulated"),
        labels=("normal quantile", "row mean [DN]"),
    )


def _draw_read_noise(
    quantiles_dn: NDArray[np.floating[Any]], diagnostics: Diagnostics, main: Axes, below: Axes, theme: Theme
) -> None:
    comparisons = diagnostics.of(_READ)
    _draw_deviations(below, comparisons, [item.expected for item in comparisons], theme)
    expected, found = quantiles_dn
    ends = expected[[0, -1]]
    main.plot(ends, ends, color=theme.theory, label="closed form")
    main.plot(expected, found, "o", markersize=3, color=theme.found, label="simulated")
    main.set_ylabel("found quantile [DN]")
    main.legend(loc="upper left")
    family = {"G": "Gaussian", "TL": "Tukey-lambda"}[_read_letters(diagnostics)]
    below.set_xlabel(f"{family} quantile [DN]")


def _draw_fit(which: str, diagnostics: Diagnostics, axes: Axes, theme: Theme) -> None:
    """Draw a log-log fit by gain mode with its bands, the draws, the measured rows and the draw that is examined."""
    modes, draws, read = diagnostics.profile.gain_modes, diagnostics.draws, _read_letters(diagnostics)
    if which == "row":
        name, field, fits = "row", "sigma_row_dn", [mode.row_fit for mode in modes]
    else:
        name, field = read, {"G": "sigma_gauss_dn", "TL": "sigma_tl_dn"}[read]
        fits = [read_fit(mode, diagnostics.model.components) for mode in modes]
    lines = [(fit, *mode.gain_range_dn_per_e) for fit, mode in zip(fits, modes, strict=True)]
    fit_bands(axes, lines, theme)
    gains, scales = [draw.gain_dn_per_e for draw in draws], [getattr(draw, field) for draw in draws]
    axes.plot(gains, scales, "o", markersize=2.5, alpha=0.75, color=theme.found, label="sampled")
    measured = [
        (row.gain_dn_per_e, scale)
        for row in diagnostics.profile.rows
        if row.gain_dn_per_e is not None and (scale := getattr(row, field) or 0.0) > 0
    ]
    if measured:
        axes.plot(*zip(*measured, strict=True), "D", color=theme.ink, markersize=5, label="measured")
    ring: dict[str, Any] = {"markersize": 10, "markerfacecolor": "none", "markeredgewidth": 1.8, "color": theme.ink}
    parameters = diagnostics.parameters
    axes.plot(parameters.gain_dn_per_e, getattr(parameters, field), "o", label="examined here", **ring)
    log_log(axes, name)
    axes.legend(loc="upper left")


def _set_up_isos(diagnostics: Diagnostics, axes: Axes) -> list[float]:
    """Set up an axis of ISOs and return each row's place on it; of row numbers if an ISO is unknown."""
    isos = [row.iso for row in diagnostics.profile.rows]
    known = [iso for iso in isos if iso is not None]
    if len(known) < len(isos):
        axes.set_xlabel("calibration row")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        return [float(index + 1) for index in range(len(isos))]
    axes.set_xscale("log")
    axes.set_xlabel("ISO")
    distinct = sorted(set(known))
    step = math.ceil(len(distinct) / 5)
    plain_ticks(axes.xaxis, distinct[::step])
    return known


def _draw_lambda_rows(diagnostics: Diagnostics, axes: Axes, theme: Theme) -> None:
    places = _set_up_isos(diagnostics, axes)
    axes.axhline(0, color=theme.theory, linewidth=1)
    axes.plot(places, [row.tukey_lambda for row in diagnostics.profile.rows], "o", color=theme.found)
    axes.set_ylabel("λ")


def _draw_bias_rows(diagnostics: Diagnostics, axes: Axes, theme: Theme) -> None:
    places = _set_up_isos(diagnostics, axes)
    step = 0.07 if axes.get_xscale() == "log" else 0.0  # side by side, where the channels' values are alike
    for channel, name in enumerate(CHANNELS):
        beside = [place * math.exp((channel - 1.5) * step) for place in places]
        style: dict[str, Any] = {"marker": MARKERS[channel], "color": theme.channels[channel], "linestyle": "none"}
        axes.plot(beside, [row.colour_bias_dn[channel] for row in diagnostics.profile.rows], label=name, **style)
        for place, row in zip(beside, diagnostics.profile.rows, strict=True):
            frames = [of_frame[channel] for of_frame in row.frame_bias_dn]
            axes.plot([place] * len(frames), frames, markersize=2, alpha=0.4, **style)
    axes.axhline(0, color=theme.theory, linewidth=1)
    axes.set_ylabel("colour bias [DN]")
    axes.legend(loc="best", ncols=2)


# --- the acceptance test ----------------------------------------------------------------------------------------------

_LABELS = {
    "tails": ("difference [σ]", "share beyond"),
    "row-spectrum": ("cycles per row", "power of row means [DN²]"),
    "column-spectrum": ("cycles per column", "power of column means [DN²]"),
}
_REACH = 20.0  # standard errors: beyond, a point lies at the edge


def acceptance_page(acceptance: Acceptance) -> str:
    """Return the page; the same result gives the same text."""
    isos = [
        {
            "found": found,
            "name": f"{found.iso:g}",
            "parameters": parameter_rows(found.parameters),
            "plots": _acceptance_plots(found),
            "groups": [(check, tuple(group)) for check, group in groupby(found.statistics, lambda one: one.check)],
        }
        for found in acceptance.isos
    ]
    return rendered("acceptance.html", acceptance=acceptance, isos=isos, limit=LIMIT)


def _acceptance_plots(found: IsoAcceptance) -> list[Plot]:
    """Draw the verdicts and the curves of one ISO."""
    worst = max((abs(one.deviation or 0.0) for one in found.statistics), default=0.0)
    alt = f"Deviations of {len(found.statistics)} statistics; {len(found.off)} are off, the furthest {worst:.3g} s.e."
    drawn = [("deviations", alt, partial(_draw_checks, found))]
    for curve in found.curves:
        title = plot_words("acceptance")[curve.name]["title"]
        drawn.append((curve.name, f"{title}: the held-out frames and the model.", partial(_draw_curve, curve)))
    return [draw_plot("acceptance", kind, alt, draw, name=f"{kind}-{found.iso:g}") for kind, alt, draw in drawn]


def _draw_checks(found: IsoAcceptance, axes: Axes, theme: Theme) -> None:
    checks = list(dict.fromkeys(one.check for one in found.statistics))
    axes.axvspan(-LIMIT, LIMIT, color=theme.theory, alpha=0.13, linewidth=0)
    axes.axvline(0, color=theme.theory, linewidth=1)
    points = [
        (max(-_REACH, min(_REACH, one.deviation)), checks.index(one.check), one.verdict)
        for one in found.statistics
        if one.deviation is not None
    ]
    _draw_verdicts(axes, points, color=theme.found, alpha=0.7)
    axes.set_yticks(range(len(checks)), checks)
    axes.invert_yaxis()
    axes.set_xlim(-1.1 * _REACH, 1.1 * _REACH)
    axes.set_xlabel("model − frames [s.e.]")


def _draw_curve(curve: Curve, axes: Axes, theme: Theme) -> None:
    for values, style, colour, label in (
        (curve.frames, "-", theme.theory, "held-out frames"),
        (curve.model, "--", theme.found, "model"),
    ):
        shown = values > 0
        axes.plot(curve.x[shown], values[shown], style, color=colour, label=label)
    axes.set_yscale("log")
    if curve.name != "tails":  # room for three decades: the wiggles of chance look as small as they are
        middle = float(curve.model[len(curve.model) // 2]) or 1.0
        axes.set_ylim(min(middle / 30, *curve.frames), max(middle * 30, *curve.frames))
    log_ticks(axes.yaxis, 3)
    xlabel, ylabel = _LABELS[curve.name]
    axes.set(xlabel=xlabel, ylabel=ylabel)
    axes.legend(loc="upper right")
