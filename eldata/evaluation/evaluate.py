"""The evaluation: check the dataset, find the predictions, score images or clips under one protocol or under all."""

from __future__ import annotations

import platform
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, Unpack

from eldata import __version__
from eldata.base.arguments import spell_keywords
from eldata.errors import ArgumentError, ManifestError
from eldata.evaluation.combined import CombinedResult, NotScored
from eldata.evaluation.diagnosis import suspicions_of
from eldata.evaluation.layouts import Expected, FoundPredictions, dataset_itself, find_predictions, misplaced
from eldata.evaluation.planning import known_places, places_elsewhere, plan_scoring, require_pairs
from eldata.evaluation.predictions import LOOKS, look_of_folder, look_wanted, other_look
from eldata.evaluation.request import ALL, SETTINGS, EvaluationOptions, Request, make_request, stated_shading
from eldata.evaluation.results import THE_INPUT, EvaluationResult
from eldata.evaluation.scores import EvaluationProblem, frames_of, place_of
from eldata.evaluation.tasks import task_note
from eldata.evaluation.units import Contender, score_plans
from eldata.noise.dark_shading import dark_shading_in
from eldata.protocols.kinds import IMAGES
from eldata.protocols.protocol import CHOICES, ONE_CAMERAS_LEVELS
from eldata.protocols.words import LEVELS
from eldata.records import PairRecord

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eldata.evaluation.planning import ScoringPlan
    from eldata.evaluation.scores import UnitScore
    from eldata.evaluation.units import PlanScores
    from eldata.protocols.protocol import Protocol


@spell_keywords(EvaluationOptions)
def evaluate(
    predictions: Path | str | None,
    dataset: str = "eld",
    *,
    protocol: str | Path | Protocol | None = None,
    **options: Unpack[EvaluationOptions],
) -> EvaluationResult:
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
        Name of a shipped manifest, such as ``eld`` or, of clips, ``drv``.
    protocol
        Name of a protocol (:mod:`eldata.protocols`) or of a family, such as ``pmn``; the path of a TOML file; or a
        protocol. Default: the one that the dataset's card names, such as ``eld``, ``sid`` or ``drv-rgb``; if it names
        none, ``raw``, by the files' own levels.
    root
        The folder that holds the datasets. Default: ``$ELDATA_ROOT``, else ``./data``.
    manifest
        A manifest's CSV file, in place of ``dataset``: your own set, or that of a copy's raw clips
        (:func:`eldata.manifest.drv.scan_raw`). Any protocol of images may score your own set, on the set's own pairs:
        those at the protocol's factors if it has every one of them, else all. Default: the shipped one.
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
        Whether to score the rest if predictions are missing or unusable; the table shows the coverage. Default: False.
    baseline
        ``"input"``, in place of ``predictions``: score the noisy input itself, amplified and clipped as the protocol
        has it. Default: None.
    strict
        Whether predictions that show a mistake (:mod:`eldata.evaluation.diagnosis`) are a problem: then nothing has a
        score. Default: False, the result's ``suspicions`` name it.
    task
        A function of (prediction, reference), (C, h, w) float32 as the protocol compares them, whose value is scored
        too, of clips frame by frame; or a :class:`~eldata.evaluation.Task`, which says which images it wants, of how
        many frames at a time, and whether lower is better; or the name of either, ``package.module:name``.
        Default: none.
    dark_shading
        The file of a dark shading (:class:`eldata.noise.DarkShading`) that the inputs are corrected with: it is taken
        off the baseline here; that predictions are of inputs less it is your statement. The protocol of the result
        states its digest. Refused for several cameras, and for another model, size, CFA or ISO. Default: none.
    store
        A store (``eldata pack``) whose frames are taken in place of the dataset's files, which need not be there: the
        scores are the same to the bit, and lossless JPEG is not decoded again. What it kept of the files that it was
        packed from is held against the manifest, and the result says which store it was. Refused for clips and for
        renderings by LibRaw. Default: none.
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
    if protocol == ALL:
        raise ArgumentError("evaluate() scores under one protocol; eldata.evaluation.evaluate_all() does under all")
    return perform(make_request(predictions, dataset, protocol, options)).results[0]


