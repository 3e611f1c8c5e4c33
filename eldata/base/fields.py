"""The one reader of text files: JSON, TOML and CSV to checked values, numbers in text bounded before they are parsed.

::

    top = TextFile(path, ProfileError).json()
    top.only(names_of(CameraProfile))
    camera = top.text("camera")
    rows = [ProfileRow(row.number("iso", above=0), row.optional("note", row.text)) for row in top.objects("rows")]

Whatever a file holds, what comes out is a value or the caller's own error: file, field, expected, found, what to do.
"""

from __future__ import annotations

import csv
import gc
import io
import json
import math
import sys
import tomllib
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cache, partial
from itertools import islice
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar, overload

from eldata.base.files import file_problem
from eldata.base.numbers import LARGEST_WHOLE, number_of, whole_of
from eldata.base.tables import text_of_cell
from eldata.base.visible import NOTHING, has_unseen, in_line, named_field, shown
from eldata.errors import ArgumentError, EldataError, FileError, nearest

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

Value = TypeVar("Value")

LARGEST_FILE_BYTES: Final = 256 << 20
_ROWS_AT_ONCE: Final = 1024


def named_object(place: str) -> Any:
    """Import the object that ``package.module:name`` names; modules of the current folder are found.

    Raises
    ------
    ArgumentError
        If the text is not such a name, or the object cannot be imported.
    """
    if not all(place.partition(":")):
        raise ArgumentError(f"{place!r} names nothing in a module; expected package.module:name")
    if "" not in sys.path and str(Path.cwd()) not in sys.path:  # as python -m does
        sys.path.insert(0, str(Path.cwd()))
    try:
        return resolve_name(place)
    except Exception as error:  # whatever the module does as it is imported
        raise ArgumentError(in_line(f"{place}: cannot be imported: {type(error).__name__}: {error}")) from error


@contextmanager
def no_search_for_cycles() -> Iterator[None]:
    """Keep the interpreter from searching millions of new objects, none of them part of a cycle, again and again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def names_of(record: type) -> tuple[str, ...]:
    """Return the names of a dataclass's fields, for :meth:`Fields.only`."""
    return tuple(item.name for item in fields(record))


@cache
def shipped_toml(path: Path) -> Mapping[str, Any]:
    """Return the content of a TOML file that lies beside the code, read once."""
    return TextFile(path, ArgumentError).toml().data


