"""A result among the published numbers that it may be compared with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.tables import text_table
from eldata.errors import ArgumentError
from eldata.evaluation.published import factor_text, load_published, place_text, shipped_published
from eldata.protocols import PROTOCOLS
from eldata.protocols.video import VIDEO_PROTOCOLS

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.evaluation.published import PublishedRow, PublishedTables
    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.video_results import VideoResult


@dataclass(frozen=True, slots=True)
class _Mean:
    """A row of a result's table."""

    pairs: int
    scored: int
    psnr_db: float
    ssim: float
    st_rred: float | None


@dataclass(frozen=True, slots=True)
class _Mine:
    """What of a result decides what it compares with; ``means`` is by camera and factor, ``None`` meaning all."""

    dataset: str
    protocol: str
    digest: str
    subset: str | None
    left_out: tuple[str, ...]
    cameras: frozenset[str]
    means: dict[tuple[str | None, float | None], _Mean]

    def mean_for(self, row: PublishedRow) -> _Mean | None:
        found = self.means.get((row.camera, row.ratio))
        if found is None and self.cameras <= {row.camera}:  # a mean over all cameras is one over this camera
            found = self.means.get((None, row.ratio))
        return found


def comparison_table(
    result: EvaluationResult | VideoResult | Mapping[str, Any], *, name: str = "yours", published: Path | None = None
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
    ArgumentError
        If ``result`` is not the JSON of a result; the message names the field.
    """
    mine = _mine(result if isinstance(result, Mapping) else result.as_dict())
    tables = shipped_published() if published is None else load_published(published)
    rows = [row for row in tables.rows if row.dataset == mine.dataset]
    if not rows:
        return f"no published numbers on {mine.dataset} are known to eldata"
    reasons = {row: _why_not(row, mine) for row in rows}
    shown = [row for row in rows if reasons[row] is None]
    subset = f", subset {mine.subset}" if mine.subset else ""
    lines = [f"published numbers on {mine.dataset}, protocol {mine.protocol}{subset}", ""]
    lines += _groups(shown, mine, name, tables) or ["None compares with this result.", ""]
    if shown:
        lines += _remarks(shown, tables)
    others = [row for row in rows if reasons[row] is not None]
    if others:
        lines.append("not compared:")
        lines += _not_compared(others, reasons, tables)
    return "\n".join(lines).rstrip()


def _why_not(row: PublishedRow, mine: _Mine) -> str | None:
    """Return why a published number does not compare with a result, or ``None`` if it does."""
    if not row.protocols:
        return f"under no protocol that is known for certain: {row.note}"
    if mine.protocol not in row.protocols:
        return f"published for {' or '.join(row.protocols)}; yours is {mine.protocol}"
    shipped = PROTOCOLS.get(mine.protocol) or VIDEO_PROTOCOLS.get(mine.protocol)
    if shipped is None or shipped.digest != mine.digest:
        return f"your result's protocol {mine.protocol} is not the one that this version of eldata has; score it again"
    if row.subset != mine.subset:
        return f"published for {_subset_text(row.subset)}; yours is {_subset_text(mine.subset)}"
    if mine.left_out:
        return f"yours leaves out pairs: {', '.join(mine.left_out)}"
    mean = mine.mean_for(row)
    if mean is None:
        return "not in your table"
    if mean.scored < mean.pairs:
        return f"yours has scores of {mean.scored} of {mean.pairs} pairs"
    if row.pairs is not None and row.pairs != mean.pairs:
        return f"published over {row.pairs} pairs; yours is over {mean.pairs}"
    return None


def _groups(shown: list[PublishedRow], mine: _Mine, name: str, tables: PublishedTables) -> list[str]:
    lines: list[str] = []
    for place in dict.fromkeys((row.camera, row.ratio) for row in shown):
        rows = [row for row in shown if (row.camera, row.ratio) == place]
        mean = mine.mean_for(rows[0])
        if mean is None:
            continue
        measured = [("  " + row.method, tables.sources[row.source].label, row) for row in rows]
        entries: list[tuple[str, str, PublishedRow | _Mean]] = [(f"> {name}", "", mean), *measured]
        entries.sort(key=lambda entry: -entry[2].psnr_db)  # at a tie yours stays first
        values = ["PSNR [dB]", "SSIM", *(["ST-RRED"] if any(row.st_rred is not None for row in rows) else [])]
        lines += [
            f"{place_text(*place)}, {mean.pairs} pairs",
            text_table(
                ("  method", "source", *values),
                [(method, label, *_value_texts(entry)[: len(values)]) for method, label, entry in entries],
                left=(0, 1),
            ),
            "",
        ]
    return lines


def _value_texts(entry: PublishedRow | _Mean) -> tuple[str, str, str]:
    ssim = "-" if entry.ssim is None else f"{entry.ssim:.3f}"
    return f"{entry.psnr_db:.2f}", ssim, "-" if entry.st_rred is None else f"{entry.st_rred:.3f}"


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
        factors.setdefault(row.camera, {})[factor_text(row.ratio)] = None
    return "; ".join(f"{camera} {', '.join(texts)}" for camera, texts in factors.items())


# --- reading a result ---------------------------------------------------------------------------------------------


def _mine(result: Mapping[str, Any]) -> _Mine:
    provenance, table = _field(result, "provenance", dict), result.get("table")
    excluded = _field(provenance, "excluded_flags", dict) if "excluded_flags" in provenance else {}
    means = _video_means(result, table) if isinstance(table, dict) else _image_means(_field(result, "table", list))
    return _Mine(
        dataset=_field(provenance, "dataset", str),
        protocol=_field(_field(result, "protocol", dict), "name", str),
        digest=_field(provenance, "protocol_digest", str),
        subset=None if provenance.get("subset") is None else _field(provenance, "subset", str),
        left_out=tuple(f"{flag} ({count})" for flag, count in excluded.items() if count),
        cameras=frozenset(camera for camera, _ in means if camera is not None),
        means=means,
    )


def _image_means(table: list[Any]) -> dict[tuple[str | None, float | None], _Mean]:
    means = {}
    for row in table:
        if not isinstance(row, dict):
            raise ArgumentError(f"a result's table has rows that are objects; found {type(row).__name__}")
        ratio = None if row.get("ratio") is None else _number(row, "ratio")
        camera = None if row.get("camera") is None else _field(row, "camera", str)
        means[camera, ratio] = _Mean(
            _field(row, "pairs", int), _field(row, "scored", int), _number(row, "psnr_db"), _number(row, "ssim"), None
        )
    return means


def _video_means(result: Mapping[str, Any], table: dict[str, Any]) -> dict[tuple[str | None, float | None], _Mean]:
    coverage = _field(result, "coverage", dict)
    counts = _field(coverage, "videos", int), _field(coverage, "scored", int)
    values = _number(table, "psnr_db"), _number(table, "ssim"), _number(table, "st_rred")
    return {(None, None): _Mean(*counts, *values)}


def _field(values: Mapping[str, Any], name: str, kind: type) -> Any:
    value = values.get(name)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise _no_result(name, kind.__name__, value)
    return value


def _number(values: Mapping[str, Any], name: str) -> float:
    """Return a number as the JSON has it: ``null`` is nan, the text ``inf`` infinite."""
    value = values.get(name)
    if value is None:
        return math.nan
    if value in ("inf", "-inf"):
        return float(value)
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise _no_result(name, "a number", value)
    return float(value)


def _no_result(name: str, expected: str, found: object) -> ArgumentError:
    return ArgumentError(
        f"this is not the result of an evaluation: field {name!r} should hold {expected}, found "
        f"{type(found).__name__}; give what eldata evaluate --json wrote"
    )
