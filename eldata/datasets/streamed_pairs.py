"""Pairs streamed from shards: the samples of a store, for disks and networks that like to be read forward."""

from __future__ import annotations

import copy
import math
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from eldata.base.compiled import in_threads
from eldata.datasets.base import AMPLIFICATIONS, Sample
from eldata.datasets.batches import Field, new_arrays, new_batch, threads_here
from eldata.datasets.clean import CleanFrame
from eldata.datasets.draws import CleanCrop, SharedEpoch
from eldata.datasets.ranks import Rank, current_rank
from eldata.errors import ArgumentError, check_choice
from eldata.raw.cfa import CLIP_RANGES, pack_normalised, packed_shape
from eldata.raw.levels import FRAME_LEVELS, with_levels
from eldata.sources.shards import splitting
from eldata.sources.shards.remote import Folder
from eldata.sources.shards.samples import read_run, read_sample
from eldata.sources.shards.shuffling import shuffled_through

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.datasets.base import Amplification
    from eldata.raw.cfa import Clip
    from eldata.raw.levels import FrameLevels
    from eldata.sources.shards.layout import Facts
    from eldata.sources.shards.members import Sample as StoredSample

# Keep these random numbers apart from those of the items, which are seeded by (seed, epoch, index).
_SHARDS, _BUFFER = 1, 2

Side = Literal["input", "target"]
SIDES: tuple[Side, ...] = get_args(Side)
_NO_PIXELS = torch.empty((0, 0, 0))


@dataclass(frozen=True, slots=True, eq=False)
class _Item:
    """One item that waits in the buffer: what is known of it, and both crops in DN, turned, in memory of their own."""

    facts: Facts
    crop: CleanCrop
    input_dn: NDArray[np.uint16]
    target_dn: NDArray[np.uint16]


