"""How long tests wait for processes and threads: until something is so, never for a time that a machine must keep.

A wait ends as soon as its condition holds, so patience costs nothing where all is well. It is long because a machine
may be busy with something else: at a load of fifteen the start of one interpreter has taken a minute.
"""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE_S = 300.0
"""What a test gives a process or a condition before it fails; shorter than pytest's own limit in pyproject.toml."""


def until(condition: Callable[[], object], what: str = "what is waited for") -> None:
    """Return once ``condition`` is true; raise TimeoutError if it does not come to be."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            msg = f"{what} did not happen within {PATIENCE_S:g} s"
            raise TimeoutError(msg)
        time.sleep(0.01)
