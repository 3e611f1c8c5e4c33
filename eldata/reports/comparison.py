"""A comparison of methods as one HTML page: tables, differences, every image, biggest wins and losses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_text
from eldata.base.numbers import counted, natural
from eldata.base.tables import Strong
from eldata.evaluation.comparison import (
    LABELS,
    contests_note,
    contests_table,
    gains_table,
    means_table,
    signed_text,
    statistics_note,
    summary_of,
)
from eldata.evaluation.looking import ScoredImage, scores_in_order
from eldata.plots.pictures import heat_gradient
from eldata.plots.scores import draw_points, mean_gains, short
from eldata.reports.evaluation import FACTS, Cell, Table, fact_cells, field_text, number_cell
from eldata.reports.html import Plot, digits, draw_plot, join_words, render_with_script, signed
from eldata.reports.pictures import DrawnImage, draw_images

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from eldata.base.workers import Workers
    from eldata.evaluation.comparison import Comparison
    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.scores import UnitScore
    from eldata.evaluation.statistics import Difference
    from eldata.plots.axes import Theme


def write_comparison_page(
    comparison: Comparison,
    out: Path | str,
    *,
    images: Sequence[ScoredImage] = (),
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
        What to decode of each common image (:func:`eldata.evaluation.looking.images_of`): their pictures are drawn
        into the folder ``<page>-pictures`` beside the page. Of none, the page has no pictures.
    whole, workers
        As for :func:`eldata.reports.pictures.draw_images`.

    Raises
    ------
    RawFileError, PredictionError, EldataError
        If a file is no longer what was scored, or the page cannot be written.
    """
    drawn = draw_images(images, out, whole=whole, workers=workers) if images else ()
    write_text(out, comparison_page(comparison, drawn))


def comparison_page(comparison: Comparison, drawn: Sequence[DrawnImage] = ()) -> str:
    """Render the page of a comparison; the same comparison gives the same text."""
    first, *others = comparison.names
    return render_with_script(
        "compare.html",
        "compare.js",
        picture_policy=" 'self' file:" if drawn else "",
        kind=comparison.kind,
        title=f"{join_words(others)} against {first}",
        summary=f"{summary_of(comparison)}.",
        warnings=comparison.warnings,
        note=statistics_note(comparison),
        means=_tabulate_means(comparison),
        sections=[_compare_method(comparison, index) for index in range(len(others))],
        contests=_differences_table(comparison) if comparison.contests else None,
        contests_note=contests_note(comparison),
        looking=_gather_viewer(comparison, drawn) if drawn else None,
        facets=_facets(comparison),
        gradient=heat_gradient(),
        rows=_tabulate_images(comparison),
        methods=[
            {"name": name, "id": f"method-{index}", "fields": _list_result_facts(result)}
            for index, (name, result) in enumerate(comparison.results.items(), start=1)
        ],
    )


def _list_result_facts(result: EvaluationResult) -> list[tuple[str, str]]:
    """List name and value of a result's source, number of scored images, protocol and provenance."""
    return [
        ("file", result.source),
        ("scored", f"{result.scored} of {result.expected} {result.kind.counted}"),
        ("protocol", result.protocol.name),
        *((name, field_text(value)) for name, value in result.provenance.items()),
    ]


# --- tables -------------------------------------------------------------------------------------------------------


def _tabulate_means(comparison: Comparison) -> Table:
    """Lay out the methods' mean scores; the best of each column is marked."""
    means = means_table(comparison, "×")
    rows = [
        (
            *map(Cell, row[:LABELS]),
            *(Cell(signed(text), "best" if isinstance(text, Strong) else "") for text in row[LABELS:]),
        )
        for row in means.rows
    ]
    return Table(means.header, tuple(rows), rules=means.rules)


def _compare_method(comparison: Comparison, index: int) -> dict[str, Any]:
    """Gather verdict, differences, plots, wins and losses of one method against the first."""
    first, other = comparison.names[0], comparison.names[index + 1]
    wins, losses = comparison.extremes(index)
    return {
        "title": f"{other} against {first}",
        "id": f"gain-{index + 1}",
        "verdict": _judge_difference(comparison.whole.gains[index]["psnr_db"], first, other),
        "table": _differences_table(comparison, index),
        "plots": gain_plots(comparison, index),
        "wins": _extremes_table(wins, comparison),
        "losses": _extremes_table(losses, comparison),
    }


