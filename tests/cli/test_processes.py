"""What only a process of its own can show: closed pipes, Ctrl-C, the installed script."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import psutil  # type: ignore[import-untyped,unused-ignore] # types-psutil may be there or not
import pytest

from eldata.manifest.card import load_card, save_card
from eldata.manifest.catalogue import load_manifest
from eldata.manifest.layouts import EldCamera, eld_records
from eldata.manifest.table import save_records
from tests.evaluation.helpers import Tree
from tests.waiting import PATIENCE_S, until

MODULE = [sys.executable, "-m", "eldata.cli.main"]


def call(*arguments: str | Path, stdout: int = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    command = [*MODULE, *(str(argument) for argument in arguments)]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S)


def test_the_installed_script_runs_and_its_exit_codes_reach_the_shell(tree: Tree, tmp_path: Path) -> None:
    """And no bar of progress is drawn where there is no terminal."""
    script = Path(sys.executable).with_name("eldata")
    for root, code in ((tree.root, 0), (tmp_path, 1)):
        command = [str(script), "verify", str(tree.manifest), "--root", str(root), "--level", "full", "--jobs", "2"]
        result = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
        assert (result.returncode, result.stderr) == (code, "")
    assert call("frobnicate").returncode == 2


def closed_pipe() -> int:
    read, write = os.pipe()
    os.close(read)
    return write


def test_a_closed_pipe_prints_no_traceback(tree: Tree) -> None:
    pipe = closed_pipe()
    try:
        result = call("verify", tree.manifest, "--root", tree.root, stdout=pipe)
    finally:
        os.close(pipe)
    assert (result.returncode, result.stderr) == (141, "")


# --- Ctrl-C ---------------------------------------------------------------------------------------------------

SCENES = 200
ATTEMPTS = 8


@pytest.fixture(scope="module")
def long_tree(tree: Tree, tmp_path_factory: pytest.TempPathFactory) -> Tree:
    """Many scenes of the same files, so that a full verification takes many seconds."""
    own = Tree(tmp_path_factory.mktemp("long"))
    cameras = [
        EldCamera(name, ".dng", 100, dict.fromkeys(range(1, SCENES + 1), Fraction(4)))
        for name in ("DemoAlpha", "DemoBeta")
    ]
    records = eld_records(cameras, range(1, SCENES + 1))
    for record in records:
        path = own.files / record.path
        path.parent.mkdir(parents=True, exist_ok=True)
        os.link(tree.files / record.camera / "scene-1" / path.name, path)
    own.manifest.parent.mkdir()
    roles = [record.role for record in records]
    card = load_card(tree.manifest.with_suffix(".json"))
    save_card(own.manifest.with_suffix(".json"), replace(card, counts={role: roles.count(role) for role in set(roles)}))
    save_records(own.manifest, records)
    return own


def workers(process: subprocess.Popen[str]) -> list[psutil.Process]:
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "multiprocessing.spawn" in " ".join(child.cmdline())]


def interrupted(command: list[str | Path], delay_s: float, number: int) -> tuple[int, str, str]:
    """Send a signal to the process group some time after its workers run, as a terminal does; nothing may be left.

    On a busy machine this test may sleep for so long that the command has ended meanwhile: then it is started again.
    """
    for _ in range(ATTEMPTS):
        with subprocess.Popen(
            [*MODULE, *map(str, command)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            until(lambda: process.poll() is not None or len(workers(process)) == 2)  # called at once
            time.sleep(delay_s)
            family = [] if process.poll() is not None else workers(process)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, number)
            out, err = process.communicate(timeout=PATIENCE_S)
        assert psutil.wait_procs(family, timeout=PATIENCE_S)[1] == []
        if process.returncode != 0:
            return process.returncode, out, err
        delay_s /= 2
    pytest.fail(f"the command ended before anything was done to it, {ATTEMPTS} times")


@pytest.fixture(scope="module")
def long_evaluation(long_tree: Tree, tmp_path_factory: pytest.TempPathFactory) -> list[str | Path]:
    """The noisy frames as they are, as DNG predictions: scoring them takes long enough to be ended in its middle."""
    folder = tmp_path_factory.mktemp("long-predictions")
    for record in load_manifest(long_tree.manifest).records:
        if record.role == "noisy":
            link = folder / record.path
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(long_tree.files / record.path)
    return ["evaluate", folder, "--manifest", long_tree.manifest, "--root", long_tree.root, "--jobs", "2"]


@pytest.mark.kill
@pytest.mark.parametrize(
    ("number", "delay_s", "word"),
    [
        (signal.SIGINT, 0.0, "interrupted; "),
        (signal.SIGTERM, 0.3, "terminated; "),  # from timeout
    ],
)
def test_evaluate_ends_with_one_line(
    number: signal.Signals, delay_s: float, word: str, long_evaluation: list[str | Path], tmp_path: Path
) -> None:
    csv = tmp_path / "scores.csv"
    code, out, err = interrupted([*long_evaluation, "--csv", csv], delay_s, number)
    assert code == 128 + number
    assert (out, err.count("\n")) == ("", 1), err
    assert f"eldata evaluate: {word}" in err
    assert list(tmp_path.iterdir()) == []