@spell_keywords(EvaluationOptions)
def evaluate_all(
    predictions: Path | str | None, dataset: str = "eld", **options: Unpack[EvaluationOptions]
) -> CombinedResult:
    """Score a folder of predictions under every protocol for the dataset, in one pass over the files.

    Each protocol scores its own pairs, and each result equals that of :func:`evaluate`. Protocols of sRGB are scored if
    the predictions are renderings, the others if they are raw. A set of your own is scored once for each way to score.
    Protocols that come to the same on these files share their scores, which are computed once
    (:attr:`CombinedResult.groups`).

    Parameters
    ----------
    predictions, dataset, **options
        As for :func:`evaluate`: ``root``, ``manifest``, ``cameras``, ``subset`` (of clips), ``ids``, ``exclude_flags``,
        ``allow_missing``, ``baseline``, ``dark_shading`` and ``workers``.

    Returns
    -------
    CombinedResult
        One :class:`EvaluationResult` per protocol, and the protocols that could not be scored, with why.

    Raises
    ------
    EldataError, DatasetError, ManifestError, ArgumentError
        Like :func:`evaluate`; or if no protocol can be scored.

    Examples
    --------
    >>> from eldata import evaluate_all
    >>> manifest = "eldata-demo/manifests/eld-demo.csv"
    >>> every = evaluate_all(None, manifest=manifest, root="eldata-demo/data", baseline="input")
    >>> [result.protocol.name for result in every.results]
    ['eld', 'eld-uncorrected', 'led-eld', 'lrd-eld', 'eld-srgb', 'eld-raw2rgb']
    """
    return perform(make_request(predictions, dataset, ALL, options))


def perform(request: Request) -> CombinedResult:
    """Return the result of each protocol of a request.

    Raises
    ------
    EldataError, DatasetError, ManifestError, ArgumentError
        Like :func:`evaluate` and :func:`evaluate_all`.
    """
    return perform_each([request])[0]


def perform_each(requests: Sequence[Request]) -> list[CombinedResult]:
    """Return what :func:`perform` does of each of these requests, which differ in their predictions alone, in one pass.

    Raises
    ------
    EldataError, DatasetError, ManifestError, ArgumentError
        Like :func:`perform`; what is wrong with the predictions in one folder is a problem of its result alone.
    """
    first = requests[0]
    plans: list[ScoringPlan] = []
    left_out: list[NotScored] = []
    for protocol in first.protocols:
        try:
            plans.append(plan_scoring(first, protocol))
        except (ArgumentError, ManifestError) as error:
            if not first.every:
                raise
            left_out.append(NotScored(protocol.name, str(error)))
    fitting = [_of_one_space(request, plans) if request.every else (plans, []) for request in requests]
    scored = _scored(requests, [fit for fit, _ in fitting])
    return [
        _combined(request, of, [*left_out, *unfit])
        for request, of, (_, unfit) in zip(requests, scored, fitting, strict=True)
    ]


def _combined(
    request: Request, scored: Sequence[tuple[EvaluationResult, PlanScores]], left_out: list[NotScored]
) -> CombinedResult:
    """Return the results; under all protocols, those that cannot score what is there are left out and named."""
    results = []
    for result, found in scored:
        if request.every and found.unfit and not found.scores:
            left_out.append(NotScored(result.protocol.name, str(found.unfit[0])))
        else:
            results.append(result)
    if not results:
        reasons = "; ".join(f"{one.protocol}: {one.reason}" for one in left_out)
        raise ArgumentError(f"no protocol can score {request.manifest.name!r} so: {reasons}")
    return CombinedResult(tuple(results), tuple(left_out))


def _of_one_space(request: Request, plans: Sequence[ScoringPlan]) -> tuple[list[ScoringPlan], list[NotScored]]:
    """Return the plans that take predictions as they are, raw or renderings, and why not the others."""
    if request.kind is not IMAGES:
        return list(plans), []
    if request.predictions is None:
        there, unfit = "the input is raw", [plan for plan in plans if not plan.protocol.is_of_packed]
    else:
        places = dict.fromkeys(pair.path for plan in plans for pair in plan.pairs)
        look = look_of_folder(find_predictions(request.predictions, places), request)
        there = f"the predictions are {LOOKS[look].removeprefix('renderings in ').removesuffix(' frames')}"
        unfit = [plan for plan in plans if look_wanted(plan.protocol) != look]
    wanted = LOOKS | {"raw": "packed raw"}
    reasons = [NotScored(one.protocol.name, f"scores {wanted[look_wanted(one.protocol)]}; {there}") for one in unfit]
    return [plan for plan in plans if plan not in unfit], reasons


# --- one pass over the files ------------------------------------------------------------------------------------------


