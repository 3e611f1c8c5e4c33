"""The checklist as files: content, safety, determinism, and the progress that comes back."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from capture.checklist import (
    ProgressError,
    html_checklist,
    load_progress,
    markdown_checklist,
    plan_digest,
    text_checklist,
)
from capture.checklist_content import every_item, rows
from capture.cli import main
from eldata.base.visible import visible
from tests.capture.checklist_plans import HOSTILE, small
from tests.cases import in_one_test
from tests.reports.pages import assert_well_formed, checked
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from capture.plan import Plan


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small()


@pytest.fixture(scope="module")
def page(plan: Plan) -> str:
    return html_checklist(plan)


# --- the page -----------------------------------------------------------------------------------------------------


def test_page_is_well_formed(page: str) -> None:
    assert_well_formed(page)
    checker = checked(page)
    identifiers = {attributes["id"] for _, attributes in checker.elements if "id" in attributes}
    for _, attributes in checker.elements:
        for name in ("aria-controls", "aria-describedby", "for"):
            assert set(attributes.get(name, "").split()) <= identifiers


def test_page_allows_its_own_script_and_style_alone(page: str) -> None:
    checker = checked(page)
    (policy,) = [item["content"] for item in checker.all("meta") if item.get("http-equiv") == "Content-Security-Policy"]
    for element in ("style", "script"):
        (text,) = re.findall(rf"<{element}>(.*?)</{element}>", page, flags=re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{element}-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe" not in policy
    assert checker.all("link", "img", "iframe", "object", "embed", "base", "form") == []
    for tag, attributes in checker.elements:
        for name, value in attributes.items():
            assert not name.startswith("on"), f"{tag} has {name}"
            assert name != "style"
            assert name not in ("src", "srcset", "action")
            assert name != "href" or value.startswith("#")
    for word in ("http://", "https://", "url(", "@import", "eval(", "innerHTML", "fetch("):
        assert word not in page.replace("https://evil.example", "")


def test_hostile_notes_stay_text(page: str) -> None:
    assert visible(HOSTILE) in checked(page).text
    assert page.count("<script") == 2
    assert "<img" not in page


def test_page_shows_every_shot(page: str, plan: Plan) -> None:
    elements = checked(page).elements
    keys = [attributes["data-row"] for _, attributes in elements if "data-row" in attributes]
    expected = [f"{scene.name}/{row.number}" for scene in plan.scenes for row in rows(scene.shots)]
    assert plan.calibration is not None
    expected += [f"calibration/{row.number}" for row in rows(plan.calibration.shots)]
    assert keys == expected
    assert sum(row.count for row in rows(plan.calibration.shots)) == len(plan.calibration.shots)
    items = [attributes["data-item"] for _, attributes in elements if "data-item" in attributes]
    assert items == [item.name for item in every_item(plan)]


def test_plan_without_scenes(plan: Plan) -> None:
    for text in (html_checklist(replace(plan, scenes=())), text_checklist(replace(plan, scenes=()))):
        assert "At each scene" not in text
        assert "Flat-field frames" in text


def test_same_plan_gives_same_files_in_another_process_which_loads_nothing_heavy(plan: Plan, tmp_path: Path) -> None:
    plan.save(tmp_path / "plan.json")
    code = (
        "import sys; from capture.cli import main\n"
        "for form in ('html', 'md', 'txt'): assert main(['checklist', 'plan.json', '-o', f'two.{form}']) == 0\n"
        "assert not {'torch', 'rawpy', 'numpy'} & set(sys.modules)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    subprocess.run(
        [sys.executable, "-c", code], check=True, timeout=PATIENCE_S, stdout=subprocess.DEVNULL, cwd=tmp_path,
        env=environment,
    )  # fmt: skip
    for form in ("html", "md", "txt"):
        assert main(["checklist", str(tmp_path / "plan.json"), "-o", str(tmp_path / f"one.{form}")]) == 0
        assert (tmp_path / f"one.{form}").read_bytes() == (tmp_path / f"two.{form}").read_bytes()


def test_digest_is_of_decisions(plan: Plan) -> None:
    assert plan_digest(plan.add_note("scene-2", "another")) == plan_digest(plan)
    assert plan_digest(plan.remeter("scene-2", Fraction(2))) != plan_digest(plan)
    assert plan_digest(replace(plan, calibration=None)) != plan_digest(plan)


# --- text and Markdown ----------------------------------------------------------------------------------------------


def test_text_and_markdown_hold_what_the_page_holds(plan: Plan) -> None:
    text, markdown = text_checklist(plan), markdown_checklist(plan)
    for item in every_item(plan):
        assert f"- [ ] {item.text}. {item.why}" in text
        assert f"- [ ] {item.text}. {item.why}" in markdown
    assert plan.calibration is not None
    found = [row for shots in (*(scene.shots for scene in plan.scenes), plan.calibration.shots) for row in rows(shots)]
    lines = [line.split() for line in text.splitlines() if line.startswith("[ ]")]
    assert len(lines) == len(found)
    for line, row in zip(lines, found, strict=True):
        assert line[2] == row.numbers
        assert f"{row.shot.iso} {row.dial} s" in " ".join(line)
    cells = [[cell.strip() for cell in line.split("|")] for line in markdown.splitlines() if line.startswith("| [ ]")]
    assert [(line[2], line[4], line[5]) for line in cells] == [
        (row.numbers, str(row.shot.iso), f"{row.dial} s") for row in found
    ]
    for table in re.findall(r"(?:^\|.*\n)+", markdown, flags=re.MULTILINE):
        assert len({len(line) for line in table.splitlines()}) == 1


def test_hostile_notes_steer_neither_terminal_nor_markdown(plan: Plan) -> None:
    for text in (text_checklist(plan), markdown_checklist(plan)):
        assert "\x1b" not in text
        assert "\u202e" not in text
    (line,) = [line for line in markdown_checklist(plan).splitlines() if "evil" in line]
    assert re.search(r"(?<!\\)[<>|*_`\[]", line.removeprefix("- ")) is None


# --- the command ----------------------------------------------------------------------------------------------------


def test_text_goes_to_the_terminal(plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan.save(tmp_path / "plan.json")
    assert main(["checklist", str(tmp_path / "plan.json")]) == 0
    assert capsys.readouterr().out == text_checklist(plan)
    assert main(["checklist", str(tmp_path / "plan.json"), "--format", "md", "--json", str(tmp_path / "it.json")]) == 0
    assert capsys.readouterr().out == markdown_checklist(plan)
    content = json.loads((tmp_path / "it.json").read_text())
    assert content == {"file": None, "format": "md", "plan": plan_digest(plan), "frames": len(plan.shots)}


def test_wrong_usage(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    plan.save("plan.json")
    for options, words in (
        ("--format html", "a page needs a file"),
        ("-o list.pdf", "expected a name that ends in .html, .md or .txt"),
        ("-o plan.json --format txt", "-o plan.json: is what PLAN names, and this command reads it"),
    ):
        assert main(["checklist", "plan.json", *options.split()]) == 2
        assert words in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]


# --- the progress that comes back -----------------------------------------------------------------------------------


def exported(plan: Plan) -> dict[str, Any]:
    """What the page exports before anything is ticked; the browser tests hold the page against it."""

    def shots(found: Any) -> list[dict[str, Any]]:
        return [row.as_dict() | {"taken_at": None, "repeats": 0, "file": "", "remark": ""} for row in rows(found)]

    return {
        "kind": "capture-progress",
        "schema": 1,
        "plan": plan_digest(plan),
        "camera": plan.camera.name,
        "preparation": [],
        "scenes": [
            {"name": scene.name, "metered_s": str(scene.metered_s), "shots": shots(scene.shots)}
            for scene in plan.scenes
        ],
        "calibration": [] if plan.calibration is None else shots(plan.calibration.shots),
    }


def written(content: object, folder: Path) -> Path:
    path = folder / "progress.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_progress_is_read(plan: Plan, tmp_path: Path) -> None:
    content = exported(plan)
    content["preparation"] = ["tripod", "bias-cap"]
    content["scenes"][0]["shots"][0] |= {"taken_at": "2", "file": " DSC01234 ", "remark": "ök", "repeats": 2}
    content["scenes"][0]["shots"][1] |= {"taken_at": "1/5"}
    content["calibration"][0] |= {"taken_at": "1/8000"}
    found = load_progress(written(content, tmp_path), plan)
    assert found.preparation == ("tripod", "bias-cap")
    assert found.plan_digest == plan_digest(plan)
    first, second = found.scenes[0].shots[:2]
    assert (first.file, first.remark, first.repeats, first.done) == ("DSC01234", "ök", 2, True)
    assert (second.dial, second.taken_at, second.done) == ("1/4", "1/5", False)
    assert not found.scenes[0].done
    assert (found.calibration[0].count, found.calibration[0].done) == (4, True)
    assert found.as_metered(plan) == plan


def test_metered_times_come_back_into_the_plan(plan: Plan, tmp_path: Path) -> None:
    other = plan.remeter("scene-2", Fraction(1))
    found = load_progress(written(exported(other), tmp_path), plan)
    assert found.as_metered(plan) == other


def test_file_of_fewer_scenes_fits_a_plan_that_has_grown(plan: Plan, tmp_path: Path) -> None:
    grown = plan.add_scene("scene-3", Fraction(2))
    assert len(load_progress(written(exported(plan), tmp_path), grown).scenes) == 2


@in_one_test(
    "place, value, words",
    [
        (("kind",), "other", 'field kind: expected "capture-progress"'),
        (("schema",), 2, "field schema: expected 1"),
        (("camera",), "NikonD850", "field camera: expected 'SonyA7S2', the plan's, found 'NikonD850'"),
        (("extra",), 1, "field extra: is unknown; known are kind"),
        (("scenes", 1, "name"), "scene-1", "field scenes[1].name: expected one of the plan's scenes, each once"),
        (("scenes", 0, "metered_s"), "0", "field scenes[0].metered_s: expected seconds above 0"),
        (("scenes", 0, "metered_s"), "1/4000", "Let 11 2/3 stops less light in"),
        (("scenes", 0, "shots"), [], "field scenes[0].shots: expected the plan's 16 rows, found 0 rows"),
        (("scenes", 0, "shots", 3, "iso"), 1600, "field scenes[0].shots[3].iso: expected 800, as in the plan"),
        (("scenes", 0, "shots", 3, "taken_at"), 1, "shots[3].taken_at: expected a text"),
        (("scenes", 0, "shots", 3, "repeats"), -1, "shots[3].repeats: expected a whole number from 0 to 99"),
        (("scenes", 0, "shots", 3, "file"), "a\nb", "shots[3].file: expected a text without control characters"),
        (("scenes", 0, "shots", 3, "remark"), "x" * 501, "shots[3].remark: expected a text of at most 500 characters"),
        (("calibration", 0, "count"), 5, "field calibration[0].count: expected 4, as in the plan"),
    ],
)
def test_wrong_progress_is_refused(
    place: tuple[Any, ...], value: object, words: str, plan: Plan, tmp_path: Path
) -> None:
    content: Any = exported(plan)
    inside = content
    for step in place[:-1]:
        inside = inside[step]
    inside[place[-1]] = value
    path = written(content, tmp_path)
    with pytest.raises(ProgressError, match=re.escape(words)) as caught:
        load_progress(path, plan)
    assert str(caught.value).startswith(str(path))
