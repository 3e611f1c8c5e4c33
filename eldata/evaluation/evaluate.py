"""The evaluation: check the dataset, find the predictions, score each pair under one protocol or under all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eldata.base.workers import AnyWorkers, Workers, accepts_jobs
from eldata.errors import ArgumentError, DatasetError, ManifestError, PredictionError
from eldata.evaluation.combined import CombinedResult, NotScored
from eldata.evaluation.common import file_problems, software
from eldata.evaluation.planning import is_own, make_plan
from eldata.evaluation.predictions import find_predictions, prediction_space
from eldata.evaluation.results import EvaluationResult
from eldata.evaluation.scoring import score_plans
from eldata.manifest.catalogue import Manifest, load_manifest, shipped_manifest
from eldata.manifest.verify import check_files
from eldata.protocols.choosing import default_protocol, get_protocol, members_of, protocols_for
from eldata.protocols.protocol import Protocol

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from eldata.evaluation.planning import Plan
    from eldata.evaluation.predictions import FoundPredictions
    from eldata.evaluation.results import ImageScore
    from eldata.evaluation.scoring import PlanScores
    from eldata.records import PairRecord

Baseline = Literal["input"]

ALL = "all"
"""In place of a protocol's name: every one that is for the dataset (:func:`evaluate_all`)."""

# A factor beyond these hides a prediction of another scale: the score says nothing of it.
_USUAL_RESCALE = (1 / 3, 3.0)


@accepts_jobs
def evaluate(
    predictions: Path | str | None,
    dataset: str = "eld",
    *,
    protocol: str | Path | Protocol | None = None,
    root: Path | str | None = None,
    manifest: Path | str | None = None,
    cameras: Collection[str] | None = None,
    subset: str | None = None,
    exclude_flags: Collection[str] = (),
    allow_missing: bool = False,
    baseline: Baseline | None = None,
    workers: AnyWorkers = 1,
) -> EvaluationResult:
    """Score a folder of predictions under a named protocol.

    Before anything is scored, the raw files of the pairs are checked as ``eldata verify --level metadata`` does: a
    wrong or incomplete download stops the evaluation.

    Parameters
    ----------
    predictions
        Folder of predictions (:mod:`eldata.evaluation.predictions`); ``None`` for a baseline.
    dataset
        Name of a shipped manifest.
    protocol
        Name of a protocol (:mod:`eldata.protocols`) or of a family, such as ``pmn``; the path of a TOML file; or a
        protocol. Default: the dataset's own, ``eld`` or ``sid``.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    manifest
        A manifest's CSV file, in place of ``dataset``: your own set. Any protocol may score it, on the set's own pairs:
        those at the protocol's factors if it has every one of them, else all.
    cameras
        Score these cameras' pairs alone; the result says so.
    subset
        Name of a subset on the dataset's card (:mod:`eldata.manifest.subsets`). Default: the protocol's, else the first
        on the card, if any.
    exclude_flags
        Leave out pairs that the manifest flags so, such as ``["misaligned"]``; the result says how many.
    allow_missing
        Score what is there although predictions are missing or unusable; the table shows the coverage.
    baseline
        ``"input"``: score the noisy input itself, amplified and clipped as the protocol has it.
    workers
        Number of worker processes, or an executor that scores (:mod:`eldata.base.workers`); the files are checked from
        here. Scores do not depend on it.

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
    """
    if protocol == ALL:
        raise ArgumentError("evaluate() scores under one protocol; eldata.evaluation.evaluate_all() does under all")
    known = _protocol(protocol, None) if _is_plain(protocol) else None  # a wrong name is said before files are read
    loaded = shipped_manifest(dataset) if manifest is None else load_manifest(manifest)
    chosen = known or _protocol(protocol, loaded)
    plan = make_plan(loaded, chosen, cameras=cameras, subset=subset, exclude_flags=exclude_flags)
    ((result, _),) = _evaluate(
        loaded,
        [plan],
        predictions,
        root=root,
        cameras=cameras,
        allow_missing=allow_missing,
        baseline=baseline,
        workers=Workers.of(workers),
    )
    return result


