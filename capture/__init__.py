"""Photograph scenes for a low-light denoising dataset: the protocol, the plan, the shots, and what became of them.

A sibling of :mod:`eldata` that needs neither a decoder nor a tensor library to plan.
"""

from capture.calibration import CalibrationPlan, plan_calibration
from capture.camera import CameraDescription, Shutter, ShutterTime
from capture.plan import Plan, ScenePlan, make_plan
from capture.protocol import PAPER, PROTOCOLS, RELEASED, CaptureProtocol, ProtocolFrame
from capture.shots import Shot

__all__ = [
    "PAPER",
    "PROTOCOLS",
    "RELEASED",
    "CalibrationPlan",
    "CameraDescription",
    "CaptureProtocol",
    "Plan",
    "ProtocolFrame",
    "ScenePlan",
    "Shot",
    "Shutter",
    "ShutterTime",
    "make_plan",
    "plan_calibration",
]
