"""Windows of consecutive frames of clips, from any source."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from functools import cache
from typing import TYPE_CHECKING

from eldata.datasets.base import facts_of
from eldata.datasets.crops import Crop, Region
from eldata.datasets.items import CroppedItems, Crops, DrawnItem, Part, Transform
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.clips import Clip, ClipRecord, FrameRange, choose_clips, clips_of, windows
from eldata.manifest.layouts import describe_layout
from eldata.manifest.pairs import Choice
from eldata.manifest.patterns import expand
from eldata.sources.pairs import OpenedPair, PairOpener

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from fractions import Fraction
    from pathlib import Path

    import numpy as np
    import pandas as pd

    from eldata.manifest.card import Subset
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Amplification
    from eldata.raw.levels import Clip as Clipping
    from eldata.raw.levels import FrameLevels
    from eldata.records import FrameRecord
    from eldata.sources.frames import Frame, FrameSource


class ClipWindows(CroppedItems):
    """Windows of clips of any source: ``dataset[i]`` is a :class:`~eldata.datasets.items.Sample`.

    Parameters
    ----------
    source
        Where the frames come from.
    rows
        Rows of a manifest, of the clips of this kind; patterns are expanded here.
    subsets
        Those of the manifest's card.
    place
        Where the source is, for messages.
    dynamic
        The clips have no reference: ``dataset[i]`` has no ``target``, and is not amplified.
    ids
        Which clips, such as ``["0007", "0013"]``: their scenes. ``None`` is all.
    window
        Number of frames of a sample.
    stride
        How far apart the samples of a clip begin; ``None`` is ``window``, so that none overlap.
    frames
        Which frames of a clip (:func:`eldata.manifest.clips.frame_range`): ``"all"``; ``"authors"``, those that the DRV
        repository's test_video.py takes, the fifth to the fourth from the end; ``"evaluation"``, five continuous ones
        as in the ELD paper, the fifth to the ninth (the paper does not say which).
    region
        (top, left, height, width) in pixels of the packed frame: the part that is kept of each frame. ``None`` is all
        of it: for DRV 15 MB a frame preprocessed and 80 MB raw. Or a random ``crop``: every frame and the reference are
        cut and turned alike.
    crops_per_window
        Items per window: the length is this times the number of windows, and item i is of window i modulo that number.
    cameras, scenes, isos, ratios, split, subset, exclude_flags
        Which clips: those of whose noisy frames one is chosen, as of :class:`~eldata.datasets.base.PairDataset`.
    levels, clip, amplification, dark_shading, crop, augment, crops, seed, transform
        As of :class:`~eldata.datasets.base.PairDataset`; by default the levels of the files.

    Raises
    ------
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
    DatasetError
        If the files of a chosen clip are not there or not in order. If the source knows its files' sizes and exposures:
        if those of a clip differ.
    """

    source: FrameSource

    def __init__(
        self,
        source: FrameSource,
        rows: Sequence[FrameRecord],
        subsets: Sequence[Subset],
        place: Path,
        *,
        dynamic: bool = False,
        ids: Collection[str] | None = None, window: int = 5, stride: int | None = None, frames: FrameRange = "all",
        region: Region | None = None, crops_per_window: int = 1,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels = "metadata", clip: Clipping = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None, transform: Transform | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        self._is_paired = not dynamic
        self.region = region
        if self.region is not None and (min(self.region[:2]) < 0 or min(self.region[2:]) < 1):
            raise ArgumentError(f"region must be (top, left, height, width), the sizes above 0; found {self.region}")
        if self.region is not None and crop is not None:
            raise ArgumentError("give a region or a crop, not both")
        super().__init__(crop, augment, crops, seed, transform, ("crops_per_window", crops_per_window))
        self.source = source
        self.root = place
        choice = Choice(cameras, scenes, isos, ratios, split, subset, exclude_flags)
        chosen = expand(choose_clips(rows, subsets, choice, ids=ids), place)
        self._choose_values(levels, clip, amplification, dark_shading, (row.camera for row in chosen))
        self._opener = PairOpener(source, levels, amplification, self.dark_shading)
        self.layout = describe_layout(chosen)
        self.clips = clips_of(chosen)
        unpaired = [each.scene for each in self.clips if each.reference is None]
        if self._is_paired and unpaired:
            raise DatasetError(f"{place}: no reference of {len(unpaired)} clips: {', '.join(unpaired)}")
        self._row_of = {row.path: row for row in chosen}
        self.records: tuple[ClipRecord, ...] = tuple(
            record
            for each in self.clips
            for record in windows(each, length=window, stride=window if stride is None else stride, frames=frames)
        )
        self._text = f"{len(self.clips)} clips, {len(self.records)} windows of {window} frames (frames={frames!r})"
        if self.reads_parts:
            for each in self.clips:
                self._check(each)
        like = cache(lambda path: self.source.frame(path).without_pixels())  # clips may have several windows
        self._count_items(len(self.records), (like(record.reference or record.path) for record in self.records))

    def _check(self, clip: Clip) -> None:
        """Make sure that the frames of a clip belong together."""
        open_target = cache(self._opener.open_target)
        first: OpenedPair | None = None
        for path, reference in zip(clip.frames, clip.references or (clip.reference,) * len(clip.frames), strict=True):
            pair = self._open_pair(path, None if reference is None else open_target(reference), first)
            first = first or pair

    @property
    def _may_differ(self) -> bool:
        """Whether frames are decoded whole, which takes so much memory that windows are read one by one."""
        return not self.reads_parts

    @property
    def frame(self) -> pd.DataFrame:
        """The records as a pandas DataFrame, one row per window."""
        import pandas as pd

        return pd.DataFrame([asdict(record) | {"frames": list(record.frames)} for record in self.records])

    def draw_item(self, place: int, generator: np.random.Generator) -> DrawnItem:
        """Draw a crop of window ``place`` modulo their number, or of a grid its crop."""
        number, tile = self._record_of(place)
        record = self.records[number]
        first = self._opener.open_target(record.reference or record.path)
        if self.region is not None:
            crop = Crop.region(first, self.region)
        else:
            crop = Crop.draw(first, generator, crop=self.crop, augment=self.augment, tile=tile)
        shapes: dict[str, tuple[int, ...]] = {"input": (len(record.frames), *crop.packed_shape)}
        if self._is_paired:
            shapes["target"] = shapes["input"] if record.references else crop.packed_shape
        return DrawnItem(crop, shapes, self._parts(record, first), {}, first.sensor)

    def _parts(self, record: ClipRecord, opened: Frame) -> Iterator[Part]:
        """Yield each reference before its frames, in order, none of them opened before the one before it was read.

        ``opened`` is the first reference, or the first frame of a clip without one.
        """
        target, noisy = (opened, None) if record.reference is not None else (None, opened)
        del opened
        first: OpenedPair | None = None
        for place, path in enumerate(record.frames):
            if target is not None and (not place or record.references):
                if place:
                    target = self._opener.open_target(record.references[place])
                yield Part("target", target, place if record.references else None, is_light=True)
                target = target.without_pixels()
            pair = self._open_pair(path, target, first, noisy)
            noisy = None
            facts = {} if place else facts_of(record, pair) | {"start": record.start}
            yield Part("input", pair.input, place, pair.gain, facts=facts)
            first = first or replace(pair, target=pair.target.without_pixels(), input=pair.input.without_pixels())
            del pair

    def _open_pair(
        self, path: str, target: Frame | None, first: OpenedPair | None, noisy: Frame | None = None
    ) -> OpenedPair:
        """Open a frame of a clip; raise DatasetError unless it is of the clip of the first one, and exposed like it."""
        pair = self._opener.open_pair(self._row_of[path], target, path, noisy)
        if first is not None and (pair.input.shape, pair.input.cfa) != (first.input.shape, first.input.cfa):
            raise DatasetError(
                f"{pair.input.name}: {pair.input.kind}, but {first.input.name} has {first.input.kind}; are they of one "
                "clip?"
            )
        if first is not None and pair.ratio != first.ratio:
            own, wanted = (math.nan if ratio is None else float(ratio) for ratio in (pair.ratio, first.ratio))
            raise DatasetError(
                f"{pair.input.name}: its exposure ratio is {own:g}, that of {first.input.name.rpartition('/')[2]} "
                f"{wanted:g}; are both frames of one clip? (eldata verify finds all such files)"
            )
        return pair

    @property
    def _crop_text(self) -> str:
        """The choice of crops, in words: a fixed region if there is one."""
        return super()._crop_text if self.region is None else f"region={self.region}"

    def _outline(self) -> list[tuple[str, str]]:
        """Describe the dataset by names and values: place, clips, files, then as for all items."""
        return [
            ("place", str(self.root)),
            ("clips", self._text),
            ("files", self.layout),
            ("values", self._describe_values()),
            *super()._outline(),
        ]
