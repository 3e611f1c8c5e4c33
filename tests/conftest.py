"""For all tests."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import sys
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

from tests.shared import made_once
from tests.syncing import not_synced

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.capture.checklist_browser import Browser, Page
    from tests.trees import Tree

# A run that was started in the background of a shell ignores Ctrl-C, one under nohup the end of its terminal, and so
# would every process that tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# A machine may be busy: how long an example takes to make or to try says nothing.
settings.register_profile("eldata", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("eldata")

# The tests have a worker process for each CPU. What more threads of OpenMP do is to wait for one another, in loops that
# keep those CPUs busy. (Before torch, numpy and LibRaw are loaded. Tests of threads ask for them.)
os.environ["OMP_NUM_THREADS"] = "1"

os.fsync = not_synced

# Hundreds of processes import the package: what one of them has compiled, no other compiles again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# The package datasets asks the Hub for the newest of what it has, unless it is told not to before it is imported.
os.environ["HF_HUB_OFFLINE"] = "1"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tests of this folder itself, of documents and whole checkouts, take long: no worker begins one at the end."""
    items.sort(key=lambda item: len(item.path.parts))


def pytest_collection_finish() -> None:
    """What is imported and collected stays: looking for garbage, in forks too, then goes over what a test made."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def demo_tree(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The demo's tree: two cameras, one scene, sixteen frames each of 64 x 96 pixels. Not to be changed: copy it."""
    from tests.trees import build_tree

    with made_once(tmp_path_factory, "demo", build_tree) as folder:
        yield folder


@pytest.fixture(scope="session")
def pristine(demo_tree: Path) -> Tree:
    """It as a manifest and its folder, not to be changed."""
    from tests.trees import tree_in

    return tree_in(demo_tree)


@pytest.fixture
def tree(pristine: Tree, tmp_path: Path) -> Tree:
    """A copy that a test may change."""
    from tests.trees import copy_tree

    return copy_tree(pristine, tmp_path)


@pytest.fixture(scope="session")
def chromium() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        if os.environ.get("ELDATA_REQUIRE_BROWSER"):
            pytest.fail("ELDATA_REQUIRE_BROWSER is set and there is no chromium")
        pytest.skip("no chromium here; apt-get install chromium")
    return found


@pytest.fixture(scope="session")
def browser(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    from tests.capture.checklist_browser import Browser  # only POSIX systems have what it needs

    running = Browser(chromium, tmp_path_factory.mktemp("browser"))
    yield running
    running.close()


@pytest.fixture
def bare(browser: Browser, tmp_path: Path) -> Iterator[Page]:
    """An empty page on a desk. With what is opened in it nothing may go wrong."""
    from tests.capture.checklist_browser import Page

    page = Page(browser, tmp_path, 1280, 900)
    yield page
    assert page.problems() == []  # nothing from the network, no error, nothing against the policy
    page.close()


@pytest.fixture(scope="session", autouse=True)
def commands_work_in_this_process() -> Iterator[None]:
    """Unless a test asks for ``--jobs``: each would start a worker for each CPU, on CPUs that the tests keep busy."""
    from eldata.base import console

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(console, "available_cpus", lambda: 1)
        yield


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages with empty pictures: drawing them takes two seconds an ISO, and what they show tests/reports looks at."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, file, **__: file.write(b"<svg/>"))
