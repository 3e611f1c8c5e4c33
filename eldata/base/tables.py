"""Tables: aligned plain text, Markdown, LaTeX, CSV and a notebook's HTML, from the same header and rows of texts."""

from __future__ import annotations

import base64
import csv
import html
import io
import math
import re
import textwrap
from dataclasses import asdict
from fractions import Fraction
from typing import TYPE_CHECKING, Final, Literal

from eldata.base.visible import in_line

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    import pandas as pd
    from _typeshed import DataclassInstance

Format = Literal["text", "markdown", "latex"]
FORMATS: Final[tuple[Format, ...]] = ("text", "markdown", "latex")
_LINE = 80  # characters of a line of text, as wide as a terminal


class Strong(str):
    """A cell that Markdown and LaTeX set in bold; plain text shows it as it is."""

    __slots__ = ()


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> str:
    """Return lines of aligned columns: columns ``left`` to the left, the others to the right."""
    header, *rows = ([in_line(cell) for cell in row] for row in (header, *rows))
    widths = [max(len(cell) for cell in column) for column in zip(header, *rows, strict=True)]
    cells = (header, ["-" * width for width in widths], *rows)
    return "\n".join("  ".join(_pad_cells(row, widths, left)).rstrip() for row in cells)


def _pad_cells(cells: Sequence[str], widths: Sequence[int], left: Collection[int]) -> list[str]:
    """Pad a row's cells to the widths of their columns; columns ``left`` to the left."""
    return [
        cell.ljust(width) if index in left else cell.rjust(width)
        for index, (cell, width) in enumerate(zip(cells, widths, strict=True))
    ]


def wrapped(text: str, indent: str = "    ") -> list[str]:
    """Return a text's lines of at most 80 characters, all but the first behind ``indent``.

    Paths, addresses and options are for copying: they stay whole.
    """
    return textwrap.wrap(text, _LINE, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


# --- Markdown -----------------------------------------------------------------------------------------------------

_MARKDOWN_SPECIAL = re.compile(r"([\\`*_{}\[\]<>|~&$])")


def markdown_text(text: str) -> str:
    """Return text that Markdown shows as it is, in one line: its special characters are escaped."""
    return _MARKDOWN_SPECIAL.sub(r"\\\1", one_line(text))


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> str:
    """Return a table of GitHub's Markdown, its lines aligned; columns ``left`` to the left, the others to the right.

    Texts are escaped; a :class:`Strong` cell is bold.
    """
    return aligned_markdown([[_markdown_cell(cell) for cell in row] for row in (header, *rows)], left)


def aligned_markdown(cells: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> str:
    """Return a table like :func:`markdown_table`, of cells that are Markdown already; the first row is the header."""
    widths = [max(3, *(len(cell) for cell in column)) for column in zip(*cells, strict=True)]
    ruler = ["-" * width if index in left else "-" * (width - 1) + ":" for index, width in enumerate(widths)]
    header, *rows = (_pad_cells(row, widths, left) for row in cells)
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, ruler, *rows))


def _markdown_cell(cell: str) -> str:
    """Escape a cell for Markdown; bold if it is :class:`Strong`."""
    text = markdown_text(cell)
    return f"**{text}**" if isinstance(cell, Strong) and text else text


# --- LaTeX --------------------------------------------------------------------------------------------------------

_LATEX = {sign: f"\\{sign}" for sign in "{}$&%#_"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "[": "{[}",  # after a line's end, "\\[" would be the optional argument of the break
    "]": "{]}",
    "×": r"$\times$",
    "±": r"$\pm$",
    "−": "$-$",
    "Δ": r"$\Delta$",
    "–": "--",
    "…": r"\dots{}",
}


def latex_text(text: str) -> str:
    """Return text that LaTeX prints as it is, in one line: its special characters are escaped."""
    return "".join(_LATEX.get(character, character) for character in one_line(text))


def latex_table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    left: Collection[int] = (0,),
    *,
    caption: str,
    label: str,
    rules: Collection[int] = (),
) -> str:
    r"""Return a ``table`` with the rules of the package booktabs.

    Parameters
    ----------
    header, rows, left
        As for :func:`text_table`. Texts are escaped; a :class:`Strong` cell is bold.
    caption
        The caption's text, which is escaped.
    label
        What ``\ref`` calls it; letters, digits, ``:`` and ``-``, anything else becomes ``-``.
    rules
        Indices of rows that have a line above them.
    """
    columns = "".join("l" if index in left else "r" for index in range(len(header)))
    lines = [
        "% needs \\usepackage{booktabs}",
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex_text(caption)}}}",
        rf"\label{{{re.sub(r'[^A-Za-z0-9:-]+', '-', label)}}}",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        _latex_row(header),
        r"\midrule",
    ]
    for index, row in enumerate(rows):
        if index in rules:
            lines.append(r"\midrule")
        lines.append(_latex_row(row))
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}"])


