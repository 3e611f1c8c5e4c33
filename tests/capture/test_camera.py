from __future__ import annotations

import json
import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture.camera import EXAMPLE, CameraDescription, Shutter, ladder, parse_seconds
from capture.capture_errors import CaptureError
from eldata.errors import ArgumentError
from tests.cases import in_one_test
from tests.shared import there

THIRD, HALF, FULL = Fraction(1, 3), Fraction(1, 2), Fraction(1)


def camera(shutter: Shutter) -> CameraDescription:
    return CameraDescription("Acme", ("Nocturne 1",), ".dng", (100, 800), 100, shutter)


@in_one_test("step, dial, exponent", [(THIRD, "1/60", -6), (THIRD, "30", 5), (HALF, "1/60", -6), (FULL, "1/125", -7)])
def test_names_lie_near_the_powers_of_two_that_the_camera_gives(step: Fraction, dial: str, exponent: int) -> None:
    """Or a name would be missing in the list, or stand twice: every later one would be a step off."""
    assert ladder(step)[Fraction(dial)].true_s == 2.0**exponent
    times = list(ladder(step).values())
    for index, time in enumerate(times):
        assert math.log2(time.true_s) == pytest.approx(math.log2(times[0].true_s) + step * index, abs=1e-12)
        assert abs(math.log2(time.nominal_s / time.true_s)) < 0.25


@given(st.fractions(Fraction(1, 10**5), 60, max_denominator=10**6), st.sampled_from((THIRD, HALF, FULL)))
def test_nearest_is_the_nearest_by_ratio(wanted: Fraction, step: Fraction) -> None:
    cam = camera(Shutter.between("1/4000", "30", step))
    found = cam.round_to_nearest(wanted)
    off = {time: abs(math.log2(time.true_s / wanted)) for time in cam.shutter.times}
    if found is None:
        assert min(off.values()) > float(step) / 2 - 1e-9
    else:
        assert off[found] <= float(step) / 2 + 1e-9
        assert off[found] <= min(off.values()) + 1e-9


@given(st.integers(-39, 14), st.floats(-1e-8, 1e-8))
def test_rounding_has_no_near_misses(thirds: int, off: float) -> None:
    """Right beside the border between two settings, and on it, whatever the last digits are."""
    cam = camera(Shutter.between("1/8000", "30", THIRD))
    found = there(cam.round_to_nearest(2 ** ((2 * thirds + 1) / 6) * (1 + off)))
    expected = thirds + (off > 1.1e-9)  # the border itself: the faster one
    if abs(off - 1e-9) > 1e-10:
        assert found.true_s == pytest.approx(2 ** (expected / 3))
    assert there(cam.round_down(2 ** (thirds / 3) * (1 + min(abs(off), 1e-10)))).true_s == pytest.approx(
        2 ** (thirds / 3)
    )


@given(st.fractions(Fraction(1, 10**5), 100, max_denominator=10**6))
def test_not_above_gives_no_more(wanted: Fraction) -> None:
    cam = camera(Shutter.between("1/8000", "30", THIRD))
    found = cam.round_down(float(wanted))
    more = [time for time in cam.shutter.times if wanted < time.true_s]
    if found is None:
        assert more == list(cam.shutter.times)
    else:
        assert [*cam.shutter.times[: cam.shutter.times.index(found) + 1], *more] == list(cam.shutter.times)


def test_bulb_times_go_on_in_the_camera_s_steps() -> None:
    found = Shutter.between("1/8000", "30", THIRD, bulb_s=130).times[-6:]
    assert [(time.dial, time.nominal_s, time.true_s) for time in found] == [
        (f"bulb {seconds}", Fraction(seconds), float(seconds)) for seconds in (40, 51, 64, 81, 102, 128)
    ]
    # A listed time that the camera gives as named goes on from there; whole seconds are taken once.
    assert [time.dial for time in Shutter(("0.5", "1"), THIRD, "as-named", 3).times[2:]] == ["bulb 2", "bulb 3"]
    for bulb_s in (30, 4000):
        with pytest.raises(CaptureError, match=f"above the slowest time, 30 s, and up to 3600, found {bulb_s}"):
            Shutter.between("1/8000", "30", THIRD, bulb_s=bulb_s)


def test_listed_times_that_are_given_as_named() -> None:
    cam = camera(Shutter(("1/1000", "1/90", "0.25"), true_times="as-named"))
    times_s = (Fraction(1, 1000), Fraction(1, 90), Fraction(1, 4))
    assert [time.true_s for time in cam.shutter.times] == [float(seconds) for seconds in times_s]
    # The root of their product, exactly: the faster.
    assert cam.round_to_nearest(Fraction(1, 300)) == cam.shutter.times[0]
    assert cam.round_to_nearest(Fraction(1, 299)) == cam.shutter.times[1]
    single = camera(Shutter(("1/100",), true_times="as-named"))
    assert single.round_to_nearest(Fraction(1, 110)) == single.fastest
    assert single.round_to_nearest(Fraction(1, 130)) is single.round_to_nearest(Fraction(1, 70)) is None


