"""An evaluation as one HTML page: the paper's table with intervals, plots, pictures, every image, provenance."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.ticker import FixedLocator

from eldata.base.files import write_text
from eldata.base.numbers import counted
from eldata.evaluation import looking
from eldata.evaluation.scores import UnitScore, factor_text, short_digest
from eldata.plots.axes import Theme, number, set_ticks
from eldata.plots.pictures import heat_gradient
from eldata.plots.scores import Strip, draw_points, strips
from eldata.protocols.words import FIELDS, in_words
from eldata.reports.html import Plot, digits, draw_plot, render_with_script, signed
from eldata.reports.pictures import DrawnImage, show_images

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.statistics import Interval
    from eldata.manifest.catalogue import FrameFiles
    from eldata.metrics.registry import Figure, Kind

    Shown = tuple[str, UnitScore, DrawnImage]

EACH: Final = 4
"""How many of the worst and of the best are shown."""

_USUAL = (0.8, 1.25)  # factors that errors of exposure come to


def write_evaluation_page(
    result: EvaluationResult,
    out: Path | str,
    *,
    dataset_folder: Path | FrameFiles,
    predictions: Path | None,
    dark_shading: Path | None = None,
) -> None:
    """Write the page of an evaluation, whole or not at all.

    Parameters
    ----------
    result
        Just computed.
    out
        The file.
    dataset_folder, predictions
        Where the raw files and the predictions lie (``None`` of a baseline): the worst and the best are decoded once
        more, to be shown.
    dark_shading
        The file of what was taken off the inputs, if anything was.

    Raises
    ------
    ArgumentError
        If the result was read back.
    RawFileError, PredictionError, EldataError
        If a file is no longer what was scored, or the page cannot be written.
    """
    where = {"dataset_folder": dataset_folder, "dark_shading": dark_shading}
    images = looking.worst_and_best_images(result, EACH, predictions=predictions, **where)
    write_text(out, evaluation_page(result, show_images(images)))


def evaluation_page(result: EvaluationResult, shown: Sequence[Shown]) -> str:
    """Render the page of an evaluation; the same result and pictures give the same text."""
    kind = result.kind
    ids = {score.path: f"picture-{index}" for index, (_, score, _) in enumerate(shown, start=1)}
    plots = score_plots(result)
    sections = [("means", "Means")]
    sections += [("distributions", "Distributions")] if plots else []
    sections += [("pictures", "Worst and best")] if shown else []
    sections += [("images", f"Every {kind.unit}")] if result.scores else []
    return render_with_script(
        "evaluation.html",
        kind=kind,
        result=result,
        title=f"{_method(result)} on {result.dataset}",
        subtitle=f"Protocol {result.protocol.name} ({short_digest(result.digest)}): {result.protocol.title}",
        remarks=[*map(str, result.suspicions), *(note[:1].upper() + note[1:] for note in result.notes)],
        tiles=_tiles(result),
        sections=[*sections, ("provenance", "Provenance")],
        table=table_with_intervals(result),
        interval_note=looking.interval_note(result),
        plots=plots,
        sizes=sorted({image.box[:1:-1] for _, _, image in shown}),
        has_whole=any(image.whole for _, _, image in shown),
        each=EACH,
        error_limit=digits(shown[0][2].error_limit, 2) if shown else "",
        gradient=heat_gradient(),
        groups={
            rank: [_viewer(ids[score.path], score, image, result) for of, score, image in shown if of == rank]
            for rank in dict.fromkeys(rank for rank, _, _ in shown)
        },
        rows=_tabulate_images(result, ids),
        protocol_fields=[
            (name, in_words(name, value) if name in FIELDS else field_text(value))
            for name, value in result.protocol.as_dict().items()
        ],
        provenance_fields=[(name, field_text(value)) for name, value in result.provenance.items()],
    )


# --- parts that the comparison's page shares ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell: its text, how it looks (a class of the style), what it sorts by, where it leads, its row's identifier."""

    text: str
    look: str = ""
    value: str | None = None
    link: str = ""
    name: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Cells of a table; which columns stand to the left, which rows have a line above."""

    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    left: tuple[int, ...] = (0,)
    rules: tuple[int, ...] = ()


def number_cell(value: float, text: str, look: str = "") -> Cell:
    """Make a cell that sorts by its number; unknown numbers sort last."""
    return Cell(signed(text) if not math.isnan(value) else "–", look, json.dumps(value))


FACTS = ("ISO", "factor")
"""What :func:`fact_cells` states."""


def fact_cells(score: UnitScore, kind: Kind) -> tuple[Cell, ...]:
    """Return ISO and factor of an image; clips state none."""
    if kind.is_of_clips:
        return ()
    iso = number_cell(score.iso, f"{score.iso:g}" if score.iso else "–")
    return iso, number_cell(score.ratio or 0.0, factor_text(score.ratio, "×"))


def field_text(value: Any) -> str:
    """Write a field of a protocol or of a provenance for a page."""
    if isinstance(value, str):
        return value or "–"
    if isinstance(value, (list, dict)) and not value:
        return "none"
    if isinstance(value, list) and all(isinstance(item, (str, int, float)) for item in value):
        return ", ".join(str(item) for item in value)
    return "none" if value is None else json.dumps(value, ensure_ascii=False)


# --- tables -------------------------------------------------------------------------------------------------------


def table_with_intervals(result: EvaluationResult) -> Table:
    """Return the paper's table with the number of scenes, and the interval after each mean."""
    metrics, (counted, *heads) = result.kind.metrics, result.kind.heads
    texts = []
    for row in result.table:
        coverage, *means = row.texts(result.kind)
        intervals = [result.interval(row, metric.name) for metric in metrics]
        cells = [coverage, str(intervals[0].scenes)]
        for mean, interval, metric in zip(means, intervals, metrics, strict=True):
            cells += [mean, _format_interval(interval, metric)]
        texts.append(cells)
    names = [counted, "scenes", *(name for head in heads for name in (head, looking.INTERVAL))]
    paper = result.lay_out(names, texts, "×")
    rules = tuple(range(2, len(names), 2)) if paper.transposed else paper.rules
    cells_of_rows = (tuple(Cell("–" if text == "-" else text) for text in row) for row in paper.rows)
    return Table(paper.header, tuple(cells_of_rows), rules=rules)


