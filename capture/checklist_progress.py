"""What was ticked and written down at the tripod: the file that the checklist's page exports.

The file is JSON::

    {
      "kind": "capture-progress", "schema": 1,
      "plan": "sha256:...",                         the plan that the page was made from
      "camera": "SonyA7S2",
      "preparation": ["tripod", ...],               what of the preparation was ticked
      "scenes": [
        {"name": "scene-1", "metered_s": "1/2",     as chosen in the page, else as planned
         "shots": [{"number": 1, "count": 1, "role": "reference", "iso": 100, "dial": "1/2",
                    "taken_at": "1/2", "repeats": 0, "file": "DSC01234", "remark": ""}, ...]}, ...],
      "calibration": [{"number": 1, "count": 10, "role": "bias", ...}, ...]
    }

``taken_at`` is the exposure time at which a shot was ticked, ``null`` where it was not. It differs from ``dial`` where
the scene was metered again but the shot not taken again. A plan that has changed since may still be read with the
file, as long as its scenes and shots are the same.
"""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capture.capture_errors import PlanError
from capture.checklist_content import ChecklistRow, every_item, rows
from capture.plan import CALIBRATION, check_same
from capture.shutter import parse_seconds
from eldata.base.fields import Fields, TextFile

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction
    from pathlib import Path

    from capture.plan import Plan
    from eldata.records import Role

KIND: Final = "capture-progress"
SCHEMA: Final = 1
LONGEST_TEXT: Final = 500
MOST_REPEATS: Final = 99


class ProgressError(PlanError):
    """A checklist's exported progress is malformed, or belongs to another plan."""


@dataclass(frozen=True, slots=True)
class ShotProgress:
    """One row of the checklist.

    Attributes
    ----------
    number, count
        Number of the (first) shot, and how many shots the row stands for: more than one with calibration frames.
    role, iso, dial
        What was to be set.
    taken_at
        The exposure time at which it was ticked, as the camera marks it; ``None`` if it was not.
    repeats
        How often it was taken again: that many more frames (times ``count``) are on the card, and the last ones count.
    file, remark
        As written down; empty if nothing was. ``file`` names the first of several.
    """

    number: int
    count: int
    role: Role
    iso: int
    dial: str
    taken_at: str | None
    repeats: int
    file: str
    remark: str

    @property
    def done(self) -> bool:
        """Whether it was ticked, at its present setting."""
        return self.taken_at == self.dial


@dataclass(frozen=True, slots=True)
class SceneProgress:
    """One scene: its name, its metered time as chosen at the scene, and its shots."""

    name: str
    metered_s: Fraction
    shots: tuple[ShotProgress, ...]

    @property
    def done(self) -> bool:
        """Whether every shot is ticked."""
        return all(shot.done for shot in self.shots)


@dataclass(frozen=True, slots=True)
class Progress:
    """What was ticked and written down.

    Attributes
    ----------
    plan_digest
        Of the plan that the page was made from (:func:`capture.checklist.plan_digest`).
    camera
        The plan's camera.
    preparation
        Names of what was ticked before the first shot.
    scenes, calibration
        In the plan's order.
    """

    plan_digest: str
    camera: str
    preparation: tuple[str, ...]
    scenes: tuple[SceneProgress, ...]
    calibration: tuple[ShotProgress, ...]

    @property
    def parts(self) -> tuple[tuple[str, tuple[ShotProgress, ...]], ...]:
        """The rows of each scene and of the calibration frames, by name."""
        scenes = ((scene.name, scene.shots) for scene in self.scenes)
        return (*scenes, *(((CALIBRATION, self.calibration),) if self.calibration else ()))

    def as_metered(self, plan: Plan) -> Plan:
        """Return the plan with the metered times that were entered at the scenes.

        Raises
        ------
        PlanError
            If the plan has no such scene.
        """
        for scene in self.scenes:
            if plan.scene(scene.name).metered_s != scene.metered_s:
                plan = plan.remeter(scene.name, scene.metered_s)
        return plan

    def as_noted(self, plan: Plan) -> Plan:
        """Return the plan with the remarks on shots as notes of their scenes, each once.

        Raises
        ------
        PlanError
            If the plan has no such scene.
        """
        for scene in self.scenes:
            for shot in scene.shots:
                note = f"frame {shot.number}: {shot.remark}"
                if shot.remark and note not in plan.scene(scene.name).notes:
                    plan = plan.add_note(scene.name, note)
        return plan


