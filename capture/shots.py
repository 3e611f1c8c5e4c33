"""Shots, scenes of them, and calibration frames: which setting each exposure becomes on a given camera.

Calibration frames are bias frames, and flat-field frames in pairs, for each ISO. The recipe and where it comes from:

- Bias frames: no light, lens capped in a dark room, the shortest exposure that there is (Wei, Fu, Zheng and Yang, TPAMI
  2021, section 3.2.1). Ten per ISO: the noise's shape needs some, and from six on one is kept out to test the result
  (docs/calibration.md). The paper gives no number; EMVA 1288 takes two dark frames per exposure time, which is enough
  for a variance but not for a distribution.
- Flats: white paper on an evenly lit wall, close, the lens at infinity (the same section). Two of each exposure, one
  after the other, since the difference of two equal frames is free of shading and fixed pattern (EMVA 1288). Six levels
  from a tenth to nine tenths of the range (docs/calibration.md: four to eight; EMVA 1288 asks for many more, to test
  linearity, where we want a slope).
- ISOs: full stops from the base ISO to the highest noisy one, since a camera with two conversion gains changes its
  noise at one of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from capture.camera import EQUAL, CameraDescription, ShutterTime
from capture.capture_errors import CaptureError, ImpossibleShotError
from eldata.manifest.pair_checks import RATIO_TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.protocol import CaptureProtocol, ProtocolFrame
    from eldata.records import Role


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame to take.

    Attributes
    ----------
    number
        Its place in the scene, or among the calibration frames, from 1.
    role
        ``"reference"``, ``"noisy"``, ``"bias"`` or ``"flat"``.
    iso
        ISO to set.
    target_s
        The exposure time that the protocol asks for, ``t* / f``, exactly.
    setting
        The exposure time to set: how it is marked, and what the camera then gives.
    factor, reference
        Low-light factor and number of the reference of a noisy frame; else ``None``.
    true_ratio
        (ISO t) of the reference over (ISO t) of the noisy frame, by the times that the camera gives and, where they are
        known, the speeds that its ISOs have.
    named_ratio
        The same by the times and ISOs that it names: what EXIF will say with most makers.
    level
        Of a flat: wanted mean, as a share of the range over black.
    true_iso
        The ISO's measured speed, where the camera's description states it.
    """

    number: int
    role: Role
    iso: int
    target_s: Fraction
    setting: ShutterTime
    factor: int | None = None
    reference: int | None = None
    true_ratio: float | None = None
    named_ratio: Fraction | None = None
    level: Fraction | None = None
    true_iso: Fraction | None = None

    @property
    def settings(self) -> str:
        """ISO and exposure time as they are dialled, to read."""
        return f"ISO {self.iso}, {self.setting.dial} s"

    @property
    def ratio_error(self) -> float | None:
        """The true ratio over the nominal factor of a noisy frame."""
        return None if self.true_ratio is None or self.factor is None else self.true_ratio / self.factor


# What a person at a camera takes, roughly: to turn a dial and look at the display; and what the camera takes to write a
# raw file before the next release.
DIAL_S: Final = 5
WRITE_S: Final = 2


def sum_duration_s(shots: Sequence[Shot], dial_s: float = DIAL_S) -> float:
    """Sum how long shots take one after the other: exposures, turns of a dial and files written.

    Composing, focusing, metering and changing scenes are not counted.
    """
    return sum(shot.setting.true_s for shot in shots) + dial_s * _count_turns(shots) + WRITE_S * len(shots)


def describe_duration(shots: Sequence[Shot]) -> str:
    """Describe how long shots take: exposures, turns of a dial and files written."""
    exposures_s = sum(shot.setting.true_s for shot in shots)
    return (
        f"about {format_minutes(sum_duration_s(shots))}: exposures {format_minutes(exposures_s)}, "
        f"{_count_turns(shots)} turns of a dial at {DIAL_S} s, {len(shots)} files at {WRITE_S} s"
    )


def _count_turns(shots: Sequence[Shot]) -> int:
    """Count the turns of the ISO and shutter dials, the first setting included."""
    changes = sum((shot.iso != last.iso) + (shot.setting != last.setting) for last, shot in pairwise(shots))
    return changes + 2 * bool(shots)


