"""A comparison of methods in text, Markdown and LaTeX, and the tables and words that its page shares."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from eldata.base.numbers import counted
from eldata.base.tables import Strong, latex_table, markdown_table, markdown_text, text_table, wrapped
from eldata.evaluation.scores import PaperTable, grouped_table, short_digest
from eldata.evaluation.statistics import FEWEST_SCENES, LEVEL, over_scenes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.base.tables import Format
    from eldata.evaluation.comparison import Comparison, Group
    from eldata.evaluation.statistics import Difference
    from eldata.protocols.kinds import Kind

LABELS = 3
"""How many cells at the beginning of each row say what it is of: camera, factor, how many images."""


def means_table(comparison: Comparison, times: str = "x") -> PaperTable:
    """Return the means of each method by group; what prints like the best of its row is :class:`Strong`."""
    kind = comparison.kind
    heads = [f"{method.name} {metric.unit or metric.label}" for method in comparison.methods for metric in kind.metrics]
    return _by_group(comparison, heads, [_mean_texts(group, kind) for group in comparison.groups], times)


def gains_table(comparison: Comparison, index: int, times: str = "x") -> PaperTable:
    """Return differences to the first method by group, of the method of this index among the others."""
    kind = comparison.kind
    heads = ["scenes", *(head for metric in kind.metrics for head in (metric.heading, f"{LEVEL:.0%} interval", "p"))]
    texts = [[str(group.scenes), *_gain_texts(group.gains[index], kind)] for group in comparison.groups]
    return _by_group(comparison, heads, texts, times)


def contests_table(comparison: Comparison) -> PaperTable:
    """Return each method against each other on all common images, with p-values corrected for their number."""
    kind = comparison.kind
    heads = (head for metric in kind.metrics for head in (metric.heading, f"{LEVEL:.0%} interval", "p", "p (Holm)"))
    rows = []
    for contest in comparison.contests:
        texts = _gain_texts(contest.gains, kind)
        cells = []
        for index, metric in enumerate(kind.metrics):
            cells += [*texts[3 * index : 3 * index + 3], _p_text(contest.corrected[metric.name])]
        rows.append((contest.other, contest.first, *cells))
    return PaperTable(("method", "minus", *heads), tuple(rows), (0, 1))


def contests_note(comparison: Comparison) -> str:
    """Return what the corrected p-values are, in a sentence."""
    count = len(comparison.contests) * len(comparison.kind.metrics)
    return (
        f"p (Holm) is corrected for the {count} tests of this table together: of differences with p (Holm) below 0.05, "
        "the chance that even one is none is 5% at most. The other tables are not corrected."
    )


def _by_group(comparison: Comparison, heads: Sequence[str], texts: Sequence[Sequence[str]], times: str) -> PaperTable:
    counted = [(str(group.images), *cells) for group, cells in zip(comparison.groups, texts, strict=True)]
    groups = [(group.camera, group.ratio) for group in comparison.groups]
    return grouped_table(groups, (comparison.kind.units, *heads), counted, times)


def _mean_texts(group: Group, kind: Kind) -> list[str]:
    """Return the means of each method as printed."""
    columns = []
    for metric in kind.metrics:
        values = [means[metric.name] for means in group.means]
        texts = [metric.format(value) for value in values]
        known = [value for value in values if not math.isnan(value)]
        best = metric.format((max if metric.sign > 0 else min)(known)) if known else ""
        columns.append([Strong(text) if text == best else text for text in texts])
    return [text for each in zip(*columns, strict=True) for text in each]


def _gain_texts(gain: dict[str, Difference], kind: Kind) -> list[str]:
    """Return difference, interval and p-value of each metric as printed."""
    cells = []
    for metric in kind.metrics:
        difference = gain[metric.name]
        interval = difference.interval
        reach = f"{metric.format_difference(interval.low)} to {metric.format_difference(interval.high)}"
        cells += [
            metric.format_difference(interval.mean),
            reach if interval.is_known else "-",
            _p_text(difference.p_value),
        ]
    return cells


def signed_text(value: float, decimals: int) -> str:
    """Return a difference with its sign; ``-`` for one that is not known."""
    return f"{value:+.{decimals}f}" if not math.isnan(value) else "-"


def _p_text(p_value: float) -> str:
    """Return a p-value as printed: three decimals, ``<0.001`` below."""
    if math.isnan(p_value):
        return "-"
    return f"{p_value:.3f}" if p_value >= 0.0005 else "<0.001"


def format_comparison(comparison: Comparison, form: Format) -> str:
    """Return the tables: means of every method, each method's differences to the first, and each against each."""
    first, *others = comparison.methods
    summary, note, means = summary_of(comparison), statistics_note(comparison), means_table(comparison)
    notes = [note]
    # What a label of LaTeX ends with, title and cells.
    tables = [
        (other.name, f"{other.name} minus {first.name}", gains_table(comparison, index))
        for index, other in enumerate(others)
    ]
    if comparison.contests:
        tables.append(("contests", "Each against each", contests_table(comparison)))
        notes.append(contests_note(comparison))
    if form == "markdown":
        blocks = [markdown_text(summary), markdown_table(means.header, means.rows)]
        for _, title, table in tables:
            blocks += [markdown_text(f"{title}:"), markdown_table(table.header, table.rows)]
        remarks = [*notes, *(f"Warning: {text}" for text in comparison.warnings)]
        return "\n\n".join([*blocks, *map(markdown_text, remarks)])
    if form == "latex":
        return "\n\n".join(_latex_tables(comparison, means, tables, notes))
    cells = (
        (*row[:LABELS], *(f"{cell}*" if isinstance(cell, Strong) else f"{cell} " for cell in row[LABELS:]))
        for row in (means.header, *means.rows)
    )
    lines = [summary, "", text_table(next(cells), list(cells)), "* best of its row", ""]
    for _, title, table in tables:
        lines += [title, "", text_table(table.header, table.rows), ""]
    return "\n".join([*lines, *(line for text in notes for line in wrapped(text, ""))])


