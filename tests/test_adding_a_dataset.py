"""docs/adding-a-dataset.md, executed: its blocks are written to the files that they name, and its commands run."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from eldata.raw import write_dng
from eldata.records import Exposure, Sensor
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs" / "adding-a-dataset.md"
_FENCE = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """A fenced block: ``kind`` is ``diff``, ``sh`` or the language of a whole file, ``path`` where it belongs."""

    kind: str
    path: str
    text: str


def blocks(section: str) -> list[Block]:
    """The blocks below a heading of the second level."""
    sections = dict(part.split("\n", 1) for part in DOCUMENT.read_text(encoding="utf-8").split("\n## ")[1:])
    return [Block(*match) for match in _FENCE.findall(sections[section])]


def apply_change(text: str, change: str) -> str:
    """Change a file's text as a diff without line numbers says; each hunk fits in one place, or the page is old."""
    for hunk in change.split("@@\n"):
        lines = hunk.splitlines(keepends=True)
        before = "".join(line[1:] for line in lines if line[0] != "+")
        assert text.count(before) == 1, f"{text.count(before)} places fit:\n{before}"
        text = text.replace(before, "".join(line[1:] for line in lines if line[0] != "-"))
    return text


def run(folder: Path, commands: str, source: Path) -> str:
    """Run shell commands in a folder, with what lies in ``source`` imported first; return what they print."""
    environment = {name: value for name, value in os.environ.items() if name != "ELDATA_ROOT"}
    environment |= {"PYTHONPATH": str(source), "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    command = ["/bin/bash", "-euc", f"exec 2>&1\n{commands}"]
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stdout
    return done.stdout


def execute(folder: Path, blocks: list[Block], source: Path) -> str:
    """Take blocks in their order; return what the commands print."""
    printed = ""
    for block in blocks:
        path = folder / block.path
        if block.kind == "sh":
            printed += run(folder, block.text, source)
        elif block.kind == "diff":
            path.write_text(apply_change(path.read_text(encoding="utf-8"), block.text), encoding="utf-8")
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
    return printed


def test_the_page_is_short() -> None:
    """Five hundred words beside the blocks: what takes longer to say is too much work for who brings a set."""
    assert len(_FENCE.sub("", DOCUMENT.read_text(encoding="utf-8")).split()) <= 500


# --- a set of one's own -----------------------------------------------------------------------------------------------


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A folder with two scenes in data/MINE."""
    generator = np.random.default_rng(3)
    sensor = Sensor("MAKER", "MODEL 3", ((0, 1), (3, 2)), (512.0,) * 4, 16300.0, 32, 48)
    for scene in ("hall", "stairs"):
        folder = tmp_path / "data" / "MINE" / scene
        folder.mkdir(parents=True)
        light = generator.uniform(0, 15000, (32, 48))
        for name, factor in (("clean", 1), ("dark_100", 100), ("dark_200", 200)):
            mosaic = np.rint(light / factor + 512 + generator.normal(0, 3, light.shape)).clip(0).astype(np.uint16)
            iso, seconds = (Fraction(100), Fraction(4)) if factor == 1 else (Fraction(1600), Fraction(1, 4 * factor))
            write_dng(folder / f"{name}.dng", mosaic, sensor, Exposure(iso, seconds))
    return tmp_path


def test_your_own_files_and_a_package_of_yours(mine: Path) -> None:
    printed = execute(mine, blocks("Your own files"), ROOT)
    assert "mine: 6 of 6 files checked (metadata) in data/MINE: all well" in printed
    assert "PairDataset(place: data/MINE; pairs: 4 of 2 scenes; cameras: MODEL3" in printed
    assert "4 of 4 pairs" in printed
    assert "sha256:" in (mine / "mine.csv").read_text()

    *files, commands = blocks("From your own package")
    execute(mine, files, ROOT)
    for name in ("mine.csv", "mine.json"):
        shutil.copy(mine / name, mine / "hallway" / name)
    # What pip leaves of the project file, so that no package index is needed.
    project = tomllib.loads((mine / "pyproject.toml").read_text())["project"]
    ((name, place),) = project["entry-points"]["eldata.datasets"].items()
    info = mine / "hallway-1.0.dist-info"
    info.mkdir()
    info.joinpath("METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 1.0\n")
    info.joinpath("entry_points.txt").write_text(f"[eldata.datasets]\n{name} = {place}\n")
    printed = run(mine, f'export PYTHONPATH="$PWD:$PYTHONPATH"\n{commands.text}', ROOT)  # as if it were installed
    assert printed.startswith("HallwayDataset(place: data/MINE; pairs: 4 of 2 scenes")
    assert "\nmine: 2 scenes taken with MODEL3 (manifest version 1.0)" in printed
    assert "mine: 6 of 6 files checked (quick) in data/MINE: all well" in printed
    assert "mine, protocol raw: 4 of 4 pairs" in printed


# --- a set in eldata --------------------------------------------------------------------------------------------------


def test_a_published_set_in_eldata(tmp_path: Path) -> None:
    """In a copy of the sources, with what is compiled of them already, but not by pytest, nor half written."""
    for name in ("eldata", "tests", "manifests"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("*-pytest-*.pyc", "*.pyc.*"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    changes = blocks("In eldata")
    printed = execute(tmp_path, changes, tmp_path)
    assert "night: Two cameras at night (NIGHT) (manifest version 1.0)" in printed
    assert "night: 16 of 16 files checked (full) in data/NIGHT: all well" in printed
    assert re.search(r"^[0-9]+ passed, [0-9]+ deselected", printed, re.MULTILINE)
    assert "night, protocol night: 8 of 8 pairs" in printed
    sources = " ".join(block.path for block in changes if block.path.endswith(".py"))
    run(tmp_path, f"ruff check --no-cache {sources}\nruff format --no-cache --check {sources}", tmp_path)
