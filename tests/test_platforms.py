"""Other systems than Linux: nothing at start needs POSIX."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from eldata.base.files import try_lock
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).parents[1]


def test_every_module_and_every_help_works_without_posix() -> None:
    command = [sys.executable, "-m", "tests.without_posix"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    eldata, capture = map(int, done.stdout.split()[1:])
    assert eldata >= 15
    assert capture >= 7


def test_a_lock_is_held_until_the_file_is_closed(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    path = tmp_path / "file"
    with path.open("wb") as first, path.open("rb") as second:
        assert try_lock(first)
        assert not try_lock(second)
        first.close()
        assert try_lock(second.fileno())
