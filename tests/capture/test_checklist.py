"""The checklist as files: content, safety, determinism."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from capture.checklist import (
    calibration_parts,
    html_checklist,
    make_rows,
    markdown_checklist,
    plan_digest,
    read_items,
    text_checklist,
)
from tests.capture.simulated import hostile_plan, run_capture
from tests.reports.pages import assert_well_formed, checked
from tests.shared import there

PLAN = hostile_plan()
CALIBRATION = there(PLAN.calibration)


def every_item() -> list[Mapping[str, str]]:
    return [*read_items("preparation", PLAN), *(item for part in calibration_parts(PLAN) for item in part.items)]


@pytest.fixture(scope="module")
def page() -> str:
    return html_checklist(PLAN)


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


def test_page_shows_every_shot(page: str) -> None:
    elements = checked(page).elements
    keys = [attributes["data-row"] for _, attributes in elements if "data-row" in attributes]
    expected = [f"{scene.name}/{row.shot.number}" for scene in PLAN.scenes for row in make_rows(scene.shots)]
    expected += [f"calibration/{row.shot.number}" for row in make_rows(CALIBRATION.shots)]
    assert keys == expected
    assert sum(row.count for row in make_rows(CALIBRATION.shots)) == len(CALIBRATION.shots)
    items = [attributes["data-item"] for _, attributes in elements if "data-item" in attributes]
    assert items == [item["name"] for item in every_item()]


# --- text and Markdown ----------------------------------------------------------------------------------------------


def test_text_and_markdown_hold_what_the_page_holds() -> None:
    text, markdown = text_checklist(PLAN), markdown_checklist(PLAN)
    for item in every_item():
        assert f"- [ ] {item['text']}. {item['why']}" in text
        assert f"- [ ] {item['text']}. {item['why']}" in markdown
    planned = (*(scene.shots for scene in PLAN.scenes), CALIBRATION.shots)
    found = [row for shots in planned for row in make_rows(shots)]
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


# --- the command ----------------------------------------------------------------------------------------------------


def test_text_goes_to_the_terminal(tmp_path: Path) -> None:
    PLAN.save(tmp_path / "plan.json")
    command = ("checklist", tmp_path / "plan.json")
    assert run_capture(*command) == text_checklist(PLAN)
    assert run_capture(*command, "--format", "md", "--json", tmp_path / "it.json") == markdown_checklist(PLAN)
    content = json.loads((tmp_path / "it.json").read_text())
    assert content == {"file": None, "format": "md", "plan": plan_digest(PLAN), "frames": len(PLAN.shots)}
    page = tmp_path / "page.html"
    assert run_capture(*command, "-o", page) == f"{page}: 2 scenes, {len(PLAN.shots)} frames\n"
    assert page.read_text(encoding="utf-8") == html_checklist(PLAN)
