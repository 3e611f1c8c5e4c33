"""A comparison of methods as one HTML page: tables, differences, every image, biggest wins and losses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_text
from eldata.base.tables import Strong
from eldata.evaluation.comparison_tables import (
    LABELS,
    contests_note,
    contests_table,
    gains_table,
    means_table,
    signed_text,
    statistics_note,
    summary_of,
)
from eldata.evaluation.looking import scenes_of, scores_in_order
from eldata.reports.compare.pictures import draw_images, picture_file
from eldata.reports.compare.plots import gain_plots
from eldata.reports.evaluation.page import FACTS, Cell, Table, fact_cells, field_text, number_cell
from eldata.reports.evaluation.pictures import heat_gradient
from eldata.reports.evaluation.script import rendered_with_script
from eldata.reports.html import digits, signed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eldata.base.workers import Workers
    from eldata.evaluation.comparison import Comparison, Method, Pairing
    from eldata.evaluation.scores import UnitScore
    from eldata.evaluation.seen_methods import MethodsImage
    from eldata.evaluation.statistics import Difference
    from eldata.reports.compare.pictures import DrawnImage, DrawnImages


def write_comparison_page(
    comparison: Comparison,
    out: Path | str,
    *,
    images: Sequence[MethodsImage] = (),
    whole: bool = False,
    workers: Workers | None = None,
) -> None:
    """Write the page of a comparison, whole or not at all.

    Parameters
    ----------
    comparison
        Methods on their common images.
    out
        The file.
    images
        What to decode of each common image (:func:`eldata.evaluation.seen_methods.images_of`): their pictures are drawn
        into the folder ``<page>-pictures`` beside the page. Of none, the page has no pictures.
    whole, workers
        As for :func:`eldata.reports.compare.pictures.draw_images`.

    Raises
    ------
    RawFileError, PredictionError, EldataError
        If a file is no longer what was scored, or the page cannot be written.
    """
    drawn = draw_images(images, out, whole=whole, workers=workers) if images else None
    write_text(out, comparison_page(comparison, drawn))


def comparison_page(comparison: Comparison, drawn: DrawnImages | None = None) -> str:
    """Return the page; the same comparison gives the same text."""
    first, *others = comparison.methods
    return rendered_with_script(
        "compare.html",
        "compare.js",
        picture_policy="" if drawn is None else " 'self' file:",
        kind=comparison.kind,
        title=f"{' and '.join(_names(others))} against {first.name}",
        summary=f"{summary_of(comparison)}.",
        warnings=comparison.warnings,
        note=statistics_note(comparison),
        means=_means_table(comparison),
        sections=[_section(comparison, index) for index in range(len(others))],
        contests=_contests_table(comparison) if comparison.contests else None,
        contests_note=contests_note(comparison),
        looking=None if drawn is None else _looking(comparison, drawn),
        facets=_facets(comparison),
        gradient=heat_gradient(),
        rows=_rows(comparison),
        methods=[
            {"name": method.name, "id": f"method-{index}", "fields": _fields(method)}
            for index, method in enumerate(comparison.methods, start=1)
        ],
    )


def _names(methods: Sequence[Method]) -> list[str]:
    names = [method.name for method in methods]
    return names if len(names) < 3 else [", ".join(names[:-1]), names[-1]]


def _fields(method: Method) -> list[tuple[str, str]]:
    result = method.result
    return [
        ("file", result.source),
        ("scored", f"{result.scored} of {result.expected} {result.kind.counted}"),
        ("protocol", result.protocol.name),
        *((name, field_text(value)) for name, value in result.provenance.items()),
    ]


# --- tables -------------------------------------------------------------------------------------------------------


def _means_table(comparison: Comparison) -> Table:
    means = means_table(comparison, "×")
    rows = [
        (
            *map(Cell, row[:LABELS]),
            *(Cell(signed(text), "best" if isinstance(text, Strong) else "") for text in row[LABELS:]),
        )
        for row in means.rows
    ]
    return Table(means.header, tuple(rows), rules=means.rules)


def _section(comparison: Comparison, index: int) -> dict[str, Any]:
    first, other = comparison.methods[0], comparison.methods[index + 1]
    wins, losses = comparison.extremes(index)
    return {
        "title": f"{other.name} against {first.name}",
        "id": f"gain-{index + 1}",
        "verdict": _verdict(comparison.whole.gains[index]["psnr_db"], first.name, other.name),
        "table": _gains_table(comparison, index),
        "plots": gain_plots(comparison, index),
        "wins": _extremes_table(wins, comparison),
        "losses": _extremes_table(losses, comparison),
    }


def _gains_table(comparison: Comparison, index: int) -> Table:
    gains = gains_table(comparison, index, "×")
    rows = []
    for group, texts in zip(comparison.groups, gains.rows, strict=True):
        looks = [""] * (LABELS + 1)  # and scenes
        for metric in comparison.kind.metrics:
            sign = group.gains[index][metric.name].interval.sign
            looks += [_look(sign * metric.sign), "", ""]
        rows.append(
            (
                *map(Cell, texts[:LABELS]),
                *(
                    Cell("–" if text == "-" else signed(text), look)
                    for text, look in zip(texts[LABELS:], looks[LABELS:], strict=True)
                ),
            )
        )
    return Table(gains.header, tuple(rows), rules=gains.rules)


def _contests_table(comparison: Comparison) -> Table:
    contests, kind = contests_table(comparison), comparison.kind
    rows = []
    for contest, texts in zip(comparison.contests, contests.rows, strict=True):
        looks = ["", ""]
        for metric in kind.metrics:
            sign = contest.gains[metric.name].interval.sign
            looks += [_look(sign * metric.sign), "", "", ""]
        rows.append(
            tuple(Cell("–" if text == "-" else signed(text), look) for text, look in zip(texts, looks, strict=True))
        )
    return Table(contests.header, tuple(rows), left=contests.left)


def _look(sign: float) -> str:
    """Return how a difference looks: better or worse, or neither."""
    return "ok" if sign > 0 else "off" if sign < 0 else ""


def _verdict(difference: Difference, first: str, other: str) -> str:
    interval = difference.interval
    if not math.isfinite(interval.mean):
        return f"The mean difference of PSNR is not finite: a prediction equals its reference, of {first} or {other}."
    size = f"{signed(signed_text(interval.mean, 2))} dB on average"
    if not interval.is_known:
        return f"{size}; {interval.scenes} scenes are too few for an interval."
    reach = signed(f"{signed_text(interval.low, 2)} to {signed_text(interval.high, 2)}")
    if interval.sign:
        better = other if interval.sign > 0 else first
        return f"{size} ({reach}): {better} is better by more than the choice of scenes explains."
    return f"{size} ({reach}): the choice of scenes may explain all of it."


def _row_name(place: int) -> str:
    """Return the identifier of the row of the image at this place of the comparison."""
    return f"image-{place + 1}"


def _extremes_table(pairings: Sequence[Pairing], comparison: Comparison) -> Table | None:
    """Return a table of wins or losses; ``None`` if there are none."""
    if not pairings:
        return None
    kind = comparison.kind
    places = {scores[0].path: place for place, scores in enumerate(comparison.images)}
    rows = [
        (
            Cell(one.first.name, link=_row_name(places[one.first.path])),
            *fact_cells(one.first, kind),
            Cell(signed(signed_text(one.gain_db, 2))),
            Cell(signed(signed_text(one.gain_ssim, 3))),
        )
        for one in pairings
    ]
    return Table((kind.unit, *(() if kind.is_of_clips else FACTS), "PSNR [dB]", "SSIM"), tuple(rows))


def _rows(comparison: Comparison) -> Table:
    kind = comparison.kind
    first, *others = comparison.methods
    header = [kind.unit, "camera", "scene", *(() if kind.is_of_clips else FACTS), f"{first.name} dB"]
    for method in others:
        header += [f"{method.name} dB", "difference"]
    rows = []
    every = list(zip(*(comparison.pairings(index) for index in range(len(others))), strict=True))
    for place in comparison.worst_first():
        of_image, base = every[place], every[place][0].first
        row = [
            Cell(base.name, link=_row_name(place), name=_row_name(place)),
            *(Cell(text) for text in (base.camera, base.scene)),
            *fact_cells(base, kind),
            number_cell(base.psnr_db, f"{base.psnr_db:.2f}"),
        ]
        for one in of_image:
            psnr, gain = one.other.psnr_db, one.gain_db
            row += [number_cell(psnr, f"{psnr:.2f}"), number_cell(gain, signed_text(gain, 2), _look(gain))]
        rows.append(tuple(row))
    return Table(tuple(header), tuple(rows), left=(0, 1, 2))


# --- pictures -----------------------------------------------------------------------------------------------------


def _facets(comparison: Comparison) -> dict[str, list[str]]:
    """Return the columns that images are filtered by, with their values in the order of the choice."""
    scores = [of[0] for of in comparison.images]
    found = {
        "camera": [score.camera for score in scores_in_order(scores, comparison.methods[0].result.dataset)],
        "scene": scenes_of(scores),
    }
    if not comparison.kind.is_of_clips:
        isos, factors = zip(*(fact_cells(score, comparison.kind) for score in scores), strict=True)
        for name, cells in (("ISO", isos), ("factor", factors)):
            found[name] = [cell.text for cell in sorted(cells, key=lambda cell: float(cell.value or 0))]
    return {name: list(dict.fromkeys(values)) for name, values in found.items()}


@dataclass(frozen=True, slots=True)
class _Panel:
    """A place of the viewer: its key, what it is called, the key of the error below it, the key that chooses it."""

    key: str
    name: str
    error: str = ""
    digit: str = ""


def _looking(comparison: Comparison, drawn: DrawnImages) -> dict[str, Any]:
    """Return what the viewer shows: its panels, and of each image addresses, sizes and words."""
    names = [method.name for method in comparison.methods]
    images = [
        _looked_at(scores, image, comparison, drawn.folder)
        for scores, image in zip(comparison.images, drawn.images, strict=True)
    ]
    first = images[comparison.worst_first()[0]]
    has_input = "input" in drawn.images[0].layers
    return {
        "panels": [
            *([_Panel("input", "Input", digit="i")] if has_input else []),
            *(
                _Panel(f"method-{index}", name, f"error-{index}", str(index) if index < 10 else "")
                for index, name in enumerate(names, start=1)
            ),
            _Panel("reference", "Reference", digit="r"),
        ],
        "first": first,
        "data": {_row_name(image["place"]): image for image in images},
        "colours": comparison.methods[0].result.protocol.pixels,
    }


def _looked_at(scores: Sequence[UnitScore], image: DrawnImage, comparison: Comparison, folder: str) -> dict[str, Any]:
    first, kind = scores[0], comparison.kind
    iso, factor = (fact_cells(first, kind) or (Cell("–"), Cell("")))[:2]
    facts = [*([f"ISO {iso.text}"] if first.iso else []), *([factor.text] if factor.text else [])]
    return {
        "place": image.number - 1,
        "name": first.name,
        "facts": ", ".join(
            [
                first.camera,
                first.scene,
                *facts,
                *([f"shown {image.brighter:g} times brighter"] if image.brighter != 1 else []),
            ]
        ),
        "scores": {
            f"method-{index}": ", ".join(
                f"{metric.format(score.values[metric.name])} {metric.unit or metric.label}" for metric in kind.metrics
            )
            for index, score in enumerate(scores, start=1)
        },
        "files": {layer: f"{folder}/{picture_file(image, layer)}" for layer in (*image.layers, "whole")},
        "box": [image.left, image.top, image.columns, image.rows],
        "size": [image.width, image.height],
        "limit": digits(image.error_limit, 2),
    }
