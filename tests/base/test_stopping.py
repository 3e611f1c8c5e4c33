"""Being told to stop, at every moment: while a program imports, works, tidies up and leaves."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from subprocess import PIPE
from typing import TYPE_CHECKING

import pytest

from eldata.base.stopping import SIGNALS, Stopped, Stopping, held, stoppable
from tests.waiting import PATIENCE_S, is_asleep, until

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def raised_by(work: Callable[[], None], state: Stopping) -> int | None:
    """The signal by which some work was stopped."""
    try:
        with stoppable(state):
            work()
    except Stopped as stopped:
        return stopped.number
    return None


@pytest.fixture(autouse=True)
def signals_stay_as_they_were() -> object:
    before = [signal.getsignal(number) for number in SIGNALS]
    hook = sys.unraisablehook
    yield
    assert [signal.getsignal(number) for number in SIGNALS] == before
    assert sys.unraisablehook is hook


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_is_raised_where_the_work_is(number: int) -> None:
    reached = []

    def work() -> None:
        signal.raise_signal(number)
        reached.append(True)

    assert raised_by(work, Stopping(None)) == number
    assert reached == []


@pytest.mark.parametrize("number", SIGNALS)
def test_what_a_library_swallowed_is_raised_at_the_end(number: int) -> None:
    def work() -> None:
        with suppress(BaseException):  # as careless libraries do
            signal.raise_signal(number)

    state = Stopping(None)
    assert raised_by(work, state) == number
    assert state.number == number


@pytest.mark.kill
def test_what_an_import_makes_of_it_is_not_a_units_error(tmp_path: Path) -> None:
    """Enumerations wrap what is raised while they are made: as units' errors, files would be listed as problems."""
    (tmp_path / "wrapping.py").write_text(
        "import os, signal\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "except BaseException:\n"
        "    raise RuntimeError('Error calling __set_name__')\n"
    )
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from eldata.base.stopping import Stopped, Stopping, stoppable\n"
        "from eldata.base.workers import Workers\n"
        "def work(unit):\n"
        "    print(unit, flush=True)\n"
        "    import wrapping\n"
        "try:\n"
        "    with stoppable(Stopping(None)):\n"
        "        list(Workers().attempt(work, [1, 2, 3]))\n"
        "except Stopped as stopped:\n"
        "    print('stopped by', stopped.number)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert (done.stdout, done.stderr) == ("1\nstopped by 15\n", "")


def test_what_python_drops_is_raised_again() -> None:
    class Careless:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGTERM)

    after = []

    def work() -> None:
        some = Careless()
        del some
        until(lambda: False, "the second try")
        after.append(True)

    assert raised_by(work, Stopping(None)) == signal.SIGTERM
    assert after == []


def test_the_same_event_twice_does_not_end_the_tidying() -> None:
    """timeout(1) sends SIGTERM twice: to its child, and to the group that the child is in."""
    tidied = []

    def work() -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGTERM)
            tidied.append(True)

    assert raised_by(work, Stopping(None)) == signal.SIGTERM
    assert tidied == [True]


def test_signals_that_others_handle_are_left_to_them() -> None:
    seen = []
    before = signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    ignored = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # nohup
    try:

        def work() -> None:
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGHUP)

        assert raised_by(work, Stopping(None)) is None
        assert seen == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)
        signal.signal(signal.SIGHUP, ignored)


def test_other_threads_are_left_alone() -> None:
    outcomes = []
    thread = threading.Thread(target=lambda: outcomes.append(raised_by(lambda: None, Stopping(None))))
    thread.start()
    thread.join()
    assert outcomes == [None]


def test_a_signal_waits_for_the_end_of_what_must_not_be_half() -> None:
    """None is lost, which setting SIG_IGN for a moment would do."""
    done = []

    def work() -> None:
        with held():
            signal.raise_signal(signal.SIGINT)
            done.append("inside")
        done.append("after")

    assert raised_by(work, Stopping(None)) == signal.SIGINT
    assert done == ["inside"]


# --- programs -----------------------------------------------------------------------------------------------------