def _differences_table(comparison: Comparison, index: int | None = None) -> Table:
    """Lay out the differences between the first method and the one at this index; without one, each against each."""
    kind = comparison.kind
    if index is None:
        table, gains, labels, each = contests_table(comparison), [one.gains for one in comparison.contests], 2, 4
    else:  # with the number of scenes after the labels
        table, gains = gains_table(comparison, index, "×"), [group.gains[index] for group in comparison.groups]
        labels, each = LABELS + 1, 3
    rows = []
    for of, texts in zip(gains, table.rows, strict=True):
        looks = [""] * (len(texts) - labels)
        for at, metric in enumerate(kind.metrics):
            looks[each * at] = _look(of[metric.name].interval.sign * metric.sign)
        cells = (
            Cell("–" if text == "-" else signed(text), look) for text, look in zip(texts[labels:], looks, strict=True)
        )
        rows.append((*map(Cell, texts[:labels]), *cells))
    return Table(table.header, tuple(rows), table.left, table.rules)


def _look(sign: float) -> str:
    """Name the look of a difference: better, worse, or neither."""
    return "ok" if sign > 0 else "off" if sign < 0 else ""


def _judge_difference(difference: Difference, first: str, other: str) -> str:
    """Say which method has the better mean PSNR, and whether the choice of scenes explains it."""
    interval = difference.interval
    if not math.isfinite(interval.mean):
        return f"The mean difference of PSNR is not finite: a prediction equals its reference, of {first} or {other}."
    size = f"{signed(signed_text(interval.mean, 2))} dB on average"
    if not interval.is_known:
        return f"{size}; {counted(interval.scenes, 'scene')}: too few for an interval."
    reach = signed(f"{signed_text(interval.low, 2)} to {signed_text(interval.high, 2)}")
    if interval.sign:
        better = other if interval.sign > 0 else first
        return f"{size} ({reach}): {better} is better by more than the choice of scenes explains."
    return f"{size} ({reach}): the choice of scenes may explain all of it."


def _row_name(place: int) -> str:
    """Return the identifier of the row of the image at this place of the comparison."""
    return f"image-{place + 1}"


def _extremes_table(pairings: Sequence[tuple[UnitScore, UnitScore]], comparison: Comparison) -> Table | None:
    """Return a table of wins or losses; ``None`` if there are none."""
    if not pairings:
        return None
    kind = comparison.kind
    places = {scores[0].path: place for place, scores in enumerate(comparison.images)}
    rows = [
        (
            Cell(first.name, link=_row_name(places[first.path])),
            *fact_cells(first, kind),
            Cell(signed(signed_text(other.psnr_db - first.psnr_db, 2))),
            Cell(signed(signed_text(other.ssim - first.ssim, 3))),
        )
        for first, other in pairings
    ]
    return Table((kind.unit, *(() if kind.is_of_clips else FACTS), "PSNR [dB]", "SSIM"), tuple(rows))


def _tabulate_images(comparison: Comparison) -> Table:
    """Lay out every image's PSNR by each method, worst first, and the differences from the first method."""
    kind = comparison.kind
    first, *others = comparison.names
    header = [kind.unit, "camera", "scene", *(() if kind.is_of_clips else FACTS), f"{first} dB"]
    for name in others:
        header += [f"{name} dB", "difference"]
    rows = []
    for place in comparison.worst_first():
        base, *by_others = comparison.images[place]
        row = [
            Cell(base.name, link=_row_name(place), name=_row_name(place)),
            *(Cell(text) for text in (base.camera, base.scene)),
            *fact_cells(base, kind),
            number_cell(base.psnr_db, f"{base.psnr_db:.2f}"),
        ]
        for score in by_others:
            psnr, gain = score.psnr_db, score.psnr_db - base.psnr_db
            row += [number_cell(psnr, f"{psnr:.2f}"), number_cell(gain, signed_text(gain, 2), _look(gain))]
        rows.append(tuple(row))
    return Table(tuple(header), tuple(rows), left=(0, 1, 2))


# --- pictures -----------------------------------------------------------------------------------------------------


def _facets(comparison: Comparison) -> dict[str, list[str]]:
    """List the columns that filter images, with their values in the order of the choice."""
    scores = [of[0] for of in comparison.images]
    columns = {
        "camera": [score.camera for score in scores_in_order(scores, comparison.first.dataset)],
        "scene": sorted((score.scene for score in scores), key=natural),
    }
    if not comparison.kind.is_of_clips:
        isos, factors = zip(*(fact_cells(score, comparison.kind) for score in scores), strict=True)
        for name, cells in (("ISO", isos), ("factor", factors)):
            columns[name] = [cell.text for cell in sorted(cells, key=lambda cell: float(cell.value or 0))]
    return {name: list(dict.fromkeys(values)) for name, values in columns.items()}


def _gather_viewer(comparison: Comparison, drawn: Sequence[DrawnImage]) -> dict[str, Any]:
    """Gather the viewer's panels, and addresses, sizes and words of each image.

    A panel has a key, what it is called, the key of the error below it, and the key of a keyboard that chooses it.
    """
    images = [
        _view_image(place, scores, image, comparison)
        for place, (scores, image) in enumerate(zip(comparison.images, drawn, strict=True))
    ]
    panels = [
        *([("input", "Input", "", "i")] if "input" in drawn[0].layers else []),
        *(
            (f"method-{index}", name, f"error-{index}", str(index) if index < 10 else "")
            for index, name in enumerate(comparison.names, start=1)
        ),
        ("reference", "Reference", "", "r"),
    ]
    return {
        "panels": [dict(zip(("key", "name", "error", "digit"), panel, strict=True)) for panel in panels],
        "first": images[comparison.worst_first()[0]],
        "data": {_row_name(image["place"]): image for image in images},
        "colours": comparison.first.protocol.pixels,
    }


