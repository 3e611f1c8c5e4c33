"""Pairs of a store: random crops, equal to the bit to those of the raw files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypedDict, cast, get_args

import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.base.compiled import in_threads
from eldata.datasets.base import AMPLIFICATIONS, PairDataset, Sample, checked_ratio
from eldata.datasets.batches import Field, new_arrays, new_batch, reading_threads
from eldata.datasets.draws import CleanCrop, SharedEpoch
from eldata.datasets.stored_clean import stored_clean_frame, stored_mosaic
from eldata.errors import ArgumentError, DatasetError, check_choice
from eldata.manifest.pairs import select_pairs
from eldata.manifest.subsets import find_subset
from eldata.raw.cfa import CLIP_RANGES, pack_normalised, packed_black_level_dn, packed_shape, packing_sites
from eldata.raw.levels import FRAME_LEVELS, with_levels
from eldata.sources.store.read import PixelReader, open_store

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.datasets.base import Amplification
    from eldata.raw.cfa import CfaRows, Clip
    from eldata.raw.levels import FrameLevels
    from eldata.records import PairRecord, Sensor
    from eldata.sources.store.layout import StoredFrame


class DnSample(TypedDict):
    """One pair in DN: half as much to send from a worker as a :class:`~eldata.datasets.base.Sample`.

    ``input_dn`` and ``target_dn`` are (H, W) uint16, mosaics in DN as the files have them, the input not multiplied by
    ``ratio`` yet. ``cfa`` (their CFA, 2 x 2 or 6 x 6, uint8), ``input_black_dn``, ``target_black_dn`` (per CFA channel,
    float64) and the white levels are for :func:`normalise_batch`. The rest is as in
    :class:`~eldata.datasets.base.Sample`.
    """

    input_dn: torch.Tensor
    target_dn: torch.Tensor
    cfa: torch.Tensor
    input_black_dn: torch.Tensor
    target_black_dn: torch.Tensor
    input_white_dn: float
    target_white_dn: float
    ratio: float
    nominal_ratio: float
    iso: float
    exposure_s: float
    camera: str
    scene: str
    split: str
    path: str
    reference: str
    flags: str


Side = Literal["input", "target"]
_SIDES: tuple[Side, ...] = get_args(Side)
_DN_SIDES = tuple(f"{side}_dn" for side in _SIDES)
_NO_PIXELS = np.empty((0, 0, 0), np.float32)


@dataclass(frozen=True, slots=True)
class _Pair:
    """What is known of a pair before its pixels: both frames with the chosen levels, and the factor of the input."""

    noisy: StoredFrame
    noisy_sensor: Sensor
    reference: StoredFrame
    reference_sensor: Sensor
    ratio: Fraction


@dataclass(frozen=True, slots=True)
class _Item:
    """One item before its pixels are read: whose it is, and the part of both mosaics."""

    record: PairRecord
    pair: _Pair
    crop: CleanCrop

    @property
    def shape(self) -> tuple[int, int, int]:
        """That of the packed crop."""
        return self.crop.packed_shape

    def side(self, side: Side) -> tuple[StoredFrame, Sensor, float]:
        """Return the frame of a side, its levels, and what it is multiplied by."""
        pair = self.pair
        if side == "input":
            return pair.noisy, pair.noisy_sensor, float(pair.ratio)
        return pair.reference, pair.reference_sensor, 1.0


class PackedStore(PairDataset):
    """Pairs from a store that ``eldata pack`` made: ``dataset[i]`` is a :class:`~eldata.datasets.base.Sample`.

    Each item is a random crop of both frames of a pair, in one of eight orientations. Its values are those of the raw
    route (:class:`~eldata.datasets.base.PairDataset` on the files) at the same place, bit for bit. Item i of epoch e
    depends on (seed, e, i) alone: not on workers, their number, or what was read before. Call :meth:`set_epoch` before
    each epoch; it reaches workers that are running already.

    Parameters
    ----------
    path
        The store.
    crop
        Side of the square crop in packed pixels, even for X-Trans; ``None`` takes whole frames.
    augment
        Draw one of the eight orientations of the mosaic; the CFA stays in order.
    crops_per_frame
        Items per pair: the length is this times the number of pairs, and item i is of pair i modulo that number.
    seed
        First part of each item's seed.
    cameras, scenes, isos, ratios, splits, subset, exclude_flags
        Which of the store's pairs, as in :class:`~eldata.datasets.base.PairDataset`.
    levels, clip, amplification
        As in :class:`~eldata.datasets.base.PairDataset`: the store holds DN, so none of them is fixed by it.

    Raises
    ------
    StoreError
        If the file is no store, truncated, not complete, or of a newer version.
    DatasetError
        If the store holds no pairs, or frames of a pair differ in size, CFA or exposure ratio from what they should be.
    ArgumentError
        If an option is unknown or out of its range; the message lists the known ones.

    Notes
    -----
    Each process opens the store for itself, on its first read. Memory does not grow with the store.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        crop: int | None = 512,
        augment: bool = True,
        crops_per_frame: int = 1,
        seed: int = 0,
        cameras: Collection[str] | None = None,
        scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None,
        ratios: Collection[float | Fraction] | None = None,
        splits: Collection[str] | None = None,
        subset: str | None = None,
        exclude_flags: Collection[str] = (),
        levels: FrameLevels = "published",
        clip: Clip = "both",
        amplification: Amplification = "metadata",
    ) -> None:
        # Not the base's: that one looks for folders.
        for name, value, known in (
            ("levels", levels, FRAME_LEVELS),
            ("clip", clip, tuple(CLIP_RANGES)),
            ("amplification", amplification, AMPLIFICATIONS),
        ):
            check_choice(name, value, known)
        if seed < 0:
            raise ArgumentError(f"seed must be 0 or more; found {seed}")
        if crops_per_frame < 1 or (crop is not None and crop < 2):
            raise ArgumentError(
                f"crops_per_frame must be 1 or more and crop 2 or more; found {crops_per_frame}, {crop}"
            )
        store = open_store(path)
        if store.manifest is None:
            raise DatasetError(f"{path}: holds clean frames, not pairs; read it with StoredFrames")
        self.name = store.dataset
        self.root = store.path
        self.levels: FrameLevels = levels
        self.clip: Clip = clip
        self.amplification: Amplification = amplification
        self.crop = crop
        self.augment = augment
        self.crops_per_frame = crops_per_frame
        self.seed = seed
        frame_of = {frame.path: frame for frame in store.frames}
        held = [record for record in store.manifest.records if record.path in frame_of]
        if subset is not None:  # counted on the whole manifest: a store of a part may lack some
            chosen = find_subset(store.manifest.card.subsets, subset).choose(select_pairs(store.manifest.records))
            wanted = {pair.path for pair in chosen}
            lacking = sorted(wanted - set(frame_of))
            if lacking:
                raise DatasetError(
                    f"{path}: lacks {len(lacking)} of the {len(wanted)} pairs of the subset {subset!r}, such as "
                    f"{lacking[0]}; pack the whole dataset, or that subset"
                )
            held = [record for record in held if record.role != "noisy" or record.path in wanted]
        self.records: tuple[PairRecord, ...] = select_pairs(
            held,
            cameras=cameras,
            scenes=scenes,
            isos=isos,
            ratios=ratios,
            splits=splits,
            exclude_flags=exclude_flags,
        )
        self._pairs = tuple(self._pair(record, frame_of) for record in self.records)
        self._reader = PixelReader(store.path)
        self._compression = store.compression
        self._epoch = SharedEpoch()

    def _pair(self, record: PairRecord, frame_of: Mapping[str, StoredFrame]) -> _Pair:
        noisy, reference = frame_of[record.path], frame_of[record.reference]
        ratio = checked_ratio(record, reference.header(self.root), noisy.header(self.root))
        of_noisy, of_reference = (with_levels(frame.sensor, self.levels) for frame in (noisy, reference))
        shapes = [(sensor.height, sensor.width, sensor.cfa) for sensor in (of_noisy, of_reference)]
        if shapes[0] != shapes[1]:
            raise DatasetError(
                f"{self.root}: {record.path} has {shapes[0][:2]} pixels, CFA {shapes[0][2]}, but its reference "
                f"{record.reference} has {shapes[1][:2]}, {shapes[1][2]}"
            )
        applied = ratio if self.amplification == "metadata" else record.ratio
        return _Pair(noisy, of_noisy, reference, of_reference, applied)

    @property
    def epoch(self) -> int:
        """The current epoch."""
        return self._epoch.value

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose items are drawn from now on, in running workers too."""
        self._epoch.set(epoch)

    def __len__(self) -> int:
        return len(self.records) * self.crops_per_frame

    def __getitem__(self, index: int) -> Sample:
        """Read one pair's crop.

        Raises
        ------
        IndexError
            If the index is outside.
        DatasetError
            If a frame is smaller than the crop (with ``augment`` one period of the CFA more is needed).
        StoreError
            If the store cannot be read.
        """
        item = self._item(index)
        sides = new_arrays([Field(side, item.shape, "<f4") for side in _SIDES])
        in_threads(lambda side: self._side(item, side, sides[side]), _SIDES, reading_threads(self._compression, 1))
        return self._sample(item.record, sides["input"], sides["target"], item.pair.ratio, item.pair.noisy.exposure)

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Read the pairs of a batch into memory that is used again (:mod:`eldata.datasets.batches`).

        torch's DataLoader calls this. The values are those of ``dataset[i]``; errors too.
        """
        items = [self._item(index) for index in indices]
        shapes = {item.shape for item in items}
        fields = [Field(side, (len(items), *items[0].shape), "<f4") for side in _SIDES]
        batch = new_batch(fields) if len(shapes) == 1 else None
        if batch is None:
            return [self[index] for index in indices]
        places = [(number, side) for number in range(len(items)) for side in _SIDES]

        def work(place: tuple[int, Side]) -> None:
            number, side = place
            self._side(items[number], side, batch.arrays[side][number])

        in_threads(work, places, reading_threads(self._compression, len(items)))
        return batch.parts([self._facts(item) for item in items])

    def _facts(self, item: _Item) -> Sample:
        """Return an item's sample without pixels."""
        return self._sample(item.record, _NO_PIXELS, _NO_PIXELS, item.pair.ratio, item.pair.noisy.exposure)

    def in_dn(self) -> DnPairs:
        """Return the same items in DN, for :func:`normalise_batch` after the DataLoader."""
        return DnPairs(self)

    def dn_item(self, index: int) -> DnSample:
        """Read one pair's crop in DN; errors as of ``dataset[index]``."""
        item = self._item(index)
        mosaics = new_arrays([Field(name, (item.crop.height, item.crop.width), "<u2") for name in _DN_SIDES])
        for side in _SIDES:
            mosaics[f"{side}_dn"][...] = self._cut(item, item.side(side)[0])
        tensors = {name: torch.from_numpy(mosaic) for name, mosaic in mosaics.items()}
        return cast("DnSample", self._dn_facts(item) | tensors)

    def dn_items(self, indices: Sequence[int]) -> list[Any]:
        """Read the pairs of a batch in DN into memory that is used again, as :meth:`__getitems__` does."""
        items = [self._item(index) for index in indices]
        shapes = {(item.crop.height, item.crop.width, len(item.crop.cfa)) for item in items}
        first = items[0].crop
        fields = [Field(name, (len(items), first.height, first.width), "<u2") for name in _DN_SIDES]
        batch = new_batch(fields) if len(shapes) == 1 else None
        if batch is None:
            return [self.dn_item(index) for index in indices]
        places = [(number, side) for number in range(len(items)) for side in _SIDES]

        def work(place: tuple[int, Side]) -> None:
            number, side = place
            batch.arrays[f"{side}_dn"][number] = self._cut(items[number], items[number].side(side)[0])

        in_threads(work, places, reading_threads(self._compression, len(items)))
        return batch.parts([self._dn_facts(item) for item in items])

    def _dn_facts(self, item: _Item) -> dict[str, Any]:
        """Return an item's sample in DN without pixels."""
        fields: dict[str, Any] = {name: value for name, value in self._facts(item).items() if name not in _SIDES}
        fields["cfa"] = torch.tensor(item.crop.cfa, dtype=torch.uint8)
        for side in _SIDES:
            _, sensor, _ = item.side(side)
            fields[f"{side}_dn"] = None
            fields[f"{side}_black_dn"] = torch.tensor(sensor.black_level_dn, dtype=torch.float64)
            fields[f"{side}_white_dn"] = sensor.white_level_dn
        return fields

    def _item(self, index: int) -> _Item:
        if not -len(self) <= index < len(self):
            raise IndexError(f"index {index} is outside of {len(self)} items")
        index %= len(self)
        place = index % len(self.records)
        pair = self._pairs[place]
        generator = np.random.default_rng([self.seed, self.epoch, index])
        frame = stored_clean_frame(self._reader, pair.noisy, pair.noisy_sensor.white_level_dn)
        crop = CleanCrop.draw(frame, generator, crop=self.crop, augment=self.augment)
        return _Item(self.records[place], pair, crop)

    def _cut(self, item: _Item, frame: StoredFrame) -> NDArray[np.uint16]:
        """Return the item's part of a frame, turned, in borrowed memory: to be packed before the next one."""
        return item.crop.turned(stored_mosaic(self._reader, frame).borrow(item.crop.slices))

    def _side(self, item: _Item, side: Side, out: NDArray[np.float32]) -> None:
        """Fill one side of an item, packed, normalised and, if it is the input, amplified."""
        frame, sensor, gain = item.side(side)
        black, white = sensor.black_level_dn, sensor.white_level_dn
        pack_normalised(self._cut(item, frame), item.crop.cfa, black, white, clip=self.clip, gain=gain, out=out)

    def __repr__(self) -> str:
        base = super().__repr__().removesuffix(")").replace(f"{len(self)} pairs", f"{len(self.records)} pairs", 1)
        return (
            f"{base}, crop={self.crop}, augment={self.augment}, crops_per_frame={self.crops_per_frame}, "
            f"seed={self.seed})"
        )


