"""Being told to stop: SIGTERM is handled as Ctrl-C is; and streams that are closed."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable

import pytest

from eldata.base import console


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


def test_closed_streams_are_no_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert run(lambda: print("nowhere")) == 0
    sys.stdout.close()
