"""The evaluation: check the dataset, find the predictions of one method or of several, score images or clips."""

from __future__ import annotations

import platform
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata import __version__
from eldata.base.files import path_problem, remove_leftovers, write_json, write_problem
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.comparison import Comparison, compare
from eldata.evaluation.diagnosis import find_suspicions
from eldata.evaluation.predictions import FoundPredictions, find_predictions
from eldata.evaluation.request import (
    SETTINGS,
    Request,
    list_places,
    list_places_elsewhere,
    make_request,
    plan_scoring,
    require_pairs,
    stated_setting,
)
from eldata.evaluation.results import THE_INPUT, EvaluationResult, kind_of
from eldata.evaluation.score import PairOutcome, score_predictions, yield_compared
from eldata.evaluation.scores import EvaluationProblem, Pair, table_of
from eldata.evaluation.tasks import task_note
from eldata.noise.dark_shading import dark_shading_in
from eldata.protocols.protocol import CHOICES, ONE_CAMERAS_LEVELS, Protocol
from eldata.protocols.words import LEVELS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from eldata.base.workers import AnyWorkers
    from eldata.evaluation.request import Baseline, ScoringPlan
    from eldata.evaluation.tasks import Task, TaskFunction

COMPARISON = "comparison"
"""The name of the comparison's files, which no method may have."""


def evaluate(
    predictions: Path | str | None, dataset: str = "eld", *, protocol: str | Path | Protocol | None = None,
    root: Path | str | None = None, manifest: Path | str | None = None, cameras: Collection[str] | None = None,
    subset: str | None = None, ids: Collection[str] | None = None, exclude_flags: Collection[str] = (),
    allow_missing: bool = False, baseline: Baseline | None = None, strict: bool = False,
    task: Task | TaskFunction | str | None = None, dark_shading: Path | str | None = None, workers: AnyWorkers = 1,
) -> EvaluationResult:  # fmt: skip
    """Score a folder of predictions, of images or of clips, under a named protocol.

    Before anything is scored, the raw files of the pairs are checked as ``eldata verify --level metadata`` does: a
    wrong or incomplete download stops the evaluation. So is the numbering of all frames of clips. A clip is scored if
    all of its frames have a prediction.

    Parameters
    ----------
    predictions
        Folder of predictions (:mod:`eldata.evaluation.predictions`); ``None`` for a baseline. The prediction of a
        clip's frame ``DSC00005.ARW`` is ``<clip>/DSC00005.<ext>``, whatever folders the frame lies in; that of a
        preprocessed RGB frame is (3, h, w) or a 16-bit RGB PNG, in the order R, G, B.
    dataset
        Name of a set, such as ``eld`` or, of clips, ``drv``; or a manifest.
    protocol
        Name of a protocol (:mod:`eldata.protocols`) or of a family, such as ``pmn``; the path of a TOML file; or a
        protocol. Default: the one that the dataset's card names, such as ``eld``, ``sid`` or ``drv-rgb``; if it names
        none, ``raw``, by the files' own levels.
    root
        The folder that holds the datasets. Default: ``$ELDATA_ROOT``, else ``./data``.
    manifest
        A manifest's CSV file, instead of ``dataset``: your own set, or that of a copy's raw clips
        (:func:`eldata.manifest.layouts.scan_raw`). Any protocol of images may score your own set, on the set's own
        pairs: those at the protocol's factors if it has every one of them, else all. Default: the shipped one.
    cameras
        Score the pairs of these cameras only; the result says so. Default: those of the protocol.
    subset
        Name of a subset on the dataset's card (:mod:`eldata.manifest.card`). Default: the protocol's, else the first
        on the card, if any.
    ids
        Score these clips instead of a subset; the result says so. Default: the subset's. Images have none.
    exclude_flags
        Leave out pairs or clips that the manifest flags so, such as ``["misaligned"]``; the result says how many.
        Default: none.
    allow_missing
        Whether to score the rest if predictions or raw files are missing or unusable; the table shows the coverage,
        ``problems`` name them. Default: False.
    baseline
        ``"input"``, instead of ``predictions``: score the noisy input itself, amplified and clipped as the protocol
        has it. Default: None.
    strict
        Whether predictions that show a mistake (:mod:`eldata.evaluation.diagnosis`) are a problem: then nothing has a
        score. Default: False, the result's ``suspicions`` name it.
    task
        A function of (prediction, reference), (C, h, w) float32 as the protocol compares them, whose value is scored
        too, of clips frame by frame; or a :class:`~eldata.evaluation.Task`, which says which images it wants and
        whether lower is better; or the name of either, ``package.module:name``. Default: none.
    dark_shading
        The file of a dark shading (:class:`eldata.noise.DarkShading`) that the inputs are corrected with: it is taken
        off the baseline here; that predictions are of inputs less it is your statement. The protocol of the result
        states its digest. Refused for several cameras, and for another model, size, CFA or ISO. Default: none.
    workers
        Number of worker processes, or an executor that scores (:mod:`eldata.base.workers`); the files are checked from
        here. Scores do not depend on it. Default: 1.

    Returns
    -------
    EvaluationResult
        Scores, tables and provenance. If it has ``problems`` and ``allow_missing`` is false, nothing was scored.

    Raises
    ------
    EldataError
        If the folder of predictions is not there.
    DatasetError
        If the dataset is not there, or its files are not what the manifest says.
    ManifestError, ArgumentError
        If the manifest is malformed, or a name is unknown.

    Examples
    --------
    >>> from eldata import evaluate
    >>> manifest = "eldata-demo/manifests/eld-demo.csv"
    >>> result = evaluate(None, manifest=manifest, root="eldata-demo/data", baseline="input")
    >>> len(result.frame), round(float(result.frame["psnr_db"].mean()), 2)
    (12, 29.02)
    >>> result.frame.groupby("camera")["ssim"].mean().round(2).to_dict()
    {'DemoAlpha': 0.63, 'DemoBeta': 0.5}
    """
    return perform_each([make_request(**locals())])[0]  # its parameters are these


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
    options = {name: value for name, value in locals().items() if name != "predictions"}
    named = predictions if isinstance(predictions, Mapping) else {}
    folders = name_folders([Path(folder) for folder in named.values() or predictions], list(named))
    requests = [make_request(folder, **options) for folder in folders.values()]
    return dict(zip(folders, perform_each(requests), strict=True))