def _format_interval(interval: Interval, metric: Figure) -> str:
    """Write an interval's ends in the metric's digits; a dash if it is not known."""
    return signed(f"{metric.format(interval.low)} to {metric.format(interval.high)}") if interval.is_known else "–"


def _tabulate_images(result: EvaluationResult, ids: dict[str, str]) -> Table:
    """Lay out every image's scores, linked to its pictures where ``ids`` has its path."""
    kind = result.kind
    rows = []
    for score in looking.scores_in_order(result.scores, result.dataset):
        cells = [Cell(score.name, link=ids.get(score.path, "")), Cell(score.camera), Cell(score.scene)]
        cells += fact_cells(score, kind)
        for metric in kind.metrics:
            value = score.values[metric.name]
            cells.append(number_cell(value, metric.format_single(value)))
        rows.append((*cells, number_cell(score.rescale, f"{score.rescale:.3f}")))
    facts = () if kind.is_of_clips else FACTS
    header = (kind.unit, "camera", "scene", *facts, *kind.heads[1:], "rescaled by")
    return Table(header, tuple(rows), left=(0, 1, 2))


# --- words --------------------------------------------------------------------------------------------------------


def _method(result: EvaluationResult) -> str:
    """Name the predictions: by their folder, or by the baseline."""
    predictions = str(result.provenance.get("predictions", ""))
    if predictions.startswith("none: "):
        return predictions.removeprefix("none: ").capitalize()
    return PurePath(predictions).name or "Predictions"