# --- whole files --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TextFile:
    """A text file, and how its problems are reported.

    Attributes
    ----------
    name
        Its path; or what messages call it, if ``content`` is given.
    error
        The error to raise: a :class:`~eldata.errors.FileError`, or one that takes a single message.
    advice
        What to do about it; every message ends with it.
    content
        Its content, if that is already available.
    largest_bytes
        Larger files are refused before they are read.
    """

    name: Path | str
    error: type[EldataError]
    advice: str = ""
    content: bytes | None = None
    largest_bytes: int = LARGEST_FILE_BYTES

    def problem(self, reason: str, place: str = "") -> EldataError:
        """Make the error, to be raised, about a place in the file such as ``field rows[0].iso``."""
        reason = f"{reason}; {self.advice}" if self.advice else reason
        if issubclass(self.error, FileError):
            return self.error(self.name, f"{place}: {reason}" if place else reason)
        return self.error(f"{self.name}, {place}: {reason}" if place else f"{self.name}: {reason}")

    def text(self, kind: str = "text") -> str:
        """Return the file's text, without a byte order mark; ``kind`` is what it should be, for messages.

        Raises
        ------
        EldataError
            The file's, if it cannot be read, is too large, or is not UTF-8.
        """
        content = self.read()
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise self.problem(f"is not {kind}: its byte {error.start} is not UTF-8") from error

    def read(self) -> bytes:
        """Read the file's bytes.

        Raises
        ------
        EldataError
            The file's, if it cannot be read or is too large.
        """
        if self.content is not None:
            return self.content
        path = Path(self.name)
        problem = file_problem(path)
        if problem is None and path.stat().st_size > self.largest_bytes:
            problem = f"expected at most {self.largest_bytes >> 20} MiB, found more; is it the right file?"
        if problem is not None:
            raise self.problem(problem)
        return path.read_bytes()

    def json(self) -> Fields:
        """Parse the file as one JSON object.

        Raises
        ------
        EldataError
            The file's, as :meth:`text` raises it; or if it is not complete JSON, uses a name twice or a constant that
            JSON does not have, is nested too deeply, or is not an object.
        """
        return self._parse_as(
            "JSON", partial(json.loads, object_pairs_hook=_build_object, parse_constant=_refuse_constant)
        )

    def toml(self) -> Fields:
        """Parse the file as TOML.

        Raises
        ------
        EldataError
            The file's, as :meth:`text` raises it; or if it is not TOML, or is nested too deeply.
        """
        return self._parse_as("TOML", tomllib.loads)

    def _parse_as(self, kind: str, parse: Callable[[str], object]) -> Fields:
        """Parse the file's text as ``kind``, JSON or TOML; a parser's error becomes the file's."""
        text = self.text(kind)
        try:
            data = parse(text)
        except json.JSONDecodeError as error:
            raise self.problem(f"is not JSON, or not whole ({error.msg} in line {error.lineno})") from error
        except RecursionError:
            raise self.problem(f"is not {kind} that can be read: it is nested too deeply") from None
        except ValueError as error:  # also of a number of too many digits
            raise self.problem(f"is not {kind} that can be read: {error}") from error
        return self.fields(data)

    def fields(self, data: object) -> Fields:
        """Return parsed data as fields; it must be an object."""
        if not isinstance(data, dict):
            raise self.problem(f"expected an object, found {shown(data)}")
        return Fields(self, data)

    def rows(self, columns: Sequence[str]) -> Iterator[TextRow]:
        """Yield the rows of a CSV file whose first line names these columns; raises like :meth:`columns`."""
        for lines, cells in self.columns(columns):
            for line, *texts in zip(lines, *cells, strict=True):
                yield TextRow(self, dict(zip(columns, texts, strict=True)), f"line {line}")

    def columns(self, columns: Sequence[str]) -> Iterator[tuple[tuple[int, ...], list[tuple[str, ...]]]]:
        """Yield some rows of a CSV file at a time, by columns: the lines on which they end, and each column's cells.

        Raises
        ------
        EldataError
            The file's, as :meth:`text` raises it; or if it is not CSV, has other columns, or a row of another length.
        """
        content = self.read()
        # Decoded as it is needed: there may be many rows.
        reader = csv.reader(io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", newline=""), strict=True)
        quoted = b"'" in content
        try:
            header: list[str] = next(reader, [])
            if header != [*columns]:
                names = shown(",".join(header), longest=400)
                raise self.problem(f"expected the columns {','.join(columns)}; found {names}", "line 1")
            while rows := [(reader.line_num, *cells) for cells in islice(reader, _ROWS_AT_ONCE)]:
                for line, *cells in rows if {*map(len, rows)} != {len(columns) + 1} else ():
                    if len(cells) != len(columns):
                        reason = f"expected {len(columns)} fields, found {len(cells)}"
                        raise self.problem(reason, f"line {line}")
                lines, *texts = zip(*rows, strict=True)
                yield lines, [tuple(map(text_of_cell, cells)) for cells in texts] if quoted else texts
        except UnicodeDecodeError:
            self.text("CSV")  # says where
            raise
        except csv.Error as error:
            raise self.problem(f"is not CSV ({error})", f"line {reader.line_num}") from error


def _refuse_constant(name: str) -> float:
    """Refuse NaN and infinities, which Python's JSON parser would accept."""
    raise ValueError(f"it holds {name}, expected finite numbers")


def _build_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON object; refuse one with a name twice, which the grammar allows."""
    data = dict(pairs)
    if len(data) < len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"an object has the field {named_field(twice)} twice")
    return data


# --- fields -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Fields:
    """An object of a file. Every method raises the file's error, which names the field.

    Attributes
    ----------
    file
        The file.
    data
        The object's content.
    place
        Where in the file it stands, such as ``scenes[0]``; empty at the top.
    """

    file: TextFile
    data: Mapping[str, Any]
    place: str = ""

    _absent: ClassVar[tuple[object, ...]] = (None,)
    _is_text: ClassVar[bool] = False  # whether numbers are texts

    def problem(self, name: str, reason: str) -> EldataError:
        """Make the error, to be raised, about a field."""
        return self.file.problem(reason, self._name_place(name))

    def wrong(self, name: str, expected: str, value: object) -> EldataError:
        """Make the error, to be raised, about a field that holds something unexpected."""
        return self.problem(name, f"expected {expected}, found {shown(value)}")

    def _name_place(self, name: str) -> str:
        """Name a field's place in the file for messages."""
        return f"field {self._join_name(name)}"

    def _join_name(self, name: str) -> str:
        """Join this object's place and a field's name: ``rows[0].iso``."""
        return f"{self.place}.{named_field(name)}" if self.place else named_field(name)

    # --- which fields there are ---------------------------------------------------------------------------------------

    def only(self, known: Collection[str]) -> None:
        """Refuse fields with other names: a misspelt one would be ignored."""
        for name in self.data:
            if name not in known:
                near = nearest(name, known, alike=0.75)
                hint = f" (did you mean {near}?)" if near else ""
                raise self.problem(name, f"is unknown{hint}; known are {', '.join(known)}")

    def value(self, name: str) -> Any:
        """Return a field that must be there, whatever it holds."""
        if name not in self.data:
            raise self.problem(name, "is missing")
        return self.data[name]

    @overload
    def optional(self, name: str, read: Callable[..., Value], default: Value, **options: Any) -> Value: ...
    @overload
    def optional(self, name: str, read: Callable[..., Value], **options: Any) -> Value | None: ...
    def optional(
        self, name: str, read: Callable[..., Value], default: Value | None = None, **options: Any
    ) -> Value | None:
        """Return ``read(name, **options)``; the default where the field is not there, null, or an empty cell."""
        return default if self.data.get(name) in self._absent else read(name, **options)

    def schema(self, number: int, program: str = "eldata", *, also: tuple[int, ...] = ()) -> int:
        """Return the schema number; refuse an unknown one."""
        value = self.data.get("schema", NOTHING)
        known = (number, *also)
        if type(value) is not int or value not in known:
            listed = " or ".join(map(str, known))
            raise self.wrong("schema", f"{listed} (a newer file needs a newer {program})", value)
        return value

    # --- objects and lists --------------------------------------------------------------------------------------------

    def inside(self, name: str) -> Fields:
        """Return the fields of an object within this one."""
        return Fields(self.file, self._require_type(name, dict, "an object"), self._join_name(name))

    def _require_type(self, name: str, kind: type[Value], expected: str) -> Value:
        """Return a field's value of this Python type; refuse a missing field, or another type."""
        value = self.data.get(name, NOTHING)
        if not isinstance(value, kind):
            raise self.wrong(name, expected, value)
        return value

    def each(
        self, name: str, read: Callable[..., Value], *,
        expected: str = "a list", count: int | None = None, fewest: int = 0, once: bool = False,
        missing_ok: bool = False, **options: Any,
    ) -> tuple[Value, ...]:  # fmt: skip
        """Return ``read(fields, element, **options)`` of each element of a list; ``read`` is a method of this class.

        Parameters
        ----------
        name, read
            The list's name; such as ``Fields.text``.
        expected
            What the list should be, for messages.
        count, fewest
            How many elements it has; how many it has at least.
        once
            Whether each value may stand in it only once.
        missing_ok
            Whether a missing list counts as empty.
        """
        items = self.data.get(name, [] if missing_ok else NOTHING)
        if not isinstance(items, list) or len(items) < fewest or (count is not None and len(items) != count):
            raise self.wrong(name, expected, items)
        inner = Fields(self.file, {f"{name}[{index}]": item for index, item in enumerate(items)}, self.place)
        values = tuple(read(inner, element, **options) for element in inner.data)
        if once:
            first = {value: at for at, value in reversed(list(enumerate(values)))}
            for at, value in enumerate(values):
                if first[value] != at:
                    raise self.wrong(f"{name}[{at}]", "each value once", value)
        return values

    def objects(self, name: str, **options: Any) -> tuple[Fields, ...]:
        """Return a list of objects; options as in :meth:`each`."""
        return self.each(name, Fields.inside, **{"expected": "a list of objects"} | options)

    def texts(self, name: str, **options: Any) -> tuple[str, ...]:
        """Return a list of texts; options as in :meth:`each` and :meth:`text`."""
        return self.each(name, Fields.text, **{"expected": "a list of texts"} | options)

    # --- values -------------------------------------------------------------------------------------------------------

    def text(self, name: str, *, empty: bool = False, unseen: bool = False) -> str:
        """Return a text; one that is blank only if ``empty``, with characters that do not show only if ``unseen``."""
        text = self._require_type(name, str, "a text")
        if not (empty or text.strip()):
            raise self.wrong(name, "a text", text)
        if not unseen and has_unseen(text, lines=True):
            raise self.wrong(name, "a text without control characters and others that do not show", text)
        return text

    def choice(self, name: str, known: Collection[Value]) -> Value:
        """Return a value; refuse an unknown one."""
        value = self.data.get(name, NOTHING)
        for choice in known:
            if value == choice and type(value) is type(choice):
                return choice
        listed = ", ".join(map(shown, known))
        raise self.wrong(name, listed if len(known) == 1 else f"one of {listed}", value)

    def flag(self, name: str) -> bool:
        """Return true or false."""
        return self._require_type(name, bool, "true or false")

    def whole(self, name: str, *, at_least: int = 0, at_most: int = LARGEST_WHOLE) -> int:
        """Return a whole number."""
        return self.parsed(name, whole_of, at_least=at_least, at_most=at_most, text=self._is_text)

    def number(self, name: str, *, at_least: float = -math.inf, above: float = -math.inf) -> float:
        """Return a finite number."""
        return self.parsed(name, number_of, at_least=at_least, above=above, text=self._is_text)

    def parsed(self, name: str, parse: Callable[..., Value], **options: Any) -> Value:
        """Return ``parse(value, **options)``; its :class:`~eldata.errors.ArgumentError` becomes the file's error."""
        try:
            return parse(self.data.get(name, NOTHING), **options)
        except ArgumentError as error:
            raise self.problem(name, str(error)) from None


@dataclass(frozen=True, slots=True)
class TextRow(Fields):
    """A row of a CSV file; numbers are parsed from the cells' text, and an empty cell counts as missing."""

    _absent: ClassVar[tuple[object, ...]] = ("",)
    _is_text: ClassVar[bool] = True

    def _name_place(self, name: str) -> str:
        """Name a field's place in the file for messages."""
        return f"{self.place}, column {name}"
