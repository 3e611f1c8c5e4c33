"""A saved result asked for again: its pairs, under its protocol, and the whole evaluation, held against it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata.base.numbers import counted
from eldata.base.tables import text_table
from eldata.base.visible import shown
from eldata.errors import ArgumentError
from eldata.evaluation.evaluate import perform
from eldata.evaluation.planning import plan_scoring, require_folder
from eldata.evaluation.request import EvaluationOptions, make_request
from eldata.evaluation.results import THE_INPUT, EvaluationResult
from eldata.evaluation.saved import load_results
from eldata.evaluation.scores import nothing_scored, problem_lines
from eldata.evaluation.tasks import Task
from eldata.manifest.catalogue import known_names
from eldata.protocols.protocol import NO_SHADING, ClipProtocol, Protocol

if TYPE_CHECKING:
    from eldata.base.workers import AnyWorkers
    from eldata.evaluation.scores import Pair, UnitScore
    from eldata.evaluation.tasks import TaskFunction
    from eldata.manifest.catalogue import FrameFiles

_SHOWN = 12  # differing scores


@dataclass(frozen=True, slots=True)
class ChangedValue:
    """One thing that is not as it was.

    Attributes
    ----------
    where
        A field of the provenance, or the name of a pair or clip and the value's.
    saved, found
        What it was, and what it is now; ``None``: there was or is none.
    """

    where: str
    saved: Any
    found: Any


@dataclass(frozen=True, slots=True)
class Reevaluation:
    """A saved result, and the same evaluation made again from what it states.

    Attributes
    ----------
    saved, again
        Both results.
    scores
        Every value of every pair or clip that is not the same to the last digit.
    conditions
        What else the results state that differs: versions, manifest, protocol's digest, choice of pairs.
    """

    saved: EvaluationResult
    again: EvaluationResult
    scores: tuple[ChangedValue, ...]
    conditions: tuple[ChangedValue, ...]

    @property
    def same(self) -> bool:
        """Whether every score came out again, to the last digit, and no other."""
        return not self.scores

    def format_text(self) -> str:
        """Return what came out, and what differs."""
        count = self.saved.kind.counted
        lines = [f"{self.saved.source}: {self.saved.dataset}, protocol {self.saved.protocol.name}"]
        if self.again.problems and not self.again.scores:
            return "\n".join([*lines, *problem_lines(self.again.problems), nothing_scored(self.again.problems)])
        if self.same:
            lines.append(f"reproduced to the last digit: every value of {self.saved.scored} {count}")
        else:
            lines.append(f"NOT reproduced: {self._extent()}\n")
            lines.append(_table("score", self.scores[:_SHOWN]))
            if len(self.scores) > _SHOWN:
                lines.append(f"and {len(self.scores) - _SHOWN} more values")
        if self.conditions:
            effect = "what differs besides, without effect on a score" if self.same else "what differs besides"
            lines.append(f"\n{effect}:\n\n{_table('condition', self.conditions)}")
        elif not self.same:
            lines.append(
                "\nNothing else that is stated differs. So the predictions or the dataset's files are not those "
                "that were scored: eldata verify --level full checks the files."
            )
        return "\n".join(lines)

    def _extent(self) -> str:
        units = {one.where.rpartition(": ")[0] for one in self.scores}
        parts = [f"{len(units)} of {counted(len({*_names(self.saved), *_names(self.again)}), self.saved.kind.unit)}"]
        for metric in self.saved.kind.metrics:
            values = [one for one in self.scores if one.where.endswith(f": {metric.name}")]
            gaps = [abs(one.found - one.saved) for one in values if None not in (one.saved, one.found)]
            if gaps:
                parts.append(f"{metric.name} by up to {max(gaps):.3g}")
        return ", ".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain JSON types, with the result that was found."""
        return {
            "source": self.saved.source,
            "reproduced": self.same,
            "scores": [asdict(one) for one in self.scores],
            "conditions": [asdict(one) for one in self.conditions],
            "again": self.again.as_dict(),
        }