def _latex_row(row: Sequence[str]) -> str:
    """Format one row of a LaTeX table, its cells escaped."""
    return f"{' & '.join(_latex_cell(cell) for cell in row)} \\\\"


def _latex_cell(cell: str) -> str:
    """Escape a cell for LaTeX; bold if it is :class:`Strong`."""
    # A hyphen before a number is meant as a minus sign.
    text = latex_text(re.sub(r"(?<![\w.)-])-(?=\.?\d)", "−", cell))
    return rf"\textbf{{{text}}}" if isinstance(cell, Strong) and text else text


def one_line(text: str) -> str:
    """Return text without line ends and other control characters."""
    return " ".join("".join(character if character.isprintable() else " " for character in text).split())


# --- CSV ------------------------------------------------------------------------------------------------------------


# What makes a spreadsheet take a cell for a formula (OWASP, "CSV Injection"), after any apostrophes.
_FORMULA: Final = re.compile(r"'*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")


def cell_of_text(text: str) -> str:
    """Return a text as a cell that no spreadsheet runs as a formula: an apostrophe goes before such a one.

    :func:`text_of_cell` undoes it: one apostrophe is taken from any cell in which apostrophes stand before such a sign.
    Texts that begin with an apostrophe and go on otherwise stay as they are.
    """
    return f"'{text}" if _FORMULA.match(text) else text


def text_of_cell(cell: str) -> str:
    """Return the text that :func:`cell_of_text` made a cell of; a formula that nobody quoted is that text."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a CSV file: texts by :func:`cell_of_text`, numbers as they are, ``None`` as an empty cell."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([cell_of_text(cell) if isinstance(cell, str) else cell for cell in row] for row in rows)
    return text.getvalue()


# --- records ------------------------------------------------------------------------------------------------------


def frame_of(records: Iterable[DataclassInstance]) -> pd.DataFrame:
    """Return records as a pandas DataFrame, one row per record, fractions as floats."""
    import pandas as pd

    rows = [
        {key: float(value) if isinstance(value, Fraction) else value for key, value in asdict(record).items()}
        for record in records
    ]
    return pd.DataFrame(rows)


# --- numbers ------------------------------------------------------------------------------------------------------


def with_error(value: float, error: float) -> str:
    """Return ``value ± error`` with its significant digits: two of the error up to 0.29, one from 0.3 on.

    A value without a standard error (nan, infinite, 0) stands alone with five digits.
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:.5g}"
    places = max(0, math.ceil(-math.log10(error / 3)))
    return f"{round(value, places) + 0.0:.{places}f} ± {error:.{places}f}"


# --- in a notebook ----------------------------------------------------------------------------------------------------

# Plain elements, which a notebook's own style sheet shows on light and dark pages: no script, nothing from the network,
# every text escaped, with only characters that show.
ROWS_SHOWN: Final = 60


def block(heading: str, *parts: str, notes: Sequence[str] = ()) -> str:
    """Format a heading in HTML, with tables and pictures (HTML) and then notes (texts) below it."""
    shown = "".join(f"<p>{escape(note)}</p>" for note in notes[:ROWS_SHOWN])
    return f"<div><p><b>{escape(heading)}</b></p>{''.join(parts)}{shown}{_count_more(len(notes))}</div>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> str:
    """Return a table; columns ``left`` to the left, the others to the right; of many rows the first, and a count.

    An empty header is left out.
    """

    def format_row(texts: Sequence[str], kind: str) -> str:
        sides = ("left" if index in left else "right" for index in range(len(texts)))
        styled = zip(texts, sides, strict=True)
        cells = (f'<{kind} style="text-align: {side}">{escape(text)}</{kind}>' for text, side in styled)
        return f"<tr>{''.join(cells)}</tr>"

    head = f"<thead>{format_row(header, 'th')}</thead>" if header else ""
    body = "".join(format_row(row, "td") for row in rows[:ROWS_SHOWN])
    return f"<table>{head}<tbody>{body}</tbody></table>{_count_more(len(rows))}"


def picture(jpeg: bytes, alt: str) -> str:
    """Return a JPEG in the page itself, described in words by its caption."""
    data = base64.b64encode(jpeg).decode("ascii")
    source, text = f"data:image/jpeg;base64,{data}", escape(alt)
    caption = f"<figcaption>{text}</figcaption>"
    return f'<figure style="display: inline-block"><img src="{source}" alt="{text}">{caption}</figure>'


def escape(text: str) -> str:
    """Escape a text for HTML, in one line."""
    return html.escape(in_line(text))


def _count_more(count: int) -> str:
    """Format a paragraph with the number of rows that are not shown; empty if all are."""
    return f"<p>… and {count - ROWS_SHOWN} more</p>" if count > ROWS_SHOWN else ""
