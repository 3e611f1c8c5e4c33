"""What only a process of its own can show: closed pipes and the installed script."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from tests.evaluation.helpers import Tree

MODULE = [sys.executable, "-m", "eldata"]


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


def test_a_closed_pipe_prints_no_traceback(tree: Tree) -> None:
    read, write = os.pipe()
    os.close(read)
    result = call("verify", tree.manifest, "--root", tree.root, stdout=write)
    os.close(write)
    assert (result.returncode, result.stderr) == (141, "")