def format_minutes(seconds: float) -> str:
    """Return a time to read: ``40 s``, ``12 min``, ``3 h 5 min``."""
    if seconds < 90:
        return f"{math.ceil(seconds)} s"
    hours, rest = divmod(math.ceil(seconds / 60), 60)
    return f"{hours} h {rest} min" if hours else f"{rest} min"


def plan_shots(camera: CameraDescription, protocol: CaptureProtocol, metered_s: Fraction) -> tuple[Shot, ...]:
    """Return the shots of a scene, in order.

    The metered time becomes a setting first: the one marked so, else the nearest. Each noisy frame then gets the
    setting whose given time is nearest, by ratio, to ``t* / f`` with ``t`` the time that the references are really
    given: the light is what counts, not the names. So it is with ISOs whose measured speed the camera states.

    Raises
    ------
    CaptureError
        If the camera does not have one of the protocol's ISOs.
    ImpossibleShotError
        If a shot needs a time that the camera does not have; the message says what to change.
    """
    check_isos(camera, protocol)
    shots = _try_shots(camera, protocol, metered_s)
    if isinstance(shots, tuple):
        return shots
    raise ImpossibleShotError(_advise_change(camera, protocol, metered_s, shots))


def check_isos(camera: CameraDescription, protocol: CaptureProtocol) -> None:
    """Refuse a protocol with an ISO that the camera does not have."""
    for iso in (protocol.base_iso, *protocol.noisy_isos):
        _check_iso(camera, iso)
        camera.speed(iso)


def _check_iso(camera: CameraDescription, iso: int) -> None:
    """Refuse an ISO that the camera does not have."""
    if iso not in camera.isos:
        raise CaptureError(
            f"{camera.name} has no ISO {iso}; it has {', '.join(map(str, camera.isos))}: choose others, or correct the "
            "camera description"
        )


@cache  # a checklist asks for every time on the dial, and what to change needs all of them
def _try_shots(
    camera: CameraDescription, protocol: CaptureProtocol, metered_s: Fraction
) -> tuple[Shot, ...] | ProtocolFrame:
    """Return the shots, or the first frame that the camera cannot take."""
    frames = protocol.frames()
    base = camera.find_marked(metered_s) or camera.round_to_nearest(metered_s)
    if base is None:
        return frames[0]
    shots = []
    speeds = dict(camera.true_isos)
    alike: dict[tuple[int, int | None], Shot] = {}  # of up to 99 repeats one is computed
    for frame in frames:
        shot = alike.get((frame.iso, frame.factor))
        if shot is None:
            target_s = protocol.exposure_s(frame, base.nominal_s)
            shot = Shot(frame.number, frame.role, frame.iso, target_s, base, true_iso=speeds.get(frame.iso))
            if frame.factor is not None:
                # The time of a noisy frame over its reference's, by the ISOs' speeds and its factor.
                light = camera.speed(protocol.base_iso) / camera.speed(frame.iso) / frame.factor
                setting = camera.round_to_nearest(base.true_s * light)
                if setting is None:
                    return frame
                true_ratio = base.true_s / setting.true_s * float(light * frame.factor)
                named_ratio = base.nominal_s / setting.nominal_s * Fraction(protocol.base_iso, frame.iso)
                shot = replace(
                    shot, setting=setting, factor=frame.factor, true_ratio=true_ratio, named_ratio=named_ratio
                )
            alike[frame.iso, frame.factor] = shot
        shots.append(replace(shot, number=frame.number, reference=frame.reference))
    return tuple(shots)


# --- what to change -----------------------------------------------------------------------------------------------


