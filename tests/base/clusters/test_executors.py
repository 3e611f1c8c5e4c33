"""Units on executors that the caller brings: threads, processes, and a real Dask cluster of two processes."""

from __future__ import annotations

import socket
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import Any

import pytest

from eldata.base.workers import Failed, Workers
from eldata.errors import EldataError, FileError, RawFileError
from tests.base.clusters import work


def test_results_come_in_the_units_order(executor: Executor) -> None:
    numbers = list(range(40))
    assert list(Workers(executor=executor).run(work.double, numbers)) == [2 * number for number in numbers]
    assert list(Workers(executor=executor).read_ahead(work.double, iter(numbers))) == [2 * n for n in numbers]
    assert list(Workers(executor=executor).run(work.double, [])) == []


def test_the_executor_is_not_shut_down(executor: Executor) -> None:
    """Neither at the end, nor by an error, nor by a caller who leaves early."""
    list(Workers(executor=executor).run(work.double, range(4)))
    with pytest.raises(RawFileError):
        list(Workers(executor=executor).run(work.fail_at_threes, range(4)))
    results = Workers(executor=executor).run(work.double, range(400))
    assert next(results) == 0
    results.close()  # type: ignore[attr-defined] # an iterator by its type, a generator in fact
    assert executor.submit(work.double, 21).result(60) == 42


def test_failing_units_do_not_lose_the_rest(executor: Executor) -> None:
    outcomes = list(Workers(executor=executor).attempt(work.fail_at_threes, range(10)))
    assert [outcome for outcome in outcomes if not isinstance(outcome, Failed)] == [1, 2, 4, 5, 7, 8]
    failed = [outcome for outcome in outcomes if isinstance(outcome, Failed)]
    assert [(failure.unit, failure.reason) for failure in failed] == [
        (number, f"{number}.dng: is not whole") for number in (0, 3, 6, 9)
    ]
    assert all(isinstance(failure.error, RawFileError) and failure.error.path for failure in failed), "with its fields"
    outcome = list(Workers(executor=executor).attempt(work.fail_in_the_program, [1, 2, 3]))[1]
    assert isinstance(outcome, Failed)
    assert outcome.reason.startswith("unexpected ZeroDivisionError")


def test_errors_that_cannot_be_made_again(executor: Executor) -> None:
    """Such an error would break a pool of processes as it is unpickled."""
    found = list(Workers(executor=executor).attempt(work.fail_oddly, [1, 2]))
    assert [one.reason for one in found if isinstance(one, Failed)] == [
        *("unexpected UnpicklableError: 1 and 1", "unexpected UnpicklableError: 2 and 2")
    ]


def test_a_file_that_the_worker_does_not_see(executor: Executor, tmp_path: Path) -> None:
    (tmp_path / "here.dng").write_bytes(b"123")
    found = list(Workers(executor=executor).attempt(work.look_at, [tmp_path / "gone.dng", tmp_path / "here.dng"]))
    assert found[1] == 3
    assert isinstance(found[0], Failed)
    assert isinstance(found[0].error, FileError)
    assert found[0].reason == (
        f"{tmp_path / 'gone.dng'}: No such file or directory on {socket.gethostname()}; every machine that takes part "
        "must see the same files under the same paths"
    )


# --- how many at a time -----------------------------------------------------------------------------------------------


class Lazy(Future[Any]):
    """Runs its call when it is asked for what came of it."""

    def __init__(self, call: Callable[[], Any]) -> None:
        super().__init__()
        self.call = call

    def exception(self, timeout: float | None = None) -> BaseException | None:
        if not self.done():
            self.set_result(self.call())
        return super().exception(timeout)


class Stepwise(Executor):
    """Runs each call when its result is wanted, and counts the calls in flight."""

    def __init__(self, workers: int | None = None) -> None:
        self.futures: list[Lazy] = []
        self.most = 0
        if workers is not None:
            self._max_workers = workers

    def submit(self, call: Callable[[], Any], /) -> Future[Any]:  # type: ignore[override] # all that is used
        future = Lazy(call)
        self.futures.append(future)
        self.most = max(self.most, sum(not one.done() for one in self.futures))
        return future


@pytest.mark.parametrize(("workers", "in_flight", "large"), [(1, 5, 2), (3, 13, 4), (None, 65, 17), (500, 200, 17)])
def test_a_bounded_number_of_units_is_in_flight(workers: int | None, in_flight: int, large: int) -> None:
    executor = Stepwise(workers)
    list(Workers(executor=executor).read_ahead(work.double, range(200)))
    assert executor.most == large
    executor = Stepwise(workers)
    results = Workers(executor=executor).run(work.double, range(200))
    assert executor.futures == [], "nothing starts before a result is wanted"
    assert list(results) == [2 * number for number in range(200)]
    assert executor.most == in_flight
    results = Workers(executor=executor).run(work.double, range(200))
    next(results)
    results.close()  # type: ignore[attr-defined] # as Ctrl-C does
    assert all(future.done() for future in executor.futures), "what waits is taken back"


# --- executors that cannot --------------------------------------------------------------------------------------------


class Broken(Executor):
    """A pool that broke before, such as one whose process was killed."""

    def submit(self, *_: object, **__: object) -> Future[Any]:
        raise BrokenExecutor("a process ended abruptly")


def test_a_broken_pool_of_the_callers_is_an_error_that_names_the_unit() -> None:
    tasks = [work.Task(number, f"{number}.dng") for number in range(3, 40)]
    with pytest.raises(EldataError, match=r"^the executor cannot run the work on 3\.dng: BrokenExecutor: a process"):
        list(Workers(executor=Broken()).run(work.end_the_process, tasks))


def test_work_that_cannot_travel(processes: Executor) -> None:
    with pytest.raises(EldataError, match=r"^the executor cannot run the work on 1: .*pickle"):
        list(Workers(executor=processes).run(lambda number: number, [1]))


# --- processes of our own ---------------------------------------------------------------------------------------------


@pytest.mark.kill
def test_a_unit_that_ends_every_process_is_named_and_the_rest_is_done(importable: None) -> None:
    tasks = [work.Task(number, f"{number}.dng") for number in range(30)]
    found = list(Workers(2).attempt(work.end_the_process, tasks))
    assert [one for one in found if not isinstance(one, Failed)] == [number for number in range(30) if number != 3]
    assert isinstance(found[3], Failed)
    assert found[3].unit == tasks[3]
    assert found[3].reason.startswith("3.dng: worker processes died at it again and again")
