"""What a checklist says, whatever its format: preparation, each scene's rows, calibration frames."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capture.plan import Plan
    from capture.shots import Shot


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
    """A row with one box to tick: a shot, or successive calibration shots with the same settings.

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
        return words if self.count == 1 else f"{words}, {self.count} frames"

    def as_dict(self) -> dict[str, Any]:
        """Return what the page and its exported progress say of a row."""
        return {
            "number": self.number,
            "count": self.count,
            "role": self.shot.role,
            "iso": self.shot.iso,
            "dial": self.dial,
        }


def rows(shots: Iterable[Shot]) -> tuple[ChecklistRow, ...]:
    """Return the rows of shots: one per shot, but calibration shots with equal settings together."""
    groups = [list(group) for _, group in groupby(shots, key=_together)]
    return tuple(ChecklistRow(group[0], len(group)) for group in groups)


def _together(shot: Shot) -> tuple[object, ...]:
    alone = shot.number if shot.role in ("reference", "noisy") else None
    return (alone, shot.role, shot.iso, shot.setting.dial, shot.level)


def preparation(plan: Plan) -> tuple[Item, ...]:
    """Return what to do before the first shot, and why."""
    camera = plan.camera
    return (
        Item("tripod", "Tripod on firm ground, everything locked", "Half a pixel of movement spoils a pair."),
        Item("release", "Remote release, app or self-timer", "A finger on the camera moves it."),
        Item("manual", "Mode M, automatic ISO off", "Every setting below is dialled by hand."),
        Item("steps", f"Exposure steps of {camera.shutter.step} stop", "The times below are those of this setting."),
        Item(
            "aperture",
            "One aperture for the whole scene",
            "The ratio of two frames is computed from ISO and time alone.",
        ),
        Item("focus", "Manual focus, ring taped", "Autofocus moves the lens between two frames."),
        Item(
            "raw",
            f"Raw ({camera.raw_extension}) in full size, uncompressed or losslessly compressed",
            "Lossy compression changes the noise itself.",
        ),
        Item(
            "long-exposure-nr",
            "Long-exposure noise reduction off",
            "It subtracts a hidden second frame, and doubles the wait.",
        ),
        Item("high-iso-nr", "High-ISO noise reduction off", "Some cameras smooth their raw files too."),
        Item("corrections", "Lens corrections and dual-pixel raw off", "They change the raw values of some cameras."),
        Item("stabiliser", "Image stabilisation off, camera and lens", "On a tripod it lets the picture drift."),
        Item(
            "shutter",
            "Mechanical or electronic shutter: one of them, for scenes and calibration alike",
            "They read the sensor in different ways, with different noise.",
        ),
        Item(
            "lamp",
            "Light that does not flicker (daylight, DC lamp, battery), lamps on for half an hour",
            "Flicker shows as bands at short times; a lamp that warms up changes its brightness.",
        ),
        Item("stray-light", "No screens, status lights or people that move", "Frames of one scene must see one light."),
        Item("white-balance", "White balance fixed, such as daylight", "Previews stay comparable from frame to frame."),
        Item(
            "battery", f"Battery full, a spare at hand, room for {len(plan.shots)} files", "A change moves the camera."
        ),
        Item("clock", "Date and time set", "Files are matched to this list by the order in which they were taken."),
    )


AT_EACH_SCENE: Final = (
    "Compose, lock the head, focus, tape the ring. From here on the camera is not touched.",
    "Meter at ISO {base_iso}: the longest time at which nothing that matters clips. Not the time planned? Enter it.",
    "Take the shots in order, up to the last reference. Change ISO and shutter alone.",
    "If the camera moved or the light changed, take the scene again from its first reference.",
)

BEFORE_BIAS: Final = (
    Item("bias-cap", "Lens cap on, viewfinder covered, dark room", "Light that leaks in lifts the black level."),
    Item("bias-rest", "Camera rested, a pause after each ISO", "Black drifts as the sensor warms up."),
)
BEFORE_FLATS: Final = (
    Item(
        "flat-surface",
        "White paper, wall or screen that fills the frame, evenly lit, without flicker",
        "Flat frames must differ in their noise alone.",
    ),
    Item("flat-focus", "Lens at infinity, surface out of focus", "Paper has a grain, screens have pixels."),
    Item("flat-pairs", "Both frames of a pair one after the other", "The gain is measured from their difference."),
)


def bias_and_flats(plan: Plan) -> tuple[tuple[ChecklistRow, ...], tuple[ChecklistRow, ...]]:
    """Return the rows of the calibration frames; both are empty in a plan without them."""
    shots = () if plan.calibration is None else plan.calibration.shots
    found = rows(shots)
    bias, flats = (tuple(row for row in found if row.shot.role == role) for role in ("bias", "flat"))
    return bias, flats


def at_each_scene(plan: Plan) -> tuple[str, ...]:
    """Return the steps at each scene."""
    return tuple(text.format(base_iso=plan.protocol.base_iso) for text in AT_EACH_SCENE)


def every_item(plan: Plan) -> tuple[Item, ...]:
    """Return all that can be ticked besides shots."""
    return (*preparation(plan), *(() if plan.calibration is None else (*BEFORE_BIAS, *BEFORE_FLATS)))
