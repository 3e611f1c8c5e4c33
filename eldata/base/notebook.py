"""How records show in a notebook: a heading, tables and small pictures, in HTML that fits a light and a dark page.

Colours are the notebook's own, lines half transparent. They have neither script nor style sheet, nothing comes from the
network, and every text is escaped, with only characters that show.
"""

from __future__ import annotations

import base64
import html
from typing import TYPE_CHECKING, Final

from eldata.base.visible import in_line

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

ROWS_SHOWN: Final = 60

_LINE: Final = "1px solid rgba(128, 128, 128, 0.4)"
_CELL: Final = "padding: 2px 10px; color: inherit; background: none"


def block(heading: str, *parts: str, notes: Sequence[str] = ()) -> str:
    """Return a heading with what stands under it: tables and pictures, which are HTML, then notes, which are texts."""
    shown = "".join(f'<p style="margin: 4px 0; max-width: 60em">{escaped(note)}</p>' for note in notes[:ROWS_SHOWN])
    more = _more(len(notes))
    head = f'<p style="margin: 4px 0"><b>{escaped(heading)}</b></p>'
    return f'<div style="color: inherit">{head}{"".join(parts)}{shown}{more}</div>'


def table(header: Sequence[str], rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> str:
    """Return a table; columns ``left`` to the left, the others to the right; of many rows the first, and a count.

    An empty header is left out.
    """

    def cells(texts: Sequence[str], kind: str, line: str) -> str:
        sides = ("left" if index in left else "right" for index in range(len(texts)))
        return "".join(
            f'<{kind} style="{_CELL}; text-align: {side}; {line}">{escaped(text)}</{kind}>'
            for text, side in zip(texts, sides, strict=True)
        )

    head = f"<thead><tr>{cells(header, 'th', f'border-bottom: {_LINE}')}</tr></thead>" if header else ""
    body = "".join(f'<tr style="background: none">{cells(row, "td", "border: none")}</tr>' for row in rows[:ROWS_SHOWN])
    style = "border-collapse: collapse; margin: 4px 0; color: inherit"
    return f'<table style="{style}">{head}<tbody>{body}</tbody></table>{_more(len(rows))}'


def facts(rows: Sequence[tuple[str, str]]) -> str:
    """Return a table of names and values."""
    return table((), rows, left=(0, 1))


def picture(jpeg: bytes, alt: str) -> str:
    """Return a JPEG as it is, in the page, with what it shows in words as its caption."""
    data = base64.b64encode(jpeg).decode("ascii")
    return (
        '<figure style="display: inline-block; margin: 4px 10px 4px 0">'
        f'<img src="data:image/jpeg;base64,{data}" alt="{escaped(alt)}">'
        f'<figcaption style="font-size: 90%">{escaped(alt)}</figcaption></figure>'
    )


def escaped(text: str) -> str:
    """Return a text as HTML shows it, in one line."""
    return html.escape(in_line(text))


def _more(count: int) -> str:
    return f'<p style="margin: 4px 0">… and {count - ROWS_SHOWN} more</p>' if count > ROWS_SHOWN else ""
