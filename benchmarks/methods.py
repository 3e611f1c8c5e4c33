"""Several folders of predictions: one evaluation of each, one pass over all of them, and from a packed store."""

from __future__ import annotations

import shutil
import time
from typing import TYPE_CHECKING

from benchmarks.harness import Row, in_turn
from eldata import evaluate
from eldata.evaluation import evaluate_methods
from eldata.sources.store import build_store, source_of_dataset

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from benchmarks.data import Files
    from eldata.evaluation import EvaluationResult

_FOLDERS = 3


def run(files: Files, rounds: int, _cores: int) -> list[Row]:
    folders = _folders(files.predictions)
    store = files.predictions.with_name("methods.h5")
    begun = time.process_time()
    if not store.exists():
        build_store(source_of_dataset("eld-demo", root=files.data, manifest=files.manifest), store)
    packing = time.process_time() - begun

    def each() -> list[EvaluationResult]:
        return [evaluate(folder, root=files.data, manifest=files.manifest) for folder in folders]

    def one_pass() -> list[EvaluationResult]:
        return list(evaluate_methods(folders, root=files.data, manifest=files.manifest).values())

    def stored() -> list[EvaluationResult]:
        return list(evaluate_methods(folders, root=files.data, manifest=files.manifest, store=store).values())

    def one_folder() -> EvaluationResult:
        return evaluate(folders[0], root=files.data, manifest=files.manifest)

    def one_stored() -> EvaluationResult:
        return evaluate(folders[0], root=files.data, manifest=files.manifest, store=store)

    count = len(one_folder().images)
    expected = [result.scores for result in each()]
    assert [result.scores for result in one_pass()] == expected
    assert [result.scores for result in stored()] == expected
    ways: dict[str, Callable[[], object]] = {
        "one pass": one_pass,
        "one evaluation per folder": each,
        "one pass, store": stored,
        "one folder, store": one_stored,
        "one folder": one_folder,
    }
    used: dict[str, list[float]] = {name: [] for name in ways}

    def metered(name: str) -> Callable[[], None]:
        def work() -> None:
            start = time.process_time()
            ways[name]()
            used[name].append(time.process_time() - start)

        return work

    timings = in_turn(rounds, {name: metered(name) for name in ways})

    def cpu(ours: str, theirs: str) -> str:
        first, second = (min(used[name][1:]) for name in (ours, theirs))  # the first round warms up
        return f"equal to the bit; CPU {first:.2f} s against {second:.2f} s"

    case, one = f"{_FOLDERS} folders of {count} pairs, jobs=1", f"1 folder of {count} pairs, jobs=1"
    return [
        timings.faster(case, ours, theirs, values=cpu(ours, theirs))
        for case, ours, theirs in (
            (case, "one pass", "one evaluation per folder"),
            (f"{case}, store (packed in {packing:.1f} s of CPU)", "one pass, store", "one evaluation per folder"),
            (f"{one}, store", "one folder, store", "one folder"),
        )
    ]


def _folders(predictions: Path) -> list[Path]:
    """Return folders with the same predictions: what scoring takes does not depend on their values."""
    copies = [predictions.with_name(f"predictions-{number}") for number in range(1, _FOLDERS)]
    for copy in copies:
        if not copy.exists():
            shutil.copytree(predictions, copy)
    return [predictions, *copies]
