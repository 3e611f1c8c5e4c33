from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture.camera import EXAMPLE, CameraDescription, Shutter
from capture.capture_errors import CaptureError, ImpossibleShotError
from capture.plan import Plan, make_plan
from capture.protocol import PAPER, RELEASED, CaptureProtocol
from capture.shots import choose_isos, format_minutes, plan_calibration, plan_shots, sum_duration_s
from tests.capture.simulated import CAMERA, plan_of
from tests.cases import in_one_test
from tests.shared import there

DIALS = [time.dial for time in EXAMPLE.shutter.times]


# --- shots --------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=40)
@given(st.sampled_from(DIALS), st.sampled_from((RELEASED, PAPER)), st.sampled_from((Fraction(1, 3), Fraction(1, 2))))
def test_shots_of_any_metered_time(dial: str, protocol: Any, step: Fraction) -> None:
    camera = replace(EXAMPLE, shutter=Shutter.between("1/8000", "30", step))
    try:
        shots = plan_shots(camera, protocol, Fraction(dial))
    except ImpossibleShotError:
        return
    base = shots[0].setting
    for frame, shot in zip(protocol.frames(), shots, strict=True):
        assert (shot.number, shot.role, shot.iso, shot.factor) == (frame.number, frame.role, frame.iso, frame.factor)
        assert shot.target_s == protocol.exposure_s(frame, base.nominal_s)
        assert shot.setting in camera.shutter.times
        if shot.factor is None:
            assert shot.setting == base
            continue
        assert there(shot.true_ratio) * shot.setting.true_s * shot.iso / 100 == pytest.approx(base.true_s, rel=1e-12)
        assert shot.named_ratio == base.nominal_s * 100 / (shot.setting.nominal_s * shot.iso)
        # Within half of a step; in thirds of a stop the usual factors come out within 1.6 %.
        assert abs(math.log2(there(shot.ratio_error))) <= float(step) / 2 + 1e-9
        if step == Fraction(1, 3):
            assert abs(there(shot.ratio_error) - 1) < 0.016
    if step == Fraction(1, 3):
        assert plan_of(dial).scenes[0].remarks == () if Fraction(dial) == base.nominal_s else True


@in_one_test(
    "camera, metered, words",
    [
        (EXAMPLE, "1/2", "noisy frame 15 (ISO 3200, x200) needs 1/12800 s, and SonyA7S2's fastest time is 1/8000 s."),
        (EXAMPLE, "1/2", "Let 2/3 stop less light in, so that the scene meters at 0.8 s or longer: stop down by 2/3"),
        (EXAMPLE, "60", "needs 60 s, and SonyA7S2's slowest time is 30 s. Let 1 stop more light in"),
        (EXAMPLE, "60", "or take ISO 200 as the base"),
        (
            *(replace(EXAMPLE, shutter=Shutter.between("1/500", "1", Fraction(1, 3))), "1"),
            "no metered time brings all of them between 1/500 s and 1 s, which SonyA7S2 has: take smaller low-light",
        ),
    ],
)
def test_impossible_shots_say_what_to_change(camera: CameraDescription, metered: str, words: str) -> None:
    """And what they say helps: a scene of 60 s at ISO 100 is one of 30 s at ISO 200."""
    with pytest.raises(ImpossibleShotError) as caught:
        plan_shots(camera, RELEASED, Fraction(metered))
    assert words in str(caught.value)
    assert plan_shots(EXAMPLE, replace(RELEASED, base_iso=200), Fraction(30))[0].setting.dial == "30"


def test_what_to_know_about_a_scene_of_full_stops() -> None:
    """Names, such as 1/15 s for 1/16 s, and a metered time between two of them."""
    camera = replace(EXAMPLE, shutter=Shutter.between("1/8000", "30", Fraction(1)))
    rounded, far = make_plan(camera, PAPER, {"scene-1": Fraction(3)}).scenes[0].remarks
    assert rounded == "metered at 3 s, set as 4 s, the camera's nearest time"
    assert far.startswith("frames 2, 3, 5, 6, 8, 9: the ratio is more than 10 % off its factor, which eldata verify")


def test_the_time_that_shots_take() -> None:
    """Sixteen frames: 4 references of 4 s and 12 noisy ones; the sum is that of its parts."""
    plan = plan_of("4", "4")
    shots = plan.scenes[0].shots
    exposures_s = 16 + sum(shot.setting.true_s for shot in shots if shot.factor)
    # Both dials at the start; within an ISO one for each factor after the first; ISO and time at and after a reference.
    turns = 2 + 3 * (2 + 3 + 2)
    assert sum_duration_s(shots) == pytest.approx(exposures_s + 5 * turns + 2 * 16)
    # The next scene begins as the one before ends.
    assert plan.duration_s == pytest.approx(2 * exposures_s + 5 * (2 * turns - 2) + 2 * 32)
    texts = [format_minutes(seconds) for seconds in (40, 89.5, 91, 11000)]
    assert texts == ["40 s", "90 s", "2 min", "3 h 4 min"]