def scored_pairs(
    predictions: Path | str | None, dataset: str = "eld", *, protocol: str | Path | Protocol | None = None,
    root: Path | str | None = None, manifest: Path | str | None = None, cameras: Collection[str] | None = None,
    subset: str | None = None, ids: Collection[str] | None = None, exclude_flags: Collection[str] = (),
    allow_missing: bool = False, baseline: Baseline | None = None, dark_shading: Path | str | None = None,
) -> Iterator[tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]], Pair]]:  # fmt: skip
    """Yield prediction, reference and record of each pair, to measure whatever else you want.

    The images are those that :func:`evaluate` takes the score of, treated as the protocol has it: the scored region,
    the prediction clamped and multiplied by its factor, both rendered or rounded under a protocol of renderings. They
    are made one after the other, as they are asked for; the data set is checked before the first, as by
    :func:`evaluate`.

    Parameters
    ----------
    predictions, dataset, protocol, root, manifest, cameras, subset, ids, exclude_flags, baseline, dark_shading
        As for :func:`evaluate`.
    allow_missing
        Whether to leave out pairs without a prediction. Default: False.

    Yields
    ------
    prediction, reference : ndarray
        (C, h, w) each, with 1.0 the white level. Packed raw: float64, (1, H, W) where the protocol's SSIM is of the
        mosaic; references lie in [0, 1] but for values below black that the protocol keeps, predictions where it clamps
        them. Renderings: (3, h, w) in [0, 1]; of protocols that round, float32 of 256 levels, k / 255. Of a clip
        (T, C, h, w), its frames in order.
    record : PairRecord or ClipRecord
        Which pair, or window of a clip: paths, camera, scene, ISO, ratio.

    Raises
    ------
    EldataError
        If a prediction is missing, or a file cannot be used.
    EldataError, DatasetError, ManifestError, ArgumentError
        Like :func:`evaluate`.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.evaluation import scored_pairs
    >>> demo = {"manifest": "eldata-demo/manifests/eld-demo.csv", "root": "eldata-demo/data"}
    >>> prediction, reference, record = next(scored_pairs(None, baseline="input", **demo))
    >>> prediction.shape == reference.shape, record.path
    (True, 'DemoAlpha/scene-1/IMG_0004.dng')
    >>> round(float(np.abs(prediction - reference).mean()), 3)
    0.012
    """
    request = make_request(**locals())  # its parameters are these
    plan = plan_scoring(request)
    found = _find_predictions(request, plan)
    if found.problems and not (allow_missing and found.files):
        more = f" (and {len(found.problems) - 1} more: eldata evaluate lists all)" if len(found.problems) > 1 else ""
        raise EldataError(f"{found.problems[0]}{more}")
    files, _, unusable = require_pairs(request, plan.pairs)
    pairs = [pair for pair in plan.pairs if unusable.keys().isdisjoint(pair.files)]
    return yield_compared(request, files, pairs, None if predictions is None else found.files)


