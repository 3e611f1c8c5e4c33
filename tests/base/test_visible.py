"""Characters that do not show: which they are, and how they are shown."""

from __future__ import annotations

import sys
import unicodedata

import pytest

from eldata.base.visible import has_unseen, in_line, visible

# Unicode 15's list of characters with the property Bidi_Control (PropList.txt).
BIDI_CONTROL = "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"


def test_which_characters_do_not_show() -> None:
    """Every code point, against Unicode's own categories: controls, surrogates, separators of lines and paragraphs."""
    for code in range(sys.maxunicode + 1):
        character = chr(code)
        unseen = unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") or character in BIDI_CONTROL
        assert has_unseen(character) == unseen, hex(code)
        assert has_unseen(character, lines=True) == (unseen and character not in "\n\t"), hex(code)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain, größe, 写真", "plain, größe, 写真"),
        ("\x1b[31m", "\\x1b[31m"),
        ("\x9b31m\x7f", "\\x9b31m\\x7f"),
        ("exe.\u202egpj", "exe.\\u202egpj"),
        ("a\u2028b", "a\\u2028b"),
        ("\udcff", "\\udcff"),
        ("a\rb", "a\\rb"),
    ],
)
def test_how_they_are_shown(text: str, shown: str) -> None:
    assert visible(text) == in_line(text) == shown
    assert visible(f"{text}\n\t") == f"{shown}\n\t"
    assert in_line(f"{text}\n\t") == f"{shown}\\n\\t"
