"""The errors of ``capture``, in the manner of :mod:`eldata.errors`: what, expected, found, what to do.

Those of a tethered session stop it, and the same command goes on.
"""

from __future__ import annotations

from eldata.errors import EldataError


class CameraError(EldataError):
    """A camera description is malformed, or asked for what the camera does not have."""


class PlanError(EldataError):
    """A capture plan is malformed, or cannot be changed as asked."""


class ImpossibleShotError(PlanError):
    """A shot needs an exposure time that the camera does not have; the message says what to change, computed."""


class MappingError(EldataError):
    """Files cannot be matched to a plan, or a mapping of them is malformed."""


class TetherError(EldataError):
    """A tethered session cannot start or go on; what was taken so far is safe, and the same command goes on."""


class GphotoError(TetherError):
    """The program gphoto2 failed.

    Attributes
    ----------
    output
        What it wrote, for those who look for more.
    """

    def __init__(self, message: str, output: str = "") -> None:
        super().__init__(message)
        self.output = output


class CameraLostError(GphotoError):
    """The camera does not answer: unplugged, off, asleep, taken by another program, or hanging."""


class JournalError(TetherError):
    """The journal of a session cannot be read or written, or belongs to another plan."""