def _advise_change(
    camera: CameraDescription, protocol: CaptureProtocol, metered_s: Fraction, frame: ProtocolFrame
) -> str:
    """Explain which frame the camera cannot take at a metered time, and what to change."""
    metered = f"metered at {metered_s} s (ISO {protocol.base_iso})"
    fitting = [time for time in camera.shutter.times if isinstance(_try_shots(camera, protocol, time.nominal_s), tuple)]
    if not fitting:
        exposures_s = [protocol.exposure_s(frame, metered_s) for frame in protocol.frames()]
        return (
            f"{metered}: the protocol asks for times from {min(exposures_s)} s to {max(exposures_s)} s, and no metered "
            f"time brings all of them between {camera.fastest.dial} s and {camera.slowest.dial} s, which "
            f"{camera.name} has: take smaller low-light factors, or fewer ISOs"
        )
    too_fast = metered_s < fitting[0].nominal_s
    bound, limit = (fitting[0], camera.fastest) if too_fast else (fitting[-1], camera.slowest)
    stops = _round_up_stops(abs(math.log2(bound.true_s / metered_s)))
    message = (
        f"{metered}: {frame.role} frame {frame.number} (ISO {frame.iso}{f', x{frame.factor}' if frame.factor else ''}) "
        f"needs {protocol.exposure_s(frame, metered_s)} s, and {camera.name}'s "
        f"{'fastest' if too_fast else 'slowest'} time is {limit.dial} s. Let {stops} "
        f"{'less' if too_fast else 'more'} light in, so that the scene meters at {bound.dial} s or "
        f"{'longer' if too_fast else 'shorter'}: "
    )
    if too_fast:
        return message + (
            f"stop down by {stops}, or add a neutral-density filter of {stops}, or dim the lamps. Another base ISO "
            "does not help: ISO x time stays the same"
        )
    message += f"open up by {stops}, or add light"
    raised = protocol.base_iso * metered_s / bound.nominal_s
    other = next((iso for iso in camera.isos if raised <= iso < min(protocol.noisy_isos)), None)
    return message if frame.factor or other is None else f"{message}; or take ISO {other} as the base"


def _round_up_stops(stops: float) -> str:
    """Write a number of stops, rounded up to thirds: ``6 1/3 stops``."""
    thirds = max(1, math.ceil(3 * stops - 1e-6))
    whole, rest = divmod(thirds, 3)
    parts = ([str(whole)] if whole else []) + ([f"{rest}/3"] if rest else [])
    return f"{' '.join(parts)} stop{'' if thirds <= 3 else 's'}"


# --- scenes -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ScenePlan:
    """One scene.

    Attributes
    ----------
    name
        Its folder: ``scene-1``.
    metered_s
        What the meter said at the base ISO, in seconds.
    shots
        In the order in which they are taken.
    notes
        The photographer's notes: what the scene shows.
    aperture
        The f-number of all its shots, as EXIF will state it; ``None`` if the plan leaves it open.
    """

    name: str
    metered_s: Fraction
    shots: tuple[Shot, ...]
    notes: tuple[str, ...] = ()
    aperture: Fraction | None = None

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on these shots: a metered time that was rounded, ratios far off their factor."""
        remarks = []
        base = self.shots[0].setting
        if base.nominal_s != self.metered_s:
            remarks.append(f"metered at {self.metered_s} s, set as {base.dial} s, the camera's nearest time")
        far = []
        for shot in self.shots:
            ratios = [float(ratio) for ratio in (shot.true_ratio, shot.named_ratio) if ratio is not None]
            if any(abs(ratio - (shot.factor or 0)) > RATIO_TOLERANCE * (shot.factor or 0) for ratio in ratios):
                far.append(str(shot.number))
        if far:
            remarks.append(
                f"frames {', '.join(far)}: the ratio is more than {float(100 * RATIO_TOLERANCE):.0f} % off its factor, "
                "which eldata verify refuses; set the camera to thirds of a stop, or meter another time"
            )
        return tuple(remarks)


def plan_scene(
    camera: CameraDescription, protocol: CaptureProtocol, name: str, metered_s: Fraction, notes: tuple[str, ...] = ()
) -> ScenePlan:
    """Return a scene with its shots computed.

    Raises
    ------
    CaptureError
        If the camera does not have one of the protocol's ISOs.
    ImpossibleShotError
        If one of its shots is beyond the camera; the message names the scene and says what to change.
    """
    try:
        return ScenePlan(name, metered_s, plan_shots(camera, protocol, metered_s), notes)
    except CaptureError as error:
        raise type(error)(f"{name}: {error}") from None


# --- calibration frames -----------------------------------------------------------------------------------------------

BIAS_FRAMES: Final = 10
LEAST_BIAS_FRAMES: Final = 4  # below, eldata calibrate refuses
_MOST_FRAMES: Final = 999  # more is a slip of the keys, and would be planned until memory ends
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
    """

    isos: tuple[int, ...]
    bias_frames: int
    flat_levels: tuple[Fraction, ...]
    flat_clips_at_s: Fraction
    shots: tuple[Shot, ...]
    remarks: tuple[str, ...] = ()


