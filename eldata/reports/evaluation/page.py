"""An evaluation as one HTML page: the paper's table with intervals, plots, pictures, every image, provenance."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Literal

from eldata.base.files import write_text
from eldata.errors import ArgumentError
from eldata.evaluation.saved import saved_result
from eldata.evaluation.statistics import FEWEST_SCENES, LEVEL, RESAMPLES, SEED, interval_of_mean
from eldata.protocols.words import FIELDS, in_words
from eldata.reports.evaluation.pictures import EACH, ShownImage, ShownImages, heat_gradient, shown_images
from eldata.reports.evaluation.plots import score_plots
from eldata.reports.evaluation.script import jpeg_uri, rendered_with_script
from eldata.reports.evaluation.tables import (
    caption_of,
    choice_text,
    factor_text,
    group_text,
    paper_table,
    short_digest,
    value_texts,
)
from eldata.reports.html import digits, signed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.saved import SavedResult, SavedRow, SavedScore


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
        If there is no result.
    RawFileError, PredictionError, EldataError
        If a file is no longer what was scored, or the page cannot be written.
    """
    if not results:
        raise ArgumentError("a page is of one result or more; found none")
    saved = [saved_result(result.as_dict(), "this evaluation") for result in results]
    shown = shown_images(saved[0], results[0].pairs, dataset_folder=dataset_folder, predictions=predictions)
    write_text(out, evaluation_page(saved, shown))


