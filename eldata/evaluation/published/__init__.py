"""A result among the published numbers that it may be compared with."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from eldata.base.tables import text_table, wrapped
from eldata.errors import ArgumentError
from eldata.evaluation.published.tables import (
    NOISY_INPUT,
    PublishedRow,
    PublishedTables,
    factors_text,
    load_published,
    shipped_published,
)
from eldata.evaluation.results import saved_result
from eldata.evaluation.scores import TableRow
from eldata.manifest.catalogue import shipped_manifest, shipped_names
from eldata.manifest.pairs import select_pairs
from eldata.protocols.kinds import IMAGES
from eldata.protocols.named import PROTOCOLS

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.evaluation.results import EvaluationResult
    from eldata.protocols.protocol import Protocol

_DIFFERENCES_SHOWN = 2
# The noisy input's own scores, PSNR in dB and SSIM. They are published with two and four digits, of sums in float32,
# which moves a score by up to 4e-7 and 3e-5 (docs/evaluation.md). What is near is less than any mistake that was tried
# makes of them (tests/evaluation/test_published.py): the smallest is a white level 0.5 % off, 0.04 dB.
_AS_PUBLISHED: Final = (0.005 + 4e-7, 0.00005 + 3e-5)
_NEAR: Final = (0.02, 0.001)


def comparison_table(
    result: EvaluationResult | Mapping[str, Any], *, name: str = "yours", published: Path | None = None
) -> str:
    """Return a result among the published numbers that it may be compared with, as text.

    A number is shown only if it was scored in the same way on the same pairs, whatever the protocols are called: one of
    the number's protocols scores as the result's did, on these files (:meth:`EvaluationResult.scored_unlike`), and the
    pairs of camera and factor are those that this protocol scores of the number's subset, each with a score. Everything
    else that is published on the dataset is listed below with the reason why it does not compare.

    Of the noisy input itself (``baseline="input"``) it also says whether its scores are the published ones. They depend
    on nothing but the files, their levels and ratios and the metric, so they check all of these.

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
    if mine.of_input:
        lines += [*_input_check([row for row in rows if row.method == NOISY_INPUT], reasons, mine), ""]
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
    ways = [PROTOCOLS[name] for name in row.protocols if name in PROTOCOLS]
    unlike = {way.name: mine.scored_unlike(way) for way in ways}
    alike = [way for way in ways if not unlike[way.name]]
    return _other_pairs(row, mine, alike) if alike else _other_scoring(row, mine, list(unlike.values()))


def _other_scoring(row: PublishedRow, mine: EvaluationResult, unlike: list[list[str]]) -> str:
    """Return in words how a published number was scored differently, by the protocol that is nearest."""
    name, theirs = mine.protocol.name, " or ".join(row.protocols)
    if not unlike:
        return f"published for {theirs}, which this version of eldata does not know"
    words = min(unlike, key=len)
    more = f" and {len(words) - _DIFFERENCES_SHOWN} more" if len(words) > _DIFFERENCES_SHOWN else ""
    differences = "; ".join(words[:_DIFFERENCES_SHOWN]) + more
    if name in row.protocols:
        return f"your result's {name} is not that of this version of eldata ({differences}); score it again"
    again = ""
    if "equal_choices" not in mine.provenance and all(text.startswith("levels:") for text in words):
        again = "; if these came to the same, a new evaluation says so"
    return f"published for {theirs}; yours is {name} ({differences}){again}"


def _other_pairs(row: PublishedRow, mine: EvaluationResult, ways: list[Protocol]) -> str | None:
    """Return why a number that was scored alike is over other pairs, or ``None`` if it is over the same."""
    mean = _mean_for(row, mine)
    ours = frozenset() if mean is None else frozenset(score.path for score in mine.scores_of(mean))
    theirs = [_pairs_of(way.name, row.dataset, row.camera, row.subset, row.ratio) for way in ways]
    if mean is not None and mean.scored == mean.pairs and ours in theirs:
        return None
    if row.subset != _subset(mine):
        return f"published for {_subset_text(row.subset)}; yours is {_subset_text(_subset(mine))}"
    left_out = [f"{flag} ({count})" for flag, count in mine.provenance.get("excluded_flags", {}).items() if count]
    if left_out:
        return f"yours leaves out pairs: {', '.join(left_out)}"
    if mean is None:
        return "not in your table"
    if mean.scored < mean.pairs:
        return f"yours has scores of {mean.scored} of {mean.pairs} pairs"
    if row.pairs is not None and row.pairs != mean.pairs:
        return f"published over {row.pairs} pairs; yours is over {mean.pairs}"
    if ours and None not in theirs:
        return "published over other pairs than yours, as many"
    return None


