"""What a checklist says, whatever its format: preparation, each scene's rows, calibration frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from capture.calibration import WARM
from capture.capture_errors import PlanError
from eldata.base.fields import TextFile

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capture.plan import Plan
    from capture.shots import Shot

TEMPLATES: Final = Path(__file__).parent / "templates"


@dataclass(frozen=True, slots=True)
class Item:
    """Something to do before the first shot.

    Attributes
    ----------
    name
        Short, for files: what is ticked stays ticked when the words change.
    text, why
        What to do, and in one line why.
    """

    name: str
    text: str
    why: str


@dataclass(frozen=True, slots=True)
class ChecklistRow:
    """A row with one box to tick: a shot, or successive shots with the same settings.

    Attributes
    ----------
    shot
        The (first) shot.
    count
        How many shots the row stands for.
    """

    shot: Shot
    count: int

    @property
    def number(self) -> int:
        """Number of the (first) shot."""
        return self.shot.number

    @property
    def numbers(self) -> str:
        """Number, or first and last: ``1-10``."""
        return str(self.number) if self.count == 1 else f"{self.number}-{self.number + self.count - 1}"

    @property
    def dial(self) -> str:
        """The exposure time as the camera marks it."""
        return self.shot.setting.dial

    @property
    def what(self) -> str:
        """The role in words, with what belongs to it."""
        words: str = self.shot.role
        if self.shot.factor is not None:
            words = f"noisy x{self.shot.factor}"
        if self.shot.level is not None:
            words = f"flat {float(100 * self.shot.level):.0f} %"
        if self.shot.series:
            words = f"{self.shot.series} {words}"
        return words if self.count == 1 else f"{words}, {self.count} frames"

    def as_dict(self) -> dict[str, Any]:
        """Return what the page's script knows of a row."""
        return {"number": self.number, "count": self.count, "iso": self.shot.iso, "dial": self.dial}


def rows(shots: Iterable[Shot]) -> tuple[ChecklistRow, ...]:
    """Return the rows of shots: those in a row that are to be equal in everything are one."""
    groups = [list(group) for _, group in groupby(shots, key=_together)]
    return tuple(ChecklistRow(group[0], len(group)) for group in groups)


def _together(shot: Shot) -> tuple[object, ...]:
    return (shot.role, shot.iso, shot.setting.dial, shot.factor, shot.reference, shot.level, shot.series)


@dataclass(frozen=True, slots=True)
class CalibrationPart:
    """Calibration frames of one kind: ``"bias"``, ``"flats"`` or ``"warm"``, with what to do before."""

    kind: str
    title: str
    items: tuple[Item, ...]
    rows: tuple[ChecklistRow, ...]


_TITLES: Final = {
    "bias": "Bias frames",
    "flats": "Flat-field frames",
    WARM: "With the sensor warm, after the shooting",
}


def part_of(shot: Shot) -> str:
    """Return the kind of calibration frames that a shot belongs to."""
    return "flats" if shot.role == "flat" else shot.series or "bias"


def calibration_parts(plan: Plan) -> tuple[CalibrationPart, ...]:
    """Return the plan's calibration frames by kind, in the order in which they are taken."""
    found: dict[str, list[Shot]] = {}
    for shot in () if plan.calibration is None else plan.calibration.shots:
        found.setdefault(part_of(shot), []).append(shot)
    return tuple(CalibrationPart(kind, _TITLES[kind], _items(kind, plan), rows(shots)) for kind, shots in found.items())


def preparation(plan: Plan) -> tuple[Item, ...]:
    """Return what to do before the first shot."""
    return _items("preparation", plan)


def _items(kind: str, plan: Plan) -> tuple[Item, ...]:
    return tuple(Item(item["name"], _filled(item["text"], plan), item["why"]) for item in _words()[kind])


def at_each_scene(plan: Plan) -> tuple[str, ...]:
    """Return the steps at each scene."""
    return tuple(_filled(text, plan) for text in _words()["at_each_scene"])


def every_item(plan: Plan) -> tuple[Item, ...]:
    """Return everything that can be ticked besides shots."""
    return (*preparation(plan), *(item for part in calibration_parts(plan) for item in part.items))


@cache
def _words() -> Mapping[str, Any]:
    return TextFile(TEMPLATES / "checklist.toml", PlanError).toml().data


def _filled(text: str, plan: Plan) -> str:
    return text.format(
        base_iso=plan.protocol.base_iso,
        files=len(plan.shots),
        raw_extension=plan.camera.raw_extension,
        step=plan.camera.shutter.step,
    )
