"""Named subsets of a dataset's pairs: which pairs a published number was made with, as data on the dataset card."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from eldata.errors import ArgumentError, ManifestError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.records import FrameRecord, PairRecord


@dataclass(frozen=True, slots=True)
class Subset:
    """A named choice of pairs: those that fit all of ``splits``, ``scenes`` and ``paths``.

    Attributes
    ----------
    name, title, source
        Short name, what it is, and who uses it.
    pairs
        Expected number of pairs; a manifest that gives another is refused.
    splits, scenes
        Wanted values; empty means all.
    paths
        Pattern of the noisy frames' paths, with ``*`` and ``?`` as in a shell.
    """

    name: str
    title: str
    source: str
    pairs: int
    splits: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()
    paths: str = "*"

    def holds(self, pair: PairRecord | FrameRecord) -> bool:
        """Return whether a pair, or the row of a noisy frame, belongs to this subset."""
        return (
            (not self.splits or pair.split in self.splits)
            and (not self.scenes or pair.scene in self.scenes)
            and fnmatchcase(pair.path, self.paths)
        )

    def choose(self, pairs: Sequence[PairRecord]) -> list[PairRecord]:
        """Return the pairs of this subset, given all pairs of a dataset.

        Raises
        ------
        ManifestError
            If their number is not the expected one.
        """
        chosen = [pair for pair in pairs if self.holds(pair)]
        if len(chosen) != self.pairs:
            raise ManifestError(
                f"subset {self.name!r}: the card expects {self.pairs} pairs, the manifest has {len(chosen)}"
            )
        return chosen


def find_subset(subsets: Sequence[Subset], name: str) -> Subset:
    """Return a subset by name.

    Raises
    ------
    ArgumentError
        If the name is unknown; the message lists the known ones.
    """
    for subset in subsets:
        if subset.name == name:
            return subset
    known = [subset.name for subset in subsets]
    listed = ", ".join(known) or "none"
    raise ArgumentError(f"no subset is called {name!r}; known are {listed}{did_you_mean(name, known)}")
