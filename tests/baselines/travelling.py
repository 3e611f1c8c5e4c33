"""Work as another process gets it, without one."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any


class Travelling(Executor):
    """Runs each call at once, as it arrives by pickling."""

    def submit(self, call: Callable[[], Any], /) -> Future[Any]:  # type: ignore[override] # all that is used
        future: Future[Any] = Future()
        future.set_result(pickle.loads(pickle.dumps(call))())
        return future