def _tiles(result: EvaluationResult) -> list[tuple[str, str, str]]:
    """List names, values and notes of the figures that the page shows large."""
    if not result.scores:
        return []
    tiles = []
    for metric in result.kind.metrics:
        interval = result.interval(result.whole, metric.name)
        reach = f"{looking.INTERVAL.split()[0]}: {_format_interval(interval, metric)}"
        note = reach if interval.is_known else looking.TOO_FEW
        tiles.append((metric.label, f"{metric.format(interval.mean)} {metric.unit}".rstrip(), note))
    cameras = len({score.camera for score in result.scores})
    return [
        *tiles,
        (result.kind.units.capitalize(), str(result.scored), f"of {result.expected} {result.kind.counted}"),
        ("Scenes", str(interval.scenes), f"of {counted(cameras, 'camera')}"),
    ]


_LAYERS = {
    "input": ("input", "Input{}", "Noisy input{}"),
    "method-1": ("prediction", "Prediction", "Prediction"),
    "reference": ("reference", "Reference", "Reference"),
    "error-1": ("error", "Error", "Absolute error"),
}


def _viewer(name: str, score: UnitScore, image: DrawnImage, result: EvaluationResult) -> dict[str, Any]:
    """Gather identifier, facts, layers (key, label, words, JPEG) and crop of one image."""
    times = ("", "") if score.ratio is None else (f" ×{score.ratio:g}", f" times {score.ratio:g}")

    def layers(jpegs: dict[str, bytes], place: str) -> list[tuple[str, str, str, bytes]]:
        """Label each JPEG of an image: key, label, alternative text, JPEG."""
        about = f"of {image.frame}: {score.psnr_db:.2f} dB, {place}"
        known = [(*_LAYERS[layer], jpeg) for layer, jpeg in jpegs.items()]
        return [
            (key, label.format(times[0]), f"{alt.format(times[1])} {about}", jpeg) for key, label, alt, jpeg in known
        ]

    values = [(metric, metric.format(score.values[metric.name])) for metric in result.kind.metrics]
    facts = [
        *(f"{text} {metric.unit}" if metric.unit else f"{metric.label} {text}" for metric, text in values),
        *([f"rescaled by {score.rescale:.3f}"] if result.rescales else []),
        f"{score.camera}, {score.scene}",
        *([f"ISO {score.iso:g}"] if score.iso else []),
        *([factor_text(score.ratio, "×")] if score.ratio is not None else ["the frame with the lowest PSNR"]),
        *([f"shown {image.brighter:g} times brighter"] if image.brighter != 1 else []),
    ]
    return {
        "id": name,
        "image": image,
        "facts": ", ".join(facts),
        "layers": layers(image.layers, "centre crop"),
        "whole": layers(image.whole, "whole"),
        "box": [100 * length / image.size[1 - place % 2] for place, length in enumerate(image.box)],
    }


# --- plots of scores, one by one: by camera, ISO and factor, and the rescaling that was found ------------------------


def score_plots(result: EvaluationResult) -> tuple[Plot, ...]:
    """Draw the scores of a result, if there are any; the rescaling only if its protocol rescales."""
    kind, shared = result.kind, result.scenes_shared
    scores = looking.scores_in_order(result.scores, result.dataset)
    finite = [score for score in scores if all(math.isfinite(score.values[metric.name]) for metric in kind.metrics)]
    if not finite:
        return ()
    left_out = len(scores) - len(finite)
    note = f" Not drawn: {left_out} without a finite score." if left_out else ""
    groupings: tuple[looking.Grouping, ...] = ("camera", "iso") if any(score.iso for score in finite) else ("camera",)
    plots = [
        _strips_plot(metric, looking.strips_of(finite, by, metric.name, scenes_shared=shared), by, kind, note)
        for by in groupings
        for metric in kind.metrics
    ]
    positive = [score for score in finite if math.isfinite(score.rescale) and score.rescale > 0]
    if result.rescales and positive:
        columns = looking.strips_of(positive, "camera", "rescale", scenes_shared=shared, mean=False)
        plots += _rescaling_plots(positive, columns, kind.units)
    return tuple(plots)


