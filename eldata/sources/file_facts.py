"""What raw files state, as JSON in stores and shards: written in one way, and checked as it is read."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile, fraction_of
from eldata.errors import ArgumentError
from eldata.records import Exposure, Sensor

if TYPE_CHECKING:
    from collections.abc import Mapping
    from fractions import Fraction


def parsed(what: str, content: str | bytes) -> dict[str, Any]:
    """Return a JSON object; an :class:`~eldata.errors.ArgumentError` says what is wrong with it."""
    return dict(TextFile(what, ArgumentError, content=content).json().data)


def exposure_data(exposure: Exposure) -> dict[str, str | None]:
    """Return an exposure as plain types; fractions as text, so that they stay exact."""
    return {name: None if value is None else str(value) for name, value in asdict(exposure).items()}


def exposure_of(data: Mapping[str, Any]) -> Exposure:
    """Return the exposure that :func:`exposure_data` wrote; ArgumentError or TypeError if it is something else."""
    return Exposure(**{name: exact(text) for name, text in data.items()})


def sensor_of(data: Mapping[str, Any]) -> Sensor:
    """Return the sensor whose fields these are; TypeError if they are others."""
    return Sensor(**{name: _tuples(value) for name, value in data.items()})


def exact(text: str | None) -> Fraction | None:
    """Return the fraction that a text names, its digits bounded before they are parsed."""
    return None if text is None else fraction_of(text, digits=40)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