def test_exif_may_state_the_name_or_what_is_given() -> None:
    for observed, stops in (("1/60", 0), ("1/64", 0), ("1/62", 0.0458), ("1/50", 0.263)):
        assert ladder(THIRD)[Fraction(1, 60)].stops_off(Fraction(observed)) == pytest.approx(stops, abs=0.001)


MEASURED = replace(EXAMPLE, true_isos=((100, Fraction(81)), (800, Fraction("644.5"))))


@in_one_test(
    "description",
    [
        MEASURED,
        camera(Shutter.between("1/4000", "30", THIRD, "as-named")),
        camera(Shutter(("1/1000", "1/90", "0.25"), true_times="as-named")),
        camera(Shutter(("1/1000", "1/125", "4"), FULL, bulb_s=5)),
    ],
)
def test_round_trip(description: CameraDescription, tmp_path: Path) -> None:
    description.save(tmp_path / "cam.json")
    assert CameraDescription.load(tmp_path / "cam.json") == description


def test_true_isos() -> None:
    assert (MEASURED.speed(800), EXAMPLE.speed(800)) == (Fraction("644.5"), Fraction(800))
    with pytest.raises(CaptureError, match="states the true speed of ISO 100, 800, and not of ISO 200"):
        MEASURED.speed(200)


LADDER = {"step": "1/3", "fastest": "1/8000", "slowest": "30"}
GOOD: dict[str, Any] = {
    "schema": 1,
    "name": "Acme",
    "models": ["Nocturne 1"],
    "raw_extension": ".dng",
    "isos": [100, 800],
    "base_iso": 100,
    "shutter": LADDER,
}


@in_one_test(
    "change, words",
    [
        ({"schema": 2}, "field schema: expected 1 (a newer file needs a newer capture), found 2"),
        ({"name": "a/b"}, "camera name: expected letters, digits"),
        ({"models": []}, "models of Acme: expected the camera's name as EXIF has it"),
        ({"raw_extension": "ARW"}, "raw_extension of Acme: expected a raw file's, with the dot"),
        ({"isos": [800, 100]}, "isos of Acme: expected one or more, rising"),
        ({"base_iso": 200}, "base_iso of Acme: expected one of its ISOs, 100, 800; found 200"),
        ({"true_isos": {"150": 100}}, "expected its ISOs, found 150"),
        ({"true_isos": {"100": 20}}, "expected speeds within 1 stop of their names, found 20 for ISO 100"),
        ({"true_isos": {"100": "81"}}, "true_isos.100: expected a finite number"),
        ({"true_isos": {"ISO 100": 81}}, "true_isos: expected ISOs with their speeds"),
        ({"cfa": "foveon"}, "field cfa: expected one of 'bayer', 'xtrans', found 'foveon'"),
        ({"shutter": LADDER | {"step": "1/4"}}, "shutter step: expected 1/3, 1/2 or 1 stop, found 1/4"),
        ({"shutter": LADDER | {"fastest": "1/7000"}}, "steps of 1/3 stop; the nearest is 1/6400 s"),
        ({"shutter": LADDER | {"fastest": "30", "slowest": "1"}}, "the fastest time, 30 s, is slower than"),
        ({"shutter": {"times": []}}, "shutter times: expected at least one, found none"),
        ({"shutter": {"times": ["1/2", "0.5"]}}, "expected each time once, found 0.5 twice"),
        ({"shutter": {"times": ["1", "1/2"]}}, "expected the fastest first, found 0.5 after 1"),
        ({"shutter": {"times": ["1/2"], "fastest": "1/8"}}, "field shutter.fastest: is unknown; known are step, "),
        ({"shutter": {"times": ["1/2"], "true_times": "roughly"}}, "expected one of 'powers-of-two', 'as-named'"),
    ],
)
def test_malformed_descriptions(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = tmp_path / "cam.json"
    path.write_text(json.dumps(GOOD | change))
    with pytest.raises(CaptureError) as caught:
        CameraDescription.load(path)
    assert str(caught.value).startswith(str(path))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@in_one_test("text", ["", "1/", "/2", "1e3", "nan", "1/2/3", "1 s", "٣", "1/0", "-1", "9" * 20])
def test_what_names_no_time_is_refused(text: str) -> None:
    with pytest.raises(ArgumentError):
        parse_seconds(text)
