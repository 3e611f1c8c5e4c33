"""How this package compiles its kernels, runs them in threads, and uses memory again.

Kernels release the GIL, are compiled on first use for the dtypes that they are given, helpers within them, and are kept
on disk, where there is a folder that can be written. They are all serial: parallel work is cut into fixed pieces that
run on plain threads (:func:`in_threads`). So the result does not depend on the number of threads, and numba's own
thread pool, which does not survive a fork, is never started.
"""

from __future__ import annotations

import gc
import logging
import math
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numba
import numpy as np
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import intrinsic

from eldata.base.files import hold_lock
from eldata.base.numbers import available_cpus

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

_LOG = logging.getLogger(__name__)
_REPORTED = "ELDATA_MISSING_CACHE_REPORTED"  # processes inherit it, and the next
_COMPILED_REPORTED = "ELDATA_COMPILATION_REPORTED"
_SPENT_S: list[float] = []  # by this process on what it compiled

Function = TypeVar("Function", bound="Callable[..., object]")
Piece = TypeVar("Piece")
Result = TypeVar("Result")

_njit: Any = numba.njit  # whose types lack an option
_compiler = partial(_njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)  # C code calls none


def kernel(function: Function) -> Function:
    """Compile ``function`` with exact IEEE arithmetic (no fast-math), without the GIL, cached on disk if possible.

    Where it is cached, one of several processes that need it at once compiles it, and the others wait and load it.
    """
    try:
        # Without a home, numba would make a folder called ~ where it is run.
        os.environ.get("NUMBA_CACHE_DIR") or Path.home()
        compiled = _compiler(cache=True)(function)
    except RuntimeError:  # no home, or numba found no folder to keep it in
        _report_missing_cache()
        return cast("Function", _compiler()(function))
    compiled.compile = partial(_compile_once, compiled, compiled.compile)
    return cast("Function", compiled)


def helper(function: Function) -> Function:
    """Compile ``function`` for kernels alone to call, a part of each: without the entry for Python, in less time."""
    bare = _compiler(no_cpython_wrapper=True)(function)
    bare._insert = lambda *_: None  # noqa: SLF001 # Python would call an address that there is not
    bare._compile_for_args = lambda *_, **__: function  # noqa: SLF001 # what it calls instead
    return cast("Function", bare)


def _compile_once(compiled: Any, compile_here: Callable[[Any], Any], signature: Any) -> Any:
    """Compile or load a kernel while no other process does, and say so once this one has spent a second on it."""
    if global_compiler_lock.is_locked():  # type: ignore[no-untyped-call] # within a kernel, whose folder is locked
        return compile_here(signature)
    with hold_lock(compiled.stats.cache_path):
        before, began, collects = compiled.stats.cache_misses[signature], time.perf_counter(), gc.isenabled()
        gc.disable()  # the compiler keeps what it makes: looking for garbage there takes a tenth of its time
        try:
            code = compile_here(signature)
        finally:
            if collects:
                gc.enable()
        if compiled.stats.cache_misses[signature] > before:
            _SPENT_S.append(time.perf_counter() - began)
    if sum(_SPENT_S) > 1 and os.environ.get(_COMPILED_REPORTED) is None:
        os.environ[_COMPILED_REPORTED] = "1"
        _LOG.warning("eldata compiles its kernels, which takes seconds, once for this machine and version")
    return code


def _report_missing_cache() -> None:
    """Warn that compiled code is lost: once, not again in each process that this one starts."""
    if os.environ.get(_REPORTED) is None:
        os.environ[_REPORTED] = "1"
        _LOG.warning(
            "eldata compiles its kernels again in every process, since neither its own folder nor a cache below HOME "
            "can be written; set NUMBA_CACHE_DIR to a folder that can, to keep them"
        )


def _contiguous(typing: Any, array: Any) -> Any:
    """Within a kernel: return a row as one that the compiler knows to be contiguous.

    Rows of a part of an array are, but its type does not say so, and loops over them would not become vector code. What
    calls the kernel sees to it that they are.
    """
    del typing
    known = array.copy(layout="C")

    def generate_code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del signature
        context.nrt.incref(builder, known, arguments[0])  # one more array on the same memory
        return arguments[0]

    return known(array), generate_code


contiguous = cast("Callable[[NDArray[Any]], NDArray[Any]]", intrinsic(_contiguous))


def in_threads(work: Callable[[Piece], Result], pieces: Sequence[Piece], threads: int | None = None) -> list[Result]:
    """Return ``[work(piece) for piece in pieces]``, computed by ``threads`` threads (default: one per CPU).

    The calling thread is one of them and never waits for one that has not begun, so calls may nest.
    """
    count = min(len(pieces), available_cpus() if threads is None else threads)
    if count <= 1:
        return [work(piece) for piece in pieces]
    results: list[Result | None] = [None] * len(pieces)
    waiting = iter(range(len(pieces)))  # next() on it is atomic
    held = [(work, pieces, results)]  # nothing else leads a thread to them: it holds on to what it has run for a while

    def take_pieces() -> None:
        """Compute pieces until none waits; several threads do so at once."""
        for index in waiting:
            work, pieces, results = held[0]
            results[index] = work(pieces[index])

    helpers = [_start_threads().submit(take_pieces) for _ in range(count - 1)]
    try:
        take_pieces()
    finally:
        begun = [helper for helper in helpers if not helper.cancel()]
        for _ in waiting:  # after an error the rest is dropped
            pass
        wait(begun)
        held.clear()
    for helper in begun:
        helper.result()  # raises what it raised
    return cast("list[Result]", results)


@cache
def _start_threads() -> ThreadPoolExecutor:
    """Start the threads that all calls share, one fewer than CPUs."""
    # Kept: starting threads takes longer than many pieces of work.
    return ThreadPoolExecutor(max(1, available_cpus() - 1), thread_name_prefix="eldata")


if hasattr(os, "register_at_fork"):  # a forked child has the pool but not its threads
    os.register_at_fork(after_in_child=_start_threads.cache_clear)


# --- memory -----------------------------------------------------------------------------------------------------------

_MULTIPLE_BYTES = 8  # so that it may be seen as numbers of any kind
_OF_THREAD = threading.local()


def scratch(use: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return an array in this thread's memory for a use, which the next one for that use overwrites.

    New pages cost as much as what is done in them.
    """
    size = math.prod(shape) * dtype.itemsize
    held: NDArray[np.uint8] | None = getattr(_OF_THREAD, use, None)
    if held is None or held.size < size:
        held = np.empty(size + -size % _MULTIPLE_BYTES, np.uint8)
        setattr(_OF_THREAD, use, held)
    return held[:size].view(dtype).reshape(shape)
