"""How many modules a reader passes on the way of one score, by a profile hook."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
import pytest

from eldata import evaluate
from eldata.evaluation import save_prediction, score
from tests.evaluation.own_set import build_own_set

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from types import FrameType

    from tests.evaluation.own_set import OwnSet


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    return build_own_set(tmp_path_factory.mktemp("own"), ratios=(50,))


@pytest.fixture(scope="module")
def predictions(own: OwnSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("preds")
    prediction = np.random.default_rng(0).uniform(0, 1, (4, 30, 42)).astype(np.float32)
    save_prediction(folder, "s0/x50.dng", prediction)
    return folder


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


def test_one_score_passes_few_modules(own: OwnSet, predictions: Path) -> None:
    """From files to a table, the check of the data set against its manifest among it; and a unit's part of that."""
    units_passed: list[set[str]] = []
    score_unit = score._score_unit

    def scored(*arguments: Any) -> Any:
        passed, result = modules_called(score_unit, *arguments)
        units_passed.append(passed)
        return result

    evaluate(predictions, **own.where)  # what is computed once, such as kernels
    whole, _ = modules_called(lambda: evaluate(predictions, **own.where))
    with patch.object(score, "_score_unit", scored):
        evaluate(predictions, **own.where)
    assert len(whole) <= 52, sorted(whole)
    assert max(map(len, units_passed)) <= 34
