"""A real Dask cluster: workers that are killed, commands with --dask, and clusters that cannot be used."""

from __future__ import annotations

import json
import logging
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import Executor
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from eldata.base import clusters
from eldata.base.clusters import ClusterError, dask_executor
from eldata.base.workers import Failed, Workers
from eldata.cli.main import main
from eldata.manifest.verify import verify
from tests.base.clusters import work
from tests.evaluation.helpers import Tree
from tests.waiting import PATIENCE_S, until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Future
    from pathlib import Path

    from distributed import Client, LocalCluster

pytestmark = pytest.mark.dask


@pytest.fixture(scope="module")
def tree(demo_tree: Path) -> Tree:
    return Tree(demo_tree)


def scheduler_of(cluster: LocalCluster) -> Any:
    """The scheduler, which is a thread of this process: what it holds can be looked at."""
    return cluster.scheduler


def tasks_on(cluster: LocalCluster) -> set[str]:
    return set(map(str, list(scheduler_of(cluster).tasks)))


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
    assert found[3].reason.startswith("3.dng: the workers that ran it died again and again")


# --- the command line -------------------------------------------------------------------------------------------------


@pytest.fixture
def address(cluster: LocalCluster, dask: Executor) -> str:
    return str(cluster.scheduler_address)


def test_a_command_on_a_cluster_prints_what_it_prints_alone(
    tree: Tree,
    address: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With paths that start from this process's folder, which is not that of the workers."""
    monkeypatch.chdir(tree.folder)
    monkeypatch.setattr("os.environ", os.environ | {"COLUMNS": "80"})
    scheduler_file = tmp_path / "scheduler.json"
    scheduler_file.write_text(json.dumps({"address": address}), encoding="utf-8")
    command = ["verify", "manifests/eld-demo.csv", "--root", "data", "--level", "full"]
    outputs = []
    for workers in (["--jobs", "1"], ["--dask", address], ["--dask", str(scheduler_file)]):
        assert main([*command, *workers]) == 0
        outputs.append(capsys.readouterr())
    assert outputs[0].out
    assert outputs[1:] == [outputs[0]] * 2


def test_the_cluster_runs_on_and_holds_nothing(tree: Tree, address: str, cluster: LocalCluster) -> None:
    def log_levels() -> list[int]:
        return [handler.level for handler in logging.getLogger("distributed").handlers]

    before, levels = tasks_on(cluster), log_levels()
    assert main(["verify", str(tree.manifest), "--root", str(tree.root), "--level", "full", "--dask", address]) == 0
    until(lambda: tasks_on(cluster) <= before)
    assert len(scheduler_of(cluster).workers) == 2
    assert log_levels() == levels


@pytest.mark.parametrize("debug", [False, True])
def test_ctrl_c_takes_the_work_back(
    debug: bool, tree: Tree, address: str, cluster: LocalCluster, dask: Executor, tmp_path: Path
) -> None:
    """Both workers are held by tasks of another user, so that those of the command certainly wait."""
    others = [dask.submit(partial(work.held, tmp_path, partial(work.double, number))) for number in (1, 2)]
    until(lambda: len(pids_in(tmp_path)) == 2)
    before = tasks_on(cluster)
    command = ["verify", tree.manifest, "--root", tree.root, "--level", "full", "--dask", address]
    with subprocess.Popen(
        [sys.executable, "-m", "eldata.cli.main", *map(str, command), *(["--debug"] if debug else [])],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            until(lambda: process.poll() is not None or len(tasks_on(cluster) - before) == 9)
            os.killpg(process.pid, signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE_S)
        finally:
            if process.poll() is None:
                process.kill()
    assert process.returncode == 130, err
    assert out == ""
    if debug:
        assert "Stopped" in err
    else:
        assert err == "eldata verify: interrupted; files are written whole or not at all, so none is left half\n"
    until(lambda: tasks_on(cluster) <= before)
    (tmp_path / "go").touch()
    assert [other.result(60) for other in others] == [2, 4], "the other user's tasks are well"
    del others
    until(lambda: not any(worker.processing for worker in list(scheduler_of(cluster).workers.values())))


def failing(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that cannot work; return its one line."""
    assert main(list(arguments)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


VERIFY = ("verify", "manifests/eld.csv", "--dask")


def test_no_scheduler_there(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "_TIMEOUT_S", 1)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        line = failing(capsys, *VERIFY, address)
    assert line.startswith(f"eldata verify: no Dask scheduler answers at {address} (")
    assert line.endswith("; is it running, and can this machine reach its port?\n")


@pytest.mark.parametrize("address", ["nowhere", "gopher://host:70", "tcp://", "tcp://127.0.0.1:port"])
def test_no_address(address: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "_TIMEOUT_S", 1)
    assert f"no Dask scheduler answers at {address} (" in failing(capsys, *VERIFY, address)


def test_no_address_again_and_again(capsys: pytest.CaptureFixture[str]) -> None:
    """A client that failed to start blocked the next one for ten seconds when it was collected: one time in eight."""
    for _ in range(20):
        assert "no Dask scheduler answers at tcp:// (" in failing(capsys, *VERIFY, "tcp://")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ": cannot be read: No such file or directory; "),
        ("{}", ", field address: expected a text, found nothing; "),
        ("tcp://127.0.0.1:8786", ": is not JSON"),
        ("[1]", ": expected an object, found [1]; "),
    ],
)
def test_no_scheduler_file(content: str | None, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scheduler.json"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    said = failing(capsys, *VERIFY, str(path))
    assert f"{path}{words}" in said
    assert "expected a scheduler file with an address, as dask scheduler --scheduler-file writes it" in said


def test_without_the_extra(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert failing(capsys, *VERIFY, "tcp://127.0.0.1:1") == (
        "eldata verify: --dask needs Dask's distributed, which is not installed: pip install 'eldata[dask]'\n"
    )


@pytest.mark.parametrize("command", ["verify", "lock", "calibrate", "synthesize", "pack"])
def test_jobs_or_a_cluster(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    given = {"verify": ["m"], "lock": ["m"], "calibrate": ["f"], "synthesize": ["c", "-o", "o", "--camera", "C"]}
    line = failing(capsys, command, *given.get(command, ["d", "-o", "s.h5"]), "--jobs", "2", "--dask", "tcp://a:1")
    assert "not allowed with argument --jobs" in line


# --- clusters that cannot be used -------------------------------------------------------------------------------------


@pytest.fixture
def empty() -> Iterator[LocalCluster]:
    """A scheduler without workers."""
    from distributed import LocalCluster

    with LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=0, dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL
    ) as made:
        yield made


def test_a_cluster_without_workers(
    empty: LocalCluster, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clusters, "_TIMEOUT_S", 1)
    address = empty.scheduler_address
    assert failing(capsys, *VERIFY, address) == (
        f"eldata verify: the Dask scheduler at {address} has no worker; start some with dask worker {address}\n"
    )


def test_a_worker_without_the_package(empty: LocalCluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It would take units and never answer."""
    (tmp_path / "eldata").mkdir()
    (tmp_path / "eldata" / "__init__.py").write_text("raise ModuleNotFoundError('No module named eldata')")
    address = str(empty.scheduler_address)
    with subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny", "--no-dashboard"],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        stderr=subprocess.DEVNULL,
    ) as worker:
        try:
            line = failing(capsys, *VERIFY, address)
            from distributed import Client

            with Client(empty, set_as_default=False) as client:  # type: ignore[no-untyped-call]
                executor = client.get_executor()
                with pytest.raises(ClusterError, match=r"cannot import eldata"):
                    list(Workers(executor=executor).run(work.double, [1]))
        finally:
            worker.terminate()
    assert line.startswith("eldata verify: Dask cluster: the worker at tcp://127.0.0.1:")
    assert "cannot import eldata (ModuleNotFoundError: No module named eldata); install eldata" in line


def test_another_version_of_the_package(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "__version__", "9.9")
    with pytest.raises(ClusterError) as raised, dask_executor(address):
        pytest.fail("it was lent")
    assert re.search(r"the worker at \S+ has eldata \S+, this machine 9\.9; install the same", str(raised.value))


@pytest.mark.parametrize(
    ("place", "package", "found"),
    [("worker", "numpy", "1.26.4"), ("worker", "rawpy", None), ("scheduler", "distributed", "2024.1.0")],
)
def test_other_versions_of_what_it_computes_with(
    place: str, package: str, found: str | None, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions: Any = client.get_versions(packages=["rawpy", "scipy", "numba", "imagecodecs"])
    there = versions["scheduler"] if place == "scheduler" else next(iter(versions["workers"].values()))
    wanted = versions["client"]["packages"][package]
    there["packages"][package] = found
    monkeypatch.setattr(client, "get_versions", lambda **_: versions)
    with pytest.raises(ClusterError) as raised:
        clusters.check_cluster(client)
    assert f"has {package} {found or 'not installed'}, this machine {wanted}; install the same" in str(raised.value)
    assert place in str(raised.value)


def test_a_patch_release_of_python_makes_no_difference(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    versions: Any = client.get_versions(packages=["rawpy", "scipy", "numba", "imagecodecs"])
    major, minor = sys.version_info[:2]
    for worker in versions["workers"].values():
        worker["packages"]["python"] = f"{major}.{minor}.99.final.0"
    monkeypatch.setattr(client, "get_versions", lambda **_: versions)
    clusters.check_cluster(client)
    versions["scheduler"]["packages"]["python"] = f"{major}.{minor + 1}.0.final.0"
    with pytest.raises(ClusterError, match=rf"the scheduler has python {major}\.{minor + 1}, this machine"):
        clusters.check_cluster(client)
