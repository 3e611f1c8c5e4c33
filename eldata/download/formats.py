"""Telling archives by their first bytes, and naming what was saved in place of one."""

from __future__ import annotations

from typing import Literal

Format = Literal["zip", "7z", "tar"]

# Enough to see the mark of a tar file, at byte 257.
HEAD_BYTES = 512

SUFFIXES = (".zip", ".7z", ".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")

_MARKS: tuple[tuple[bytes, Format], ...] = (
    (b"PK\x03\x04", "zip"),
    (b"PK\x05\x06", "zip"),  # an empty one
    (b"7z\xbc\xaf\x27\x1c", "7z"),
    (b"\x1f\x8b", "tar"),
    (b"BZh", "tar"),
    (b"\xfd7zXZ\x00", "tar"),
)


def archive_format(head: bytes) -> Format | None:
    """Return an archive's format by its first ``HEAD_BYTES`` bytes, ``None`` if they are not an archive's."""
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name
    return "tar" if head[257:262] == b"ustar" else None


def looks_like(head: bytes) -> str:
    """Say what the first bytes of a file that is no archive look like."""
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype", b"<html", b"<head", b"<?xml", b"<!--")):
        return "a web page, as Google Drive sends when it asks for a confirmation or a login"
    if head.startswith(b"Rar!"):
        return "a RAR archive; unpack it with unrar or 7z"
    if not head.strip(b"\0"):
        return "nothing but zeros" if head else "an empty file"
    return f"no archive; it starts with {head[:8]!r}"
