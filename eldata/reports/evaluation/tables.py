"""The table of a result as the papers print it, in Markdown and LaTeX, and the words that go with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from eldata.base.tables import latex_table, markdown_table, markdown_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.saved import SavedResult, SavedRow

Format = Literal["text", "markdown", "latex"]
FORMATS: Final[tuple[Format, ...]] = ("text", "markdown", "latex")

VALUE_NAMES: Final = ("pairs", "PSNR [dB]", "SSIM")


@dataclass(frozen=True, slots=True)
class PaperTable:
    """Cells of a table, which columns stand to the left, and which rows have a line above."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[int, ...]
    rules: tuple[int, ...]


def paper_table(result: SavedResult) -> PaperTable:
    """Return the cells: PSNR in dB to two decimals, SSIM to three.

    A set of several cameras has a row for each camera and factor, as in the ELD paper's table; a set of one camera has
    a column for each factor, as in those on SID.
    """
    rows = result.table
    one_camera = result.provenance.get("cameras") == "all" and len(cameras_of(rows)) == 1
    if one_camera:
        header = (rows[0].camera or "", *(factor_text(row.ratio) for row in rows))
        values = zip(*(value_texts(row) for row in rows), strict=True)
        return PaperTable(
            header, tuple((name, *texts) for name, texts in zip(VALUE_NAMES, values, strict=True)), (), ()
        )
    starts = [index for index, row in enumerate(rows) if index and row.camera != rows[index - 1].camera]
    cells = [
        ("" if index and index not in starts else group_text(row.camera), factor_text(row.ratio), *value_texts(row))
        for index, row in enumerate(rows)
    ]
    return PaperTable(("camera", "factor", *VALUE_NAMES), tuple(cells), (0,), tuple(starts))


def format_results(results: Sequence[SavedResult], form: Literal["markdown", "latex"]) -> str:
    """Return the tables of results, one a protocol, ready to be pasted into a document."""
    return "\n\n".join(_markdown(result) if form == "markdown" else _latex(result) for result in results)


def format_evaluations(results: Sequence[EvaluationResult], form: Literal["markdown", "latex"]) -> str:
    """Return the same of results that were not saved."""
    from eldata.evaluation.saved import saved_result

    return format_results([saved_result(result.as_dict(), "this evaluation") for result in results], form)


def _markdown(result: SavedResult) -> str:
    table = paper_table(result)
    left = table.left or (0,)
    lines = [markdown_table(table.header, table.rows, left), "", markdown_text(caption_of(result))]
    lines += [f"\nNote: {markdown_text(note)}" for note in result.notes]
    return "\n".join(lines)


def _latex(result: SavedResult) -> str:
    table = paper_table(result)
    return latex_table(
        table.header,
        table.rows,
        table.left or (0,),
        caption=caption_of(result),
        label=f"tab:{result.dataset}-{result.protocol_name}",
        rules=table.rules,
    )


def caption_of(result: SavedResult) -> str:
    """Return what a table is of: dataset, protocol with its digest, coverage and choice of pairs."""
    coverage = f"{len(result.images)} of {result.pairs} pairs"
    incomplete = "; INCOMPLETE: does not compare with others" if len(result.images) < result.pairs else ""
    version = result.provenance.get("manifest_version", "")
    dataset = f"{result.dataset} {version}".rstrip()
    return (
        f"{dataset}, protocol {result.protocol_name} ({short_digest(result.protocol_digest)}): "
        f"{coverage}{choice_text(result)}{incomplete}."
    )


def choice_text(result: SavedResult) -> str:
    """Return what of the dataset was chosen, to stand after its coverage; empty for all of it."""
    provenance = result.provenance
    cameras, subset = provenance.get("cameras", "all"), provenance.get("subset")
    excluded = provenance.get("excluded_flags") or {}
    parts = [f"only {', '.join(map(str, cameras))}"] if isinstance(cameras, list) else []
    parts += [f"subset {subset}"] if subset is not None else []
    parts += [f"without {flag} ({count})" for flag, count in excluded.items()] if isinstance(excluded, dict) else []
    return "".join(f", {part}" for part in parts)


def short_digest(digest: str) -> str:
    """Return the beginning of a digest that tells it from others: ``sha256:`` and eight digits."""
    return digest[:15]


def cameras_of(rows: Sequence[SavedRow]) -> tuple[str, ...]:
    """Return the cameras of a table, in its order."""
    return tuple(dict.fromkeys(row.camera for row in rows if row.camera is not None))


def group_text(camera: str | None) -> str:
    """Return a camera's name, or ``all``."""
    return "all" if camera is None else camera


def factor_text(ratio: float | None) -> str:
    """Return a factor as printed: ``x100``, or ``all``."""
    return "all" if ratio is None else f"x{ratio:g}"


def value_texts(row: SavedRow) -> tuple[str, str, str]:
    """Return pairs, PSNR and SSIM as printed (:data:`VALUE_NAMES`); ``-`` where nothing was scored."""
    pairs = str(row.pairs) if row.scored == row.pairs else f"{row.scored} of {row.pairs}"
    return (pairs, f"{row.psnr_db:.2f}", f"{row.ssim:.3f}") if row.scored else (pairs, "-", "-")
