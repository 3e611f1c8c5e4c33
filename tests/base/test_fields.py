"""The one reader of text files: every text becomes a checked value or the caller's own error, and none takes long."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldata.base.fields import Fields, TextFile
from eldata.base.numbers import fraction_of, number_of, whole_of
from eldata.base.visible import NOTHING
from eldata.errors import ArgumentError, EldataError, FileError, ManifestError, ProfileError
from tests.cases import in_one_test

# The parsers of the standard library would compute on these for minutes, or refuse them with errors of their own.
ENDLESS = ("1e16000000", "1e-16000000", "9" * 10_000, "1/" + "9" * 10_000, "0." + "1" * 10_000, "1" * 5000 + "/3")
NO_NUMBERS = (
    *("", " ", "a", "1/0", "1e3", "-1", "+1", "1_000", "1 2", " 1", "1\n", "/3", "1/", ".", ".5", "5.", "inf", "nan"),
    *("٣",),
)


def fields(data: Any) -> Fields:
    return TextFile("a.json", ManifestError).fields(data)


def parsed(text: str, error: type[EldataError] = ManifestError) -> Fields:
    return TextFile("a.json", error, content=text.encode()).json()


# --- numbers in text ----------------------------------------------------------------------------------------------


def test_numbers_in_text_are_bounded_before_they_are_parsed() -> None:
    for text in (*ENDLESS, *NO_NUMBERS):
        for parse in (fraction_of, whole_of):
            with pytest.raises(ArgumentError, match=r"expected a .*number.*, found ") as caught:
                parse(text)
            assert len(str(caught.value)) < 200
    for text in ("1e16000000", "9" * 10_000, "0." + "1" * 10_000, "1e999", "inf", "nan", "", "1_0", "1/2", " 1", "0x1"):
        with pytest.raises(ArgumentError, match="expected a finite number, found"):
            number_of(text)
    odd: tuple[object, ...] = (5, 0.5, None, True, ["1"], {})
    for found in odd:
        with pytest.raises(ArgumentError, match="as text, such as 800"):
            fraction_of(found)


def test_numbers_in_text_are_exact() -> None:
    values = {"800": Fraction(800), "0.005": Fraction(1, 200), "1/30": Fraction(1, 30), "9.50/19": Fraction(1, 2)}
    assert {text: fraction_of(text) for text in values} == values
    assert fraction_of("0.5/3") == Fraction(1, 6)
    assert fraction_of("9" * 18) == 10**18 - 1
    assert fraction_of("0") == 0
    assert whole_of("007") == 7
    assert (number_of("-1.5e-05"), number_of("5."), number_of(".5")) == (-1.5e-05, 5.0, 0.5)


@given(st.fractions(min_value=0, max_value=10**18, max_denominator=10**17))
def test_a_fractions_own_text_gives_it_back(value: Fraction) -> None:
    assert fraction_of(str(value), digits=40) == value


@given(st.text(alphabet="0123456789./eE+-_ \n٣²x") | st.text() | st.from_regex(r"[0-9]{0,50}e[0-9]{1,9}"))
def test_any_text_is_a_number_or_our_error(text: str) -> None:
    for parse, kind in ((fraction_of, Fraction), (whole_of, int), (number_of, float)):
        try:
            value = parse(text)
        except ArgumentError:
            continue
        assert type(value) is kind
        assert math.isfinite(value)


# --- whole files --------------------------------------------------------------------------------------------------


def test_problems_of_the_whole_file_name_it_and_say_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for content, reason in (
        (b'{"a": "\xff"}', "is not JSON: its byte 7 is not UTF-8"),
        (b'{"a": 1,\n "b', "is not JSON, or not whole (Unterminated string starting at in line 2)"),
        (b"", "is empty (0 bytes): copy or download it again"),
        (b'{"a": 1, "b": {"c": 1, "c": 2}}', "is not JSON that can be read: an object has the field c twice"),
        (b'{"a": ' + b"[" * 100_000, "is not JSON that can be read: it is nested too deeply"),
        (b"[1, 2]", "expected an object, found [1, 2]"),
        (b'{"a": {"b": [1, NaN]}}', "is not JSON that can be read: it holds NaN, expected finite numbers"),
        (b'{"a": 1.0, "b": -Infinity}', "is not JSON that can be read: it holds -Infinity, expected finite numbers"),
        (b"null", "expected an object, found null"),
    ):
        path.write_bytes(content)
        with pytest.raises(ProfileError) as caught:
            TextFile(path, ProfileError, "export it again").json()
        assert str(caught.value).startswith(f"{path}: {reason}")
        assert str(caught.value).endswith("; export it again")
    with pytest.raises(FileError, match=r"b\.json: cannot be read: No such file or directory; look again"):
        TextFile(tmp_path / "b.json", FileError, "look again").json()


def test_files_that_are_too_large_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with path.open("wb") as file:
        os.truncate(file.fileno(), 1 << 40)  # sparse: a tebibyte of nothing
    with pytest.raises(FileError, match=r"expected at most 1 MiB, found more; is it the right file\?"):
        TextFile(path, FileError, largest_bytes=1 << 20).text()


def test_toml(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("a = 5\nb = 0.5\n[c]\nd = 'x'\n", encoding="utf-8")
    top = TextFile(path, ManifestError).toml()
    assert (top.whole("a"), top.number("b"), top.inside("c").text("d")) == (5, 0.5, "x")
    for content, reason in (
        ("a = ", "is not TOML that can be read: Invalid value"),
        ("a = 1\na = 2", "is not TOML that can be read: Cannot overwrite a value"),
        ("a = " + "9" * 5000, "is not TOML that can be read: Exceeds the limit"),
        ("a = " + "[" * 100_000, "is not TOML that can be read: it is nested too deeply"),
    ):
        with pytest.raises(ArgumentError) as caught:
            TextFile("a.toml", ArgumentError, content=content.encode()).toml()
        assert str(caught.value).startswith(f"a.toml: {reason}")
    top = TextFile("a.toml", ManifestError, content=b"a = nan\nb = -inf\nc = 1979-05-27\nd = 0x" + b"f" * 5000).toml()
    for name in "abcd":
        with pytest.raises(ManifestError, match=rf"field {name}: expected a finite number, found "):
            top.number(name)


@given(st.binary() | st.text().map(str.encode))
def test_any_bytes_are_read_or_our_error(content: bytes) -> None:
    file = TextFile("a", FileError, content=content)
    reads: tuple[Callable[[], object], ...] = (file.json, file.toml, lambda: list(file.rows(("a", "b"))))
    for read in reads:
        with suppress(FileError):
            read()


# --- fields -------------------------------------------------------------------------------------------------------

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)
READERS: tuple[Callable[[Fields], object], ...] = (
    lambda top: top.text("a"),
    lambda top: top.texts("a"),
    lambda top: top.flag("a"),
    lambda top: top.whole("a"),
    lambda top: top.number("a", above=0),
    lambda top: top.choice("a", ("x", 1)),
    lambda top: top.inside("a"),
    lambda top: top.objects("a"),
    lambda top: top.each("a", Fields.whole, once=True),
    lambda top: top.optional("a", top.number),
    lambda top: top.schema(1),
    lambda top: top.only(("a", "b")),
)


@settings(max_examples=50)
@given(st.dictionaries(st.text() | st.just("a"), JSON) | JSON)
def test_any_data_gives_values_or_our_error(data: Any) -> None:
    for read in READERS:
        with suppress(FileError):
            read(TextFile("a.json", FileError).fields(data))


@in_one_test(
    "value, read, message",
    [
        (" ", Fields.text, ": expected a text, found ' '"),
        (NOTHING, Fields.text, ": expected a text, found nothing"),
        ("\ud800", Fields.text, ": expected a text without control characters and others that do not show, found '"),
        (["a", 5], Fields.texts, "[1]: expected a text, found 5"),
        (" ", Fields.texts, ": expected a list of texts, found ' '"),
        (1, Fields.flag, ": expected true or false, found 1"),
        (True, Fields.whole, ": expected a whole number of 0 or more, found true"),
        (1.0, partial(Fields.whole, at_least=1), ": expected a whole number of 1 or more, found 1.0"),
        (5, partial(Fields.whole, at_most=4), ": expected a whole number from 0 to 4, found 5"),
        (2**63, Fields.whole, ": expected a whole number of 0 or more, found 92233"),
        ("9" * 19, partial(Fields.parsed, parse=fraction_of), ": expected a number as text"),
        ("1", Fields.number, ": expected a finite number, found '1'"),
        (math.inf, Fields.number, ": expected a finite number, found inf"),
        (10**400, Fields.number, ": expected a finite number, found 1000"),
        (1.0, partial(Fields.number, above=1), ": expected a finite number above 1, found 1.0"),
        (NOTHING, Fields.value, ": is missing"),
        ("1e16000000", partial(Fields.parsed, parse=fraction_of), ": expected a number as text, such as 800, 0.005 or"),
        ("1", partial(Fields.choice, known=("a", "b")), ": expected one of 'a', 'b', found '1'"),
        (["a"], Fields.inside, ": expected an object, found ['a']"),
        (["a"], partial(Fields.texts, count=4, expected="four texts"), ": expected four texts, found ['a']"),
        ([{}, 3], Fields.objects, "[1]: expected an object, found 3"),
        ([{"iso": 0}], lambda top, name: top.objects(name)[0].number("iso", above=0), "[0].iso: expected a"),
        ([1, 2, 1], partial(Fields.each, read=Fields.whole, once=True), "[2]: expected each value once, found 1"),
    ],
)
def test_every_error_names_the_field_what_was_expected_and_found(
    value: object, read: Callable[[Fields, str], object], message: str
) -> None:
    with pytest.raises(ManifestError) as caught:
        read(fields({} if value is NOTHING else {"a": value}), "a")
    assert str(caught.value).startswith(f"a.json, field a{message}")


@pytest.mark.parametrize("schema", [NOTHING, True, 2])
def test_a_file_of_another_schema(schema: object) -> None:
    with pytest.raises(ManifestError, match=r"field schema: expected 1 \(a newer file needs a newer eldata\), found "):
        fields({"schema": schema}).schema(1)


def test_values_come_as_they_are() -> None:
    top = parsed('{"a": 1, "b": "1/30", "c": ["x", ""], "d": null, "e": true, "f": {"g": [1, 2.5]}, "h": "y", "i": ""}')
    assert top.number("a") == 1.0
    assert type(top.number("a")) is float
    assert top.parsed("b", fraction_of) == Fraction(1, 30)
    assert top.texts("c", empty=True) == ("x", "")
    assert (top.optional("d", top.whole), top.optional("z", top.whole), top.optional("a", top.whole)) == (None, None, 1)
    assert top.flag("e") is True
    assert top.texts("z", missing_ok=True) == ()
    assert top.inside("f").each("g", Fields.number, fewest=1, at_least=1) == (1.0, 2.5)
    assert top.choice("h", ("x", "y")) == "y"
    assert top.text("i", empty=True) == ""


def test_unknown_fields_are_refused_with_the_nearest_name() -> None:
    known = ("gain", "notes")
    fields({"gain": 1}).only(known)
    with pytest.raises(ManifestError) as caught:
        fields({"gian": 1}).only(known)
    assert str(caught.value) == "a.json, field gian: is unknown (did you mean gain?); known are gain, notes"
    with pytest.raises(ManifestError, match=r"field 'a\\x1b\[2J\\n': is unknown; known are gain, notes"):
        fields({"a\x1b[2J\n": 1}).only(known)


# --- tables -------------------------------------------------------------------------------------------------------


def table(text: str) -> TextFile:
    return TextFile("a.csv", ManifestError, content=text.encode())


def test_cells_are_parsed_from_text() -> None:
    (row,) = table("name,iso,ratio,score\nx,100,1/3,\n").rows(("name", "iso", "ratio", "score"))
    assert (row.text("name"), row.whole("iso"), row.parsed("ratio", fraction_of)) == ("x", 100, Fraction(1, 3))
    assert row.number("iso") == 100.0
    assert row.optional("score", row.number) is None
    for name in ("iso", "ratio"):
        (odd,) = table(f"name,{name}\nx,1e999\n").rows(("name", name))
        for read in (odd.whole, odd.number):
            with pytest.raises(ManifestError, match=rf"a\.csv, line 2, column {name}: expected a .*found '1e999'"):
                read(name)


def test_tables_that_are_not_as_declared() -> None:
    for text, message in (
        ("", "a.csv, line 1: expected the columns a,b; found ''"),
        ("a\n", "a.csv, line 1: expected the columns a,b; found 'a'"),
        ("a,b\n1\n", "a.csv, line 2: expected 2 fields, found 1"),
        ('a,b\n"1,2\n', "a.csv, line 2: is not CSV (unexpected end of data)"),
        ("a,b\n" + "x" * 200_000 + ",1\n", "a.csv, line 2: is not CSV (field larger than field limit (131072))"),
    ):
        with pytest.raises(ManifestError) as caught:
            list(table(text).rows(("a", "b")))
        assert str(caught.value) == message
