"""The errors of ``capture``, in the manner of :mod:`eldata.errors`: what, expected, found, what to do."""

from __future__ import annotations

from eldata.errors import EldataError


class CameraError(EldataError):
    """A camera description is malformed, or asked for what the camera does not have."""


class PlanError(EldataError):
    """A capture plan is malformed, or cannot be changed as asked."""


class ImpossibleShotError(PlanError):
    """A shot needs an exposure time that the camera does not have; the message says what to change, computed."""


class MappingError(EldataError):
    """Files cannot be matched to a plan, or a mapping of them is malformed."""
