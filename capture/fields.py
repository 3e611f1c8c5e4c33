"""Typed values out of a JSON file, each error naming file and field, what was expected and what was found."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capture.exact import parse_seconds
from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Collection
    from fractions import Fraction
    from pathlib import Path

_LARGEST: Final = 10**9
_ABSENT: Final = object()


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is no JSON number")


@dataclass(frozen=True, slots=True)
class Fields:
    """An object of a JSON file.

    Attributes
    ----------
    path, error
        The file, and the kind of error to raise.
    place
        Where in the file the object stands, such as ``scenes[0]``; empty at the top.
    data
        Its content.
    """

    path: Path
    error: type[EldataError]
    place: str
    data: dict[str, Any]

    @classmethod
    def of_file(cls, path: Path, error: type[EldataError]) -> Fields:
        """Read a JSON file whose top is an object."""
        try:
            data = json.loads(path.read_bytes().decode("utf-8-sig"), parse_constant=_refuse_constant)
        except OSError as problem:
            raise error(f"{path}: cannot be read: {problem.strerror}") from problem
        except (ValueError, RecursionError) as problem:
            raise error(f"{path}: is not JSON ({problem})") from problem
        if not isinstance(data, dict):
            raise error(f"{path}: expected a JSON object, found {_short(data)}")
        return cls(path, error, "", data)

    def wrong(self, name: str, expected: str, found: object) -> EldataError:
        """Return the error that a field is wrong, to be raised."""
        return self.error(f"{self.path}, field {self._named(name)}: expected {expected}, found {_short(found)}")

    def _named(self, name: str) -> str:
        return f"{self.place}.{name}" if self.place else name

    def only(self, known: Collection[str]) -> None:
        """Refuse fields of unknown names, which would be ignored where they are a misspelling."""
        for key in self.data:
            if key not in known:
                raise self.wrong(key, f"one of the fields {', '.join(known)}", key)

    def value(self, name: str) -> Any:
        """Return a field that must be there."""
        if name not in self.data:
            raise self.error(f"{self.path}, field {self._named(name)}: is missing")
        return self.data[name]

    def schema(self, number: int) -> None:
        """Refuse another schema number."""
        found = self.value("schema")
        if found != number or isinstance(found, bool):
            raise self.wrong("schema", f"{number} (a newer file needs a newer capture)", found)

    def inside(self, name: str, value: Any = _ABSENT) -> Fields:
        """Return an object that stands in a field; ``name`` may be an element such as ``scenes[0]``."""
        found = self.value(name) if value is _ABSENT else value
        if not isinstance(found, dict):
            raise self.wrong(name, "an object", found)
        return Fields(self.path, self.error, self._named(name), found)

    def items(self, name: str) -> list[Any]:
        """Return a list."""
        found = self.value(name)
        if not isinstance(found, list):
            raise self.wrong(name, "a list", found)
        return found

    def text(self, name: str, value: Any = _ABSENT) -> str:
        """Return a text that is not empty."""
        found = self.value(name) if value is _ABSENT else value
        if not isinstance(found, str) or not found.strip():
            raise self.wrong(name, "a text", found)
        return found

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a list of texts."""
        items = self.items(name)
        for index, item in enumerate(items):
            if not isinstance(item, str) or not item.strip():
                raise self.wrong(f"{name}[{index}]", "a text", item)
        return tuple(items)

    def whole(self, name: str, value: Any = _ABSENT) -> int:
        """Return a whole number above 0."""
        found = self.value(name) if value is _ABSENT else value
        if not isinstance(found, int) or isinstance(found, bool) or not 0 < found <= _LARGEST:
            raise self.wrong(name, "a whole number above 0", found)
        return found

    def wholes(self, name: str) -> tuple[int, ...]:
        """Return a list of whole numbers above 0, at least one, each once."""
        items = self.items(name)
        if not items:
            raise self.wrong(name, "at least one whole number", items)
        for index, item in enumerate(items):
            if not isinstance(item, int) or isinstance(item, bool) or not 0 < item <= _LARGEST:
                raise self.wrong(f"{name}[{index}]", "a whole number above 0", item)
            if item in items[:index]:
                raise self.wrong(f"{name}[{index}]", "each number once", item)
        return tuple(items)

    def seconds(self, name: str, value: Any = _ABSENT) -> Fraction:
        """Return seconds, which stand as text so that they are exact."""
        found = self.value(name) if value is _ABSENT else value
        if not isinstance(found, str):
            raise self.wrong(name, 'seconds as text, such as "1/2"', found)
        try:
            return parse_seconds(found)
        except ArgumentError:
            raise self.wrong(name, 'seconds above 0 as text, such as "1/2"', found) from None


def _short(found: object) -> str:
    text = repr(found)
    return text if len(text) <= 80 else f"{text[:77]}..."
