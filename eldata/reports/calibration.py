"""A calibration as one HTML page: verdict, tables, fits, and for each ISO the plots that show whether to believe it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from eldata.base.numbers import counted
from eldata.reports.calibration_iso import (
    bias_plot,
    estimated,
    line_spectrum_plot,
    ppcc_plot,
    read_noise_plots,
    reproduced_pictures,
    reproduced_plot,
    rows_plot,
    shading_pictures,
    spectrum_picture,
    transfer_plot,
)
from eldata.reports.calibration_joint import joint_plots
from eldata.reports.html import digits, grouped, measured, rendered

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.calibration.findings import Effect, Quantity
    from eldata.calibration.iso_results import IsoCalibration, IsoGain, MeasuredFigure
    from eldata.calibration.results import Calibration
    from eldata.reports.calibration_iso import Pictures
    from eldata.reports.html import Plot

_GRAVEST: tuple[Effect, ...] = ("withheld", "wider", "remark")
_READ: tuple[Quantity, ...] = ("shape", "read noise")
_FIT_HEADER = ("fit over ln K", "slope", "intercept", "σ", "R²")
_CAPTIONS = {
    "figures": "Figures, value ± standard error",
    "gains": "K alone, from flats without bias frames",
    "colour-bias": "Colour bias over the recorded black level [DN]",
    "fits": "Lines of ln σ over ln K",
    "reproduction": "A bias frame kept out, against simulated ones",
}


def calibration_page(calibration: Calibration) -> str:
    """Return the page; the same calibration gives the same text."""
    return rendered(
        "calibration.html",
        calibration=calibration,
        verdict=_verdict(calibration) + _without_profile(calibration),
        wary=_wary(calibration),
        withheld=_where([one.symbols("withheld") for one in calibration.all_isos], calibration),
        widened=_where([one.symbols("wider") for one in calibration.all_isos], calibration),
        remarks=_remarks(calibration),
        tables=_tables(calibration),
        joint=joint_plots(calibration),
        sections=_sections(calibration),
        made_from=_made_from(calibration),
    )


@dataclass(frozen=True, slots=True)
class _Group:
    """Plots and figures of one kind of noise."""

    title: str
    numbers: tuple[tuple[str, str], ...]
    plots: tuple[Plot, ...] = ()
    pictures: tuple[Pictures, ...] = ()
    note: str = ""
    effect: Effect = "remark"


def _tables(calibration: Calibration) -> list[dict[str, Any]]:
    """Return name, caption, header and rows of each table that has any."""
    return [
        {"name": name, "caption": _CAPTIONS[name], "header": _FIT_HEADER if name == "fits" else header, "rows": rows}
        for name, (header, rows) in calibration.tables().items()
    ]


# --- verdict ------------------------------------------------------------------------------------------------------


def _verdict(calibration: Calibration) -> str:
    """Return how much was measured, in a sentence."""
    isos = calibration.all_isos
    where = f"ISO {isos[0].iso:g}" if len(isos) == 1 else f"{len(isos)} ISOs from {isos[0].iso:g} to {isos[-1].iso:g}"
    gains = [one.gain_dn_per_e for one in isos if one.gain_dn_per_e is not None]
    if not gains:
        is_withheld = any("gain" in one.withheld for one in isos)
        return f"{where}; K is {'withheld' if is_withheld else 'not known, for want of flats'}."
    low, high = digits(min(gains)), digits(max(gains))
    found = f"K is {low} DN/e⁻" if low == high else f"K from {low} to {high} DN/e⁻"
    missing = len(isos) - len(gains)
    return f"{where}, {found}{f', not given at {missing} of them' if missing else ''}."


def _without_profile(calibration: Calibration) -> str:
    """Return why there is no profile, as a further sentence; empty if there is one."""
    return f" No profile can be made: {calibration.no_profile}." if calibration.no_profile else ""


def _wary(calibration: Calibration) -> str:
    """Return where there is something to be wary of, in a sentence; empty if nowhere."""
    places = [f"ISO {one.iso:g}" for one in calibration.all_isos if one.all_remarks]
    if not places and not calibration.remarks:
        return ""
    if len(places) == len(calibration.all_isos) > 1:
        places = ["every ISO"]
    elif len(places) > 3:
        places = [f"{len(places)} of {len(calibration.all_isos)} ISOs"]
    about = [*places, *(["the calibration as a whole"] if calibration.remarks else [])]
    number = len(calibration.all_remarks)
    return f"{counted(number, 'remark')}, on {_and(about)}."


def _where(symbols: Sequence[str], calibration: Calibration) -> str:
    """Return symbols of figures with the ISOs that each list of them belongs to; empty if there are none."""
    isos: dict[str, list[str]] = {}
    for of_one, one in zip(symbols, calibration.all_isos, strict=True):
        if of_one:
            isos.setdefault(of_one, []).append(f"{one.iso:g}")
    return "; ".join(f"{of_one} at ISO {_and(places)}" for of_one, places in isos.items())


def _remarks(calibration: Calibration) -> list[tuple[str, str, Effect]]:
    """Return of which ISOs (of the whole if empty) what is remarked, and what becomes of figures, gravest first.

    What is said of several ISOs is said once.
    """
    isos: dict[tuple[str, Effect], list[str]] = {}
    for one in calibration.all_isos:
        for remark in _remarks_on(one):
            isos.setdefault(remark, []).append(f"{one.iso:g}")
    of_isos = [(f"ISO {_and(places)}", remark, effect) for (remark, effect), places in isos.items()]
    of_all: list[tuple[str, str, Effect]] = [("", remark, "remark") for remark in calibration.remarks]
    return sorted(of_isos + of_all, key=lambda remark: _GRAVEST.index(remark[2]))


def _remarks_on(one: IsoGain) -> list[tuple[str, Effect]]:
    of_findings = [(finding.remark, finding.effect) for finding in one.findings]
    return [*of_findings, *((remark, "remark") for remark in one.remarks)]


def _and(items: Sequence[str]) -> str:
    return " and ".join([", ".join(items[:-1]), items[-1]]) if len(items) > 1 else items[0]


def _made_from(calibration: Calibration) -> str:
    isos = calibration.all_isos
    sizes = sorted({(one.sensor.width, one.sensor.height) for one in isos})
    shapes = _and([f"{width} × {height}" for width, height in sizes])
    bias, flat = sum(one.bias_frames for one in calibration.isos), sum(one.flat_frames for one in isos)
    kept = sum(one.reproduction is not None for one in calibration.isos)
    frames = f"{bias} bias and {flat} flat frames of {shapes} pixels"
    return f"{frames}, and compared with {counted(kept, 'more bias frame')}" if kept else frames


# --- one ISO ------------------------------------------------------------------------------------------------------


def _sections(calibration: Calibration) -> list[tuple[str, str, list[tuple[str, Effect]], tuple[_Group, ...]]]:
    """Return ISO, summary, remarks and groups of each ISO, ascending."""
    of_gain = [(one, _gain_summary(one), (_gain(one),)) for one in calibration.gains]
    of_all = [(one, _summary(one), _groups(one)) for one in calibration.isos]
    ascending = sorted((*of_gain, *of_all), key=lambda section: section[0].iso)
    return [(f"{one.iso:g}", summary, _remarks_on(one), groups) for one, summary, groups in ascending]


def _gain_summary(one: IsoGain) -> str:
    return "K not known" if one.gain_text == "-" else f"K {_alone(one.gain)}"


def _summary(one: IsoCalibration) -> str:
    shape, scale, row = _alone(one.tukey_lambda, 2), _alone(one.sigma_tl_dn), _alone(one.sigma_row_dn)
    return f"{_gain_summary(one)}, λ {shape}, σ TL {scale}, σ row {row}"


def _alone(figure: MeasuredFigure | None, count: int = 3) -> str:
    """Return a figure without its error."""
    if figure is None:
        return "withheld"
    return digits(figure.value, count) + (" (stated)" if figure.is_stated else "")


def _judged(one: IsoGain, group: _Group, *figures: Quantity) -> _Group:
    """Return a group with the sentence why figures are not given, or with which error; as it is if all is well."""
    if why := one.why(*figures):
        return replace(group, note=f"Withheld: {why.rstrip('.')}.", effect="withheld")
    if why := one.why(*figures, effect="wider"):
        return replace(group, note=f"Errors made larger: {why.rstrip('.')}.", effect="wider")
    return group


def _groups(one: IsoCalibration) -> tuple[_Group, ...]:
    return _gain(one), _colour_bias(one), _rows(one), _read_noise(one), _reproduction(one), _pattern(one)


def _by_channel(template: str, one: IsoGain, values: Sequence[str]) -> list[tuple[str, str]]:
    """Return a text for each CFA channel, with the template's name for it."""
    return [(template.format(name), value) for name, value in zip(one.channels, values, strict=True)]


