"""Flats are exposed until their level is right: the first one tells when the surface really clips."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from capture.calibration import plan_calibration
from capture.capture_errors import PlanError, TetherError

if TYPE_CHECKING:
    from capture.plan import Plan
    from capture.shots import Shot
    from capture.tether.levels import Levels

TRIES: Final = 6
NEVER_RIGHT: Final = (
    f"the first flat was taken {TRIES} times and never had the level that is wanted: does the light change, or does "
    "something cover the lens? Then run the same command again"
)
_MOST_AT_ONCE: Final = 8.0  # a clipped or dark frame tells only the direction
_CLIPPED: Final = 0.01


def clips_at_s(plan: Plan, shot: Shot, levels: Levels) -> Fraction | None:
    """Return when the surface clips at the base ISO, by a flat of the plan; ``None`` if that flat's level is right.

    Right is what the plan's rounding down to the camera's steps allows, and half a step beyond either end.
    """
    if plan.calibration is None or shot.level is None:
        return None
    wanted, step = float(shot.level), float(plan.camera.shutter.step)
    clipped = levels.clipped > _CLIPPED
    if not clipped and 2 ** (-1.5 * step) <= levels.mean / wanted <= 2 ** (0.5 * step):
        return None
    brighter = _MOST_AT_ONCE if clipped else max(levels.mean / wanted, 1 / _MOST_AT_ONCE)
    speed = float(plan.camera.speed(shot.iso) / plan.camera.speed(plan.protocol.base_iso))
    found_s = shot.setting.true_s * speed / wanted / min(brighter, _MOST_AT_ONCE)
    return Fraction(f"{found_s:.3g}")


def with_flats(plan: Plan, flat_clips_at_s: Fraction) -> Plan:
    """Return the plan with its flats exposed for a surface that clips at another time.

    Raises
    ------
    TetherError
        If the camera cannot expose them so; the message says what to change.
    """
    before = plan.calibration
    if before is None:
        return plan
    try:
        after = plan_calibration(
            plan.camera,
            plan.protocol.base_iso,
            before.isos,
            flat_clips_at_s,
            bias_frames=before.bias_frames,
            flat_levels=before.flat_levels,
            dark=before.dark,
            dark_frames=before.dark_frames,
            warm=before.warm,
        )
    except PlanError as error:
        raise TetherError(f"by its first flat the surface clips at {float(flat_clips_at_s):g} s: {error}") from None
    if len(after.shots) != len(before.shots):
        raise TetherError(
            f"by its first flat the surface clips at {float(flat_clips_at_s):g} s, and the camera's steps then leave "
            f"{len(after.shots)} calibration frames where the plan has {len(before.shots)}: change the light, or plan "
            "the calibration frames again with --flat-clips-at"
        )
    return replace(plan, calibration=after)