def test_true_isos_give_the_light() -> None:
    """ISO 800 that is ISO 566, half a stop slower: noisy frames are longer by half a stop, as far as thirds allow."""
    half = Fraction(566, 800)
    camera = replace(EXAMPLE, true_isos=((100, Fraction(100)), (800, 800 * half), (1600, Fraction(1600))))
    protocol = replace(RELEASED, noisy_isos=(800, 1600))
    plain, shots = plan_shots(EXAMPLE, protocol, Fraction(4)), plan_shots(camera, protocol, Fraction(4))
    for before, shot in zip(plain, shots, strict=True):
        assert shot.true_iso == {100: 100, 800: 566, 1600: 1600}[shot.iso]
        if shot.iso != 800:
            assert (shot.setting, shot.true_ratio) == (before.setting, before.true_ratio)
            continue
        true_light = shot.setting.true_s * 566
        assert shot.true_ratio == pytest.approx(4 * 100 / true_light)
        assert shot.named_ratio == Fraction(4 * 100) / (shot.setting.nominal_s * 800)
        assert shot.setting.true_s > before.setting.true_s
        assert abs(math.log2(there(shot.ratio_error))) <= 1 / 6 + 1e-9
    # A camera that is off everywhere alike is off nowhere in its ratios.
    alike = replace(EXAMPLE, true_isos=tuple((iso, iso * half) for iso in EXAMPLE.isos))
    found = plan_shots(alike, RELEASED, Fraction(4))
    for before, shot in zip(plan_shots(EXAMPLE, RELEASED, Fraction(4)), found, strict=True):
        assert replace(shot, true_iso=None) == before


# --- calibration frames -------------------------------------------------------------------------------------------


def test_calibration_frames() -> None:
    plan = plan_calibration(EXAMPLE, 100, choose_isos(EXAMPLE, RELEASED), Fraction(1, 2))
    assert plan.isos == (100, 200, 400, 800, 1600, 3200)
    bias = [shot for shot in plan.shots if shot.role == "bias"]
    flats = [shot for shot in plan.shots if shot.role == "flat"]
    assert [shot.number for shot in plan.shots] == list(range(1, len(plan.shots) + 1))
    assert len(bias) == 6 * 10
    assert {shot.setting.dial for shot in bias} == {"1/8000"}
    assert len(flats) == 6 * 6 * 2
    assert [shot.setting.dial for shot in flats if shot.iso == 100][::2] == ["1/20", "1/13", "1/8", "1/5", "1/4", "0.4"]
    assert plan.remarks == ()


@settings(deadline=None)
@given(st.sampled_from(DIALS), st.sampled_from((Fraction(1, 3), Fraction(1, 2), Fraction(1))))
def test_flats_never_clip_and_come_in_pairs(dial: str, step: Fraction) -> None:
    camera = replace(EXAMPLE, shutter=Shutter.between("1/8000", "30", step))
    clips_at_s = Fraction(dial)
    try:
        plan = plan_calibration(camera, 100, (100, 800), clips_at_s)
    except ImpossibleShotError:
        return
    flats = [shot for shot in plan.shots if shot.role == "flat"]
    named = camera.find_marked(clips_at_s)
    clips = float(clips_at_s) if named is None else named.true_s
    for first, second in zip(flats[::2], flats[1::2], strict=True):
        assert replace(first, number=second.number) == second
        level = there(first.level)
        share = first.setting.true_s * first.iso / 100 / clips
        assert share <= float(level) * (1 + 1e-9)
        assert first.setting != camera.fastest
    for iso in (100, 800):
        times = [shot.setting.nominal_s for shot in flats if shot.iso == iso]
        assert times == sorted(times)
        assert all(times.count(time) == 2 for time in times)
    if step != 1:
        assert plan.remarks == ()


