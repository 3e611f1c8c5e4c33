"""Published numbers with their sources, and a result among those that it may be compared with."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from eldata.base.fields import Fields, TextFile, TextRow, names_of
from eldata.base.tables import text_table, wrapped
from eldata.errors import ManifestError
from eldata.evaluation.results import EvaluationResult, saved_result
from eldata.evaluation.scores import TableRow, factor_text
from eldata.manifest.catalogue import shipped_folder
from eldata.protocols.named import PROTOCOLS

COLUMNS = (
    *("source", "table", "dataset", "camera", "subset", "protocol", "ratio", "pairs", "method"),
    *("psnr_db", "ssim", "st_rred", "note"),
)
NOISY_INPUT = "noisy input"
"""The method of a row that scores the input itself, as ``--baseline input`` does, and no prediction."""

_DIFFERENCES_SHOWN = 2
# The noisy input's own scores, PSNR in dB and SSIM. They are published with two and four digits, of sums in float32,
# which moves a score by up to 4e-7 and 3e-5 (docs/evaluation.md). What is near is less than any mistake that was tried
# makes of them, on simulated scenes: black off by 1 DN, a ratio by 1 %, a white level by 0.5 %, which is 0.04 dB.
_AS_PUBLISHED: Final = (0.005 + 4e-7, 0.00005 + 3e-5)
_NEAR: Final = (0.02, 0.001)


@dataclass(frozen=True, slots=True)
class PublishedSource:
    """Where published numbers come from.

    Attributes
    ----------
    key, label
        Name in the tables' column ``source``; name for readers.
    citation, url, commit
        What to cite, where it is, and the state of the code that says how it was computed, if there is code.
    tables
        Title of each of its tables by the table's name.
    known, unknown
        What is known of how the numbers were computed, and what is not.
    """

    key: str
    label: str
    citation: str
    url: str
    commit: str | None
    tables: dict[str, str]
    known: tuple[str, ...]
    unknown: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PublishedRow:
    """The published PSNR and SSIM of one method.

    Attributes
    ----------
    source, table
        Key of the :class:`PublishedSource` and name of its table.
    dataset, camera, subset, ratio
        What was scored. ``subset`` is a name on the dataset's card, ``None`` the whole set or not known; ``ratio`` is
        the low-light factor, ``None`` a mean over all.
    protocols
        Names of the protocols that score as the source did; empty if how it did is not known for certain, and then
        ``note`` says what is not.
    pairs
        How many pairs the mean is over, if known.
    method
        Its name; what a paper calls "ours" has a name here. :data:`NOISY_INPUT` is none: the input itself was scored.
    psnr_db, ssim, st_rred
        As printed; ``None`` where it is not published or not known.
    note
        What else to know.
    """

    source: str
    table: str
    dataset: str
    camera: str
    subset: str | None
    protocols: tuple[str, ...]
    ratio: float | None
    pairs: int | None
    method: str
    psnr_db: float
    ssim: float | None
    st_rred: float | None
    note: str

    @property
    def place(self) -> str:
        """Camera and factor as text."""
        return f"{self.camera} {_name_factors(self.ratio)}"


@dataclass(frozen=True, slots=True)
class PublishedTables:
    """Published numbers and their sources, by key."""

    sources: dict[str, PublishedSource]
    rows: tuple[PublishedRow, ...]


# --- reading ------------------------------------------------------------------------------------------------------


@cache
def shipped_published() -> PublishedTables:
    """Read the published numbers that come with the package: ``sources.json`` and every ``*.csv``."""
    folder = shipped_folder() / "published"
    top = TextFile(folder / "sources.json", ManifestError).json()
    sources = {key: _read_source(key, top.inside(key)) for key in top.data}
    files = [TextFile(path, ManifestError) for path in sorted(folder.glob("*.csv"))]
    return PublishedTables(sources, tuple(_read_row(cells, sources) for file in files for cells in file.rows(COLUMNS)))


def _read_source(key: str, entry: Fields) -> PublishedSource:
    """Read a source of published numbers: citation, address, tables."""
    entry.only([name for name in names_of(PublishedSource) if name != "key"])
    tables = entry.inside("tables")
    commit = None if entry.value("commit") is None else entry.text("commit")
    texts = {name: entry.text(name) for name in ("label", "citation", "url")}
    known, unknown = entry.texts("known"), entry.texts("unknown")
    titles = {name: tables.text(name) for name in tables.data}
    return PublishedSource(key, **texts, commit=commit, tables=titles, known=known, unknown=unknown)


def _read_row(row: TextRow, sources: dict[str, PublishedSource]) -> PublishedRow:
    """Read a published number from a row of CSV."""
    source = sources[row.choice("source", tuple(sources))]
    return PublishedRow(
        source=source.key,
        table=row.choice("table", tuple(source.tables)),
        dataset=row.text("dataset"),
        camera=row.text("camera"),
        subset=row.data["subset"] or None,
        protocols=tuple(name for name in row.data["protocol"].split(";") if name),
        ratio=row.optional("ratio", row.number, at_least=0),
        pairs=row.optional("pairs", row.whole, at_least=1),
        method=row.text("method"),
        psnr_db=row.number("psnr_db", at_least=0),
        ssim=row.optional("ssim", row.number, at_least=0),
        st_rred=row.optional("st_rred", row.number, at_least=0),
        note=row.data["note"],
    )


# --- choosing -----------------------------------------------------------------------------------------------------


def published_rows(
    dataset: str,
    protocol: str | None = None,
    *,
    subset: str | None = None,
    camera: str | None = None,
    ratios: Collection[float] | None = None,
) -> tuple[PublishedRow, ...]:
    """Return the published numbers on a dataset, in the order of the files. ``None`` means any.

    Parameters
    ----------
    dataset
        Name of a shipped manifest, such as ``sid-sony``.
    protocol
        Name of a protocol; numbers whose protocol is not known for certain are under none.
    subset, camera
        Name of a subset on the dataset's card, and of a camera.
    ratios
        Low-light factors.

    Examples
    --------
    >>> from eldata.evaluation import published_rows
    >>> sorted({row.method for row in published_rows("eld", "eld")})[:3]
    ['A-BM3D', 'BM3D', 'ELD']
    """
    return tuple(
        row
        for row in shipped_published().rows
        if row.dataset == dataset
        and (protocol is None or protocol in row.protocols)
        and (subset is None or row.subset == subset)
        and (camera is None or row.camera == camera)
        and (ratios is None or row.ratio in ratios)
    )


# --- a result among them ----------------------------------------------------------------------------------------------


def comparison_table(result: EvaluationResult | Mapping[str, Any], *, name: str = "yours") -> str:
    """Return a result among the published numbers that it may be compared with, as text.

    A number is shown only if it was scored in the same way on the same pairs, whatever the protocols are called: one of
    the number's protocols scores as the result's did, on these files (:meth:`EvaluationResult.scored_unlike`), and the
    result has as many pairs of camera and factor, of the same subset, each with a score. Everything else that is
    published on the dataset is listed below with the reason why it does not compare.

    Of the noisy input itself (``baseline="input"``) it also says whether its scores are the published ones. They depend
    on nothing but the files, their levels and ratios and the metric, so they check all of these.

    Parameters
    ----------
    result
        A result, or its JSON (``as_dict()``, or what ``eldata evaluate --json`` wrote).
    name
        What the result is called in the tables, where it is marked with ``>``.

    Raises
    ------
    FileError
        If ``result`` is not the JSON of a result; the message names the field.
    """
    mine = saved_result(result, "the result") if isinstance(result, Mapping) else result
    tables = shipped_published()
    rows = [row for row in tables.rows if row.dataset == mine.dataset]
    if not rows:
        return f"no published numbers on {mine.dataset} are known to eldata"
    reasons = {row: _explain_mismatch(row, mine) for row in rows}
    alike = [row for row in rows if reasons[row] is None]
    stated = mine.provenance.get("subset")
    subset = f", subset {stated}" if stated else ""
    lines = [f"published numbers on {mine.dataset}, protocol {mine.protocol.name}{subset}", ""]
    lines += _write_tables(alike, mine, name, tables) or ["None compares with this result.", ""]
    if mine.of_input:
        lines += [*_check_input([row for row in rows if row.method == NOISY_INPUT], reasons, mine), ""]
    if alike:
        lines += _write_remarks(alike, tables)
    if others := [row for row in rows if reasons[row] is not None]:
        lines.append("not compared:")
        lines += _list_others(others, reasons, tables)
    return "\n".join(lines).rstrip()


def _explain_mismatch(row: PublishedRow, mine: EvaluationResult) -> str | None:
    """Explain why a published number does not compare with a result; ``None`` if it does."""
    if not row.protocols:
        return f"under no protocol that is known for certain: {row.note}"
    differences = [mine.scored_unlike(PROTOCOLS[name]) for name in row.protocols]
    if [] not in differences:
        return _describe_scoring(row, mine, differences)
    mean, subset = _find_mean(row, mine), mine.provenance.get("subset")
    if row.subset != subset:
        return f"published for {_name_subset(row.subset)}; yours is {_name_subset(subset)}"
    if mean is None:
        return "not in your table"
    if mean.scored < mean.pairs:
        return f"yours has scores of {mean.scored} of {mean.pairs} pairs"
    if row.pairs != mean.pairs:
        return f"published over {row.pairs or 'an unknown number of'} pairs; yours is over {mean.pairs}"
    return None


def _describe_scoring(row: PublishedRow, mine: EvaluationResult, differences: list[list[str]]) -> str:
    """Describe the differences in scoring of a published number, by its protocol that is nearest to the result's."""
    name, theirs = mine.protocol.name, " or ".join(row.protocols)
    nearest = min(differences, key=len)
    more = f" and {len(nearest) - _DIFFERENCES_SHOWN} more" if len(nearest) > _DIFFERENCES_SHOWN else ""
    words = "; ".join(nearest[:_DIFFERENCES_SHOWN]) + more
    if name in row.protocols:
        return f"your result's {name} is not that of this version of eldata ({words}); score it again"
    return f"published for {theirs}; yours is {name} ({words})"


