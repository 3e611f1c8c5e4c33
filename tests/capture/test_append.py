"""Several cards, nights and plans in one set, with real files."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

from capture.plan import make_plan
from eldata.manifest import load_manifest
from tests.capture.simulated import CAMERA, Nights, plan_of, shoot, whole_plan

if TYPE_CHECKING:
    from pathlib import Path


def test_a_scene_on_two_cards(tmp_path: Path) -> None:
    """The first card was full in the middle of the second scene, before the reference of what it has."""
    nights, plan = Nights(tmp_path), plan_of("4", "1", "2")
    files = shoot(tmp_path / "both", whole_plan(plan))
    one, two = tmp_path / "one", tmp_path / "two"
    for card, some in ((one, files[:26]), (two, files[26:])):
        card.mkdir()
        for path in some:
            shutil.move(path, card / path.name)
    output = nights.add(plan, one, options=("--allow-gaps", "--yes"))
    assert "scene-2 frame 9: compared with frame 6, as 11 is missing" in output
    card = nights.csv.with_suffix(".json")
    card.write_text(card.read_text().replace('"licence": "not stated"', '"licence": "CC0"'))
    output = nights.add(plan, two)
    for words in (
        "has 26 of the plan's 48 shots",
        "22 of 22 shots have a file",
        "48 files below",
        "22 of them new",
    ):
        assert words in output
    assert nights.problems() == []
    manifest = load_manifest(nights.csv)
    assert (manifest.card.licence, manifest.card.counts) == ("CC0", {"noisy": 36, "reference": 12})
    assert manifest.card.title == "3 scenes taken with AcmeNocturne"
    whole = Nights(tmp_path / "at-once")
    whole.folder.mkdir()
    whole.add(plan, one, two, options=())
    assert whole.csv.read_bytes() == nights.csv.read_bytes()
    before = nights.csv.read_bytes(), card.read_bytes()
    output = nights.add(plan, two)  # again: nothing is left to add
    assert "22 of the files given are in the set already, or copies; 0 are not" in output
    (two / "broken.dng").write_bytes(b"")
    assert "broken.dng: " in nights.add(plan, two, code=1)
    assert (nights.csv.read_bytes(), card.read_bytes()) == before


def test_a_second_plan_and_what_cannot_be_joined(tmp_path: Path) -> None:
    nights, first = Nights(tmp_path), plan_of("4", factors=(100,))
    second = make_plan(CAMERA, first.protocol, {"scene-2": Fraction(4)})
    for day, (plan, options) in enumerate(((first, ()), (second, ("--append",)))):
        shoot(tmp_path / str(day), whole_plan(plan), day=day)
        nights.add(plan, tmp_path / str(day), options=options)
    assert {record.scene for record in load_manifest(nights.csv).records} == {"scene-1", "scene-2"}

    # What is not of the set's plan, or of other scenes of the same name, is not mixed in.
    before = nights.csv.read_bytes()
    output = nights.add(plan_of("1", factors=(100,)), tmp_path / "0", code=2)
    assert "IMG_0001.dng, taken at ISO 100, 4 s, and the plan asks for ISO 100, 1 s there" in output
    new = tmp_path / "new"
    shoot(new, whole_plan(first), day=7)
    output = nights.add(first, new, code=1)
    assert "7 are not\nand every shot of the plan is. Another night's scenes need other names" in output
    third = make_plan(replace(CAMERA, models=("Nocturne X",)), first.protocol, {"scene-5": Fraction(4)})
    shoot(tmp_path / "x", [replace(press, model="Nocturne X") for press in whole_plan(third)], day=8)
    output = nights.add(third, tmp_path / "x", code=2)
    assert "whose model in EXIF is Nocturne 1, and that of the plan's AcmeNocturne is Nocturne X" in output

    third = make_plan(CAMERA, first.protocol, {"scene-5": Fraction(4)})
    data, nights.data = nights.data, tmp_path / "elsewhere" / "mine"
    output = nights.add(third, new, code=2)
    assert "14 files of 14 are not in the one given, such as AcmeNocturne/scene-1/IMG_0001.dng" in output
    nights.data, card = data, nights.csv.with_suffix(".json")
    content = card.read_text()
    card.write_text(json.dumps(json.loads(content) | {"counts": {"noisy": 2, "reference": 4}}))
    output = nights.add(third, new, code=2)
    assert "its card expects {'noisy': 2, 'reference': 4} rows per role, and it has" in output
    card.write_text(content)
    assert nights.csv.read_bytes() == before
    assert not (nights.data / "AcmeNocturne" / "scene-5").exists()
    assert nights.problems() == []
