"""What stands beside a result's numbers: what a reader should know of them, and all that they depend on."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from eldata import __version__
from eldata.evaluation.request import SETTINGS, Request, stated_shading
from eldata.evaluation.results import THE_INPUT, EvaluationResult
from eldata.evaluation.scores import short_digest
from eldata.noise.dark_shading import dark_shading_in
from eldata.protocols.protocol import CHOICES, ONE_CAMERAS_LEVELS
from eldata.protocols.words import LEVELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.evaluation.layouts import FoundPredictions
    from eldata.evaluation.planning import ScoringPlan
    from eldata.evaluation.scores import UnitScore
    from eldata.evaluation.units import PlanScores

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
    if plan.set_aside:
        factors = ", ".join(f"x{ratio:g}" for ratio in plan.facts["ratios"])
        notes.append(
            f"this set's own pairs are scored ({factors}), not those of the protocol: {', '.join(plan.set_aside)}"
        )
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
    if scores and levels in ONE_CAMERAS_LEVELS and "published" not in (scored.equal_choices or {}).get("levels", ()):
        notes.append(
            f"{LEVELS[levels]} was taken for every file, as protocol {plan.protocol.name} has it; some of these files "
            "state another black level"
        )
    if "task" in result.provenance and scores:
        notes.append(_task_note(result.provenance["task"]))
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
        "subset": plan.subset,
        **plan.facts,
        "excluded_flags": plan.excluded,
        "equal_choices": {name: [choice for choice in CHOICES[name] if choice in equal[name]] for name in equal},
        **({} if request.dark_shading is None else {"dark_shading": plan.protocol.dark_shading}),
        **({} if request.task is None else {"task": request.task.provenance}),
    }


def _task_note(task: dict[str, Any]) -> str:
    """Return what a task's column holds."""
    source = f" ({short_digest(task['source_sha256'])})" if task["source_sha256"] else ""
    images = {"compared": "what the protocol compares", "packed": "packed raw", "srgb": "renderings in sRGB"}
    better = "higher" if task["higher_is_better"] else "lower"
    return f"{task['label']}: {task['callable']}{source}, of {images[task['images']]}; {better} is better"
