"""From the card to the dataset, with real files: matched, placed, listed, verified and read."""

from __future__ import annotations

import json
import os
import resource
import shutil
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from capture.capture_errors import CaptureError
from capture.cli import main
from capture.manifest import Placement, place_files
from capture.plan import Plan, make_plan
from eldata.base.files import sha256_of
from eldata.errors import EldataError
from eldata.manifest import load_manifest, verify
from eldata.records import FrameRecord
from tests.capture.simulated import CAMERA, Nights, Taken, plan_of, run_capture, shoot, whole_plan
from tests.cases import in_one_test
from tests.trees import interrupt_manifest


class Field(Nights):
    """A folder with a plan, a memory card and a place for the dataset."""

    def __init__(self, folder: Path, plan: Plan, taken: list[Taken] | None = None, **how: Any) -> None:
        super().__init__(folder)
        self.plan, self.card = plan, folder / "card"
        self.mapping = folder / "manifests" / "mine.mapping.json"
        self.files = shoot(self.card, whole_plan(plan) if taken is None else taken, **how)
        plan.save(folder / "plan.json")

    @property
    def command(self) -> list[str]:
        return ["manifest", str(self.folder / "plan.json"), str(self.card), "-o", str(self.csv), "--jobs", "1"]

    def copy(self, *options: str, code: int = 0) -> str:
        return run_capture(*self.command, "--copy-to", self.data, *options, code=code)


@pytest.fixture
def small(tmp_path: Path) -> Field:
    return Field(tmp_path, plan_of("4", "1", factors=(100,)))


def test_scenes_from_card_to_dataset(tmp_path: Path) -> None:
    field = Field(tmp_path, plan_of("4", "1", "2", "1"), shuffle=3)
    before = {path: (path.stat().st_mtime_ns, sha256_of(path)) for path in field.files}
    output = field.copy()
    assert "scene-4  16 of 16" in output
    assert "64 of 64 shots have a file; 64 files were given" in output
    assert ":\n" not in output.partition("manifest:")[0]  # no kind of remark
    manifest = load_manifest(field.csv)
    assert manifest.card.counts == {"noisy": 48, "reference": 16}
    assert field.problems() == []
    assert {path: (path.stat().st_mtime_ns, sha256_of(path)) for path in field.files} == before
    # Each file under the number of its place in the order of time.
    for index, (scene, shot) in enumerate(field.plan.shots):
        placed = field.data / CAMERA.name / scene / f"IMG_{shot.number:04d}.dng"
        assert sha256_of(placed) == before[field.files[index]][1]
    record = next(record for record in manifest.records if record.path == "AcmeNocturne/scene-3/IMG_0005.dng")
    expected = ("noisy", Fraction(800), Fraction(1, 800), Fraction(200))
    assert (record.role, record.iso, record.exposure_s, record.ratio) == expected
    assert record.reference == "AcmeNocturne/scene-3/IMG_0006.dng"
    field.copy("--replace")  # again: nothing to do, nothing in the way
    assert field.problems() == []


@pytest.mark.parametrize("how", ["new", "--replace", "--append"])
def test_the_files_of_a_set_are_right_after_an_interruption(how: str, tmp_path: Path) -> None:
    """Before each of card and table: the same command again ends with those that it writes."""
    for suffix in (".json", ".csv"):
        field = Field(tmp_path / suffix[1:], plan_of("4", "1", factors=(1,)))
        options = [] if how == "new" else [how]
        if how != "new":
            field.copy("--only", "scene-1", "--yes")
        with pytest.MonkeyPatch.context() as patch:
            interrupt_manifest(patch, suffix)
            field.copy(*options, code=130)
        field.copy(*options)
        manifest = load_manifest(field.csv)
        assert len(manifest.records) == len(field.plan.shots)
        assert sorted(path.name for path in field.csv.parent.iterdir()) == ["mine.csv", "mine.json"]


def test_files_may_stay_where_they_are(small: Field) -> None:
    run_capture(*small.command)
    manifest = load_manifest(small.csv)
    assert manifest.card.folder == small.folder.name
    assert manifest.records[0].path == "card/DSC0001.dng"  # the counter turned over
    assert verify(small.csv, small.folder.parent, level="full").ok


