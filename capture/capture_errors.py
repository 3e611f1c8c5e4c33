"""The errors of ``capture``; like :mod:`eldata.errors`, they say what was expected and found, and what to do."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class CaptureError(EldataError):
    """A camera description, plan or mapping is malformed, or cannot be used as asked."""


class ImpossibleShotError(CaptureError):
    """A shot needs an exposure time that the camera does not have; the message says what to change, computed."""


@contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Let every error from inside begin with the file's name."""
    try:
        yield
    except EldataError as error:
        raise CaptureError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
