"""Matrices of quick cases in one test each."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any

Test = Callable[..., None]


def in_one_test(names: str, cases: Iterable[Any]) -> Callable[[Test], Test]:
    """Decorate as ``pytest.mark.parametrize`` does, but loop over the cases in one test, which names the failing one.

    For many quick cases that share their fixtures: pytest takes some milliseconds to collect, run and report a test,
    and every worker process collects them all. Fixtures, such as ``tmp_path``, are the same for all cases.
    """
    keys = names.replace(" ", "").split(",")
    listed = [case if len(keys) > 1 else (case,) for case in cases]

    def decorate(test: Test) -> Test:
        @functools.wraps(test)
        def looped(*args: Any, **fixtures: Any) -> None:
            for case in listed:
                given = dict(zip(keys, case, strict=True))
                try:
                    test(*args, **fixtures, **given)
                except BaseException as error:
                    error.add_note("in the case " + ", ".join(f"{key}={value!r}" for key, value in given.items()))
                    raise

        signature = inspect.signature(test)
        rest = [parameter for name, parameter in signature.parameters.items() if name not in keys]
        looped.__signature__ = signature.replace(parameters=rest)  # type: ignore[attr-defined] # what pytest asks for
        return looped

    return decorate
