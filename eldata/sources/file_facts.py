"""What raw files state, as JSON in stores and shards: written in one way, and checked as it is read.

A sensor is written with levels, white balance and matrix as floats; beside it, where there is any, what such a record
has no room for (:func:`more_of_sensor`).
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from eldata.base.numbers import fraction_of
from eldata.errors import ArgumentError
from eldata.records import D65, ExactFloat, Exposure, Sensor, exact_fraction, exact_number

if TYPE_CHECKING:
    from collections.abc import Mapping
    from fractions import Fraction


_EXACT = ("black_level_dn", "white_level_dn", "white_balance", "xyz_to_camera")


def exposure_data(exposure: Exposure) -> dict[str, str | None]:
    """Return an exposure as plain types; fractions as text, so that they stay exact."""
    return {name: None if value is None else str(value) for name, value in asdict(exposure).items()}


def exposure_of(data: Mapping[str, Any]) -> Exposure:
    """Return the exposure that :func:`exposure_data` wrote; ArgumentError or TypeError if it is something else."""
    return Exposure(**{name: exact(text) for name, text in data.items()})


def sensor_data(sensor: Sensor) -> dict[str, Any]:
    """Return a sensor as plain types, without its light; fractions as the nearest floats."""
    return {name: value for name, value in asdict(sensor).items() if name != "matrix_illuminant"}


def more_of_sensor(sensor: Sensor) -> dict[str, Any]:
    """Return what :func:`sensor_data` leaves out: fractions that floats do not hold, as text, and another light."""
    fields = {name: getattr(sensor, name) for name in _EXACT}
    more = {name: _texts(value) for name, value in fields.items() if _has_fractions(value)}
    return more if sensor.matrix_illuminant == D65 else more | {"matrix_illuminant": sensor.matrix_illuminant}


def sensor_of(data: Mapping[str, Any], more: Mapping[str, Any]) -> Sensor:
    """Return the sensor that :func:`sensor_data` and :func:`more_of_sensor` wrote; TypeError if it is something else.

    Raises
    ------
    ArgumentError
        If a fraction is not what its float is nearest to, or the light not a whole number of 16 bits.
    """
    sensor = Sensor(**{name: _tuples(value) for name, value in data.items()})
    fractions = {name: _numbers(value) for name, value in more.items() if name != "matrix_illuminant"}
    for name, value in fractions.items():
        if name not in _EXACT or value != getattr(sensor, name):
            raise ArgumentError(f"{name}: expected fractions beside a float of the sensor, found {more[name]}")
    light = more.get("matrix_illuminant", D65)
    if type(light) is not int or not 0 <= light < 1 << 16:
        raise ArgumentError(f"matrix_illuminant: expected a whole number of 16 bits, found {light!r}")
    return replace(sensor, **fractions, matrix_illuminant=light)


def exact(text: str | None) -> Fraction | None:
    """Return the fraction that a text names, its digits bounded before they are parsed."""
    return None if text is None else fraction_of(text, digits=40)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _has_fractions(value: Any) -> bool:
    return any(map(_has_fractions, value)) if isinstance(value, tuple) else isinstance(value, ExactFloat)


def _texts(value: Any) -> Any:
    return list(map(_texts, value)) if isinstance(value, tuple) else str(exact_fraction(value))


def _numbers(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_numbers, value))
    text = str(value)
    size = fraction_of(text.removeprefix("-"), digits=40)
    return exact_number(-size if text.startswith("-") else size)