def _scored(
    requests: Sequence[Request], plans: Sequence[Sequence[ScoringPlan]]
) -> list[list[tuple[EvaluationResult, PlanScores]]]:
    """Return the result of each plan of each request, and what scoring found beyond it."""
    if not any(plans):
        return [[] for _ in requests]
    pairs = {pair.path: pair for of in plans for plan in of for pair in plan.pairs}.values()
    with requests[0].workers_for(pairs).sharing() as workers:
        first = replace(requests[0], workers=workers)
        found = [_found(request, of) for request, of in zip(requests, plans, strict=True)]
        originals = require_pairs(first, pairs)
        contenders = [
            Contender(
                plan if request.allow_missing or not one.problems else replace(plan, pairs=()),
                number,
                None if request.predictions is None else one.files,
            )
            for number, request in enumerate(requests)
            for plan, one in zip(plans[number], found[number], strict=True)
        ]
        scored = iter(score_plans(first, originals, contenders))
    return [
        _results(request, of, ones, list(islice(scored, len(of))), originals.stated)
        for request, of, ones in zip(requests, plans, found, strict=True)
    ]


def _results(
    request: Request,
    plans: Sequence[ScoringPlan],
    found: Sequence[FoundPredictions],
    scored: Sequence[PlanScores],
    store: dict[str, str],
) -> list[tuple[EvaluationResult, PlanScores]]:
    """Return the results of one request."""
    suspicions = [suspicions_of(new.inspections) for new in scored]
    refused = [EvaluationProblem(str(request.predictions), str(one)) for of in suspicions for one in of]
    if not request.strict:
        refused = []
    results = []
    for plan, one, new, suspect in zip(plans, found, scored, suspicions, strict=True):
        every = [*one.problems, *new.problems, *new.unfit]
        scores = new.scores if not refused and (request.allow_missing or not every) else {}
        provenance = provenance_of(request, plan, new) | ({"store": store} if store else {})
        result = EvaluationResult.of(plan.protocol, provenance, plan.pairs, scores, [*refused, *every])
        result = replace(result, suspicions=suspect)
        notes = [*shading_notes(request), *notes_of(plan, one, result, new)]
        results.append((replace(result, notes=tuple(notes)), new))
    return results


def _found(request: Request, plans: Sequence[ScoringPlan]) -> list[FoundPredictions]:
    """Return the predictions of what each plan scores; a baseline has none.

    In a folder of which nothing is where a prediction may be, that is the one problem of all plans.
    """
    if request.predictions is None:
        return [FoundPredictions({}, (), 0) for _ in plans]
    known, elsewhere = known_places(request), places_elsewhere(request)
    places = [[place_of(pair, frame) for pair in plan.pairs for frame in frames_of(pair)] for plan in plans]
    references: dict[str, str] = {}
    for pair in (pair for plan in plans for pair in plan.pairs if isinstance(pair, PairRecord)):
        references.setdefault(pair.reference, pair.path)
    expected = Expected(list(dict.fromkeys(chain.from_iterable(places))), references, elsewhere)
    problem = dataset_itself(request.predictions, request.folder, [row.path for row in request.manifest.records])
    problem = problem or misplaced(request.predictions, expected, known)
    if problem is not None:
        return [FoundPredictions({}, (problem,), 0) for _ in plans]
    find = partial(find_predictions, request.predictions, elsewhere=elsewhere, allow_missing=request.allow_missing)
    if request.every:  # its plans are of the predictions' space, and share their problems
        return [find(places=wanted, known=known) for wanted in places]
    return [
        _of_its_space(request, request.predictions, plan, find(places=wanted, known=known, because=_own_pairs(plan)))
        for plan, wanted in zip(plans, places, strict=True)
    ]


def _own_pairs(plan: ScoringPlan) -> str:
    """Return why a set of the user's own may lack predictions of pairs that its protocol does not choose elsewhere."""
    name, set_aside = plan.protocol.name, plan.facts.get("set_aside")
    return f", and {name} scores this set's own pairs, not its {', '.join(set_aside)}" if set_aside else ""


def _of_its_space(request: Request, folder: Path, plan: ScoringPlan, found: FoundPredictions) -> FoundPredictions:
    """Return the predictions; if none of them is what the protocol takes, that is their one problem."""
    if plan.protocol.kind is not IMAGES:
        return found
    reason = other_look(plan.protocol, found, request.manifest, folder)
    return found if reason is None else FoundPredictions({}, (EvaluationProblem(str(folder), reason),), 0)


# --- what stands beside a result's numbers ----------------------------------------------------------------------------

# A white level that is off by more than this share is said: of ELD's Sony, 16300 for 16383, it is a half percent.
_USUAL_WHITE = 0.02
# A factor beyond these hides a prediction of another scale: the score says nothing of it.
_USUAL_RESCALE = (1 / 3, 3.0)


