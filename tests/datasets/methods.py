"""How workers of a DataLoader are started in tests."""

from __future__ import annotations

import os

import pytest

FORK = pytest.param("fork", marks=pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here"))

# Each worker that is spawned imports torch: five seconds a test. One test, over every registered set, spawns always.
METHODS = [FORK, pytest.param("spawn", marks=pytest.mark.study)]


def workers(method: str) -> int:
    """Two that share the items, or one where each imports torch."""
    return 2 if method == "fork" else 1
