"""Characters that do not show: which they are, how they are shown, and that no stream lets one through."""

from __future__ import annotations

import io
import os
import sys
import unicodedata

import pytest
from tqdm import tqdm

from eldata.base.visible import has_unseen, in_line, visible, visible_output

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


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_what_is_printed_shows_in_every_encoding(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding=encoding, errors="strict"))
    with visible_output():
        print("\x1b[2J größe ± 写真 \udcff\u202e")
        print("two\tcolumns", flush=True)
    text = written.getvalue().decode(encoding)
    assert text.startswith("\\x1b[2J ")
    assert text.endswith("\\udcff\\u202e\ntwo\tcolumns\n")
    assert ("größe" in text) == (encoding != "ascii")
    assert ("写真" in text) == (encoding == "utf-8")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.skipif(os.name != "posix", reason="colours are for POSIX terminals")
@pytest.mark.parametrize(("screen", "no_color"), [(Terminal, ""), (Terminal, "1"), (io.StringIO, "")])
def test_verdicts_have_colours_on_a_terminal(
    screen: type[io.StringIO], no_color: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Words that say how a line is, and only there; an escape that a name brings is shown, and colours nothing."""
    monkeypatch.setenv("NO_COLOR", no_color)
    monkeypatch.setattr(sys, "stdout", written := screen())
    with visible_output():
        print("a: all well\nb: 2 problems\nnote: keep, they say\n    to do     take\n\x1b[31mSUSPECT: c", end="")
    expected = "a: [32mall well[0m\nb: [31m2 problems[0m\n[33mnote[0m: keep, they say\n[33m    to do[0m     take"
    is_plain = screen is io.StringIO or no_color
    for code in ("[32m", "[31m", "[33m", "[0m"):
        expected = expected.replace(code, "" if is_plain else f"\x1b{code}")
    assert written.getvalue() == expected + "\n\\x1b[31mSUSPECT: c"


def test_a_progress_bar_begins_its_line_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """And its name, which may be a file's, cannot do anything else."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with visible_output(), tqdm(total=3, desc="\x1b[2J\rname", disable=None, leave=False, mininterval=0) as bar:
        for _ in range(3):
            bar.update()
    text = terminal.getvalue()
    assert text.startswith("\r\\x1b[2J\\rname:   0%")
    assert text.endswith("\r")
    assert "100%" in text
    assert "\x1b" not in text


def test_a_full_disk_behind_a_stream_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:  # noqa: PTH123 # as a shell's redirection
        monkeypatch.setattr(sys, "stdout", full)
        with visible_output(), pytest.raises(OSError, match="No space left on device") as caught:  # noqa: PT012
            print("x")
            sys.stdout.flush()
        monkeypatch.undo()
        assert caught.value.filename == "cannot write to standard output"
        # Or closing would try again.
        full.truncate = None  # type: ignore[method-assign,assignment]
        with pytest.raises(OSError, match="No space"):
            full.close()


def test_streams_that_are_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    with visible_output():
        print("x")
        assert sys.stdout is None
