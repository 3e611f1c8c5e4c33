"""Pairs of a noisy frame and its reference, chosen from a manifest alone."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from operator import attrgetter
from typing import Any, TypeVar

from eldata.base.fields import names_of
from eldata.errors import ArgumentError, did_you_mean
from eldata.manifest.card import Subset, find_subset
from eldata.manifest.patterns import has_fields
from eldata.records import FrameRecord, PairRecord, from_columns

Item = TypeVar("Item", "PairRecord", "FrameRecord")

# Flag of a frame whose ISO is stated in two ways, or is known not to be its speed: EXIF cannot check its ratio.
UNCERTAIN_ISO = "uncertain-iso"
# Flag of a noisy frame whose ratio cannot follow from what files state: the manifest's is taken.
NOMINAL_RATIO = "nominal-ratio"
# Flag of bias frames of a sensor that was warm from shooting.
WARM_SENSOR = "warm-sensor"

_OF_PAIRS = names_of(PairRecord)

# Known values in a message: all if there are no more than this, else this many on each side of the wanted one.
_SHOWN, _NEAR = 30, 5


@dataclass(frozen=True, slots=True)
class Choice:
    """Which pairs or clips; ``None`` means all.

    Attributes
    ----------
    cameras, scenes, isos, ratios
        Wanted values. A scene is its name or its number: 3 for ``scene-3``, 34 for ``00034``. A ratio is the nominal
        one.
    split
        Name of a split, or several.
    subset
        Name of a subset on the dataset's card (:mod:`eldata.manifest.card`); the rest chooses within it.
    exclude_flags
        What has one of these flags is left out.
    """

    cameras: Collection[str] | None = None
    scenes: Collection[str | int] | None = None
    isos: Collection[int] | None = None
    ratios: Collection[float | Fraction] | None = None
    split: str | Collection[str] | None = None
    subset: str | None = None
    exclude_flags: Collection[str] = ()

    @property
    def wanted_values(self) -> dict[str, Collection[object] | None]:
        """The wanted values by kind, for :func:`filter_rows`."""
        values = self.cameras, self.scenes, self.isos, self.ratios, self.split, self.exclude_flags
        return dict(zip(("camera", "scene", "ISO", "ratio", "split", "flag"), map(as_values, values), strict=True))

    def pairs(self, records: Iterable[FrameRecord], subsets: Sequence[Subset] = ()) -> tuple[PairRecord, ...]:
        """Return the chosen pairs of a manifest's rows, in their order.

        Raises
        ------
        ArgumentError
            If a value does not occur or the subset is unknown; the message lists the known ones. If no pair has all
            values, or no frame of the subset a reference.
        ManifestError
            If the subset has another number of pairs than its card says.
        """
        noisy = [
            record
            for record in records
            if record.role == "noisy" and record.reference is not None
            if record.ratio is not None or has_fields(record.path)  # no file of it is there: whoever needs it says so
        ]
        values = {name: list(map(attrgetter(name), noisy)) for name in _OF_PAIRS}
        # What is not there has no ratio, which none reads: it is refused, or left out by name.
        pairs = from_columns(PairRecord, values | {"ratio": [ratio or Fraction(1) for ratio in values["ratio"]]})
        found = None if self.subset is None else find_subset(subsets, self.subset)
        alone = () if found is None else unpaired(records, found)
        if alone:
            raise ArgumentError(
                f"the {len(alone)} noisy frames of the subset {self.subset!r}, such as {alone[0].path}, have no "
                "references, so they cannot be scored here; eldata predict and eldata baseline predict them (--subset)"
            )
        chosen = pairs if found is None else found.choose(pairs)
        return tuple(filter_rows(chosen, pairs, "pair", self.wanted_values))


def as_values(wanted: Any) -> Collection[Any] | None:
    """Return the wanted values: one alone as a collection of one; ``None`` as it is."""
    return wanted if wanted is None or (isinstance(wanted, Collection) and not isinstance(wanted, str)) else (wanted,)


def unpaired(records: Iterable[FrameRecord], subset: Subset) -> tuple[FrameRecord, ...]:
    """Return the noisy rows of a subset without references, such as a benchmark's; none of any other subset."""
    held = [record for record in records if record.role == "noisy" and subset.holds(record)]
    return () if any(record.reference is not None for record in held) else tuple(held)


def filter_rows(
    chosen: Sequence[Item], every: Sequence[Item], what: str, wanted: Mapping[str, Collection[object] | None]
) -> list[Item]:
    """Return the chosen pairs (or rows of clips) that have a wanted value of each kind.

    Parameters
    ----------
    chosen, every
        The items to filter, and all items, whose values are known.
    what
        ``"pair"`` or ``"clip"``, for messages.
    wanted
        Values by kind: camera, scene, ISO, ratio, split, and flag, which is one to leave out; ``None`` means any.

    Raises
    ------
    ArgumentError
        If a value does not occur; the message lists those that do. If nothing has all of them.
    """
    kept = list(chosen)
    for kind, values in wanted.items():
        if values is None or kind == "flag":
            continue
        of = attrgetter(kind.lower())
        values = _scene_names(every, values) if kind == "scene" else values  # noqa: PLW2901 # the same, by name
        _check_known(what, kind, values, map(of, every))
        kept = [item for item in kept if of(item) in values]
    flags = set(wanted.get("flag") or ())
    if flags:
        _check_known(what, "flag", flags, (flag for item in every for flag in item.flags))
        kept = [item for item in kept if not flags & set(item.flags)]
    if not kept:
        raise ArgumentError(f"no {what} has all of the wanted cameras, scenes, ISOs, ratios, splits and flags together")
    return kept


def _scene_names(every: Iterable[PairRecord | FrameRecord], scenes: Collection[object]) -> list[object]:
    """Return the wanted scenes by name: a number stands for the scene that has it after ``scene-``, or is it."""
    names = {item.scene for item in every}
    prefix = "scene-" if any(name.startswith("scene-") for name in names) else ""
    digits_of = {name: name.removeprefix(prefix) for name in names}
    by_number = {int(digits): name for name, digits in digits_of.items() if digits.isdecimal()}
    return [by_number.get(scene, f"{prefix}{scene}") if isinstance(scene, int) else scene for scene in scenes]


def _check_known(what: str, kind: str, wanted: Collection[object], values: Iterable[object]) -> None:
    """Refuse wanted values that no row has, with known and similar ones."""
    known = sorted({value for value in values if value is not None})  # type: ignore[type-var] # of one kind each
    for value in wanted:
        if value not in known:
            hint = did_you_mean(str(value), map(str, known)) if kind in ("camera", "split", "flag") else ""
            raise ArgumentError(f"no {what} has {kind} {value}; known are {_list_near(known, value)}{hint}")


def _list_near(known: Sequence[object], wanted: object) -> str:
    """Return values as text; of many, those that stand next to the wanted one."""
    texts = [str(value) for value in known]
    if len(texts) <= _SHOWN:
        return ", ".join(texts) or "none"
    place = min(max(bisect(texts, str(wanted)), _NEAR), len(texts) - _NEAR)
    return f"{len(texts)}, next to it {', '.join(texts[place - _NEAR : place + _NEAR])}"