def _view_image(place: int, scores: Sequence[UnitScore], image: DrawnImage, comparison: Comparison) -> dict[str, Any]:
    """Gather an image's facts, scores, picture files and crop for the viewer."""
    first, kind = scores[0], comparison.kind
    iso, factor = (fact_cells(first, kind) or (Cell("–"), Cell("")))[:2]
    facts = [f"{first.camera}, {first.scene}", f"ISO {iso.text}" if first.iso else "", factor.text]
    facts.append(f"shown {image.brighter:g} times brighter" if image.brighter != 1 else "")
    return {
        "place": place,
        "name": first.name,
        "facts": ", ".join(filter(None, facts)),
        "scores": {
            f"method-{index}": ", ".join(
                f"{metric.format(score.values[metric.name])} {metric.unit or metric.label}" for metric in kind.metrics
            )
            for index, score in enumerate(scores, start=1)
        },
        "files": image.layers | image.whole,
        "box": image.box,
        "size": [image.size[1], image.size[0]],
        "limit": digits(image.error_limit, 2),
    }


# --- plots --------------------------------------------------------------------------------------------------------


def gain_plots(comparison: Comparison, index: int) -> tuple[Plot, ...]:
    """Draw the plots of one method against the first, ``index`` 0 for the second; none without finite scores.

    They show the mean differences of groups with their intervals; each image by both methods; and its difference over
    the first one's score.
    """
    finite = [
        (first.ratio, first.psnr_db, other.psnr_db)
        for first, other in comparison.pairings(index)
        if math.isfinite(first.psnr_db) and math.isfinite(other.psnr_db)
    ]
    if not finite:
        return ()
    kind, (first, other) = comparison.kind, (comparison.names[at] for at in (0, index + 1))
    groups = [group for group in comparison.groups if math.isfinite(group.gains[index]["psnr_db"].interval.mean)]
    gains = [(ratio, first_db, other_db - first_db) for ratio, first_db, other_db in finite]
    values = [value for _, *scores in finite for value in scores]
    margin = 0.04 * (max(values) - min(values)) + 0.1
    reach = min(values) - margin, max(values) + margin

    def draw_groups(axes: Axes, theme: Theme) -> None:
        """Draw each group's mean difference of PSNR, with its interval."""
        means = [group.gains[index]["psnr_db"].interval.ends for group in groups]
        mean_gains(axes, [group.name for group in groups], means, theme)
        axes.set_xlabel("difference of PSNR [dB]")

    def draw_both(axes: Axes, theme: Theme) -> None:
        """Draw every image's PSNR by one method over the other's."""
        axes.plot(reach, reach, color=theme.theory, linewidth=1)
        draw_points(axes, finite, theme, alpha=0.6)
        axes.set(xlim=reach, ylim=reach)
        axes.set_xlabel(f"{short(first)} [dB]", parse_math=False)
        axes.set_ylabel(f"{short(other)} [dB]", parse_math=False)

    def draw_gains(axes: Axes, theme: Theme) -> None:
        """Draw every image's difference of PSNR over its PSNR by the first method."""
        axes.axhline(0, color=theme.theory, linewidth=1)
        draw_points(axes, gains, theme, alpha=0.6)
        axes.set_xlabel(f"{short(first)} [dB]", parse_math=False)
        axes.set_ylabel("difference [dB]")

    differences = [gain for _, _, gain in gains]
    better, low, high = sum(gain > 0 for gain in differences), min(differences), max(differences)
    words: dict[str, object] = {"first": first, "other": other, "better": better, "count": len(finite)}
    words |= {"unit": kind.unit, "units": kind.units}
    words |= {name.capitalize(): text.capitalize() for name, text in (("unit", kind.unit), ("units", kind.units))}
    drawings = {
        "gain-groups": (f"Mean difference of PSNR, {other} minus {first}, of {len(groups)} groups.", draw_groups),
        "gain-scatter": (
            f"PSNR of {other} against that of {first} on {len(finite)} {kind.units}; it is higher on {better}.",
            draw_both,
        ),
        "gain-level": (
            f"Difference of PSNR, from {low:.2f} to {high:.2f} dB, against the PSNR of {first}.",
            draw_gains,
        ),
    }
    return tuple(
        draw_plot("compare", name, alt, draw, name=f"{name}-{index}", words=words)
        for name, (alt, draw) in drawings.items()
    )
