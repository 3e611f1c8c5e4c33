"""Being told to stop: SIGTERM is handled as Ctrl-C is; and streams that are closed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from eldata.base import console
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable
    from pathlib import Path


def run(work: Callable[[], object]) -> int:
    """The exit code of a command that does some work."""

    def command(_: argparse.Namespace) -> int:
        work()
        return 0

    parser = console.Parser(prog="some")
    parser.set_defaults(run=command)
    return console.run(parser, [])


@pytest.mark.parametrize(("number", "word"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_a_signal_unwinds_the_work_and_is_one_line(
    number: signal.Signals, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """SIGTERM twice, too, as timeout(1) sends it."""
    before = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)]
    unwound = []

    def work() -> None:
        try:
            signal.raise_signal(number)
        finally:
            if number == signal.SIGTERM:
                signal.raise_signal(number)
            unwound.append(True)

    assert run(work) == 128 + number
    assert unwound == [True]
    assert capsys.readouterr() == ("", f"some: {word}; files are written whole or not at all, so none is left half\n")
    assert [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.parametrize("handled", [True, False])
def test_sigterm_that_others_handle_or_ignore_is_left_to_them(handled: bool) -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGTERM, (lambda number, _: seen.append(number)) if handled else signal.SIG_IGN)
    try:
        assert run(lambda: signal.raise_signal(signal.SIGTERM)) == 0
        assert seen == [signal.SIGTERM] * handled
    finally:
        signal.signal(signal.SIGTERM, before)


NOWHERE = "eldata protocols: the system refused a step of this: Bad file descriptor; --debug shows which\n"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="shells with >&-")
@pytest.mark.parametrize(
    ("closed", "code", "said"),
    [
        ("<&-", 0, ""),
        (">&-", 2, NOWHERE),
        (
            ">&- <&-",
            2,
            NOWHERE,
        ),
        ("2>&-", 0, ""),
        (">&- 2>&-", 2, ""),
        (">/dev/full 2>/dev/full", 2, ""),
    ],
)
def test_closed_streams_are_no_crash(closed: str, code: int, said: str, tmp_path: Path) -> None:
    command = f'"{sys.executable}" -m eldata.cli.main protocols --json "{tmp_path}/p.json" {closed}'
    done = subprocess.run(["/bin/sh", "-c", command], capture_output=True, text=True, timeout=PATIENCE_S)
    assert (done.returncode, done.stderr) == (code, said)
    # What was opened has not taken the place of a stream, and got what was meant for that.
    if "full" not in closed:  # there the error comes first
        assert isinstance(json.loads((tmp_path / "p.json").read_text(encoding="utf-8")), dict | list)