def evaluation_page(results: Sequence[SavedResult], shown: ShownImages) -> str:
    """Return the page; the same results and pictures give the same text."""
    result = results[0]
    rescaled = result.protocol.get("rescaling", "none") != "none"
    ids = {image.score.path: f"picture-{index}" for index, image in enumerate(shown.images, start=1)}
    plots = score_plots(result.images, rescaled=rescaled)
    sections = [("means", "Means")]
    sections += [("distributions", "Distributions")] if plots else []
    sections += [("pictures", "Worst and best")] if shown.images else []
    sections += [("images", "Every image")] if result.images else []
    return rendered_with_script(
        "evaluation.html",
        title=f"{_method(result)} on {result.dataset}",
        subtitle=_subtitle(result),
        outcome=_outcome(result),
        remarks=_remarks(result),
        tiles=_tiles(result),
        sections=[*sections, ("provenance", "Provenance")],
        table=table_with_intervals(result),
        table_caption=caption_of(result),
        interval_note=interval_note(),
        protocols=_protocols(results) if len(results) > 1 else None,
        others=[
            {
                "name": other.protocol_name,
                "id": f"means-{index}",
                "table": table_with_intervals(other),
                "caption": caption_of(other),
            }
            for index, other in enumerate(results[1:], start=2)
        ],
        plots=plots,
        rescaled=rescaled,
        shown=shown,
        pictures_note=_pictures_note(result, shown),
        error_limit=digits(shown.error_limit, 2),
        gradient=heat_gradient(),
        groups=[
            {
                "title": f"{rank} by PSNR",
                "images": [
                    {"image": image, "id": ids[image.score.path], "facts": _facts(image, rescaled=rescaled)}
                    for image in shown.images
                    if image.rank == rank
                ],
            }
            for rank in dict.fromkeys(image.rank for image in shown.images)
        ],
        jpeg_uri=jpeg_uri,
        rows=_rows(result.images, ids),
        rows_caption=f"Scores of {len(result.images)} images",
        problems=result.problems,
        missing=result.missing,
        pairs=result.pairs,
        protocol_name=result.protocol_name,
        protocol_fields=[(name, _protocol_text(name, value)) for name, value in result.protocol.items()],
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


def interval_note() -> str:
    """Return what the intervals are, in a sentence or two."""
    return (
        f"Intervals: {LEVEL:.0%}, bootstrap over scenes, because images of one scene err together ({RESAMPLES} "
        f"resamples, seed {SEED}, percentiles at the level for few samples). There is none of fewer than "
        f"{FEWEST_SCENES} scenes. They say how far the mean would move with other scenes like these, not how "
        "exact a score is."
    )


# --- tables -------------------------------------------------------------------------------------------------------


def table_with_intervals(result: SavedResult) -> Table:
    """Return the paper's table with the number of scenes and the intervals of its means."""
    paper = paper_table(result)
    texts = [_interval_texts(result, row) for row in result.table]
    if not paper.left:  # a column for each factor
        pairs, psnr, ssim = paper.rows
        columns = list(zip(*texts, strict=True))
        rows = (
            pairs,
            ("scenes", *columns[0]),
            psnr,
            (f"{LEVEL:.0%} interval", *columns[1]),
            ssim,
            (f"{LEVEL:.0%} interval", *columns[2]),
        )
        return Table(tuple(map(times, paper.header)), _cells(rows), rules=(2, 4))
    header = (
        "camera",
        "factor",
        "pairs",
        "scenes",
        "PSNR [dB]",
        f"{LEVEL:.0%} interval",
        "SSIM",
        f"{LEVEL:.0%} interval",
    )
    rows_with = [
        (camera, times(factor), pairs, scenes, psnr, psnr_interval, ssim, ssim_interval)
        for (camera, factor, pairs, psnr, ssim), (scenes, psnr_interval, ssim_interval) in zip(
            paper.rows, texts, strict=True
        )
    ]
    return Table(header, _cells(rows_with), rules=paper.rules)


def _cells(rows: Iterable[tuple[str, ...]]) -> tuple[tuple[Cell, ...], ...]:
    return tuple(tuple(Cell("–" if text == "-" else text) for text in row) for row in rows)


def times(factor: str) -> str:
    """Return a factor with the sign that a page has: ×100."""
    return re.sub(r"^x(?=\d)", "×", factor)


def _interval_texts(result: SavedResult, row: SavedRow) -> tuple[str, str, str]:
    """Return the number of scenes and the intervals of PSNR and SSIM."""
    images = result.images_of(row)
    places = [image.place for image in images]
    psnr, ssim = (
        _interval_text([getattr(image, field) for image in images], places, count) for field, count in _SCORES
    )
    return str(len(set(places))), psnr, ssim


_SCORES: tuple[tuple[Literal["psnr_db", "ssim"], int], ...] = (("psnr_db", 2), ("ssim", 3))


def _interval_text(values: Sequence[float], places: Sequence[tuple[str, str]], decimals: int) -> str:
    interval = interval_of_mean(values, places)
    if not interval.is_known:
        return "–"
    return signed(f"{interval.low:.{decimals}f} to {interval.high:.{decimals}f}")


def _protocols(results: Sequence[SavedResult]) -> Table:
    header = ("protocol", "digest", "pairs", "PSNR [dB]", "SSIM")
    rows = [
        (result.protocol_name, short_digest(result.protocol_digest), *value_texts(result.table[-1]))
        for result in results
        if result.table
    ]
    return Table(header, _cells(rows))


def _rows(images: Sequence[SavedScore], ids: dict[str, str]) -> Table:
    header = ("image", "camera", "scene", "ISO", "factor", "PSNR [dB]", "SSIM", "rescaled by")
    rows = [
        (
            Cell(image.path, link=ids.get(image.path, "")),
            Cell(image.camera),
            Cell(image.scene),
            number_cell(image.iso, f"{image.iso:g}" if image.iso else "–"),
            number_cell(image.ratio, f"×{image.ratio:g}"),
            number_cell(image.psnr_db, f"{image.psnr_db:.2f}"),
            number_cell(image.ssim, f"{image.ssim:.4f}"),
            number_cell(image.rescale, f"{image.rescale:.3f}"),
        )
        for image in images
    ]
    return Table(header, tuple(rows), left=(0, 1, 2))


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


def _method(result: SavedResult) -> str:
    """Return what to call the predictions: their folder's name, or the baseline."""
    predictions = str(result.provenance.get("predictions", ""))
    if predictions.startswith("none: "):
        return predictions.removeprefix("none: ").capitalize()
    return PurePath(predictions).name or "Predictions"


def _subtitle(result: SavedResult) -> str:
    title = result.protocol.get("title", "")
    return f"Protocol {result.protocol_name} ({short_digest(result.protocol_digest)}): {title}"


def _outcome(result: SavedResult) -> _Outcome:
    coverage = f"{len(result.images)} of {result.pairs} pairs{choice_text(result)}"
    if not result.images:
        return _Outcome("off", f"Nothing was scored: {len(result.problems)} problems, listed below.")
    if len(result.images) < result.pairs:
        return _Outcome("off", f"Incomplete: {coverage}. These means do not compare with others.")
    if result.problems:
        return _Outcome("off", f"{coverage}; {len(result.problems)} problems, listed below.")
    return _Outcome("ok", f"Complete: {coverage}.")


def _remarks(result: SavedResult) -> tuple[str, ...]:
    return tuple(note[:1].upper() + note[1:] for note in result.notes)


def _tiles(result: SavedResult) -> tuple[_Tile, ...]:
    if not result.images:
        return ()
    whole = result.table[-1]
    places = [image.place for image in result.images]
    psnr, ssim = (
        _interval_text([getattr(image, field) for image in result.images], places, count) for field, count in _SCORES
    )
    missing = f"no interval of fewer than {FEWEST_SCENES} scenes"
    return (
        _Tile("PSNR", f"{whole.psnr_db:.2f} dB", missing if psnr == "–" else f"{LEVEL:.0%}: {psnr}"),
        _Tile("SSIM", f"{whole.ssim:.3f}", missing if ssim == "–" else f"{LEVEL:.0%}: {ssim}"),
        _Tile("Images", str(len(result.images)), f"of {result.pairs} pairs"),
        _Tile("Scenes", str(len(set(places))), f"of {_cameras(result)}"),
    )


def _cameras(result: SavedResult) -> str:
    count = len({image.camera for image in result.images})
    return f"{count} camera{'' if count == 1 else 's'}"


def _facts(image: ShownImage, *, rescaled: bool) -> str:
    score = image.score
    parts = [
        f"{score.psnr_db:.2f} dB",
        f"SSIM {score.ssim:.3f}",
        *([f"rescaled by {score.rescale:.3f}"] if rescaled else []),
        f"{group_text(score.camera)}, {score.scene}",
        *([f"ISO {score.iso:g}"] if score.iso else []),
        times(factor_text(score.ratio)),
        *([f"shown {image.brighter:g} times brighter"] if image.brighter != 1 else []),
    ]
    return ", ".join(parts)


def _pictures_note(result: SavedResult, shown: ShownImages) -> str:
    if not shown.images:
        return ""
    srgb = result.protocol.get("rendering") == "libraw"
    pixels = "pixels" if srgb else "packed pixels"
    sizes = {image.size for image in shown.images}
    crops = any(image.whole for image in shown.images)
    size = " or ".join(f"{columns} × {rows}" for rows, columns in sorted(sizes))
    what = (
        f"the centre {size} {pixels}, one to one, and below the whole, reduced, with the crop's place"
        if crops
        else f"the whole image, {size} {pixels}, one to one"
    )
    rescaled = ", rescaled and clipped" if result.protocol.get("rescaling", "none") != "none" else ", clipped"
    rendering = (
        "Reference and prediction are sRGB renderings. "
        if srgb
        else "Pictures are rendered with the camera's white balance and colour matrix to sRGB, one pixel a packed "
        "pixel. The input is clipped, multiplied by its factor and clipped again. "
    )
    return (
        f"Up to {EACH} of the worst and of the best by PSNR, at most one a scene: {what}. {rendering}The prediction is "
        f"as it was scored{rescaled}. The error is absolute, the mean over channels, on one scale for all, by its "
        "square root. JPEG: to look at, not to measure."
    )
