"""A request for an evaluation, with its names resolved, and the pairs of the set that its protocol scores.

A request is made once, by a public function or the command line, and passed on whole.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eldata.base.fields import TextFile
from eldata.base.files import inside
from eldata.base.workers import IN_THIS_PROCESS, AnyWorkers, Workers
from eldata.errors import ArgumentError, DatasetError, EldataError
from eldata.evaluation.tasks import Task
from eldata.manifest.card import find_subset
from eldata.manifest.catalogue import FrameFiles, Manifest, find_manifest, shipped_manifest, shipped_names
from eldata.manifest.clips import choose_clips, clip_place, clips_of, windows
from eldata.manifest.layouts import describe_layout
from eldata.manifest.pair_checks import white_remarks
from eldata.manifest.pairs import Choice, as_values, unpaired
from eldata.manifest.patterns import expand, is_pattern, is_png
from eldata.manifest.verify import check_files
from eldata.metrics.registry import IMAGES, Kind
from eldata.noise.dark_shading import DarkShading, dark_shading_in
from eldata.protocols.named import PROTOCOLS, default_protocol, get_protocol, protocols_for
from eldata.protocols.protocol import NO_SHADING, OWN_SEQUENCES, ClipProtocol, Protocol
from eldata.protocols.words import FIELDS, in_words

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from eldata.evaluation.scores import Pair
    from eldata.evaluation.tasks import TaskFunction
    from eldata.manifest.verify_report import Level
    from eldata.raw.levels import MeanLevels
    from eldata.records import FrameRecord

Baseline = Literal["input"]

OF_CLIPS = "--clip ID (in Python ids=[...])"
"""The option that chooses clips, in messages: the commands that predict have another use for ``--clip``."""

SETTINGS = "predictions.json"
"""The file in which eldata baseline and eldata predict state how they made a folder of predictions."""

# How long scoring a pair takes, for itself and for each byte of its input; and what two workers take to start.
_PAIR_S, _BYTE_S, _WORTH_S = 3e-3, 20e-9, 1.3


@dataclass(frozen=True, slots=True)
class Request:
    """A request for an evaluation, with names resolved; the options are as for :func:`eldata.evaluate`.

    Attributes
    ----------
    manifest, folder
        The dataset's manifest, and its folder.
    predictions
        Their folder; ``None`` for the baseline.
    protocol
        How to score.
    task
        One of the user's own; ``None``: none.
    dark_shading
        The file of the dark shading that inputs are corrected with, whose digest the protocol states; ``None``: none.
    """

    manifest: Manifest
    folder: Path
    predictions: Path | None
    protocol: Protocol
    cameras: Collection[str] | None
    subset: str | None
    ids: Collection[str] | None
    exclude_flags: Collection[str]
    allow_missing: bool
    strict: bool
    task: Task | None
    dark_shading: Path | None
    workers: Workers

    @property
    def kind(self) -> Kind:
        """Images or clips."""
        return self.protocol.kind

    @property
    def files(self) -> FrameFiles:
        """The set's files, with what its card states of them."""
        return FrameFiles.of(self.folder, self.manifest.card, self.manifest.records)

    def workers_for(self, pairs: Collection[Pair]) -> Workers:
        """Choose the workers that score some pairs: this process alone where starting others would take longer."""
        if self.workers.executor is not None or self.kind is not IMAGES or self.task is not None:
            return self.workers
        seconds = _PAIR_S * len(pairs)
        for pair in pairs:
            if seconds > _WORTH_S:
                break
            with suppress(OSError):  # what is not there is found when it is looked for
                seconds += _BYTE_S * inside(self.folder, pair.path).stat().st_size
        return self.workers if seconds > _WORTH_S else IN_THIS_PROCESS


