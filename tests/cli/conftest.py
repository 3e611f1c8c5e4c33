from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from eldata.cli.main import main
from tests.evaluation import conftest as evaluation
from tests.evaluation.helpers import Tree

GOLDEN = Path(__file__).parent / "golden"
tree = evaluation.tree
predictions = evaluation.predictions


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


class Cli:
    """Runs the command in this process, in an empty folder, and keeps what it printed."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object) -> Outcome:
        self._capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        captured = self._capsys.readouterr()
        return Outcome(code, captured.out, captured.err)


@pytest.fixture
def eldata(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Cli:
    (tmp_path / "cwd").mkdir()
    monkeypatch.chdir(tmp_path / "cwd")
    monkeypatch.delenv("ELDATA_ROOT", raising=False)
    return Cli(capsys)


@contextmanager
def room_for(most_bytes: int) -> Iterator[None]:
    """Have larger files meet a full disk when they are synced. RLIMIT_FSIZE would cut Python's own .pyc short, too."""

    def sync(descriptor: int) -> None:
        if os.fstat(descriptor).st_size > most_bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", sync)
        yield


@pytest.fixture
def own(tree: Tree, tmp_path: Path) -> Tree:
    """A copy of the tree to spoil."""
    return tree.copy(tmp_path / "tree")


def normalised(text: str, **paths: Path) -> str:
    """Replace paths by their names in braces."""
    for name, path in sorted(paths.items(), key=lambda item: -len(str(item[1]))):
        text = text.replace(str(path), "{" + name + "}")
    return re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE)


def assert_golden(name: str, text: str, folder: Path = GOLDEN) -> None:
    """Compare with a golden file; ELDATA_UPDATE_GOLDEN=1 rewrites it instead."""
    path = folder / f"{name}.txt"
    if os.environ.get("ELDATA_UPDATE_GOLDEN") == "1":
        path.write_text(text, encoding="utf-8")
    assert path.is_file(), f"{path} is missing: run the tests with ELDATA_UPDATE_GOLDEN=1 and look at what it holds"
    assert text == path.read_text(encoding="utf-8")
