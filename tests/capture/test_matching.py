"""Matching without files: what a photographer does wrong, and what is made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from fractions import Fraction
from pathlib import Path
from typing import Literal

from hypothesis import given, settings
from hypothesis import strategies as st

from capture.mapping import explain_metering
from capture.matching import Match, match
from capture.observed import Observed, ObservedFrame
from capture.plan import Plan
from capture.shots import plan_calibration
from tests.capture.simulated import START, Taken, as_planned, plan_of
from tests.cases import in_one_test
from tests.shared import there

Slot = tuple[str, int]


@dataclass
class Press:
    """One press of the release, and the shot that it should be taken for."""

    taken: Taken
    slot: Slot | None


def scene_of(plan: Plan, name: str, *, before_s: float = 200.0) -> list[Press]:
    shots = plan.scene(name).shots
    presses = [Press(taken, (name, shot.number)) for taken, shot in zip(as_planned(shots), shots, strict=True)]
    presses[0].taken = replace(presses[0].taken, pause_s=before_s)
    return presses


def session(plan: Plan) -> list[Press]:
    return [press for scene in plan.scenes for press in scene_of(plan, scene.name)]


def planned(*metered: str) -> tuple[Plan, list[Press]]:
    """A plan, and its scenes taken as planned."""
    plan = plan_of(*metered)
    return plan, session(plan)


def develop(presses: Sequence[Press], *, times: bool = True) -> tuple[Observed, dict[Slot, str]]:
    """What the card holds, and the file of each shot."""
    now = START
    frames, truth = [], {}
    for index, press in enumerate(presses):
        now += timedelta(seconds=press.taken.pause_s)
        path = Path(f"DSC{index:04d}.ARW")
        taken = now if times else None
        frames.append(ObservedFrame(path, Fraction(press.taken.iso), press.taken.exposure_s, taken, press.taken.model))
        if press.slot is not None:
            truth[press.slot] = path.name
    return Observed(tuple(frames), (), times), truth


def matched(
    plan: Plan, presses: Sequence[Press], *, times: bool = True, repeated: Literal["last", "first"] = "last"
) -> Match:
    """Match what the card holds; each shot has its file."""
    observed, truth = develop(presses, times=times)
    found = match(plan, observed, repeated=repeated)
    assert {slot: frame.path.name for slot, frame in found.frames.items()} == truth
    return found


def kinds(found: Match) -> list[str]:
    return sorted({remark.kind for remark in found.remarks})


def again(press: Press, slot: Slot | None, pause_s: float = 3.0) -> Press:
    return Press(replace(press.taken, pause_s=pause_s), slot)


EXTRA = Press(Taken(200, Fraction(1, 30)), None)


@in_one_test("times", [True, False])
@in_one_test("metered", [("4",), ("4",) * 10, ("4", "1", "2", "1", "4", "8", "1.3", "0.8", "30", "5")])
def test_nothing_false_on_a_clean_set(metered: tuple[str, ...], times: bool) -> None:
    found = matched(*planned(*metered), times=times)
    assert kinds(found) == ([] if times else ["no-times"])
    assert not found.doubtful


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 31), st.sampled_from(("4 4", "4 1")))
def test_a_skipped_shot_shifts_nothing(index: int, metered: str) -> None:
    plan, presses = planned(*metered.split())
    skipped = presses.pop(index)
    if index == 16:
        presses[16].taken = replace(presses[16].taken, pause_s=200.0)
    found = matched(plan, presses)
    assert [(remark.scene, remark.number) for remark in found.missing] == [skipped.slot]
    assert kinds(found) == ["missing"]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 31), st.integers(1, 3), st.sampled_from(("last", "first")))
def test_of_a_repeated_shot_the_last_is_taken(index: int, more: int, which: Literal["last", "first"]) -> None:
    plan, presses = planned("4", "4")
    press = presses[index]
    # Pauses that grow shorter: only one that is three times the next begins something else.
    copies = [Press(press.taken, None)] + [again(press, None, pause_s) for pause_s in (8.0, 4.0, 3.0)[:more]]
    copies[-1 if which == "last" else 0].slot = press.slot
    presses[index : index + 1] = copies
    found = matched(plan, presses, repeated=which)
    assert kinds(found) == ["repeated"]
    assert len(found.remarks) == more
    assert {(remark.scene, remark.number) for remark in found.remarks} == {press.slot}
    assert found.frames[there(press.slot)].path.name in found.remarks[0].text


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 30))
def test_swapped_shots_are_told_apart(index: int) -> None:
    plan, presses = planned("4", "1")
    if index == 15:
        return  # of two scenes: nobody does that
    one, other = presses[index], presses[index + 1]
    presses[index] = again(other, other.slot, one.taken.pause_s)
    presses[index + 1] = again(one, one.slot)
    found = matched(plan, presses)
    assert kinds(found) == ["out-of-order"]
    assert len(found.remarks) == 1


@settings(deadline=None, max_examples=30)
@given(st.lists(st.integers(0, 32), min_size=1, max_size=5))
def test_test_shots_are_named_and_left_out(places: list[int]) -> None:
    plan, presses = planned("4", "1")
    for place in sorted(places, reverse=True):
        presses.insert(place, EXTRA)
    found = matched(plan, presses)
    assert [remark.kind for remark in found.remarks] == ["extra"] * len(places)
    assert "ISO 200, 1/30 s: not a shot of the plan" in found.remarks[0].text


@settings(deadline=None, max_examples=20)
@given(st.permutations(["scene-1", "scene-2", "scene-3"]))
def test_scenes_in_any_order(order: list[str]) -> None:
    plan = plan_of("4", "1", "2")
    found = matched(plan, [press for name in order for press in scene_of(plan, name)])
    assert kinds(found) == ([] if order == sorted(order) else ["scene-order"])
    assert not found.doubtful


@in_one_test("given_up_after", [2, 5, 9, 15])
@in_one_test("metered", ["4 4 4", "4 1 2"])
def test_a_scene_begun_again(given_up_after: int, metered: str) -> None:
    """The lamp fell over: the second take counts, whole."""
    plan, presses = planned(*metered.split())
    attempt = [Press(press.taken, None) for press in presses[16 : 16 + given_up_after]]
    presses[16].taken = replace(presses[16].taken, pause_s=30.0)
    presses[16:16] = attempt
    found = matched(plan, presses)
    assert set(kinds(found)) <= {"repeated", "ambiguous"}
    assert len([remark for remark in found.remarks if remark.kind == "repeated"]) == given_up_after


def test_a_third_of_a_scene_is_that_scene() -> None:
    plan, presses = planned("4", "1")
    assert len(matched(plan, [*presses[:16], *presses[17:23]]).missing) == 10


def test_a_beginning_with_old_settings_is_not_the_end_taken_again() -> None:
    """The pause before it is much longer than the one after it."""
    plan, presses = planned("4", "1")
    presses[16].taken = replace(presses[16].taken, pause_s=30.0)
    presses.insert(16, again(presses[15], None, 200.0))
    assert len(matched(plan, presses).remarks) == 1


@in_one_test("time", [160, 174])  # 0.32 and 0.2 stops off
def test_a_wrong_setting_is_named(time: int) -> None:
    plan, presses = planned("4")
    presses[3] = Press(replace(presses[3].taken, exposure_s=Fraction(1, time)), None)
    found = matched(plan, presses)
    assert kinds(found) == ["missing", "wrong-setting"]
    (missing,) = found.missing
    assert missing.text == (
        "scene-1 frame 4 (noisy, ISO 800, 1/200 s): no file; DSC0003.ARW may be meant, but was taken at ISO 800, "
        f"1/{time} s"
    )


def test_calibration_frames() -> None:
    plan = plan_of("4")
    plan = replace(plan, calibration=plan_calibration(plan.camera, 100, (100, 800), Fraction(1, 2)))
    shots = there(plan.calibration).shots
    calibration = [
        Press(taken, ("calibration", shot.number)) for taken, shot in zip(as_planned(shots), shots, strict=True)
    ]
    assert kinds(matched(plan, [*calibration, *session(plan)])) == ["scene-order"]
    more = [Press(calibration[0].taken, None)] * 2
    assert kinds(matched(plan, [*more, *calibration, *session(plan)])) == ["repeated", "scene-order"]


# --- scenes that were metered again -----------------------------------------------------------------------------------


def explained(plan: Plan, shot: Plan, *more: Press) -> Match:
    observed, _ = develop([*session(shot), *more])
    return explain_metering(plan, observed, match(plan, observed))


def test_a_scene_that_was_metered_again_is_one_line_with_what_to_do() -> None:
    plan = plan_of("4", "4", "1")
    found = explained(plan, plan.remeter("scene-2", Fraction(16, 5)))
    (remark,) = [remark for remark in found.remarks if remark.kind == "metered"]
    assert "16 of its 16 frames are there if it was metered at 3.2 s" in remark.text
    assert "--remeter scene-2=3.2" in remark.text
    assert "extra" not in kinds(found)
    assert found.doubtful


def test_of_what_no_metered_time_explains_each_file_is_named() -> None:
    plan = plan_of("4", "1")
    assert explained(plan, plan).remarks == ()
    found = explained(plan, plan.only(["scene-1"]), EXTRA)
    assert "metered" not in kinds(found)
    assert [remark.path for remark in found.remarks if remark.kind == "extra"] == [Path("DSC0016.ARW")]
