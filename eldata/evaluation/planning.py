"""Which pairs of a set, or windows of its clips, a protocol scores, and whether their files are what they should be."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from eldata.errors import ArgumentError, DatasetError
from eldata.evaluation.request import OF_CLIPS
from eldata.manifest.card import find_subset
from eldata.manifest.catalogue import shipped_manifest, shipped_names
from eldata.manifest.clips import choose_clips, clip_place, clips_of, windows
from eldata.manifest.drv import Layout
from eldata.manifest.pair_checks import white_remarks
from eldata.manifest.pairs import Choice, select_pairs, unpaired
from eldata.manifest.patterns import expand, is_png
from eldata.manifest.verify import check_files
from eldata.noise.dark_shading import dark_shading_in
from eldata.protocols.kinds import IMAGES
from eldata.protocols.named import PROTOCOLS, default_protocol
from eldata.protocols.protocol import OWN_SEQUENCES, ClipProtocol

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from eldata.evaluation.request import Request
    from eldata.evaluation.scores import Pair
    from eldata.manifest.catalogue import FrameFiles
    from eldata.manifest.verify_report import Level
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Protocol
    from eldata.raw.levels import MeanLevels
    from eldata.records import FrameRecord


@dataclass(frozen=True, slots=True)
class ScoringPlan:
    """What a protocol scores here.

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


def known_places(request: Request) -> list[str]:
    """Return where predictions of any noisy frame of the dataset may lie."""
    noisy = [record for record in request.manifest.records if record.role == "noisy"]
    if request.kind is IMAGES:
        return [record.path for record in noisy]
    return [clip_place(row.scene, row.path) for row in expand(noisy, request.folder)]


def places_elsewhere(request: Request) -> dict[str, list[str]]:
    """Return where predictions of other sets of images may lie that come with the package, by the sets' names.

    One folder may hold those of several, such as of SID's two cameras. Of a set of your own every prediction that is
    not its own is a mistake.
    """
    if request.is_own or request.kind is not IMAGES:
        return {}
    others = [name for name in shipped_names() if name != request.manifest.name]
    return {
        manifest.name: [record.path for record in manifest.records if record.role == "noisy"]
        for manifest in map(shipped_manifest, others)
        if default_protocol(manifest.card).kind is IMAGES
    }


def plan_scoring(request: Request, *, unscored: bool = False) -> ScoringPlan:
    """Return what is scored; with ``unscored`` also what is only to be predicted, a subset without references.

    Of a set that comes with the package these are the protocol's pairs or clips. A set of the user's own has its own
    pairs: those at the protocol's factors if it has every one of them, else all; of a protocol of the user's own those
    of its cameras, scenes and subset too.

    Raises
    ------
    ArgumentError
        If the protocol is for another dataset, a name is unknown, nothing is left, or the dark shading is not that of
        the inputs.
    ManifestError
        If a subset has not as many pairs as its card says.
    DatasetError
        If the files of clips are not there, or not what the manifest says.
    """
    name, protocol = request.manifest.name, request.protocol
    for_own = protocol.kind is IMAGES or protocol.dataset == OWN_SEQUENCES
    if not ((request.is_own and for_own) or protocol.covers(name)):
        raise ArgumentError(
            f"protocol {protocol.name!r} is for dataset {protocol.dataset!r}, not {name!r}; "
            "eldata protocols lists those for each"
        )
    if isinstance(protocol, ClipProtocol):
        plan = _clip_plan(request, protocol)
    else:
        plan = _image_plan(request, protocol, unscored)
    if request.dark_shading is not None:
        _check_shading(protocol, plan.pairs, dark_shading_in(request.dark_shading))
    return plan


def _check_shading(protocol: Protocol, pairs: Sequence[Pair], shading: DarkShading) -> None:
    """Raise :class:`ArgumentError` unless a dark shading can be that of all inputs, as far as the manifest knows."""
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


def _image_plan(request: Request, protocol: Protocol, unscored: bool) -> ScoringPlan:
    records, subsets = request.manifest.records, request.manifest.card.subsets
    set_aside: list[str] = []
    choice = protocol
    if request.is_own:
        choice = _choice_of_own(request, protocol)
        set_aside = _set_aside(protocol, choice)
    _check_choice(request, choice)
    cameras = choice.cameras or None if request.cameras is None else request.cameras
    scenes, ratios, subset = choice.scenes or None, choice.ratios, choice.subset or request.subset
    if subset is None and subsets:
        subset = subsets[0].name
    if unscored and subset is not None:
        alone = unpaired(records, find_subset(subsets, subset))
        records = tuple(replace(one, reference="") for one in alone) or records
    choose = partial(
        select_pairs, records, subsets, cameras=cameras, scenes=scenes, ratios=ratios or None, subset=subset
    )
    candidates, pairs = choose(), choose(exclude_flags=request.exclude_flags)
    facts = {
        "subset": subset,
        "ratios": sorted({float(pair.ratio) for pair in pairs}),
        "set_aside": set_aside,
        "included_flags": _counted(pair.flags for pair in pairs),
        "excluded_flags": _excluded(request, (pair.flags for pair in candidates)),
    }
    return ScoringPlan(pairs, facts)


