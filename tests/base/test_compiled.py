"""Kernels without a place to keep them: a package and a HOME that cannot be written, as in containers and services."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from eldata.base import compiled

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="users are looked up as Linux does")


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
    exec(compile("def add(a, b): return a + b\ndef less(a, b): return a - b", file, "exec"), names)  # noqa: S102
    assert (compiled.kernel(names["add"])(2, 1), compiled.kernel(names["less"])(2, 1)) == (3, 1)
    (said,) = caplog.messages
    assert "NUMBA_CACHE_DIR" in said
