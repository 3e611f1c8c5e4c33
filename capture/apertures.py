"""Apertures: as f-numbers, which the plan may state for a scene and EXIF states for each file.

Exposure ratios are computed from ISO and time alone, so one aperture must hold for a scene. A lens without contacts
states none, which is not a mistake.
"""

from __future__ import annotations

from fractions import Fraction
from math import log2
from typing import TYPE_CHECKING, Final

from capture.matching import STOPS_TOLERANCE, MatchRemark
from eldata.base.numbers import counted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capture.matching import Slot
    from capture.observed import ObservedFrame
    from capture.plan import Plan

LEAST_F_NUMBER: Final = Fraction(1, 2)
MOST_F_NUMBER: Final = Fraction(128)


def f_text(f_number: Fraction) -> str:
    """Return an f-number to read: ``f/5.6``."""
    return f"f/{float(f_number):.4g}"


def same_aperture(one: Fraction, other: Fraction) -> bool:
    """Return whether two f-numbers are one setting: names are rounded (f/22 is f/22.6), steps are a third of a stop."""
    return abs(2 * log2(one / other)) <= STOPS_TOLERANCE


def aperture_remarks(plan: Plan, frames: Mapping[Slot, ObservedFrame]) -> tuple[MatchRemark, ...]:
    """Return where files have another aperture than their scene in the plan, or state none."""
    remarks = []
    for scene in plan.scenes:
        if scene.aperture is None:
            continue
        unknown = []
        for shot in scene.shots:
            frame = frames.get((scene.name, shot.number))
            if frame is None:
                continue
            if frame.f_number is None:
                unknown.append(frame.path.name)
            elif not same_aperture(frame.f_number, scene.aperture):
                text = (
                    f"{frame.path.name} ({scene.name} frame {shot.number}): taken at {f_text(frame.f_number)}, where "
                    f"the plan has {f_text(scene.aperture)}: take the scene again; or, if all of it was taken so, "
                    f"correct the plan with capture plan --aperture {scene.name}={float(frame.f_number):.4g}"
                )
                remarks.append(MatchRemark("aperture", text, scene.name, shot.number, frame.path))
        if unknown:
            text = (
                f"{scene.name}: {counted(len(unknown), 'file')} without an aperture, such as {unknown[0]}, so that "
                f"{f_text(scene.aperture)} cannot be checked; a lens without contacts states none"
            )
            remarks.append(MatchRemark("note", text, scene.name))
    return tuple(remarks)
