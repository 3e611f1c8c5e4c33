"""A protocol of the user's own, as a TOML file: a shipped one to start from, and what is different."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.visible import shown
from eldata.errors import ArgumentError
from eldata.protocols.kinds import IMAGES
from eldata.protocols.named import FAMILIES, PROTOCOLS
from eldata.protocols.protocol import CHOICES, Protocol

_BASE = "base"
_LISTS_OF_TEXT = ("cameras", "scenes")
_NUMBERS = ("data_range", "mse_offset")
_KNOWN = (_BASE, *(name for name in names_of(Protocol) if name != "family"))
_LARGEST_BYTES = 1 << 20
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
    top = TextFile(path, ArgumentError, largest_bytes=_LARGEST_BYTES).toml()
    top.only(_KNOWN)
    for name in (_BASE, "name", "title"):
        if name not in top.data:
            raise top.problem(name, "is missing; a protocol needs base, name and title")
    values = {name: _value(top, name) for name in top.data}
    base = values.pop(_BASE)
    name = values["name"]
    if name in PROTOCOLS or name in _TAKEN:
        raise top.problem("name", f"{shown(name)} is the name of a shipped protocol; choose another")
    if not name.isprintable() or name.endswith(".toml"):
        raise top.wrong("name", "printable text that does not end in .toml", name)
    start = PROTOCOLS[base]
    if start.kind is not IMAGES:
        raise ArgumentError(f"{path}: base: {base!r} scores clips; a protocol of your own starts from one of images")
    made = replace(start, **({"source": f"{path.name}, after {base}: {start.source}", "family": ""} | values))
    try:
        made.check()
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    return made


def _ratio(top: Fields, name: str) -> Any:
    top.number(name, above=0)
    return top.value(name)  # whole where it is: the digest tells 100 from 100.0


def _value(top: Fields, name: str) -> Any:
    """Return a field's value as :class:`Protocol` has it."""
    if name == _BASE:
        return top.choice(name, tuple(PROTOCOLS))
    if name in CHOICES:
        return top.choice(name, CHOICES[name])
    if name in _NUMBERS:
        return top.number(name)
    if name == "ratios":
        return top.each(name, _ratio, expected="a list of positive numbers, such as [100, 200]; [] for all")
    if name in _LISTS_OF_TEXT:
        return top.texts(name, expected="a list of names; [] for all", empty=True)
    if name == "subset":
        return top.text(name, empty=True) or None
    return top.text(name, empty=name not in ("name", "title"))
