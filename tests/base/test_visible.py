"""Characters that do not show: which they are, how they are shown, and that no stream lets one through."""

from __future__ import annotations

import io
import sys
import unicodedata

import pytest
from tqdm import tqdm

from eldata.base.console import Screen
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


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_progress_bar_begins_its_line_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """And its name, which may be a file's, cannot do anything else."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", Screen(terminal, has_bars=True))
    with tqdm(total=3, desc="\x1b[2J\rname", disable=None, leave=False, mininterval=0) as bar:
        for _ in range(3):
            bar.update()
    text = terminal.getvalue()
    assert text.startswith("\r\\x1b[2J\\rname:   0%")
    assert text.endswith("\r")
    assert "100%" in text
    assert "\x1b" not in text
