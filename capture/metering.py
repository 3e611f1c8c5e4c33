"""Scenes that were metered again at the camera, and not in the plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from capture.matching import Match, MatchRemark, match
from eldata.errors import EldataError

if TYPE_CHECKING:
    from fractions import Fraction

    from capture.observed import Observed
    from capture.plan import Plan


def explain_metering(plan: Plan, observed: Observed, found: Match) -> Match:
    """Return a match that says of scenes which lack most of their frames at which other metered time these are there.

    Of the frames that this explains, nothing else is said. Only times of frames at the base ISO are tried: references
    are taken at the metered time.
    """
    used = {frame.path for frame in found.frames.values()}
    left = tuple(frame for frame in observed.frames if frame.path not in used)
    dials = {
        setting.nominal_s: setting.dial
        for frame in left
        if frame.iso == plan.protocol.base_iso and frame.exposure_s
        if (setting := plan.camera.nearest(frame.exposure_s)) is not None
    }
    remarks: list[MatchRemark] = []
    explained: set[Path] = set()
    for scene in plan.scenes:
        count = len(scene.shots)
        if 2 * sum(remark.scene == scene.name for remark in found.missing) <= count:
            continue
        rest = replace(observed, frames=left, unusable=())
        tried = [
            (_frames_at(time_s, plan.only([scene.name]), rest), time_s)
            for time_s in sorted(dials.keys() - {scene.metered_s})
        ]
        frames, time_s = max(tried, key=lambda one: len(one[0]), default=(frozenset[Path](), scene.metered_s))
        if 2 * len(frames) > count:
            text = (
                f"{scene.name}: planned for a metered time of {scene.metered_s} s; {len(frames)} of its {count} frames "
                f"are there if it was metered at {dials[time_s]} s. If so: capture plan PLAN --remeter "
                f"{scene.name}={dials[time_s]}, and this again"
            )
            remarks.append(MatchRemark("metered", text, scene.name))
            explained |= frames
    remarks += [one for one in found.remarks if one.path not in explained or one.kind not in ("extra", "wrong-setting")]
    return replace(found, remarks=tuple(remarks))


def _frames_at(time_s: Fraction, scene: Plan, observed: Observed) -> frozenset[Path]:
    """Return the files that are frames of a plan's scene if it was metered at this time."""
    try:
        again = scene.remeter(scene.scenes[0].name, time_s)
    except EldataError:  # some of its shots are beyond the camera
        return frozenset()
    return frozenset(frame.path for frame in match(again, observed).frames.values())