class StreamedPairs(IterableDataset[Sample]):
    """Pairs from shards that ``eldata shard`` wrote: yields :class:`~eldata.datasets.base.Sample`.

    Values are those of :class:`~eldata.datasets.packed_store.PackedStore` at the same place, bit for bit. Each item
    depends on (seed, epoch, its number) alone; which items come when also on the number of ranks and workers. Give it
    to :func:`~eldata.datasets.loading.training_loader` or :func:`~eldata.datasets.loading.evaluation_loader`. In a
    DataLoader of your own it is shuffled, and each item comes exactly once over all ranks and workers.

    Parameters
    ----------
    address
        The folder of shards: a path, or any address that fsspec takes, such as ``s3://bucket/sid`` or
        ``https://host/sid`` (whose packages are to be installed: the extra ``streaming`` has that of http).
    crop
        Side of the square crop in packed pixels, even for X-Trans; ``None`` takes the tile's side, or whole frames
        where whole frames were written.
    augment
        Draw one of the eight orientations of the mosaic; the CFA stays in order.
    crops_per_tile
        Items per sample of the shards: it is read once for all of them.
    shuffle_buffer
        Crops among which the next one is drawn; so many are in memory, in DN, in each worker.
    seed
        First part of each item's seed, and of the order's.
    levels, clip, amplification
        As in :class:`~eldata.datasets.base.PairDataset`.
    rank
        Which process of how many this is; ``None`` asks torch.distributed at each iteration.
    storage_options
        Options of fsspec's file system, such as credentials.
    attempts, retry_wait_s
        How often a remote read is tried without any progress, and the seconds before the second attempt, which double.

    Raises
    ------
    ShardError
        If there is no index at the address, or it is damaged or of a newer version; while iterating, if a shard is
        missing, truncated, damaged, or holds anything but samples.
    DatasetError
        While iterating, if a sample is smaller than the crop (with ``augment`` one period of the CFA more is needed).
    ArgumentError
        If an option is unknown or out of its range, or fsspec cannot open the address.
    """

    def __init__(
        self,
        address: str,
        *,
        crop: int | None = None,
        augment: bool = True,
        crops_per_tile: int = 1,
        shuffle_buffer: int = 64,
        seed: int = 0,
        levels: FrameLevels = "published",
        clip: Clip = "both",
        amplification: Amplification = "metadata",
        rank: Rank | None = None,
        storage_options: Mapping[str, Any] | None = None,
        attempts: int = 5,
        retry_wait_s: float = 0.5,
    ) -> None:
        super().__init__()
        for name, value, known in (
            ("levels", levels, FRAME_LEVELS),
            ("clip", clip, tuple(CLIP_RANGES)),
            ("amplification", amplification, AMPLIFICATIONS),
        ):
            check_choice(name, value, known)
        if seed < 0:
            raise ArgumentError(f"seed must be 0 or more; found {seed}")
        if crops_per_tile < 1 or shuffle_buffer < 1 or (crop is not None and crop < 2):
            raise ArgumentError(
                "crops_per_tile and shuffle_buffer must be 1 or more and crop 2 or more; found "
                f"{crops_per_tile}, {shuffle_buffer}, {crop}"
            )
        self.folder = Folder(str(address), storage_options or {}, attempts, retry_wait_s)
        self.index = self.folder.read_index()
        if crop is not None and self.index.tile is not None and crop > self.index.tile:
            raise ArgumentError(f"crop must be at most the tiles' side, {self.index.tile}; found {crop}")
        self.crop = self.index.tile if crop is None else crop
        self.augment = augment
        self.crops_per_tile = crops_per_tile
        self.shuffle_buffer = shuffle_buffer
        self.seed = seed
        self.levels: FrameLevels = levels
        self.clip: Clip = clip
        self.amplification: Amplification = amplification
        self.rank = rank
        self._epoch = SharedEpoch()
        self._order: Literal["shuffled", "stored"] = "shuffled"
        self._parts: Literal["exact", "even"] = "exact"
        self._batch_size: int | None = None  # not known in a DataLoader of the user's own

    # --- for whom ---------------------------------------------------------------------------------------------

    def for_training(self, batch_size: int, rank: Rank) -> StreamedPairs:
        """Return the same pairs shuffled, as many on every rank, and split over workers in whole batches.

        Fewer items than there are ranks are left out, others each epoch. The epoch is shared with this dataset.
        """
        return self._with(_order="shuffled", _parts="even", _batch_size=batch_size, rank=rank)

    def for_evaluation(self, batch_size: int, rank: Rank) -> StreamedPairs:
        """Return the same pairs in the order of the shards, each item exactly once over all ranks."""
        return self._with(_order="stored", _parts="exact", _batch_size=batch_size, rank=rank)

    def _with(self, **changes: Any) -> StreamedPairs:
        changed = copy.copy(self)
        changed.__dict__.update(changes, _epoch=self._epoch)
        return changed

    @property
    def epoch(self) -> int:
        """The current epoch."""
        return self._epoch.value

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch that the next iteration gives, in running workers too."""
        self._epoch.set(epoch)

    @cached_property
    def sample_bytes(self) -> int:
        """Size of an item's two arrays: of the first sample of the first shard, which is read for it."""
        first = read_sample(self.folder, self.index, splitting.Run(0, 0, 1))
        shape = packed_shape(first.input_dn.shape, first.facts.input.sensor.cfa)
        pixels = math.prod(shape[1:]) if self.crop is None else self.crop**2
        return 2 * 4 * shape[0] * pixels

    @property
    def buffer_bytes(self) -> int:
        """What each worker holds beside its batches: the buffer, in DN, and a sample as it is read."""
        buffer = self.shuffle_buffer if self._order == "shuffled" else 0
        return buffer * self.sample_bytes // 2 + max(int(shard.sample_bytes.max()) for shard in self.index.shards)

    def __getstate__(self) -> dict[str, Any]:
        # A worker that was not forked knows nothing of torch.distributed.
        return self.__dict__ | ({"rank": self._rank()} if get_worker_info() is None else {})

    def _rank(self) -> Rank:
        return current_rank() if self.rank is None else self.rank

    def _part(self) -> range:
        """Return the places of this rank's items in the epoch's sequence."""
        total = len(self.index) * self.crops_per_tile
        rank = self._rank()
        split = splitting.even_part if self._parts == "even" else splitting.exact_part
        return split(total, rank.number, rank.of)

    def __len__(self) -> int:
        return len(self._part())

    # --- reading ----------------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Sample]:
        info = get_worker_info()
        worker, workers = (0, 1) if info is None else (info.id, info.num_workers)
        epoch = self.epoch
        places = splitting.worker_part(self._part(), worker, workers, self._batch_size or 1)
        with closing(self._items(places, epoch)) as read:
            items: Iterator[_Item] = read
            if self._order == "shuffled":
                rank = self._rank()
                generator = self._generator(epoch, _BUFFER, rank.number, rank.of, worker, workers)
                items = shuffled_through(read, self.shuffle_buffer, generator)
            if self._batch_size is None:
                yield from map(self._sample, items)
            else:
                while batch := list(islice(items, self._batch_size)):
                    yield from self._batch(batch)

    def _generator(self, epoch: int, *what: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence((self.seed, epoch), spawn_key=what))

    def _items(self, places: range, epoch: int) -> Generator[_Item]:
        """Yield the items at some places of the epoch's sequence."""
        if not places:
            return
        lengths = [len(shard) for shard in self.index.shards]
        if self._order == "shuffled":
            runs = splitting.shuffled(lengths, self._generator(epoch, _SHARDS))
        else:
            runs = splitting.in_order(lengths)
        each = self.crops_per_tile
        samples = range(places.start // each, (places.stop - 1) // each + 1)
        place = samples.start * each
        for run in splitting.cut(runs, samples):
            with closing(read_run(self.folder, self.index, run)) as read:
                for sample in read:
                    for crop in range(each):
                        if place in places:
                            yield self._item(sample, crop, epoch)
                        place += 1

    def _item(self, sample: StoredSample, crop: int, epoch: int) -> _Item:
        # The same as PackedStore's, where whole frames were written: its items are numbered in this way.
        generator = np.random.default_rng([self.seed, epoch, sample.number + crop * len(self.index)])
        sensor = sample.facts.input.sensor
        name = f"{self.folder.address}: {sample.facts.record.path}"
        like = CleanFrame(sample.input_dn, sensor.cfa, sensor.black_level_dn, sensor.white_level_dn, name)
        drawn = CleanCrop.draw(like, generator, crop=self.crop, augment=self.augment)
        cuts = (drawn.turned(mosaic[drawn.slices]).copy() for mosaic in (sample.input_dn, sample.target_dn))
        return _Item(sample.facts, drawn, *cuts)

    def _batch(self, items: Sequence[_Item]) -> Iterator[Sample]:
        """Yield the samples of a batch in memory that is used again (:mod:`eldata.datasets.batches`)."""
        shapes = {packed_shape(item.input_dn.shape, item.crop.cfa) for item in items}
        shape = len(items), *min(shapes)
        batch = None if len(shapes) > 1 else new_batch([Field(side, shape, "<f4") for side in SIDES])
        if batch is None:
            yield from map(self._sample, items)
            return

        def work(place: tuple[int, Side]) -> None:
            number, side = place
            self._fill(items[number], side, batch.arrays[side][number])

        in_threads(work, [(number, side) for number in range(len(items)) for side in SIDES], threads_here())
        parts: Any = batch.parts([self._facts(item) for item in items])
        yield from parts

    def _sample(self, item: _Item) -> Sample:
        shape = packed_shape(item.input_dn.shape, item.crop.cfa)
        arrays = new_arrays([Field(side, shape, "<f4") for side in SIDES])
        for side in SIDES:
            self._fill(item, side, arrays[side])
        pixels = {side: torch.from_numpy(array) for side, array in arrays.items()}
        return cast("Sample", {**self._facts(item), **pixels})

    def _facts(self, item: _Item) -> Sample:
        """Return an item's sample without pixels."""
        record = item.facts.record
        exposure = item.facts.input.exposure
        return Sample(
            input=_NO_PIXELS,
            target=_NO_PIXELS,
            ratio=self._ratio(item),
            nominal_ratio=float(record.ratio),
            iso=float(exposure.iso or 0),
            exposure_s=float(exposure.exposure_s or 0),
            camera=record.camera,
            scene=record.scene,
            split=record.split,
            path=record.path,
            reference=record.reference,
            flags=";".join(record.flags),
        )

    def _ratio(self, item: _Item) -> float:
        """Return what the input is multiplied by."""
        return float(item.facts.ratio if self.amplification == "metadata" else item.facts.record.ratio)

    def _fill(self, item: _Item, side: Side, out: NDArray[np.float32]) -> None:
        """Write one side of an item, packed and normalised."""
        if side == "input":
            pixels, frame, gain = item.input_dn, item.facts.input, self._ratio(item)
        else:
            pixels, frame, gain = item.target_dn, item.facts.target, 1.0
        sensor = with_levels(frame.sensor, self.levels)
        black, white = sensor.black_level_dn, sensor.white_level_dn
        pack_normalised(pixels, item.crop.cfa, black, white, clip=self.clip, gain=gain, out=out)

    def __repr__(self) -> str:
        tile = "whole frames" if self.index.tile is None else f"tiles of {self.index.tile}"
        return (
            f"StreamedPairs({self.folder.address!r}, {self.index.dataset}: {len(self.index)} {tile} in "
            f"{len(self.index.shards)} shards, crop={self.crop}, augment={self.augment}, "
            f"crops_per_tile={self.crops_per_tile}, shuffle_buffer={self.shuffle_buffer}, seed={self.seed}, "
            f"levels={self.levels!r}, clip={self.clip!r}, amplification={self.amplification!r})"
        )
