"""Choosing pairs from a manifest."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

from eldata.errors import ArgumentError
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.pairs import Choice
from eldata.records import FrameRecord

RECORDS = shipped_manifest("eld").records


@pytest.mark.parametrize(
    ("filters", "field", "found", "count"),
    [
        ({}, "path", {record.path for record in RECORDS if record.role == "noisy"}, 480),
        ({"cameras": ("NikonD850", "CanonEOS70D")}, "camera", {"NikonD850", "CanonEOS70D"}, 240),
        ({"cameras": "SonyA7S2", "split": "test"}, "camera", {"SonyA7S2"}, 120),  # one alone
        ({"scenes": [1]}, "scene", {"scene-1"}, 48),  # and not scene-10
        ({"scenes": 1, "isos": 800, "ratios": 100.0}, "ratio", {Fraction(100)}, 4),
        ({"scenes": ["scene-3", 10]}, "scene", {"scene-3", "scene-10"}, 96),
        ({"isos": {800, 3200}}, "iso", {Fraction(800), Fraction(3200)}, 320),
        ({"ratios": [100, 200]}, "ratio", {Fraction(100), Fraction(200)}, 240),  # the paper's
        ({"ratios": [1.0, Fraction(10)]}, "ratio", {Fraction(1), Fraction(10)}, 240),
    ],
)
def test_each_filter(filters: dict[str, Any], field: str, found: set[object], count: int) -> None:
    pairs = Choice(**filters).pairs(RECORDS)
    assert {getattr(pair, field) for pair in pairs} == found
    assert list(pairs) == sorted(pairs, key=lambda pair: pair.path)
    assert len(pairs) == count


@pytest.mark.parametrize(
    ("filters", "said"),
    [
        ({"cameras": ["SonyA7S2", "CanonEOS5D4"]}, "no pair has camera CanonEOS5D4; known are .*SonyA7S2"),
        ({"scenes": [11]}, "no pair has scene scene-11; known are scene-1, scene-10, scene-2"),
        ({"isos": [100]}, "no pair has ISO 100; known are 800, 1600, 3200"),
        ({"ratios": [213.3]}, "no pair has ratio 213.3; known are 1, 10, 100, 200"),
    ],
)
def test_an_unknown_value_lists_the_known(filters: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        Choice(**filters).pairs(RECORDS)


def test_of_many_values_those_next_to_the_wanted_one_are_listed() -> None:
    with pytest.raises(ArgumentError, match=r"known are 231, next to it 10170, .*10185, 10187, .*10198$"):
        Choice(scenes=[10186]).pairs(shipped_manifest("sid-sony").records)


def test_a_combination_that_does_not_occur() -> None:
    some = [r for r in RECORDS if not (r.camera == "SonyA7S2" and r.iso == 800)]
    with pytest.raises(ArgumentError, match="no pair has all of"):
        Choice(cameras=["SonyA7S2"], isos=[800]).pairs(some)
    with pytest.raises(ArgumentError, match="no pair has all of"):
        Choice(cameras=[]).pairs(RECORDS)


def test_numbers_of_padded_scenes_and_either_of_two_flags() -> None:
    records = [
        FrameRecord(f"{scene}/2.ARW", "noisy", "a", scene, ratio=Fraction(100), reference=f"{scene}/1.ARW", flags=flags)
        for scene, flags in (("0001", ("moved",)), ("0010", ("dim", "blurred")), ("0002", ()))
    ]
    assert [pair.scene for pair in Choice(scenes=[1, 10]).pairs(records)] == ["0001", "0010"]
    assert [pair.scene for pair in Choice(exclude_flags=["moved", "dim"]).pairs(records)] == ["0002"]


def test_rows_that_are_no_pairs_are_left_out() -> None:
    records = [
        FrameRecord("a/1.ARW", "reference", "a"),
        FrameRecord("a/2.ARW", "noisy", "a", ratio=Fraction(100), reference="a/1.ARW", flags=("misaligned",)),
        FrameRecord("a/3.ARW", "noisy", "a", ratio=Fraction(100)),
        FrameRecord("a/4.ARW", "noisy", "a", reference="a/1.ARW"),
        FrameRecord("a/5.ARW", "bias", "a"),
        FrameRecord("a/6.ARW", "flat", "a"),
    ]
    pairs = Choice().pairs(records)
    assert [pair.path for pair in pairs] == ["a/2.ARW"]
    assert pairs[0].flags == ("misaligned",)