def _find_mean(row: PublishedRow, mine: EvaluationResult) -> TableRow | None:
    """Find a result's mean over the same camera and ratio as a published number; ``None`` if it has none."""
    means = {(mean.camera, mean.ratio): mean for mean in mine.table}
    is_only_camera = {camera for camera, _ in means if camera is not None} <= {row.camera}
    over_all = means.get((None, row.ratio)) if is_only_camera else None  # a mean over all cameras is one over this
    return means.get((row.camera, row.ratio), over_all)


def _write_tables(alike: list[PublishedRow], mine: EvaluationResult, name: str, tables: PublishedTables) -> list[str]:
    """Write a table for each camera and ratio: published methods and this result, the best PSNR first."""
    lines: list[str] = []
    labels = {key: source.label for key, source in tables.sources.items()}
    for place in dict.fromkeys((row.camera, row.ratio) for row in alike):
        rows = [row for row in alike if (row.camera, row.ratio) == place]
        mean = next(filter(None, (_find_mean(row, mine) for row in rows)))
        entries: list[tuple[str, str, float, float | None, float | None]] = [
            (f"> {name}", "", mean.psnr_db, mean.ssim, mean.values.get("st_rred")),
            *((f"  {row.method}", labels[row.source], row.psnr_db, row.ssim, row.st_rred) for row in rows),
        ]
        entries.sort(key=lambda entry: -entry[2])  # at a tie yours stays first
        header = ["  method", "source", "PSNR [dB]", "SSIM", "ST-RRED"]
        header = header[: 5 if any(row.st_rred is not None for row in rows) else 4]
        cells = [
            (method, label, f"{psnr_db:.2f}", *("-" if value is None else f"{value:.3f}" for value in values))
            for method, label, psnr_db, *values in entries
        ]
        unique = dict.fromkeys(row[: len(header)] for row in cells)  # a README and a log that print the same are one
        lines += [f"{rows[0].place}, {mean.pairs} pairs", text_table(header, list(unique), left=(0, 1)), ""]
    return lines


