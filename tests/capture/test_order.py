"""The files' numbers against the camera's clock: where both readings are possible, the photographer chooses."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from capture.cli import main
from capture.matching import match, match_by_numbers
from capture.observed import observe
from eldata.manifest import load_manifest
from tests.capture.simulated import CAMERA, Taken, plan_of, shoot, whole_plan

if TYPE_CHECKING:
    from pathlib import Path

    from capture.plan import Plan


def clock_put_back(plan: Plan) -> list[Taken]:
    """The clock loses a day before the last scene; the counter turns over within the first."""
    taken = whole_plan(plan)
    last = len(taken) - len(plan.scenes[-1].shots)
    return [*taken[:last], replace(taken[last], pause_s=-86400.0), *taken[last + 1 :]]


def ask(folder: Path, plan: Plan, *options: str) -> int:
    plan.save(folder / "plan.json")
    arguments = [str(folder / "plan.json"), str(folder / "card"), "-o", str(folder / "mine.csv"), *options]
    return main(["manifest", *arguments])


def numbers_of(folder: Path, scene: str) -> list[str]:
    """Numbers of the originals that became a scene's frames, told by their pixels."""
    originals = {path.read_bytes(): path.stem for path in sorted((folder / "card").iterdir())}
    records = [one for one in load_manifest(folder / "mine.csv").records if one.scene == scene]
    return [originals[(folder / "set" / one.path).read_bytes()] for one in records]


@pytest.mark.parametrize("digits", [4, 5])
def test_equal_scenes_and_a_clock_that_was_put_back_are_a_question(
    digits: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where the names have five digits, of which the counter has four: DSC09999, then DSC00001."""
    plan = plan_of("4", "4", "4", factors=(1, 10))
    files = shoot(tmp_path / "card", clock_put_back(plan), digits=digits)
    count = len(plan.scenes[0].shots)
    place = ("--copy-to", str(tmp_path / "set"))
    shown = tmp_path / "mapping.json"
    assert ask(tmp_path, plan, *place, "--yes", "--json", str(shown)) == 1  # nobody said yes to either
    out = capsys.readouterr().out
    assert not (tmp_path / "mine.csv").exists()
    first, last = files[0].name, files[-count].name
    by_clock, by_numbers = out.split("by the numbers of the files:")
    (in_clock,) = [line for line in by_clock.splitlines() if line.startswith("scene-1 ")]
    (in_numbers,) = [line for line in by_numbers.splitlines() if line.startswith("scene-1 ")]
    assert last in in_clock
    assert first in in_numbers
    assert "Choose with --order clock or --order numbers" in out
    assert "by_numbers" in json.loads(shown.read_text())
    assert ask(tmp_path, plan, *place, "--order", "numbers") == 0
    assert numbers_of(tmp_path, "scene-1") == [path.stem for path in files[:count]]
    assert ask(tmp_path, plan, "--order", "clock", "--replace", "--copy-to", str(tmp_path / "other")) == 0


@pytest.mark.parametrize("shuffle", [None, 3])
def test_names_that_agree_or_say_nothing_raise_no_question(tmp_path: Path, shuffle: int | None) -> None:
    plan = plan_of("4", "4", "4")
    shoot(tmp_path / "card", whole_plan(plan), shuffle=shuffle)
    observed = observe(sorted((tmp_path / "card").iterdir()), CAMERA.models)
    assert match_by_numbers(plan, observed, match(plan, observed)) is None


def test_scenes_that_exposures_tell_apart_raise_no_question(tmp_path: Path) -> None:
    """The frames are the same ones by either order."""
    plan = plan_of("4", "1", "2")
    shoot(tmp_path / "card", clock_put_back(plan))
    observed = observe(sorted((tmp_path / "card").iterdir()), CAMERA.models)
    assert observed.numbered is not None
    assert observed.numbered.frames != observed.frames
    assert match_by_numbers(plan, observed, match(plan, observed)) is None


def test_the_order_of_names_that_are_no_series_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = plan_of("4", factors=(1,))
    files = shoot(tmp_path / "card", whole_plan(plan))
    files[0].rename(files[0].with_name("first.dng"))
    assert ask(tmp_path, plan, "--order", "numbers") == 2
    assert "the files' names are not one series of numbers" in capsys.readouterr().err


def test_files_without_times_are_in_the_order_of_a_counter_that_turned_over(tmp_path: Path) -> None:
    plan = plan_of("4", "4", factors=(1,))
    files = shoot(tmp_path / "card", whole_plan(plan), times=False)
    named = [path.with_name(f"DSC{(9995 + index) % 9999 + 1:05d}.dng") for index, path in enumerate(files)]
    for path, name in zip(files, named, strict=True):
        path.rename(name)
    assert (named[3].stem, named[4].stem) == ("DSC09999", "DSC00001")
    observed = observe(sorted(named), CAMERA.models)
    assert not observed.by_time
    assert [frame.path for frame in observed.frames] == named