def make_request(
    predictions: Path | str | None, dataset: str, protocol: str | Path | Protocol | None, *,
    root: Path | str | None = None, manifest: Path | str | None = None, cameras: Collection[str] | None = None,
    subset: str | None = None, ids: Collection[str] | None = None, exclude_flags: Collection[str] = (),
    allow_missing: bool = False, baseline: Baseline | None = None, strict: bool = False,
    task: Task | TaskFunction | str | None = None, dark_shading: Path | str | None = None, workers: AnyWorkers = 1,
) -> Request:  # fmt: skip
    """Return a request; everything that can be told without the dataset's files is checked.

    The arguments are as for :func:`eldata.evaluate`.

    Raises
    ------
    ManifestError, ArgumentError
        If the manifest is malformed, a name is unknown, or options do not go together.
    """
    known = find_manifest(dataset if manifest is None else manifest, root)
    folder = known.folder(root)
    request = Request(
        manifest=known.of_copy(folder),
        folder=folder,
        predictions=None if predictions is None else Path(predictions),
        protocol=_state_shading(_choose_protocol(protocol, known), dark_shading),
        cameras=as_values(cameras),
        subset=subset,
        ids=as_values(ids),
        exclude_flags=as_values(exclude_flags) or (),
        allow_missing=allow_missing,
        strict=strict,
        task=None if task is None else Task.of(task),
        dark_shading=None if dark_shading is None else Path(dark_shading).absolute(),
        workers=Workers.of(workers),
    )
    if baseline not in (None, "input"):
        raise ArgumentError(f"baseline must be 'input'; found {baseline!r}")
    if (predictions is None) == (baseline is None):
        raise ArgumentError("give a folder of predictions or a baseline, and not both")
    if request.kind is IMAGES and request.ids is not None:
        raise ArgumentError(f"{OF_CLIPS} is for datasets of clips, such as drv")
    if request.subset is not None and request.ids is not None:
        raise ArgumentError("give a subset or ids, not both")
    chosen = request.protocol
    if predictions is None and chosen.pixels == "srgb" and not chosen.is_of_packed:
        raise ArgumentError(f"protocol {chosen.name!r} scores renderings, so the raw input is not a baseline of it")
    if request.predictions is not None:
        _check_inputs(request, request.predictions)
    if request.task is not None:
        _check_task(request, request.task)
    return request


def is_own(manifest: Manifest) -> bool:
    """Tell whether a set is the user's own: not shipped with the package, and without a protocol of clips."""
    default = default_protocol(manifest.card)
    return manifest.name not in shipped_names() and (default.kind is IMAGES or not default.covers(manifest.name))


def _choose_protocol(protocol: str | Path | Protocol | None, manifest: Manifest) -> Protocol:
    """Return the protocol to score with, which has to be for the dataset.

    A set of one's own may be scored by any protocol of images, and as sequences.
    """
    default, owned = default_protocol(manifest.card), is_own(manifest)
    if isinstance(protocol, (str, Path)):
        protocol = get_protocol(protocol, manifest.name, own=owned)
    chosen = protocol or default
    chosen.check()
    if owned and (chosen.kind is IMAGES or chosen.dataset == OWN_SEQUENCES):
        return chosen
    if chosen.kind is default.kind and chosen.covers(manifest.name):
        return chosen
    wrong = f"is for dataset {chosen.dataset!r}, not {manifest.name!r}"
    if chosen.kind is not default.kind:
        wrong = f"scores {chosen.kind.units}, and {manifest.name!r} is a dataset of {default.kind.units}"
    own = ", ".join(known.name for known in protocols_for(manifest.name))
    raise ArgumentError(f"protocol {chosen.name!r} {wrong}; its protocols are {own}")


def _state_shading(protocol: Protocol, shading: Path | str | None) -> Protocol:
    """State the inputs' dark shading in the protocol; one that states its own takes no other."""
    digest = NO_SHADING if shading is None else dark_shading_in(Path(shading).absolute()).digest
    if protocol.dark_shading not in (NO_SHADING, digest):
        found = "none was given" if shading is None else f"{shading} is {digest}"
        raise ArgumentError(
            f"protocol {protocol.name!r} is of inputs less the dark shading {protocol.dark_shading}, and {found}: give "
            "that one with --dark-shading (dark_shading=...)"
        )
    return replace(protocol, dark_shading=digest)


def stated_setting(folder: Path, name: str) -> str | None:
    """Read a setting from a folder's own file, which says how its predictions were made; None without such a file.

    ``dark_shading`` is the digest of what was subtracted from the inputs, or ``"none"``.
    """
    file = folder / SETTINGS
    if not file.is_file():
        return None
    try:
        stated = TextFile(file, EldataError, "predict again into a new folder").json().data.get(name)
    except EldataError:  # another program's: ours is written whole or not at all
        return None
    return stated if isinstance(stated, str) else None


