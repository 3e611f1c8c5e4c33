"""`capture check`: are the frames of each scene what they should be? Measured on the real pixels."""

from capture.check.checking import check
from capture.check.result import CheckedGroup, CheckReport, Measure, write_sheet

__all__ = ["CheckReport", "CheckedGroup", "Measure", "check", "write_sheet"]
