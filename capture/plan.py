"""The capture plan: what to photograph with one camera, scene by scene, as a file that can be changed and resumed.

The file states what was decided (camera, protocol, metered times) and, for readers in other languages, the shots that
follow. On load they are computed again and must agree: nobody would notice the ratio of a shot changed by hand.
"""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from capture.camera import CameraDescription, camera_as_dict, parse_seconds, read_camera, read_wholes
from capture.capture_errors import CaptureError, naming
from capture.protocol import CaptureProtocol
from capture.shots import CalibrationPlan, ScenePlan, Shot, check_isos, plan_calibration, plan_scene, sum_duration_s
from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import write_json
from eldata.base.numbers import counted, fraction_of
from eldata.base.visible import shown

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction
    from pathlib import Path

SCHEMA: Final = 1
CALIBRATION: Final = "calibration"
_SCENE: Final = re.compile(r"scene-[1-9][0-9]{0,5}")


@dataclass(frozen=True, slots=True)
class Plan:
    """What to photograph with one camera.

    Attributes
    ----------
    camera, protocol
        What the camera can be set to; the frames of a scene.
    scenes
        In the order in which they are taken.
    calibration
        Calibration frames, or ``None``.

    Raises
    ------
    CaptureError
        If there is nothing to take, or a scene's name is not ``scene-<n>`` or occurs twice.
    """

    camera: CameraDescription
    protocol: CaptureProtocol
    scenes: tuple[ScenePlan, ...] = ()
    calibration: CalibrationPlan | None = None

    def __post_init__(self) -> None:
        check_isos(self.camera, self.protocol)
        if not self.scenes and self.calibration is None:
            raise CaptureError("a plan needs at least one scene, or calibration frames; found neither")
        names: list[str] = []
        for scene in self.scenes:
            if _SCENE.fullmatch(scene.name) is None:
                raise CaptureError(
                    f"scene name: expected scene-1, scene-2 and so on, as the dataset's folders are called; found "
                    f"{scene.name!r} (what it shows belongs in its notes)"
                )
            if scene.name in names:
                raise CaptureError(f"scene names: expected each once, found {scene.name} twice")
            names.append(scene.name)

    @property
    def shots(self) -> tuple[tuple[str, Shot], ...]:
        """All shots in the order in which they are taken, each with its scene's name or ``"calibration"``."""
        scenes = [(scene.name, shot) for scene in self.scenes for shot in scene.shots]
        frames = () if self.calibration is None else self.calibration.shots
        return (*scenes, *((CALIBRATION, shot) for shot in frames))

    @property
    def duration_s(self) -> float:
        """The time that the shots take, without the work between the scenes."""
        return sum_duration_s([shot for _, shot in self.shots])

    @property
    def extent(self) -> str:
        """Number of scenes, in words."""
        return counted(len(self.scenes), "scene")

    def scene(self, name: str) -> ScenePlan:
        """Return a scene by its name.

        Raises
        ------
        CaptureError
            If the name is unknown; the message lists the plan's scenes.
        """
        for scene in self.scenes:
            if scene.name == name:
                return scene
        known = ", ".join(scene.name for scene in self.scenes) or "none"
        raise CaptureError(f"the plan has no scene called {name!r}; it has {known}")

    def add_scene(self, name: str, metered_s: Fraction) -> Plan:
        """Return the plan with one more scene at its end; as it is if it has that very scene.

        Raises
        ------
        CaptureError
            If the name is not ``scene-<n>`` or is taken.
        ImpossibleShotError
            If one of its shots is beyond the camera.
        """
        if any((scene.name, scene.metered_s) == (name, metered_s) for scene in self.scenes):
            return self
        return replace(self, scenes=(*self.scenes, plan_scene(self.camera, self.protocol, name, metered_s)))

    def remeter(self, name: str, metered_s: Fraction) -> Plan:
        """Return the plan with a scene's shots computed from another metered time; its notes stay.

        Raises
        ------
        CaptureError
            If the scene is unknown.
        ImpossibleShotError
            If one of its shots is beyond the camera.
        """
        scene = self.scene(name)
        shots = plan_scene(self.camera, self.protocol, name, metered_s).shots
        return self._replace_scene(replace(scene, metered_s=metered_s, shots=shots))

    def set_aperture(self, name: str, aperture: Fraction) -> Plan:
        """Return the plan with a scene's aperture, an f-number.

        Raises
        ------
        CaptureError
            If the scene is unknown.
        """
        return self._replace_scene(replace(self.scene(name), aperture=aperture))

    def add_note(self, name: str, note: str) -> Plan:
        """Return the plan with one more note on a scene, which has each once.

        Raises
        ------
        CaptureError
            If the scene is unknown.
        """
        scene = self.scene(name)
        return self._replace_scene(replace(scene, notes=tuple(dict.fromkeys((*scene.notes, note)))))

    def _replace_scene(self, changed: ScenePlan) -> Plan:
        """Return the plan with a scene changed, found by its name."""
        return replace(self, scenes=tuple(changed if scene.name == changed.name else scene for scene in self.scenes))

    def only(self, names: Sequence[str]) -> Plan:
        """Return the plan of some scenes alone; ``"calibration"`` names the calibration frames.

        Raises
        ------
        CaptureError
            If a scene is unknown, or there are no calibration frames.
        """
        if CALIBRATION in names and self.calibration is None:
            raise CaptureError("the plan has no calibration frames")
        wanted = {self.scene(name).name for name in names if name != CALIBRATION}
        return replace(
            self,
            scenes=tuple(scene for scene in self.scenes if scene.name in wanted),
            calibration=self.calibration if CALIBRATION in names else None,
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the plan as plain JSON types: the content of its file."""
        return {
            "schema": SCHEMA,
            "camera": camera_as_dict(self.camera),
            "protocol": asdict(self.protocol),
            "scenes": list(map(_scene_as_dict, self.scenes)),
            "calibration": None if self.calibration is None else _calibration_as_dict(self.calibration),
        }

    def save(self, path: Path | str) -> None:
        """Write the plan as JSON, whole or not at all."""
        write_json(path, self.as_dict(), indent=1)

    @classmethod
    def load(cls, path: Path | str) -> Plan:
        """Read a plan.

        Raises
        ------
        CaptureError
            If the file cannot be read, a field is missing, unknown or wrong, or the shots are not those that follow
            from the rest; the message names the field, what was expected and what was found.
        """
        top = TextFile(path, CaptureError).json()
        top.only(("schema", "camera", "protocol", "scenes", "calibration"))
        top.schema(SCHEMA, "capture")
        with naming(path):
            camera = read_camera(top.inside("camera"))
            protocol = _read_protocol(top.inside("protocol"))
            check_isos(camera, protocol)
            scenes = tuple(_read_scene(scene, camera, protocol) for scene in top.objects("scenes"))
            calibration = None
            if top.value("calibration") is not None:
                calibration = _read_calibration(top.inside("calibration"), camera, protocol)
            return cls(camera, protocol, scenes, calibration)


def make_plan(
    camera: CameraDescription,
    protocol: CaptureProtocol,
    metered_s: dict[str, Fraction],
    calibration: CalibrationPlan | None = None,
) -> Plan:
    """Return a plan of scenes by name and metered time.

    Raises
    ------
    CaptureError
        If there is nothing to take, a name is not ``scene-<n>``, or the camera does not have one of the ISOs.
    ImpossibleShotError
        If one of the shots is beyond the camera.

    Examples
    --------
    >>> from fractions import Fraction
    >>> from capture import RELEASED, make_plan
    >>> from capture.camera import EXAMPLE
    >>> plan = make_plan(EXAMPLE, RELEASED, {"scene-1": Fraction(4), "scene-2": Fraction(2)})
    >>> [(shot.role, shot.iso, shot.setting.dial) for shot in plan.scenes[0].shots[:3]]
    [('reference', 100, '4'), ('noisy', 800, '0.5'), ('noisy', 800, '1/20')]
    """
    scenes = tuple(plan_scene(camera, protocol, name, seconds) for name, seconds in metered_s.items())
    return Plan(camera, protocol, scenes, calibration)


# --- the file -----------------------------------------------------------------------------------------------------


def _scene_as_dict(scene: ScenePlan) -> dict[str, Any]:
    """Convert a scene to plain JSON types."""
    return {
        "name": scene.name,
        "metered_s": str(scene.metered_s),
        **({} if scene.aperture is None else {"aperture": str(scene.aperture)}),
        "notes": list(scene.notes),
        "shots": list(map(_shot_as_dict, scene.shots)),
    }


def _calibration_as_dict(calibration: CalibrationPlan) -> dict[str, Any]:
    """Convert the calibration frames to plain JSON types."""
    return {
        "isos": list(calibration.isos),
        "bias_frames": calibration.bias_frames,
        "flat_levels": list(map(str, calibration.flat_levels)),
        "flat_clips_at_s": str(calibration.flat_clips_at_s),
        "shots": list(map(_shot_as_dict, calibration.shots)),
    }


def _shot_as_dict(shot: Shot) -> dict[str, Any]:
    """Convert a shot to plain JSON types, without its empty fields."""
    content = {
        "number": shot.number,
        "role": shot.role,
        "iso": shot.iso,
        "target_s": str(shot.target_s),
        "dial": shot.setting.dial,
        "nominal_s": str(shot.setting.nominal_s),
        "true_s": shot.setting.true_s,
        "factor": shot.factor,
        "reference": shot.reference,
        "named_ratio": shot.named_ratio and str(shot.named_ratio),
        "true_ratio": shot.true_ratio,
        "level": shot.level and str(shot.level),
        "true_iso": shot.true_iso and float(shot.true_iso),
    }
    return {name: value for name, value in content.items() if value is not None}


def _read_protocol(fields: Fields) -> CaptureProtocol:
    """Read a protocol from a JSON object."""
    fields.only(names_of(CaptureProtocol))
    return CaptureProtocol(
        fields.whole("base_iso", at_least=1),
        read_wholes(fields, "noisy_isos"),
        read_wholes(fields, "low_light_factors"),
        fields.whole("repeats", at_least=1),
        fields.whole("references", at_least=1),
    )


def _read_scene(fields: Fields, camera: CameraDescription, protocol: CaptureProtocol) -> ScenePlan:
    """Read a scene from a JSON object, and refuse it if its shots are not as computed."""
    fields.only(names_of(ScenePlan))
    name, notes = fields.text("name"), fields.texts("notes", unseen=True)
    scene = plan_scene(camera, protocol, name, fields.parsed("metered_s", parse_seconds), notes)
    _check_shots(fields, scene.shots)
    return replace(scene, aperture=fields.optional("aperture", fields.parsed, parse=fraction_of, above=0))


def _read_calibration(fields: Fields, camera: CameraDescription, protocol: CaptureProtocol) -> CalibrationPlan:
    """Read the calibration frames from a JSON object; refuse shots that are not as computed."""
    fields.only(("isos", "bias_frames", "flat_levels", "flat_clips_at_s", "shots"))
    calibration = plan_calibration(
        camera,
        protocol.base_iso,
        read_wholes(fields, "isos"),
        fields.parsed("flat_clips_at_s", parse_seconds),
        bias_frames=fields.whole("bias_frames"),
        flat_levels=fields.each("flat_levels", Fields.parsed, parse=parse_seconds),
    )
    _check_shots(fields, calibration.shots)
    return calibration


def _check_shots(fields: Fields, shots: Sequence[Shot]) -> None:
    """Refuse a file whose shots differ from those computed from its decisions."""
    items = fields.objects("shots")
    advice = " (shots follow from the rest: change that with capture plan --remeter, not the shots)"
    for item, shot in zip(items, shots, strict=False):
        expected = _shot_as_dict(shot)
        item.only(expected)
        for key, value in expected.items():
            stated = item.value(key)
            same = isinstance(stated, type(value))
            same &= math.isclose(stated, value, rel_tol=1e-9) if same and isinstance(value, float) else stated == value
            if not same:
                raise item.wrong(key, f"{shown(value)}{advice}", stated)
    if len(items) != len(shots):
        raise fields.problem("shots", f"expected {len(shots)} shots{advice}, found {len(items)}")
