"""The evaluation: check the dataset, find the predictions, score each pair under a protocol."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata.errors import ArgumentError, DatasetError, PredictionError
from eldata.evaluation.common import EvaluationProblem, file_problems, software
from eldata.evaluation.predictions import FoundPredictions, find_predictions, load_prediction
from eldata.evaluation.results import EvaluationResult, ImageScore
from eldata.files import inside
from eldata.manifest.catalogue import Manifest, load_manifest, shipped_manifest
from eldata.manifest.pairs import select_pairs
from eldata.manifest.subsets import find_subset
from eldata.manifest.verify import check_files
from eldata.parallel import run_units
from eldata.protocols import Protocol, default_protocol, get_protocol

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from eldata.manifest.subsets import Subset
    from eldata.records import PairRecord

# A factor beyond these hides a prediction of another scale: the score says nothing of it.
_USUAL_RESCALE = (1 / 3, 3.0)


def evaluate(
    predictions: Path | str,
    dataset: str = "eld",
    *,
    protocol: str | None = None,
    root: Path | str | None = None,
    manifest: Path | str | None = None,
    cameras: Collection[str] | None = None,
    subset: str | None = None,
    exclude_flags: Collection[str] = (),
    allow_missing: bool = False,
    jobs: int = 1,
) -> EvaluationResult:
    """Score a folder of predictions under a named protocol.

    Before anything is scored, the raw files of the pairs are checked as ``eldata verify --level metadata`` does: a
    wrong or incomplete download stops the evaluation.

    Parameters
    ----------
    predictions
        Folder of predictions (:mod:`eldata.evaluation.predictions`).
    dataset
        Name of a shipped manifest.
    protocol
        Name of a protocol (:mod:`eldata.protocols`). Default: the dataset's own, ``eld`` or ``sid``.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    manifest
        A manifest's CSV file, in place of ``dataset``: your own set, in the layout of a known one.
    cameras
        Score these cameras' pairs alone; the result says so.
    subset
        Name of a subset on the dataset's card (:mod:`eldata.manifest.subsets`). Default: the first there, if any.
    exclude_flags
        Leave out pairs that the manifest flags so, such as ``["misaligned"]``; the result says how many.
    allow_missing
        Score what is there although predictions are missing or unusable; the table shows the coverage.
    jobs
        Number of worker processes. Scores do not depend on it.

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
    named_protocol = None if protocol is None else get_protocol(protocol)
    loaded = shipped_manifest(dataset) if manifest is None else load_manifest(manifest)
    chosen_protocol = named_protocol or default_protocol(loaded.name)
    if manifest is None and not chosen_protocol.covers(loaded.name):
        raise ArgumentError(
            f"protocol {chosen_protocol.name!r} is for dataset {chosen_protocol.dataset!r}, not {loaded.name!r}"
        )
    chosen_subset = _subset(loaded, subset)
    choose = partial(select_pairs, loaded.records, cameras=cameras, ratios=chosen_protocol.ratios, subset=chosen_subset)
    candidates, pairs = choose(), choose(exclude_flags=exclude_flags)
    noisy_paths = [record.path for record in loaded.records if record.role == "noisy"]
    found = find_predictions(Path(predictions), pairs, noisy_paths)
    folder = loaded.folder(root)
    _require_dataset(loaded, folder, pairs, jobs)

    problems = file_problems(found, allow_missing=allow_missing)
    scores: dict[str, ImageScore] = {}
    if allow_missing or not problems:
        scores, unusable = _score_all(folder, chosen_protocol, pairs, found, jobs)
        problems += unusable
        if problems and not allow_missing:
            scores = {}
    images = tuple(scores[pair.path] for pair in pairs if pair.path in scores)
    return EvaluationResult(
        protocol=chosen_protocol,
        provenance={
            **_provenance(loaded, chosen_protocol, predictions, cameras),
            "subset": None if chosen_subset is None else chosen_subset.name,
            "excluded_flags": {flag: sum(flag in pair.flags for pair in candidates) for flag in exclude_flags},
        },
        pairs=pairs,
        images=images,
        missing=tuple(pair.path for pair in pairs if pair.path not in scores),
        problems=tuple(problems),
        notes=tuple(_notes(found, images)),
    )


