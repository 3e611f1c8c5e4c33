"""What is to be evaluated: made once, by a public function or the command line, and passed on whole."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from eldata.base.fields import TextFile
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.tasks import Task
from eldata.manifest.catalogue import FrameFiles, Manifest, known_manifest, load_manifest, shipped_names
from eldata.noise.dark_shading import dark_shading_in
from eldata.protocols.kinds import IMAGES, Kind
from eldata.protocols.named import default_protocol, get_protocol, protocols_for
from eldata.protocols.protocol import NO_SHADING, OWN_SEQUENCES
from eldata.protocols.words import FIELDS, in_words

if TYPE_CHECKING:
    from collections.abc import Collection

    from eldata.base.workers import AnyWorkers
    from eldata.evaluation.scores import Pair
    from eldata.evaluation.tasks import TaskFunction
    from eldata.protocols.protocol import Protocol

Baseline = Literal["input"]

OF_CLIPS = "--clip ID (in Python ids=[...])"
"""What chooses clips, in messages: the commands that predict have another use for ``--clip``."""

SETTINGS = "predictions.json"
"""What made the predictions beside it; eldata baseline and eldata predict write it."""

# How long scoring a pair takes, for itself and for each byte of its input; and what two workers take to start.
_PAIR_S, _BYTE_S, _WORTH_S = 3e-3, 20e-9, 1.3


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be evaluated, with names resolved; the options are those of :func:`eldata.evaluate`.

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
        """What is scored: images or clips."""
        return self.protocol.kind

    @property
    def files(self) -> FrameFiles:
        """The set's files, with what its card states of them."""
        return FrameFiles.of(self.folder, self.manifest.card, self.manifest.records)

    def workers_for(self, pairs: Collection[Pair]) -> Workers:
        """Return who scores some pairs: this process, where it takes less time than starting others does."""
        if self.workers.executor is not None or self.kind is not IMAGES or self.task is not None:
            return self.workers
        seconds = _PAIR_S * len(pairs)
        for pair in pairs:
            if seconds > _WORTH_S:
                break
            with suppress(OSError):  # what is not there is found when it is looked for
                seconds += _BYTE_S * (self.folder / pair.path).stat().st_size
        return self.workers if seconds > _WORTH_S else IN_THIS_PROCESS

    @property
    def is_own(self) -> bool:
        """Whether the set is the user's own: it does not come with the package, nor has it a protocol of clips."""
        return _is_own(self.manifest)


def make_request(
    predictions: Path | str | None, dataset: str, protocol: str | Path | Protocol | None, *,
    root: Path | str | None = None, manifest: Path | str | None = None, cameras: Collection[str] | None = None,
    subset: str | None = None, ids: Collection[str] | None = None, exclude_flags: Collection[str] = (),
    allow_missing: bool = False, baseline: Baseline | None = None, strict: bool = False,
    task: Task | TaskFunction | str | None = None, dark_shading: Path | str | None = None, workers: AnyWorkers = 1,
) -> Request:  # fmt: skip
    """Return a request; everything that can be told without the dataset's files is checked.

    The arguments are those of :func:`eldata.evaluate`.

    Raises
    ------
    ManifestError, ArgumentError
        If the manifest is malformed, a name is unknown, or options do not go together.
    """
    known = known_manifest(dataset) if manifest is None else load_manifest(manifest)
    request = Request(
        manifest=known,
        folder=known.folder(root),
        predictions=None if predictions is None else Path(predictions),
        protocol=_of_inputs(_protocol(protocol, known), dark_shading),
        cameras=cameras,
        subset=subset,
        ids=ids,
        exclude_flags=exclude_flags,
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


def _is_own(manifest: Manifest) -> bool:
    default = default_protocol(manifest.card)
    return manifest.name not in shipped_names() and (default.kind is IMAGES or not default.covers(manifest.name))


def _protocol(protocol: str | Path | Protocol | None, manifest: Manifest) -> Protocol:
    """Return the protocol that is meant; it has to be of what the dataset holds, images or clips.

    A set of one's own may be scored as images, and as sequences.
    """
    default, is_own = default_protocol(manifest.card), _is_own(manifest)
    if isinstance(protocol, (str, Path)):
        protocol = get_protocol(protocol, manifest.name, own=is_own)
    chosen = protocol or default
    chosen.check()
    fits_own = is_own and (chosen.kind is IMAGES or chosen.dataset == OWN_SEQUENCES)
    if chosen.kind is not default.kind and not fits_own:
        own = ", ".join(one.name for one in protocols_for(manifest.name))
        raise ArgumentError(
            f"protocol {chosen.name!r} scores {chosen.kind.units}, and {manifest.name!r} is a dataset of "
            f"{default.kind.units}; its protocols are {own}"
        )
    return chosen


def _of_inputs(protocol: Protocol, shading: Path | str | None) -> Protocol:
    """Return the protocol with what is taken off its input; if it states a dark shading, it is of that one alone."""
    digest = NO_SHADING if shading is None else dark_shading_in(Path(shading).absolute()).digest
    if protocol.dark_shading not in (NO_SHADING, digest):
        found = "none was given" if shading is None else f"{shading} is {digest}"
        raise ArgumentError(
            f"protocol {protocol.name!r} is of inputs less the dark shading {protocol.dark_shading}, and {found}: give "
            "that one with --dark-shading (dark_shading=...)"
        )
    return replace(protocol, dark_shading=digest)


def stated_shading(folder: Path) -> str | None:
    """Return the digest of the dark shading that a folder's own file says its predictions are of inputs less.

    ``"none"``: it says that they are of inputs as they are. ``None``: it says nothing, since there is no such file, or
    one of another origin.
    """
    return _stated(folder, "dark_shading")


def _stated(folder: Path, name: str) -> str | None:
    """Return a text of a folder's own file, if it has one."""
    file = folder / SETTINGS
    if not file.is_file():
        return None
    try:
        stated = TextFile(file, EldataError, "predict again into a new folder").json().data.get(name)
    except EldataError:  # another program's: ours is written whole or not at all
        return None
    return stated if isinstance(stated, str) else None


def _check_inputs(request: Request, folder: Path) -> None:
    """Check that the folder's own words on what its predictions were made of do not contradict the request."""
    protocol = request.protocol
    if protocol.is_of_packed and protocol.pixels == "srgb":
        for name in ("input_space", "response"):
            stated, wanted = _stated(folder, name), in_words(name, getattr(protocol, name))
            if stated not in (None, wanted):
                raise ArgumentError(
                    f"{folder / SETTINGS} says of these predictions {FIELDS[name][0]}: {stated}, and protocol "
                    f"{protocol.name!r} has {wanted} ({name}); give the protocol that they were made under"
                )
    stated, digest = stated_shading(folder), protocol.dark_shading
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
