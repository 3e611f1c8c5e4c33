"""Kernels without a place to keep them: a package and a HOME that cannot be written, as in containers and services."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from eldata.base import compiled

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="users are looked up as Linux does")

COUNT = """
import json, numpy as np
from eldata.metrics import _kernels as k
image = np.zeros((9, 9), np.float32)
print(flush=True), input()
k.squared_error(image, image), k.products(image, image, 0.0, 1.0)
stats = k.squared_error.stats, k.products.stats
print(json.dumps([sum(sum(counts[index].values()) for counts in stats) for index in (1, 2)]))
"""


@pytest.mark.parametrize(("file", "home"), [("<nowhere>", True), pytest.param(__file__, False, marks=LINUX)])
def test_a_kernel_that_cannot_be_kept_is_compiled(
    file: str, home: bool, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As numba finds no folder for code of no file, and would make one named ``~`` without a HOME; it is said once."""
    monkeypatch.setenv(compiled._REPORTED, "")
    monkeypatch.delenv(compiled._REPORTED)
    if not home:
        monkeypatch.delenv("HOME")
        monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
        monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    names: dict[str, Any] = {"__name__": __name__}
    exec(compile("def add(a, b): return a + b\ndef subtract(a, b): return a - b", file, "exec"), names)  # noqa: S102
    assert (compiled.kernel(names["add"])(2, 1), compiled.kernel(names["subtract"])(2, 1)) == (3, 1)
    (said,) = caplog.messages
    assert "NUMBA_CACHE_DIR" in said


def test_of_processes_that_begin_together_one_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two kernels, three processes, and an empty cache: compiled twice, loaded four times."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    command = [sys.executable, "-c", COUNT]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    processes: list[Any] = [subprocess.Popen(command, **pipes) for _ in range(3)]
    for process in processes:
        process.stdout.readline()  # it has imported what it needs
    for process in processes:
        process.stdin.write(b"\n")
        process.stdin.flush()
    counts = [json.loads(process.communicate()[0]) for process in processes]
    hits, misses = map(sum, zip(*counts, strict=True))
    assert (hits, misses) == (4, 2)


def test_python_that_calls_a_helper_runs_it_as_it_stands() -> None:
    """It has no entry for Python, before and after a kernel is compiled with it."""
    half: Any = compiled.helper(lambda x: x / 2)
    kernel = compiled._compiler()(lambda x: half(x) + 1)
    assert (half(3.0), kernel(3.0), half(3.0)) == (1.5, 2.5, 1.5)
