"""The manifest's table: CSV text to :class:`~eldata.records.FrameRecord` and back."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from fractions import Fraction
from operator import attrgetter
from typing import TYPE_CHECKING, Any, get_args

from eldata.base.fields import TextFile, TextRow, names_of, no_search_for_cycles
from eldata.base.files import encoded, path_problem, write_text
from eldata.base.tables import csv_text
from eldata.base.visible import shown
from eldata.errors import ArgumentError, ManifestError
from eldata.records import FrameRecord, Records, Role, from_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

COLUMNS = names_of(FrameRecord)
ROLES: tuple[Role, ...] = get_args(Role)

_LARGEST_BYTES = 1 << 30  # millions of rows
_MOST_DECIMALS = 9
_SHA256 = re.compile(r"sha256:[0-9a-f]{64}")
_NAME = re.compile(r"[\w.+-]{1,255}")


def number_text(value: Fraction) -> str:
    """Return a fraction as exact text: ``800``, ``0.005`` where at most nine decimals do, else ``1/30``."""
    digits = next((digits for digits in range(_MOST_DECIMALS + 1) if 10**digits % value.denominator == 0), None)
    if digits is None:
        return f"{value.numerator}/{value.denominator}"
    text = str(int(abs(value) * 10**digits)).rjust(digits + 1, "0")
    sign = "-" if value < 0 else ""
    return f"{sign}{text[:-digits]}.{text[-digits:]}" if digits else f"{sign}{text}"


def load_records(path: Path) -> tuple[FrameRecord, ...]:
    """Read a manifest's rows.

    Raises
    ------
    ManifestError
        If the file cannot be read or a row is malformed; the message names file, line and column, what was expected
        and what was found.
    """
    return load_table(path)[0]


def load_table(path: Path, content: bytes | None = None) -> tuple[tuple[FrameRecord, ...], str]:
    """Read a manifest's rows as :func:`load_records` does, and ``sha256:<hex>`` of the bytes that they stand in.

    They are read from ``content``, if that is given.
    """
    file = TextFile(path, ManifestError, content=content, largest_bytes=_LARGEST_BYTES)
    content = file.read()
    return _parse(replace(file, content=content)), f"sha256:{hashlib.sha256(content).hexdigest()}"


def _parse(file: TextFile) -> tuple[FrameRecord, ...]:
    """Return the rows, sorted by path: by columns, which is fast; if something is wrong, by rows, to say where."""
    records: list[FrameRecord] = []
    try:
        with no_search_for_cycles():
            _by_columns(file, records)
    except (ManifestError, ValueError):
        records = _by_rows(file, records)
    return Records(sorted(records, key=attrgetter("path")))


def _by_rows(file: TextFile, begun: Sequence[FrameRecord] = ()) -> list[FrameRecord]:
    """Return the rows in order, or say what is wrong first; those ``begun`` with are right by themselves."""
    records: list[FrameRecord] = []
    places: dict[str, str] = {}
    for row in file.rows(COLUMNS):
        if len(records) < len(begun):
            record = begun[len(records)]
        else:
            record = FrameRecord(**{name: read(row, name) for name, read in _READ.items()})
        key = record.path.casefold()  # two names that one file system would hold as one file
        if key in places:
            raise row.problem("path", f"{shown(record.path)} stands in {places[key]} already")
        places[key] = row.place
        records.append(record)
    role_of = {record.path: record.role for record in records}
    for record, place in zip(records, places.values(), strict=True):
        if record.reference is not None and role_of.get(record.reference) != "reference":
            row = TextRow(file, {}, place)
            raise row.wrong("reference", "the path of a row with role reference", record.reference)
    return records


# --- by columns -------------------------------------------------------------------------------------------------------


# Cells that need no closer look, of the columns in which nearly all differ. Of a plain path no part begins with a dot.
_PLAIN_PATH = re.compile(
    r"[A-Za-z0-9_ ()+-][A-Za-z0-9_ ()+.-]{0,254}(?:/[A-Za-z0-9_ ()+-][A-Za-z0-9_ ()+.-]{0,254}){0,15}"
)
_PLAIN: dict[str, tuple[re.Pattern[str], Callable[[str], object]]] = {
    "path": (_PLAIN_PATH, str),
    "size_bytes": (re.compile(r"(?:[0-9]{1,18})?"), lambda cell: int(cell) if cell else None),
    "sha256": (re.compile(rf"(?:{_SHA256.pattern})?"), lambda cell: cell or None),
}
_MOST_KEPT = 2**16


def _by_columns(file: TextFile, records: list[FrameRecord]) -> None:
    """Add the rows of a table in which nothing is wrong; anything else raises an error that does not say where.

    What was added until then is right by itself.
    """
    known = {name: _Known(file, name) for name in COLUMNS}
    # Of names that one file system would hold as one file, the hashes: those of a million names are small.
    keys: set[int] = set()
    to_be_references: set[object] = set()
    are_references: set[object] = set()
    for columns in file.columns(COLUMNS):
        values: dict[str, Sequence[object]] = {}
        for name, cells in zip(COLUMNS, columns, strict=True):
            plain, value_of = _PLAIN.get(name, (None, None))
            if plain is None or value_of is None or not all(map(plain.fullmatch, cells)):
                value_of = known[name].__getitem__
            values[name] = list(map(value_of, cells))
        records += from_columns(FrameRecord, values)
        keys.update(map(hash, map(str.casefold, columns[0])))
        to_be_references.update(values["reference"])
        pairs = zip(values["path"], values["role"], strict=True)
        are_references.update(path for path, role in pairs if role == "reference")
    if len(keys) < len(records) or not to_be_references <= are_references | {None}:
        raise ValueError(COLUMNS)


class _Known(dict[str, Any]):
    """What cells of one column hold, by their text: most columns have few texts."""

    def __init__(self, file: TextFile, name: str) -> None:
        self._file = file
        self._name = name

    def __missing__(self, text: str) -> object:
        if len(self) >= _MOST_KEPT:
            self.clear()
        value = self[text] = _READ[self._name](TextRow(self._file, {self._name: text}), self._name)
        return value


def save_records(path: Path, records: Iterable[FrameRecord]) -> None:
    """Write a manifest's rows, sorted by path, whole or not at all.

    Raises
    ------
    ManifestError
        Like :func:`table_text`.
    EldataError
        If it cannot be written.
    """
    write_text(path, table_text(path, records))


def table_text(path: Path, records: Iterable[FrameRecord]) -> str:
    """Return a manifest's rows, sorted by path, as they are written to ``path``.

    Raises
    ------
    ManifestError
        If :func:`load_records` would refuse a row.
    """
    ordered = tuple(sorted(records, key=attrgetter("path")))
    text = csv_text(COLUMNS, ([cell_text(getattr(record, column)) for column in COLUMNS] for record in ordered))
    for record, read_back in zip(ordered, _parse(TextFile(path, ManifestError, content=encoded(text))), strict=True):
        if record != read_back:
            raise ManifestError(f"{path}, row {record.path!r}: cannot be written as text and read back the same")
    return text


def cell_text(value: object) -> str:
    """Return a field of a record as a cell holds it: flags joined by semicolons, nothing for what is not known."""
    if isinstance(value, tuple):
        return ";".join(map(cell_text, value))
    if isinstance(value, Fraction):
        return number_text(value)
    return "" if value is None else str(value)


# --- cells ------------------------------------------------------------------------------------------------------------


def _path(text: str) -> str:
    problem = path_problem(text)
    if problem is not None:
        raise ArgumentError(f"{shown(text)} {problem}")
    return text


def _name(text: str) -> str:
    if not _NAME.fullmatch(text):
        raise ArgumentError(f"expected a name of letters, digits and . _ + -, found {shown(text)}")
    return text


def _sha256(text: str) -> str:
    if not _SHA256.fullmatch(text):
        raise ArgumentError(f"expected sha256: and 64 hexadecimal digits, found {shown(text)}")
    return text


def _flags(row: TextRow, name: str) -> tuple[str, ...]:
    flags = row.data[name].split(";") if row.data[name] else ()
    if not all(map(_NAME.fullmatch, flags)):
        raise row.wrong(name, "a ;-separated list of words", row.data[name])
    return tuple(flags)


# How each column is read, in the order in which a row's problems are looked for.
_READ: dict[str, Callable[[TextRow, str], Any]] = {
    "flags": _flags,
    "path": lambda row, name: row.parsed(name, _path),
    "role": lambda row, name: row.choice(name, ROLES),
    "camera": lambda row, name: row.parsed(name, _name),
    "scene": lambda row, name: row.optional(name, row.parsed, "", parse=_name),
    "split": lambda row, name: row.optional(name, row.parsed, "", parse=_name),
    "iso": lambda row, name: row.optional(name, row.fraction, above=0),
    "exposure_s": lambda row, name: row.optional(name, row.fraction, above=0),
    "ratio": lambda row, name: row.optional(name, row.fraction, above=0),
    "reference": lambda row, name: row.optional(name, row.parsed, parse=_path),
    "width": lambda row, name: row.optional(name, row.whole),
    "height": lambda row, name: row.optional(name, row.whole),
    "size_bytes": lambda row, name: row.optional(name, row.whole),
    "sha256": lambda row, name: row.optional(name, row.parsed, parse=_sha256),
}
