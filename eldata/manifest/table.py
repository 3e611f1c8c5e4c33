"""The manifest's table: CSV text to :class:`~eldata.records.FrameRecord` and back."""

from __future__ import annotations

import hashlib
import re
from array import array
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any, get_args

from eldata.base.fields import TextFile, names_of, no_search_for_cycles
from eldata.base.files import encoded, path_problem, write_text
from eldata.base.numbers import fraction_of, whole_of
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
    """Return the rows, sorted by path. They are read by columns, some at a time: a table may have a million."""
    records: list[FrameRecord] = []
    lines = array("Q")
    with no_search_for_cycles():
        for numbers, columns in file.columns(COLUMNS):
            cells = zip(COLUMNS, columns, strict=True)
            values = {name: _parse_cells(file, name, texts, numbers) for name, texts in cells}
            records += from_columns(FrameRecord, values)
            lines.extend(numbers)
    _check_paths(file, records, lines)
    return Records(sorted(records, key=attrgetter("path")))


def _parse_cells(file: TextFile, name: str, cells: Sequence[str], lines: Sequence[int]) -> Sequence[object]:
    """Parse the cells of one column."""
    if name == "path" and all(map(_PLAIN_PATH.fullmatch, cells)):
        return cells
    values: list[object] = []
    try:
        values.extend(map(_PARSE[name], cells))  # keeps those before a bad one
    except ArgumentError as error:
        raise file.problem(str(error), f"line {lines[len(values)]}, column {name}") from None
    return values


def _check_paths(file: TextFile, records: Sequence[FrameRecord], lines: Sequence[int]) -> None:
    """Refuse a path that stands in two rows, and a reference that is no row's with that role."""
    keys = {record.path.casefold() for record in records}  # a file system may hold two such names as one file
    if len(keys) < len(records):
        places: dict[str, int] = {}
        for record, line in zip(records, lines, strict=True):
            other = places.setdefault(record.path.casefold(), line)
            if other != line:
                reason = f"{shown(record.path)} stands in line {other} already"
                raise file.problem(reason, f"line {line}, column path")
    references = {record.path for record in records if record.role == "reference"}
    for record, line in zip(records, lines, strict=True):
        if record.reference is not None and record.reference not in references:
            reason = f"expected the path of a row with role reference, found {shown(record.reference)}"
            raise file.problem(reason, f"line {line}, column reference")


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
    """Return a field of a record as a cell holds it: flags joined by semicolons, an empty text for None."""
    if isinstance(value, tuple):
        return ";".join(map(cell_text, value))
    if isinstance(value, Fraction):
        return number_text(value)
    return "" if value is None else str(value)


# --- cells ------------------------------------------------------------------------------------------------------------


def _parse_path(text: str) -> str:
    """Return a cell's path; refuse an unsafe one."""
    if (problem := path_problem(text)) is not None:
        raise ArgumentError(f"{shown(text)} {problem}")
    return text


def _parse_role(text: str) -> str:
    """Return a cell's role; refuse an unknown one."""
    if text not in ROLES:
        raise ArgumentError(f"expected one of {', '.join(map(shown, ROLES))}, found {shown(text)}")
    return text


def _parse_name(text: str) -> str:
    """Return a cell's name, such as a camera's; refuse spaces and other signs."""
    if not _NAME.fullmatch(text):
        raise ArgumentError(f"expected a name of letters, digits and . _ + -, found {shown(text)}")
    return text


def _parse_sha256(text: str) -> str | None:
    """Return a cell's ``sha256:<hex>``; ``None`` if it is empty."""
    if text and not _SHA256.fullmatch(text):
        raise ArgumentError(f"expected sha256: and 64 hexadecimal digits, found {shown(text)}")
    return text or None


def _parse_flags(text: str) -> tuple[str, ...]:
    """Split a cell's flags at semicolons; refuse one that is not a name."""
    flags = text.split(";") if text else ()
    if not all(map(_NAME.fullmatch, flags)):
        raise ArgumentError(f"expected a ;-separated list of words, found {shown(text)}")
    return tuple(flags)


def _parse_number(text: str) -> Fraction | None:
    """Parse a positive number exactly; ``None`` if the cell is empty."""
    return fraction_of(text, above=0) if text else None


def _parse_whole(text: str) -> int | None:
    """Parse a whole number; ``None`` if the cell is empty."""
    return whole_of(text) if text else None


def parse_cell(name: str, text: str, place: str) -> Any:
    """Parse what a path states of a column.

    Raises
    ------
    ManifestError
        If it cannot be a value of it.
    """
    try:
        return _PARSE[name](text)
    except ArgumentError as error:
        raise ManifestError(f"{place}: {error} as {name}") from None


# How the cells of each column are read. Most columns have few texts, each of which is read once.
_cached = lru_cache(2**16)
_PARSE: dict[str, Callable[[str], Any]] = {
    "path": _parse_path,
    "role": _cached(_parse_role),
    "camera": _cached(_parse_name),
    "scene": _cached(lambda text: text and _parse_name(text)),
    "split": _cached(lambda text: text and _parse_name(text)),
    "iso": _cached(_parse_number),
    "exposure_s": _cached(_parse_number),
    "ratio": _cached(_parse_number),
    "reference": _cached(lambda text: _parse_path(text) if text else None),
    "width": _cached(_parse_whole),
    "height": _cached(_parse_whole),
    "size_bytes": _parse_whole,
    "sha256": _parse_sha256,
    "flags": _cached(_parse_flags),
}
# Needs no closer look: no part of it begins with a dot.
_PLAIN_PATH = re.compile(
    r"[A-Za-z0-9_ ()+-][A-Za-z0-9_ ()+.-]{0,254}(?:/[A-Za-z0-9_ ()+-][A-Za-z0-9_ ()+.-]{0,254}){0,15}"
)
