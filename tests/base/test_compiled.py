"""Kernels without a place to keep them: a package and a HOME that cannot be written, as in containers and services."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eldata.base import compiled

if TYPE_CHECKING:
    import pytest


def test_a_kernel_that_cannot_be_kept_is_compiled(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As numba finds no folder for code of no file; it is said once."""
    monkeypatch.setenv(compiled._REPORTED, "")
    monkeypatch.delenv(compiled._REPORTED)
    names: dict[str, Any] = {}
    exec(compile("def add(a, b): return a + b\ndef less(a, b): return a - b", "<nowhere>", "exec"), names)  # noqa: S102
    assert (compiled.kernel(names["add"])(2, 1), compiled.kernel(names["less"])(2, 1)) == (3, 1)
    (said,) = caplog.messages
    assert "NUMBA_CACHE_DIR" in said
