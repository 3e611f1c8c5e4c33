"""Pairs of a noisy frame and its reference, chosen from a manifest alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from eldata.errors import ArgumentError
from eldata.records import PairRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable
    from fractions import Fraction

    from eldata.records import FrameRecord

Value = TypeVar("Value")


def select_pairs(
    records: Iterable[FrameRecord],
    *,
    cameras: Collection[str] | None = None,
    scenes: Collection[str | int] | None = None,
    isos: Collection[int] | None = None,
    ratios: Collection[float | Fraction] | None = None,
) -> tuple[PairRecord, ...]:
    """Return the manifest's pairs, in its order, that have one of the given values; ``None`` means any.

    Parameters
    ----------
    records
        Rows of a manifest.
    cameras, scenes, isos, ratios
        Wanted values. A scene is its name or, for ``scene-3``, the number 3; a ratio is the nominal one.

    Raises
    ------
    ArgumentError
        If a value does not occur; the message lists those that do. If no pair has all of them.
    """
    pairs = [
        PairRecord(
            path=record.path,
            reference=record.reference,
            camera=record.camera,
            scene=record.scene,
            split=record.split,
            iso=record.iso,
            exposure_s=record.exposure_s,
            ratio=record.ratio,
            flags=record.flags,
        )
        for record in records
        if record.role == "noisy" and record.reference is not None and record.ratio is not None
    ]
    for name, wanted in (("camera", cameras), ("scene", scenes), ("ISO", isos), ("ratio", ratios)):
        if isinstance(wanted, str):
            raise ArgumentError(f"give {name} values as a list: [{wanted!r}]")
    wanted_scenes = None if scenes is None else [f"scene-{s}" if isinstance(s, int) else s for s in scenes]
    chosen = pairs
    chosen = _having(chosen, pairs, "camera", cameras, lambda pair: pair.camera)
    chosen = _having(chosen, pairs, "scene", wanted_scenes, lambda pair: pair.scene)
    chosen = _having(chosen, pairs, "ISO", isos, lambda pair: pair.iso)
    chosen = _having(chosen, pairs, "ratio", ratios, lambda pair: pair.ratio)
    if not chosen:
        raise ArgumentError("no pair has all of the wanted cameras, scenes, ISOs and ratios together")
    return tuple(chosen)


def _having(
    chosen: list[PairRecord],
    pairs: list[PairRecord],
    name: str,
    wanted: Collection[Value] | None,
    value_of: Callable[[PairRecord], object],
) -> list[PairRecord]:
    if wanted is None:
        return chosen
    known = list(dict.fromkeys(value_of(pair) for pair in pairs))
    for value in wanted:
        if value not in known:
            raise ArgumentError(f"no pair has {name} {value}; known are {', '.join(map(str, known))}")
    return [pair for pair in chosen if value_of(pair) in wanted]
