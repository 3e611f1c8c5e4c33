"""Several folders of predictions, one for each method: scored in one pass, compared, and written."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import folder_problem, path_problem, remove_leftovers, write_json, write_problem
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.comparison import compare
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
"""The name of the comparison's files, which no method may have."""


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
    names = list(predictions) if isinstance(predictions, Mapping) else []
    folders = named_folders(
        [Path(folder) for folder in (predictions.values() if isinstance(predictions, Mapping) else predictions)], names
    )
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
    named: dict[str, Path] = {}
    for folder, name in zip(folders, names or [folder.resolve().name for folder in folders], strict=True):
        problem = folder_problem(folder)
        if problem is not None:
            raise EldataError(f"{folder}: {problem}")
        if not name or "/" in name or name.startswith(".") or path_problem(name) is not None:
            raise ArgumentError(f"{folder}: {name!r} cannot be the name of a file; give it another with --name")
        if name.casefold() == COMPARISON:
            raise ArgumentError(f"{folder}: {name!r} is what the comparison is called; give it another with --name")
        for other, taken in named.items():
            if other.casefold() == name.casefold():
                raise ArgumentError(
                    f"{taken} and {folder} would both be called {name!r}; give each a --name, in the order of the "
                    "folders"
                )
        named[name] = folder
    return named


def compare_scored(results: Mapping[str, EvaluationResult]) -> tuple[Comparison | None, str]:
    """Compare the methods that have scores with the first of them; of several, say why where it cannot be done."""
    scored = {name: result for name, result in results.items() if result.scored}
    if len(results) < 2:
        return None, ""
    if len(scored) < 2:
        who = f"{next(iter(scored))} alone has" if scored else "no method has"
        return None, f"there is nothing to compare: {who} scores"
    try:
        return compare(scored), ""
    except EldataError as error:
        return None, str(error)


def make_results_folder(folder: Path, names: Iterable[str]) -> None:
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
    for name in (*(f"{name}.json" for name in names), f"{COMPARISON}.json"):
        problem = write_problem(folder / name)
        if problem is not None:
            raise ArgumentError(f"cannot write {folder / name}: {problem}")


def write_results(folder: Path, results: Mapping[str, EvaluationResult], comparison: Comparison | None) -> None:
    """Write NAME.json and NAME.csv of each method, and comparison.json; each whole or not at all."""
    remove_leftovers(folder)
    for name, result in results.items():
        result.write_json(folder / f"{name}.json")
        result.write_csv(folder / f"{name}.csv")
    if comparison is not None:
        write_json(folder / f"{COMPARISON}.json", comparison.as_dict())
