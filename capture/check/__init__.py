"""`capture check`: are the frames of each scene what they should be? Measured on the real pixels."""

from capture.check.checking import check
from capture.check.measures import Estimate, Measure, MeasureKind, Remark, Verdict
from capture.check.result import CheckedGroup, CheckedPair, CheckReport, write_sheet

__all__ = [
    "CheckReport",
    "CheckedGroup",
    "CheckedPair",
    "Estimate",
    "Measure",
    "MeasureKind",
    "Remark",
    "Verdict",
    "check",
    "write_sheet",
]