@cache
def _pairs_of(
    protocol: str, dataset: str, camera: str, subset: str | None, ratio: float | None
) -> frozenset[str] | None:
    """Return the noisy frames that a protocol scores of one camera at one factor; ``None`` where nobody can tell."""
    way = PROTOCOLS[protocol]
    if way.kind is not IMAGES or dataset not in shipped_names():
        return None
    manifest = shipped_manifest(dataset)
    try:
        pairs = select_pairs(
            manifest.records,
            manifest.card.subsets,
            cameras=[camera],
            scenes=way.scenes or None,
            ratios=way.ratios or None if ratio is None else [ratio],
            subset=subset,
        )
    except ArgumentError:  # such as a camera that is not in the set
        return None
    return frozenset(pair.path for pair in pairs)


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
        cells = [(method, label, *_value_texts(entry)[: len(values)]) for method, label, entry in entries]
        lines += [
            f"{rows[0].place}, {mean.pairs} pairs",
            text_table(
                ("  method", "source", *values),
                list(dict.fromkeys(cells)),  # a README and a log that print the same are one line
                left=(0, 1),
            ),
            "",
        ]
    return lines


def _value_texts(entry: PublishedRow | TableRow) -> tuple[str, str, str]:
    st_rred = entry.values.get("st_rred") if isinstance(entry, TableRow) else entry.st_rred
    ssim, st_rred_text = ("-" if value is None else f"{value:.3f}" for value in (entry.ssim, st_rred))
    return f"{entry.psnr_db:.2f}", ssim, st_rred_text


def _input_check(
    published: list[PublishedRow], reasons: dict[PublishedRow, str | None], mine: EvaluationResult
) -> list[str]:
    """Return whether the noisy input's own scores are the published ones: a sentence per group, and what follows."""
    published = [row for row in published if row.protocols]
    if not published:
        return [f"the noisy input: no published score of it on {mine.dataset} is known, so this checks nothing"]
    beside = [(row, mean) for row in published if reasons[row] is None and (mean := _mean_for(row, mine)) is not None]
    if not beside:
        reason = "; ".join(dict.fromkeys(str(reasons[row]) for row in published))
        name, camera = published[0].protocols[0], published[0].camera
        lines = [f"the noisy input: its published scores are not beside yours ({reason});"]
        return [*lines, f"  --protocol {name}, over all pairs of {camera}, checks files, levels, ratios and metric"]
    lines = ["the noisy input, whose scores check files, levels, ratios and metric:"]
    lines += [f"  {_agreement(row, mean)}" for row, mean in beside]
    lines += [f"  {row.place} is not checked: {reasons[row]}" for row in published if reasons[row] is not None]
    return [*lines, f"  {_what_follows(beside)}"]


def _agreement(row: PublishedRow, mean: TableRow) -> str:
    printed = f"{row.psnr_db:.2f} dB" if row.ssim is None else f"{row.psnr_db:.2f} dB and {row.ssim:.4f}"
    values = f"{printed} published, yours {mean.psnr_db:.3f} and {mean.ssim:.5f}"
    if _is_within(_AS_PUBLISHED, row, mean):
        return f"{row.place} agrees: {values}"
    by = ", ".join(f"{value:{form}}" for value, form in zip(_differences(row, mean), ("+.3f", "+.5f"), strict=False))
    return f"{row.place} {'is near' if _is_within(_NEAR, row, mean) else 'DOES NOT AGREE'}: {values} ({by})"


def _what_follows(beside: list[tuple[PublishedRow, TableRow]]) -> str:
    off = [row for row, mean in beside if not _is_within(_NEAR, row, mean)]
    again = "unpack or fetch them again and compare"
    if not off and all(_is_within(_AS_PUBLISHED, row, mean) for row, mean in beside):
        return "so these files, their levels and ratios and the metric are those of the published evaluation"
    if not off:
        return (
            "so files, levels, ratios and metric seem right: every mistake that was tried moves these scores more. "
            "What is left is as small as other margins of the frame, of another release of LibRaw"
        )
    if len(off) < len(beside):
        return f"so levels and metric are right, and of {_places(off)} the files or the ratio are not: {again}"
    shared = "the black or white level that LibRaw states, or the metric"
    if len(off) == 1:
        return f"so one of these is not as published: the files or their ratio ({again}), {shared}"
    return f"so what all factors share is not as published: {shared}; else all of the files ({again})"


def _differences(row: PublishedRow, mean: TableRow) -> tuple[float, ...]:
    """Return PSNR in dB and SSIM less the published ones, as far as these are known."""
    return (mean.psnr_db - row.psnr_db, *(() if row.ssim is None else (mean.ssim - row.ssim,)))


def _is_within(limits: tuple[float, float], row: PublishedRow, mean: TableRow) -> bool:
    return all(abs(value) <= limit for value, limit in zip(_differences(row, mean), limits, strict=False))


def _remarks(shown: list[PublishedRow], tables: PublishedTables) -> list[str]:
    notes = [f"note: {row.method}, {row.place}: {row.note}" for row in shown if row.note]
    lines = [line for text in notes for line in wrapped(text)]
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