class DnPairs(Dataset[DnSample]):
    """The items of a :class:`PackedStore` in DN, for a DataLoader whose batches go through :func:`normalise_batch`.

    Sending a batch from a worker takes longer than reading it; uint16 is half as much to send. The conversion then runs
    in the main process, or on the device that the batch was moved to.
    """

    def __init__(self, pairs: PackedStore) -> None:
        self.pairs = pairs

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[DnSample]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> DnSample:
        """Read one pair's crop in DN; errors as of :class:`PackedStore`."""
        return self.pairs.dn_item(index)

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Read the pairs of a batch in DN into memory that is used again."""
        return self.pairs.dn_items(indices)

    def __repr__(self) -> str:
        return f"DnPairs({self.pairs!r})"


def normalise_batch(batch: Mapping[str, Any], *, clip: Clip = "both") -> dict[str, Any]:
    """Pack, normalise and amplify a batch in DN, on the device that it lies on: the samples that the raw route gives.

    Where division and multiplication of float32 are IEEE's, as on the CPU, the values are those of
    :class:`PackedStore`, bit for bit.

    Parameters
    ----------
    batch
        A :class:`DnSample`, or several collated.
    clip
        As in :class:`~eldata.datasets.base.PairDataset`.

    Returns
    -------
    dict
        The batch with ``input`` and ``target``, (C, h, w) or (B, C, h, w) float32, in place of the mosaics and levels.

    Raises
    ------
    ArgumentError
        If ``clip`` is unknown, or the batch is not in DN.
    """
    check_choice("clip", clip, CLIP_RANGES)
    names = {"cfa", *(f"{side}_{what}" for side in _SIDES for what in ("dn", "black_dn", "white_dn"))}
    if not names <= set(batch) or batch["input_dn"].dtype != torch.uint16:
        raise ArgumentError("expected a batch in DN, as PackedStore(...).in_dn() gives it: uint16 with its levels")
    result = {name: value for name, value in batch.items() if name not in names}
    images = [image for side in _SIDES for image in _images(batch, side)]
    on_cpu = batch["input_dn"].device.type == "cpu"
    packed = _by_kernel(images, clip) if on_cpu else _by_torch(images, clip)
    if batch["input_dn"].ndim == 2:
        return result | dict(zip(_SIDES, packed, strict=True))
    return result | dict(zip(_SIDES, packed.chunk(2), strict=True))


class _Image(NamedTuple):
    """One mosaic (H, W) of a batch in DN, and how it is normalised."""

    mosaic: torch.Tensor
    cfa: CfaRows
    black_level_dn: tuple[float, ...]
    white_level_dn: float
    gain: float


def _images(batch: Mapping[str, Any], side: str) -> Iterator[_Image]:
    """Yield the images of one side of a batch; its numbers are fetched from the device at once."""
    several = batch["input_dn"].ndim == 3

    def each(value: Any) -> Any:
        values = torch.as_tensor(value).tolist()
        return values if several else [values]

    mosaics = batch[f"{side}_dn"] if several else batch[f"{side}_dn"][None]
    blacks, whites = each(batch[f"{side}_black_dn"]), each(batch[f"{side}_white_dn"])
    gains = each(batch["ratio"]) if side == "input" else [1.0] * len(mosaics)
    for mosaic, cfa, black, white, gain in zip(mosaics, each(batch["cfa"]), blacks, whites, gains, strict=True):
        yield _Image(mosaic, tuple(map(tuple, cfa)), tuple(black), white, gain)


def _by_kernel(images: Sequence[_Image], clip: Clip) -> torch.Tensor:
    """Return images packed by the one packer, (N, C, h, w), on as many threads as torch takes.

    Into memory that is used again: the pages of new memory would cost several times as much as the packing.
    """
    mosaics = [image.mosaic.numpy() for image in images]
    shape = len(images), *packed_shape(mosaics[0].shape, images[0].cfa)
    packed = new_arrays([Field("packed", shape, "<f4")])["packed"]

    def work(number: int) -> None:
        image = images[number]
        black, white = image.black_level_dn, image.white_level_dn
        pack_normalised(mosaics[number], image.cfa, black, white, clip=clip, gain=image.gain, out=packed[number])

    in_threads(work, range(len(images)), torch.get_num_threads())
    return torch.from_numpy(packed)


def _by_torch(images: Sequence[_Image], clip: Clip) -> torch.Tensor:
    """Return images packed by torch on their device, (N, C, h, w): the packer's operations, one by one."""
    first = images[0].mosaic
    shape = packed_shape((first.shape[0], first.shape[1]), images[0].cfa)
    packed = torch.empty((len(images), *shape), dtype=torch.float32, device=first.device)
    low, high = CLIP_RANGES[clip]
    for image, values in zip(images, packed, strict=True):
        sites = packing_sites(image.cfa)
        for row, column, channel, y, x in sites.table:
            site = image.mosaic[row :: sites.period, column :: sites.period]
            values[channel, y :: sites.sub, x :: sites.sub] = site.to(torch.float32)
        black = torch.from_numpy(packed_black_level_dn(image.cfa, image.black_level_dn)).to(first.device)[:, None, None]
        white = torch.tensor(image.white_level_dn, dtype=torch.float32, device=first.device)
        values.sub_(black).div_(white - black).clamp_(low, high)
        values.mul_(torch.tensor(image.gain, dtype=torch.float32, device=first.device)).clamp_(max=high)
    return packed