@in_one_test(
    "isos, clips_at, changes, words",
    [
        ((100, 150), "1/2", {}, "SonyA7S2 has no ISO 150"),
        ((800, 100), "1/2", {}, "calibration ISOs: expected one or more, rising"),
        ((100,), "1/2", {"bias_frames": 3}, "bias frames per ISO: expected 4 to 999, found 3"),
        ((100,), "1/2", {"flat_levels": (Fraction(1, 2), Fraction(1))}, "flat levels: expected shares between 0 and 1"),
        ((100, 25600), "1/4", {}, "the flat of 10 % at ISO 25600 needs 9.77e-05 s"),
        ((100,), "1000", {}, "SonyA7S2's slowest time is 30 s: light the surface more or open up"),
    ],
)
def test_wrong_calibration(isos: tuple[int, ...], clips_at: str, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(CaptureError) as caught:
        plan_calibration(EXAMPLE, 100, isos, Fraction(clips_at), **changes)
    assert words in str(caught.value)


# --- plans --------------------------------------------------------------------------------------------------------


def test_changes_leave_the_rest_alone() -> None:
    plan = plan_of("4", "1").add_note("scene-2", "books")
    changed = plan.remeter("scene-2", Fraction(2)).add_scene("scene-7", Fraction(8)).add_note("scene-7", "cups")
    assert changed.add_scene("scene-7", Fraction(8)).add_note("scene-7", "cups") == changed, "the same command again"
    assert changed.scenes[0] == plan.scenes[0]
    assert changed.scene("scene-2").notes == ("books",)
    assert changed.scene("scene-2").shots == plan_of("2").scenes[0].shots
    assert changed.scene("scene-7").notes == ("cups",)
    assert len(changed.shots) == 48


def test_wrong_scenes() -> None:
    for name, metered, words in (
        ("scene-1", "2", "expected each once, found scene-1 twice"),
        ("kitchen", "4", "expected scene-1, scene-2 and so on"),
        ("scene-2/../x", "4", "expected scene-1"),
        ("scene-2", "1/50", "scene-2: metered at 1/50 s"),
    ):
        with pytest.raises(CaptureError, match=words):
            plan_of("4").add_scene(name, Fraction(metered))
    with pytest.raises(CaptureError, match="no scene called 'scene-9'"):
        plan_of("4").remeter("scene-9", Fraction(4))
    with pytest.raises(CaptureError, match="at least one scene"):
        make_plan(CAMERA, RELEASED, {})


def every_kind() -> Plan:
    """A plan with everything that a file can say."""
    speeds = tuple((iso, Fraction(iso) * Fraction(9, 10)) for iso in CAMERA.isos)
    camera = replace(CAMERA, true_isos=speeds)
    protocol = CaptureProtocol(100, (800,), (1, 10), repeats=2, references=3)
    frames = plan_calibration(camera, 100, (100, 800), Fraction(1, 2), bias_frames=4)
    plan = make_plan(camera, protocol, {"scene-1": Fraction(4)}, frames).add_note("scene-1", "books, ünïcode")
    return plan.set_aperture("scene-1", Fraction("5.6"))


def test_a_file_says_all_of_a_plan(tmp_path: Path) -> None:
    every_kind().save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json") == every_kind()


EVERYTHING = json.loads(json.dumps(every_kind().as_dict()))


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a JSON value."""
    found = [path] if path else []
    if isinstance(value, dict):
        for key, item in value.items():
            found += places(item, (*path, key))
    elif isinstance(value, list) and value:
        found += places(value[0], (*path, 0))
    return found


def load_changed(folder: Path, place: tuple[Any, ...], value: object) -> str:
    """What loading a plan says of which one value was changed."""
    content = copy.deepcopy(EVERYTHING)
    at = content
    for key in place[:-1]:
        at = at[key]
    at[place[-1]] = value
    path = folder / "plan.json"
    path.write_text(json.dumps(content))
    with pytest.raises(CaptureError) as caught:
        Plan.load(path)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)


@in_one_test("place", places(EVERYTHING))
@in_one_test("wrong", [{"x": 1}, -7, "soon"])
def test_every_field_is_checked(place: tuple[Any, ...], wrong: object, tmp_path: Path) -> None:
    if place in ((("scenes", 0, "notes", 0)), ("camera", "name"), ("camera", "models", 0)) and wrong == "soon":
        return  # any text will do
    assert "\n" not in load_changed(tmp_path, place, wrong)


@in_one_test(
    "place, value, words",
    [
        (("scenes", 0, "shots", 3, "dial"), "1/160", "field scenes[0].shots[3].dial: expected '0.5' (shots follow"),
        (("scenes", 0, "shots", 3, "true_ratio"), 100.0, "scenes[0].shots[3].true_ratio: expected 1"),
        (("scenes", 0, "metered_s"), "8", "scenes[0].shots[0].target_s: expected '8'"),
        (("scenes", 0, "shots"), [], "field scenes[0].shots: expected 10 shots"),
        (("calibration", "bias_frames"), 5, "calibration.shots"),
        (("schema",), 2, "a newer file needs a newer capture"),
    ],
)
def test_shots_changed_by_hand_are_found(place: tuple[Any, ...], value: object, words: str, tmp_path: Path) -> None:
    assert words in load_changed(tmp_path, place, value)