def choose_isos(camera: CameraDescription, protocol: CaptureProtocol) -> tuple[int, ...]:
    """Return the full stops from the base ISO to the highest noisy ISO, and the protocol's own ISOs.

    Names of ISOs are rounded: one stop above ISO 64 is ISO 125. A full stop that lies within half a stop of one of the
    protocol's ISOs tells nothing that this one does not.
    """
    used = {protocol.base_iso, *protocol.noisy_isos}
    isos = set(used)
    for iso in camera.isos:
        stops = math.log2(iso / protocol.base_iso)
        full = abs(stops - round(stops)) < _NAME_STOPS and 0 < stops < math.log2(max(used) / protocol.base_iso)
        if full and all(abs(math.log2(iso / other)) > _NEAR_STOPS for other in used):
            isos.add(iso)
    return tuple(sorted(isos))


def plan_calibration(
    camera: CameraDescription, base_iso: int, isos: tuple[int, ...], flat_clips_at_s: Fraction, *,
    bias_frames: int = BIAS_FRAMES, flat_levels: tuple[Fraction, ...] = FLAT_LEVELS,
) -> CalibrationPlan:  # fmt: skip
    """Return the calibration frames of a camera: bias frames and flats.

    Raises
    ------
    CaptureError
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
        _check_iso(camera, iso)
    if not isos or list(isos) != sorted(set(isos)):
        raise CaptureError(f"calibration ISOs: expected one or more, rising; found {list(isos)}")
    if not LEAST_BIAS_FRAMES <= bias_frames <= _MOST_FRAMES:
        raise CaptureError(f"bias frames per ISO: expected {LEAST_BIAS_FRAMES} to {_MOST_FRAMES}, found {bias_frames}")
    levels = [Fraction(0), *flat_levels, Fraction(1)]
    if not flat_levels or levels != sorted(set(levels)):
        found = ", ".join(map(str, flat_levels))
        raise CaptureError(f"flat levels: expected shares between 0 and 1, rising; found {found}")
    shots: list[Shot] = []
    remarks: list[str] = []
    named = camera.find_marked(flat_clips_at_s)
    clips_at = float(flat_clips_at_s) if named is None else named.true_s  # what the camera gives for it
    fastest = camera.fastest
    shots += [Shot(0, "bias", iso, fastest.nominal_s, fastest) for iso in isos for _ in range(bias_frames)]
    for iso in isos:
        taken: list[Fraction] = []
        for level in flat_levels:
            target_s = flat_clips_at_s * level * Fraction(base_iso, iso)
            wanted = clips_at * float(level * camera.speed(base_iso) / camera.speed(iso))
            setting = _choose_flat_setting(camera, iso, level, wanted, flat_clips_at_s)
            if setting.nominal_s in taken:
                remarks.append(
                    f"ISO {iso}: no flats at {float(100 * level):.0f} %, which the camera's steps round to "
                    f"{setting.dial} s again"
                )
                continue
            taken.append(setting.nominal_s)
            shots += [Shot(0, "flat", iso, target_s, setting, level=level)] * FRAMES_PER_LEVEL
    numbered = tuple(replace(shot, number=number) for number, shot in enumerate(shots, 1))
    return CalibrationPlan(isos, bias_frames, flat_levels, flat_clips_at_s, numbered, tuple(remarks))


def _choose_flat_setting(
    camera: CameraDescription, iso: int, level: Fraction, wanted_s: float, clips_at_s: Fraction
) -> ShutterTime:
    """Choose the shutter time of a flat, rounded down; refuse one that the camera cannot give."""
    what = f"the flat of {float(100 * level):.0f} % at ISO {iso} needs {wanted_s:.3g} s"
    # Rounded down, never up: a flat that clips is of no use, a darker one is.
    setting = camera.round_down(wanted_s)
    if setting is None or setting == camera.fastest:
        second = camera.shutter.times[min(1, len(camera.shutter.times) - 1)]
        least_s = second.true_s / wanted_s * clips_at_s
        raise ImpossibleShotError(
            f"{what}, and the fastest time that {camera.name} has for flats is {second.dial} s (the one above it is "
            "that of the bias frames, which EXIF could not tell apart). Dim its light, stop down or add a "
            f"neutral-density filter until it clips at {least_s:.2g} s or later, or leave ISO {iso} out"
        )
    if camera.slowest.true_s * 2**camera.shutter.step * EQUAL < wanted_s:
        raise ImpossibleShotError(
            f"{what}, and {camera.name}'s slowest time is {camera.slowest.dial} s: light the surface more or open up"
        )
    return setting
