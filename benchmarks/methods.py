"""Several folders of predictions: one evaluation of each, and one pass over all of them."""

from __future__ import annotations

import shutil
import time
from typing import TYPE_CHECKING

from benchmarks.harness import Row, in_turn
from eldata import evaluate
from eldata.evaluation import evaluate_methods

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from benchmarks.data import Files
    from eldata.evaluation import EvaluationResult

_FOLDERS = 3


def run(files: Files, rounds: int, _cores: int) -> list[Row]:
    folders = _folders(files.predictions)

    def each() -> list[EvaluationResult]:
        return [evaluate(folder, root=files.data, manifest=files.manifest) for folder in folders]

    def one_pass() -> list[EvaluationResult]:
        return list(evaluate_methods(folders, root=files.data, manifest=files.manifest).values())

    expected = [result.scores for result in each()]
    assert [result.scores for result in one_pass()] == expected
    ways: dict[str, Callable[[], object]] = {"one pass": one_pass, "one evaluation per folder": each}
    used: dict[str, list[float]] = {name: [] for name in ways}

    def metered(name: str) -> Callable[[], None]:
        def work() -> None:
            start = time.process_time()
            ways[name]()
            used[name].append(time.process_time() - start)

        return work

    timings = in_turn(rounds, {name: metered(name) for name in ways})

    ours, theirs = (min(used[name][1:]) for name in ways)  # the first round warms up
    case = f"{_FOLDERS} folders of {len(expected[0])} pairs, jobs=1"
    values = f"equal to the bit; CPU {ours:.2f} s against {theirs:.2f} s"
    return [timings.faster(case, "one pass", "one evaluation per folder", values=values)]


def _folders(predictions: Path) -> list[Path]:
    """Return folders with the same predictions: what scoring takes does not depend on their values."""
    copies = [predictions.with_name(f"predictions-{number}") for number in range(1, _FOLDERS)]
    for copy in copies:
        if not copy.exists():
            shutil.copytree(predictions, copy)
    return [predictions, *copies]