def _check_input(
    published: list[PublishedRow], reasons: dict[PublishedRow, str | None], mine: EvaluationResult
) -> list[str]:
    """Compare the noisy input's own scores with the published ones: a sentence per group, and what follows."""
    published = [row for row in published if row.protocols]
    if not published:
        return [f"the noisy input: no published score of it on {mine.dataset} is known, so this checks nothing"]
    beside = [(row, mean) for row in published if reasons[row] is None and (mean := _find_mean(row, mine)) is not None]
    if not beside:
        reason = "; ".join(dict.fromkeys(str(reasons[row]) for row in published))
        name, camera = published[0].protocols[0], published[0].camera
        lines = [f"the noisy input: its published scores are not beside yours ({reason});"]
        return [*lines, f"  --protocol {name}, over all pairs of {camera}, checks files, levels, ratios and metric"]
    lines = ["the noisy input, whose scores check files, levels, ratios and metric:"]
    lines += [f"  {_describe_agreement(row, mean)}" for row, mean in beside]
    lines += [f"  {row.place} is not checked: {reasons[row]}" for row in published if reasons[row] is not None]
    return [*lines, f"  {_conclude(beside)}"]


def _describe_agreement(row: PublishedRow, mean: TableRow) -> str:
    """Compare a published score of the noisy input with the user's own, in a sentence."""
    printed = f"{row.psnr_db:.2f} dB" if row.ssim is None else f"{row.psnr_db:.2f} dB and {row.ssim:.4f}"
    values = f"{printed} published, yours {mean.psnr_db:.3f} and {mean.ssim:.5f}"
    if _is_within(_AS_PUBLISHED, row, mean):
        return f"{row.place} agrees: {values}"
    by = ", ".join(f"{value:{form}}" for value, form in zip(_differences(row, mean), ("+.3f", "+.5f"), strict=False))
    return f"{row.place} {'is near' if _is_within(_NEAR, row, mean) else 'DOES NOT AGREE'}: {values} ({by})"


