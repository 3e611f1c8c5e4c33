"""Several folders of predictions, one of each method: scored in one pass, held against each other, written beside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import folder_problem, path_problem, remove_leftovers, write_json, write_problem
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.comparison import Method, compare
from eldata.evaluation.evaluate import perform_each
from eldata.evaluation.request import make_request

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from eldata.base.workers import AnyWorkers
    from eldata.evaluation.comparison import Comparison
    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.tasks import Task, TaskFunction
    from eldata.protocols.protocol import Protocol

COMPARISON = "comparison"
"""What the files of the comparison are called, so that no method is."""


def evaluate_methods(
    predictions: Mapping[str, Path | str] | Iterable[Path | str], dataset: str = "eld", *,
    protocol: str | Path | Protocol | None = None,
    root: Path | str | None = None, manifest: Path | str | None = None, cameras: Collection[str] | None = None,
    subset: str | None = None, ids: Collection[str] | None = None, exclude_flags: Collection[str] = (),
    allow_missing: bool = False, strict: bool = False,
    task: Task | TaskFunction | str | None = None, dark_shading: Path | str | None = None, workers: AnyWorkers = 1,
) -> dict[str, EvaluationResult]:  # fmt: skip
    """Score several folders of predictions in one pass over the dataset: each raw file is decoded once for all.

    Parameters
    ----------
    predictions
        The folder of each method by its name; or folders, whose own names are the methods'.
    dataset, protocol, root, manifest, cameras, subset, ids, exclude_flags, allow_missing, strict, task, \
    dark_shading, workers
        As for :func:`eldata.evaluate`.

    Returns
    -------
    dict
        The result of each, by name, in their order: what :func:`eldata.evaluate` gives of its folder alone. What is
        wrong with the predictions of one is a problem of its own result, and costs the others nothing.
        :func:`eldata.evaluation.compare` holds them against each other.

    Raises
    ------
    ArgumentError
        If two have one name, or a name cannot be that of a file.
    EldataError, DatasetError, ManifestError
        Like :func:`eldata.evaluate`.

    Examples
    --------
    >>> from eldata.baselines import BaselineDenoiser, write_predictions
    >>> from eldata.evaluation import evaluate_methods
    >>> demo = {"manifest": "eldata-demo/manifests/eld-demo.csv", "root": "eldata-demo/data"}
    >>> for name in ("input", "dct"):
    ...     report = write_predictions(BaselineDenoiser(name), "", f"preds/{name}", **demo)
    >>> results = evaluate_methods(["preds/input", "preds/dct"], **demo)
    >>> {name: round(float(result.frame["psnr_db"].mean()), 2) for name, result in results.items()}
    {'input': 29.02, 'dct': 39.03}
    """
    if isinstance(predictions, Mapping):
        folders = named_folders([Path(folder) for folder in predictions.values()], list(predictions))
    else:
        folders = named_folders([Path(folder) for folder in predictions])
    requests = [
        make_request(
            folder, dataset, protocol, root=root, manifest=manifest,
            cameras=cameras, subset=subset, ids=ids, exclude_flags=exclude_flags, allow_missing=allow_missing,
            strict=strict, task=task, dark_shading=dark_shading, workers=workers,
        )
        for folder in folders.values()
    ]  # fmt: skip
    return dict(zip(folders, perform_each(requests), strict=True))


def named_folders(folders: Sequence[Path], names: Sequence[str] = ()) -> dict[str, Path]:
    """Return folders by the names of their methods, by default their own.

    Raises
    ------
    ArgumentError
        If there is none, two have one name, a name cannot be that of a file, or there are not as many names as folders.
    EldataError
        If a folder is not there.
    """
    if not folders:
        raise ArgumentError("expected one folder of predictions or more, found none")
    if names and len(names) != len(folders):
        raise ArgumentError(
            f"expected one name (--name) per folder, or none; found {len(names)} for {len(folders)} folders"
        )
    found: dict[str, Path] = {}
    taken: dict[str, Path] = {COMPARISON: Path()}
    for folder, name in zip(folders, names or [folder.resolve().name for folder in folders], strict=True):
        problem = folder_problem(folder)
        if problem is not None:
            raise EldataError(f"{folder}: {problem}")
        if not name or "/" in name or name.startswith(".") or path_problem(name) is not None:
            raise ArgumentError(f"{folder}: {name!r} cannot be the name of a file; give it another with --name")
        other = taken.setdefault(name.casefold(), folder)
        if name.casefold() == COMPARISON:
            raise ArgumentError(f"{folder}: {name!r} is what the comparison is called; give it another with --name")
        if name in found or other != folder:
            raise ArgumentError(
                f"{other} and {folder} would both be called {name!r}; give each a --name, in the order of the folders"
            )
        found[name] = folder
    return found


@dataclass(frozen=True, slots=True)
class ScoredMethods:
    """The results of several folders, by the names of the methods.

    ``comparison``: of those that have scores, with the first of them; ``None`` where there is none to be made, and
    ``why_not``.
    """

    results: Mapping[str, EvaluationResult]
    comparison: Comparison | None
    why_not: str = ""

    @classmethod
    def of(cls, results: Mapping[str, EvaluationResult]) -> ScoredMethods:
        """Return results with their comparison."""
        scored = {name: of for name, of in results.items() if of.scored}
        if len(results) < 2:
            return cls(results, None)
        if len(scored) < 2:
            who = f"{', '.join(scored)} alone has" if scored else "no method has"
            return cls(results, None, f"there is nothing to compare: {who} scores")
        try:
            return cls(results, compare([Method(name, result) for name, result in scored.items()]))
        except EldataError as error:
            return cls(results, None, str(error))

    @property
    def all_well(self) -> bool:
        """Whether every method was scored without a problem."""
        return all(of.scored and not of.problems for of in self.results.values())

    def write(self, folder: Path) -> None:
        """Write NAME.json and NAME.csv of each method, and comparison.json; each whole or not at all."""
        remove_leftovers(folder)
        for name, result in self.results.items():
            result.write_json(folder / f"{name}.json")
            result.write_csv(folder / f"{name}.csv")
        if self.comparison is not None:
            write_json(folder / f"{COMPARISON}.json", self.comparison.as_dict())


def results_folder(folder: Path, names: Iterable[str]) -> None:
    """Make the folder of results, before there are any.

    Raises
    ------
    ArgumentError
        If it cannot be made, or a file cannot be written in it.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise ArgumentError(f"cannot write {folder}: {error.strerror}; give a folder, in one that is there") from error
    for name in (
        *(f"{name}{suffix}" for name in names for suffix in (".json", ".csv")),
        f"{COMPARISON}.json",
        f"{COMPARISON}.html",
    ):
        problem = write_problem(folder / name)
        if problem is not None:
            raise ArgumentError(f"cannot write {folder / name}: {problem}")