def test_names_order_where_there_are_no_times(tmp_path: Path) -> None:
    field = Field(tmp_path, plan_of("4", "1"), times=False)  # DSC1 ... DSC32, which sort as text the wrong way
    assert "not every file says when it was taken" in field.copy()
    assert sha256_of(field.data / "AcmeNocturne/scene-1/IMG_0010.dng") == sha256_of(field.card / "DSC10.dng")


def test_everything_that_goes_wrong(tmp_path: Path) -> None:
    """Skipped, repeated, swapped, a test shot, another camera's file, a damaged one: each is named, none shifts."""
    plan = plan_of("4", "1", "2")
    taken = whole_plan(plan)
    taken[32], taken[33] = taken[33], taken[32]
    taken[21:22] = [taken[21]] * 2
    taken[16:16] = [Taken(200, Fraction(1, 30))]
    del taken[3]
    field = Field(tmp_path, plan, taken)
    (field.card / "broken.dng").write_bytes(field.files[0].read_bytes()[:500])
    shoot(field.card / "other", [Taken(100, Fraction(4), model="Toy")])
    (field.card / "DSC0001.JPG").write_bytes(b"jpeg")
    output = field.copy(code=1)
    for words in (
        "scene-1 frame 4 (noisy, ISO 800, 1/200 s): no file",
        "scene-2 frame 6 was taken more than once; the last one is used",
        "scene-3 frame 2, taken out of order (before all others)",
        "ISO 200, 1/30 s: not a shot of the plan; not used",
        "was taken by Toy; the plan's is Nocturne 1",
        "broken.dng: truncated",
        "47 of 48 shots have a file; 51 files were given",
        "1 of 48 shots have no file. Take them again, or accept the gaps",
    ):
        assert words in output
    assert not field.csv.exists()
    assert not field.data.exists()

    plan_of("15", factors=(200,)).save(field.folder / "plan.json")
    assert "no file is a shot of this plan; nothing was written. Is it the right plan" in field.copy(code=1)
    plan.save(field.folder / "plan.json")
    assert "accept it as it is with --allow-gaps\n" in field.copy("--yes", code=1)  # which has been said
    field.mapping.unlink()
    field.copy("--allow-gaps", code=1)  # still to be confirmed
    assert field.mapping.exists()
    field.copy("--allow-gaps", "--yes")
    assert field.problems() == []
    assert len(load_manifest(field.csv).records) == 47


def test_an_edited_mapping(tmp_path: Path) -> None:
    plan = plan_of("4", factors=(100,))
    taken = whole_plan(plan)
    taken[2:3] = [taken[2]] * 2  # frame 3 twice, the first one is the better one
    field = Field(tmp_path, plan, taken)
    assert f"--mapping {field.mapping}" in field.copy(code=1)
    content = json.loads(field.mapping.read_text())
    assert content["shots"][2]["file"] == str(field.files[3])
    assert content["unused"] == [{"file": str(field.files[2]), "settings": "ISO 100, 4 s"}]
    content["shots"][2]["file"] = str(field.files[2])
    field.mapping.write_text(json.dumps(content))
    assert "is there already, perhaps edited, and was left as it is" in field.copy(code=1)
    assert json.loads(field.mapping.read_text()) == content
    field.copy("--mapping", str(field.mapping))
    assert sha256_of(field.data / "AcmeNocturne/scene-1/IMG_0003.dng") == sha256_of(field.files[2])
    assert field.problems() == []


@in_one_test(
    "change, words",
    [
        ({"number": 99}, "shots[1].number: expected a shot of the plan's scene-1, each once, found 99"),
        ({"number": 1}, "expected a shot of the plan's scene-1, each once, found 1"),
        ({"file": 1}, "shots[1].file: expected a text, found 1"),
        ({"file": "nowhere.dng"}, "expected one of the files given"),
        ({"note": "x"}, "field shots[1].note: is unknown; known are scene, number, shot, file"),
        ({"file": "FIRST"}, "expected one of the files given, each once, with"),
        ({"file": "LAST"}, "asks for ISO 800, 1/200 s, and "),
    ],
)
def test_wrong_mappings(small: Field, change: dict[str, object], words: str) -> None:
    small.files[-1].unlink(missing_ok=True)
    small.mapping.unlink(missing_ok=True)
    small.copy(code=1)
    content = json.loads(small.mapping.read_text())
    place = {"FIRST": str(small.files[0]), "LAST": str(small.files[6])}
    if change.get("file") == "LAST":
        content["shots"][6]["file"] = None
    content["shots"][1] |= {key: place.get(str(value), value) for key, value in change.items()}
    small.mapping.write_text(json.dumps(content))
    assert words in small.copy("--mapping", str(small.mapping), "--allow-gaps", code=2)
    assert not small.data.exists()


