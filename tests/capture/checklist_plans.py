"""Plans to make checklists of."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Final

from capture.camera import EXAMPLE, CameraDescription, Shutter
from capture.plan import Plan, make_plan
from capture.protocol import RELEASED, CaptureProtocol
from capture.shots import plan_calibration

HOSTILE: Final = (
    '</script><script>alert("x")</script>\'&<img src=https://evil.example/x.png onerror=alert(1)> | *_`\x1b[31m\u202e'
)


def small() -> Plan:
    """Two scenes with notes that mean ill, and calibration frames."""
    calibration = plan_calibration(EXAMPLE, 100, (100, 800), Fraction(1, 2), bias_frames=4)
    plan = make_plan(EXAMPLE, RELEASED, {"scene-1": Fraction(2), "scene-2": Fraction(4)}, calibration)
    return plan.add_note("scene-1", "Bookshelf").add_note("scene-1", HOSTILE)


# Speeds over their names: the first two differ by half a stop, so that frames get other times.
MEASURED: Final = {100: Fraction(9, 10), 800: Fraction(6, 10), 1600: Fraction(4, 5), 3200: Fraction(81, 100)}
# Listed times, bulb, and measured speeds; the metered times make possible scenes.
NAMES: Final = ("1/9000", "1/3333", "1/1000", "1/100", "1/11", "0.3", "1", "1.1", "4.4")
LISTED: Final = Shutter(NAMES, true_times="as-named")
BULB: Final = Shutter.between("1/8000", "30", Fraction(1, 3), bulb_s=300)
SPEEDS: Final = tuple((iso, Fraction(iso) * share) for iso, share in MEASURED.items())
PLANS: Final[dict[str, tuple[CameraDescription, CaptureProtocol, Fraction]]] = {
    "as-named": (replace(EXAMPLE, shutter=LISTED), CaptureProtocol(100, (800, 3200), (1, 2, 10)), Fraction(1)),
    "bulb": (replace(EXAMPLE, shutter=BULB), RELEASED, Fraction(100)),
    "measured": (replace(EXAMPLE, true_isos=SPEEDS), replace(RELEASED, repeats=3, references=2), Fraction(2)),
}


def plan_of(name: str) -> Plan:
    camera, protocol, metered_s = PLANS[name]
    return make_plan(camera, protocol, {"scene-1": metered_s})