def _check_inputs(request: Request, folder: Path) -> None:
    """Check that the folder's own file, which states the predictions' inputs, does not contradict the request."""
    protocol = request.protocol
    if protocol.is_of_packed and protocol.pixels == "srgb":
        for name in ("input_space", "response"):
            stated, wanted = stated_setting(folder, name), in_words(name, getattr(protocol, name))
            if stated not in (None, wanted):
                raise ArgumentError(
                    f"{folder / SETTINGS} says of these predictions {FIELDS[name][0]}: {stated}, and protocol "
                    f"{protocol.name!r} has {wanted} ({name}); give the protocol that they were made under"
                )
    stated, digest = stated_setting(folder, "dark_shading"), protocol.dark_shading
    if stated in (None, digest):
        return
    said, advice = f"inputs less the dark shading {stated}", "give that one with --dark-shading"
    if stated == NO_SHADING:
        said, advice = "inputs as they are", "leave --dark-shading (dark_shading) out"
    found = "none was given" if request.dark_shading is None else f"{request.dark_shading} is {digest}"
    raise ArgumentError(f"{folder / SETTINGS} says that these predictions are of {said}, and {found}: {advice}")


def _check_task(request: Request, task: Task) -> None:
    """Check that a task can have the images that it wants, and that the workers can have it."""
    protocol = request.protocol
    possible = {"packed": ("compared", "packed", "srgb"), "srgb": ("compared", "srgb")}
    if task.images not in possible.get(protocol.pixels, ("compared",)):
        wanted = {"packed": "packed raw images", "srgb": "renderings in sRGB"}[task.images]
        raise ArgumentError(
            f"the task {task.place} wants {wanted}, which predictions under protocol {protocol.name!r} do not have; "
            "give a protocol that takes packed raw predictions, such as eld or sid"
        )
    if request.workers.executor is None and request.workers.jobs > 1:
        task.check_transportable()


# --- the pairs that are scored ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ScoringPlan:
    """The pairs that a protocol scores here.

    Attributes
    ----------
    pairs
        Pairs of frames in the manifest's order, or windows of clips.
    facts
        What of the choice the provenance states, such as the subset on the card, and how many pairs were left out for
        each of the flags asked for. ``set_aside``: what of the protocol's own choice of pairs was not applied, in
        words, because the set is the user's own.
    """

    pairs: tuple[Pair, ...]
    facts: dict[str, Any] = field(default_factory=dict)


def list_places(request: Request) -> list[str]:
    """Return the places of predictions of all noisy frames of the dataset."""
    noisy = [record for record in request.manifest.records if record.role == "noisy"]
    if request.kind is IMAGES:
        return [record.path for record in noisy]
    return [clip_place(row.scene, row.path) for row in expand(noisy, request.folder)]


def list_places_elsewhere(request: Request) -> dict[str, list[str]]:
    """Return the places of predictions of other sets of images that come with the package, by the sets' names.

    One folder may hold those of several, such as of SID's two cameras. Of a set of your own every prediction that is
    not its own is a mistake.
    """
    if is_own(request.manifest) or request.kind is not IMAGES:
        return {}
    others = [name for name in shipped_names() if name != request.manifest.name]
    return {
        manifest.name: [record.path for record in manifest.records if record.role == "noisy"]
        for manifest in map(shipped_manifest, others)
        if default_protocol(manifest.card).kind is IMAGES
    }


def plan_scoring(request: Request, *, unscored: bool = False) -> ScoringPlan:
    """Return the pairs to score; with ``unscored`` also pairs to predict only, of a subset without references.

    Of a set that comes with the package these are the protocol's pairs or clips. A set of the user's own has its own
    pairs: those at the protocol's factors if it has every one of them, else all; of a protocol of the user's own those
    of its cameras, scenes and subset too.

    Raises
    ------
    ArgumentError
        If a name is unknown, nothing is left, or the dark shading does not fit the inputs.
    ManifestError
        If a subset has not as many pairs as its card says.
    DatasetError
        If the files of clips are not there, or not what the manifest says.
    """
    protocol = request.protocol
    if isinstance(protocol, ClipProtocol):
        plan = _plan_clips(request, protocol)
    else:
        plan = _plan_images(request, protocol, unscored)
    if request.dark_shading is not None:
        _check_shading(protocol, plan.pairs, dark_shading_in(request.dark_shading))
    return plan


def _check_shading(protocol: Protocol, pairs: Sequence[Pair], shading: DarkShading) -> None:
    """Refuse a dark shading that cannot fit all inputs, as far as the manifest knows them."""
    if protocol.pixels == "rgb":
        raise ArgumentError(
            f"protocol {protocol.name!r} scores preprocessed RGB, whose dark shading nobody can take off; leave "
            "--dark-shading (dark_shading) out"
        )
    cameras = list(dict.fromkeys(pair.camera for pair in pairs))
    if len(cameras) > 1:
        raise ArgumentError(
            f"the dark shading of {shading.camera} is of one body, and {len(cameras)} cameras are scored: "
            f"{', '.join(cameras)}; choose one with --camera (cameras)"
        )
    for iso in sorted({float(pair.iso) for pair in pairs if pair.iso}):
        shading.measured(iso)


