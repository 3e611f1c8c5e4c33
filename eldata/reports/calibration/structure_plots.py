"""What the noise of pixels has in common: the figures of one ISO, and their plots."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.plots.axes import Theme, legend_above, log_ticks, one_axes, plain_ticks, two_axes
from eldata.reports.calibration.joint_plots import by_iso
from eldata.reports.figures import Plot, drawn
from eldata.reports.html import digits, measured, plot_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.calibration.audit.structure import MeasuredStructure
    from eldata.calibration.iso_results import IsoCalibration
    from eldata.calibration.results import Calibration
    from eldata.noise.structure import RowSpectrum

_NONE = "none seen"
_MISSING = "not measured"
_FREQUENCIES_LABELLED = (1e-4, 1e-3, 0.01, 0.1, 0.5)

Point = tuple[float, float, float]
"""ISO, value and its standard error."""


def _or_none(value: float | None, error: float, unit: str, missing: str = _MISSING) -> str:
    if value is None:
        return missing
    return measured(value, error, unit) if value else _NONE


def structure_numbers(one: IsoCalibration, structure: MeasuredStructure) -> tuple[tuple[str, str], ...]:
    """Return the figures by name, with their errors."""
    of_rows = "withheld" if "row noise" in one.withheld else _MISSING
    spectrum, jumping = structure.row_spectrum, structure.telegraph
    numbers = [("C: σ column", _or_none(structure.sigma_column_dn, structure.sigma_column_error_dn, "DN", of_rows))]
    if spectrum is None:
        numbers.append(("W: rows", of_rows))
    else:
        numbers.append(("W: rows", "banded" if _is_banded(spectrum) else "independent of each other"))
        numbers.append(("σ of the rows by W", f"{digits(math.sqrt(spectrum.variance_dn2))} DN"))
        numbers += [
            (f"Wave of {digits(1 / wave.frequency_per_row)} rows", measured(wave.amplitude_dn, error, "DN"))
            for wave, error in zip(spectrum.waves, structure.wave_errors_dn, strict=True)
        ]
    if jumping is None:
        numbers.append(("T: telegraph pixels", _MISSING))
    else:
        numbers.append(("T: telegraph pixels", _or_none(1e6 * jumping.share, 1e6 * structure.share_error, "ppm")))
    if jumping is not None and jumping.share:
        numbers += [
            ("They jump by", measured(jumping.amplitude_dn, structure.amplitude_error_dn, "DN")),
            ("Share of frames at the upper level", measured(jumping.duty, structure.duty_error)),
            ("λ of the others, less that of all", digits(jumping.tukey_lambda_shift, 2)),
            ("σ TL of the others, over that of all", digits(jumping.sigma_tl_ratio)),
        ]
    prnu = structure.prnu
    numbers.append(("F: PRNU", _or_none(None if prnu is None else 100 * prnu, 100 * structure.prnu_error, "%")))
    return tuple(numbers)


def _is_banded(spectrum: RowSpectrum) -> bool:
    return len(spectrum.power_dn2) > 1 or bool(spectrum.waves)


def row_bands_plot(one: IsoCalibration, structure: MeasuredStructure, spectrum: RowSpectrum) -> Plot:
    """Draw the bands and waves that W makes, over the spectrum of the row means that they come from."""
    said = plot_words("calibration")["row-bands"]
    rows, columns = one.rows.rows, one.rows.columns
    waves = "".join(f", a wave of {digits(1 / wave.frequency_per_row)} rows" for wave in spectrum.waves)
    low, high = min(spectrum.power_dn2), max(spectrum.power_dn2)
    powers = f"power {digits(high)} DN²" if low == high else f"powers from {digits(low)} to {digits(high)} DN²"
    bands = len(spectrum.power_dn2)
    alt = (
        f"Spectrum of the row means at ISO {one.iso:g}, and what component W makes: {bands} band{'s'[: bands > 1]}, "
        f"{powers}{waves}."
    )

    def draw(theme: Theme) -> Figure:
        drawing, axes = one_axes()
        of_pixels = one.rows.pixel_variance_dn2 / columns.deviations_dn.shape[1]
        frequency, power = rows.smoothed_power_dn2(len(one.sensor.cfa))
        axes.plot(frequency, power, "o", markersize=3, color=theme.found, label="row means")
        edges = np.array(spectrum.edges_per_row)
        made = of_pixels + np.array(spectrum.power_dn2)
        axes.stairs(made, edges, baseline=None, color=theme.theory, linewidth=1.8, label="W and pixels")
        middles = np.sqrt(edges[:-1] * edges[1:])
        axes.errorbar(middles, made, yerr=structure.band_errors_dn2, fmt="none", color=theme.theory, capsize=3)
        axes.axhline(of_pixels, color=theme.theory, linewidth=1, linestyle="--", label="pixels alone")
        for number, wave in enumerate(spectrum.waves):
            label = "_" if number else "wave"
            axes.axvline(wave.frequency_per_row, color=theme.ink, linewidth=1.2, linestyle=":", label=label)
        axes.set_xscale("log")
        axes.set_yscale("log")
        plain_ticks(axes.xaxis, [at for at in _FREQUENCIES_LABELLED if edges[0] <= at])
        bottom, top = axes.get_ylim()
        log_ticks(axes.yaxis, max(1, round(math.log10(top / bottom))))
        axes.set(xlabel="frequency [cycles per row]", ylabel="power [DN²]")
        legend_above(axes)
        return drawing

    return drawn(f"row-bands-{one.iso:g}", said["title"], alt, said["caption"], draw)


# --- over the ISOs --------------------------------------------------------------------------------------------------


def structure_plots(calibration: Calibration) -> tuple[Plot, ...]:
    """Draw what was found over the ISOs: telegraph pixels, and the two patterns that have one figure."""
    known = [(one.iso, one.structure) for one in calibration.isos if one.structure is not None]
    shares = [(iso, 1e6 * jumping.share, 1e6 * found.share_error) for iso, found, jumping in _jumping(known)]
    jumps = [
        (iso, jumping.amplitude_dn, found.amplitude_error_dn)
        for iso, found, jumping in _jumping(known)
        if jumping.share
    ]
    columns = [
        (iso, found.sigma_column_dn, found.sigma_column_error_dn)
        for iso, found in known
        if found.sigma_column_dn is not None
    ]
    responses = [(iso, 100 * found.prnu, 100 * found.prnu_error) for iso, found in known if found.prnu is not None]
    plots = []
    if shares:
        labels = ("telegraph [ppm]", "jump [DN]")
        plots.append(_over_isos("telegraph", (shares, jumps), labels))
    if columns or responses:
        profile = calibration.made_profile
        pooled = None if profile is None else next((one.prnu for one in profile.structure), None)
        labels = ("σ column [DN]", "PRNU [%]")
        plots.append(
            _over_isos("patterns", (columns, responses), labels, below=None if pooled is None else 100 * pooled)
        )
    return tuple(plots)


def _jumping(known: Sequence[tuple[float, MeasuredStructure]]) -> list[tuple[float, MeasuredStructure, Any]]:
    return [(iso, found, found.telegraph) for iso, found in known if found.telegraph is not None]


def _over_isos(
    kind: str, points: tuple[Sequence[Point], Sequence[Point]], labels: tuple[str, str], below: float | None = None
) -> Plot:
    """Draw two figures over the ISOs, one above the other, and a line in the lower one."""
    by_iso_of = [", ".join(f"{_or_none(value, error, '')} at ISO {iso:g}" for iso, value, error in of) for of in points]
    found = "; ".join(f"{label}: {listed}" for label, listed in zip(labels, by_iso_of, strict=True) if listed)

    def draw(theme: Theme) -> tuple[Figure, Axes]:
        drawing, *both = two_axes(1)
        for axes, of_one, label in zip(both, points, labels, strict=True):
            _bars(axes, of_one, theme)
            axes.set_ylabel(label)
        if below is not None:
            both[1].axhline(below, color=theme.theory, label=f"in the profile, {digits(below)}")
            both[1].legend(loc="best")
        return drawing, both[1]

    isos = sorted({iso for of_one in points for iso, _, _ in of_one})
    return by_iso(kind, isos, f"{plot_words('calibration')[kind]['title']}. {found}.", draw, "")


def _bars(axes: Axes, points: Sequence[Point], theme: Theme) -> None:
    """Draw values with their errors; what is not told from nothing as rings at 0, which have none."""
    seen = [point for point in points if point[1]]
    none = [iso for iso, value, _ in points if not value]
    if seen:
        isos, values, errors = zip(*seen, strict=True)
        axes.errorbar(isos, values, yerr=errors, fmt="o", color=theme.found, capsize=3)
    if none:
        axes.plot(none, [0.0] * len(none), "o", color=theme.found, markerfacecolor="none")
    if points:
        axes.set_ylim(0 if not none else None, None)
        axes.margins(y=0.2)
    else:
        axes.set_yticks([])
