"""How many modules a reader passes on the way of one score, by a profile hook."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any
from unittest.mock import patch

from eldata import evaluate
from eldata.evaluation import score
from tests.evaluation.own_set import OwnSet


def modules_called(work: Callable[..., Any], *arguments: Any) -> tuple[set[str], Any]:
    """Return the modules of eldata of which a function is called, and what came of the work."""
    found: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            found.add(str(frame.f_globals.get("__name__", "")))

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        result = work(*arguments)
    finally:
        sys.setprofile(before)
    return {name for name in found if name.startswith("eldata.")}, result


def test_one_score_passes_few_modules(own: OwnSet) -> None:
    """From files to a table, the check of the data set against its manifest among it; and a unit's part of that."""
    units_passed: list[set[str]] = []
    score_unit = score._score_unit

    def scored(*arguments: Any) -> Any:
        passed, result = modules_called(score_unit, *arguments)
        units_passed.append(passed)
        return result

    evaluate(own.predictions, **own.where)  # what is computed once, such as kernels
    whole, _ = modules_called(lambda: evaluate(own.predictions, **own.where))
    with patch.object(score, "_score_unit", scored):
        evaluate(own.predictions, **own.where)
    assert len(whole) <= 42, sorted(whole)
    assert max(map(len, units_passed)) <= 28
