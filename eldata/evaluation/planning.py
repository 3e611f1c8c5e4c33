"""Which pairs of a set, or windows of its clips, a protocol scores, and whether their files are what they should be."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from eldata.errors import ArgumentError, DatasetError, ManifestError
from eldata.evaluation.pairs import Pair, clip_place, frames_of
from eldata.manifest.clip_checks import is_png
from eldata.manifest.clips import clips_of, select_rows, windows
from eldata.manifest.drv import Layout
from eldata.manifest.pairs import select_pairs
from eldata.manifest.patterns import expand
from eldata.manifest.subsets import find_subset
from eldata.manifest.verify import check_files
from eldata.protocols.clips import ClipProtocol
from eldata.protocols.kinds import IMAGES

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from eldata.evaluation.request import Request
    from eldata.manifest.verify import Level
    from eldata.protocols.protocol import Protocol
    from eldata.records import FrameRecord


@dataclass(frozen=True, slots=True)
class ScoringPlan:
    """A protocol and what it scores here.

    Attributes
    ----------
    protocol, pairs
        Pairs of frames in the manifest's order, or windows of clips.
    subset
        Name of the subset on the card that they are of, if any.
    excluded
        Number of pairs that were left out for each of the flags asked for.
    set_aside
        What of the protocol's own choice of pairs was not applied, in words, because the set is the user's own.
    facts
        What else of the choice the provenance states.
    """

    protocol: Protocol
    pairs: tuple[Pair, ...]
    subset: str | None
    excluded: dict[str, int]
    set_aside: tuple[str, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)


def known_places(request: Request) -> list[str]:
    """Return where predictions of any noisy frame of the dataset may lie."""
    noisy = [record for record in request.manifest.records if record.role == "noisy"]
    if request.kind is IMAGES:
        return [record.path for record in noisy]
    return [clip_place(row.scene, row.path) for row in expand(noisy, request.folder)]


def plan_scoring(request: Request, protocol: Protocol) -> ScoringPlan:
    """Return what a protocol scores.

    Of a set that comes with the package these are the protocol's pairs or clips. A set of the user's own has its own
    pairs: those at the protocol's factors if it has every one of them, else all.

    Raises
    ------
    ArgumentError
        If the protocol is for another dataset, a name is unknown, or nothing is left.
    ManifestError
        If a subset has not as many pairs as its card says.
    DatasetError
        If the files of clips are not there, or not what the manifest says.
    """
    name = request.manifest.name
    if not (request.is_own or protocol.covers(name)):
        raise ArgumentError(
            f"protocol {protocol.name!r} is for dataset {protocol.dataset!r}, not {name!r}; "
            "eldata protocols lists those for each"
        )
    if isinstance(protocol, ClipProtocol):
        return _clip_plan(request, protocol)
    return _own_plan(request, protocol) if request.is_own else _shipped_plan(request, protocol)


# --- images -----------------------------------------------------------------------------------------------------------


def _shipped_plan(request: Request, protocol: Protocol) -> ScoringPlan:
    if protocol.subset is not None and request.subset not in (None, protocol.subset):
        raise ArgumentError(
            f"protocol {protocol.name!r} scores the subset {protocol.subset!r}, not {request.subset!r}; leave the "
            "subset out"
        )
    cameras = request.cameras
    if protocol.cameras and cameras is not None:
        unscored = [name for name in cameras if name not in protocol.cameras and name in request.manifest.card.cameras]
        if unscored:
            raise ArgumentError(
                f"protocol {protocol.name!r} scores {', '.join(protocol.cameras)}, not {', '.join(unscored)}"
            )
    return _image_plan(
        request,
        protocol,
        cameras=cameras if cameras is not None else protocol.cameras or None,
        scenes=protocol.scenes or None,
        ratios=protocol.ratios or None,
        subset=protocol.subset or request.subset,
    )


def _own_plan(request: Request, protocol: Protocol) -> ScoringPlan:
    there = {record.ratio for record in request.manifest.records if record.role == "noisy"}
    has_all = bool(protocol.ratios) and all(ratio in there for ratio in protocol.ratios)
    set_aside = [f"cameras {', '.join(protocol.cameras)}"] if protocol.cameras else []
    if protocol.scenes:
        set_aside.append(f"{len(protocol.scenes)} scenes")
    if protocol.subset is not None:
        set_aside.append(f"subset {protocol.subset}")
    if protocol.ratios and not has_all:
        set_aside.append(f"factors {', '.join(f'x{ratio:g}' for ratio in protocol.ratios)}")
    return _image_plan(
        request,
        protocol,
        cameras=request.cameras,
        scenes=None,
        ratios=protocol.ratios if has_all else None,
        subset=request.subset,
        set_aside=tuple(set_aside),
    )


def _image_plan(
    request: Request,
    protocol: Protocol,
    *,
    cameras: Collection[str] | None,
    scenes: Collection[str] | None,
    ratios: Collection[float] | None,
    subset: str | None,
    set_aside: tuple[str, ...] = (),
) -> ScoringPlan:
    subsets = request.manifest.card.subsets
    chosen = find_subset(subsets, subset) if subset is not None else subsets[0] if subsets else None
    candidates, pairs = (
        select_pairs(
            request.manifest.records, cameras=cameras, scenes=scenes, ratios=ratios, subset=chosen, exclude_flags=flags
        )
        for flags in ((), request.exclude_flags)
    )
    there = _counted(pair.flags for pair in candidates)
    return ScoringPlan(
        protocol=protocol,
        pairs=pairs,
        subset=None if chosen is None else chosen.name,
        excluded={flag: there.get(flag, 0) for flag in request.exclude_flags},
        set_aside=set_aside,
        facts={
            "ratios": sorted({float(pair.ratio) for pair in pairs}),
            "set_aside": list(set_aside),
            "included_flags": _counted(pair.flags for pair in pairs),
        },
    )


def _counted(flags: Iterable[tuple[str, ...]]) -> dict[str, int]:
    """Return how many have each flag."""
    return dict(sorted(Counter(flag for of in flags for flag in of).items()))


# --- clips ------------------------------------------------------------------------------------------------------------


def _clip_plan(request: Request, protocol: ClipProtocol) -> ScoringPlan:
    """Return the windows; the numbering of all frames of their clips is checked."""
    require_folder(request)
    subset, rows = _clip_rows(request)
    for name, wanted, known in (
        ("camera", request.cameras, {row.camera for row in rows}),
        ("flag", request.exclude_flags, {flag for row in rows for flag in row.flags}),
    ):
        if isinstance(wanted, str):
            raise ArgumentError(f"give {name} values as a list: [{wanted!r}]")
        for value in wanted or ():
            if value not in known:
                raise ArgumentError(f"no clip has {name} {value!r}; known are {', '.join(sorted(known)) or 'none'}")
    rows = tuple(row for row in rows if request.cameras is None or row.camera in request.cameras)
    flags_of = {row.scene: row.flags for row in rows if row.role == "noisy"}
    kept = {scene: flags for scene, flags in flags_of.items() if not set(flags) & set(request.exclude_flags)}
    if not kept:
        raise ArgumentError("no clip is left of the wanted subset, ids, cameras and flags")
    rows = tuple(row for row in rows if row.scene in kept)
    check_rows(request, rows, "quick")
    listed = expand(rows, request.folder)
    found = tuple(
        window
        for clip in clips_of(listed)
        for window in windows(clip, length=protocol.frame_count, stride=protocol.frame_count, frames=protocol.frames)
    )
    for window in found:
        if window.reference is None:
            raise DatasetError(f"clip {window.scene}: has no reference, so it cannot be scored")
        if is_png(window.path) != (protocol.pixels == "rgb"):
            raise ArgumentError(f"{window.path}: protocol {protocol.name!r} scores {protocol.pixels} frames")
    ids = None if request.ids is None else sorted(request.ids)
    facts = {"ids": ids, "layout": str(Layout.of(listed)), "included_flags": _counted(kept.values())}
    there = _counted(flags_of.values())
    return ScoringPlan(
        protocol, found, subset, {flag: there.get(flag, 0) for flag in request.exclude_flags}, facts=facts
    )


def _clip_rows(request: Request) -> tuple[str | None, tuple[FrameRecord, ...]]:
    """Return the rows of the clips that are chosen, and the subset's name."""
    manifest, subsets = request.manifest, request.manifest.card.subsets
    if request.ids is not None:
        splits = {row.split for row in manifest.records if row.role == "reference"}
        return None, select_rows(manifest.records, splits=sorted(splits), ids=request.ids)
    if not subsets:
        raise ArgumentError(f"{manifest.path}: its card names no subset; name the clips with ids")
    chosen = subsets[0] if request.subset is None else find_subset(subsets, request.subset)
    rows = select_rows(manifest.records, splits=chosen.splits, ids=None)
    clips = {row.scene for row in rows if row.role == "noisy"}
    if len(clips) != chosen.pairs:
        raise ManifestError(
            f"subset {chosen.name!r} has {chosen.pairs} clips, the manifest {len(clips)} of them; score those with ids"
        )
    return chosen.name, rows


