"""The errors of ``capture``, like those of :mod:`eldata.errors`: what, expected, found, what to do.

Those of a tethered session stop it, and the same command resumes it.
"""

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


class TetherError(EldataError):
    """A tethered session cannot start or go on; what was taken so far is safe, and the same command resumes it."""


class GphotoError(TetherError):
    """The program gphoto2 failed.

    Attributes
    ----------
    output
        What it wrote, for those who need the details.
    """

    def __init__(self, message: str, output: str = "") -> None:
        super().__init__(message)
        self.output = output


class CameraLostError(GphotoError):
    """The camera does not answer: unplugged, off, asleep, taken by another program, or hanging."""


class JournalError(TetherError):
    """The journal of a session cannot be read or written, or belongs to another plan."""


@contextmanager
def naming(path: Path | str, kind: type[EldataError]) -> Iterator[None]:
    """Turn every error from inside into one of this kind that begins with the file's name."""
    try:
        yield
    except EldataError as error:
        if isinstance(error, kind) and str(error).startswith(str(path)):
            raise
        raise kind(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
