"""The manifest's table: exact numbers, a faithful round trip, and a refusal that says where."""

from __future__ import annotations

import csv
import gc
import io
import random
import re
from collections.abc import Callable, Sequence
from dataclasses import astuple, replace
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldata.base.files import sha256_of
from eldata.base.tables import cell_of_text, text_of_cell
from eldata.errors import ManifestError
from eldata.manifest.table import COLUMNS, load_records, load_table, number_text, save_records
from eldata.records import FrameRecord
from tests.cases import in_one_test

Rows = list[dict[str, str]]

HASH = "sha256:" + "0123456789abcdef" * 4
REFERENCE = FrameRecord("Cam/scene-1/IMG_0001.ARW", "reference", "Cam", "scene-1", "test", Fraction(100), Fraction(4))
NOISY = FrameRecord(
    path="Cam/scene-1/IMG_0004.ARW",
    role="noisy",
    camera="Cam",
    scene="scene-1",
    split="test",
    iso=Fraction(800),
    exposure_s=Fraction(1, 30),
    ratio=Fraction(100),
    reference=REFERENCE.path,
    width=4256,
    height=2848,
    size_bytes=25_000_000,
    sha256=HASH,
    flags=("misaligned", "inexact-ratio"),
)
BIAS = FrameRecord("Cam/bias/DSC 0001 (2).ARW", "bias", "Cam")  # spaces and brackets do occur in people's names


# --- numbers ------------------------------------------------------------------------------------------------------


# What an EXIF fraction can be: two unsigned 32-bit numbers.
EXIF_FRACTIONS = st.builds(Fraction, st.integers(1, 2**32 - 1), st.integers(1, 2**32 - 1))
# Hypothesis would hardly meet a denominator of 2s and 5s alone by itself.
DECIMALS = st.builds(
    lambda n, twos, fives: Fraction(n, 2**twos * 5**fives),
    st.integers(1, 2**32 - 1),
    st.integers(0, 18),
    st.integers(0, 13),
)


@given(EXIF_FRACTIONS | DECIMALS)
def test_number_text_is_exact_and_decimal_where_nine_decimals_do(value: Fraction) -> None:
    """A float's repr would round 1/30; the text must give the very fraction back."""
    text = number_text(value)
    assert Fraction(text) == value
    assert ("/" in text) == (10**9 % value.denominator != 0)
    assert re.fullmatch(r"\d+(/\d+|\.\d*[1-9])?", text), "a digit before the point, and no trailing zero"


# --- malformed ----------------------------------------------------------------------------------------------------


def rows() -> Rows:
    """A reference in line 2, a noisy frame in line 3."""
    first, second = (f"Cam/scene-1/IMG_{number}.ARW" for number in ("0001", "0004"))
    reference = {"path": first, "role": "reference", "camera": "Cam", "iso": "100", "exposure_s": "4"}
    noisy = {"path": second, "role": "noisy", "iso": "800", "exposure_s": "0.005", "ratio": "100", "reference": first}
    return [dict.fromkeys(COLUMNS, "") | reference | fields for fields in ({}, noisy)]


def as_csv(table: Rows) -> str:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    return text.getvalue()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "set.csv"


OUT_OF_PLACE = "Cam/scene-1/IMG_0001.ARW", "cam/SCENE-1/img_0001.arw"
NO_ISOS = "ISO800", "0", "-800", "+800", "8e2", "nan", "inf", " 800", "800\n", "9" * 5000, "1e16000000"
NO_TIMES = "1/0", "0/3", "1/30/2", "1,5", ".5", "__import__('os')"
NO_REFERENCES = "Cam/scene-1/IMG_0009.ARW", "cam/scene-1/IMG_0001.ARW", "Cam/scene-1/IMG_0004.ARW"
NO_HASHES = "0123456789abcdef" * 4, "sha256:abc", "sha256:" + HASH[7:].upper(), HASH + "0", "md5:" + "0" * 64


