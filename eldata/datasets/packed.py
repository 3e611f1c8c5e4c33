"""Pairs and clips of a store: random crops, equal to the files' to the bit; and pairs of two noisy frames."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from eldata.base.fields import no_search_for_cycles
from eldata.datasets.base import SourcePairs
from eldata.datasets.clips import ClipWindows
from eldata.datasets.items import CroppedItems, Crops, DrawnItem, SharedDraws, Transform, keywords_of, take_choice
from eldata.errors import ArgumentError, DatasetError
from eldata.sources.store.read import Store

if TYPE_CHECKING:
    from collections.abc import Collection
    from fractions import Fraction
    from pathlib import Path

    import numpy as np

    from eldata.datasets.crops import Region
    from eldata.manifest.clips import FrameRange
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Amplification
    from eldata.raw.levels import Clip, FrameLevels


class PackedStore(SourcePairs):
    """Pairs from a store that ``eldata pack`` made: ``dataset[i]`` is a :class:`~eldata.datasets.items.Sample`.

    Each item is a random crop of both frames of a pair, in one of eight orientations. Its values are those of the raw
    route (:class:`~eldata.datasets.base.PairDataset` on the files) at the same place, bit for bit. Draws are those of
    the raw route too: another each time that an item is asked for, unless :meth:`set_epoch` fixes them.

    Parameters
    ----------
    path
        The store.
    cameras, scenes, isos, ratios, split, subset, exclude_flags, levels, clip, amplification, dark_shading, crop, \
    augment, crops, crops_per_frame, seed, transform
        As for :class:`~eldata.datasets.base.PairDataset`: the store holds DN, so nothing of them is fixed by it.

    Raises
    ------
    StoreError
        If the file is not a store, truncated, or of a newer version.
    DatasetError
        If the store holds no pairs, or frames of a pair differ in size, CFA or exposure ratio from what they should be.
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.

    Notes
    -----
    Each process opens the store for itself, on its first read. Memory does not grow with the store.

    Examples
    --------
    >>> # eldata pack eld-demo --manifest eldata-demo/manifests/eld-demo.csv --root eldata-demo/data -o demo.h5
    >>> from eldata import PackedStore
    >>> store = PackedStore("demo.h5", crop=64, seed=0)
    >>> len(store), store[0]["input"].shape
    (24, torch.Size([4, 64, 64]))
    """

    source: Store

    def __init__(
        self,
        path: Path | str,
        *,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = 512, augment: bool = True, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None,
    ) -> None:  # fmt: skip
        options = keywords_of(locals(), "path")
        with no_search_for_cycles():
            source = Store(path)
            options["levels"] = levels or source.levels
            super().__init__(source, source.pairs(take_choice(options)), name=source.dataset, **options)
            self._place = str(source.path)


class PackedClips(ClipWindows):
    """Windows of clips of a store: ``dataset[i]`` is a :class:`~eldata.datasets.items.Sample`.

    The clips are those that have a reference, or with ``dynamic`` those that have none, such as DRV's dynamic ones.
    Each item is a window of consecutive frames and their one reference, all cut at the same random place and turned the
    same way. The values are those of :class:`~eldata.datasets.published.DRVDataset` on the files, bit for bit.

    Parameters
    ----------
    path
        The store, as ``eldata pack drv`` or ``eldata pack drv-raw`` makes it.
    dynamic, ids, window, stride, frames, region, crops_per_window, cameras, scenes, isos, ratios, split, subset, \
    exclude_flags, levels, clip, amplification, dark_shading, crop, augment, crops, seed, transform
        As for :class:`~eldata.datasets.clips.ClipWindows`.

    Raises
    ------
    StoreError
        If the file is not a store, truncated, or of another version.
    DatasetError
        If the store holds no clip of this kind; if frames of a clip differ in size, CFA or exposure, or are exposed
        more than their reference.
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        dynamic: bool = False,
        ids: Collection[str] | None = None, window: int = 5, stride: int | None = None, frames: FrameRange = "all",
        region: Region | None = None, crops_per_window: int = 1,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels = "metadata", clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None, transform: Transform | None = None,
        crop: int | None = 512, augment: bool = True, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        options, source = keywords_of(locals(), "path"), Store(path)
        if source.manifest is None:
            raise DatasetError(f"{source.path}: holds clean frames, not clips; read it with CleanFrames or CleanClips")
        noisy = [row for row in source.manifest.records if row.role == "noisy"]
        if any(row.ratio is not None for row in noisy):
            raise DatasetError(f"{source.path}: holds pairs, not clips; read it with PackedStore")
        of_kind = {row.scene for row in noisy if (row.reference is None) == dynamic}
        if not of_kind:
            what = "without" if dynamic else "with"
            raise DatasetError(f"{source.path}: holds no clip {what} a reference; read it with dynamic={not dynamic}")
        rows = [row for row in source.manifest.records if row.scene in of_kind]
        super().__init__(source, rows, source.manifest.card.subsets, source.path, **options)


class Noise2Noise(CroppedItems):
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
        super().__init__(pairs.crop, pairs.augment, pairs.crops, pairs.seed, pairs.transform, repeats)
        self.pairs = pairs
        self.source, self.clip = pairs.source, pairs.clip
        groups: dict[object, list[int]] = defaultdict(list)
        for number, record in enumerate(pairs.records):
            like = record.camera, record.reference, record.iso, record.ratio
            groups[like].append(number)
        several = [group for group in groups.values() if len(group) > 1]
        self._text = f"{sum(map(len, several))} of {len(several)} exposures"
        self._members = [
            (group, place, step)
            for group in several
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

    def draw_item(self, place: int, generator: np.random.Generator) -> DrawnItem:
        """Draw a crop of a pair, and of another pair of its scene."""
        group, place, step = self._members[place % len(self._members)]
        other_place = (place + 1 + int(generator.integers(len(group) - 1))) % len(group)
        item = self.pairs.draw_item(self.pairs._indices_of(group[place])[step], generator)
        other = self.pairs.draw_item(self.pairs._indices_of(group[other_place])[step], generator)
        (mine,), (its,) = ([part for part in drawn.parts if part.tensor == "input"] for drawn in (item, other))
        item.parts = [mine, its._replace(tensor="target", facts={})]
        return item

    def _outline(self) -> list[tuple[str, str]]:
        """Describe the dataset by names and values: the pairs' own, and how noisy frames are chosen."""
        return [("noisy frames", self._text), *self.pairs._outline()]
