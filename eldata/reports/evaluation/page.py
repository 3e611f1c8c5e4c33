"""An evaluation as one HTML page: the paper's table with intervals, plots, pictures, every image, provenance."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_text
from eldata.errors import ArgumentError
from eldata.evaluation.looking import INTERVAL, TOO_FEW, interval_note, seen_frames
from eldata.evaluation.table import factor_text, short_digest
from eldata.protocols.kinds import IMAGES
from eldata.protocols.words import FIELDS, in_words
from eldata.reports.evaluation.pictures import EACH, ShownImage, ShownImages, heat_gradient, shown_images
from eldata.reports.evaluation.plots import score_plots
from eldata.reports.evaluation.script import jpeg_uri, rendered_with_script
from eldata.reports.html import digits, signed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.statistics import Interval
    from eldata.protocols.kinds import Metric


def write_evaluation_page(
    results: Sequence[EvaluationResult], out: Path | str, *, dataset_folder: Path, predictions: Path | None
) -> None:
    """Write the page of an evaluation, whole or not at all.

    Parameters
    ----------
    results
        One, or the same predictions under several protocols: the first is shown in full, the others by their tables.
    out
        The file.
    dataset_folder, predictions
        Where the raw files and the predictions lie (``None`` of a baseline): the worst and the best are decoded once
        more, to be shown.

    Raises
    ------
    ArgumentError
        If there is no result, or it was read back.
    RawFileError, PredictionError, EldataError
        If a file is no longer what was scored, or the page cannot be written.
    """
    if not results:
        raise ArgumentError("a page is of one result or more; found none")
    seen = seen_frames(results[0], EACH, dataset_folder=dataset_folder, predictions=predictions)
    write_text(out, evaluation_page(results, shown_images(seen)))


def evaluation_page(results: Sequence[EvaluationResult], shown: ShownImages) -> str:
    """Return the page; the same results and pictures give the same text."""
    result, kind = results[0], results[0].kind
    ids = {image.score.path: f"picture-{index}" for index, image in enumerate(shown.images, start=1)}
    plots = score_plots(result.scores, kind, rescaled=result.rescales)
    sections = [("means", "Means")]
    sections += [("distributions", "Distributions")] if plots else []
    sections += [("pictures", "Worst and best")] if shown.images else []
    sections += [("images", f"Every {kind.unit}")] if result.scores else []
    return rendered_with_script(
        "evaluation.html",
        kind=kind,
        title=f"{_method(result)} on {result.dataset}",
        subtitle=f"Protocol {result.protocol.name} ({short_digest(result.digest)}): {result.protocol.title}",
        outcome=_outcome(result),
        remarks=[note[:1].upper() + note[1:] for note in result.notes],
        tiles=_tiles(result),
        sections=[*sections, ("provenance", "Provenance")],
        table=table_with_intervals(result),
        table_caption=result.caption,
        interval_note=interval_note(kind),
        protocols=_protocols(results) if len(results) > 1 else None,
        others=[
            {
                "name": other.protocol.name,
                "id": f"means-{index}",
                "table": table_with_intervals(other),
                "caption": other.caption,
            }
            for index, other in enumerate(results[1:], start=2)
        ],
        plots=plots,
        rescaled=result.rescales,
        shown=shown,
        pictures_note=_pictures_note(result, shown),
        error_limit=digits(shown.error_limit, 2),
        gradient=heat_gradient(),
        groups=[
            {
                "title": f"{rank} by PSNR",
                "images": [
                    {"image": image, "id": ids[image.score.path], "facts": _facts(image, result)}
                    for image in shown.images
                    if image.rank == rank
                ],
            }
            for rank in dict.fromkeys(image.rank for image in shown.images)
        ],
        jpeg_uri=jpeg_uri,
        rows=_rows(result, ids),
        rows_caption=f"Scores of {result.scored} {kind.units}",
        problems=result.problems,
        missing=result.missing,
        pairs=result.expected,
        protocol_name=result.protocol.name,
        protocol_fields=[(name, _protocol_text(name, value)) for name, value in result.protocol.as_dict().items()],
        provenance_fields=[(name, field_text(value)) for name, value in result.provenance.items()],
    )


# --- parts that the comparison's page shares ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell: its text, how it looks (a class of the style), what it sorts by, where it leads."""

    text: str
    look: str = ""
    value: str | None = None
    link: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Cells of a table; which columns stand to the left, which rows have a line above, which column is sorted."""

    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    left: tuple[int, ...] = (0,)
    rules: tuple[int, ...] = ()
    sorted_by: int | None = None


def number_cell(value: float, text: str, look: str = "") -> Cell:
    """Return a cell that sorts by its number; what is not known sorts last."""
    known = (
        "NaN" if math.isnan(value) else ("-Infinity" if value < 0 else "Infinity") if math.isinf(value) else repr(value)
    )
    return Cell(signed(text) if not math.isnan(value) else "–", look, known)


def field_text(value: Any) -> str:
    """Return a field of a protocol or of a provenance as a page shows it."""
    if isinstance(value, str):
        return value or "–"
    if isinstance(value, (list, dict)) and not value:
        return "none"
    if isinstance(value, list) and all(isinstance(item, (str, int, float)) for item in value):
        return ", ".join(str(item) for item in value)
    return "none" if value is None else json.dumps(value, ensure_ascii=False)


def _protocol_text(name: str, value: Any) -> str:
    """Return a field of a protocol in words, where there are any."""
    return in_words(name, value) if name in FIELDS else field_text(value)


# --- tables -------------------------------------------------------------------------------------------------------


def table_with_intervals(result: EvaluationResult) -> Table:
    """Return the paper's table with the number of scenes, and the interval after each mean."""
    paper, metrics = result.paper_table, result.kind.metrics
    found = [{metric.name: result.interval(row, metric.name) for metric in metrics} for row in result.table]
    scenes = tuple(str(intervals[metrics[0].name].scenes) for intervals in found)
    reaches = [tuple(_interval_text(intervals[metric.name], metric) for intervals in found) for metric in metrics]
    if paper.transposed:
        counted, *means = paper.rows
        lines = [counted, ("scenes", *scenes)]
        for mean, reach in zip(means, reaches, strict=True):
            lines += [mean, (INTERVAL, *reach)]
        return Table(tuple(map(times, paper.header)), _cells(lines), rules=tuple(range(2, len(lines), 2)))
    names = len(paper.header) - len(metrics)
    header = [*paper.header[:names], "scenes"]
    for name in paper.header[names:]:
        header += [name, INTERVAL]
    rows = []
    for index, texts in enumerate(paper.rows):
        labels = (times(text) if head == "factor" else text for head, text in zip(header, texts[:names], strict=False))
        row = [*labels, scenes[index]]
        for mean_text, reach in zip(texts[names:], reaches, strict=True):
            row += [mean_text, reach[index]]
        rows.append(tuple(row))
    return Table(tuple(header), _cells(rows), rules=paper.rules)


