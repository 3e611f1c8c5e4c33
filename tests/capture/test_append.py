"""Several cards, nights and cameras in one set, with real files."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from datetime import timedelta
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from capture.plan import make_plan
from eldata.base.files import sha256_of
from eldata.manifest import load_manifest
from tests.capture import simulated
from tests.capture.simulated import CAMERA, Nights, Taken, plan_of, shoot, whole_plan

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def nights(tmp_path: Path) -> Nights:
    return Nights(tmp_path)


def night(folder: Path, taken: list[Taken], monkeypatch: pytest.MonkeyPatch, day: int) -> list[Path]:
    """A card that was filled on this day; its pixels are on none of the other cards."""
    start = simulated.START
    monkeypatch.setattr(simulated, "START", start + timedelta(days=day))
    files = shoot(folder, [Taken(200, Fraction(1, 30 + day)), *taken])  # a test shot, so that no two cards are alike
    monkeypatch.setattr(simulated, "START", start)
    files[0].unlink()
    return files[1:]


def test_a_scene_on_two_cards(nights: Nights, capsys: pytest.CaptureFixture[str]) -> None:
    """The first card was full in the middle of the second scene, before the reference of what it has."""
    plan = plan_of("4", "1", "2")
    files = shoot(nights.folder / "both", whole_plan(plan))
    for name, some in (("one", files[:26]), ("two", files[26:])):
        (nights.folder / name).mkdir()
        for path in some:
            shutil.move(path, nights.folder / name / path.name)
    assert nights.add(plan, nights.folder / "one", options=("--allow-gaps", "--yes")) == 0
    output = capsys.readouterr().out
    assert "scene-2 frame 9: compared with frame 6, as 11 is missing" in output
    card = nights.csv.with_suffix(".json")
    card.write_text(card.read_text().replace('"licence": "not stated"', '"licence": "CC0"'))
    assert nights.add(plan, nights.folder / "two") == 0
    output = capsys.readouterr().out
    assert "has 26 of the plan's 48 shots" in output
    assert "22 of 22 shots have a file" in output
    assert "48 files below" in output
    assert "22 of them new" in output
    assert nights.problems() == []
    manifest = load_manifest(nights.csv)
    assert (manifest.card.licence, manifest.card.counts) == ("CC0", {"noisy": 36, "reference": 12})
    assert manifest.card.title == "3 scenes taken with AcmeNocturne"
    whole = Nights(nights.folder / "at-once")
    whole.folder.mkdir()
    assert whole.add(plan, nights.folder / "one", nights.folder / "two", options=()) == 0
    assert whole.csv.read_bytes() == nights.csv.read_bytes()
    before = nights.csv.read_bytes(), card.read_bytes()
    capsys.readouterr()
    assert nights.add(plan, nights.folder / "two") == 0  # again: nothing is left to add
    assert "22 of the files given are in the set already, or copies; 0 are not" in capsys.readouterr().out
    assert (nights.csv.read_bytes(), card.read_bytes()) == before


def test_a_second_plan_and_what_is_not_mixed_in(
    nights: Nights, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plans = (
        plan_of("4", factors=(100,)),
        make_plan(CAMERA, replace(plan_of("4").protocol, low_light_factors=(100,)), {"scene-2": Fraction(4)}),
    )
    for index, plan in enumerate(plans):
        night(nights.folder / str(index), whole_plan(plan), monkeypatch, index)
        assert nights.add(plan, nights.folder / str(index), options=("--append",) if index else ()) == 0
    assert {record.scene for record in load_manifest(nights.csv).records} == {"scene-1", "scene-2"}
    # What is not of the set's plan, or of other scenes of the same name, is not mixed in.
    before = nights.csv.read_bytes()
    capsys.readouterr()
    assert nights.add(plan_of("1", factors=(100,)), nights.folder / "0") == 2
    assert "IMG_0001.dng, taken at ISO 100, 4 s, and the plan asks for ISO 100, 1 s there" in capsys.readouterr().err
    night(nights.folder / "new", whole_plan(plans[0]), monkeypatch, 7)
    assert nights.add(plans[0], nights.folder / "new") == 1
    assert "7 are not\nand every shot of the plan is. Another night's scenes" in capsys.readouterr().out
    renamed = replace(CAMERA, models=("Nocturne X",))
    taken = [replace(press, model="Nocturne X") for press in whole_plan(plans[0])]
    night(nights.folder / "x", taken, monkeypatch, 8)
    assert nights.add(make_plan(renamed, plans[0].protocol, {"scene-5": Fraction(4)}), nights.folder / "x") == 2
    remark = "whose model in EXIF is Nocturne 1, and that of the plan's AcmeNocturne is Nocturne X"
    assert remark in capsys.readouterr().err
    assert nights.csv.read_bytes() == before
    assert nights.problems() == []


def test_what_cannot_be_joined(
    nights: Nights, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_of("4", "1", factors=(100,))
    night(nights.folder / "one", whole_plan(plan.only(["scene-1"])), monkeypatch, 0)
    night(nights.folder / "two", whole_plan(plan.only(["scene-2"])), monkeypatch, 1)
    assert nights.add(plan, nights.folder / "one", options=("--only", "scene-1")) == 0
    capsys.readouterr()
    data, nights.data = nights.data, nights.folder / "elsewhere" / "mine"
    assert nights.add(plan, nights.folder / "two") == 2
    assert "7 files of 7 are not in the one given, such as AcmeNocturne/scene-1/IMG_0001.dng" in capsys.readouterr().err
    nights.data = data
    card = nights.csv.with_suffix(".json")
    content = json.loads(card.read_text())
    card.write_text(json.dumps(content | {"counts": {"noisy": 2, "reference": 4}}))
    digest = sha256_of(nights.csv)
    assert nights.add(plan, nights.folder / "two") == 2
    assert "its card expects {'noisy': 2, 'reference': 4} rows per role, and it has" in capsys.readouterr().err
    assert sha256_of(nights.csv) == digest
    assert not (nights.data / "AcmeNocturne" / "scene-2").exists()
