"""A Dask cluster's executor for the command line, and what must be true of a cluster that units run on."""

from __future__ import annotations

import asyncio
import logging
import pkgutil
import warnings
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata import __version__
from eldata.base.fields import TextFile
from eldata.errors import EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from concurrent.futures import Executor

    from distributed import Client

_TIMEOUT_S = 10

# Without the same Python and Dask the machines do not understand each other; the others may change the last bit.
_OF_EVERY_MACHINE = ("python", "dask", "distributed", "cloudpickle")
_OF_WORKERS = (*_OF_EVERY_MACHINE, "numpy", "scipy", "numba", "rawpy", "imagecodecs")


class ClusterError(EldataError):
    """A cluster cannot be reached, or cannot run this package's work."""


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Yield the executor of a running Dask cluster, which goes on running afterwards.

    For command lines: what Dask logs is silenced meanwhile. In a notebook, make a ``distributed.Client`` and
    pass ``client.get_executor()``.

    Parameters
    ----------
    address
        The scheduler's, such as ``tcp://host:8786`` or ``tls://host:8786``, or the path of its scheduler file.

    Raises
    ------
    ClusterError
        If Dask is not installed, no scheduler answers within ten seconds, or it has no worker; and like
        :func:`check_cluster`.
    """
    try:
        import distributed  # noqa: F401 # is it installed?
    except ImportError as error:
        raise ClusterError(
            "--dask needs Dask's distributed, which is not installed: pip install 'eldata[dask]'"
        ) from error
    # Dask reports a lost connection in tracebacks, we in one line.
    with _quiet(logging.CRITICAL + 1, "distributed", "distributed.client"):
        client = _connected(_scheduler(address))
        try:
            check_cluster(client)
            yield client.get_executor()  # type: ignore[no-untyped-call]
        finally:
            client.close(timeout=_TIMEOUT_S)  # type: ignore[no-untyped-call] # takes back what it asked for


@contextmanager
def _quiet(level: int, *loggers: str) -> Iterator[None]:
    """Keep what loggers of libraries report below a level from stderr."""
    handlers = [handler for name in loggers for handler in logging.getLogger(name).handlers]
    before = [handler.level for handler in handlers]
    for handler in handlers:
        handler.setLevel(max(level, handler.level))
    try:
        yield
    finally:
        for handler, its_level in zip(handlers, before, strict=True):
            handler.setLevel(its_level)


def _connected(scheduler: str) -> Client:
    """Return the client of a scheduler that has workers."""
    from distributed import Client

    try:
        asyncio.run(_reach(scheduler))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of versions, which check_cluster compares
            client = Client(scheduler, timeout=_TIMEOUT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, ImportError) as error:
        raise ClusterError(
            f"no Dask scheduler answers at {scheduler} ({error}); is it running, and can this machine reach its port?"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_TIMEOUT_S)
    except BaseException as error:
        client.close(timeout=_TIMEOUT_S)  # type: ignore[no-untyped-call]
        if not isinstance(error, TimeoutError):
            raise
        raise ClusterError(
            f"the Dask scheduler at {scheduler} has no worker; start some with dask worker {scheduler}"
        ) from error
    return client


async def _reach(scheduler: str) -> None:
    """Connect once. A client that cannot is never closed, and can block the next one's start when it is collected."""
    from distributed.comm.core import connect
    from distributed.security import Security

    arguments = Security().get_connection_args("client")  # type: ignore[no-untyped-call]
    comm = await connect(scheduler, timeout=_TIMEOUT_S, **arguments)  # type: ignore[no-untyped-call]
    await comm.close()


def check_cluster(client: Client) -> None:
    """Check that a cluster can run this package's work, with the results that this machine would give.

    A worker that cannot import the package would take units and never answer.

    Raises
    ------
    ClusterError
        If the scheduler or a worker cannot import eldata, or has another version of it or of a package that it uses.
    """
    try:
        found: dict[str, Any] = client.run(pkgutil.resolve_name, "eldata:__version__", on_error="return")
        found["the scheduler"] = _on_scheduler(client)
        versions: Any = client.get_versions(packages=[name for name in _OF_WORKERS if name != "python"])
    except OSError as error:
        raise ClusterError(f"the connection to the Dask cluster was lost: {error}") from error
    for place, version in found.items():
        if isinstance(version, BaseException):
            raise ClusterError(
                f"Dask cluster: {_named(place)} cannot import eldata ({type(version).__name__}: {version}); install "
                f"eldata {__version__} there"
            )
        if version != __version__:
            raise ClusterError(
                f"Dask cluster: {_named(place)} has eldata {version}, this machine {__version__}; install the same"
            )
    here = versions["client"]["packages"]
    _compare("the scheduler", versions["scheduler"]["packages"], here, _OF_EVERY_MACHINE)
    for place, there in versions["workers"].items():
        _compare(place, there["packages"], here, _OF_WORKERS)


def _on_scheduler(client: Client) -> Any:
    """Return the package's version on the scheduler, or why it has none; the scheduler unpickles what it passes on."""
    try:
        return client.run_on_scheduler(pkgutil.resolve_name, "eldata:__version__")  # type: ignore[no-untyped-call]
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 # whatever the import raised there
        return error


def _compare(
    place: str, there: Mapping[str, str | None], here: Mapping[str, str | None], names: tuple[str, ...]
) -> None:
    for name in names:
        wanted, found = (_version(name, versions.get(name)) for versions in (here, there))
        if wanted != found:
            raise ClusterError(
                f"Dask cluster: {_named(place)} has {name} {found}, this machine {wanted}; install the same on every "
                "machine"
            )


def _version(name: str, version: str | None) -> str:
    if name == "python" and version is not None:
        return ".".join(version.split(".")[:2])  # what pickles depend on
    return version or "not installed"


def _named(place: str) -> str:
    return place if place.startswith("the ") else f"the worker at {place}"


def _scheduler(address: str) -> str:
    """Return a scheduler's address, read from a scheduler file if that is given."""
    if "://" in address or not (address.endswith(".json") or Path(address).exists()):
        return address
    advice = "expected a scheduler file with an address, as dask scheduler --scheduler-file writes it"
    return TextFile(address, ClusterError, advice).json().text("address")