def _gain(one: IsoGain) -> _Group:
    title = "System gain K"
    if one.transfer is None:
        stated = () if one.gain is None else (("K [DN/e⁻]", estimated(one.gain)),)
        note = "There are no pairs of equal flats of this ISO, so K is not known and there is no photon transfer line."
        if stated:
            note = "K is stated: there is no photon transfer line that gives it."
        return _judged(one, _Group(title, stated, note=note), "gain")
    transfer = one.transfer
    numbers = [("K [DN/e⁻]", estimated(one.gain))]
    if one.channel_gains is not None:
        numbers += _by_channel("K of {}", one, [estimated(gain) for gain in one.channel_gains])
    if one.spatial_gain is not None:
        numbers.append(("K as published", estimated(one.spatial_gain)))
    numbers += [
        ("Channels' χ² per d.o.f.", digits(transfer.agreement_chi2_per_dof, 2)),
        ("Flat frames", str(transfer.frames)),
        ("Area left out", f"{transfer.left_out:.1%}"),
    ]
    return _judged(one, _Group(title, tuple(numbers), plots=(transfer_plot(one, transfer),)), "gain")


def _colour_bias(one: IsoCalibration) -> _Group:
    bias = one.bias
    blacks = sorted(set(one.sensor.black_level_dn))
    given = one.colour_bias
    numbers = [
        *([] if given is None else _by_channel("{}", one, [estimated(channel, "DN") for channel in given])),
        ("Recorded black", f"{_and([f'{level:g}' for level in blacks])} DN"),
        ("Bias frames", str(bias.frames)),
    ]
    plots = () if given is None else (bias_plot(one, given),)
    return _judged(one, _Group("Colour bias", tuple(numbers), plots=plots), "colour bias")


