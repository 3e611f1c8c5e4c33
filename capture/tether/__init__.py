"""Tethered capture through the program ``gphoto2``: a plan shot by the computer, and resumed after any accident."""

from capture.capture_errors import CameraLostError, GphotoError, JournalError, TetherError
from capture.tether.gphoto import Gphoto
from capture.tether.journal import Journal
from capture.tether.session import Outcome, run_session
from capture.tether.stages import Stage, commands, stages_of

__all__ = [
    "CameraLostError",
    "Gphoto",
    "GphotoError",
    "Journal",
    "JournalError",
    "Outcome",
    "Stage",
    "TetherError",
    "commands",
    "run_session",
    "stages_of",
]
