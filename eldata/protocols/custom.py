"""A protocol of the user's own, as a TOML file: a shipped one to start from, and what is different."""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from eldata.errors import ArgumentError
from eldata.protocols.kinds import IMAGES
from eldata.protocols.named import FAMILIES, PROTOCOLS
from eldata.protocols.protocol import CHOICES, Protocol

_BASE = "base"
_LISTS_OF_TEXT = ("cameras", "scenes")
_NUMBERS = ("data_range", "mse_offset")
_KNOWN = (_BASE, *(field.name for field in fields(Protocol) if field.name != "family"))
# Names that mean something else already.
_TAKEN = ("all", *FAMILIES)


def load_protocol(path: Path | str) -> Protocol:
    """Load a protocol from a TOML file.

    It has ``base``, the name of a shipped protocol, ``name``, ``title``, and any field of :class:`Protocol` that is to
    differ from the base's. ``source`` is by default the base's with the file's name.

    Raises
    ------
    ArgumentError
        If the file cannot be read, a field is unknown, missing or of the wrong type, a value is impossible, or the name
        is a shipped protocol's; the message names file and field.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = tomllib.load(file)
    except OSError as error:
        raise ArgumentError(f"{path}: the protocol cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ArgumentError(f"{path}: is no TOML: {error}") from error
    for name in content:
        if name not in _KNOWN:
            raise ArgumentError(f"{path}: unknown field {name!r}; known are {', '.join(_KNOWN)}")
    for name in (_BASE, "name", "title"):
        if name not in content:
            raise ArgumentError(f"{path}: field {name!r} is missing; a protocol needs base, name and title")
    values = {name: _value(path, name, value) for name, value in content.items()}
    base = values.pop(_BASE)
    if base not in PROTOCOLS:
        raise ArgumentError(f"{path}: base: no protocol is called {base!r}; known are {', '.join(PROTOCOLS)}")
    name = values["name"]
    if name in PROTOCOLS or name in _TAKEN:
        raise ArgumentError(f"{path}: name: {name!r} is the name of a shipped protocol; choose another")
    if not name or not name.isprintable() or name.endswith(".toml"):
        raise ArgumentError(f"{path}: name: expected printable text that does not end in .toml, found {name!r}")
    start = PROTOCOLS[base]
    if start.kind is not IMAGES:
        raise ArgumentError(f"{path}: base: {base!r} scores clips; a protocol of your own starts from one of images")
    made = replace(start, **({"source": f"{path.name}, after {base}: {start.source}", "family": ""} | values))
    try:
        made.check()
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    return made


def _value(path: Path, name: str, value: Any) -> Any:
    """Return a field's value as :class:`Protocol` has it."""

    def refuse(expected: str) -> ArgumentError:
        return ArgumentError(f"{path}: {name}: expected {expected}, found {value!r}")

    if name in CHOICES:
        if value not in CHOICES[name]:
            raise refuse(f"one of {', '.join(map(repr, CHOICES[name]))}")
        return value
    if name in _NUMBERS:
        if not _is_number(value):
            raise refuse("a number")
        return float(value)
    if name == "ratios":
        if not isinstance(value, list) or not all(_is_number(item) and item > 0 for item in value):
            raise refuse("a list of positive numbers, such as [100, 200]; [] for all")
        return tuple(value)
    if name in _LISTS_OF_TEXT:
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise refuse("a list of names; [] for all")
        return tuple(value)
    if not isinstance(value, str):
        raise refuse("text")
    return None if name == "subset" and value == "" else value


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