def perform_each(requests: Sequence[Request]) -> list[EvaluationResult]:
    """Score several requests, which differ in their predictions alone, in one pass; return a result of each.

    Raises
    ------
    EldataError, DatasetError, ManifestError, ArgumentError
        Like :func:`evaluate`; what is wrong with the predictions in one folder is a problem of its result alone.
    """
    first = requests[0]
    plan = plan_scoring(first)
    with first.workers_for(plan.pairs).sharing() as workers:  # processes are started once, for checks and scores
        first = replace(first, workers=workers)
        found = [_find_predictions(request, plan) for request in requests]
        files, white_notes, unusable = require_pairs(first, plan.pairs)
        usable = [pair for pair in plan.pairs if unusable.keys().isdisjoint(pair.files)]
        predictions = [
            None if request.predictions is None else those.files if request.allow_missing or not those.problems else {}
            for request, those in zip(requests, found, strict=True)
        ]
        outcomes = score_predictions(first, files, usable, predictions)
    lost = [EvaluationProblem(path, reason.removeprefix(f"{path}: ")) for path, reason in unusable.items()]
    found = [replace(those, problems=(*those.problems, *lost)) for those in found]
    results = map(_make_result, requests, repeat(plan), found, outcomes)
    return [replace(result, notes=(*result.notes, *white_notes)) for result in results]


def _make_result(
    request: Request, plan: ScoringPlan, found: FoundPredictions, outcomes: Sequence[PairOutcome]
) -> EvaluationResult:
    """Make the result of one request from the outcomes of its pairs."""
    suspicions = find_suspicions([outcome.inspection for outcome in outcomes if outcome.inspection is not None])
    refused = [
        EvaluationProblem(str(request.predictions), str(suspicion)) for suspicion in suspicions if request.strict
    ]
    problems = [*found.problems, *(problem for outcome in outcomes for problem in outcome.problems)]
    scores = {outcome.path: outcome.score for outcome in outcomes if outcome.score is not None}
    if refused or (problems and not request.allow_missing):
        scores = {}
    provenance = collect_provenance(request, plan, outcomes)
    scored = tuple(scores[pair.path] for pair in plan.pairs if pair.path in scores)
    kind = kind_of(request.kind, provenance)
    result = EvaluationResult(
        protocol=request.protocol,
        provenance=provenance,
        scores=scored,
        table=table_of(plan.pairs, scored, kind, request.manifest.name),
        expected=len(plan.pairs),
        missing=tuple(pair.name for pair in plan.pairs if pair.path not in scores),
        problems=(*refused, *problems),
        notes=(),
        suspicions=suspicions,
        units=plan.pairs,
    )
    notes = write_notes(request, plan, found, result, [outcome for outcome in outcomes if outcome.path in scores])
    return replace(result, notes=(*write_shading_notes(request), *notes))


