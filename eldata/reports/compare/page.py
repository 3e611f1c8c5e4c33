"""A comparison of methods as one HTML page: tables, differences, every image, biggest wins and losses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_text
from eldata.base.tables import Strong
from eldata.evaluation.comparison_tables import (
    LABELS,
    gains_table,
    means_table,
    signed_text,
    statistics_note,
    summary_of,
)
from eldata.protocols.kinds import CLIPS
from eldata.reports.compare.plots import gain_plots
from eldata.reports.evaluation.page import FACTS, Cell, Table, fact_cells, field_text, number_cell
from eldata.reports.evaluation.script import rendered_with_script
from eldata.reports.html import signed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eldata.evaluation.comparison import Comparison, Method, Pairing
    from eldata.evaluation.statistics import Difference
    from eldata.protocols.kinds import Kind


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
        kind=comparison.kind,
        title=f"{' and '.join(_names(others))} against {first.name}",
        summary=f"{summary_of(comparison)}.",
        warnings=comparison.warnings,
        note=statistics_note(),
        means=_means_table(comparison),
        sections=[_section(comparison, index) for index in range(len(others))],
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
    first, other, kind = comparison.methods[0], comparison.methods[index + 1], comparison.kind
    wins, losses = comparison.extremes(index)
    return {
        "title": f"{other.name} against {first.name}",
        "id": f"gain-{index + 1}",
        "verdict": _verdict(comparison.whole.gains[index]["psnr_db"], first.name, other.name),
        "table": _gains_table(comparison, index),
        "plots": gain_plots(comparison, index),
        "wins": _extremes_table(wins, kind),
        "losses": _extremes_table(losses, kind),
    }


def _gains_table(comparison: Comparison, index: int) -> Table:
    gains = gains_table(comparison, index, "×")
    rows = []
    for group, texts in zip(comparison.groups, gains.rows, strict=True):
        looks = [""] * (LABELS + 1)  # and scenes
        for metric in comparison.kind.metrics:
            sign = group.gains[index][metric.name].interval.sign
            looks += [_look(sign if metric.higher_is_better else -sign), "", ""]
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


def _extremes_table(pairings: Sequence[Pairing], kind: Kind) -> Table | None:
    """Return a table of wins or losses; ``None`` if there are none."""
    if not pairings:
        return None
    rows = [
        (
            Cell(one.first.name),
            *fact_cells(one.first, kind),
            Cell(signed(signed_text(one.gain_db, 2))),
            Cell(signed(signed_text(one.gain_ssim, 3))),
        )
        for one in pairings
    ]
    return Table((kind.unit, *(FACTS if kind is not CLIPS else ()), "PSNR [dB]", "SSIM"), tuple(rows))


def _rows(comparison: Comparison) -> Table:
    kind = comparison.kind
    first, *others = comparison.methods
    header = [kind.unit, "camera", "scene", *(FACTS if kind is not CLIPS else ()), f"{first.name} dB"]
    for method in others:
        header += [f"{method.name} dB", "difference"]
    rows = []
    for of_image in zip(*(comparison.pairings(index) for index in range(len(others))), strict=True):
        base = of_image[0].first
        row = [
            *(Cell(text) for text in (base.name, base.camera, base.scene)),
            *fact_cells(base, kind),
            number_cell(base.psnr_db, f"{base.psnr_db:.2f}"),
        ]
        for one in of_image:
            psnr, gain = one.other.psnr_db, one.gain_db
            row += [number_cell(psnr, f"{psnr:.2f}"), number_cell(gain, signed_text(gain, 2), _look(gain))]
        rows.append(tuple(row))
    return Table(tuple(header), tuple(rows), left=(0, 1, 2))
