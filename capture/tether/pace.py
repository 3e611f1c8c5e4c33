"""How long the frames that are left will take."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from capture.shots import minutes

if TYPE_CHECKING:
    from collections.abc import Container

    from capture.matching import Slot
    from capture.plan import Plan
    from capture.shots import Shot


class Pace:
    """How long a frame takes beyond its exposure, by those that were taken."""

    def __init__(self) -> None:
        self.overheads_s: list[float] = []
        self.begun = 0.0

    def begin(self) -> None:
        """Note that a frame is begun."""
        self.begun = time.monotonic()

    def end(self, shot: Shot) -> None:
        """Note that it is here."""
        self.overheads_s.append(max(0.0, time.monotonic() - self.begun - shot.setting.true_s))

    def text(self, plan: Plan, have: Container[Slot]) -> str:
        """Return how long the shots that a plan lacks will take, to read, without what is to be prepared."""
        left = [shot for scene, shot in plan.shots if (scene, shot.number) not in have]
        if not left:
            return ""
        overhead_s = sum(self.overheads_s) / len(self.overheads_s)
        return f"  {minutes(sum(shot.setting.true_s + overhead_s for shot in left))} left"