def _find_predictions(request: Request, plan: ScoringPlan) -> FoundPredictions:
    """Find the prediction of each frame to score; a baseline has none."""
    if request.predictions is None:
        return FoundPredictions({}, (), 0)
    set_aside, because = plan.facts.get("set_aside"), ""
    if set_aside:
        because = f", and {request.protocol.name} scores this set's own pairs, not its {', '.join(set_aside)}"
    return find_predictions(
        request.predictions,
        [pair.place(frame) for pair in plan.pairs for frame in pair.frames],
        list_places(request),
        elsewhere=partial(list_places_elsewhere, request),
        dataset=(request.folder, [row.path for row in request.manifest.records]),
        allow_missing=request.allow_missing,
        because=because,
    )


# --- what stands beside a result's numbers ----------------------------------------------------------------------------

# A white level that is off by more than this share is said: of ELD's Sony, 16300 for 16383, it is a half percent.
_USUAL_WHITE = 0.02
# A factor beyond these hides a prediction of another scale: the score says nothing of it.
_USUAL_RESCALE = (1 / 3, 3.0)


def write_shading_notes(request: Request) -> list[str]:
    """Describe the dark shading that was subtracted from the inputs, or is stated to be."""
    if request.dark_shading is None:
        return []
    shading = dark_shading_in(request.dark_shading)
    which = f"the dark shading of {shading.camera}, {shading.digest} ({shading.source})"
    if request.predictions is None:
        return [f"the input was scored less {which}"]
    stated = stated_setting(request.predictions, "dark_shading")  # which the request was held against
    said = "stated with --dark-shading" if stated is None else f"{SETTINGS} says"
    return [f"the predictions are, as {said}, of inputs less {which}"]


def write_notes(
    request: Request, plan: ScoringPlan, found: FoundPredictions, result: EvaluationResult,
    outcomes: Sequence[PairOutcome],
) -> list[str]:  # fmt: skip
    """Write notes for readers of a table: on its pairs, predictions, levels and factors."""
    notes, scores, protocol = [], result.scores, request.protocol
    if set_aside := plan.facts.get("set_aside"):
        factors = ", ".join(f"x{ratio:g}" for ratio in plan.facts["ratios"])
        notes.append(f"this set's own pairs are scored ({factors}), not those of the protocol: {', '.join(set_aside)}")
    if found.unscored:
        notes.append(f"not scored, because this evaluation leaves their frames out: {found.unscored} predictions")
    notes += [
        f"{count} predictions of {name} are there too; not scored here" for name, count in found.elsewhere.items()
    ]
    if bare := [outcome.path for outcome in outcomes if outcome.lacks_channel_whites]:
        notes.append(
            f"LibRaw has no white level per channel of the references of {len(bare)} pairs, such as that of {bare[0]}: "
            "the file's one white level was taken"
        )
    notes += _write_white_notes(outcomes)
    levels = protocol.levels
    same = {"metadata", "published"} & set(result.provenance["equal_choices"].get("levels", ()))
    if scores and levels in ONE_CAMERAS_LEVELS and not same:
        other = "others" if levels == "lrid" else "another black level"
        notes.append(
            f"{LEVELS[levels]} was taken for every file, as protocol {protocol.name} has it; some of these files "
            f"state {other}"
        )
    if "task" in result.provenance and scores:
        notes.append(task_note(result.provenance["task"]))
    low, high = _USUAL_RESCALE
    if odd := [score for score in scores if not low <= score.rescale <= high]:
        notes.append(
            f"rescaled by less than {low:.2g} or more than {high:g}: {len(odd)} of {len(scores)} predictions, such as "
            f"{odd[0].name} by {odd[0].rescale:.3g}; are they scaled like the reference?"
        )
    if perfect := [score.name for score in scores if score.psnr_db == float("inf")]:
        what, units = "equal to their reference exactly", "predictions"
        if result.kind.is_of_clips:
            what, units = "with a frame that equals the reference exactly", "videos"
        notes.append(f"{what}: {len(perfect)} {units}, such as {perfect[0]}")
    return notes


