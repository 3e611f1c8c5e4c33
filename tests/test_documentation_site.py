"""The site: it builds without a warning, has every public name and command, and what docstrings show is run."""

from __future__ import annotations

import doctest
import html
import importlib
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.shared import made_once
from tests.test_architecture import exports
from tests.test_public_names import PACKAGES
from tests.waiting import PATIENCE_S
from tests.without_posix import commands

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.capture.checklist_browser import Browser, Page

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted(path for path in (DOCS / "gallery").glob("*.md"))
PAGES = sorted(path.stem for path in (DOCS / "reference").glob("*.rst") if re.match(r"eldata|capture", path.stem))
_CELL = re.compile(r"^```\{code-cell\} ipython3\n(?::tags:[^\n]*\n\n)?(.*?)^```$", re.MULTILINE | re.DOTALL)
_KEPT = re.compile(r'^keep\("(.+)"\)$', re.MULTILINE)


# --- what is built ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The site, built with warnings as errors; notebooks are shown and not run."""

    def build(folder: Path) -> None:
        command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-D", "nb_execution_mode=off"]
        command += ["-d", str(folder.with_name("doctrees")), str(DOCS), str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
        assert (done.returncode, done.stderr) == (0, "")

    with made_once(tmp_path_factory, "site", build) as folder:
        yield folder


def examples() -> set[str]:
    """The pages that notebooks make, as the start page links them."""
    return {f"examples/{file}" for path in NOTEBOOKS for file in _KEPT.findall(path.read_text(encoding="utf-8"))}


@pytest.mark.study
def test_the_reference_has_every_public_name(site: Path) -> None:
    names = {f"{package}.{name}" for package in PACKAGES for name in exports(package)}
    for module in ("capture.check", "capture.checklist"):
        names |= {f"{module}.{name}" for name in vars(importlib.import_module(module))["__all__"]}
    assert len(names) > 180
    text = "".join(page.read_text(encoding="utf-8") for page in (site / "reference").glob("*.html"))
    assert {name for name in names if f'id="{name}"' not in text} == set()


@pytest.mark.study
def test_the_reference_has_every_command_and_option(site: Path) -> None:
    for program in ("eldata", "capture"):
        page = (site / "reference" / f"command-{program}.html").read_text(encoding="utf-8")
        shown = html.unescape(re.sub(r"<[^>]*>", "", page))
        parser = importlib.import_module(f"{program}.cli.main").parser()
        for _, command in commands(parser):
            assert f'id="{command.prog.replace(" ", "-")}"' in page, command.prog
            options = {name for action in command._actions for name in action.option_strings} - {"-h", "--help"}
            assert {name for name in options if name not in shown} == set(), command.prog


@pytest.mark.study
def test_links_between_pages_lead_somewhere(site: Path) -> None:
    """Sphinx has checked what it resolves; this is what the pages say in the end."""
    pages = {path: path.read_text(encoding="utf-8") for path in site.rglob("*.html")}
    ids = {path: set(re.findall(r'\bid="([^"]+)"', text)) for path, text in pages.items()}
    broken = []
    followed = 0
    for path, text in pages.items():
        for link in re.findall(r'<a\b[^>]*\bhref="([^"]*)"', text):
            if re.match(r"[a-z]+:", link):
                continue
            file, _, anchor = html.unescape(link).partition("#")
            if file in examples():
                continue  # notebooks make them, which do not run here
            target = (path.parent / file).resolve() if file else path
            followed += 1
            if not target.exists() or (anchor and target.suffix == ".html" and anchor not in ids[target]):
                broken.append(f"{path.relative_to(site)}: {link}")
    assert followed > 5000
    assert sorted(set(broken)) == []


# --- in a browser -----------------------------------------------------------------------------------------------------


@pytest.fixture
def page(browser: Browser, tmp_path: Path) -> Iterator[Page]:
    from tests.capture.checklist_browser import Page  # only POSIX systems have what it needs

    page = Page(browser, tmp_path, 390, 844)
    yield page
    page.close()


@pytest.mark.browser
@pytest.mark.study
def test_no_page_scrolls_sideways_on_a_phone(site: Path, page: Page) -> None:
    wide = {}
    paths = [path for path in site.rglob("*.html") if "_static" not in path.parts]
    for path in paths:
        page.open(path.as_uri())
        if page.run("document.scrollingElement.scrollWidth > innerWidth"):
            wide[path.name] = page.run("document.scrollingElement.scrollWidth")
    assert len(paths) > 60
    assert wide == {}


# --- what the pages' sources have to be -------------------------------------------------------------------------------


def test_every_guide_and_what_notebooks_make_is_on_the_site() -> None:
    start = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = start.split()
    assert [path.name for path in DOCS.glob("*.md") if path.stem not in {"index", *listed}] == []
    assert {f"gallery/{path.stem}" for path in NOTEBOOKS} <= set(listed)
    assert set(re.findall(r'href="(examples/[^"]+)"', start)) == examples()


SHORTER = {"train-and-score": ("steps=10 * len(loader)", "steps=len(loader)")}
"""A training of one epoch: whether it learns, tests of trainings ask."""


@pytest.mark.study
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(notebook: Path, tmp_path: Path) -> None:
    """Their cells as one script, without a kernel: `make docs` runs them as notebooks."""
    text = notebook.read_text(encoding="utf-8")
    whole, shorter = SHORTER.get(notebook.stem, ("", ""))
    assert whole in text
    cells = _CELL.findall(text.replace(whole, shorter))
    assert len(cells) > 3
    script = ["import matplotlib, subprocess, sys", "matplotlib.use('Agg')"]
    for cell in cells:
        magic, _, rest = cell.partition("\n")
        shell = f"subprocess.run(['bash', '-ec', {rest!r}], check=True)"
        script.append(shell if magic.startswith("%%bash") else cell)
    (tmp_path / "cells.py").write_text("\n".join(script), encoding="utf-8")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    modules = os.pathsep.join([str(DOCS / "site"), str(ROOT)])
    kept = tmp_path / "kept"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": modules, "ELDATA_EXAMPLES": str(kept)}
    command = [sys.executable, "cells.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S, env=environment)
    assert done.returncode == 0, done.stderr
    pages = [file for cell in cells for file in _KEPT.findall(cell)]
    assert [file for file in pages if "</html>" not in (kept / file).read_text(encoding="utf-8")] == []


# --- what docstrings show ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What docstrings read: `eldata demo --scenes 1`, its store, and a calibration of few and small frames."""
    from eldata.cli.main import main
    from eldata.demo.calibration_frames import make_calibration_frames
    from eldata.demo.tree import make_tree

    def make(folder: Path) -> None:
        tree = folder / "eldata-demo"
        make_tree(tree, scenes=1)
        packed = ["pack", "eld-demo", "--manifest", str(tree / "manifests" / "eld-demo.csv")]
        assert main([*packed, "--root", str(tree / "data"), "-o", str(folder / "demo.h5")]) == 0
        make_calibration_frames(folder / "eldata-calibration", bias_frames=6, size=(256, 384))

    with made_once(tmp_path_factory, "docstrings", make) as folder:
        yield folder


def examples_of_docstrings() -> dict[str, str]:
    """The docstrings that have examples, by public name."""
    texts = {}
    for page in PAGES:
        module = importlib.import_module(page)
        for name in getattr(module, "__all__", [name for name in vars(module) if not name.startswith("_")]):
            value = getattr(module, name)
            text = inspect.getdoc(value) or ""
            if (inspect.isclass(value) or inspect.isroutine(value)) and ">>>" in text:
                texts[f"{value.__module__}.{name}"] = text
    return texts


# A published set, or frames of one's own camera, which nobody has here: other examples are run.
SKIPPABLE = {"DRVDataset", "LRDDataset", "CRVDDataset", "LRIDDataset", "SIDDDataset", "SIDDataset", "DarkFrames"}


def test_docstrings_show_what_is_so(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("eldata-demo", "eldata-calibration", "demo.h5"):
        (tmp_path / name).symlink_to(demo / name)
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    said: list[str] = []
    run = set()
    for full, text in examples_of_docstrings().items():
        name = full.rpartition(".")[2]
        assert "doctest: +SKIP" not in text or name in {*SKIPPABLE, "dark_shading"}
        test = doctest.DocTestParser().get_doctest(text, {}, full, None, 0)
        if not all(doctest.SKIP in example.options for example in test.examples[1:]):
            run.add(name)
        runner.run(test, out=said.append)
    assert said == []
    assert len(run) > 35