# --- images -----------------------------------------------------------------------------------------------------------


def _plan_images(request: Request, protocol: Protocol, unscored: bool) -> ScoringPlan:
    """Choose the pairs to score, and state their subset, ratios and flags."""
    records, subsets = request.manifest.records, request.manifest.card.subsets
    set_aside: list[str] = []
    if is_own(request.manifest):
        protocol, set_aside = _set_choice_aside(request, protocol)
    _check_choice(request, protocol)
    subset = protocol.subset or request.subset or (subsets[0].name if subsets else None)
    if unscored and subset is not None:
        alone = unpaired(records, find_subset(subsets, subset))
        records = tuple(replace(record, reference="") for record in alone) or records
    choice = Choice(
        cameras=(protocol.cameras or None) if request.cameras is None else request.cameras,
        scenes=protocol.scenes or None,
        ratios=protocol.ratios or None,
        subset=subset,
    )
    candidates = choice.pairs(records, subsets)
    pairs = replace(choice, exclude_flags=request.exclude_flags).pairs(records, subsets)
    ratios = sorted({float(pair.ratio) for pair in pairs if not is_pattern(pair.path)})
    facts = {"subset": subset, "ratios": ratios, "set_aside": set_aside}
    flags = _count_flags(request, (pair.flags for pair in pairs), (pair.flags for pair in candidates))
    return ScoringPlan(pairs, facts | flags)


def _set_choice_aside(request: Request, protocol: Protocol) -> tuple[Protocol, list[str]]:
    """Drop the parts of a protocol's choice that do not apply to the user's own set; name them in words.

    A shipped protocol chooses cameras, scenes and subset of a published set, which are set aside. So they are in a file
    that has them from its base, unless the set has them all; what the file states itself is applied, or refused.
    """
    noisy = [record for record in request.manifest.records if record.role == "noisy"]
    known: dict[str, set[Any]] = {
        "cameras": {record.camera for record in noisy},
        "scenes": {record.scene for record in noisy},
        "subset": {subset.name for subset in request.manifest.card.subsets},
    }
    kept: dict[str, Any] = {}
    for name, values in known.items():
        chosen = getattr(protocol, name)
        bases = [base.name for base in PROTOCOLS.values() if getattr(base, name, None) == chosen]
        wanted = {chosen} if isinstance(chosen, str) else set(chosen or ())
        if protocol.name in bases or (bases and not wanted <= values):
            kept[name] = None if name == "subset" else ()
    if not {record.ratio for record in noisy}.issuperset(protocol.ratios):
        kept["ratios"] = ()
    words = {
        "cameras": f"cameras {', '.join(protocol.cameras)}",
        "scenes": f"{len(protocol.scenes)} scenes",
        "subset": f"subset {protocol.subset}",
        "ratios": f"factors {', '.join(f'x{ratio:g}' for ratio in protocol.ratios)}",
    }
    return replace(protocol, **kept), [words[name] for name in kept if getattr(protocol, name) != kept[name]]


def _check_choice(request: Request, protocol: Protocol) -> None:
    """Raise :class:`ArgumentError` if the user wants what the protocol does not score."""
    if protocol.subset is not None and request.subset not in (None, protocol.subset):
        raise ArgumentError(
            f"protocol {protocol.name!r} scores the subset {protocol.subset!r}, not {request.subset!r}; leave the "
            "subset out"
        )
    known = request.manifest.card.cameras
    unscored = [name for name in request.cameras or () if name not in protocol.cameras and name in known]
    if protocol.cameras and unscored:
        raise ArgumentError(
            f"protocol {protocol.name!r} scores {', '.join(protocol.cameras)}, not {', '.join(unscored)}"
        )


def _count_flags(
    request: Request, chosen: Iterable[tuple[str, ...]], candidates: Iterable[tuple[str, ...]]
) -> dict[str, dict[str, int]]:
    """Count the chosen pairs with each flag, and the candidates with each of the flags to leave out."""
    included, there = (Counter(flag for flags in each for flag in flags) for each in (chosen, candidates))
    excluded = {flag: there[flag] for flag in request.exclude_flags}
    return {"included_flags": dict(sorted(included.items())), "excluded_flags": excluded}


# --- clips ------------------------------------------------------------------------------------------------------------


