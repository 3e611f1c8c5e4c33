"""A comparison of methods as one HTML page: tables, differences, every image, biggest wins and losses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_text
from eldata.base.tables import Strong
from eldata.evaluation.comparison import (
    METRICS,
    gain_header,
    gain_texts,
    mean_texts,
    signed_text,
    statistics_note,
    summary_of,
)
from eldata.reports.compare.plots import gain_plots
from eldata.reports.evaluation.page import Cell, Table, field_text, number_cell, times
from eldata.reports.evaluation.script import rendered_with_script
from eldata.reports.evaluation.tables import factor_text, group_text
from eldata.reports.html import signed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eldata.evaluation.comparison import Comparison, Group, Method
    from eldata.evaluation.saved import SavedScore
    from eldata.evaluation.statistics import Difference

_SHOWN = 10  # biggest wins, and losses


def write_comparison_page(comparison: Comparison, out: Path | str) -> None:
    """Write the page of a comparison, whole or not at all.

    Raises
    ------
    EldataError
        If it cannot be written.
    """
    write_text(out, comparison_page(comparison))


def comparison_page(comparison: Comparison) -> str:
    """Return the page; the same comparison gives the same text."""
    first, *others = comparison.methods
    return rendered_with_script(
        "compare.html",
        title=f"{' and '.join(_names(others))} against {first.name}",
        summary=f"{summary_of(comparison)}.",
        warnings=comparison.warnings,
        note=statistics_note(),
        means=_means_table(comparison),
        sections=[_section(comparison, index) for index in range(len(others))],
        rows=_rows(comparison),
        methods=[
            {"name": method.name, "id": f"method-{index}", "fields": _facts(method)}
            for index, method in enumerate(comparison.methods, start=1)
        ],
    )


def _names(methods: Sequence[Method]) -> list[str]:
    names = [method.name for method in methods]
    return names if len(names) < 3 else [", ".join(names[:-1]), names[-1]]


def _facts(method: Method) -> list[tuple[str, str]]:
    result = method.result
    return [
        ("file", result.source),
        ("scored", f"{len(result.images)} of {result.pairs} pairs"),
        ("protocol", result.protocol_name),
        *((name, field_text(value)) for name, value in result.provenance.items()),
    ]


# --- tables -------------------------------------------------------------------------------------------------------


def _labels(comparison: Comparison) -> list[tuple[Cell, Cell, Cell]]:
    labels = []
    previous = ""
    for group in comparison.groups:
        name = group_text(group.camera)
        texts = ("" if name == previous else name, times(factor_text(group.ratio)), str(group.images))
        labels.append((Cell(texts[0]), Cell(texts[1]), Cell(texts[2])))
        previous = name
    return labels


def _rules(comparison: Comparison) -> tuple[int, ...]:
    return tuple(index for index, label in enumerate(_labels(comparison)) if index and label[0].text)


def _means_table(comparison: Comparison) -> Table:
    heads = [f"{method.name} {unit or name}" for method in comparison.methods for name, unit, _ in METRICS]
    rows = [
        (*label, *(Cell(signed(text), "best" if isinstance(text, Strong) else "") for text in mean_texts(group)))
        for label, group in zip(_labels(comparison), comparison.groups, strict=True)
    ]
    return Table(("camera", "factor", "images", *heads), tuple(rows), rules=_rules(comparison))


def _section(comparison: Comparison, index: int) -> dict[str, Any]:
    first, other = comparison.methods[0], comparison.methods[index + 1]
    rows = [
        (*label, Cell(str(group.scenes)), *_gain_cells(group, index))
        for label, group in zip(_labels(comparison), comparison.groups, strict=True)
    ]
    wins, losses = _extremes(comparison, index + 1)
    return {
        "title": f"{other.name} against {first.name}",
        "id": f"gain-{index + 1}",
        "verdict": _verdict(comparison.whole.gains[index].psnr_db, first.name, other.name),
        "table": Table(("camera", "factor", "images", "scenes", *gain_header()), tuple(rows), rules=_rules(comparison)),
        "plots": gain_plots(comparison, index),
        "wins": wins,
        "losses": losses,
    }


def _gain_cells(group: Group, index: int) -> list[Cell]:
    gain = group.gains[index]
    looks = [look for difference in (gain.psnr_db, gain.ssim) for look in (_look(difference), "", "")]
    return [
        Cell("–" if text == "-" else signed(text), look) for text, look in zip(gain_texts(gain), looks, strict=True)
    ]


def _look(difference: Difference) -> str:
    """Return how a difference looks: better or worse only where its interval leaves 0 out."""
    interval = difference.interval
    if interval.is_known and interval.low > 0:
        return "ok"
    return "off" if interval.is_known and interval.high < 0 else ""


def _verdict(difference: Difference, first: str, other: str) -> str:
    interval = difference.interval
    if not math.isfinite(interval.mean):
        return f"The mean difference of PSNR is not finite: a prediction equals its reference, of {first} or {other}."
    size = f"{signed(signed_text(interval.mean, 2))} dB on average"
    if not interval.is_known:
        return f"{size}; {interval.scenes} scenes are too few for an interval."
    reach = signed(f"{signed_text(interval.low, 2)} to {signed_text(interval.high, 2)}")
    if interval.low > 0 or interval.high < 0:
        better = other if interval.low > 0 else first
        return f"{size} ({reach}): {better} is better by more than the choice of scenes explains."
    return f"{size} ({reach}): the choice of scenes may explain all of it."


def _extremes(comparison: Comparison, which: int) -> tuple[Table | None, Table | None]:
    """Return the images with the biggest gains and those with the biggest losses; ``None`` if there are none."""
    gains = [
        (scores[which].psnr_db - scores[0].psnr_db, scores)
        for scores in comparison.images
        if math.isfinite(scores[which].psnr_db) and math.isfinite(scores[0].psnr_db)
    ]
    gains.sort(key=lambda item: item[0])
    losses = [item for item in gains[:_SHOWN] if item[0] < 0]
    wins = [item for item in gains[::-1][:_SHOWN] if item[0] > 0]
    return _extremes_table(wins, which), _extremes_table(losses, which)


def _extremes_table(items: Sequence[tuple[float, tuple[SavedScore, ...]]], which: int) -> Table | None:
    if not items:
        return None
    rows = [
        (
            Cell(scores[0].path),
            Cell(f"{scores[0].iso:g}" if scores[0].iso else "–"),
            Cell(f"×{scores[0].ratio:g}"),
            Cell(signed(signed_text(gain, 2))),
            Cell(signed(signed_text(scores[which].ssim - scores[0].ssim, 3))),
        )
        for gain, scores in items
    ]
    return Table(("image", "ISO", "factor", "PSNR [dB]", "SSIM"), tuple(rows))


def _rows(comparison: Comparison) -> Table:
    first, *others = comparison.methods
    header = ["image", "camera", "scene", "ISO", "factor", f"{first.name} dB"]
    for method in others:
        header += [f"{method.name} dB", "difference"]
    rows = []
    for scores in comparison.images:
        base = scores[0]
        row = [
            *(Cell(text) for text in (base.path, base.camera, base.scene)),
            number_cell(base.iso, f"{base.iso:g}" if base.iso else "–"),
            number_cell(base.ratio, f"×{base.ratio:g}"),
            number_cell(base.psnr_db, f"{base.psnr_db:.2f}"),
        ]
        for score in scores[1:]:
            equal = math.isinf(score.psnr_db) and score.psnr_db == base.psnr_db
            gain = math.nan if equal else score.psnr_db - base.psnr_db
            look = "ok" if gain > 0 else "off" if gain < 0 else ""
            row += [number_cell(score.psnr_db, f"{score.psnr_db:.2f}"), number_cell(gain, signed_text(gain, 2), look)]
        rows.append(tuple(row))
    return Table(tuple(header), tuple(rows), left=(0, 1, 2))