def _cells(rows: Iterable[tuple[str, ...]]) -> tuple[tuple[Cell, ...], ...]:
    return tuple(tuple(Cell("–" if text == "-" else text) for text in row) for row in rows)


def times(factor: str) -> str:
    """Return a factor with the sign that a page has: ×100."""
    return re.sub(r"^x(?=\d)", "×", factor)


def _interval_text(interval: Interval, metric: Metric) -> str:
    return signed(f"{metric.text(interval.low)} to {metric.text(interval.high)}") if interval.is_known else "–"


def _protocols(results: Sequence[EvaluationResult]) -> Table:
    kind = results[0].kind
    header = ("protocol", "digest", kind.counted, *(metric.head for metric in kind.metrics))
    rows = [
        (result.protocol.name, short_digest(result.digest), *result.whole.texts(kind))
        for result in results
        if result.table
    ]
    return Table(header, _cells(rows))


def _rows(result: EvaluationResult, ids: dict[str, str]) -> Table:
    metrics, of_images = result.kind.metrics, result.kind is IMAGES
    header = (result.kind.unit, "camera", "scene", *(("ISO", "factor") if of_images else ()))
    rows = []
    for score in result.scores:
        cells = [Cell(score.name, link=ids.get(score.path, "")), Cell(score.camera), Cell(score.scene)]
        if of_images:
            cells.append(number_cell(score.iso, f"{score.iso:g}" if score.iso else "–"))
            cells.append(number_cell(score.ratio or 0.0, times(factor_text(score.ratio))))
        for metric in metrics:
            value = score.values[metric.name]
            cells.append(number_cell(value, f"{value:.{metric.row_places}f}"))
        rows.append((*cells, number_cell(score.rescale, f"{score.rescale:.3f}")))
    return Table((*header, *(metric.head for metric in metrics), "rescaled by"), tuple(rows), left=(0, 1, 2))