# Sends itself a signal as it imports its k-th module, and says how many there were if there are not so many.
AT_IMPORT = """
import importlib, os, signal, sys
at, number = int(sys.argv[1]), int(sys.argv[2])
class Counting:
    seen = 0
    def find_spec(self, name, path=None, target=None):
        Counting.seen += 1
        if Counting.seen == at:
            os.kill(os.getpid(), number)
main = importlib.import_module(sys.argv[3]).main
sys.argv = sys.argv[4:]
sys.meta_path.insert(0, Counting())
code = main()
if not at:
    print("imports", Counting.seen)
sys.exit(code)
"""


def at_import(at: int, number: int, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", AT_IMPORT, str(at), str(int(number)), f"{program}.cli.main", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)


COMMANDS = {
    "eldata": ("synthesize", "nowhere", "-o", "never", "--camera", "SonyA7S2"),
    "capture": ("protocol", "--metered", "4"),
}


@pytest.mark.kill
@pytest.mark.parametrize("program", COMMANDS)
def test_ctrl_c_while_a_program_imports_is_one_line(program: str, tmp_path: Path) -> None:
    """By each signal at two of six places in its imports, from the first to the last."""
    undisturbed = at_import(0, signal.SIGINT, program, *COMMANDS[program])
    count = int(undisturbed.stdout.split()[-1])
    assert count > 50
    for place in range(6):
        number = SIGNALS[place % len(SIGNALS)]
        done = at_import(1 + place * (count - 1) // 5, number, program, *COMMANDS[program])
        assert (done.returncode, done.stdout) == (128 + number, ""), (place, done)
        assert done.stderr.startswith(program)
        assert done.stderr.count("\n") == 1, (place, done.stderr)


def test_before_ctrl_c_is_handled_little_is_imported() -> None:
    """What comes before cannot be answered in one line: Python's own start, and these modules."""
    for program in COMMANDS:
        code = f"import sys; old = set(sys.modules); import {program}.cli.main; print(*set(sys.modules) - old)"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
        loaded = done.stdout.split()
        ours = {name for name in loaded if name.split(".")[0] in COMMANDS}
        stage = {"eldata", "eldata.base", "eldata.base.stopping", f"{program}", f"{program}.cli", f"{program}.cli.main"}
        assert ours == stage
        assert not {"typing", "threading", "argparse", "numpy"} & set(loaded)


IMPATIENT = """
import os, signal, sys, time
from eldata.base import stopping
stopping._SAME_EVENT_S = 0.0
stopping.exit_when_told("eldata")
try:
    with stopping.stoppable(stopping.Stopping("eldata")):
        os.kill(os.getpid(), signal.SIGTERM)
finally:
    os.kill(os.getpid(), signal.SIGINT)  # while it tidies
    print("never")
"""


@pytest.mark.kill
def test_who_asks_again_is_served_at_once() -> None:
    done = subprocess.run([sys.executable, "-c", IMPATIENT], capture_output=True, text=True, timeout=PATIENCE_S)
    assert (done.returncode, done.stdout, done.stderr) == (143, "", "eldata: terminated\n")


# Waits for a lock of C that nobody will open: signals do not end that, nor does Python's handler get to run.
STUCK = """
import ctypes, sys
from eldata.base import stopping
stopping.exit_when_told("eldata")
with stopping.stoppable(stopping.Stopping("eldata")):
    libc, lock = ctypes.CDLL(None), ctypes.create_string_buffer(256)
    libc.pthread_mutex_lock(lock)
    print("stuck", flush=True)
    libc.pthread_mutex_lock(lock)
"""


@pytest.mark.kill
@pytest.mark.skipif(sys.platform != "linux", reason="a lock of zeros is one of glibc")
@pytest.mark.parametrize(("number", "word"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_who_asks_again_is_served_inside_a_call_into_c(number: int, word: str) -> None:
    """The first time waits for the call's return, and so does the same event again."""
    with subprocess.Popen([sys.executable, "-c", STUCK], stdout=PIPE, stderr=PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "stuck\n"
            until(lambda: is_asleep(process.pid), "the second lock")
            for _ in range(2):
                process.send_signal(number)
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(1.5)  # longer than what counts as one event
            process.send_signal(number)
            out, said = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    assert (process.returncode, out, said) == (128 + number, "", f"eldata: {word}\n")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="shells with >&-")
@pytest.mark.parametrize(
    ("closed", "code", "said"),
    [
        ("<&-", 0, ""),
        (">&-", 2, "eldata protocols: cannot write to standard output: Bad file descriptor\n"),
        (">&- <&-", 2, "eldata protocols: cannot write to standard output: Bad file descriptor\n"),
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