def reproduce(
    result: EvaluationResult | Path | str,
    *,
    predictions: Path | str | None = None,
    root: Path | str | None = None,
    manifest: Path | str | None = None,
    dark_shading: Path | str | None = None,
    task: Task | TaskFunction | str | None = None,
    store: Path | str | None = None,
    workers: AnyWorkers = 1,
) -> Reevaluation:
    """Evaluate again as a saved result states, on the data at hand, and tell what differs.

    Protocol, choice of pairs and task are the result's. The protocol is the one that it states field by field, whatever
    this version calls by that name.

    Parameters
    ----------
    result
        Of :func:`eldata.evaluate`, or the file that it was written to, with one protocol.
    predictions
        Where the predictions lie now; by default where they lay.
    root, manifest, dark_shading, task, store, workers
        As :func:`eldata.evaluate` has them. A result that is of corrected inputs, or of a set of your own, needs
        ``dark_shading`` or ``manifest``. Its task is the function that it names, unless ``task`` is
        given, which an object with a state needs.

    Raises
    ------
    FileError
        If the file is not a result.
    ArgumentError
        If it holds several protocols' results, this version cannot score as it states, or something that it needs is
        not given.
    EldataError, DatasetError, ManifestError
        Like :func:`eldata.evaluate`.
    """
    if not isinstance(result, EvaluationResult):
        found = load_results(result)
        if len(found) > 1:
            names = ", ".join(one.protocol.name for one in found)
            raise ArgumentError(f"{result} holds results of several protocols ({names}); give one of load_results(...)")
        (result,) = found
    if not result.scores:
        raise ArgumentError(f"{result.source}: nothing was scored, so there is nothing to hold against")
    _check_known(result, manifest)
    protocol, options = _asked(result)
    options |= {"root": root, "manifest": manifest, "store": store, "workers": workers}
    options |= {"dark_shading": dark_shading, "task": _task(result, task)}
    options |= {"allow_missing": bool(result.missing), "exclude_flags": tuple(_stated(result, "excluded_flags"))}
    place = stated_predictions(result) if predictions is None else Path(predictions)
    if place is None:
        options["baseline"] = "input"
    request = make_request(place, result.dataset, protocol, options)
    (again,) = perform(request).results
    return Reevaluation(result, again, _score_differences(result, again), _condition_differences(result, again))


def _check_known(result: EvaluationResult, manifest: Path | str | None) -> None:
    if manifest is None and result.dataset not in known_names():
        raise ArgumentError(
            f"{result.source} is of {result.dataset!r}, which is not a set that eldata knows; give its manifest with "
            "--manifest (manifest=...)"
        )


def _asked(result: EvaluationResult) -> tuple[Protocol, EvaluationOptions]:
    """Return the protocol and the choice of pairs of a result that was read back."""
    chosen = result.provenance.get("cameras", "all")
    options: EvaluationOptions = {"cameras": None if chosen == "all" else chosen}
    ids = result.provenance.get("ids")
    if ids is not None:
        options["ids"] = ids
    else:
        options["subset"] = result.provenance.get("subset")
    return protocol_of(result), options


def _stated(result: EvaluationResult, name: str) -> dict[str, Any]:
    found = result.provenance.get(name)
    return found if isinstance(found, dict) else {}


def _task(result: EvaluationResult, given: Task | TaskFunction | str | None) -> Task | None:
    stated = _stated(result, "task")
    if not stated:
        if given is not None:
            raise ArgumentError(f"{result.source} has no task; leave --task (task=...) out")
        return None
    if given is not None:
        return Task.of(given)
    found = Task.of(str(stated["callable"]))
    as_stated = {name: stated[name] for name in ("label", "images", "higher_is_better")}
    return replace(found, **as_stated, frames=stated.get("frames", 1))


# --- what differs -----------------------------------------------------------------------------------------------------


def _names(result: EvaluationResult) -> list[str]:
    return [score.name for score in result.scores]


