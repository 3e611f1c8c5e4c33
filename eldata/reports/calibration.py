"""A calibration as one HTML page: verdict, tables, fits, and for each ISO the plots that show whether to believe it.

What is a figure is read from the calibration's records (:class:`~eldata.calibration.iso_results.MeasuredFigure`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from eldata.base.numbers import counted
from eldata.reports import calibration_iso as drawn
from eldata.reports.calibration_iso import Pictures, format_figure
from eldata.reports.calibration_joint import joint_plots
from eldata.reports.html import Plot, digits, format_count, format_measured, join_words, render_page, typeset

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from eldata.calibration.iso_results import Effect, IsoCalibration, IsoGain, MeasuredFigure, Quantity
    from eldata.calibration.results import Calibration

    Rows = list[tuple[str, str]]

_GRAVEST: tuple[Effect, ...] = ("withheld", "wider", "remark")
_FIT_HEADER = ("fit over ln K", "slope", "intercept", "σ", "R²")
_CAPTIONS = {
    "figures": "Figures, value ± standard error",
    "gains": "K alone, from flats without bias frames",
    "colour-bias": "Colour bias over the recorded black level [DN]",
    "fits": "Lines of ln σ over ln K",
    "reproduction": "A bias frame kept out, against simulated ones",
}
_SUMMARY = ("tukey_lambda", "sigma_tl_dn", "sigma_row_dn")
_ROW_NOISE = {"sigma_row_dn": "σ row", "sigma_column_dn": "σ column"}
_READ_NOISE = {
    "tukey_lambda": "λ",
    "sigma_tl_dn": "σ TL",
    "sigma_gauss_dn": "σ G",
    "ppcc_lambda": "λ by PPCC",
    "ppcc_sigma_tl_dn": "σ TL by PPCC",
    "read_chi2_per_dof": "χ² per d.o.f.",
    "r_squared_tl": "R², Tukey lambda",
    "r_squared_gauss": "R², Gaussian",
}


def calibration_page(calibration: Calibration) -> str:
    """Render the page of a calibration; the same calibration gives the same text."""
    isos = calibration.all_isos
    return render_page(
        "calibration.html",
        calibration=calibration,
        verdict=_verdict(calibration),
        wary=_count_remarks(calibration),
        withheld=_list_symbols("withheld", isos),
        widened=_list_symbols("wider", isos),
        remarks=_sort_remarks(calibration),
        tables=[
            (name, _CAPTIONS[name], _FIT_HEADER if name == "fits" else header, rows)
            for name, (header, rows) in calibration.tables().items()
        ],
        joint=joint_plots(calibration),
        sections=_list_sections(calibration),
        made_from=_describe_frames(calibration),
    )


# --- verdict ------------------------------------------------------------------------------------------------------


def _verdict(calibration: Calibration) -> str:
    """Say in sentences how much was measured, and why there is no profile if there is none."""
    isos = calibration.all_isos
    where = f"ISO {isos[0].iso:g}" if len(isos) == 1 else f"{len(isos)} ISOs from {isos[0].iso:g} to {isos[-1].iso:g}"
    gains = [record.gain_dn_per_e for record in isos if record.gain_dn_per_e is not None]
    if gains:
        low, high, missing = digits(min(gains)), digits(max(gains)), len(isos) - len(gains)
        of_gain = f", K is {low} DN/e⁻" if low == high else f", K from {low} to {high} DN/e⁻"
        of_gain += f", not given at {missing} of them" if missing else ""
    else:
        is_withheld = any("gain" in record.withheld for record in isos)
        of_gain = f"; K is {'withheld' if is_withheld else 'not known, for want of flats'}"
    of_profile = f" No profile can be made: {calibration.no_profile}." if calibration.no_profile else ""
    return f"{where}{of_gain}.{of_profile}"


def _count_remarks(calibration: Calibration) -> str:
    """Count the remarks, with the ISOs that have any, in a sentence; empty if there are none."""
    places = [f"ISO {record.iso:g}" for record in calibration.all_isos if record.all_remarks]
    if not places and not calibration.remarks:
        return ""
    if len(places) == len(calibration.all_isos) > 1:
        places = ["every ISO"]
    elif len(places) > 3:
        places = [f"{len(places)} of {len(calibration.all_isos)} ISOs"]
    places += ["the calibration as a whole"] if calibration.remarks else []
    return f"{counted(len(calibration.all_remarks), 'remark')}, on {join_words(places)}."


def _join_isos(items: Iterable[tuple[Any, IsoGain]]) -> dict[Any, str]:
    """List each item once, with its ISOs."""
    isos: dict[Any, list[str]] = {}
    for item, record in items:
        isos.setdefault(item, []).append(f"{record.iso:g}")
    return {item: f"ISO {join_words(names)}" for item, names in isos.items()}


def _list_symbols(effect: Effect, isos: Sequence[IsoGain]) -> str:
    """List the symbols of figures that are withheld, or have a larger error, with their ISOs; empty if none."""
    symbols = _join_isos((record.symbols(effect), record) for record in isos)
    return "; ".join(f"{names} at {where}" for names, where in symbols.items() if names)


def _sort_remarks(calibration: Calibration) -> list[tuple[str, str, Effect]]:
    """List each remark once, gravest first: its ISOs (empty: the whole calibration), text, effect on figures."""
    of_isos = _join_isos((remark, record) for record in calibration.all_isos for remark in _list_remarks(record))
    remarks: list[tuple[str, str, Effect]] = [(where, *remark) for remark, where in of_isos.items()]
    remarks += [("", remark, "remark") for remark in calibration.remarks]
    return sorted(remarks, key=lambda remark: _GRAVEST.index(remark[2]))


def _list_remarks(record: IsoGain) -> list[tuple[str, Effect]]:
    """List the remarks of an ISO's findings, then its own, each with its effect on figures."""
    of_findings = [(finding.remark, finding.effect) for finding in record.findings]
    return [*of_findings, *((remark, "remark") for remark in record.remarks)]