def _latex_tables(
    comparison: Comparison, means: PaperTable, tables: Sequence[tuple[str, str, PaperTable]], notes: Sequence[str]
) -> list[str]:
    summary, result = summary_of(comparison), comparison.methods[0].result
    label = f"tab:{result.dataset}-{result.protocol.name}"
    metrics = [metric.label for metric in comparison.kind.metrics]
    found = [
        latex_table(
            (*means.header[:LABELS], *metrics * len(comparison.methods)),
            means.rows,
            caption=f"{summary}. PSNR in dB.",
            label=f"{label}-methods",
            spans=[("", LABELS), *((method.name, len(metrics)) for method in comparison.methods)],
            rules=means.rules,
        )
    ]
    for name, title, table in tables:
        caption = f"{title}: {summary}. {' '.join(notes if table.left == (0, 1) else notes[:1])}"
        found.append(latex_table(table.header, table.rows, caption=caption, label=f"{label}-{name}", rules=table.rules))
    return found


def summary_of(comparison: Comparison) -> str:
    """Return what was compared, in a line."""
    result, kind = comparison.methods[0].result, comparison.kind
    count, scenes = len(comparison.images), comparison.whole.scenes
    return (
        f"{len(comparison.methods)} methods on {count} common {kind.unit if count == 1 else kind.units} of "
        f"{counted(scenes, 'scene')}: {result.dataset}, protocol {result.protocol.name} "
        f"({short_digest(result.digest)})"
    )


def statistics_note(comparison: Comparison) -> str:
    """Return what interval and p are, in a sentence."""
    return (
        f"Interval: {LEVEL:.0%}, Student's t over {over_scenes(shared=comparison.scenes_shared)}; p: signs of whole "
        f"scenes flipped, two-sided. With fewer than {FEWEST_SCENES} scenes there is no interval."
    )
