"""Plans to make checklists of."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Final

from capture.camera import EXAMPLE, CameraDescription, Shutter
from capture.plan import Plan, make_plan
from capture.protocol import PAPER, RELEASED, CaptureProtocol
from capture.shots import plan_calibration

HOSTILE: Final = (
    '</script><script>alert("x")</script>\'&<img src=https://evil.example/x.png onerror=alert(1)> | *_`\x1b[31m\u202e'
)


def small() -> Plan:
    """Two scenes with notes that mean ill, and calibration frames."""
    calibration = plan_calibration(EXAMPLE, 100, (100, 800), Fraction(1, 2), bias_frames=4)
    plan = make_plan(EXAMPLE, RELEASED, {"scene-1": Fraction(2), "scene-2": Fraction(4)}, calibration)
    return plan.add_note("scene-1", "Bookshelf").add_note("scene-1", HOSTILE)


def _with(shutter: Shutter) -> CameraDescription:
    return replace(EXAMPLE, shutter=shutter)


# Speeds over their names: the first two differ by half a stop, so that frames get other times.
MEASURED: Final = {100: Fraction(9, 10), 800: Fraction(6, 10), 1600: Fraction(4, 5), 3200: Fraction(81, 100)}
# Every kind of shutter; the metered times make possible scenes.
PLANS: Final[dict[str, tuple[CameraDescription, CaptureProtocol, Fraction]]] = {
    "thirds": (EXAMPLE, RELEASED, Fraction(2)),
    "halves": (_with(Shutter.between("1/8000", "30", Fraction(1, 2))), RELEASED, Fraction(2)),
    "stops": (_with(Shutter.between("1/8000", "30", Fraction(1))), PAPER, Fraction(2)),
    "as-named": (
        _with(
            Shutter(("1/9000", "1/3333", "1/1000", "1/100", "1/11", "0.3", "1", "1.1", "4.4"), true_times="as-named")
        ),
        CaptureProtocol(100, (800, 3200), (1, 2, 10)),
        Fraction(1),
    ),
    "bulb": (_with(Shutter.between("1/8000", "30", Fraction(1, 3), bulb_s=300)), RELEASED, Fraction(100)),
    "measured": (
        replace(
            EXAMPLE,
            true_isos=tuple((iso, Fraction(iso) * share) for iso, share in MEASURED.items()),
        ),
        replace(RELEASED, repeats=3, references=2),
        Fraction(2),
    ),
    "two-times": (_with(Shutter(("1/125", "1/100"))), CaptureProtocol(100, (125,), (1,)), Fraction(1, 100)),
}


def plan_of(name: str) -> Plan:
    camera, protocol, metered_s = PLANS[name]
    return make_plan(camera, protocol, {"scene-1": metered_s})