@accepts_jobs
def evaluate_all(
    predictions: Path | str | None,
    dataset: str = "eld",
    *,
    root: Path | str | None = None,
    manifest: Path | str | None = None,
    cameras: Collection[str] | None = None,
    exclude_flags: Collection[str] = (),
    allow_missing: bool = False,
    baseline: Baseline | None = None,
    workers: AnyWorkers = 1,
) -> CombinedResult:
    """Score a folder of predictions under every protocol for the dataset, in one pass over the files.

    Each protocol scores its own pairs, and each result equals that of :func:`evaluate`. Protocols of sRGB are scored if
    the predictions are renderings, the others if they are raw. A set of your own is scored once for each way to score.

    Parameters
    ----------
    predictions, dataset, root, manifest, cameras, exclude_flags, allow_missing, baseline, workers
        As for :func:`evaluate`.

    Returns
    -------
    CombinedResult
        One :class:`EvaluationResult` a protocol, and the protocols that could not be scored, with why.

    Raises
    ------
    EldataError, DatasetError, ManifestError, ArgumentError
        As :func:`evaluate`; or if no protocol can be scored.
    """
    loaded = shipped_manifest(dataset) if manifest is None else load_manifest(manifest)
    if predictions is not None and not Path(predictions).is_dir():
        find_predictions(Path(predictions), [], [])  # says so
    candidates = protocols_for(loaded.name)
    if is_own(loaded):
        ways: dict[str, Protocol] = {}
        for protocol in candidates:
            ways.setdefault(protocol.scoring_digest, protocol)
        candidates = tuple(ways.values())
    plans: list[Plan] = []
    left_out: list[NotScored] = []
    for protocol in candidates:
        try:
            plans.append(make_plan(loaded, protocol, cameras=cameras, subset=None, exclude_flags=exclude_flags))
        except (ArgumentError, ManifestError) as error:
            left_out.append(NotScored(protocol.name, str(error)))
    space = "raw" if predictions is None else _space(Path(predictions), plans, loaded)
    what = "the input is raw" if predictions is None else f"the predictions are {'raw' if space == 'raw' else 'sRGB'}"
    for plan in plans:
        if plan.protocol.prediction_space != space:
            wanted = "renderings in sRGB" if space == "raw" else "packed raw"
            left_out.append(NotScored(plan.protocol.name, f"scores {wanted}; {what}"))
    plans = [plan for plan in plans if plan.protocol.prediction_space == space]
    if not plans:
        raise ArgumentError(_none_left(loaded, left_out))
    evaluated = _evaluate(
        loaded,
        plans,
        predictions,
        root=root,
        cameras=cameras,
        allow_missing=allow_missing,
        baseline=baseline,
        workers=Workers.of(workers),
    )
    results = []
    for result, scored in evaluated:
        if scored.unfit and not scored.scores:
            left_out.append(NotScored(result.protocol.name, str(scored.unfit[0])))
        else:
            results.append(result)
    if not results:
        raise ArgumentError(_none_left(loaded, left_out))
    return CombinedResult(tuple(results), tuple(left_out))


def _none_left(manifest: Manifest, left_out: Sequence[NotScored]) -> str:
    reasons = "; ".join(f"{one.protocol}: {one.reason}" for one in left_out)
    return f"no protocol can score {manifest.name!r} so: {reasons}"


def _is_plain(protocol: str | Path | Protocol | None) -> bool:
    """Return whether a protocol is known without the dataset: by its own name, by a file, or itself."""
    from eldata.protocols.named import FAMILIES

    return protocol is not None and protocol not in FAMILIES


def _protocol(protocol: str | Path | Protocol | None, manifest: Manifest | None) -> Protocol:
    if isinstance(protocol, Protocol):
        protocol.check()
        return protocol
    if protocol is None:
        return default_protocol("" if manifest is None else manifest.name)
    if isinstance(protocol, Path):
        from eldata.protocols.custom import load_protocol

        return load_protocol(protocol)
    if manifest is not None and is_own(manifest):
        # A family's members differ in the choice of pairs, and a set of the user's own has its own.
        members = members_of(protocol)
        return next((member for member in members if member.covers(manifest.name)), members[0])
    return get_protocol(protocol, None if manifest is None else manifest.name)


def _space(predictions: Path, plans: Sequence[Plan], manifest: Manifest) -> str:
    """Return whether a folder holds raw predictions or renderings, by the first that can be read."""
    pairs = {pair.path: pair for plan in plans for pair in plan.pairs}
    found = find_predictions(predictions, pairs.values(), _noisy_paths(manifest))
    for file in found.files.values():
        try:
            return prediction_space(file)
        except PredictionError:  # it will be among the problems
            continue
    return "raw"


def _noisy_paths(manifest: Manifest) -> list[str]:
    return [record.path for record in manifest.records if record.role == "noisy"]


# --- one pass over the files ------------------------------------------------------------------------------------------


