"""Guarded work: what it returns and raises, and that a crash, a hang and hunger for memory end in one sentence.

The work is functions of the standard library and of numpy, which any process can import.
"""

from __future__ import annotations

import ctypes
import errno
import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from datetime import datetime
from fractions import Fraction
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import eldata.base.isolation
from eldata.base.isolation import VARIABLE, GuardError, Limits, guarded, guarded_file, isolating, isolation
from eldata.base.workers import Workers
from eldata.errors import ArgumentError, EldataError, RawFileError
from eldata.records import Exposure, RawHeader
from tests.cases import in_one_test
from tests.waiting import PATIENCE_S, until

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="isolation needs a POSIX system")

# Of which no work below needs more: it hangs or it is done.
SHORT = Limits(seconds=1.0)


@pytest.fixture
def isolated(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Isolation is on, and afterwards no guarded process is left."""
    monkeypatch.delenv(VARIABLE, raising=False)
    with isolation():
        yield
    assert not eldata.base.isolation._HELPERS._all


def is_alive(process: int) -> bool:
    """Whether a process runs: not gone, and no zombie that nobody has asked for its end."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state not in "ZX"


# --- the switch -------------------------------------------------------------------------------------------------------


def test_it_is_off_unless_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert guarded(os.getpid) == os.getpid()
    with isolation():
        assert guarded(os.getpid) != os.getpid()
        with isolation(on=False):
            assert guarded(os.getpid) == os.getpid()
        assert guarded(guarded, os.getppid) == os.getpid(), "and not again inside"
    assert not isolating()
    monkeypatch.setenv(VARIABLE, "1")
    assert isolating()
    monkeypatch.setenv(VARIABLE, "yes")
    with pytest.raises(ArgumentError, match="ELDATA_ISOLATE must be 0 or 1; found 'yes'"):
        guarded(os.getpid)
    with pytest.raises(ArgumentError, match="limits must be positive"):
        Limits(seconds=0)


def test_workers_take_it_over(isolated: None) -> None:
    """Of our own, and of an executor whose processes have started before."""
    units = [f"__import__('os').environ[{VARIABLE!r}]"] * 3
    assert list(Workers(2).run(eval, units)) == ["1"] * 3
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        with isolation(on=False):
            assert list(Workers(executor=executor).run(eval, units)) == ["0"] * 3
        assert list(Workers(executor=executor).run(eval, units)) == ["1"] * 3


# --- answers ----------------------------------------------------------------------------------------------------------


def test_a_process_is_used_again_and_each_thread_has_its_own(isolated: None) -> None:
    first = guarded(os.getpid)
    assert guarded(os.getpid) == first
    with ThreadPoolExecutor(2) as pool:
        futures = [pool.submit(guarded, eval, "(__import__('time').sleep(0.5), __import__('os').getpid())[1]")] * 2
        futures[1] = pool.submit(guarded, eval, "(__import__('time').sleep(0.5), __import__('os').getpid())[1]")
        side_by_side = {future.result() for future in futures}
    assert len(side_by_side) == 2
    assert first in side_by_side


def test_records_and_arrays_come_back_equal(isolated: None) -> None:
    """Small and large ones, of every layout; in memory that may be written to."""
    random = np.random.default_rng(0)
    large = random.integers(0, 65536, (300, 401), np.uint16)
    sent: Any = {
        "large": large,
        "transposed": large.T,
        "cut": large[1:-1, 3:200:2],
        "small": np.array([1, 2], np.float32),
        "none": np.empty((0, 3)),
        "scalar": np.float64(0.1),
        "header": RawHeader(Path("a.dng"), "Make", "Model", Exposure(Fraction(100)), datetime(2026, 1, 2)),  # noqa: DTZ001
        "plain": (None, True, 1.5, "text", b"bytes", frozenset((1,))),
    }
    found: Any = guarded(dict, sent)
    assert found.keys() == sent.keys()
    for name, value in sent.items():
        if isinstance(value, np.ndarray):
            assert found[name].dtype == value.dtype
            assert np.array_equal(found[name], value)
        else:
            assert found[name] == value, name
    found["large"] += 1
    assert np.array_equal(found["large"], large + np.uint16(1))
    with ThreadPoolExecutor(4) as pool:
        for index, many in enumerate(pool.map(lambda n: guarded(np.full, (200, 200), n), range(40))):
            assert (many == index).all()


def test_errors_come_through(isolated: None) -> None:
    with pytest.raises(ValueError, match="invalid literal for int") as caught:
        guarded(int, "x")
    assert re.search(r"on \S+, process \d+:\nTraceback", caught.value.__notes__[0])
    code = "__import__('eldata.raw.reading').raw.reading.read_header('/nowhere.dng')"
    with pytest.raises(RawFileError, match="No such file") as ours:
        guarded(eval, code)
    assert ours.value.path == Path("/nowhere.dng")


def read_what_cannot_be_read(_: Path) -> bytes:
    with Path("/proc/self/mem").open("rb", buffering=0) as file:
        return file.read(1)  # the system's own Input/output error


@pytest.mark.parametrize("isolate", [False, True])
def test_a_disk_that_fails_names_the_file_and_is_not_called_damage(isolate: bool, tmp_path: Path) -> None:
    file = tmp_path / "IMG_0001.dng"
    file.write_bytes(b"II*\0")
    with (
        isolation(isolate),
        pytest.raises(RawFileError, match=r"^\S*IMG_0001\.dng: cannot be read: Input/output error"),
    ):
        guarded_file(read_what_cannot_be_read, file, RawFileError)


def test_a_process_that_cannot_be_started_is_blamed(isolated: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def refusing(*_: object, **__: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr("subprocess.Popen", refusing)
    with pytest.raises(EldataError, match=r"cannot be started \(Too many open files\).*ulimit.*--no-isolate"):
        guarded(abs, -1)


def test_relative_paths_are_those_of_the_caller(
    isolated: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        assert guarded(os.getcwd) == str(tmp_path / name)


def test_nothing_is_left_open(isolated: None) -> None:
    def held() -> tuple[int, list[str]]:
        return len(os.listdir("/proc/self/fd")), sorted(os.listdir("/dev/shm"))  # noqa: PTH208, S108

    guarded(np.ones, 100_000)
    before = held()
    kept = [guarded(np.ones, 100_000) for _ in range(20)]
    assert held() == before
    assert sum(map(np.sum, kept)) == 2_000_000


# --- crashes, hangs, memory -------------------------------------------------------------------------------------------


@in_one_test(
    "work,arguments,reason",
    [
        (os.abort, (), r"crashed \(SIGABRT\)"),
        (ctypes.string_at, (8,), r"crashed \(SIGSEGV\)"),
        (os._exit, (3,), r"crashed \(exit code 3\)"),
        (eval, ("__import__('sys').exit(4)",), r"crashed \(exit code 4\)"),
        (eval, ("__import__('os').kill(__import__('os').getpid(), 9)",), r"crashed \(SIGKILL\)"),
        (time.sleep, (1e6,), "took more than 1 s"),
        # This one does not let go of Python's lock.
        (eval, ("__import__('re').match('(a+)+b', 'a' * 64)",), "took more than 1 s"),
        (bytearray, (100 << 30,), "needed more than 2 GiB of memory"),
        (np.ones, (1 << 29,), "needed more than 2 GiB of memory"),
    ],
)
def test_it_costs_one_error(work: Any, arguments: tuple[Any, ...], reason: str, isolated: None) -> None:
    """And the next work is done as if nothing had been."""
    if "memory" in reason and sys.platform != "linux":
        pytest.skip("only Linux enforces RLIMIT_DATA")
    limits = SHORT if "took" in reason else Limits()
    with pytest.raises(GuardError, match=f"^its decoder {reason}"):
        guarded(work, *arguments, limits=limits)
    assert guarded(int, "7") == 7


def test_threads_lose_only_their_own(isolated: None) -> None:
    work = ["'well'", "__import__('os').abort()", "__import__('time').sleep(1e6)"] * 4
    with ThreadPoolExecutor(4) as pool:
        futures = [pool.submit(guarded, eval, code, limits=Limits(seconds=5)) for code in work]
    errors = [future.exception() for future in futures]
    for code, error, future in zip(work, errors, futures, strict=True):
        if code == "'well'":
            assert future.result() == "well"
        else:
            assert isinstance(error, GuardError)
            assert ("SIGABRT" if "abort" in code else "took more than 5 s") in str(error)


def test_what_an_earlier_file_did_is_not_blamed_on_the_next(isolated: None) -> None:
    """The process of the first one has died meanwhile, or has no memory left."""
    os.kill(guarded(os.getpid), signal.SIGKILL)
    assert guarded(int, "7") == 7


def test_a_process_that_ran_out_of_memory_is_not_used_again(isolated: None) -> None:
    before = guarded(os.getpid)
    if sys.platform == "linux":
        with pytest.raises(GuardError, match="memory"):
            guarded(bytearray, 100 << 30)
        assert guarded(os.getpid) != before


def read_marked(path: Path) -> int:
    """Return a process's number; die, or hang, as a file's content says."""
    fate = path.read_bytes()
    if fate == b"hangs":
        time.sleep(1e6)
    if fate:
        os.kill(os.getpid(), int(fate))
    return os.getpid()


def read_all(paths: list[Path]) -> list[int | str]:
    """Read files as a unit of work does: one that cannot be read is noted."""
    found: list[int | str] = []
    for path in paths:
        try:
            found.append(guarded(read_marked, path, limits=Limits(seconds=3)))
        except GuardError as error:
            found.append(str(error))
    return found


@pytest.mark.kill
def test_a_worker_is_its_own_guard_and_a_file_that_ends_it_costs_that_file(isolated: None, tmp_path: Path) -> None:
    """Two files of the second unit end their worker, one is never done; whatever else it reads is read."""
    paths = [tmp_path / str(number) for number in range(8)]
    for path, fate in zip(paths, ["", "", "6", "", "11", "", "hangs", ""], strict=True):
        path.write_text(fate)
    (first, *more), second = Workers(2).run(read_all, [paths[:2], paths[2:]])
    assert os.getpid() != first == more[0]
    assert second[0] == "its decoder crashed (SIGABRT)"
    assert second[2] == "its decoder crashed (SIGSEGV)"
    assert second[4] == "its decoder took more than 3 s"
    assert second[1] == second[3] == second[5], "one process has read the rest"


def test_an_interrupted_caller_does_not_leave_its_answer_to_the_next(isolated: None) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    guarded(int, "0")
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        with pytest.raises(KeyboardInterrupt):
            guarded(eval, "(__import__('time').sleep(60), 'late')[1]")
    finally:
        signal.signal(signal.SIGALRM, before)
    assert guarded(str, "next") == "next"


# --- the end ----------------------------------------------------------------------------------------------------------


def hanging(hang: str, folder: Path) -> tuple[subprocess.Popen[str], int]:
    """Return a process that waits for its helper, and the helper, which hangs."""
    mark = folder / "hangs"
    code = f"""
import os
from pathlib import Path
from eldata.base.isolation import Limits, guarded, isolation
with isolation():
    print(guarded(os.getpid), flush=True)
    guarded(eval, "(__import__('pathlib').Path({str(mark)!r}).touch(), {hang})", limits=Limits(seconds=10))
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=Path(__file__).parents[2],
    )
    until(mark.exists, "the start of the work")
    assert process.stdout is not None
    return process, int(process.stdout.readline())


@pytest.mark.kill
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_it_ends_with_its_parent(number: signal.Signals, tmp_path: Path) -> None:
    """However that ends; Ctrl-C reaches the parent alone, so nothing else complains."""
    process, helper = hanging("__import__('time').sleep(1e6)", tmp_path)
    os.killpg(process.pid, number)
    _, errors = process.communicate(timeout=PATIENCE_S)
    until(lambda: not is_alive(helper), "the end of the helper")
    assert process.returncode == -number
    assert errors.count("Traceback") == (1 if number == signal.SIGINT else 0)


@pytest.mark.kill
def test_it_ends_by_itself_even_if_it_holds_pythons_lock(tmp_path: Path) -> None:
    """The parent's deadline can no longer end it; its own can."""
    process, helper = hanging("__import__('re').match('(a+)+b', 'a' * 64)", tmp_path)
    process.kill()
    process.communicate(timeout=PATIENCE_S)
    until(lambda: not is_alive(helper), "the end of the helper")


def test_a_fork_has_helpers_of_its_own() -> None:
    """Such as a DataLoader's worker; and what it has forgotten still serves the parent."""
    code = """
import os
from eldata.base.isolation import guarded, isolation
with isolation():
    first = guarded(os.getpid)
    child = os.fork()
    own = guarded(os.getpid)
    if child == 0:
        os._exit(0 if own not in (first, os.getpid()) else 1)
    print(own == first, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), guarded(int, "7"))
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, cwd=Path(__file__).parents[2])
    assert (done.stdout, done.stderr) == ("True 0 7\n", "")
