"""Changes to text: tokens of JSON, TOML and CSV, numbers without an end, escape sequences, encodings."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from random import Random

_TOKEN = re.compile(rb'"(?:[^"\\\n]|\\.)*"|-?[0-9][0-9.eE+/-]*|[\w.-]+|[][{}(),:;=]|\n')
_NUMBERS = (
    *(b"1e16000000", b"9" * 10_000, b"1/" + b"9" * 5_000, b"1/0", b"0", b"-1", b"-0", b"NaN", b"Infinity", b"1e400"),
    *(b"1e-400", b"0x10", b"1_000", b"01", b"1.", b".5", b"1e", b"+1", b"9" * 400, b"2147483648"),
    *(b"18446744073709551616", b"\xd9\xa3"),
)
_TEXTS = (
    *(b"\x1b[31m", b"\\u001b[2J", b"\xc2\x9b0m", b"\xe2\x80\xae", b"\\u202e", b"\\u0000", b"\x00", b"\\ud800"),
    *(b"\xff\xfe", b"../../x", b"/etc/passwd", b"=1+1", b"+1", b"-1", b"@x", b"a" * 70_000, b"<script>"),
    *(b"{0.__class__}", b"%s%n", b"", b"\xef\xbb\xbf", b"\r", b"\x0b", b"\xe2\x80\xa8", b"\x85", b"~", b"CON", b"'"),
    *(b'"', b"\\", b"\xed\xa0\x80", b"1;2"),
)
_VALUES = (
    *(b"null", b"true", b"false", b"[]", b"{}", b'""', b"[" * 50_000, b'{"a":' * 20_000, b"1,", b"[1]", b"[[1]]"),
    *(b'{"a":1}',),
)


def token(data: bytes, random: Random, other: bytes) -> bytes:
    """One token replaced: a number by an endless one, a text by an escape sequence, anything by another kind."""
    spans = [found.span() for found in _TOKEN.finditer(data)]
    if not spans:
        return data
    start, stop = random.choice(spans)
    old = data[start:stop]
    if old[:1].isdigit() or old[:1] == b"-":
        new = random.choice((*_NUMBERS, random.choice(_VALUES), random.choice(_TEXTS)))
    elif old.startswith(b'"'):
        text = random.choice(_TEXTS)
        new = random.choice(
            (b'"' + text + b'"', old[:-1] + text + b'"', random.choice(_NUMBERS), random.choice(_VALUES))
        )
    else:
        new = random.choice((random.choice(_TEXTS), random.choice(_NUMBERS), random.choice(_VALUES), b""))
    return data[:start] + new + data[stop:]


def exchanged(data: bytes, random: Random, other: bytes) -> bytes:
    """Two tokens exchanged, or one repeated in another's place."""
    spans = [found.span() for found in _TOKEN.finditer(data)]
    if len(spans) < 2:
        return data
    (a, b), (c, d) = sorted(random.sample(spans, 2))
    return data[:a] + data[c:d] + data[b:c] + random.choice((data[a:b], data[c:d])) + data[d:]


def lines(data: bytes, random: Random, other: bytes) -> bytes:
    """A line left out, repeated, moved, joined with the next, or with another end."""
    held = data.splitlines(keepends=True)
    if len(held) < 2:
        return data
    at, to = random.randrange(len(held)), random.randrange(len(held))
    which = random.randrange(5)
    if which == 0:
        del held[at]
    elif which == 1:
        held[at:at] = [held[at]] * random.choice((1, 1, 2000))
    elif which == 2:
        held.insert(to, held.pop(at))
    elif which == 3:
        held[at] = held[at].rstrip(b"\r\n")
    else:
        held[at] = held[at].rstrip(b"\r\n") + random.choice((b"\r\n", b"\r", b"\n\n", b",\n", b"\x00\n"))
    return b"".join(held)


def encoded(data: bytes, random: Random, other: bytes) -> bytes:
    """The same text in another encoding, or with a byte order mark."""
    text = data.decode("utf-8", errors="replace")
    code = random.choice(("utf-16", "utf-32", "utf-8-sig", "latin-1", "cp037"))
    return text.encode(code, errors="replace")


CHANGES = (token, token, token, token, exchanged, lines)
