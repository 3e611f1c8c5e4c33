"""One scene of a plan, or one moment of it: its name, its metered time, and the shots that follow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from capture.capture_errors import PlanError
from capture.shots import scene_shots
from eldata.manifest.clips import moment_name, moment_of

if TYPE_CHECKING:
    from capture.camera import CameraDescription
    from capture.protocol import CaptureProtocol
    from capture.shots import Shot

# As in eldata verify, which refuses a pair whose ratio is further off its nominal one.
RATIO_TOLERANCE: Final = Fraction(1, 10)


@dataclass(frozen=True, slots=True)
class ScenePlan:
    """One scene.

    Attributes
    ----------
    name
        Its folder: ``scene-1``; of a moment of a sequence ``scene-1-moment-3``.
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
    def sequence(self) -> str:
        """The scene's name without the moment."""
        return sequence_name(self.name)

    @property
    def moment(self) -> int:
        """Which moment of a sequence, counted from 1; 0 of a scene without moments."""
        return (moment_of(self.name) or ("", 0))[1]

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


def sequence_name(name: str) -> str:
    """Return the scene that a name means, without its moment."""
    return (moment_of(name) or (name,))[0]


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


def moments_of(scene: ScenePlan, protocol: CaptureProtocol) -> tuple[ScenePlan, ...]:
    """Return a scene as often as it is taken; its notes stay with the first moment."""
    if protocol.moments == 1:
        return (scene,)
    names = (moment_name(scene.name, number) for number in range(1, protocol.moments + 1))
    first, *rest = (replace(scene, name=name) for name in names)
    return (first, *(replace(one, notes=()) for one in rest))
