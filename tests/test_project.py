"""What strangers who join meet: forms, workflows, policies. All parse, agree with each other and lead somewhere."""

from __future__ import annotations

import importlib.util
import re
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

import eldata
from eldata.manifest import shipped_manifest
from tests.cases import in_one_test
from tests.shared import there

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted(path for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml")
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def parsed(path: Path) -> Any:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def script(name: str) -> ModuleType:
    """A module of the folder .ci, which is not a package."""
    spec = there(importlib.util.spec_from_file_location(name, ROOT / ".ci" / f"{name}.py"))
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# --- citation -----------------------------------------------------------------------------------------------------


def test_the_citation_is_whole() -> None:
    """By the rules of the Citation File Format 1.2.0: what it requires of the file and of each reference."""
    citation = parsed(ROOT / "CITATION.cff")
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == eldata.__version__
    assert citation["license"] == PROJECT["project"]["license"]
    assert citation["authors"] == PROJECT["project"]["authors"]
    assert all(isinstance(citation[name], str) for name in ("message", "title", "abstract"))
    (paper,) = citation["references"]
    names = [f"{author['given-names'][0]}. {author['family-names']}" for author in paper["authors"]]
    authors = " and ".join([", ".join(names[:-1]), names[-1]])
    cited = f"{authors}, {paper['title']}, {paper['journal']}, {paper['year']}"
    assert (paper["type"], shipped_manifest("eld").card.citation) == ("article", cited)


# --- forms --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_a_form_is_well_formed(path: Path) -> None:
    """By the rules for issue forms: a form that breaks one is not offered, without a word to anyone."""
    form = parsed(path)
    assert {"name", "description", "body"} <= set(form) <= {"name", "description", "body", "title", "labels"}
    ids = [field["id"] for field in form["body"] if field["type"] != "markdown"]
    assert len(ids) == len(set(ids))
    for field in form["body"]:
        assert field["type"] in ("input", "textarea", "checkboxes", "markdown")
        texts = [field["attributes"], *field["attributes"].get("options", ())]
        assert all(isinstance(text.get("label", text.get("value")), str) for text in texts)


# --- workflows and hooks ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_is_well_formed(path: Path) -> None:
    workflow = parsed(path)
    assert workflow[True], "'on', which YAML 1.1 reads as true"
    assert workflow["permissions"] == {"contents": "read"}, "what a job needs beyond reading, it asks for itself"
    for job in workflow["jobs"].values():
        assert job["runs-on"]
        assert set(job.get("needs", "").split()) <= set(workflow["jobs"])
    for step in (step for job in workflow["jobs"].values() for step in job["steps"]):
        assert ("run" in step) != ("uses" in step), step
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", step.get("uses", "a/b@" + "0" * 40))
        assert "checkout" not in step.get("uses", "") or step["with"] == {"persist-credentials": False}
        # What others write (a title, a branch's name) would be run: it has to come through the environment.
        assert "${{" not in step.get("run", "")
        files = [word for word in step.get("run", "").split() if re.match(r"(tests|\.ci|manifests|docs)/", word)]
        assert [name for name in files if not (ROOT / name).exists()] == []


def test_the_image_is_built_from_what_is_let_in_and_runs_as_a_user() -> None:
    steps = [line.split() for line in (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()]
    assert len(steps) <= 20
    assert [step[1] for step in steps if step[0] == "USER"] == ["eldata"]
    let_in = re.findall(r"^!(.*)$", (ROOT / ".dockerignore").read_text(encoding="utf-8"), re.MULTILINE)
    assert "pyproject.toml" in let_in
    assert all((ROOT / name).exists() for name in let_in)


def test_each_python_of_the_classifiers_is_tested() -> None:
    jobs = parsed(ROOT / ".github" / "workflows" / "tests.yml")["jobs"]
    words = "Programming Language :: Python :: 3."
    stated = [line.removeprefix(words) for line in PROJECT["project"]["classifiers"] if line.startswith(words)]
    assert jobs["linux"]["strategy"]["matrix"]["python"] == [f"3.{minor}" for minor in stated]
    assert PROJECT["project"]["requires-python"] == f">=3.{stated[0]}"
    assert jobs["lowest"]["steps"][1]["with"]["python-version"] == f"3.{stated[0]}"
    assert jobs["newest"]["steps"][1]["with"]["python-version"] == f"3.{stated[-1]}"


# --- versions -----------------------------------------------------------------------------------------------------


def test_the_changelog_begins_with_this_version() -> None:
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert re.fullmatch(rf"{re.escape(eldata.__version__)} \((unreleased|\d{{4}}-\d\d-\d\d)\)", headings[0])
    assert len(headings) == 1  # nothing was released before


RELEASED = """# Changelog
## 0.2.0 (2026-12-01)

- New.

## 0.1.0
- Old.
"""
CITED = "title: eldata\nversion: 0.2.0\nlicense: MIT\n"


@pytest.mark.parametrize(
    ("tag", "changelog", "citation", "words"),
    [
        ("v0.2.1", RELEASED, CITED, r"the tag is v0\.2\.1, .* expected the tag v0\.2\.0"),
        ("0.2.0", RELEASED, CITED, r"expected the tag v0\.2\.0"),
        ("v0.2.0", RELEASED.replace("2026-12-01", "unreleased"), CITED, r"CHANGELOG\.md: expected the heading"),
        ("v0.2.0", RELEASED, CITED.replace("0.2.0", "0.1.0"), r"CITATION\.cff: expected .* 0\.2\.0"),
    ],
)
def test_a_release_needs_what_it_says_to_agree(tag: str, changelog: str, citation: str, words: str) -> None:
    assert script("release").notes("v0.2.0", "0.2.0", RELEASED, CITED) == "- New.\n"
    with pytest.raises(ValueError, match=words):
        script("release").notes(tag, "0.2.0", changelog, citation)


# --- floors -------------------------------------------------------------------------------------------------------


def test_floors_are_those_of_what_eldata_runs_with() -> None:
    floors = script("lowest").floors((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert {"numpy", "torch", "rawpy", "dask", "py7zr"} <= set(floors)
    assert not floors.keys() & {"pytest", "mypy", "ruff"}, "tools of the extra dev"
    assert {f"{name}>={floor}" for name, floor in floors.items()} >= set(PROJECT["project"]["dependencies"])


# --- documents and the source archive -----------------------------------------------------------------------------


def anchors(path: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@in_one_test("page", PAGES)
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if link.startswith("https://"):
            continue
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        assert not anchor or target.suffix != ".md" or anchor in anchors(target), link


def test_every_test_that_a_page_names_is_there() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = re.findall(r"`(tests/\S+\.py)::(test_\w+)`", text)
    assert len(named) == text.count("::test_") > 100
    for file, test in sorted(set(named)):
        assert f"\ndef {test}(" in (ROOT / file).read_text(encoding="utf-8"), f"{file}::{test}"


def test_every_file_that_the_architecture_names_is_there() -> None:
    files = [path.as_posix() for room in ("eldata", "capture", "tests", "docs") for path in (ROOT / room).rglob("*.*")]
    names = re.findall(r"`([\w/]+\.(?:py|toml))`", (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8"))
    assert [name for name in names if not any(file.endswith(f"/{name}") for file in files)] == []