def shading_notes(request: Request) -> list[str]:
    """Return what was done to the inputs, or is stated of them."""
    if request.dark_shading is None:
        return []
    shading = dark_shading_in(request.dark_shading)
    which = f"the dark shading of {shading.camera}, {shading.digest} ({shading.source})"
    if request.predictions is None:
        return [f"the input was scored less {which}"]
    stated = stated_shading(request.predictions)  # which the request was held against
    said = "stated with --dark-shading" if stated is None else f"{SETTINGS} says"
    return [f"the predictions are, as {said}, of inputs less {which}"]


def notes_of(plan: ScoringPlan, found: FoundPredictions, result: EvaluationResult, scored: PlanScores) -> list[str]:
    """Return what a reader of a result's table should know: of its pairs, its predictions, its levels and factors."""
    notes, scores = [], result.scores
    if set_aside := plan.facts.get("set_aside"):
        factors = ", ".join(f"x{ratio:g}" for ratio in plan.facts["ratios"])
        notes.append(f"this set's own pairs are scored ({factors}), not those of the protocol: {', '.join(set_aside)}")
    if found.unscored:
        notes.append(f"not scored, because this evaluation leaves their frames out: {found.unscored} predictions")
    notes += [
        f"{count} predictions of {name} are there too; not scored here" for name, count in found.elsewhere.items()
    ]
    paths = {score.path for score in scores}
    bare = [path for path in scored.without_channel_whites if path in paths]
    if bare:
        notes.append(
            f"LibRaw has no white level per channel of the references of {len(bare)} pairs, such as that of {bare[0]}: "
            "the file's one white level was taken"
        )
    notes += _white_level_notes(result.scores, scored)
    levels = plan.protocol.levels
    same = {"metadata", "published"} & {*(scored.equal_choices or {}).get("levels", ())}
    if scores and levels in ONE_CAMERAS_LEVELS and not same:
        other = "others" if levels == "lrid" else "another black level"
        notes.append(
            f"{LEVELS[levels]} was taken for every file, as protocol {plan.protocol.name} has it; some of these files "
            f"state {other}"
        )
    if "task" in result.provenance and scores:
        notes.append(task_note(result.provenance["task"]))
    low, high = _USUAL_RESCALE
    odd = [score for score in scores if not low <= score.rescale <= high]
    if odd:
        notes.append(
            f"rescaled by less than {low:.2g} or more than {high:g}: {len(odd)} of {len(scores)} predictions, such as "
            f"{odd[0].name} by {odd[0].rescale:.3g}; is their scale that of the reference?"
        )
    perfect = [score.name for score in scores if score.psnr_db == float("inf")]
    if perfect and not result.kind.is_of_clips:
        notes.append(f"equal to their reference exactly: {len(perfect)} predictions, such as {perfect[0]}")
    elif perfect:
        notes.append(f"with a frame that equals the reference exactly: {len(perfect)} videos, such as {perfect[0]}")
    return notes


def _white_level_notes(scores: Sequence[UnitScore], scored: PlanScores) -> list[str]:
    """Return whose files saturate at another level than the protocol divides by, in one line with all numbers."""
    found: dict[str, set[float]] = {}
    taken_dn = 0.0
    for score in scores:
        stated_dn, white_dn = scored.white_levels_dn[score.path] or (0.0, 0.0)
        if abs(stated_dn - white_dn) > _USUAL_WHITE * white_dn:
            taken_dn = white_dn  # the same of every file
            found.setdefault(score.camera, set()).add(stated_dn)
    if not found:
        return []
    whose = ", those of ".join(
        f"{camera}{'' if number else ' saturate'} at "
        f"{' to '.join(f'{level:g}' for level in dict.fromkeys((min(levels), max(levels))))} DN"
        for number, (camera, levels) in enumerate(found.items())
    )
    own = "--protocol raw takes the files' own white level"
    return [f"the files of {whose}, and the protocol divides by {taken_dn:g}: {own}"]


def provenance_of(request: Request, plan: ScoringPlan, scored: PlanScores) -> dict[str, Any]:
    """Return what the numbers of a plan depend on: versions, manifest, protocol's digest, choice of pairs."""
    import rawpy

    manifest, cameras = request.manifest, request.cameras
    equal = scored.equal_choices or {}
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
        **{name: version(name) for name in ("numpy", "numba", "rawpy", "exifread")},
        "protocol_digest": plan.protocol.digest,
        **plan.facts,
        "equal_choices": {name: [choice for choice in CHOICES[name] if choice in equal[name]] for name in equal},
        **({} if request.dark_shading is None else {"dark_shading": plan.protocol.dark_shading}),
        **({} if request.task is None else {"task": request.task.provenance}),
    }
