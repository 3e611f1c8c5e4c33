"""Characters that nobody sees or that steer a terminal: found, and shown by their numbers on all that is printed.

File names and metadata come from strangers: an escape sequence in one repaints the screen, a mark that turns the
direction of writing makes ``gpj.exe`` of ``exe.jpg``, and a byte that is not UTF-8 cannot be printed at all.
"""

from __future__ import annotations

import io
import json
import os
import re
import reprlib
import sys
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import TYPE_CHECKING, Any, Final, TextIO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

# Unicode's control characters (C0, DEL, C1), its line and paragraph separators, what it calls Bidi_Control, and
# surrogates, by which Python stands for bytes that are not UTF-8.
_UNSEEN: Final = "\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff"
_IN_TEXT: Final = re.compile(f"[{_UNSEEN}]")
_IN_LINE: Final = re.compile(f"[{_UNSEEN}\t\n]")
_SHORT: Final = {"\t": "\\t", "\n": "\\n", "\r": "\\r"}

# Words that begin or end a line and say how it is, and their colours on a terminal: red, yellow and green.
_VERDICT: Final = re.compile(
    r"^(?:SUSPECT|missing|repeated|ambiguous|metered|note|not scored|look|shoot again)(?=:)|^ +to do(?=  )"
    r"|(?<=: )(?:all well|\d+ problems?|keep|look|shoot again)$",
    re.MULTILINE,
)
_GOOD: Final = ("all well", "keep")
_BAD: Final = ("SUSPECT", "missing", "shoot again")


def has_unseen(text: str, *, lines: bool = False) -> bool:
    """Return whether a text has characters that do not show; with ``lines``, it may have tabs and several lines."""
    return (_IN_TEXT if lines else _IN_LINE).search(text) is not None


def visible(text: str) -> str:
    r"""Return a text with each character that does not show as its number, such as ``\x1b``; lines and tabs stay."""
    return _IN_TEXT.sub(_number, text)


def in_line(text: str) -> str:
    """Return a text as one line, with each character that does not show, line ends and tabs too, as its number."""
    return _IN_LINE.sub(_number, text)


def _number(found: re.Match[str]) -> str:
    character = found[0]
    code = ord(character)
    return _SHORT.get(character) or (f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}")


_LONGEST_SHOWN: Final = 80
NOTHING: Final = object()
"""Stands for a field that is not there."""

_REPR: Final = reprlib.Repr()
_REPR.maxlevel, _REPR.maxlist, _REPR.maxdict = 2, 6, 4


def shown(found: object, longest: int = _LONGEST_SHOWN) -> str:
    """Return a value as a message shows it: on one line, and short."""
    if found is NOTHING:
        return "nothing"
    if found is None or isinstance(found, bool):
        return json.dumps(found)
    try:
        text = repr(found[:longest]) if isinstance(found, str) else _REPR.repr(found)
    except ValueError:  # Python refuses to write out the largest whole numbers
        return "a number of thousands of digits"
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def named_field(name: str) -> str:
    """Return a field's name as a message shows it."""
    return name if name.isprintable() and len(name) <= _LONGEST_SHOWN else shown(name)


@contextmanager
def visible_output() -> Iterator[None]:
    """Print nothing to standard output and standard error but what shows, in an encoding that they have."""
    with (
        redirect_stdout(_screen(sys.stdout, "standard output")),
        redirect_stderr(_screen(sys.stderr, "standard error")),
    ):
        yield


def _screen(stream: TextIO | None, name: str) -> Any:
    return stream if stream is None or isinstance(stream, _Screen) else _Screen(stream, name)


def _coloured(found: re.Match[str]) -> str:
    word = found[0]
    colour = 32 if word in _GOOD else 31 if word in _BAD or "problem" in word else 33
    return f"\x1b[{colour}m{word}\x1b[0m"


class _Screen(io.TextIOBase):
    """A stream that shows what would not be seen, and names itself where it cannot be written to.

    On a terminal, words of verdict have colours, unless ``NO_COLOR`` is set (https://no-color.org).
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        self._stream = stream
        self._name = name
        self._has_colours = os.name == "posix" and stream.isatty() and not os.environ.get("NO_COLOR")

    def write(self, text: str) -> int:
        # Progress bars begin again at the line's start: the only use of standard error for that.
        start = "\r" if text.startswith("\r") and self._name == "standard error" else ""
        shown = visible(text[len(start) :])
        if not shown.isascii():
            encoding = self.encoding
            shown = shown.encode(encoding, "backslashreplace").decode(encoding)
        if self._has_colours:
            shown = _VERDICT.sub(_coloured, shown)
        self._named(lambda: self._stream.write(start + shown))
        return len(text)

    def flush(self) -> None:
        self._named(self._stream.flush)

    def _named(self, call: Callable[[], object]) -> None:
        try:
            call()
        except OSError as error:
            raise OSError(error.errno, error.strerror, f"cannot write to {self._name}") from error

    @property
    def encoding(self) -> str:  # type: ignore[override] # a stream's own is writable, and nobody writes it
        return getattr(self._stream, "encoding", None) or "utf-8"

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        return self._stream.errors

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()

    def writable(self) -> bool:
        return True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
