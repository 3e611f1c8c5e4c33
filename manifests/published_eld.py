"""The published ELD set: its cameras and its rows.

Sources: see :mod:`eldata.manifest.layouts`.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.manifest.layouts import EldCamera, eld_records

if TYPE_CHECKING:
    from eldata.records import FrameRecord

_SCENES = tuple(range(1, 11))
_CAMERAS = (
    # All EXIF ratios of the Sony frames are exact, its references 4 s, in scene 2 3.2 s (PMN, ELD_SonyA7S2.info).
    EldCamera("SonyA7S2", ".ARW", 100, {scene: Fraction(16, 5) if scene == 2 else Fraction(4) for scene in _SCENES}),
    EldCamera("NikonD850", ".nef", 100),
    # The Canon references' ISO is called "base ISO" only.
    EldCamera("CanonEOS70D", ".CR2"),
    EldCamera("CanonEOS700D", ".CR2"),
)


def published_eld_records() -> tuple[FrameRecord, ...]:
    """Return the rows of the set: 4 cameras, 10 scenes, 16 frames each."""
    return eld_records(_CAMERAS, _SCENES, {"NikonD850/scene-1/IMG_0012.nef": ("inexact-ratio",)})