def _evaluate(
    manifest: Manifest,
    plans: Sequence[Plan],
    predictions: Path | str | None,
    *,
    root: Path | str | None,
    cameras: Collection[str] | None,
    allow_missing: bool,
    baseline: Baseline | None,
    workers: Workers,
) -> list[tuple[EvaluationResult, PlanScores]]:
    """Return the result of each plan, and what scoring found beyond it."""
    _check_source(plans, predictions, baseline)
    found: list[FoundPredictions | None] = [None] * len(plans)
    if predictions is not None:
        known = _noisy_paths(manifest)
        found = [find_predictions(Path(predictions), plan.pairs, known) for plan in plans]
    folder = manifest.folder(root)
    pairs = {pair.path: pair for plan in plans for pair in plan.pairs}
    _require_dataset(manifest, folder, list(pairs.values()), workers)

    problems = [[] if one is None else file_problems(one, allow_missing=allow_missing) for one in found]
    wanted = [allow_missing or not some for some in problems]
    scored = score_plans(
        folder,
        [plan if want else replace(plan, pairs=()) for plan, want in zip(plans, wanted, strict=True)],
        None if predictions is None else [one.files for one in found if one is not None],
        workers=workers,
    )
    source = str(predictions) if predictions is not None else f"none: the {baseline} itself"
    provenance = _provenance(manifest, cameras, source)
    results = []
    for plan, one, already, new in zip(plans, found, problems, scored, strict=True):
        new_problems = new.problems + new.unfit
        complete = allow_missing or not (already or new_problems)
        scores = new.scores if complete else {}
        images = tuple(scores[pair.path] for pair in plan.pairs if pair.path in scores)
        result = EvaluationResult(
            protocol=plan.protocol,
            provenance=provenance
            | {
                "protocol_digest": plan.protocol.digest,
                "subset": plan.subset,
                "ratios": plan.ratios,
                "set_aside": list(plan.set_aside),
                "excluded_flags": plan.excluded,
            },
            pairs=plan.pairs,
            images=images,
            missing=tuple(pair.path for pair in plan.pairs if pair.path not in scores),
            problems=tuple(already + new_problems),
            notes=tuple(_notes(plan, one, images, new)),
        )
        results.append((result, new))
    return results


def _check_source(plans: Sequence[Plan], predictions: Path | str | None, baseline: Baseline | None) -> None:
    if baseline not in (None, "input"):
        raise ArgumentError(f"baseline must be 'input'; found {baseline!r}")
    if (predictions is None) == (baseline is None):
        raise ArgumentError("give a folder of predictions or a baseline, and not both")
    for plan in plans:
        if baseline is not None and plan.protocol.prediction_space != "raw":
            raise ArgumentError(
                f"protocol {plan.protocol.name!r} scores renderings, so the raw input is no baseline of it"
            )


def _require_dataset(manifest: Manifest, folder: Path, pairs: Sequence[PairRecord], workers: Workers) -> None:
    if not folder.is_dir():
        raise DatasetError(
            f"{folder}: the dataset is not there; name the folder above it with --root (root=...). Where to get it: "
            f"{manifest.card.homepage}"
        )
    needed = {pair.path for pair in pairs} | {pair.reference for pair in pairs}
    records = [record for record in manifest.records if record.path in needed]
    problems, _ = check_files(manifest, folder, records, level="metadata", workers=workers)
    if problems:
        more = f" (and {len(problems) - 1} more: eldata verify --level metadata lists all)" if len(problems) > 1 else ""
        raise DatasetError(f"{folder}: the dataset is not what its manifest says: {problems[0]}{more}")


def _notes(plan: Plan, found: FoundPredictions | None, images: Sequence[ImageScore], scored: PlanScores) -> list[str]:
    notes = []
    if plan.set_aside:
        factors = ", ".join(f"x{ratio:g}" for ratio in plan.ratios)
        notes.append(
            f"this set's own pairs are scored ({factors}), not those of the protocol: {', '.join(plan.set_aside)}"
        )
    if found is not None and found.unscored:
        notes.append(f"not scored, because this evaluation leaves their frames out: {found.unscored} predictions")
    bare = [path for path in scored.without_channel_whites if any(image.path == path for image in images)]
    if bare:
        notes.append(
            f"LibRaw has no white level per channel of the references of {len(bare)} pairs, such as that of {bare[0]}: "
            "the file's one white level was taken"
        )
    low, high = _USUAL_RESCALE
    odd = [image for image in images if not low <= image.rescale <= high]
    if odd:
        notes.append(
            f"rescaled by less than {low:.2g} or more than {high:g}: {len(odd)} of {len(images)} predictions, such as "
            f"{odd[0].path} by {odd[0].rescale:.3g}; is their scale that of the reference?"
        )
    perfect = [image for image in images if image.psnr_db == float("inf")]
    if perfect:
        notes.append(f"equal to their reference exactly: {len(perfect)} predictions, such as {perfect[0].path}")
    return notes


def _provenance(manifest: Manifest, cameras: Collection[str] | None, predictions: str) -> dict[str, Any]:
    return {
        "dataset": manifest.name,
        "manifest_version": manifest.card.version,
        "manifest_sha256": manifest.digest,
        "cameras": "all" if cameras is None else [name for name in manifest.card.cameras if name in cameras],
        "predictions": predictions,
        **software(),
    }