def _score_differences(saved: EvaluationResult, again: EvaluationResult) -> tuple[ChangedValue, ...]:
    before, after = ({score.name: _values(score) for score in one.scores} for one in (saved, again))
    found = []
    for name in dict.fromkeys((*before, *after)):
        first, second = before.get(name, {}), after.get(name, {})
        for value in dict.fromkeys((*first, *second)):
            one, other = first.get(value), second.get(value)
            if repr(one) != repr(other):  # NaN is NaN
                found.append(ChangedValue(f"{name}: {value}", one, other))
    return tuple(found)


def _values(score: UnitScore) -> dict[str, float]:
    """Return every value of a score by its name; of a clip those of its frames too."""
    frames = {
        f"{frame.path} {name}": float(getattr(frame, name))
        for frame in score.frames
        for name in ("psnr_db", "ssim", "rescale")
    }
    return {name: float(value) for name, value in score.values.items()} | frames


def _condition_differences(saved: EvaluationResult, again: EvaluationResult) -> tuple[ChangedValue, ...]:
    before, after = saved.provenance, again.provenance
    return tuple(
        ChangedValue(name, before.get(name), after.get(name))
        for name in dict.fromkeys((*before, *after))
        if name != "predictions" and before.get(name) != after.get(name)  # where they lay decides no score
    )


def _table(what: str, differences: tuple[ChangedValue, ...]) -> str:
    rows = [[one.where, _shown(one.saved), _shown(one.found)] for one in differences]
    return text_table([what, "was", "is"], rows)


def _shown(value: Any) -> str:
    return "nothing" if value is None else repr(value) if isinstance(value, float) else shown(value, 80).strip("'")


# --- one part of it ---------------------------------------------------------------------------------------------------


def protocol_of(result: EvaluationResult) -> Protocol:
    """Return the protocol of a result, of one that was read back as this version has it.

    Raises
    ------
    ArgumentError
        If this version scores differently from what the result states.
    """
    stated = result.protocol
    if isinstance(stated, Protocol):
        return stated
    kind = ClipProtocol if result.kind.is_of_clips else Protocol
    fields: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in stated.fields.items()
        if name in kind.__dataclass_fields__
    }
    try:
        found = kind(**fields)
    except TypeError:
        found = None
    if found is None or found.digest != stated.digest:
        raise ArgumentError(
            f"{result.source}: its protocol {stated.name!r} is of another version of eldata, which may have scored "
            "otherwise; score again with eldata evaluate --json, or with that version"
        )
    return found


def units_again(
    result: EvaluationResult, *, manifest: Path | None = None, root: Path | None = None
) -> tuple[FrameFiles, dict[str, Pair]]:
    """Return the dataset's folder, and the pairs of a result that was read back, by their paths.

    Parameters
    ----------
    result
        Read back.
    manifest
        The manifest's file; by default that of the dataset that the result names.
    root
        The folder above the dataset's.

    Raises
    ------
    ArgumentError
        If the manifest is not the one that the scores are of.
    ManifestError, DatasetError
        If it is malformed, or the dataset is not there.
    """
    _check_known(result, manifest)
    protocol, options = _asked(result)
    options |= {"root": root, "manifest": manifest}
    # Which pairs there are does not depend on what was taken off their inputs.
    request = make_request(Path(), result.dataset, _plain(protocol), options)
    stated = result.provenance["manifest_sha256"]
    if request.manifest.digest != stated:
        raise ArgumentError(
            f"{request.manifest.path} is not the manifest that {result.source} was scored with ({stated[:15]}, this "
            f"is {request.manifest.digest[:15]}); give that one with --manifest"
        )
    require_folder(request)
    return request.files, {pair.path: pair for pair in plan_scoring(request, _plain(protocol)).pairs}


def _plain(protocol: Protocol) -> Protocol:
    return replace(protocol, dark_shading=NO_SHADING)


def stated_predictions(result: EvaluationResult) -> Path | None:
    """Return the folder of predictions that a result states; ``None``: the noisy input itself."""
    stated = str(result.provenance.get("predictions", ""))
    return None if stated == THE_INPUT else Path(stated)
