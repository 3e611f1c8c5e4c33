"""Units of work over processes: order, a bounded window, and an end to everything that can go wrong.

The work is functions of the standard library, which a spawned process can import whatever runs the tests.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil  # type: ignore[import-untyped,unused-ignore] # types-psutil may be there or not
import pytest

from eldata.base import workers
from eldata.base.workers import Failed, Processes, Workers
from eldata.errors import ArgumentError
from tests.base.clusters.work import Task
from tests.cases import in_one_test
from tests.waiting import PATIENCE_S


def workers_of(process: int) -> list[psutil.Process]:
    children = psutil.Process(process).children()
    return [child for child in children if "multiprocessing.spawn" in " ".join(child.cmdline())]


@pytest.fixture(autouse=True)
def no_process_is_left() -> Iterator[None]:
    yield
    assert workers_of(os.getpid()) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_the_units_order(jobs: int) -> None:
    """Earlier units take longer, so that results arrive in another order than they are wanted."""
    with Workers(jobs).sharing() as shared:
        assert list(shared.run(time.sleep, [0.3, 0.0, 0.2, 0.0])) == [None] * 4
        assert list(shared.run(abs, list(range(-30, 0)))) == list(range(30, 0, -1))


@in_one_test(
    "given, said",
    [
        (0, "workers must be 1 or more; found 0"),
        (-1, "workers must be 1 or more; found -1"),
        ("two", "workers must be a whole number or an executor; found 'two'"),
    ],
)
def test_what_is_no_workers(given: Any, said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        Workers.of(given)


class Dying(Processes):
    """Runs calls in two threads; the worker of the unit 3 is lost some times, at once."""

    def __init__(self, times: int) -> None:
        self._max_workers, self.times, self.checks, self.beside = 1, times, 0, 0
        self.pool, self.others = ThreadPoolExecutor(2), list[Future[Any]]()

    def submit(self, call: Any, /) -> Future[Any]:  # type: ignore[override] # all that is used
        def slowly() -> Any:
            time.sleep(0.01)
            return call()

        if call.args[1].number != 3:
            self.others.append(self.pool.submit(slowly))
            return self.others[-1]
        self.beside, future = sum(not other.done() for other in self.others), Future[Any]()
        if self.times > 0:
            self.times -= 1
            future.set_exception(BrokenProcessPool())
        else:
            future.set_result(call())
        return future

    def check(self) -> None:
        self.checks += 1


@pytest.mark.parametrize("times", [1, 2])
def test_a_unit_whose_worker_died_is_tried_once_more(times: int) -> None:
    """If it ends that worker, too, it is a failure that names it; the other units are not."""
    executor = Dying(times)
    tasks = [Task(number, f"{number}.dng") for number in range(20)]
    outcomes = list(Workers(executor=executor).attempt(attrgetter("number"), tasks))
    executor.pool.shutdown()
    assert (executor.times, executor.checks, executor.beside) == (0, 1, 0), "alone, at last"
    if times == 2:
        failed = outcomes[3]
        assert isinstance(failed, Failed)
        assert failed.unit == tasks[3]
        assert failed.reason.startswith("3.dng: worker processes died at it again and again")
        outcomes[3] = 3
    assert outcomes == list(range(20))


class Ended(BaseException):
    """Stands for the end of this process."""


def test_how_a_worker_process_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Told to, it unwinds its work, and that is no result; without work, or without its parent, it ends at once."""

    def end(status: int) -> None:
        raise Ended(status)

    monkeypatch.setattr(os, "_exit", end)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(workers, "parent_process", lambda: SimpleNamespace(join=int))
    with pytest.raises(SystemExit):
        workers._run_elsewhere(partial(workers._unwind, signal.SIGTERM), None, os.getpid(), "")
    with pytest.raises(Ended, match="143"):
        workers._run_elsewhere(partial(workers._unwind, signal.SIGTERM), None, 0, "")
    workers._AT_WORK.clear()
    for end_now in (partial(workers._unwind, signal.SIGTERM, None), workers._end_with_parent):
        with pytest.raises(Ended, match="143"):
            end_now()


UNGUARDED = """
from eldata.base.workers import Workers

print(list(Workers(2).run(abs, [1, 2, 3])))
"""


def test_a_script_without_the_guard(tmp_path: Path) -> None:
    """Each worker that runs it again says so in one line, and no pool is started for ever."""
    with started(UNGUARDED, tmp_path) as child:
        out, err = child.communicate(timeout=PATIENCE_S)
    assert (child.returncode, out) == (1, "")
    lines = err.splitlines()
    said = 'put work under if __name__ == "__main__": each worker process runs the script again'
    assert 1 <= lines.count(said) <= 4
    assert "worker processes die as soon as they start" in lines[-1]