@in_one_test(
    "column, said, values",
    [
        ("path", "is empty", [""]),
        ("path", "'..'", ["Cam/../../etc/passwd", "..", "./IMG_0004.ARW"]),
        ("path", "control character", ["Cam/IMG_0004.ARW\0", "Cam/IMG\n0004.ARW"]),
        ("path", "a name of more than 255 characters", [f"Cam/IMG_{'4' * 300}.ARW"]),
        ("path", "line 2 already", OUT_OF_PLACE),
        ("role", "one of 'reference', 'noisy', 'bias', 'flat'", ["", "dark", "Noisy"]),
        ("camera", "a name of letters, digits", ["", "Sony A7S2", "a/b", "Cam\0"]),
        ("scene", "letters, digits", ["../1", "1" * 5000]),
        ("split", "letters, digits", ["te st"]),
        ("iso", "a number above 0", NO_ISOS),
        ("exposure_s", "a number above 0", NO_TIMES),
        ("ratio", "a number above 0", ["100x"]),
        ("reference", "'..'", ["../IMG_0001.ARW"]),
        ("reference", "a row with role reference", NO_REFERENCES),
        ("width", "a whole number", ["4256.0", "-1"]),
        ("height", "a whole number", ["1e3", "1" * 5000]),
        ("size_bytes", "a whole number", ["25 MB"]),
        ("sha256", "sha256: and 64", NO_HASHES),
        ("flags", "list of words", ["misaligned;", ";", "not aligned", "a,b"]),
    ],
)
def test_a_bad_field_is_named_by_file_line_and_column(
    path: Path, column: str, said: str, values: Sequence[str]
) -> None:
    for value in values:
        table = rows()
        table[1][column] = value
        path.write_text(as_csv(table), encoding="utf-8", newline="")
        with pytest.raises(ManifestError) as raised:
            load_records(path)
        # A field that holds a line end makes its row end one line later.
        line = 4 if "\n" in value else 3
        assert re.search(rf"line {line}, column {column}: .*{re.escape(said)}", str(raised.value)), value
        assert str(path) in str(raised.value)


@in_one_test(
    "said, line, spoil",
    [
        ("expected the columns path,role,camera", 1, lambda text: text.replace("path,role", "role,path", 1)),
        ("expected the columns path,role,camera", 1, lambda text: text.replace(",flags", ",flags,notes", 1)),
        ("expected 14 fields, found 13", 3, lambda text: text[:-2] + "\n"),
        ("expected 14 fields, found 0", 4, lambda text: text + "\n"),
        ("is not CSV", 3, lambda text: text.replace("noisy", '"noisy"x')),
    ],
)
def test_a_broken_table_is_named_by_file_and_line(
    path: Path, spoil: Callable[[str], str], line: int, said: str
) -> None:
    path.write_text(spoil(as_csv(rows())), encoding="utf-8", newline="")
    with pytest.raises(ManifestError, match=f"{path}, line {line}: .*{said}"):
        load_records(path)


@in_one_test("content", [b"\x89PNG\r\n\x1a\n\xff", as_csv(rows()).encode("utf-16"), b"path,\xe4\n", None])
def test_a_file_that_is_no_text_or_not_there_is_named(path: Path, content: bytes | None) -> None:
    path.unlink(missing_ok=True)
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ManifestError, match=f"{path}: {'cannot be read' if content is None else 'is not .*UTF-8'}"):
        load_records(path)


def test_what_spreadsheets_make_of_a_table_is_accepted(path: Path) -> None:
    text = as_csv(rows())
    head, first, second = text.splitlines()
    path.write_bytes(text.encode())
    expected = load_records(path)
    for made in (f"\ufeff{text}", text.replace("\n", "\r\n"), f"{head}\n{second}\n{first}\n"):
        path.write_bytes(made.encode())
        assert load_records(path) == expected


# --- large tables -----------------------------------------------------------------------------------------------------


NAMES = ("IMG", "-b", "é (1)", "_x", "='ß,;#\" ")


def many_rows(rng: random.Random, count: int) -> list[list[str]]:
    """A table in which all is well: references, noisy frames of them, and others."""
    table: list[list[str]] = []
    for number in range(count):
        path = f"Cam/scene-{number // 4}/{rng.choice(NAMES)}{number:04}.ARW"
        role = "reference" if number % 4 == 0 else rng.choice(("noisy", "bias", "flat"))
        scene, split = rng.choice(("", f"scene-{number // 4}", "-1", "+x")), rng.choice(("", "test"))
        numbers = [rng.choice(("", "100", "0.005", f"1/{rng.randint(1, 9999)}")) for _ in range(3)]
        reference = rng.choice(("", table[number - number % 4][0])) if number % 4 else ""
        sizes = [rng.choice(("", str(rng.randint(0, 10**9)))) for _ in range(3)]
        row = [path, role, "Cam", scene, split, *numbers, reference, *sizes]
        table.append([*row, rng.choice(("", HASH)), rng.choice(("", "a", "a;b"))])
    return table


