from __future__ import annotations

import logging
import multiprocessing
import sys
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from distributed import Client, LocalCluster


@pytest.fixture(scope="session")
def importable() -> Iterator[None]:
    """Let worker processes, which get this process's path, import the tests' functions."""
    root = str(Path(__file__).parents[3])
    sys.path.append(root)
    yield
    sys.path.remove(root)


@pytest.fixture(scope="session")
def cluster(importable: None) -> Iterator[LocalCluster]:
    """Two worker processes of Dask, one thread each; its scheduler is a thread of this process."""
    from distributed import LocalCluster  # a second, which only the tests that need it shall cost

    with LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    ) as made:
        yield made


@pytest.fixture(scope="session")
def client(cluster: LocalCluster) -> Iterator[Client]:
    from distributed import Client

    with Client(cluster, set_as_default=False) as made:  # type: ignore[no-untyped-call]
        yield made


@pytest.fixture
def dask(client: Client) -> Executor:
    """Dask's executor, with both workers there: a test before this one may have killed some."""
    client.wait_for_workers(2, timeout=PATIENCE_S)
    executor: Executor = client.get_executor()  # type: ignore[no-untyped-call]
    return executor


@pytest.fixture(scope="session")
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(2, thread_name_prefix="caller") as pool:
        yield pool


@pytest.fixture(scope="session")
def processes(importable: None) -> Iterator[Executor]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool


@pytest.fixture(params=["threads", "processes", pytest.param("dask", marks=pytest.mark.dask)])
def executor(request: pytest.FixtureRequest) -> Executor:
    """Each kind of executor that a caller may bring."""
    found: Executor = request.getfixturevalue(request.param)
    return found
