"""Other systems than Linux: nothing at start needs POSIX."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.waiting import PATIENCE_S

ROOT = Path(__file__).parents[1]


def test_every_module_and_every_help_works_without_posix() -> None:
    command = [sys.executable, "-m", "tests.without_posix"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    eldata, capture = map(int, done.stdout.split()[1:])
    assert eldata >= 15
    assert capture >= 7