def _choice_of_own(request: Request, protocol: Protocol) -> Protocol:
    """Return the protocol with what it chooses of a set of the user's own.

    A shipped protocol chooses cameras, scenes and subset of a published set, which are set aside. So they are in a file
    that has them from its base, unless the set has them all; what the file states itself is applied, or refused.
    """
    noisy = [record for record in request.manifest.records if record.role == "noisy"]
    subsets = {subset.name for subset in request.manifest.card.subsets}
    there = {"cameras": {one.camera for one in noisy}, "scenes": {one.scene for one in noisy}, "subset": subsets}
    kept: dict[str, Any] = {}
    for name, known in there.items():
        chosen = getattr(protocol, name)
        bases = [base.name for base in PROTOCOLS.values() if getattr(base, name, None) == chosen]
        wanted = {chosen} if isinstance(chosen, str) else set(chosen or ())
        if protocol.name in bases or (bases and not wanted <= known):
            kept[name] = None if name == "subset" else ()
    ratios = {record.ratio for record in noisy}
    return replace(protocol, **kept, ratios=protocol.ratios if ratios.issuperset(protocol.ratios) else ())


def _set_aside(protocol: Protocol, choice: Protocol) -> list[str]:
    """Return which of a protocol's choices a set of the user's own sets aside."""
    found = [f"cameras {', '.join(protocol.cameras)}"] if choice.cameras != protocol.cameras else []
    if choice.scenes != protocol.scenes:
        found.append(f"{len(protocol.scenes)} scenes")
    if choice.subset != protocol.subset:
        found.append(f"subset {protocol.subset}")
    if choice.ratios != protocol.ratios:
        found.append(f"factors {', '.join(f'x{ratio:g}' for ratio in protocol.ratios)}")
    return found


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


def _excluded(request: Request, flags: Iterable[tuple[str, ...]]) -> dict[str, int]:
    """Return how many have each of the flags that are to be left out."""
    there = _counted(flags)
    return {flag: there.get(flag, 0) for flag in request.exclude_flags}


def _counted(flags: Iterable[tuple[str, ...]]) -> dict[str, int]:
    """Return how many have each flag."""
    return dict(sorted(Counter(flag for of in flags for flag in of).items()))


# --- clips ------------------------------------------------------------------------------------------------------------


def _clip_plan(request: Request, protocol: ClipProtocol) -> ScoringPlan:
    """Return the windows; the numbering of all frames of their clips is checked."""
    require_folder(request)
    subset = _clip_subset(request)
    manifest = request.manifest
    paired = {row.split for row in manifest.records if row.role == "reference"}
    every, rows = (
        choose_clips(
            [row for row in manifest.records if row.split in paired],
            manifest.card.subsets,
            Choice(cameras=request.cameras, subset=subset, exclude_flags=flags),
            ids=request.ids,
        )
        for flags in ((), request.exclude_flags)
    )
    there, kept = ({row.scene: row.flags for row in of if row.role == "noisy"} for of in (every, rows))
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
    flags = {
        "included_flags": _counted(kept.values()),
        "excluded_flags": _excluded(request, there.values()),
    }
    return ScoringPlan(found, {"subset": subset, "ids": ids, "layout": str(Layout.of(listed)), **flags})


def _clip_subset(request: Request) -> str | None:
    """Return the name of the subset whose clips are chosen; ``None`` if they are named, or all are of your own set."""
    subsets = request.manifest.card.subsets
    if request.ids is None and not subsets and request.is_own:
        return None
    if request.ids is None and not subsets:
        raise ArgumentError(f"{request.manifest.path}: its card names no subset; name the clips: {OF_CLIPS}")
    return None if request.ids is not None else request.subset or subsets[0].name


# --- the files --------------------------------------------------------------------------------------------------------


def require_folder(request: Request) -> None:
    """Raise :class:`DatasetError` unless the dataset is there."""
    if not request.folder.is_dir():
        raise DatasetError(
            f"{request.folder}: the dataset is not there; name the folder above it with --root (root=...). Where to "
            f"get it: {request.manifest.card.homepage}"
        )


def require_pairs(request: Request, pairs: Iterable[Pair]) -> tuple[FrameFiles, tuple[str, ...]]:
    """Return the files of the dataset, and what there is to say of white levels that differ in these pairs.

    Raise :class:`DatasetError` unless the manifest means them.
    """
    needed = {path for pair in pairs for path in pair.files}
    rows = [row for row in request.manifest.records if row.role in ("noisy", "reference")]
    require_folder(request)
    listed = rows if request.kind is IMAGES else expand(rows, request.folder)
    chosen, files = [row for row in listed if row.path in needed], request.files.absolute()
    levels_dn = check_rows(request, chosen, "metadata")
    if not (request.protocol.is_of_packed and request.protocol.levels == "metadata"):
        return files, ()
    remarks = white_remarks(chosen, levels_dn, files, request.workers)
    return files, tuple(remark.sentence() for remark in remarks)


def check_rows(request: Request, rows: Sequence[FrameRecord], level: Level) -> dict[str, MeanLevels | None]:
    """Raise :class:`DatasetError` unless these rows' files are what the manifest says; return known levels by path."""
    problems, _, _, levels_dn = check_files(
        request.manifest, request.folder, rows, level=level, workers=request.workers
    )
    if problems:
        more = f" (and {len(problems) - 1} more: eldata verify --level metadata lists all)" if len(problems) > 1 else ""
        raise DatasetError(f"{request.folder}: the dataset is not what its manifest says: {problems[0]}{more}")
    return levels_dn