def _strips_plot(metric: Figure, drawn: Sequence[Strip], by: looking.Grouping, kind: Kind, note: str) -> Plot:
    """Draw the values of each group in a column."""
    groups = list(dict.fromkeys(strip.group for strip in drawn))
    values = [value for strip in drawn for value in strip.values]

    def draw(axes: Axes, theme: Theme) -> None:
        """Draw the metric's values, a column for each group."""
        strips(axes, drawn, theme)
        axes.set_ylabel(metric.heading)

    alt = (
        f"{metric.heading} of {len(values)} {kind.units} in {len(groups)} groups ({', '.join(groups)}), from "
        f"{min(values):.4g} to {max(values):.4g}."
    )
    name = f"{re.sub(r'[^a-z0-9]+', '-', metric.label.lower())}-{by}"
    by_what = f"{'ISO' if by == 'iso' else by}{'' if {strip.ratio for strip in drawn} == {None} else ' and factor'}"
    words = {"metric": metric.label, "groups": by_what, "unit": kind.unit, "note": note}
    return draw_plot("evaluation", "by-group", alt, draw, name=name, words=words)


def _rescaling_plots(scores: Sequence[UnitScore], drawn: Sequence[Strip], units: str) -> tuple[Plot, Plot]:
    """Draw the factors by camera, and the PSNR over them."""
    factors = [score.rescale for score in scores]
    points = [(score.ratio, score.rescale, score.psnr_db) for score in scores]

    def draw_factors(axes: Axes, theme: Theme) -> None:
        """Draw the rescaling factors, a column for each group."""
        _draw_exposure_band(axes, theme, horizontal=True)
        strips(axes, drawn, theme)
        _set_up_factors(axes, factors)
        axes.set_ylabel("rescaled by")

    def draw_scores(axes: Axes, theme: Theme) -> None:
        """Draw the PSNR over the rescaling factor."""
        _draw_exposure_band(axes, theme, horizontal=False)
        draw_points(axes, points, theme, alpha=0.7)
        _set_up_factors(axes, factors, horizontal=True)
        axes.set(xlabel="rescaled by", ylabel="PSNR [dB]")

    alt = f"Factor of each of {len(factors)} predictions by camera, from {min(factors):.3g} to {max(factors):.3g}."
    over = f"PSNR of {len(scores)} {units} against the factor that each prediction was multiplied by."
    return (
        draw_plot("evaluation", "rescaling", alt, draw_factors, words={"units": units}),
        draw_plot("evaluation", "rescaling-psnr", over, draw_scores, words={"units": units}),
    )


def _draw_exposure_band(axes: Axes, theme: Theme, *, horizontal: bool) -> None:
    """Draw the usual range of the rescaling factor, and a line at 1."""
    (axes.axhspan if horizontal else axes.axvspan)(*_USUAL, color=theme.theory, alpha=0.13, linewidth=0)
    (axes.axhline if horizontal else axes.axvline)(1, color=theme.theory, linewidth=1)


def _set_up_factors(axes: Axes, factors: Sequence[float], *, horizontal: bool = False) -> None:
    """Set up a logarithmic axis of factors, wide enough for the band."""
    low, high = min(0.7, *factors), max(1.43, *factors)
    low, high = low / 1.05, high * 1.05
    (axes.set_xscale if horizontal else axes.set_yscale)("log", base=2)
    (axes.set_xlim if horizontal else axes.set_ylim)(low, high)
    doublings = math.log2(high / low)
    ticks = [0.7, 0.8, 0.9, 1, 1.1, 1.25, 1.4] if doublings < 1.3 else [0.5, 0.7, 1, 1.4, 2]
    if doublings > 2.5:
        step = max(1, math.ceil(doublings / 7))
        exponents = np.arange(math.ceil(math.log2(low) / step), math.floor(math.log2(high) / step) + 1) * step
        ticks = [float(2.0**exponent) for exponent in exponents]
    places = FixedLocator([tick for tick in ticks if low <= tick <= high])
    set_ticks(axes.xaxis if horizontal else axes.yaxis, places, lambda value, _: number(float(f"{value:.3g}")))
