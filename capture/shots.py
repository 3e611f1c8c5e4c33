"""Shots, and scenes of them: which setting each exposure becomes on a given camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from capture.capture_errors import ImpossibleShotError, PlanError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.camera import CameraDescription
    from capture.protocol import CaptureProtocol, ProtocolFrame
    from capture.shutter import ExactNumber, ShutterTime
    from eldata.records import Role

# As in eldata verify, which refuses a pair whose ratio is further off its nominal one.
RATIO_TOLERANCE: Final = Fraction(1, 10)


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
    series
        Of calibration frames beside the usual ones, the folder that keeps them apart: ``warm``.
    """

    number: int
    role: Role
    iso: int
    target_s: Fraction
    setting: ShutterTime
    factor: int | None = None
    reference: int | None = None
    true_ratio: ExactNumber | None = None
    named_ratio: Fraction | None = None
    level: Fraction | None = None
    true_iso: Fraction | None = None
    series: str = ""

    @property
    def settings(self) -> str:
        """ISO and exposure time as they are dialled, to read."""
        return f"ISO {self.iso}, {self.setting.dial} s"

    @property
    def error_stops(self) -> float | None:
        """How many stops the true ratio lies above the nominal factor."""
        if self.true_ratio is None or self.factor is None:
            return None
        return (self.true_ratio / self.factor).log2

    @property
    def error_percent(self) -> float | None:
        """How many per cent the true ratio lies above the nominal factor."""
        if self.true_ratio is None or self.factor is None:
            return None
        return 100 * (float(self.true_ratio / self.factor) - 1)


# What a person at a camera takes, roughly: to turn a dial and look at the display; and what the camera takes to write a
# raw file before the next release.
DIAL_S: Final = 5
WRITE_S: Final = 2


@dataclass(frozen=True, slots=True)
class Duration:
    """How long shots take: exposures in seconds, how often ISO or time changes, files."""

    exposures_s: float
    turns: int
    files: int

    @property
    def total_s(self) -> float:
        """The sum, with :data:`DIAL_S` for a turn and :data:`WRITE_S` for a file."""
        return self.exposures_s + DIAL_S * self.turns + WRITE_S * self.files

    def __str__(self) -> str:
        return (
            f"about {minutes(self.total_s)}: exposures {minutes(self.exposures_s)}, {self.turns} turns of a dial at "
            f"{DIAL_S} s, {self.files} files at {WRITE_S} s"
        )


def duration_of(shots: Sequence[Shot]) -> Duration:
    """Return how long shots take one after the other, without composing, focusing, metering and changing scenes."""
    turns = sum((one.iso != other.iso) + (one.setting != other.setting) for one, other in pairwise(shots)) + 2 * bool(
        shots
    )
    return Duration(sum(shot.setting.true_s for shot in shots), turns, len(shots))


def minutes(seconds: float) -> str:
    """Return a time to read: ``40 s``, ``12 min``, ``3 h 5 min``."""
    if seconds < 90:
        return f"{math.ceil(seconds)} s"
    hours, rest = divmod(math.ceil(seconds / 60), 60)
    return f"{hours} h {rest} min" if hours else f"{rest} min"


def scene_shots(camera: CameraDescription, protocol: CaptureProtocol, metered_s: Fraction) -> tuple[Shot, ...]:
    """Return the shots of a scene, in order.

    The metered time becomes a setting first: the one marked so, else the nearest. Each noisy frame then gets the
    setting whose given time is nearest, by ratio, to ``t* / f`` with ``t`` the time that the references are really
    given: the light is what counts, not the names. So it is with ISOs whose measured speed the camera states.

    Raises
    ------
    PlanError
        If the camera does not have one of the protocol's ISOs.
    ImpossibleShotError
        If a shot needs a time that the camera does not have; the message says what to change.
    """
    check_isos(camera, protocol)
    shots = _shots_or_none(camera, protocol, metered_s)
    if isinstance(shots, tuple):
        return shots
    raise ImpossibleShotError(_what_to_change(camera, protocol, metered_s, shots))


def check_isos(camera: CameraDescription, protocol: CaptureProtocol) -> None:
    """Refuse a protocol with an ISO that the camera does not have."""
    for iso in (protocol.base_iso, *protocol.noisy_isos):
        if iso not in camera.isos:
            raise PlanError(
                f"{camera.name} has no ISO {iso}; it has {', '.join(map(str, camera.isos))}: choose others, or correct "
                "the camera description"
            )
        camera.speed(iso)


def _light_share(camera: CameraDescription, protocol: CaptureProtocol, frame: ProtocolFrame) -> Fraction:
    """Return the time of a noisy frame over that of its reference: by the ISOs' speeds, and its factor."""
    return camera.speed(protocol.base_iso) / camera.speed(frame.iso) / (frame.factor or 1)