def as_record(cells: Sequence[str]) -> FrameRecord:
    """What a row says, read without any check."""
    path, role, camera, scene, split, *numbers, reference, width, height, size, sha256, flags = cells
    fractions = [Fraction(text) if text else None for text in numbers]
    wholes = [int(text) if text else None for text in (width, height, size)]
    words = tuple(flags.split(";")) if flags else ()
    return FrameRecord(path, role, camera, scene, split, *fractions, reference or None, *wholes, sha256 or None, words)  # type: ignore[arg-type, call-arg] # as the columns stand


def write_rows(path: Path, table: Sequence[Sequence[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *table])


def test_a_table_of_several_batches_is_read_as_csv_has_it_and_comes_back(path: Path) -> None:
    table = many_rows(random.Random(1), 3000)  # noqa: S311 # to be repeated
    write_rows(path, table)
    expected = sorted(map(as_record, table), key=lambda record: record.path)
    records, digest = load_table(path)
    assert (list(records), digest) == (expected, sha256_of(path))
    assert [[type(value) for value in astuple(one)] for one in records] == [
        [type(value) for value in astuple(one)] for one in expected
    ], "1 and Fraction(1) are equal"
    assert gc.isenabled()
    save_records(path, reversed(records))
    assert list(load_records(path)) == expected
    with path.open(encoding="utf-8", newline="") as file:
        assert not [cell for row in csv.reader(file) for cell in row if cell.startswith(("=", "+", "-", "@"))]


@in_one_test(
    "column, cell, said",
    [
        ("path", "Cam/scene-0/IMG\\b.ARW", "backslash"),
        ("path", "line 2", "stands in line 2 already"),
        ("iso", "ISO100", "a number above 0"),
        ("reference", "Cam/none.ARW", "a row with role reference"),
    ],
)
def test_a_fault_behind_the_first_batch_is_named_by_its_line(path: Path, column: str, cell: str, said: str) -> None:
    table = many_rows(random.Random(1), 3000)  # noqa: S311 # to be repeated
    table[2500][COLUMNS.index(column)] = table[0][0] if cell == "line 2" else cell
    write_rows(path, table)
    with pytest.raises(ManifestError, match=f"line 2502, column {column}: .*{said}"):
        load_records(path)


# --- cells that a spreadsheet would run -------------------------------------------------------------------------------


@given(st.text("'=+-@\t\r\n＝a1", max_size=6))
def test_any_text_comes_back_from_a_cell_that_is_no_formula(text: str) -> None:
    cell = cell_of_text(text)
    assert cell[:1] not in ("=", "+", "-", "@", "\t", "\r", "\n", "＝") or not cell
    assert text_of_cell(cell) == text


# --- saving -------------------------------------------------------------------------------------------------------


def test_saved_text_is_sorted_with_plain_line_ends(path: Path) -> None:
    """Diffs of manifests in a repository stay small, and two people write the same bytes."""
    save_records(path, [NOISY, REFERENCE, BIAS])
    first = path.read_bytes()
    assert load_records(path) == (BIAS, REFERENCE, NOISY), "every field comes back"
    save_records(path, [BIAS, REFERENCE, NOISY])
    assert path.read_bytes() == first
    lines = first.decode().split("\n")
    assert lines[0] == ",".join(COLUMNS)
    assert [line.split(",")[0] for line in lines[1:]] == [BIAS.path, REFERENCE.path, NOISY.path, ""]
    assert b"\r" not in first


# What is written is read back: of each way to be wrong that only a record can have, and of the others one.
REFUSED = [
    [REFERENCE, replace(NOISY, path="../IMG_0004.ARW")],
    [REFERENCE, replace(NOISY, role="dark")],  # type: ignore[arg-type] # as a caller without types may
    [REFERENCE, replace(NOISY, exposure_s=0.1)],  # type: ignore[arg-type] # a float is not exact
    [REFERENCE, replace(NOISY, flags=("",))],
    [REFERENCE, NOISY, replace(NOISY, path=NOISY.path.lower())],
    [NOISY],
]


@pytest.mark.parametrize("records", REFUSED, ids=range(len(REFUSED)))
def test_what_load_would_refuse_is_not_saved(path: Path, records: list[FrameRecord]) -> None:
    """A manifest that can be written but not read would be found out much later, by someone else."""
    save_records(path, [REFERENCE, NOISY])
    before = path.read_bytes()
    with pytest.raises(ManifestError) as raised:
        save_records(path, records)
    assert str(path) in str(raised.value)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]
