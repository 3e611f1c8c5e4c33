"""What every dataset of pairs shares: crops of both frames, from any source, normalised alike."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any

from eldata.base.tables import frame_of
from eldata.datasets.crops import Crop
from eldata.datasets.items import CroppedItems, Crops, DrawnItem, Part, Transform, keywords_of, take_choice
from eldata.manifest.catalogue import FrameFiles, find_manifest
from eldata.protocols.named import default_protocol
from eldata.records import PairRecord, Records
from eldata.sources.frames import KEPT_BYTES, FileCheck, Files, Frame, FrameSource
from eldata.sources.pairs import OpenedPair, PairOpener

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    import numpy as np
    import pandas as pd

    from eldata.manifest.clips import ClipRecord
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Amplification
    from eldata.raw.levels import Clip, FrameLevels

SIDES = ("input", "target")


# Pairs whose frames stay open, 2 kB each. To open one again takes a tenth of a millisecond.
_MOST_OPEN = 4096


def facts_of(record: PairRecord | ClipRecord, pair: OpenedPair) -> dict[str, Any]:
    """Return the facts of a :class:`~eldata.datasets.items.Sample` that are known of an opened pair."""
    exposure = pair.input.exposure
    numbers = {"ratio": pair.ratio, "nominal_ratio": record.ratio}
    numbers |= {"iso": exposure.iso, "exposure_s": exposure.exposure_s}
    return {
        **{name: float(value or math.nan) for name, value in numbers.items()},
        **{name: getattr(record, name) for name in ("camera", "scene", "split", "path")},
        "reference": record.reference or "",
        "flags": ";".join(record.flags),
    }


class SourcePairs(CroppedItems):
    """Pairs of frames of any source: ``dataset[i]`` is a :class:`~eldata.datasets.items.Sample`.

    Parameters
    ----------
    source
        Where the frames come from; their paths are those of the records.
    records
        The pairs.
    name
        Of the dataset.
    levels, clip, amplification, dark_shading, crop, augment, crops, crops_per_frame, seed, transform
        As of :class:`PairDataset`; by default the levels of the files.
    """

    source: FrameSource

    def __init__(
        self,
        source: FrameSource,
        records: Collection[PairRecord],
        *,
        name: str = "",
        levels: FrameLevels = "metadata", clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None,
    ) -> None:  # fmt: skip
        self.source = source
        self.records: tuple[PairRecord, ...] = Records(records)
        self.name = self._place = name
        self._choose_values(levels, clip, amplification, dark_shading, (record.camera for record in self.records))
        self._opener = PairOpener(source, levels, amplification, self.dark_shading)
        self.crops_per_frame = crops_per_frame
        super().__init__(crop, augment, crops, seed, transform, ("crops_per_frame", crops_per_frame))
        self._pairs: dict[int, OpenedPair] = {}
        if self.reads_parts:
            self._check_pairs()
        like = cache(lambda path: self.source.frame(path).without_pixels())  # a reference may have several pairs
        self._count_items(len(self.records), (like(record.reference) for record in self.records))

    @property
    def frame(self) -> pd.DataFrame:
        """The records as a pandas DataFrame, one row per pair, numbers as floats."""
        return frame_of(self.records)

    def draw_item(self, place: int, generator: np.random.Generator) -> DrawnItem:
        """Draw a crop of pair ``place`` modulo their number, or of a grid its crop."""
        number, tile = self._record_of(place)
        record = self.records[number]
        pair = self._pairs.get(number)
        target = self._opener.open_target(record.reference) if pair is None else pair.target
        if pair is None and target.reads_parts:
            pair = self._opener.open_pair(record, target)
            if pair.input.reads_parts:  # the pairs of a small set stay open
                if len(self._pairs) >= _MOST_OPEN:
                    self._pairs.clear()
                self._pairs[number] = pair
        crop = Crop.draw(target, generator, crop=self.crop, augment=self.augment, tile=tile)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(SIDES, crop.packed_shape)
        return DrawnItem(crop, shapes, self._parts(record, target, pair), {}, target.sensor)

    def _parts(self, record: PairRecord, target: Frame, pair: OpenedPair | None) -> Iterator[Part]:
        """Yield the target, then the input, which is opened once the target was read unless it is open already."""
        yield Part("target", target, is_light=True)
        if pair is None:
            target = target.without_pixels()
            pair = self._opener.open_pair(record, target)
        yield Part("input", pair.input, gain=pair.gain, facts=facts_of(record, pair))

    def _check_pairs(self) -> None:
        """Refuse frames that are not a pair. One pair of each kind is opened: the source knows all but pixels."""
        kinds = set()
        numbers: dict[object, int] = {}
        # Of a reference once; by number, for to look at the hash of fractions takes longer than all else here.
        kind_of = cache(lambda path: numbers.setdefault(_kind_of(self.source.frame(path)), len(numbers)))
        for record in self.records:
            own = record.camera, record.ratio, record.flags
            kind = kind_of(record.reference), kind_of(record.path), own
            if kind not in kinds:
                kinds.add(kind)
                self._opener.open_pair(record, self._opener.open_target(record.reference))

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pairs": {}}  # each process opens those that it reads

    def _outline(self) -> list[tuple[str, str]]:
        """Describe the dataset by names and values: place, pairs, cameras, ISO, ratios, then as for all items."""
        scenes = len({(record.camera, record.scene) for record in self.records})
        named = (("cameras", "camera"), ("splits", "split"), ("ISO", "iso"), ("ratios", "ratio"))
        return [
            ("place", self._place),
            ("pairs", f"{len(self.records)} of {scenes} scenes"),
            *((name, self._list_values(field)) for name, field in named),
            ("values", self._describe_values()),
            *super()._outline(),
        ]

    def _list_values(self, field: str) -> str:
        """List the distinct values of a field of the records in words; of many, their number."""
        distinct = dict.fromkeys(getattr(record, field) for record in self.records)
        texts = [f"{float(value):g}" if isinstance(value, Fraction) else str(value) for value in distinct]
        return ", ".join(texts) if len(texts) <= 6 else f"{len(texts)} values"


class PairDataset(SourcePairs):
    """Pairs of a manifest, decoded from their files: ``dataset[i]`` is a :class:`~eldata.datasets.items.Sample`.

    Parameters
    ----------
    root
        The dataset's own folder, such as ``data/ELD``. Default: the card's folder below ``$ELDATA_ROOT`` or ``./data``.
    manifest
        A manifest's CSV file, or the name of a shipped one.
    cameras, scenes, isos, ratios
        Which pairs: values, or one alone; ``None`` means all. A scene is its name or its number: 3 for ``scene-3``, 34
        for ``00034``. A ratio is the nominal one.
    split
        Name of a split, or several.
    subset
        Name of a subset on the dataset's card (:mod:`eldata.manifest.card`); the rest chooses within it.
    exclude_flags
        What has one of these flags is left out.
    levels
        ``"published"``: white level 16383 for every camera; ``"metadata"``: the file's own. Black is the file's either
        way. Or the constants of the SID code, or of LRID's, by name: :func:`eldata.raw.levels.with_levels`. RGB is
        divided by 65535. ``None``: those of the protocol that the set's card names: ``"published"`` of ELD and SID,
        ``"metadata"`` of a set of one's own.
    clip
        Of the input. ``"both"``: the normalised frame is clipped to [0, 1] before and after it is multiplied by the
        ratio, as published; ``"upper"``: at 1 only, so that negative read noise is kept; ``"none"``. The target lies in
        [0, 1] whatever it is.
    amplification
        What the input is multiplied by: ``"metadata"``, the ratio of ISO times exposure time that the files state,
        or ``"nominal"``, the manifest's ratio. The files' ratio is checked each time.
    dark_shading
        What the sensor shows of itself in the dark (:class:`~eldata.noise.DarkShading`, or its file), taken off the
        input, in DN of the file, before anything is clipped. A frame of another model, size, CFA or ISO is refused.
    crop
        Side of the square crop in pixels of the packed (or RGB) frame, even for X-Trans; ``None`` takes whole frames.
    augment
        Draw one of the eight orientations; a mosaic's CFA stays in order.
    crops
        ``"random"``: each item is of a place that is drawn. ``"grid"``: the crops lie side by side from the frame's
        first row and column on, in order with the CFA, and each is one item, so once an epoch, turned anew in each (K.
        Wei et al., TPAMI 2021, section 4.1.1). What is left over at the bottom and at the right is in none; turning a
        mosaic shifts a crop by at most one period of its CFA. Frames that are decoded whole are decoded once for their
        size as the dataset is made.
    crops_per_frame
        Items per pair: the length is this times the number of pairs, and item i is of pair i modulo that number.
    seed
        First part of each item's seed, below 2^128: draw k of item i depends on (seed, k, i) alone. The k-th time that
        an item is asked for it is draw k, whatever the workers; after :meth:`set_epoch` always that of the epoch.
    transform
        A callable that gets a whole sample, a dict, after crop and noise, and returns it, or what you make of it. It is
        called in workers, which it must be sent to: a function at the top of a module, or a module of torchvision's v2.
        Plots show samples without it.
    check
        ``"exists"``: that every chosen file is there, as the dataset is made; ``"never"``: ``records``, ``frame`` and
        the length need no files.

    Raises
    ------
    DatasetError
        If a chosen file, its camera's folder or the set's is not there; of an item, if ``check`` is ``"never"``.
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
    ManifestError
        If the manifest is malformed.

    Notes
    -----
    Frames of different cameras differ in size: with more than one camera use ``batch_size=1``, or crops. Crops of
    uncompressed raws, and of DNGs in tiles of lossless JPEG, are read alone. Of other files those that were decoded
    last are kept for the next of several crops (``dataset.source.kept.most`` bytes in all workers of a loader, 512 MB),
    which :func:`~eldata.datasets.training_loader` puts near each other (``records_at_a_time``); else they are decoded
    on each access, and read far faster from a store (:class:`~eldata.datasets.packed.PackedStore`).
    """

    source: Files

    def __init__(
        self,
        root: Path | str | None,
        manifest: Path | str,
        *,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None, check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        options = keywords_of(locals(), "root", "manifest", "check")
        loaded = find_manifest(manifest)
        self.root = loaded.own_folder(root)
        loaded = loaded.of_copy(self.root)
        records = take_choice(options).pairs(loaded.records, loaded.card.subsets)
        files = Files(FrameFiles.of(self.root, loaded.card, loaded.records), loaded.records, loaded.card)
        files.require(records, check)
        options["levels"] = levels or default_protocol(loaded.card).frame_levels
        super().__init__(files, records, name=loaded.name, **options)
        self._place = str(self.root)
        if crops_per_frame > 1 or crops == "grid":
            files.kept.most = KEPT_BYTES


def _kind_of(frame: Frame) -> tuple[object, ...]:
    """Return all facts of a frame that decide with which others it makes a pair: all but its colours."""
    exposure = frame.exposure
    return frame.shape, frame.cfa, frame.black_level_dn, frame.white_level_dn, exposure.iso, exposure.exposure_s