def _plan_clips(request: Request, protocol: ClipProtocol) -> ScoringPlan:
    """Return the windows; the numbering of all frames of their clips is checked."""
    require_folder(request)
    manifest, subsets, subset = request.manifest, request.manifest.card.subsets, None
    if request.ids is None and subsets:
        subset = request.subset or subsets[0].name
    elif request.ids is None and not is_own(request.manifest):
        raise ArgumentError(f"{manifest.path}: its card names no subset; name the clips: {OF_CLIPS}")
    splits = {row.split for row in manifest.records if row.role == "reference"}
    paired, choice = [row for row in manifest.records if row.split in splits], Choice(request.cameras, subset=subset)
    candidates, rows = (
        choose_clips(paired, subsets, replace(choice, exclude_flags=flags), ids=request.ids)
        for flags in ((), request.exclude_flags)
    )
    check_rows(request, rows, "quick")
    listed = expand(rows, request.folder)
    found = tuple(
        window
        for clip in clips_of(listed)
        for length in (protocol.frame_count or len(clip.frames),)
        for window in windows(clip, length=length, stride=length, frames=protocol.frames)
    )
    for window in found:
        if window.reference is None:
            raise DatasetError(f"clip {window.scene}: has no reference, so it cannot be scored")
        if protocol.dataset == OWN_SEQUENCES and not window.references:
            raise ArgumentError(
                f"clip {window.scene}: is no sequence, whose moments are scenes such as scene-1-moment-3; protocol "
                f"{protocol.name!r} scores those. Choose others: {OF_CLIPS}"
            )
        if is_png(window.path) != (protocol.pixels == "rgb"):
            raise ArgumentError(f"{window.path}: protocol {protocol.name!r} scores {protocol.pixels} frames")
    ids = None if request.ids is None else sorted(request.ids)
    flags = ({row.scene: row.flags for row in each if row.role == "noisy"}.values() for each in (rows, candidates))
    facts = {"subset": subset, "ids": ids, "layout": describe_layout(listed)}
    return ScoringPlan(found, facts | _count_flags(request, *flags))


# --- the files --------------------------------------------------------------------------------------------------------


def require_folder(request: Request) -> None:
    """Raise :class:`DatasetError` unless the dataset is there."""
    if not request.folder.is_dir():
        raise DatasetError(
            f"{request.folder}: the dataset is not there; name the folder above it with --root (root=...). Where to "
            f"get it: {request.manifest.card.homepage}"
        )


def require_pairs(request: Request, pairs: Iterable[Pair]) -> tuple[FrameFiles, tuple[str, ...], dict[str, str]]:
    """Check the files of these pairs; return their frames' source, remarks on white levels, unusable files by path.

    Raise :class:`DatasetError` unless the manifest means them. Files are unusable that are missing or damaged, if the
    request allows that.
    """
    needed = {path for pair in pairs for path in pair.files}
    rows = [row for row in request.manifest.records if row.role in ("noisy", "reference")]
    require_folder(request)
    listed = rows if request.kind is IMAGES else expand(rows, request.folder)
    chosen, files = [row for row in listed if row.path in needed], request.files.absolute()
    unusable: dict[str, str] = {}
    levels_dn = check_rows(request, chosen, "metadata", unusable if request.allow_missing else None)
    if not (request.protocol.is_of_packed and request.protocol.levels == "metadata"):
        return files, (), unusable
    there, cameras = [row for row in chosen if row.path not in unusable], request.manifest.card.cameras
    remarks = white_remarks(there, levels_dn, cameras, files, request.workers)
    return files, tuple(remark.sentence() for remark in remarks), unusable


def check_rows(
    request: Request, rows: Sequence[FrameRecord], level: Level, unusable: dict[str, str] | None = None
) -> dict[str, MeanLevels | None]:
    """Raise :class:`DatasetError` unless these rows' files are what the manifest says; return known levels by path.

    With ``unusable`` files that are missing or damaged are put there, in words by path, instead.
    """
    problems, _, _, levels_dn = check_files(
        request.manifest, request.folder, rows, level=level, workers=request.workers
    )
    if unusable is not None:
        lost = [problem for problem in problems if problem.field in ("file", "folder", "size_bytes", "content")]
        for problem in lost:
            unusable |= {row.path: str(problem) for row in rows if row.path.startswith(problem.path)}
        problems = tuple(problem for problem in problems if problem not in lost)
    if problems:
        more = f" (and {len(problems) - 1} more: eldata verify --level metadata lists all)" if len(problems) > 1 else ""
        raise DatasetError(f"{request.folder}: the dataset is not what its manifest says: {problems[0]}{more}")
    return levels_dn
