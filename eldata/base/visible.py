"""Values and names of strangers as messages show them: short, on one line, with all characters seen.

An escape sequence in a file's name repaints the screen, and a mark that turns the direction of writing makes
``gpj.exe`` of ``exe.jpg``.
"""

from __future__ import annotations

import json
import re
import reprlib
from typing import Final

# Unicode's control characters (C0, DEL, C1), its line and paragraph separators, what it calls Bidi_Control, and
# surrogates, by which Python stands for bytes that are not UTF-8.
_UNSEEN: Final = "\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff"
_IN_TEXT: Final = re.compile(f"[{_UNSEEN}]")
_IN_LINE: Final = re.compile(f"[{_UNSEEN}\t\n]")


def has_unseen(text: str, *, lines: bool = False) -> bool:
    """Tell whether a text has characters that do not show; with ``lines``, it may have tabs and several lines."""
    return (_IN_TEXT if lines else _IN_LINE).search(text) is not None


def visible(text: str) -> str:
    r"""Return a text with each character that does not show as its number, such as ``\x1b``; lines and tabs stay."""
    return _IN_TEXT.sub(_write_number, text)


def in_line(text: str) -> str:
    """Return a text as one line, with each character that does not show, line ends and tabs too, as its number."""
    return _IN_LINE.sub(_write_number, text)


def _write_number(character: re.Match[str]) -> str:
    """Write a character as Python does: its short escape, or else its number."""
    return repr(character[0])[1:-1]


_LONGEST_SHOWN: Final = 80
NOTHING: Final = object()
"""Stands for a field that is not there."""

_REPR: Final = reprlib.Repr()
_REPR.maxlevel, _REPR.maxlist, _REPR.maxdict = 2, 6, 4


def shown(value: object, longest: int = _LONGEST_SHOWN) -> str:
    """Return a value as a message shows it: on one line, and short."""
    if value is NOTHING:
        return "nothing"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    try:
        text = repr(value[:longest]) if isinstance(value, str) else _REPR.repr(value)
    except ValueError:  # Python refuses to write out the largest whole numbers
        return "a number of thousands of digits"
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def named_field(name: str) -> str:
    """Return a field's name as a message shows it."""
    return name if name.isprintable() and len(name) <= _LONGEST_SHOWN else shown(name)


def name_of(maker: object) -> str:
    """Name a callable: a function by its name, an object by its repr."""
    return str(getattr(maker, "__qualname__", None) or repr(maker))
