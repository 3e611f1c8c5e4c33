"""Which calibration frames to take: bias frames, and flat-field frames in pairs, for each ISO.

The recipe and where it comes from:

- Bias frames: no light, lens capped in a dark room, the shortest exposure that there is (Wei, Fu, Zheng and Yang, TPAMI
  2021, section 3.2.1). Ten per ISO: the noise's shape needs some, and from six on one is kept out to test the result
  (docs/calibration.md). The paper gives no number; EMVA 1288 takes two dark frames per exposure time, which is enough
  for a variance but not for a distribution.
- Flats: white paper on an evenly lit wall, close, the lens at infinity (the same section). Two of each exposure, one
  after the other, since the difference of two equal frames is free of shading and fixed pattern (EMVA 1288). Six levels
  from a tenth to nine tenths of the range (docs/calibration.md: four to eight; EMVA 1288 asks for many more, to test
  linearity, where we want a slope).
- A warm sensor: bias frames once more after the shooting, since black follows the temperature.
- ISOs: full stops from the base ISO to the highest noisy one, since a camera with two conversion gains changes its
  noise at one of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from capture.capture_errors import ImpossibleShotError, PlanError
from capture.shots import Shot
from capture.shutter import ExactNumber, as_exact

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capture.camera import CameraDescription
    from capture.protocol import CaptureProtocol
    from capture.shutter import ShutterTime

BIAS_FRAMES: Final = 10
LEAST_BIAS_FRAMES: Final = 4  # below, eldata calibrate refuses
_MOST_FRAMES: Final = 999  # more is a slip of the keys, and would be planned until memory ends
WARM: Final = "warm"
FRAMES_PER_LEVEL: Final = 2
_NAME_STOPS: Final = 0.1  # by which an ISO's name may lie off a full stop: neighbours are a third of a stop apart
_NEAR_STOPS: Final = 0.5
# Wanted mean of the flats over the range above black. Their distances stay above half a stop, so that rounding down to
# thirds or halves of a stop leaves them apart.
FLAT_LEVELS: Final = tuple(Fraction(text) for text in ("1/10", "1/6", "1/4", "2/5", "3/5", "9/10"))


@dataclass(frozen=True, slots=True)
class CalibrationPlan:
    """The calibration frames to take.

    Attributes
    ----------
    isos
        Rising.
    bias_frames
        Number of bias frames at each ISO.
    flat_levels
        Wanted means of the flats, as shares of the range over black; two frames of each.
    flat_clips_at_s
        Exposure time at the base ISO from which the evenly lit surface clips.
    shots
        Bias frames of all ISOs, then, cap off, the flats of all ISOs by rising exposure.
    remarks
        What the plan had to leave out.
    warm
        Whether bias frames are taken once more, with the sensor warm from the shooting.
    """

    isos: tuple[int, ...]
    bias_frames: int
    flat_levels: tuple[Fraction, ...]
    flat_clips_at_s: Fraction
    shots: tuple[Shot, ...]
    remarks: tuple[str, ...] = ()
    warm: bool = False


def default_isos(camera: CameraDescription, protocol: CaptureProtocol) -> tuple[int, ...]:
    """Return the full stops from the base ISO to the highest noisy ISO, and the protocol's own ISOs.

    Names of ISOs are rounded: one stop above ISO 64 is ISO 125. A full stop that lies within half a stop of one of the
    protocol's ISOs tells nothing that this one does not.
    """
    used = {protocol.base_iso, *protocol.noisy_isos}
    found = set(used)
    for iso in camera.isos:
        stops = math.log2(iso / protocol.base_iso)
        full = abs(stops - round(stops)) < _NAME_STOPS and 0 < stops < math.log2(max(used) / protocol.base_iso)
        if full and all(abs(math.log2(iso / other)) > _NEAR_STOPS for other in used):
            found.add(iso)
    return tuple(sorted(found))


def plan_calibration(
    camera: CameraDescription,
    base_iso: int,
    isos: tuple[int, ...],
    flat_clips_at_s: Fraction,
    *,
    bias_frames: int = BIAS_FRAMES,
    flat_levels: tuple[Fraction, ...] = FLAT_LEVELS,
    warm: bool = False,
) -> CalibrationPlan:
    """Return the calibration frames of a camera: bias frames, flats, and bias frames with a warm sensor.

    Raises
    ------
    PlanError
        If the camera lacks an ISO or a time, or a number is out of range.
    ImpossibleShotError
        If a flat needs a time that the camera does not have; the message says what to change.

    Examples
    --------
    >>> from fractions import Fraction
    >>> from capture import plan_calibration
    >>> from capture.camera import EXAMPLE
    >>> plan = plan_calibration(EXAMPLE, 100, (800, 1600), Fraction(1, 4))
    >>> len(plan.shots), plan.shots[0].role, plan.shots[-1].role
    (44, 'bias', 'flat')
    """
    for iso in isos:
        if iso not in camera.isos:
            raise PlanError(f"{camera.name} has no ISO {iso}; it has {', '.join(map(str, camera.isos))}")
    if not isos or list(isos) != sorted(set(isos)):
        raise PlanError(f"calibration ISOs: expected one or more, rising; found {list(isos)}")
    if not LEAST_BIAS_FRAMES <= bias_frames <= _MOST_FRAMES:
        raise PlanError(f"bias frames per ISO: expected {LEAST_BIAS_FRAMES} to {_MOST_FRAMES}, found {bias_frames}")
    if (
        not flat_levels
        or list(flat_levels) != sorted(set(flat_levels))
        or not 0 < flat_levels[0] <= flat_levels[-1] < 1
    ):
        raise PlanError(
            f"flat levels: expected shares between 0 and 1, rising; found {', '.join(map(str, flat_levels))}"
        )
    shots: list[Shot] = []
    remarks: list[str] = []
    named = camera.named(flat_clips_at_s)
    clips_at = as_exact(flat_clips_at_s) if named is None else named.true_exact  # what the camera gives for it
    capped = [
        Shot(0, "bias", iso, camera.fastest.nominal_s, camera.fastest) for iso in isos for _ in range(bias_frames)
    ]
    shots += _numbered(capped, 1)
    for iso in isos:
        taken: list[Fraction] = []
        for level in flat_levels:
            target_s = flat_clips_at_s * level * Fraction(base_iso, iso)
            wanted = clips_at * level * (camera.speed(base_iso) / camera.speed(iso))
            setting = _flat_setting(camera, iso, level, wanted, flat_clips_at_s)
            if setting.nominal_s in taken:
                remarks.append(
                    f"ISO {iso}: no flats at {float(100 * level):.0f} %, which the camera's steps round to "
                    f"{setting.dial} s again"
                )
                continue
            taken.append(setting.nominal_s)
            numbers = range(len(shots) + 1, len(shots) + 1 + FRAMES_PER_LEVEL)
            shots += [Shot(n, "flat", iso, target_s, setting, level=level) for n in numbers]
    # Behind the others, which so keep their numbers when these are added to a plan that is being shot.
    if warm:
        shots += _numbered((replace(shot, series=WARM) for shot in capped), len(shots) + 1)
    return CalibrationPlan(isos, bias_frames, flat_levels, flat_clips_at_s, tuple(shots), tuple(remarks), warm)


def _numbered(shots: Iterable[Shot], first: int) -> list[Shot]:
    return [replace(shot, number=number) for number, shot in enumerate(shots, first)]


def _flat_setting(
    camera: CameraDescription, iso: int, level: Fraction, wanted: ExactNumber, clips_at_s: Fraction
) -> ShutterTime:
    what = f"the flat of {float(100 * level):.0f} % at ISO {iso} needs {float(wanted):.3g} s"
    # Rounded down, never up: a flat that clips is of no use, a darker one is.
    setting = camera.not_above(wanted)
    if setting is None or setting == camera.fastest:
        second = camera.shutter.times[min(1, len(camera.shutter.times) - 1)]
        least_s = float(second.true_exact / wanted) * float(clips_at_s)
        raise ImpossibleShotError(
            f"{what}, and the fastest time that {camera.name} has for flats is {second.dial} s (the one above it is "
            "that of the bias frames, which EXIF could not tell apart). Dim its light, stop down or add a "
            f"neutral-density filter until it clips at {least_s:.2g} s or later, or leave ISO {iso} out"
        )
    if camera.slowest.true_exact * ExactNumber(Fraction(1), camera.shutter.step) < wanted:
        raise ImpossibleShotError(
            f"{what}, and {camera.name}'s slowest time is {camera.slowest.dial} s: light the surface more or open up"
        )
    return setting