# --- threads ----------------------------------------------------------------------------------------------------------


def reader_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("ThreadPoolExecutor")]


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_give_results_in_the_units_order(threads: int) -> None:
    delays = [0.05, 0.0, 0.03, 0.0, 0.01, 0.0]

    def work(index: int) -> int:
        time.sleep(delays[index])
        return index

    assert list(Workers(threads).read_ahead(work, range(6))) == list(range(6))
    assert list(Workers(threads).read_ahead(work, [])) == []
    assert list(Workers(threads).read_ahead(work, iter([3, 1]))) == [3, 1], "any iterable will do"
    assert reader_threads() == []


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_at_most_one_result_more_than_threads_is_in_memory(threads: int) -> None:
    """Frames are large: the threads wait until the consumer has taken one, however slow it is."""
    alive, most, lock = 0, 0, threading.Lock()

    class Frame:
        def __init__(self, _: int) -> None:
            nonlocal alive, most
            with lock:
                alive += 1
                most = max(most, alive)

        def __del__(self) -> None:
            nonlocal alive
            with lock:
                alive -= 1

    results = Workers(threads).read_ahead(Frame, range(40))
    for _ in range(40):
        frame = next(results)
        time.sleep(0.002)
        del frame
    assert most <= threads + 1


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_of_a_thread_comes_in_its_turn(threads: int) -> None:
    results = Workers(threads).read_ahead(int, ["1", "2", "three", "4", "five", "6"])
    assert [next(results), next(results)] == [1, 2]
    with pytest.raises(ValueError, match="'three'"):
        next(results)
    assert reader_threads() == []


INTERRUPTED = """
import sys
from pathlib import Path
from eldata.base.workers import Workers

if __name__ == "__main__":
    for _ in Workers(2).run(Path.read_bytes, [Path(name) for name in sys.argv[1:]]):
        print("one", flush=True)
"""


@pytest.mark.kill
def test_ctrl_c_ends_everything_and_is_told_once(tmp_path: Path) -> None:
    """A terminal sends Ctrl-C to the whole process group; each worker would print a traceback of its own.

    The last unit is a pipe: opening it waits until a worker reads it, and that worker works until it is closed.
    """
    pipe, file = tmp_path / "pipe", tmp_path / "file"
    file.touch()
    os.mkfifo(pipe)
    with started(INTERRUPTED, tmp_path, *[str(file)] * 4, str(pipe)) as child:
        assert child.stdout is not None
        with pipe.open("wb"):
            for _ in range(4):
                assert child.stdout.readline() == "one\n"
            children = workers_of(child.pid)
            os.killpg(child.pid, signal.SIGINT)  # one worker works, and the other waits for work
        _, errors = child.communicate(timeout=PATIENCE_S)
        assert psutil.wait_procs(children, timeout=PATIENCE_S)[1] == []
    assert child.returncode != 0
    assert errors.count("KeyboardInterrupt") == 1, errors


@contextmanager
def started(text: str, folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Yield the process of a script, in a group of its own, and end that."""
    (folder / "work.py").write_text(text, encoding="utf-8")
    command = [sys.executable, str(folder / "work.py"), *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as child:
        try:
            yield child
        finally:
            child.kill()


ORPHANED = """
import ctypes, os, sys, time
from eldata.base.workers import Workers

def python(unit):
    while True:
        time.sleep(0.01)

def released(unit):
    ctypes.CDLL(None).sleep(10**6)  # a long call into C, other threads run

def said(unit):
    os.write(1, b"begun\\n")
    return globals()[sys.argv[1]](unit)

if __name__ == "__main__":
    list(Workers(2).run(said, [1, 2]))
"""


@pytest.mark.kill
@pytest.mark.parametrize(
    ("work", "number"), [("python", signal.SIGKILL), ("released", signal.SIGKILL), ("python", signal.SIGTERM)]
)
def test_workers_end_with_their_parent(work: str, number: int, tmp_path: Path) -> None:
    """However it ends, and whatever they do. Only the parent gets the signal, as from kill or a scheduler."""
    with started(ORPHANED, tmp_path, work) as child:
        assert child.stdout is not None
        assert [child.stdout.readline() for _ in range(2)] == ["begun\n"] * 2
        children = workers_of(child.pid)
        child.send_signal(number)
        assert child.wait(PATIENCE_S) == -number
        assert psutil.wait_procs(children, timeout=PATIENCE_S)[1] == []
