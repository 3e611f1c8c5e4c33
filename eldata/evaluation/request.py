"""What is to be evaluated: made once, by a public function or the command line, and passed on whole."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

from eldata.base.keywords import keywords
from eldata.base.workers import AnyWorkers, Workers
from eldata.errors import ArgumentError
from eldata.manifest.catalogue import Manifest, load_manifest, shipped_manifest, shipped_names
from eldata.protocols.choosing import default_protocol, get_protocol, protocols_for
from eldata.protocols.kinds import IMAGES, Kind
from eldata.protocols.named import PROTOCOLS

if TYPE_CHECKING:
    from collections.abc import Collection

    from eldata.protocols.protocol import Protocol

Baseline = Literal["input"]

ALL = "all"
"""In place of a protocol's name: every one that is for the dataset."""


class EvaluationOptions(TypedDict, total=False):
    """Keyword arguments of :func:`eldata.evaluate`, which says what they mean, and :func:`eldata.evaluate_all`."""

    root: Path | str | None
    manifest: Path | str | None
    cameras: Collection[str] | None
    subset: str | None
    ids: Collection[str] | None
    exclude_flags: Collection[str]
    allow_missing: bool
    baseline: Baseline | None
    strict: bool
    lpips: Path | str | None
    workers: AnyWorkers


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be evaluated, with names resolved; the options are those of :func:`eldata.evaluate`.

    Attributes
    ----------
    manifest, folder
        The dataset's manifest, and its folder.
    predictions
        Their folder; ``None`` for the baseline.
    protocols
        How to score; several for ``all``.
    every
        Whether every protocol was asked for, and those that cannot score are left out and named.
    lpips
        The folder of the weights of LPIPS, which are there; ``None``: it is not wanted.
    """

    manifest: Manifest
    folder: Path
    predictions: Path | None
    protocols: tuple[Protocol, ...]
    every: bool
    cameras: Collection[str] | None
    subset: str | None
    ids: Collection[str] | None
    exclude_flags: Collection[str]
    allow_missing: bool
    strict: bool
    lpips: Path | None
    workers: Workers

    @property
    def kind(self) -> Kind:
        """What is scored: images or clips."""
        return self.protocols[0].kind

    @property
    def is_own(self) -> bool:
        """Whether the set is the user's own, not one that comes with the package."""
        return self.kind is IMAGES and self.manifest.name not in shipped_names()


def make_request(
    predictions: Path | str | None, dataset: str, protocol: str | Path | Protocol | None, options: EvaluationOptions
) -> Request:
    """Return a request; everything that can be told without the dataset's files is checked.

    Raises
    ------
    ManifestError, ArgumentError
        If the manifest is malformed, a name or an option is unknown, or options do not go together.
    """
    keywords("evaluate", options, EvaluationOptions, renamed={})
    path, baseline, lpips = options.get("manifest"), options.get("baseline"), options.get("lpips")
    manifest = shipped_manifest(dataset) if path is None else load_manifest(path)
    manifest.card.check_readable()
    own = manifest.name not in shipped_names()
    request = Request(
        manifest=manifest,
        folder=manifest.folder(options.get("root")),
        predictions=None if predictions is None else Path(predictions),
        protocols=protocols_for(manifest.name, own=own) if protocol == ALL else (_protocol(protocol, manifest),),
        every=protocol == ALL,
        cameras=options.get("cameras"),
        subset=options.get("subset"),
        ids=options.get("ids"),
        exclude_flags=options.get("exclude_flags", ()),
        allow_missing=options.get("allow_missing", False),
        strict=options.get("strict", False),
        lpips=None if lpips is None else Path(lpips).absolute(),
        workers=Workers.of(options.get("workers", 1)),
    )
    if baseline not in (None, "input"):
        raise ArgumentError(f"baseline must be 'input'; found {baseline!r}")
    if (predictions is None) == (baseline is None):
        raise ArgumentError("give a folder of predictions or a baseline, and not both")
    if request.kind is IMAGES and request.ids is not None:
        raise ArgumentError("--clip (ids) is for datasets of clips, such as drv")
    if request.kind is IMAGES and request.every and request.subset is not None:
        raise ArgumentError("--protocol all scores each protocol's own pairs; leave --subset out")
    if request.subset is not None and request.ids is not None:
        raise ArgumentError("give a subset or ids, not both")
    if not request.every and predictions is None and request.protocols[0].pixels == "srgb":
        raise ArgumentError(
            f"protocol {request.protocols[0].name!r} scores renderings, so the raw input is not a baseline of it"
        )
    if request.lpips is not None:
        _check_lpips(request, request.lpips)
    return request


def _protocol(protocol: str | Path | Protocol | None, manifest: Manifest) -> Protocol:
    """Return the protocol that is meant; it has to be of what the dataset holds, images or clips."""
    default = default_protocol(manifest.name)
    if isinstance(protocol, (str, Path)):
        protocol = get_protocol(protocol, manifest.name, own=manifest.name not in shipped_names())
    chosen = protocol or default
    chosen.check()
    if chosen.kind is not default.kind:
        own = ", ".join(one.name for one in protocols_for(manifest.name))
        raise ArgumentError(
            f"protocol {chosen.name!r} scores {chosen.kind.units}, and {manifest.name!r} is a dataset of "
            f"{default.kind.units}; its protocols are {own}"
        )
    return chosen


def _check_lpips(request: Request, folder: Path) -> None:
    """Check that LPIPS can be taken: of renderings, with the published weights, which are read to know that."""
    from eldata.metrics.lpips import LpipsWeights

    if request.every:
        raise ArgumentError("--lpips goes with one protocol of sRGB, not with --protocol all")
    (protocol,) = request.protocols
    if protocol.space != "srgb":
        known = ", ".join(name for name, one in PROTOCOLS.items() if one.space == "srgb")
        raise ArgumentError(
            f"LPIPS is defined on sRGB images, and protocol {protocol.name!r} scores raw ones; protocols of sRGB are "
            f"{known}"
        )
    LpipsWeights.load(folder)
