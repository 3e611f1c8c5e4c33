"""A seeded pass of tests/kills.py, which kills every command that writes; the whole of it is run by hand."""

from __future__ import annotations

import sys

import pytest

from tests import kills

pytestmark = [
    pytest.mark.kill,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in /proc"),
]


@pytest.mark.parametrize("names", [list(kills.CASES)[k::3] for k in range(3)], ids="+".join)
def test_killed_and_run_again(names: list[str]) -> None:
    """Each kill and Ctrl-C, after some time and before a step, and the undisturbed result once it is run again."""
    done = kills.in_a_process("--trials", "2", "--signal", "KILL", "INT", "--", *names)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("2 times SIG") == 2 * len(names)
