"""The manifest's table: CSV text to :class:`~eldata.records.FrameRecord` and back."""

from __future__ import annotations

import csv
import io
import re
from fractions import Fraction
from typing import TYPE_CHECKING, get_args

from eldata.base.files import path_problem, write_text
from eldata.errors import ManifestError
from eldata.records import FrameRecord, Role

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

COLUMNS = (
    "path",
    "role",
    "camera",
    "scene",
    "split",
    "iso",
    "exposure_s",
    "ratio",
    "reference",
    "width",
    "height",
    "size_bytes",
    "sha256",
    "flags",
)
ROLES: tuple[Role, ...] = get_args(Role)

_NUMBER = re.compile(r"[0-9]{1,18}(\.[0-9]{1,18})?(/[0-9]{1,18})?")
_MOST_DECIMALS = 9
_WHOLE = re.compile(r"[0-9]{1,18}")
_SHA256 = re.compile(r"sha256:[0-9a-f]{64}")
_NAME = re.compile(r"[\w.+-]+")


def number_text(value: Fraction) -> str:
    """Return a fraction as exact text: ``800``, ``0.005`` where at most nine decimals do, else ``1/30``."""
    scaled, denominator, digits = value.numerator, value.denominator, 0
    while denominator % 10 == 0:
        denominator, digits = denominator // 10, digits + 1
    for prime, partner in ((2, 5), (5, 2)):
        while denominator % prime == 0:
            denominator, scaled, digits = denominator // prime, scaled * partner, digits + 1
    if denominator != 1 or digits > _MOST_DECIMALS:
        return f"{value.numerator}/{value.denominator}"
    text = str(scaled).rjust(digits + 1, "0")
    return f"{text[:-digits]}.{text[-digits:]}" if digits else text


def load_records(path: Path) -> tuple[FrameRecord, ...]:
    """Read a manifest's rows.

    Raises
    ------
    ManifestError
        If the file cannot be read or a row is malformed; the message names file, line and column, what was expected
        and what was found.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ManifestError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ManifestError(f"{path}: is not UTF-8 text (byte {error.start}); is it a manifest?") from error
    return _parse(path, text)


def _parse(path: Path, text: str) -> tuple[FrameRecord, ...]:
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        header = next(reader, None)
        if header is None or tuple(header) != COLUMNS:
            found = ",".join(header or ())
            raise ManifestError(f"{path} line 1: expected the columns {','.join(COLUMNS)}; found {found}")
        records: list[FrameRecord] = []
        line_of: dict[str, int] = {}
        for fields in reader:
            where = f"{path} line {reader.line_num}"
            if len(fields) != len(COLUMNS):
                raise ManifestError(f"{where}: expected {len(COLUMNS)} fields, found {len(fields)}")
            record = _record(where, dict(zip(COLUMNS, fields, strict=True)))
            key = record.path.casefold()  # two names that one file system would hold as one file
            if key in line_of:
                raise ManifestError(f"{where}, column path: {record.path!r} stands in line {line_of[key]} already")
            line_of[key] = reader.line_num
            records.append(record)
    except csv.Error as error:
        raise ManifestError(f"{path} line {reader.line_num}: is not CSV ({error})") from error
    role_of = {record.path: record.role for record in records}
    for record in records:
        if record.reference is not None and role_of.get(record.reference) != "reference":
            raise ManifestError(
                f"{path} line {line_of[record.path.casefold()]}, column reference: expected the path of a row with "
                f"role reference, found {record.reference!r}"
            )
    return tuple(sorted(records, key=lambda record: record.path))


def save_records(path: Path, records: Iterable[FrameRecord]) -> None:
    """Write a manifest's rows, sorted by path, whole or not at all.

    Raises
    ------
    ManifestError
        If :func:`load_records` would refuse a row.
    """
    ordered = tuple(sorted(records, key=lambda record: record.path))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(_fields(record).values() for record in ordered)
    for record, read_back in zip(ordered, _parse(path, text.getvalue()), strict=True):
        if record != read_back:
            raise ManifestError(f"{path}, row {record.path!r}: cannot be written as text and read back the same")
    write_text(path, text.getvalue())


def _fields(record: FrameRecord) -> dict[str, str]:
    def text(value: object) -> str:
        if isinstance(value, tuple):
            return ";".join(value)
        if isinstance(value, Fraction):
            return number_text(value)
        return "" if value is None else str(value)

    return {column: text(getattr(record, column)) for column in COLUMNS}


def _record(where: str, fields: dict[str, str]) -> FrameRecord:
    def fail(column: str, expected: str) -> ManifestError:
        return ManifestError(f"{where}, column {column}: expected {expected}, found {fields[column]!r}")

    def safe_path(column: str) -> str:
        problem = path_problem(fields[column])
        if problem is not None:
            raise ManifestError(f"{where}, column {column}: {fields[column]!r} {problem}")
        return fields[column]

    def optional_number(column: str) -> Fraction | None:
        if not fields[column]:
            return None
        if not _NUMBER.fullmatch(fields[column]):
            raise fail(column, "a positive number such as 800, 0.005 or 1/30, or nothing")
        whole, _, divisor = fields[column].partition("/")
        denominator = int(divisor or 1)
        value = Fraction(whole) / denominator if denominator else Fraction(0)
        if value <= 0:
            raise fail(column, "a positive number")
        return value

    def optional_whole(column: str) -> int | None:
        if not fields[column]:
            return None
        if not _WHOLE.fullmatch(fields[column]):
            raise fail(column, "a whole number or nothing")
        return int(fields[column])

    def matching(column: str, pattern: re.Pattern[str], expected: str) -> str:
        if fields[column] and not pattern.fullmatch(fields[column]):
            raise fail(column, expected)
        return fields[column]

    role = next((role for role in ROLES if role == fields["role"]), None)
    if role is None:
        raise fail("role", f"one of {', '.join(ROLES)}")
    if not fields["camera"]:
        raise fail("camera", "a camera's name")
    flags = tuple(fields["flags"].split(";")) if fields["flags"] else ()
    if not all(_NAME.fullmatch(flag) for flag in flags):
        raise fail("flags", "a ;-separated list of words")
    plain = "letters, digits and . _ + -"
    return FrameRecord(
        path=safe_path("path"),
        role=role,
        camera=matching("camera", _NAME, plain),
        scene=matching("scene", _NAME, plain),
        split=matching("split", _NAME, plain),
        iso=optional_number("iso"),
        exposure_s=optional_number("exposure_s"),
        ratio=optional_number("ratio"),
        reference=safe_path("reference") if fields["reference"] else None,
        width=optional_whole("width"),
        height=optional_whole("height"),
        size_bytes=optional_whole("size_bytes"),
        sha256=matching("sha256", _SHA256, "sha256: and 64 hexadecimal digits") or None,
        flags=flags,
    )