def _subset(manifest: Manifest, name: str | None) -> Subset | None:
    subsets = manifest.card.subsets
    if name is not None:
        return find_subset(subsets, name)
    return subsets[0] if subsets else None


def _require_dataset(manifest: Manifest, folder: Path, pairs: Sequence[PairRecord], jobs: int) -> None:
    if not folder.is_dir():
        raise DatasetError(
            f"{folder}: the dataset is not there; name the folder above it with --root (root=...). Where to get it: "
            f"{manifest.card.homepage}"
        )
    needed = {pair.path for pair in pairs} | {pair.reference for pair in pairs}
    records = [record for record in manifest.records if record.path in needed]
    problems, _ = check_files(manifest, folder, records, level="metadata", jobs=jobs)
    if problems:
        more = f" (and {len(problems) - 1} more: eldata verify --level metadata lists all)" if len(problems) > 1 else ""
        raise DatasetError(f"{folder}: the dataset is not what its manifest says: {problems[0]}{more}")


def _notes(found: FoundPredictions, images: Sequence[ImageScore]) -> list[str]:
    notes = []
    if found.unscored:
        notes.append(f"not scored, because this evaluation leaves their frames out: {found.unscored} predictions")
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


def _provenance(
    manifest: Manifest, protocol: Protocol, predictions: Path | str, cameras: Collection[str] | None
) -> dict[str, Any]:
    return {
        "dataset": manifest.name,
        "manifest_version": manifest.card.version,
        "manifest_sha256": manifest.digest,
        "protocol_digest": protocol.digest,
        "cameras": "all" if cameras is None else [name for name in manifest.card.cameras if name in cameras],
        "predictions": str(predictions),
        **software(),
    }


# --- scoring --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Unit:
    """The predictions that share a reference, so that it is decoded once."""

    reference: str
    pairs: tuple[tuple[PairRecord, Path], ...]

    def __str__(self) -> str:
        return self.reference


def _score_all(
    folder: Path, protocol: Protocol, pairs: Sequence[PairRecord], found: FoundPredictions, jobs: int
) -> tuple[dict[str, ImageScore], list[EvaluationProblem]]:
    by_reference: dict[str, list[tuple[PairRecord, Path]]] = {}
    for pair in pairs:
        if pair.path in found.files:
            by_reference.setdefault(pair.reference, []).append((pair, found.files[pair.path]))
    units = [_Unit(reference, tuple(members)) for reference, members in by_reference.items()]
    # Processes share the CPUs; within one process the metrics use all of them.
    work = partial(_score_unit, folder, protocol, None if jobs == 1 else 1)
    scores: dict[str, ImageScore] = {}
    problems: list[EvaluationProblem] = []
    for outcome in run_units(work, units, jobs=jobs, label="scoring", unit="reference"):
        for item in outcome:
            if isinstance(item, ImageScore):
                scores[item.path] = item
            else:
                problems.append(item)
    return scores, problems


def _score_unit(
    folder: Path, protocol: Protocol, threads: int | None, unit: _Unit
) -> list[ImageScore | EvaluationProblem]:
    from eldata.metrics import score
    from eldata.raw.levels import packed_frame
    from eldata.raw.reading import read_raw

    frame = read_raw(inside(folder, unit.reference))
    target = packed_frame(frame, levels=protocol.levels, clip=protocol.reference_clip)
    outcomes: list[ImageScore | EvaluationProblem] = []
    for pair, path in unit.pairs:
        try:
            prediction = load_prediction(path, frame.sensor, protocol.levels)
        except PredictionError as error:
            outcomes.append(EvaluationProblem(str(path), error.reason))
            continue
        found = score(prediction, target, rescaling=protocol.rescaling, threads=threads)
        outcomes.append(
            ImageScore(
                path=pair.path,
                camera=pair.camera,
                scene=pair.scene,
                iso=float(pair.iso or 0),
                ratio=float(pair.ratio),
                psnr_db=found.psnr_db,
                ssim=found.ssim,
                rescale=found.rescale,
            )
        )
    return outcomes
