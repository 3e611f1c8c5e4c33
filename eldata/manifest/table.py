"""The manifest's table: CSV text to :class:`~eldata.records.FrameRecord` and back."""

from __future__ import annotations

import csv
import io
import re
from fractions import Fraction
from typing import TYPE_CHECKING, get_args

from eldata.base.fields import TextFile, TextRow, names_of, shown
from eldata.base.files import path_problem, write_text
from eldata.errors import ArgumentError, ManifestError
from eldata.records import FrameRecord, Role

if TYPE_CHECKING:
    from collections.abc import Iterable
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
    text = str(int(value * 10**digits)).rjust(digits + 1, "0")
    return f"{text[:-digits]}.{text[-digits:]}" if digits else text


def load_records(path: Path, content: bytes | None = None) -> tuple[FrameRecord, ...]:
    """Read a manifest's rows, from its ``content`` if that is given.

    Raises
    ------
    ManifestError
        If the file cannot be read or a row is malformed; the message names file, line and column, what was expected
        and what was found.
    """
    return _parse(TextFile(path, ManifestError, content=content, largest_bytes=_LARGEST_BYTES))


def _parse(file: TextFile) -> tuple[FrameRecord, ...]:
    records: list[FrameRecord] = []
    places: dict[str, str] = {}
    for row in file.rows(COLUMNS):
        record = _record(row)
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
    return tuple(sorted(records, key=lambda record: record.path))


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
    ordered = tuple(sorted(records, key=lambda record: record.path))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([_text(getattr(record, column)) for column in COLUMNS] for record in ordered)
    for record, read_back in zip(ordered, _parse(TextFile(path, ManifestError, content=text.getvalue())), strict=True):
        if record != read_back:
            raise ManifestError(f"{path}, row {record.path!r}: cannot be written as text and read back the same")
    return text.getvalue()


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ";".join(value)
    if isinstance(value, Fraction):
        return number_text(value)
    return "" if value is None else str(value)


def _record(row: TextRow) -> FrameRecord:
    flags = row.data["flags"].split(";") if row.data["flags"] else ()
    if not all(map(_NAME.fullmatch, flags)):
        raise row.wrong("flags", "a ;-separated list of words", row.data["flags"])
    return FrameRecord(
        path=row.parsed("path", _path),
        role=row.choice("role", ROLES),
        camera=row.parsed("camera", _name),
        scene=row.optional("scene", row.parsed, "", parse=_name),
        split=row.optional("split", row.parsed, "", parse=_name),
        iso=row.optional("iso", row.fraction, above=0),
        exposure_s=row.optional("exposure_s", row.fraction, above=0),
        ratio=row.optional("ratio", row.fraction, above=0),
        reference=row.optional("reference", row.parsed, parse=_path),
        width=row.optional("width", row.whole),
        height=row.optional("height", row.whole),
        size_bytes=row.optional("size_bytes", row.whole),
        sha256=row.optional("sha256", row.parsed, parse=_sha256),
        flags=tuple(flags),
    )


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