@cache  # a checklist asks for every time on the dial, and what to change needs all of them
def _shots_or_none(
    camera: CameraDescription, protocol: CaptureProtocol, metered_s: Fraction
) -> tuple[Shot, ...] | ProtocolFrame:
    """Return the shots, or the first frame that the camera cannot take."""
    frames = protocol.frames()
    base = camera.named(metered_s) or camera.nearest(metered_s)
    if base is None:
        return frames[0]
    shots = []
    speeds = dict(camera.true_isos)
    alike: dict[tuple[int, int], Shot] = {}  # of up to 99 repeats one is computed
    for frame in frames:
        target_s = protocol.exposure_s(frame, base.nominal_s)
        true_iso = speeds.get(frame.iso)
        if frame.factor is None:
            shots.append(Shot(frame.number, frame.role, frame.iso, target_s, base, true_iso=true_iso))
            continue
        before = alike.get((frame.iso, frame.factor))
        if before is not None:
            shots.append(replace(before, number=frame.number, reference=frame.reference))
            continue
        light = _light_share(camera, protocol, frame)
        setting = camera.nearest(base.true_exact * light)
        if setting is None:
            return frame
        ratios = (
            base.true_exact / setting.true_exact * light * frame.factor,
            base.nominal_s / setting.nominal_s * Fraction(protocol.base_iso, frame.iso),
        )
        shot = Shot(frame.number, frame.role, frame.iso, target_s, setting, frame.factor, frame.reference, *ratios)
        alike[frame.iso, frame.factor] = replace(shot, true_iso=true_iso)
        shots.append(alike[frame.iso, frame.factor])
    return tuple(shots)


# --- what to change -----------------------------------------------------------------------------------------------


def _what_to_change(
    camera: CameraDescription, protocol: CaptureProtocol, metered_s: Fraction, frame: ProtocolFrame
) -> str:
    exposures_s = [protocol.exposure_s(one, metered_s) for one in protocol.frames()]
    shortest_s, longest_s = min(exposures_s), max(exposures_s)
    metered = f"metered at {metered_s} s (ISO {protocol.base_iso})"
    fitting = [
        time for time in camera.shutter.times if isinstance(_shots_or_none(camera, protocol, time.nominal_s), tuple)
    ]
    if not fitting:
        return (
            f"{metered}: the protocol asks for times from {shortest_s} s to {longest_s} s, and no metered time brings "
            f"all of them between {camera.name}'s {camera.fastest.dial} s and {camera.slowest.dial} s: take smaller "
            "low-light factors, or fewer ISOs"
        )
    target_s = protocol.exposure_s(frame, metered_s)
    what = f"{frame.role} frame {frame.number} (ISO {frame.iso}{f', x{frame.factor}' if frame.factor else ''})"
    too_fast = metered_s < fitting[0].nominal_s
    limit = camera.fastest if too_fast else camera.slowest
    bound = fitting[0] if too_fast else fitting[-1]
    stops = _stops_up(abs((bound.true_exact / metered_s).log2))
    message = (
        f"{metered}: {what} needs {target_s} s, and {camera.name}'s {'fastest' if too_fast else 'slowest'} time is "
        f"{limit.dial} s. "
    )
    if too_fast:
        return message + (
            f"Let {stops} less light in, so that the scene meters at {bound.dial} s or longer: stop down by {stops}, "
            f"or add a neutral-density filter of {stops}, or dim the lamps. Another base ISO does not help: "
            "ISO x time stays the same"
        )
    message += (
        f"Let {stops} more light in, so that the scene meters at {bound.dial} s or shorter: open up by {stops}, or add "
        "light"
    )
    raised = protocol.base_iso * metered_s / bound.nominal_s
    other = next((iso for iso in camera.isos if iso >= raised and iso < min(protocol.noisy_isos)), None)
    if frame.factor is None and other is not None:
        message += f"; or take ISO {other} as the base"
    return message


def _stops_up(stops: float) -> str:
    """Return a number of stops, rounded up to thirds: ``6 1/3 stops``."""
    thirds = max(1, math.ceil(3 * stops - 1e-6))
    whole, rest = divmod(thirds, 3)
    text = " ".join([*([str(whole)] if whole else []), *([f"{rest}/3"] if rest else [])])
    return f"{text} stop{'' if thirds <= 3 else 's'}"


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
        """What to know about these shots: a metered time that was rounded, ratios far off their factor."""
        found = []
        base = self.shots[0].setting
        if base.nominal_s != self.metered_s:
            found.append(f"metered at {self.metered_s} s, set as {base.dial} s, the camera's nearest time")
        far = [shot for shot in self.shots if _far_off(shot)]
        if far:
            listed = ", ".join(str(shot.number) for shot in far)
            found.append(
                f"frames {listed}: the ratio is more than {float(100 * RATIO_TOLERANCE):.0f} % off its factor, which "
                "eldata verify refuses; set the camera to thirds of a stop, or meter another time"
            )
        return tuple(found)


def _far_off(shot: Shot) -> bool:
    if shot.factor is None or shot.true_ratio is None or shot.named_ratio is None:
        return False
    ratios = (float(shot.true_ratio), float(shot.named_ratio))
    return any(abs(ratio - shot.factor) > RATIO_TOLERANCE * shot.factor for ratio in ratios)


def plan_scene(
    camera: CameraDescription, protocol: CaptureProtocol, name: str, metered_s: Fraction, notes: tuple[str, ...] = ()
) -> ScenePlan:
    """Return a scene with its shots computed.

    Raises
    ------
    PlanError
        If the camera does not have one of the protocol's ISOs.
    ImpossibleShotError
        If one of its shots is beyond the camera; the message names the scene and says what to change.
    """
    try:
        return ScenePlan(name, metered_s, scene_shots(camera, protocol, metered_s), notes)
    except PlanError as error:
        raise type(error)(f"{name}: {error}") from None
