"""A seeded pass of tests/kills.py, which kills every command that writes; the whole of it is run by hand."""

from __future__ import annotations

import sys

import pytest

from tests import kills

pytestmark = [
    pytest.mark.kill,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in /proc"),
]


@pytest.mark.parametrize("name", kills.CASES)
def test_killed_and_run_again(name: str) -> None:
    """Each kill and Ctrl-C, and the undisturbed result to the bit after the command is run again."""
    done = kills.in_a_process("--trials", "3", "--signal", "KILL", "INT", "--", name)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("3 times SIG") == 2