# --- words --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Outcome:
    look: str
    text: str


@dataclass(frozen=True, slots=True)
class _Tile:
    name: str
    value: str
    note: str


def _method(result: EvaluationResult) -> str:
    """Return what to call the predictions: their folder's name, or the baseline."""
    predictions = str(result.provenance.get("predictions", ""))
    if predictions.startswith("none: "):
        return predictions.removeprefix("none: ").capitalize()
    return PurePath(predictions).name or "Predictions"


def _outcome(result: EvaluationResult) -> _Outcome:
    problems = f"{len(result.problems)} problems, listed below."
    if not result.scores:
        return _Outcome("off", f"Nothing was scored: {problems}")
    if result.scored < result.expected:
        return _Outcome("off", f"Incomplete: {result.coverage}. These means do not compare with others.")
    if result.problems:
        return _Outcome("off", f"{result.coverage}; {problems}")
    return _Outcome("ok", f"Complete: {result.coverage}.")


def _tiles(result: EvaluationResult) -> tuple[_Tile, ...]:
    if not result.scores:
        return ()
    whole, tiles, scenes = result.whole, [], 0
    for metric in result.kind.metrics:
        interval = result.interval(whole, metric.name)
        reach, scenes = _interval_text(interval, metric), interval.scenes
        note = f"{INTERVAL.split()[0]}: {reach}" if interval.is_known else TOO_FEW
        tiles.append(_Tile(metric.label, f"{metric.text(whole.values[metric.name])} {metric.unit}".rstrip(), note))
    cameras = len({score.camera for score in result.scores})
    return (
        *tiles,
        _Tile(result.kind.units.capitalize(), str(result.scored), f"of {result.expected} {result.kind.counted}"),
        _Tile("Scenes", str(scenes), f"of {cameras} camera{'' if cameras == 1 else 's'}"),
    )


def _facts(image: ShownImage, result: EvaluationResult) -> str:
    score = image.score
    parts = [
        *(
            f"{metric.text(score.values[metric.name])} dB"
            if metric.unit
            else f"{metric.label} {metric.text(score.values[metric.name])}"
            for metric in result.kind.metrics
        ),
        *([f"rescaled by {score.rescale:.3f}"] if result.rescales else []),
        f"{score.camera}, {score.scene}",
        *([f"ISO {score.iso:g}"] if score.iso else []),
        *([times(factor_text(score.ratio))] if score.ratio is not None else ["the frame with the lowest PSNR"]),
        *([f"shown {image.brighter:g} times brighter"] if image.brighter != 1 else []),
    ]
    return ", ".join(parts)


def _pictures_note(result: EvaluationResult, shown: ShownImages) -> str:
    if not shown.images:
        return ""
    protocol = result.protocol.as_dict()
    colours = "srgb" if protocol.get("rendering") == "libraw" else protocol.get("pixels", "packed")
    pixels = "packed pixels" if colours == "packed" else "pixels"
    sizes = {image.size for image in shown.images}
    crops = any(image.whole for image in shown.images)
    size = " or ".join(f"{columns} × {rows}" for rows, columns in sorted(sizes))
    what = (
        f"the centre {size} {pixels}, one to one, and below the whole, reduced, with the crop's place"
        if crops
        else f"the whole image, {size} {pixels}, one to one"
    )
    rescaled = ", rescaled and clipped" if result.rescales else ", clipped"
    rendering = {
        "srgb": "Reference and prediction are sRGB renderings. ",
        "rgb": "Frames are shown as they are stored, as the authors preprocessed them. ",
        "packed": "Pictures are rendered with the camera's white balance and colour matrix to sRGB, one pixel per "
        "packed pixel. The input is clipped, multiplied by its factor and clipped again. ",
    }[colours]
    return (
        f"Up to {EACH} of the worst and of the best by PSNR, at most one per scene: {what}. {rendering}The prediction "
        f"is as it was scored{rescaled}. The error is absolute, the mean over channels, on one scale for all, by its "
        "square root. JPEG: to look at, not to measure."
    )