def _conclude(beside: list[tuple[PublishedRow, TableRow]]) -> str:
    """Conclude from the noisy input's scores whether files, levels, ratios and metric are right."""
    off = [row for row, mean in beside if not _is_within(_NEAR, row, mean)]
    if not off:
        return "so files, levels, ratios and metric are right: every mistake that was tried moves these scores more"
    if len(off) < len(beside):
        return f"so levels and metric are right, and of {_places(off)} the files or the ratio are not: fetch them again"
    return "so what all factors share is not as published: the levels that LibRaw states, the metric, or all files"


def _differences(row: PublishedRow, mean: TableRow) -> tuple[float, ...]:
    """Return PSNR in dB and SSIM less the published ones, as far as these are known."""
    return (mean.psnr_db - row.psnr_db, *(() if row.ssim is None else (mean.ssim - row.ssim,)))


def _is_within(limits: tuple[float, float], row: PublishedRow, mean: TableRow) -> bool:
    """Check that PSNR and SSIM differ from the published ones by no more than their limits."""
    return all(abs(value) <= limit for value, limit in zip(_differences(row, mean), limits, strict=False))


def _write_remarks(alike: list[PublishedRow], tables: PublishedTables) -> list[str]:
    """Write the notes on published numbers, their sources, and the open questions on these."""
    notes = [f"note: {row.method}, {row.place}: {row.note}" for row in alike if row.note]
    lines = [line for text in notes for line in wrapped(text)]
    for key in dict.fromkeys(row.source for row in alike):
        source = tables.sources[key]
        lines.append(f"{source.label}: {source.citation}; {source.url}")
        lines += [f"  not known: {text}" for text in source.unknown]
    return [*lines, ""]


def _list_others(
    others: list[PublishedRow], reasons: dict[PublishedRow, str | None], tables: PublishedTables
) -> list[str]:
    """List the numbers that do not compare with a result, by table and reason, as lines of text."""
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


def _name_subset(subset: str | None) -> str:
    return "no named subset" if subset is None else f"subset {subset}"


def _places(rows: list[PublishedRow]) -> str:
    """Return cameras and factors as text, each camera once: ``NikonD850 x100, x200``."""
    factors: dict[str, dict[str, None]] = {}
    for row in rows:
        factors.setdefault(row.camera, {})[_name_factors(row.ratio)] = None
    return "; ".join(f"{camera} {', '.join(texts)}" for camera, texts in factors.items())


def _name_factors(ratio: float | None) -> str:
    """Name a ratio, such as ``x100``; ``None`` is a mean over all."""
    return "all factors" if ratio is None else factor_text(ratio)