def _describe_frames(calibration: Calibration) -> str:
    """Say how many frames, and of which sizes, a calibration has used."""
    isos = calibration.all_isos
    sizes = sorted({(record.sensor.width, record.sensor.height) for record in isos})
    shapes = join_words([f"{width} × {height}" for width, height in sizes])
    bias = sum(record.bias_frames for record in calibration.isos)
    flat = sum(record.flat_frames for record in isos if record.transfer)
    kept = sum(record.reproduction is not None for record in calibration.isos)
    frames = f"{bias} bias and {flat} flat frames of {shapes} pixels"
    return f"{frames}, and compared with {counted(kept, 'more bias frame')}" if kept else frames


# --- one ISO ------------------------------------------------------------------------------------------------------


def _list_sections(calibration: Calibration) -> list[tuple[str, str, list[tuple[str, Effect]], list[dict[str, Any]]]]:
    """List ISO, summary, remarks and groups of each ISO, ascending."""
    groups = {record.iso: [_group_gain(record)] for record in calibration.gains}
    summaries = dict.fromkeys(groups, "")
    for record in calibration.isos:
        figures = (record.figures[name] for name in _SUMMARY)
        summaries[record.iso] = "".join(
            f", {typeset(figure.label)} {_alone(figure, 3 if figure.unit else 2)}" for figure in figures
        )
        kinds = (_group_gain, _group_colour_bias, _group_rows, _group_read_noise, _group_reproduction, _group_pattern)
        groups[record.iso] = [gather(record) for gather in kinds]
    sections = []
    for each in calibration.all_isos:
        gain = "K not known" if each.gain_text == "-" else f"K {_alone(each.gain)}"
        sections.append((f"{each.iso:g}", gain + summaries[each.iso], _list_remarks(each), groups[each.iso]))
    return sections


def _alone(figure: MeasuredFigure | None, count: int = 3) -> str:
    """Write a figure without its error."""
    if figure is None or math.isnan(figure.value):
        return "withheld"
    return digits(figure.value, count) + (" (stated)" if figure.is_stated else "")


def _group(
    record: IsoGain,
    title: str,
    numbers: Rows,
    *quantities: Quantity,
    plots: Sequence[Plot] = (),
    pictures: Sequence[Pictures] = (),
    note: str = "",
) -> dict[str, Any]:
    """Gather numbers, plots and pictures of one kind of noise, and why its quantities are withheld or less exact."""
    effect: Effect = "remark"
    if why := record.why(*quantities):
        note, effect = f"Withheld: {why.rstrip('.')}.", "withheld"
    elif why := record.why(*quantities, effect="wider"):
        note, effect = f"Errors made larger: {why.rstrip('.')}.", "wider"
    shown = {"numbers": numbers, "plots": plots, "pictures": pictures}
    return {"title": title, **shown, "note": note, "effect": effect}


def _format_figures(record: IsoCalibration, labels: Mapping[str, str]) -> Rows:
    """Write figures with their errors; one that never has any is left out where it is not known."""
    figures = [(label, record.figures[name]) for name, label in labels.items()]
    return [
        (label, format_figure(figure) if figure.decimals is None else _alone(figure, 6 if "R²" in label else 3) + unit)
        for label, figure in figures
        for unit in [f" {figure.unit}".rstrip()]
        if figure.decimals is None or not math.isnan(figure.value)
    ]


def _label_channels(template: str, record: IsoGain, values: Iterable[str]) -> Rows:
    """Label each CFA channel's text by the template, filled with the channel's name."""
    return [(template.format(name), value) for name, value in zip(record.channels, values, strict=True)]


