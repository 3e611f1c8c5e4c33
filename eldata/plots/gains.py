"""Calibrated figures: scales over the gain, the gain over the ISO, photon transfer."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from eldata.plots.axes import MARKERS, bars, fit_bands, legend_above, log_log, log_ticks, plain_ticks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from eldata.plots.axes import LogLogLine, Theme

Point: TypeAlias = tuple[float, float, float]
"""Gain, scale and the scale's standard error."""

_LEVELS_SHOWN = 20  # of a channel; more are pooled
_ISOS_LABELLED = 5


class TransferLine(Protocol):
    """The photon transfer line of one channel, with its points."""

    @property
    def signal_dn(self) -> NDArray[np.floating[Any]]:
        """Means of the points over black."""

    def variance_at(self, signal_dn: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Return the line's variance at these signals."""

    def pooled(
        self, levels: int
    ) -> tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]], NDArray[np.floating[Any]]]:
        """Return signal, variance and its standard error of at most so many points."""


def scale_over_gain(
    axes: Axes, name: str, lines: Sequence[tuple[LogLogLine, float, float]], points: Sequence[Point], theme: Theme
) -> None:
    """Draw measured scales over the gain, and fitted lines from a gain to a gain with their bands."""
    fit_bands(axes, lines, theme)
    gains, scales = [gain for gain, _, _ in points], [scale for _, scale, _ in points]
    if points:
        # A bar down to 0 has no end on a logarithmic axis.
        bars(axes, gains, scales, [bar(min(error, 0.9 * scale)) for _, scale, error in points], theme)
    log_log(axes, name)
    if len(points) == 1:
        axes.set_xlim(gains[0] / 2.2, gains[0] * 2.2)
        axes.set_ylim(scales[0] / 2.2, scales[0] * 2.2)
    axes.legend(loc="upper left")


def bar(error: float) -> float:
    """Return the length of an error's bar: none of an error that is not known."""
    return error if math.isfinite(error) and error > 0 else 0.0


def gain_over_iso(
    axes: Axes, isos: Sequence[float], gains: Sequence[float], errors: Sequence[float], usual: float, theme: Theme
) -> None:
    """Draw K over the ISO, and the line of the usual K / ISO."""
    ends = np.array([isos[0] / 1.3, isos[-1] * 1.3])
    axes.plot(ends, usual * ends, color=theme.theory, label="constant K / ISO")
    bars(axes, isos, gains, errors, theme)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    log_ticks(axes.yaxis, round(math.log10(high / low)))
    axes.set_ylabel("K [DN/e⁻]")
    axes.legend(loc="upper left")


def iso_axis(axes: Axes, isos: Sequence[float]) -> None:
    """Set up a logarithmic axis of ISOs."""
    axes.set_xscale("log")
    axes.set_xlabel("ISO")
    plain_ticks(axes.xaxis, isos[:: math.ceil(len(isos) / _ISOS_LABELLED)])
    axes.set_xlim(isos[0] / 1.4, isos[-1] * 1.4)


def transfer_lines(
    main: Axes, below: Axes | None, names: Sequence[str], lines: Sequence[TransferLine], theme: Theme
) -> float:
    """Draw the variance over the signal with the fitted lines; below, if wanted, the deviations from them.

    Returns
    -------
    float
        The furthest deviation, in standard errors.
    """
    furthest = 0.0
    for name, line, marker, colour in zip(names, lines, MARKERS, theme.channels, strict=False):
        signal, variance, error = line.pooled(_LEVELS_SHOWN)
        deviation = (variance - line.variance_at(signal)) / error
        furthest = max(furthest, float(np.abs(deviation).max()))
        main.errorbar(signal, variance, yerr=error, fmt=marker, markersize=4, color=colour, label=name)
        if below is not None:
            below.plot(signal, deviation, marker, markersize=3.5, color=colour)
    ends = np.array([0.0, max(float(line.signal_dn.max()) for line in lines)])
    for index, line in enumerate(lines):
        main.plot(ends, line.variance_at(ends), color=theme.theory, label="fitted" if index == 0 else "_")
    main.set_ylabel("variance [DN²]")
    legend_above(main, most=5)
    return furthest
