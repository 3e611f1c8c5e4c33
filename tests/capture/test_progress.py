"""What the phone knows comes home: the checklist's export in plans and in the matching of files."""

from __future__ import annotations

import io
import json
import sys
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from capture.calibration import plan_calibration
from capture.checklist import load_progress
from capture.cli import main
from capture.noted import match_noted
from capture.plan import Plan
from tests.capture.simulated import CAMERA, plan_of
from tests.capture.test_checklist import exported, written
from tests.capture.test_matching import Press, develop, kinds, names, scene_of, session

if TYPE_CHECKING:
    from pathlib import Path

    from capture.matching import Match


def ticked(plan: Plan) -> dict[str, Any]:
    """What the page exports once every shot is ticked."""
    content = exported(plan)
    for shots in (*(scene["shots"] for scene in content["scenes"]), content["calibration"]):
        for shot in shots:
            shot["taken_at"] = shot["dial"]
    return content


def texts(found: Match, kind: str) -> list[str]:
    return [remark.text for remark in found.remarks if remark.kind == kind]


class Evening:
    """A plan, what was pressed, and what the checklist says."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        self.plan, self.folder = plan, folder
        self.presses = session(plan)
        self.content = ticked(plan)

    def row(self, scene: int, number: int) -> dict[str, Any]:
        row: dict[str, Any] = self.content["scenes"][scene - 1]["shots"][number - 1]
        return row

    def found(self) -> tuple[Match, dict[tuple[str, int], str]]:
        progress = load_progress(written(self.content, self.folder), self.plan)
        observed, truth = develop(self.presses)
        return match_noted(self.plan, observed, progress), truth


# --- files and shots ----------------------------------------------------------------------------------------------


def test_a_checklist_that_agrees_says_nothing(tmp_path: Path) -> None:
    evening = Evening(plan_of("4", "1"), tmp_path)
    for index, press in enumerate(evening.presses):
        assert press.slot is not None
        scene = int(press.slot[0].removeprefix("scene-"))
        # As people write names: whole, without the ending, in small letters, the number alone.
        written_as = (f"DSC{index:04d}.ARW", f"DSC{index:04d}", f"dsc{index:04d}", str(index))[index % 4]
        evening.row(scene, press.slot[1])["file"] = written_as
    found, truth = evening.found()
    assert names(found) == truth
    assert found.remarks == ()


def test_a_name_that_was_written_down_settles_which_of_two_takes_is_used(tmp_path: Path) -> None:
    """The first take of frame 3 is the good one; the order alone takes the last."""
    evening = Evening(plan_of("4", "1"), tmp_path)
    evening.presses[2:3] = [evening.presses[2], Press(evening.presses[2].taken, None)]
    evening.row(1, 3)["file"] = "DSC0002"
    found, truth = evening.found()
    assert names(found) == truth
    assert kinds(found) == ["checklist", "extra"]
    assert texts(found, "checklist") == [
        "scene-1 frame 3: the checklist says DSC0002, used, where by the order of the files it is DSC0003.ARW"
    ]
    assert texts(found, "extra") == ["DSC0003.ARW: the checklist names other files; not used"]
    assert found.doubtful


def test_scenes_of_equal_exposures_are_told_apart_by_one_name_each(tmp_path: Path) -> None:
    """Two files whose order was wrong change places."""
    evening = Evening(plan_of("4", factors=(100,)), tmp_path)
    evening.row(1, 1)["file"] = "DSC0006"  # frames 1 and 7 are both references of 4 s
    found, _ = evening.found()
    assert names(found)["scene-1", 1] == "DSC0006.ARW"
    assert names(found)["scene-1", 7] == "DSC0000.ARW"
    assert len(found.frames) == 7
    assert found.doubtful


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({(1, 3): "DSC0999"}, "says DSC0999, not among the files given; by the order of the files it is DSC0002"),
        ({(1, 3): "DSC0004"}, "DSC0004, taken at ISO 800, 1/400 s, where the plan has ISO 800, 1/20 s"),
        ({(1, 1): "DSC0005", (1, 6): "DSC0005"}, ""),
        ({(1, 6): "DSC0015", (1, 11): "DSC0015"}, "frame 11: the checklist says DSC0015, which is another shot's"),
    ],
)  # fmt: skip
def test_names_that_cannot_be_right_are_said(changes: dict[tuple[int, int], str], words: str, tmp_path: Path) -> None:
    evening = Evening(plan_of("4"), tmp_path)
    for place, name in changes.items():
        evening.row(*place)["file"] = name
    found, _ = evening.found()
    assert len(found.frames) == 16
    assert len({frame.path for frame in found.frames.values()}) == 16
    assert found.doubtful
    assert words in " ".join(texts(found, "checklist"))


def test_what_was_skipped_is_no_gap(tmp_path: Path) -> None:
    evening = Evening(plan_of("4", "1", "2"), tmp_path)
    evening.presses = evening.presses[:32]  # without the third scene
    del evening.presses[3]
    evening.row(1, 4)["taken_at"] = None
    for number in range(1, 17):
        evening.row(3, number)["taken_at"] = None
    found, truth = evening.found()
    assert names(found) == truth
    assert kinds(found) == ["skipped"]
    assert (found.missing, found.doubtful) == ((), False)
    assert len(texts(found, "skipped")) == 17
    # What is ticked and has no file is a gap, and is said to be ticked.
    evening.row(1, 4)["taken_at"] = "1/200"
    found, _ = evening.found()
    assert [remark.text for remark in found.missing] == [
        "scene-1 frame 4 (noisy, ISO 800, 1/200 s): no file; ticked on the checklist"
    ]
    # A shot that has a file and no tick: the ticks were not kept, and excuse nothing.
    evening.row(1, 4)["taken_at"] = evening.row(1, 5)["taken_at"] = None
    found, _ = evening.found()
    assert len(found.missing) == 17
    assert texts(found, "note") == [
        "1 of the shots that have files are not ticked, so that ticks do not say what was skipped"
    ]


def test_ticks_tell_which_of_two_equal_scenes_was_taken(tmp_path: Path) -> None:
    evening = Evening(plan_of("4", "4", "4"), tmp_path)
    evening.presses = scene_of(evening.plan, "scene-2")
    for scene in (1, 3):
        for number in range(1, 17):
            evening.row(scene, number)["taken_at"] = None
    found, truth = evening.found()
    assert names(found) == truth
    assert kinds(found) == ["skipped"]
    assert set(texts(found, "skipped")) == {
        f"{scene}: none of its 16 frames; not ticked on the checklist either" for scene in ("scene-1", "scene-3")
    }
    # Files of a scene that was not ticked are not lost: the ticks explain less than the files show.
    evening.presses = session(evening.plan)[:32]
    found, truth = evening.found()
    assert names(found) == truth
    assert len(found.missing) == 16


def test_repeats_and_remarks(tmp_path: Path) -> None:
    evening = Evening(plan_of("4", "1"), tmp_path)
    evening.presses[2:3] = [Press(evening.presses[2].taken, None), evening.presses[2]]
    found, truth = evening.found()
    assert kinds(found) == ["repeated"]
    assert found.doubtful
    evening.row(1, 3).update(repeats=1, remark="a lamp blew")
    found, _ = evening.found()
    assert names(found) == truth
    assert (kinds(found), found.doubtful) == (["note", "retaken"], False)
    assert texts(found, "note") == ["scene-1 frame 3: a lamp blew"]
    assert texts(found, "retaken")[0].endswith("repeated on the checklist too")


def test_calibration_frames_are_ticked_by_rows(tmp_path: Path) -> None:
    plan = plan_of("4")
    plan = replace(plan, calibration=plan_calibration(CAMERA, 100, (100, 800), Fraction(1, 2), bias_frames=4))
    content = ticked(plan)
    content["calibration"][-1]["taken_at"] = None
    assert content["calibration"][-1]["count"] == 2
    progress = load_progress(written(content, tmp_path), plan)
    observed, _ = develop(scene_of(plan, "scene-1"))
    found = match_noted(plan, observed, progress)
    assert len(found.missing) == 8 + 24 - 2
    assert len(texts(found, "skipped")) == 2


# --- the commands -------------------------------------------------------------------------------------------------


def pasted(text: str) -> SimpleNamespace:
    return SimpleNamespace(buffer=io.BytesIO(text.encode()), isatty=lambda: False)


def test_pasted_text_changes_the_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_of("4", "4")
    plan.save(tmp_path / "plan.json")
    metered = plan.remeter("scene-2", Fraction(2))
    content = ticked(metered)
    content["scenes"][1]["shots"][3] |= {"remark": "lamp flickers", "taken_at": None}
    for _ in range(2):  # the second time changes nothing
        monkeypatch.setattr(sys, "stdin", pasted(json.dumps(content, indent=1)))
        assert main(["plan", str(tmp_path / "plan.json"), "--progress", "-"]) == 0
        assert capsys.readouterr().out.count("not taken, by the checklist:\n    scene-2: frame 4\n") == 1
        assert Plan.load(tmp_path / "plan.json") == metered.add_note("scene-2", "frame 4: lamp flickers")
    monkeypatch.setattr(sys, "stdin", pasted(json.dumps(content)[:100]))
    assert main(["plan", str(tmp_path / "plan.json"), "--progress", "-"]) == 2
    assert capsys.readouterr().err.startswith("capture plan: the pasted text: is not JSON, or not whole")
