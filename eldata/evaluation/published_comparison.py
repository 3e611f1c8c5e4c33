"""A result among the published numbers that it may be compared with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from eldata.base.tables import text_table
from eldata.evaluation.published import factors_text, load_published, shipped_published
from eldata.evaluation.saved import saved_result
from eldata.evaluation.table import TableRow
from eldata.protocols.named import PROTOCOLS

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.evaluation.published import PublishedRow, PublishedTables
    from eldata.evaluation.results import EvaluationResult


def comparison_table(
    result: EvaluationResult | Mapping[str, Any], *, name: str = "yours", published: Path | None = None
) -> str:
    """Return a result among the published numbers that it may be compared with, as text.

    A number is shown only if it was scored under the same protocol on the same pairs: the protocol's name is among the
    number's and its digest is that of this version's protocol, subset, camera and factor are the same, no flag left
    pairs out, every pair was scored, and they are as many as the source's where that is known. Everything else that is
    published on the dataset is listed below with the reason why it does not compare.

    Parameters
    ----------
    result
        A result, or its JSON (``as_dict()``, or what ``eldata evaluate --json`` wrote).
    name
        What the result is called in the tables, where it is marked with ``>``.
    published
        Folder of published numbers (:func:`load_published`). Default: those that come with the package.

    Raises
    ------
    FileError
        If ``result`` is not the JSON of a result; the message names the field.
    """
    mine = saved_result(result, "the result") if isinstance(result, Mapping) else result
    tables = shipped_published() if published is None else load_published(published)
    rows = [row for row in tables.rows if row.dataset == mine.dataset]
    if not rows:
        return f"no published numbers on {mine.dataset} are known to eldata"
    reasons = {row: _why_not(row, mine) for row in rows}
    shown = [row for row in rows if reasons[row] is None]
    subset = f", subset {_subset(mine)}" if _subset(mine) else ""
    lines = [f"published numbers on {mine.dataset}, protocol {mine.protocol.name}{subset}", ""]
    lines += _groups(shown, mine, name, tables) or ["None compares with this result.", ""]
    if shown:
        lines += _remarks(shown, tables)
    others = [row for row in rows if reasons[row] is not None]
    if others:
        lines.append("not compared:")
        lines += _not_compared(others, reasons, tables)
    return "\n".join(lines).rstrip()


def _why_not(row: PublishedRow, mine: EvaluationResult) -> str | None:
    """Return why a published number does not compare with a result, or ``None`` if it does."""
    if not row.protocols:
        return f"under no protocol that is known for certain: {row.note}"
    name = mine.protocol.name
    if name not in row.protocols:
        return f"published for {' or '.join(row.protocols)}; yours is {name}"
    if name not in PROTOCOLS or PROTOCOLS[name].digest != mine.digest:
        return f"your result's protocol {name} is not the one that this version of eldata has; score it again"
    if row.subset != _subset(mine):
        return f"published for {_subset_text(row.subset)}; yours is {_subset_text(_subset(mine))}"
    left_out = [f"{flag} ({count})" for flag, count in mine.provenance.get("excluded_flags", {}).items() if count]
    if left_out:
        return f"yours leaves out pairs: {', '.join(left_out)}"
    mean = _mean_for(row, mine)
    if mean is None:
        return "not in your table"
    if mean.scored < mean.pairs:
        return f"yours has scores of {mean.scored} of {mean.pairs} pairs"
    if row.pairs is not None and row.pairs != mean.pairs:
        return f"published over {row.pairs} pairs; yours is over {mean.pairs}"
    return None


def _subset(mine: EvaluationResult) -> str | None:
    subset = mine.provenance.get("subset")
    return None if subset is None else str(subset)


def _mean_for(row: PublishedRow, mine: EvaluationResult) -> TableRow | None:
    means = {(mean.camera, mean.ratio): mean for mean in mine.table}
    found = means.get((row.camera, row.ratio))
    if found is None and {camera for camera, _ in means if camera is not None} <= {row.camera}:
        return means.get((None, row.ratio))  # a mean over all cameras is one over this camera
    return found


def _groups(shown: list[PublishedRow], mine: EvaluationResult, name: str, tables: PublishedTables) -> list[str]:
    lines: list[str] = []
    for place in dict.fromkeys((row.camera, row.ratio) for row in shown):
        rows = [row for row in shown if (row.camera, row.ratio) == place]
        mean = _mean_for(rows[0], mine)
        if mean is None:
            continue
        measured = [("  " + row.method, tables.sources[row.source].label, row) for row in rows]
        entries: list[tuple[str, str, PublishedRow | TableRow]] = [(f"> {name}", "", mean), *measured]
        entries.sort(key=lambda entry: -entry[2].psnr_db)  # at a tie yours stays first
        values = ["PSNR [dB]", "SSIM", *(["ST-RRED"] if any(row.st_rred is not None for row in rows) else [])]
        lines += [
            f"{rows[0].place}, {mean.pairs} pairs",
            text_table(
                ("  method", "source", *values),
                [(method, label, *_value_texts(entry)[: len(values)]) for method, label, entry in entries],
                left=(0, 1),
            ),
            "",
        ]
    return lines


def _value_texts(entry: PublishedRow | TableRow) -> tuple[str, str, str]:
    st_rred = entry.values.get("st_rred") if isinstance(entry, TableRow) else entry.st_rred
    ssim, st_rred_text = ("-" if value is None else f"{value:.3f}" for value in (entry.ssim, st_rred))
    return f"{entry.psnr_db:.2f}", ssim, st_rred_text


def _remarks(shown: list[PublishedRow], tables: PublishedTables) -> list[str]:
    lines = [f"note: {row.method}, {row.place}: {row.note}" for row in shown if row.note]
    for key in dict.fromkeys(row.source for row in shown):
        source = tables.sources[key]
        lines.append(f"{source.label}: {source.citation}; {source.url}")
        lines += [f"  not known: {text}" for text in source.unknown]
    return [*lines, ""]


def _not_compared(
    others: list[PublishedRow], reasons: dict[PublishedRow, str | None], tables: PublishedTables
) -> list[str]:
    lines = []
    for source, table in dict.fromkeys((row.source, row.table) for row in others):
        rows = [row for row in others if (row.source, row.table) == (source, table)]
        lines.append(f"  {tables.sources[source].label}, {tables.sources[source].tables[table]}")
        for reason in dict.fromkeys(reasons[row] for row in rows):
            alike = [row for row in rows if reasons[row] == reason]
            lowest, highest = min(row.psnr_db for row in alike), max(row.psnr_db for row in alike)
            span = f"{lowest:.2f} dB" if lowest == highest else f"{lowest:.2f} to {highest:.2f} dB"
            lines.append(f"    {_places(alike)} ({span}): {reason}")
    return lines


def _subset_text(subset: str | None) -> str:
    return "no named subset" if subset is None else f"subset {subset}"


def _places(rows: list[PublishedRow]) -> str:
    """Return cameras and factors as text, each camera once: ``NikonD850 x100, x200``."""
    factors: dict[str, dict[str, None]] = {}
    for row in rows:
        factors.setdefault(row.camera, {})[factors_text(row.ratio)] = None
    return "; ".join(f"{camera} {', '.join(texts)}" for camera, texts in factors.items())
