"""The errors of tethered capture: what stops a session, and what to do before it goes on."""

from __future__ import annotations

from eldata.errors import EldataError


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