def _rows(one: IsoCalibration) -> _Group:
    rows, columns = one.rows.rows, one.rows.columns
    numbers = (
        ("σ row", estimated(one.sigma_row_dn, "DN")),
        ("σ column", estimated(one.sigma_column_dn, "DN")),
        ("Fixed rows", f"{digits(rows.fixed_sigma_dn)} DN"),
        ("Fixed columns", f"{digits(columns.fixed_sigma_dn)} DN"),
        ("Shapiro-Wilk p", digits(rows.shapiro_p, 2)),
        ("Excess kurtosis", digits(rows.excess_kurtosis, 2)),
    )
    plots = (rows_plot(one), line_spectrum_plot(one))
    return _judged(one, _Group("Row noise", numbers, plots=plots, pictures=(spectrum_picture(one),)), "row noise")


def _read_noise(one: IsoCalibration) -> _Group:
    title, read, plot, shape = "Read noise", one.read, one.plot, one.tukey_lambda
    if read is None or plot is None:
        return _judged(one, _Group(title, ()), *_READ)
    by_ppcc = (("λ by PPCC", digits(read.ppcc_lambda)), ("σ TL by PPCC", f"{digits(read.ppcc_sigma_tl_dn)} DN"))
    numbers = (
        ("λ", estimated(shape)),
        ("σ TL", estimated(one.sigma_tl_dn, "DN")),
        ("σ G", estimated(one.sigma_gauss_dn, "DN")),
        *(() if shape is None else by_ppcc),
        *([] if math.isnan(read.chi2_per_dof) else [("χ² per d.o.f.", digits(read.chi2_per_dof))]),
        ("R², Tukey lambda", digits(read.r_squared_tl, 6)),
        ("R², Gaussian", digits(read.r_squared_gauss, 6)),
        *_as_published(one),
        ("Residuals", grouped(read.residuals)),
    )
    of_shape = () if shape is None else (ppcc_plot(one, read, shape),)
    return _judged(one, _Group(title, numbers, plots=(*of_shape, *read_noise_plots(one, read, plot))), *_READ)


def _as_published(one: IsoCalibration) -> tuple[tuple[str, str], ...]:
    if one.single_frame is None:
        return ()
    of_shape, of_normal, _ = one.single_frame
    return (
        ("R² as published, Tukey lambda", digits(of_shape, 6)),
        ("R² as published, Gaussian", digits(of_normal, 6)),
    )


def _reproduction(one: IsoCalibration) -> _Group:
    title = "A bias frame kept out, against the model"
    found = one.reproduction
    if found is None:
        note = f"None was kept out: there were only {one.bias_frames} bias frames, and all went into the estimates."
        if one.parameters is None:
            note = "There is none, since a figure that it would be made with is withheld."
        return _Group(title, (), note=note)
    numbers = (
        ("R² of the quantiles", digits(found.r_squared, 6)),
        ("Histograms differ by", f"{found.histogram_distance:.2%}"),
        ("By chance", f"{found.histogram_distance_by_chance:.2%}"),
        ("σ real", f"{digits(found.sigma_real_dn, 4)} DN"),
        ("σ simulated", f"{digits(found.sigma_simulated_dn, 4)} DN"),
        ("Row means, σ real", f"{digits(found.row_sigma_real_dn)} DN"),
        ("Row means, σ simulated", f"{digits(found.row_sigma_simulated_dn)} DN"),
    )
    return _Group(title, numbers, plots=(reproduced_plot(one, found),), pictures=(reproduced_pictures(one, found),))


def _pattern(one: IsoCalibration) -> _Group:
    pattern = one.pattern
    numbers = (
        ("Defects", f"{grouped(pattern.defects)}, {digits(100 * pattern.defects / pattern.pixels, 2)} %"),
        ("Off their level", grouped(pattern.off_level)),
        ("Never changing", grouped(pattern.stuck)),
        *_by_channel(
            "DSNU of {}",
            one,
            [measured(*figure, "DN") for figure in zip(pattern.dsnu_dn, pattern.dsnu_error_dn, strict=True)],
        ),
    )
    return _Group("What stays from frame to frame", numbers, pictures=(shading_pictures(one),))
