"""Pairs of a noisy frame and its reference, chosen from a manifest alone."""

from __future__ import annotations

from bisect import bisect
from typing import TYPE_CHECKING, TypeVar

from eldata.base.fields import names_of
from eldata.errors import ArgumentError
from eldata.records import PairRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence
    from fractions import Fraction

    from eldata.manifest.subsets import Subset
    from eldata.records import FrameRecord

Value = TypeVar("Value")

# Flag of a frame whose ISO the publisher states in two ways: its exposure ratio cannot be checked.
UNCERTAIN_ISO = "uncertain-iso"

_OF_PAIRS = names_of(PairRecord)

# Known values in a message: all of up to so many, or so many on each side.
_SHOWN, _NEAR = 30, 5


def select_pairs(
    records: Iterable[FrameRecord],
    *,
    cameras: Collection[str] | None = None,
    scenes: Collection[str | int] | None = None,
    isos: Collection[int] | None = None,
    ratios: Collection[float | Fraction] | None = None,
    splits: Collection[str] | None = None,
    subset: Subset | None = None,
    exclude_flags: Collection[str] = (),
) -> tuple[PairRecord, ...]:
    """Return the manifest's pairs, in its order, that have one of the given values; ``None`` means any.

    Parameters
    ----------
    records
        Rows of a manifest.
    cameras, scenes, isos, ratios, splits
        Wanted values. A scene is its name or its number: 3 for ``scene-3``, 34 for ``00034``. A ratio is the nominal
        one.
    subset
        A named choice, of the manifest's card; the other values choose among its pairs.
    exclude_flags
        Pairs with one of these flags are left out.

    Raises
    ------
    ArgumentError
        If a value does not occur; the message lists those that do. If no pair has all of them.
    ManifestError
        If the subset has not as many pairs as its card says.
    """
    pairs = [
        PairRecord(**{name: getattr(record, name) for name in _OF_PAIRS})
        for record in records
        if record.role == "noisy" and record.reference is not None and record.ratio is not None
    ]
    for name, wanted in (
        *(("camera", cameras), ("scene", scenes), ("ISO", isos), ("ratio", ratios), ("split", splits)),
        ("flag", exclude_flags),
    ):
        if isinstance(wanted, str):
            raise ArgumentError(f"give {name} values as a list: [{wanted!r}]")
    chosen = pairs if subset is None else subset.choose(pairs)
    chosen = _having(chosen, pairs, "camera", cameras, lambda pair: pair.camera)
    chosen = _having(chosen, pairs, "scene", _scene_names(pairs, scenes), lambda pair: pair.scene)
    chosen = _having(chosen, pairs, "ISO", isos, lambda pair: pair.iso)
    chosen = _having(chosen, pairs, "ratio", ratios, lambda pair: pair.ratio)
    chosen = _having(chosen, pairs, "split", splits, lambda pair: pair.split)
    _check_known("flag", exclude_flags, [flag for pair in pairs for flag in pair.flags])
    chosen = [pair for pair in chosen if not set(exclude_flags) & set(pair.flags)]
    if not chosen:
        raise ArgumentError("no pair has all of the wanted cameras, scenes, ISOs, ratios, splits and flags together")
    return tuple(chosen)


def _scene_names(pairs: list[PairRecord], scenes: Collection[str | int] | None) -> list[str] | None:
    """Return the wanted scenes by name: a number stands for the scene that has it after ``scene-``, or is it."""
    if scenes is None:
        return None
    names = {pair.scene for pair in pairs}
    prefix = "scene-" if any(name.startswith("scene-") for name in names) else ""
    digits_of = {name: name.removeprefix(prefix) for name in names}
    by_number = {int(digits): name for name, digits in digits_of.items() if digits.isdecimal()}
    return [by_number.get(scene, f"{prefix}{scene}") if isinstance(scene, int) else scene for scene in scenes]


def _having(
    chosen: list[PairRecord],
    pairs: list[PairRecord],
    name: str,
    wanted: Collection[Value] | None,
    value_of: Callable[[PairRecord], object],
) -> list[PairRecord]:
    if wanted is None:
        return chosen
    _check_known(name, wanted, [value_of(pair) for pair in pairs])
    return [pair for pair in chosen if value_of(pair) in wanted]


def _check_known(name: str, wanted: Collection[object], values: Iterable[object]) -> None:
    known = sorted({value for value in values if value is not None})  # type: ignore[type-var] # of one kind each
    for value in wanted:
        if value not in known:
            raise ArgumentError(f"no pair has {name} {value}; known are {_listed(known, value)}")


def _listed(known: Sequence[object], wanted: object) -> str:
    """Return values as text; of many, those that stand next to the wanted one."""
    texts = [str(value) for value in known]
    if len(texts) <= _SHOWN:
        return ", ".join(texts) or "none"
    place = min(max(bisect(texts, str(wanted)), _NEAR), len(texts) - _NEAR)
    return f"{len(texts)}, next to it {', '.join(texts[place - _NEAR : place + _NEAR])}"
