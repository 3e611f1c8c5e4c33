"""A real Dask cluster: workers that are killed, commands with --dask, and clusters that cannot be used."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from concurrent.futures import Executor, Future
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from eldata.base import console
from eldata.base.workers import Failed, Workers
from eldata.cli.main import main
from eldata.manifest.verify import verify
from tests.base.clusters import work
from tests.evaluation.helpers import Tree
from tests.waiting import PATIENCE_S, until

if TYPE_CHECKING:
    from pathlib import Path

    from distributed import LocalCluster

pytestmark = pytest.mark.dask


@pytest.fixture(scope="module")
def tree(demo_tree: Path) -> Tree:
    return Tree(demo_tree)


def scheduler_of(cluster: LocalCluster) -> Any:
    """The scheduler, which is a thread of this process: what it holds can be looked at."""
    return cluster.scheduler


def pids_in(folder: Path) -> list[int]:
    return [int(path.name.partition("-")[2]) for path in folder.glob("in-*")]


# --- workers that die -------------------------------------------------------------------------------------------------


class Holding(Executor):
    """Another executor, which holds one unit where it runs until the file ``go`` is there."""

    def __init__(self, executor: Executor, folder: Path, number: int) -> None:
        self._executor, self._folder, self._left = executor, folder, number

    def submit(self, call: Any, /) -> Future[Any]:  # type: ignore[override] # all that is used
        self._left -= 1
        return self._executor.submit(partial(work.held, self._folder, call) if self._left == 0 else call)


def test_a_worker_killed_in_the_middle_changes_nothing(tree: Tree, dask: Executor, tmp_path: Path) -> None:
    """The process is killed while it works on the fourth file: the unit cannot have ended, nor not have begun."""
    alone = verify(tree.manifest, tree.root, level="full")
    reports: list[Any] = []

    def run() -> None:
        reports.append(verify(tree.manifest, tree.root, level="full", workers=Holding(dask, tmp_path, 4)))

    running = threading.Thread(target=run)
    running.start()
    until(lambda: len(pids_in(tmp_path)) == 1)
    (killed,) = pids_in(tmp_path)
    os.kill(killed, signal.SIGKILL)
    until(lambda: len(pids_in(tmp_path)) == 2)  # the unit was begun again, by another process
    (tmp_path / "go").touch()
    running.join(PATIENCE_S)
    assert reports == [alone]
    assert alone.ok
    assert alone.datasets[0].files_checked == 32


def test_a_unit_that_ends_every_worker_is_named_and_the_rest_is_done(
    dask: Executor, cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask gives a unit up that lost some workers, and with it the innocent ones that lay on the same workers."""
    monkeypatch.setattr(scheduler_of(cluster), "allowed_failures", 0)  # default 3; each costs the start of a process
    tasks = [work.Task(number, f"{number}.dng") for number in range(20)]
    found = list(Workers(executor=dask).attempt(work.end_the_process, tasks))
    assert [one for one in found if not isinstance(one, Failed)] == [number for number in range(20) if number != 3]
    assert isinstance(found[3], Failed)
    assert found[3].reason.startswith("3.dng: worker processes died at it again and again")


# --- the command line -------------------------------------------------------------------------------------------------


@pytest.fixture
def address(cluster: LocalCluster, dask: Executor) -> str:
    return str(cluster.scheduler_address)


def test_a_command_on_a_cluster_prints_what_it_prints_alone(
    tree: Tree, address: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With paths that start from this process's folder, which is not that of the workers."""
    monkeypatch.chdir(tree.folder)
    monkeypatch.setattr("os.environ", os.environ | {"COLUMNS": "80"})
    command = ["verify", "manifests/eld-demo.csv", "--root", "data", "--level", "full"]
    outputs = []
    for workers in (["--jobs", "1"], ["--dask", address]):
        assert main([*command, *workers]) == 0
        outputs.append(capsys.readouterr())
    assert outputs[0].out
    assert outputs[1] == outputs[0]


def failing(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that cannot work; return its one line."""
    assert main(list(arguments)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


VERIFY = ("verify", "manifests/eld.csv", "--dask")


def test_no_scheduler_there(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "_DASK_S", 1)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        line = failing(capsys, *VERIFY, address)
    assert line.startswith(f"eldata verify: no Dask scheduler answers at {address} (")
    assert line.endswith("; is it running, and can this machine reach its port?\n")


def test_without_the_extra(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert failing(capsys, *VERIFY, "tcp://127.0.0.1:1") == (
        "eldata verify: --dask needs Dask's distributed: pip install 'eldata[dask]'\n"
    )
