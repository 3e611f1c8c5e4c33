"""The kinds of measures of scenes: their limits, where these come from, and what to do beyond them."""

from __future__ import annotations

from typing import Final

from capture.check.limits import (
    LIGHT_AGAIN,
    LIGHT_LOOK,
    LIGHT_SOURCE,
    RATIO_LOOK,
    SHIFT_AGAIN_PX,
    SHIFT_LOOK_PX,
    SHIFT_SOURCE,
)
from capture.check.measures import MeasureKind

_INFINITE: Final = float("inf")
DRIFT: Final = MeasureKind(
    "drift",
    "%",
    100 * LIGHT_LOOK,
    100 * LIGHT_AGAIN,
    LIGHT_SOURCE,
    "the light changed: let lamps warm up, shut out daylight, keep the aperture fixed",
)
FLICKER: Final = MeasureKind(
    "flicker",
    "%",
    100 * 2**0.5 * LIGHT_LOOK,
    100 * 2**0.5 * LIGHT_AGAIN,
    "as for drift; a wave's root mean square is its amplitude over the square root of 2",
    "the lamp flickers: use daylight, a lamp on batteries or direct current, or no exposures below 1/50 s",
)
SHIFT: Final = MeasureKind(
    "shift",
    "px",
    SHIFT_LOOK_PX,
    SHIFT_AGAIN_PX,
    SHIFT_SOURCE,
    "the camera moved: fix tripod and head, use a remote release, do not touch lens or focus",
)
# From one moment of a sequence to the next, whose pairs do not share a reference: what matters is what a denoiser of
# video takes from one frame for the other.
_OF_NEIGHBOURS: Final = "for a denoiser that takes what rests from the moment before: "
MOMENT_DRIFT: Final = MeasureKind(
    "moment drift",
    "%",
    100 * LIGHT_LOOK,
    100 * LIGHT_AGAIN,
    _OF_NEIGHBOURS + LIGHT_SOURCE,
    "the light changed between the moments: let lamps warm up, shut out daylight, leave exposure and aperture alone; "
    "take the sequence again",
)
MOMENT_SHIFT: Final = MeasureKind(
    "moment shift",
    "px",
    SHIFT_LOOK_PX,
    SHIFT_AGAIN_PX,
    _OF_NEIGHBOURS + SHIFT_SOURCE,
    "the camera moved between the moments, or what moves fills half of the picture: lock tripod and head, and let more "
    "rest; take the sequence again",
)
MOVEMENT: Final = MeasureKind(
    "movement",
    "%",
    0.1,
    _INFINITE,
    "practical: one part in a thousand of the picture; what moved may not matter, so look",
    "something in the scene moved, or a shadow on it: look at the picture of differences",
)
FOCUS: Final = MeasureKind(
    "focus",
    "%",
    3.0,
    10.0,
    "the contrast of detail of 5 to 20 pixels; a Gaussian blur of 0.5 pixels takes 3 to 5 %, one of 1 pixel 10 to 20 %",
    "the focus changed: focus by hand, switch autofocus and stabiliser off, fix the ring with tape",
)
CLIPPED: Final = MeasureKind(
    "clipped",
    "%",
    0.5,
    5.0,
    "highlights and lamps clip in any scene; scores leave saturated pixels out, and a twentieth of the picture is too "
    "much to leave out",
    "expose the references less (and plan the scene again), or shade the highlights",
)
BRIGHTNESS: Final = MeasureKind(
    "brightness",
    "%",
    90.0,
    _INFINITE,
    "below a tenth of the range, a frame at x200 has too little signal",
    "underexposed: meter the scene again, for a longer time",
    expected=100.0,
)
MATCH: Final = MeasureKind(
    "match",
    "%",
    10.0,
    50.0,
    "practical: 100 % but for noise in aligned frames, about 0 between scenes; halfway between, shoot again",
    "another scene, or something moved: is the file in its place?",
    expected=100.0,
)
FINE_NOISE: Final = MeasureKind(
    "fine noise",
    "%",
    15.0,
    50.0,
    "practical: 100 % for a sensor's white noise; the mean of two neighbours of a colour leaves 57 %",
    "the camera smoothed the noise: switch noise reduction and lens corrections off, take uncompressed raw",
    expected=100.0,
)
GAPS: Final = MeasureKind(
    "gaps",
    "%",
    10.0,
    45.0,
    "values that never occur; a bit too few leaves half of them out, two bits three quarters",
    "fewer bits than the file has room for: take 14-bit raw, no burst, no silent or compressed mode",
)
SIGNAL: Final = MeasureKind(
    "signal",
    "%",
    100 * RATIO_LOOK,
    50.0,
    "the tolerance of eldata verify; to shoot again: half of the signal is missing",
    "no light, or far too little: was the lens capped, the exposure right?",
    expected=100.0,
)