def _write_white_notes(outcomes: Sequence[PairOutcome]) -> list[str]:
    """Name the cameras whose files saturate at another level than the protocol divides by, in one line."""
    found: dict[str, set[float]] = {}
    taken_dn = 0.0
    for outcome in outcomes:
        stated_dn, white_dn = outcome.white_levels_dn or (0.0, 0.0)
        if outcome.score is not None and abs(stated_dn - white_dn) > _USUAL_WHITE * white_dn:
            taken_dn = white_dn  # the same of every file
            found.setdefault(outcome.score.camera, set()).add(stated_dn)
    if not found:
        return []
    whose = ", those of ".join(
        f"{camera}{'' if number else ' saturate'} at "
        f"{' to '.join(f'{level:g}' for level in dict.fromkeys((min(levels), max(levels))))} DN"
        for number, (camera, levels) in enumerate(found.items())
    )
    own = "--protocol raw takes the files' own white level"
    return [f"the files of {whose}, and the protocol divides by {taken_dn:g}: {own}"]


def collect_provenance(request: Request, plan: ScoringPlan, outcomes: Sequence[PairOutcome]) -> dict[str, Any]:
    """Collect the facts that a result depends on: versions, manifest, the protocol's digest, the choice of pairs."""
    import rawpy

    manifest, cameras = request.manifest, request.cameras
    scored = [outcome for outcome in outcomes if outcome.score is not None]
    choices = [outcome.equal_choices for outcome in scored if outcome.equal_choices is not None]
    equal = {name: frozenset.intersection(*(of[name] for of in choices)) for name in (choices[0] if choices else ())}
    return {
        "dataset": manifest.name,
        "manifest_version": manifest.card.version,
        "manifest_sha256": manifest.digest,
        "scenes_shared": manifest.card.scenes_shared,
        "cameras": "all" if cameras is None else [name for name in manifest.card.cameras if name in cameras],
        "predictions": THE_INPUT if request.predictions is None else str(request.predictions),
        "python": platform.python_version(),
        "libraw": ".".join(map(str, rawpy.libraw_version)),
        "eldata": __version__,
        **{name: version(name) for name in ("numpy", "numba", "rawpy")},
        "protocol_digest": request.protocol.digest,
        **plan.facts,
        "equal_choices": {name: [choice for choice in CHOICES[name] if choice in equal[name]] for name in equal},
        **({} if request.dark_shading is None else {"dark_shading": request.protocol.dark_shading}),
        **({} if request.task is None else {"task": request.task.provenance}),
    }


# --- several methods: their names, comparison and files ---------------------------------------------------------------


def name_folders(folders: Sequence[Path], names: Sequence[str] = ()) -> dict[str, Path]:
    """Return folders by the names of their methods, by default their own.

    Raises
    ------
    ArgumentError
        If there is none, two have one name, a name cannot be that of a file, or there are not as many names as folders.
    """
    if not folders:
        raise ArgumentError("expected one folder of predictions or more, found none")
    if names and len(names) != len(folders):
        raise ArgumentError(
            f"expected one name (--name) per folder, or none; found {len(names)} for {len(folders)} folders"
        )
    named: dict[str, Path] = {}
    taken = {COMPARISON: "the comparison"}
    for folder, name in zip(folders, names or [folder.resolve().name for folder in folders], strict=True):
        if not name or "/" in name or name.startswith(".") or path_problem(name) is not None:
            raise ArgumentError(f"{folder}: {name!r} cannot be the name of a file; give it another with --name")
        if name.casefold() in taken:
            raise ArgumentError(
                f"{taken[name.casefold()]} and {folder} would both be called {name!r}; give each a --name, in the "
                "order of the folders"
            )
        taken[name.casefold()] = str(folder)
        named[name] = folder
    return named


def compare_methods(results: Mapping[str, EvaluationResult]) -> tuple[Comparison | None, str]:
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
        if (problem := write_problem(folder / name)) is not None:
            raise ArgumentError(f"cannot write {folder / name}: {problem}")


def write_results(folder: Path, results: Mapping[str, EvaluationResult], comparison: Comparison | None) -> None:
    """Write NAME.json and NAME.csv of each method, and comparison.json; each whole or not at all."""
    remove_leftovers(folder)
    for name, result in results.items():
        result.write_json(folder / f"{name}.json")
        result.write_csv(folder / f"{name}.csv")
    if comparison is not None:
        write_json(folder / f"{COMPARISON}.json", comparison.as_dict())