def _group_gain(record: IsoGain) -> dict[str, Any]:
    """Gather the gain's figures and its photon transfer plot; without flats, a note says so."""
    title, transfer = "System gain K", record.transfer
    numbers = [] if transfer is None and record.gain is None else [("K [DN/e⁻]", format_figure(record.gain, ""))]
    if transfer is None:
        note = "There are no pairs of equal flats of this ISO, so K is not known and there is no photon transfer line."
        if numbers:
            note = "K is stated: there is no photon transfer line that gives it."
        return _group(record, title, numbers, "gain", note=note)
    if record.channel_gains is not None:
        numbers += _label_channels("K of {}", record, [format_figure(gain, "") for gain in record.channel_gains])
    numbers += [
        ("Channels' χ² per d.o.f.", digits(transfer.agreement_chi2_per_dof, 2)),
        ("Flat frames", str(transfer.frames)),
        ("Area left out", f"{transfer.left_out:.1%}"),
    ]
    return _group(record, title, numbers, "gain", plots=[drawn.transfer_plot(record, transfer)])


def _group_colour_bias(record: IsoCalibration) -> dict[str, Any]:
    """Gather the mean of each CFA channel in bias frames, and their plot."""
    bias, blacks = record.colour_bias, sorted(set(record.sensor.black_level_dn))
    numbers = [
        *([] if bias is None else _label_channels("{}", record, map(format_figure, bias))),
        ("Recorded black", f"{join_words([f'{level:g}' for level in blacks])} DN"),
        ("Bias frames", str(record.bias.frames)),
    ]
    return _group(
        record, "Colour bias", numbers, "colour bias", plots=[] if bias is None else [drawn.bias_plot(record, bias)]
    )


def _group_rows(record: IsoCalibration) -> dict[str, Any]:
    """Gather the figures and plots of row noise."""
    rows, columns = record.rows.rows, record.rows.columns
    numbers = [
        *_format_figures(record, _ROW_NOISE),
        ("Fixed rows", f"{digits(rows.fixed_sigma_dn)} DN"),
        ("Fixed columns", f"{digits(columns.fixed_sigma_dn)} DN"),
        ("Shapiro-Wilk p", digits(rows.shapiro_p, 2)),
        ("Excess kurtosis", digits(rows.excess_kurtosis, 2)),
    ]
    plots = [drawn.rows_plot(record), drawn.line_spectrum_plot(record)]
    return _group(record, "Row noise", numbers, "row noise", plots=plots, pictures=[drawn.spectrum_picture(record)])


def _group_read_noise(record: IsoCalibration) -> dict[str, Any]:
    """Gather the figures of the read noise, and its probability plots."""
    numbers: Rows = []
    plots: list[Plot] = []
    if record.read is not None and record.plot is not None:
        numbers = [*_format_figures(record, _READ_NOISE), ("Residuals", format_count(record.read.residuals))]
        shape = record.tukey_lambda
        plots = [] if shape is None else [drawn.ppcc_plot(record, record.read, shape)]
        plots += drawn.read_noise_plots(record, record.read, record.plot)
    return _group(record, "Read noise", numbers, "shape", "read noise", plots=plots)


def _group_reproduction(record: IsoCalibration) -> dict[str, Any]:
    """Gather the comparison of a kept-out bias frame with a simulated one."""
    title, kept = "A bias frame kept out, against the model", record.reproduction
    if kept is None:
        note = f"None was kept out: there were only {record.bias_frames} bias frames, and all went into the estimates."
        if record.parameters is None:
            note = "There is none, since a figure that it would be made with is withheld."
        return _group(record, title, [], note=note)
    numbers = [
        ("R² of the quantiles", digits(kept.r_squared, 6)),
        ("Histograms differ by", f"{kept.histogram_distance:.2%}"),
        ("By chance", f"{kept.histogram_distance_by_chance:.2%}"),
        ("σ real", f"{digits(kept.sigma_real_dn, 4)} DN"),
        ("σ simulated", f"{digits(kept.sigma_simulated_dn, 4)} DN"),
        ("Row means, σ real", f"{digits(kept.row_sigma_real_dn)} DN"),
        ("Row means, σ simulated", f"{digits(kept.row_sigma_simulated_dn)} DN"),
    ]
    plots, pictures = [drawn.reproduced_plot(record, kept)], [drawn.reproduced_pictures(record, kept)]
    return _group(record, title, numbers, plots=plots, pictures=pictures)


def _group_pattern(record: IsoCalibration) -> dict[str, Any]:
    """Gather defects, DSNU and the shading picture."""
    pattern = record.pattern
    uneven = zip(pattern.dsnu_dn, pattern.dsnu_error_dn, strict=True)
    numbers = [
        ("Defects", f"{format_count(pattern.defects)}, {digits(100 * pattern.defects / pattern.pixels, 2)} %"),
        ("Off their level", format_count(pattern.off_level)),
        ("Never changing", format_count(pattern.stuck)),
        *_label_channels("DSNU of {}", record, [format_measured(*values, "DN") for values in uneven]),
    ]
    return _group(record, "What stays from frame to frame", numbers, pictures=[drawn.shading_pictures(record)])
