"""Pairs of a source given otherwise: as two noisy frames of one scene, for training without a clean one."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from eldata.datasets.base import Sample
from eldata.datasets.items import CroppedItems, SharedDraws
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    import numpy as np

    from eldata.datasets.base import SourcePairs
    from eldata.datasets.items import DrawnItem


class Noise2Noise(CroppedItems[Sample]):
    """Two noisy frames of one scene, ISO and ratio: the input, and instead of the clean target another one.

    J. Lehtinen et al., ICML 2018, and the row of that name in K. Wei et al., TPAMI 2021. The samples are those of the
    pairs but for ``target``, a noisy frame that is drawn for the item, amplified and clipped like the input; ``path``
    is the input's. Targets whose negative read noise is clipped off are too bright where it is dark, and the network
    learns that: give the pairs ``clip="none"``, and test on the same.

    Parameters
    ----------
    pairs
        Of a source that reads parts, such as :class:`~eldata.datasets.PackedStore`. Those whose scene has no other
        noisy frame of their ISO and ratio are left out.

    Raises
    ------
    ArgumentError
        If the source decodes whole files, or no scene has two such frames.
    """

    def __init__(self, pairs: SourcePairs) -> None:
        if not pairs.reads_parts:
            raise ArgumentError("Noise2Noise reads two noisy frames of a scene at once: pack the dataset, eldata pack")
        repeats = "crops_per_frame", pairs.crops_per_frame
        super().__init__(pairs.crop, pairs.augment, pairs.crops, pairs.seed, repeats)
        self.pairs = pairs
        self.source, self.clip = pairs.source, pairs.clip
        groups: dict[object, list[int]] = defaultdict(list)
        for number, record in enumerate(pairs.records):
            like = record.camera, record.reference, record.iso, record.ratio
            groups[like].append(number)
        self._groups = [group for group in groups.values() if len(group) > 1]
        self._count = sum(map(len, self._groups))
        self._members = [
            (group, place, step)
            for group in self._groups
            for place in range(len(group))
            for step in range(len(pairs._indices_of(group[place])))
        ]
        if not self._members:
            raise ArgumentError(
                "Noise2Noise needs two noisy frames of a scene at one ISO and ratio; of "
                f"{len(pairs.records)} pairs none has another one"
            )
        self._draws = SharedDraws(len(self))

    def __len__(self) -> int:
        return len(self._members) * self.pairs.crops_per_frame

    def drawn(self, place: int, generator: np.random.Generator) -> DrawnItem:
        """Draw a crop of a pair, and of another pair of its scene."""
        group, place, step = self._members[place % len(self._members)]
        other_place = (place + 1 + int(generator.integers(len(group) - 1))) % len(group)
        item = self.pairs.drawn(self.pairs._indices_of(group[place])[step], generator)
        other = self.pairs.drawn(self.pairs._indices_of(group[other_place])[step], generator)
        (mine,), (its,) = ([part for part in one.parts if part.tensor == "input"] for one in (item, other))
        item.parts = [mine, its._replace(tensor="target", facts={})]
        return item

    def _outline(self) -> list[tuple[str, str]]:
        """Return what the dataset is: two noisy frames of each of these pairs."""
        return [("noisy frames", str(self._count)), *self.pairs._outline()]

    def __repr__(self) -> str:
        return f"Noise2Noise({self._count} noisy frames of {len(self._groups)} exposures; {self.pairs!r})"
