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
