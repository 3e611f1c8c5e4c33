"""The errors of getting files: each says what to do next."""

from __future__ import annotations

from eldata.errors import EldataError, FileError


class DownloadError(EldataError):
    """A file cannot be fetched or written; what has come so far is kept unless the message says otherwise."""


class ArchiveError(FileError):
    """An archive is damaged, unsafe to unpack, or another one than was asked for."""
