"""A decoder that crashes or hangs costs one line: through the commands, in one process, in several, and in threads.

No file is known that crashes the LibRaw of today. So its place is taken, in processes that start from here, by one that
is brought down by files whose white balance asks for it; the commands themselves run in the test's own process, which
would go down with it.
"""

from __future__ import annotations

import json
import os
import shutil
from typing import TYPE_CHECKING

import pytest

from eldata.base.isolation import VARIABLE, Limits, guarded_file
from tests.trees import frame

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.conftest import Cli
    from tests.evaluation.helpers import Tree

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="isolation needs a POSIX system")

# Python imports a module of this name when it starts.
SITE = """
import ctypes, os, time
import rawpy

class Fragile(rawpy.RawPy):
    def unpack(self):
        for mark, fate in (("CRASH", lambda: ctypes.string_at(8)), ("HANG", lambda: time.sleep(1e6))):
            if os.path.exists(f"{self.path}.{mark}"):
                fate()
        super().unpack()

    def open_file(self, path):
        self.path = path
        super().open_file(path)

rawpy.RawPy = Fragile
"""


@pytest.fixture
def fragile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Isolation as the commands have it by default, with a short limit on time."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(SITE)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(guarded_file, "__kwdefaults__", {"limits": Limits(seconds=5)})


def doom(path: Path, fate: str) -> None:
    path.with_name(f"{path.name}.{fate}").touch()


CRASHED = "its decoder crashed (SIGSEGV); is the file whole, and what it says it is?"
HUNG = "its decoder took more than 5 s; is the file whole, and what it says it is?"


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_verify_lists_it_and_checks_the_others(
    jobs: str, eldata: Cli, own: Tree, fragile: None, tmp_path: Path
) -> None:
    doom(own.files / frame(3), "CRASH")
    if jobs == "1":  # the limit of other processes is a minute
        doom(own.files / frame(5), "HANG")
    report = tmp_path / "report.json"
    outcome = eldata("verify", own.manifest, "--root", own.root, "--level", "full", "--jobs", jobs, "--json", report)
    assert (outcome.code, outcome.err) == (1, "")
    found = {problem["path"]: problem["found"] for problem in json.loads(report.read_text())["datasets"][0]["problems"]}
    assert found == {frame(3): CRASHED} | ({frame(5): HUNG} if jobs == "1" else {})
    assert "32 of 32 files checked" in outcome.out


def test_evaluate_lists_it(eldata: Cli, own: Tree, fragile: None, predictions: Path) -> None:
    reference = own.pairs[0].reference
    doom(own.files / reference, "CRASH")
    outcome = eldata("evaluate", predictions, "--manifest", own.manifest, "--root", own.root, "--jobs", "1")
    assert outcome.code == 1
    of_it = [pair.path for pair in own.pairs if pair.reference == reference]
    lines = [f"{path}: its reference {reference} cannot be used: {CRASHED}" for path in of_it]
    assert outcome.out.splitlines()[:-1] == lines


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_pack_says_it_in_one_line(jobs: str, eldata: Cli, own: Tree, fragile: None, tmp_path: Path) -> None:
    """Two jobs are two threads."""
    doom(own.files / frame(7), "CRASH")
    folder, store = tmp_path / "frames", tmp_path / "store.h5"
    shutil.copytree(own.files, folder)
    outcome = eldata("pack", folder, "-o", store, "--jobs", jobs)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err == f"eldata pack: {folder / frame(7)}: {CRASHED}\n"


def test_a_command_may_do_without(eldata: Cli, own: Tree, fragile: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """By option, or by the environment, which the option overrules; then no process is started."""

    def refuse(*_: object) -> None:
        raise AssertionError

    command = ("verify", own.manifest, "--root", own.root, "--level", "full", "--jobs", "1")
    monkeypatch.setattr("eldata.base.processes._Process", refuse)
    assert eldata(*command, "--no-isolate").code == 0
    assert VARIABLE not in os.environ
    monkeypatch.setenv(VARIABLE, "0")
    assert eldata(*command).code == 0
    assert "unexpected AssertionError" in eldata(*command, "--isolate").err + eldata(*command, "--isolate").out
    assert os.environ[VARIABLE] == "0"