# --- the files --------------------------------------------------------------------------------------------------------


def require_folder(request: Request) -> None:
    """Raise :class:`DatasetError` unless the dataset is there."""
    if not request.folder.is_dir():
        raise DatasetError(
            f"{request.folder}: the dataset is not there; name the folder above it with --root (root=...). Where to "
            f"get it: {request.manifest.card.homepage}"
        )


def require_pairs(request: Request, pairs: Iterable[Pair]) -> None:
    """Raise :class:`DatasetError` unless the files of these pairs are what the manifest says."""
    require_folder(request)
    needed = {path for pair in pairs for path in (*frames_of(pair), pair.reference)}
    rows = [row for row in request.manifest.records if row.role in ("noisy", "reference")]
    listed = rows if request.kind is IMAGES else expand(rows, request.folder)
    check_rows(request, [row for row in listed if row.path in needed], "metadata")


def check_rows(request: Request, rows: Sequence[FrameRecord], level: Level) -> None:
    """Raise :class:`DatasetError` unless the files of these rows are what the manifest says."""
    problems, _ = check_files(request.manifest, request.folder, rows, level=level, workers=request.workers)
    if problems:
        more = f" (and {len(problems) - 1} more: eldata verify --level metadata lists all)" if len(problems) > 1 else ""
        raise DatasetError(f"{request.folder}: the dataset is not what its manifest says: {problems[0]}{more}")
