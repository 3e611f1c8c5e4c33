"""The errors of ``capture``, like those of :mod:`eldata.errors`: what, expected, found, what to do."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class CameraError(EldataError):
    """A camera description is malformed, or asks for what the camera does not have."""


class PlanError(EldataError):
    """A capture plan is malformed, or cannot be changed as asked."""


class ImpossibleShotError(PlanError):
    """A shot needs an exposure time that the camera does not have; the message says what to change, computed."""


class MappingError(EldataError):
    """Files cannot be matched to a plan, or a mapping of them is malformed."""


@contextmanager
def naming(path: Path | str, kind: type[EldataError]) -> Iterator[None]:
    """Turn every error from inside into one of this kind that begins with the file's name."""
    try:
        yield
    except EldataError as error:
        if isinstance(error, kind) and str(error).startswith(str(path)):
            raise
        raise kind(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