def load_progress(path: Path | str, plan: Plan, content: bytes | None = None) -> Progress:
    """Read what the checklist's page exported.

    Parameters
    ----------
    path
        The file; or what messages call it, if ``content`` is given.
    plan
        The plan that the page was made from, or one that it has become since.
    content
        What was exported, if that is at hand: pasted text.

    Raises
    ------
    ProgressError
        If the file cannot be read, a field is missing, unknown or wrong, or its scenes and shots are not the plan's;
        the message names the field, what was expected and what was found.
    """
    top = TextFile(path, ProgressError, content=content).json()
    top.only(("kind", "schema", "plan", "camera", "preparation", "scenes", "calibration"))
    if top.value("kind") != KIND:
        raise top.wrong("kind", f'"{KIND}", the file that the page\'s Export writes', top.data["kind"])
    top.schema(SCHEMA, "capture")
    if top.text("camera") != plan.camera.name:
        raise top.wrong("camera", f"{plan.camera.name!r}, the plan's", top.data["camera"])
    known = [item.name for item in every_item(plan)]
    # Calibration frames may have left the plan since, and their preparation with them.
    preparation = tuple(name for name in top.texts("preparation") if name in known)
    scenes: list[SceneProgress] = []
    for item in top.objects("scenes"):
        scenes.append(_scene(item, plan, [scene.name for scene in scenes]))
    frames = () if plan.calibration is None else rows(plan.calibration.shots)
    return Progress(top.text("plan"), plan.camera.name, preparation, tuple(scenes), _shots(top, "calibration", frames))


def _scene(fields: Fields, plan: Plan, before: Sequence[str]) -> SceneProgress:
    fields.only(("name", "metered_s", "shots"))
    name = fields.text("name")
    if name in before or name not in (scene.name for scene in plan.scenes):
        raise fields.wrong("name", "one of the plan's scenes, each once", name)
    metered_s = fields.parsed("metered_s", parse_seconds)
    try:
        scene = plan.remeter(name, metered_s).scene(name)
    except PlanError as error:
        advice = "Enter the time that was used in the page, and export again"
        raise fields.problem("metered_s", f"{error}. {advice}") from None
    return SceneProgress(name, metered_s, _shots(fields, "shots", rows(scene.shots)))


def _shots(fields: Fields, name: str, expected: Sequence[ChecklistRow]) -> tuple[ShotProgress, ...]:
    items = fields.objects(name)
    if len(items) != len(expected):
        raise fields.problem(name, f"expected the plan's {len(expected)} rows, found {len(items)} rows")
    found = []
    for shot, row in zip(items, expected, strict=True):
        planned = row.as_dict()
        check_same(shot, planned, ", as in the plan", also=("taken_at", "repeats", "file", "remark"))
        found.append(
            ShotProgress(
                **planned,
                taken_at=None if shot.value("taken_at") is None else shot.text("taken_at"),
                repeats=shot.whole("repeats", at_most=MOST_REPEATS),
                file=_words(shot, "file"),
                remark=_words(shot, "remark"),
            )
        )
    return tuple(found)


def _words(fields: Fields, name: str) -> str:
    found = fields.text(name, empty=True, longest=LONGEST_TEXT, unseen=True)
    if any(unicodedata.category(character) == "Cc" for character in found):
        raise fields.wrong(name, "a text without control characters", found)
    return found.strip()
