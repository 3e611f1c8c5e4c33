"""Which pairs of a set a protocol scores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldata.errors import ArgumentError
from eldata.manifest.catalogue import shipped_names
from eldata.manifest.pairs import select_pairs
from eldata.manifest.subsets import find_subset

if TYPE_CHECKING:
    from collections.abc import Collection

    from eldata.manifest.catalogue import Manifest
    from eldata.manifest.subsets import Subset
    from eldata.protocols.protocol import Protocol
    from eldata.records import PairRecord


@dataclass(frozen=True, slots=True)
class Plan:
    """A protocol and the pairs that it scores here.

    Attributes
    ----------
    protocol, pairs
        The pairs in the manifest's order.
    subset
        Name of the subset on the card that they are of, if any.
    excluded
        Number of pairs that were left out for each of the flags asked for.
    set_aside
        What of the protocol's own choice of pairs was not applied, in words, because the set is the user's own.
    """

    protocol: Protocol
    pairs: tuple[PairRecord, ...]
    subset: str | None
    excluded: dict[str, int]
    set_aside: tuple[str, ...]

    @property
    def ratios(self) -> list[float]:
        """The low-light factors of its pairs."""
        return sorted({float(pair.ratio) for pair in self.pairs})


def is_own(manifest: Manifest) -> bool:
    """Return whether a manifest is of a set of the user's own, none that comes with the package."""
    return manifest.name not in shipped_names()


def make_plan(
    manifest: Manifest,
    protocol: Protocol,
    *,
    cameras: Collection[str] | None,
    subset: str | None,
    exclude_flags: Collection[str],
) -> Plan:
    """Return the pairs that a protocol scores.

    Of a set that comes with the package these are the protocol's. A set of the user's own has its own pairs: those at
    the protocol's factors if it has every one of them, else all.

    Raises
    ------
    ArgumentError
        If the protocol is for another dataset, a name is unknown, or no pair is left.
    ManifestError
        If a subset has not as many pairs as its card says.
    """
    if is_own(manifest):
        return _own_plan(manifest, protocol, cameras=cameras, subset=subset, exclude_flags=exclude_flags)
    if not protocol.covers(manifest.name):
        raise ArgumentError(
            f"protocol {protocol.name!r} is for dataset {protocol.dataset!r}, not {manifest.name!r}; "
            "eldata protocols lists those for each"
        )
    if protocol.subset is not None and subset not in (None, protocol.subset):
        raise ArgumentError(
            f"protocol {protocol.name!r} scores the subset {protocol.subset!r}, not {subset!r}; leave the subset out"
        )
    if protocol.cameras and cameras is not None:
        unscored = [name for name in cameras if name not in protocol.cameras and name in manifest.card.cameras]
        if unscored:
            raise ArgumentError(
                f"protocol {protocol.name!r} scores {', '.join(protocol.cameras)}, not {', '.join(unscored)}"
            )
    return _plan(
        manifest,
        protocol,
        cameras=cameras if cameras is not None else protocol.cameras or None,
        scenes=protocol.scenes or None,
        ratios=protocol.ratios or None,
        subset=_subset(manifest, protocol.subset or subset),
        exclude_flags=exclude_flags,
        set_aside=(),
    )


def _own_plan(
    manifest: Manifest,
    protocol: Protocol,
    *,
    cameras: Collection[str] | None,
    subset: str | None,
    exclude_flags: Collection[str],
) -> Plan:
    there = {record.ratio for record in manifest.records if record.role == "noisy"}
    has_all = bool(protocol.ratios) and all(ratio in there for ratio in protocol.ratios)
    set_aside = [f"cameras {', '.join(protocol.cameras)}"] if protocol.cameras else []
    if protocol.scenes:
        set_aside.append(f"{len(protocol.scenes)} scenes")
    if protocol.subset is not None:
        set_aside.append(f"subset {protocol.subset}")
    if protocol.ratios and not has_all:
        set_aside.append(f"factors {', '.join(f'x{ratio:g}' for ratio in protocol.ratios)}")
    return _plan(
        manifest,
        protocol,
        cameras=cameras,
        scenes=None,
        ratios=protocol.ratios if has_all else None,
        subset=_subset(manifest, subset),
        exclude_flags=exclude_flags,
        set_aside=tuple(set_aside),
    )


def _plan(
    manifest: Manifest,
    protocol: Protocol,
    *,
    cameras: Collection[str] | None,
    scenes: Collection[str] | None,
    ratios: Collection[float] | None,
    subset: Subset | None,
    exclude_flags: Collection[str],
    set_aside: tuple[str, ...],
) -> Plan:
    candidates, pairs = (
        select_pairs(
            manifest.records, cameras=cameras, scenes=scenes, ratios=ratios, subset=subset, exclude_flags=flags
        )
        for flags in ((), exclude_flags)
    )
    return Plan(
        protocol=protocol,
        pairs=pairs,
        subset=None if subset is None else subset.name,
        excluded={flag: sum(flag in pair.flags for pair in candidates) for flag in exclude_flags},
        set_aside=set_aside,
    )


def _subset(manifest: Manifest, name: str | None) -> Subset | None:
    subsets = manifest.card.subsets
    if name is not None:
        return find_subset(subsets, name)
    return subsets[0] if subsets else None
