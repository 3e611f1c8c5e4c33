"""What only a process of its own can show: the installed script, closed pipes, and kills."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import kills
from tests.evaluation.helpers import Tree
from tests.waiting import PATIENCE_S


def test_the_installed_script_runs_and_its_exit_code_reaches_the_shell(own: Tree) -> None:
    """And no bar of progress is drawn where there is no terminal."""
    next(own.files.rglob("*.dng")).unlink()
    script = Path(sys.executable).with_name("eldata")
    command: list[str | Path] = [script, "verify", own.manifest, "--root", own.root, "--level", "full", "--jobs", "2"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert (result.returncode, result.stderr) == (1, "")


def test_a_closed_pipe_prints_no_traceback(tree: Tree) -> None:
    read, write = os.pipe()
    os.close(read)
    command: list[str | Path] = [sys.executable, "-m", "eldata", "verify", tree.manifest, "--root", tree.root]
    result = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S)
    os.close(write)
    assert (result.returncode, result.stderr) == (141, "")


WITHOUT_TORCH = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name="torch")
sys.meta_path.insert(0, Missing())
"""


def test_scoring_verifying_and_capture_need_no_torch(tree: Tree, tmp_path: Path) -> None:
    """As README says of an installation without it; workers miss it as well. What needs it says so."""
    (tmp_path / "sitecustomize.py").write_text(WITHOUT_TORCH, encoding="utf-8")
    paths = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])

    def done(program: str, *arguments: str | Path) -> tuple[int, str]:
        command = [sys.executable, "-m", program, *arguments]
        environment = os.environ | {"PYTHONPATH": paths}
        result = subprocess.run(
            command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S
        )
        return result.returncode, result.stderr

    files: list[str | Path] = ["--manifest", tree.manifest, "--root", tree.root]
    assert done("eldata", "verify", tree.manifest, "--root", tree.root, "--level", "full", "--jobs", "2") == (0, "")
    assert done("eldata", "evaluate", "--baseline", "input", *files, "--jobs", "2", "--html", "e.html")[0] == 0
    assert done("capture", "camera", "--example", "cam.json") == (0, "")
    assert done("capture", "plan", "--camera", "cam.json", "--scenes", "2", "--metered", "4", "-o", "plan.json")[0] == 0
    code, said = done("eldata", "baseline", "network", *files, "-o", "preds")
    assert (code, said.count("\n"), "pip install torch" in said) == (2, 1, True), said


@pytest.mark.kill
@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in /proc")
@pytest.mark.parametrize("names", [list(kills.CASES)[k::3] for k in range(3)], ids="+".join)
def test_killed_and_run_again(names: list[str]) -> None:
    """Each kill and Ctrl-C, after some time and before a step, and the undisturbed result once it is run again.

    A seeded pass of tests/kills.py, which kills every command that writes; the whole of it is run by hand.
    """
    done = kills.in_a_process("--trials", "2", "--signal", "KILL", "INT", "--", *names)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("2 times SIG") == 2 * len(names)