def test_what_is_there_stays(small: Field) -> None:
    """A card alone is what a killed run left; one that was filled in is not touched."""
    small.copy()
    small.copy()  # the same command again has the same result
    card, rows = small.csv.with_suffix(".json"), small.csv.read_bytes()
    small.csv.unlink()
    small.copy()
    assert small.csv.read_bytes() == rows
    card.write_text(card.read_text().replace('"licence": "not stated"', '"licence": "CC0"'))
    small.csv.unlink()
    assert f"{card} is there already, with other content: give another name, or --rep" in small.copy(code=2)
    assert '"licence": "CC0"' in card.read_text()


@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("", 1)])
def test_asked_on_a_terminal(tmp_path: Path, answer: str, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a part of the plan, by hard links."""
    plan = plan_of("4", "1", factors=(100,))
    taken = whole_plan(plan.only(["scene-1"]))
    field = Field(tmp_path, plan, [*taken, taken[-1]])
    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: answer)
    assert main([*field.command, "--only", "scene-1", "--link-to", str(field.data)]) == code
    assert field.csv.exists() == (code == 0)
    assert field.mapping.exists() == (code == 1)
    if not code:
        assert (field.data / "AcmeNocturne/scene-1/IMG_0001.dng").samefile(field.files[0])
        assert field.problems() == []


# --- several cards, nights and plans in one set -----------------------------------------------------------------------


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
    for words in ("has 26 of the plan's 48 shots", "22 of 22 shots have a file", "48 files below", "22 of them new"):
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


# --- files into their places ----------------------------------------------------------------------------------------


@pytest.fixture
def placement(tmp_path: Path) -> Placement:
    source = tmp_path / "card" / "DSC1.ARW"
    source.parent.mkdir()
    source.write_bytes(os.urandom(100_000))
    os.utime(source, (1_700_000_000, 1_700_000_000))
    record = FrameRecord("scene-1/IMG_0001.ARW", "reference", "Acme", sha256=sha256_of(source))
    return Placement(source, tmp_path / "data" / record.path, record)


@pytest.mark.parametrize("content", [5, 100_000, None])  # the second is that of what would be placed, the last a link
def test_what_is_there_is_never_replaced(placement: Placement, content: int | None) -> None:
    """Before anything is written: the file before it stays away too."""
    placement.target.parent.mkdir(parents=True)
    if content is None:
        placement.target.symlink_to(placement.target.parent / "elsewhere")
    else:
        placement.target.write_bytes(bytes(content))
    free = replace(placement, target=placement.target.with_name("IMG_0000.ARW"))
    with pytest.raises(CaptureError, match="is there already with another content"):
        place_files([free, placement], "copy")
    assert [path.name for path in placement.target.parent.iterdir()] == ["IMG_0001.ARW"]
    assert placement.target.is_symlink() or placement.target.read_bytes() == bytes(content or 0)


def test_a_copy_that_fails_leaves_nothing(placement: Placement) -> None:
    """A source that the system does not let be read, or that has changed; a target for which it has no room."""
    with pytest.raises(OSError, match="Input/output error: '/proc/self/mem'"):
        place_files([replace(placement, path=Path("/proc/self/mem"))], "copy")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        with pytest.raises(EldataError, match=r"cannot write \S*IMG_0001.ARW: File too large"):
            place_files([placement], "copy")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    placement.path.write_bytes(b"another")
    with pytest.raises(CaptureError, match="changed while it was being copied"):
        place_files([placement], "copy")
    assert list(placement.target.parent.iterdir()) == []
