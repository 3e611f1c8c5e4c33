"""Pairs streamed from shards: the samples of a store, for disks and networks that like to be read forward."""

from __future__ import annotations

import copy
import math
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, pairwise
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Unpack

import numpy as np
from torch.utils.data import IterableDataset, get_worker_info

from eldata.base.arguments import spell_keywords
from eldata.base.seeds import checked_seed, item_generator, purpose_sequence
from eldata.datasets.base import OpenedPair, PairItem, Sample
from eldata.datasets.choices import Representation, chosen_shading, shading_text, understood
from eldata.datasets.crops import Crop, Orientation
from eldata.datasets.items import Epochs, ReadItems, SharedNumber
from eldata.datasets.ranks import Rank, current_rank
from eldata.errors import ArgumentError
from eldata.raw.cfa import packed_shape
from eldata.sources.frames import Frame, stated_ratio
from eldata.sources.shards.reading import Folder, read_samples

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
    from collections.abc import Set as AbstractSet

    from numpy.typing import NDArray

    from eldata.protocols.protocol import Amplification
    from eldata.raw.levels import Clip, FrameLevels
    from eldata.sources.shards.index import StoredSample

# Keep these random numbers apart from those of the items, which are seeded by (seed, epoch, index).
_SHARDS, _BUFFER = 1, 2


class StreamOptions(Representation, total=False):
    """Keyword arguments of :class:`StreamedPairs` beside those that are its own."""

    crops_per_frame: int


class _Crops(ReadItems[Sample]):
    """Crops in DN, turned, in memory of their own, that become samples."""

    reads_parts = True
    _may_differ = False

    def __init__(self, items: Sequence[PairItem], clip: Clip) -> None:
        self.items = items
        self.clip = clip

    def __len__(self) -> int:
        return len(self.items)

    def item(self, index: int) -> PairItem:
        return self.items[index]


class StreamedPairs(Epochs, IterableDataset[Sample]):
    """Pairs from shards that ``eldata shard`` wrote: yields :class:`~eldata.datasets.base.Sample`.

    Values are those of :class:`~eldata.datasets.packed.PackedStore` at the same place, bit for bit. Each item
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
    crops_per_frame
        Items per sample of the shards: it is read once for all of them.
    shuffle_buffer
        Crops among which the next one is drawn; so many are in memory, in DN, in each worker.
    seed
        First part of each item's seed, and of the order's.
    levels, clip, amplification, dark_shading
        See :class:`~eldata.datasets.choices.Representation`. Which pairs there are was chosen as shards were written.
    rank
        Which process of how many this is; ``None`` asks torch.distributed at each iteration.
    storage_options
        Options of fsspec's file system, such as credentials.
    attempts, retry_wait_s
        How often a remote read is tried without any progress, and the seconds before the second attempt, which double.
    timeout_s
        A web server of which no byte comes for so long has failed; other places have options of their own.

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

    @spell_keywords(StreamOptions)
    def __init__(
        self,
        address: str,
        *,
        crop: int | None = None,
        augment: bool = True,
        shuffle_buffer: int = 64,
        seed: int = 0,
        rank: Rank | None = None,
        storage_options: Mapping[str, Any] | None = None,
        attempts: int = 5,
        retry_wait_s: float = 0.5,
        timeout_s: float = 60.0,
        **options: Unpack[StreamOptions],
    ) -> None:
        super().__init__()
        if "crops" in options:
            raise ArgumentError("shards have no crops=: they are tiles, each of which comes once (eldata shard --tile)")
        (given,) = understood(self, options, StreamOptions)
        crops_per_frame: int = given.get("crops_per_frame", 1)
        if crops_per_frame < 1 or shuffle_buffer < 1 or (crop is not None and crop < 2):
            raise ArgumentError(
                "crops_per_frame and shuffle_buffer must be 1 or more and crop 2 or more; found "
                f"{crops_per_frame}, {shuffle_buffer}, {crop}"
            )
        self.folder = Folder(str(address), storage_options or {}, attempts, retry_wait_s, timeout_s)
        self.index = self.folder.read_index()
        if crop is not None and self.index.tile is not None and crop > self.index.tile:
            raise ArgumentError(f"crop must be at most the tiles' side, {self.index.tile}; found {crop}")
        self.crop = self.index.tile if crop is None else crop
        self.augment = augment
        self.crops_per_frame = crops_per_frame
        self.shuffle_buffer = shuffle_buffer
        self.seed = checked_seed(seed)
        self.levels: FrameLevels = given.get("levels", self.index.levels)
        self.clip: Clip = given.get("clip", "both")
        self.amplification: Amplification = given.get("amplification", "metadata")
        self.dark_shading = chosen_shading(given)
        self.rank = rank
        self._first_batch = SharedNumber()
        self._order: Literal["shuffled", "stored"] = "shuffled"
        self._parts: Literal["exact", "even"] = "exact"
        self._batch_size: int | None = None  # not known in a DataLoader of the user's own

    # --- for whom ---------------------------------------------------------------------------------------------

    def for_training(self, batch_size: int, rank: Rank) -> StreamedPairs:
        """Return the same pairs shuffled, as many on every rank, and split over workers in whole batches.

        Fewer items than there are ranks are left out, others each epoch. The epoch is shared with this dataset, the
        batch that an epoch begins with is not.
        """
        first = SharedNumber()
        return self._with(_order="shuffled", _parts="even", _batch_size=batch_size, _first_batch=first, rank=rank)

    def for_evaluation(self, batch_size: int, rank: Rank) -> StreamedPairs:
        """Return the same pairs in the order of the shards, each item exactly once over all ranks."""
        return self._with(_order="stored", _parts="exact", _batch_size=batch_size, rank=rank)

    def _with(self, **changes: Any) -> StreamedPairs:
        changed = copy.copy(self)
        changed.__dict__.update(changes, _epoch=self._epoch)
        return changed

    def set_first_batch(self, number: int) -> None:
        """Choose from which of its rank's batches on the next iteration gives an epoch: for training alone."""
        self._first_batch.set(number)

    @cached_property
    def sample_bytes(self) -> int:
        """Size of an item's two arrays: of the first sample of the first shard, which is read for it."""
        with closing(read_samples(self.folder, self.index, 0, range(1))) as samples:
            first = next(samples)
        shape = packed_shape(first.input_dn.shape, first.facts.input.sensor.cfa)
        pixels = math.prod(shape[1:]) if self.crop is None else self.crop**2
        return 2 * 4 * shape[0] * pixels

    @property
    def buffer_bytes(self) -> int:
        """What each worker holds beside its batches: the buffer, in DN, and a sample as it is read."""
        buffer = self.shuffle_buffer if self._order == "shuffled" else 0
        in_dn = 2 if self.dark_shading is None else 3  # uint16; inputs less a dark shading are float32
        return buffer * self.sample_bytes * in_dn // 4 + max(
            int(shard.sample_bytes.max()) for shard in self.index.shards
        )

    def __getstate__(self) -> dict[str, Any]:
        # A worker that was not forked knows nothing of torch.distributed.
        return self.__dict__ | ({"rank": self._rank()} if get_worker_info() is None else {})

    def _rank(self) -> Rank:
        return current_rank() if self.rank is None else self.rank

    def _part(self) -> range:
        """Return the places of this rank's items in the epoch's sequence."""
        total = len(self.index) * self.crops_per_frame
        rank = self._rank()
        split = even_part if self._parts == "even" else exact_part
        return split(total, rank.number, rank.of)

    def __len__(self) -> int:
        return len(self._part())

    # --- reading ----------------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Sample]:
        info = get_worker_info()
        process, workers = (0, 1) if info is None else (info.id, info.num_workers)
        epoch, batch_size = self.epoch, self._batch_size or 1
        parts = [worker_part(self._part(), worker, workers, batch_size) for worker in range(workers)]
        worker, batches = turns([len(part) // batch_size for part in parts], self._first_batch.value)[process]
        # Which item comes when is decided by numbers alone, so those that were given out before are not read.
        order = self._order_of(parts[worker], epoch, worker, workers)
        given = frozenset(islice(order, batches * batch_size))
        with closing(self._items(parts[worker], epoch, given)) as read:
            items = as_called(read, order)
            while batch := list(islice(items, batch_size)):
                crops = _Crops(batch, self.clip)
                yield from crops if self._batch_size is None else crops.__getitems__(range(len(batch)))

    def _order_of(self, places: range, epoch: int, worker: int, workers: int) -> Iterator[int]:
        """Return a worker's places in the order in which their items are given out."""
        if self._order == "stored":
            return iter(places)
        rank = self._rank()
        generator = self._generator(epoch, _BUFFER, rank.number, rank.of, worker, workers)
        return shuffled_through(places, self.shuffle_buffer, generator)

    def _generator(self, epoch: int, purpose: int, *place: int) -> np.random.Generator:
        return np.random.default_rng(purpose_sequence(self.seed, epoch, purpose, *place))

    def _items(
        self, places: range, epoch: int, given: AbstractSet[int] = frozenset()
    ) -> Generator[tuple[int, PairItem]]:
        """Yield some places of the epoch's sequence and the items there, but for those that were given out before."""
        if not places:
            return
        lengths = [len(shard) for shard in self.index.shards]
        runs = shuffled(lengths, self._generator(epoch, _SHARDS)) if self._order == "shuffled" else in_order(lengths)
        each = self.crops_per_frame
        samples = range(places.start // each, (places.stop - 1) // each + 1)
        at = samples.start * each
        for run in cut(runs, samples):
            wanted: dict[int, list[int]] = {}  # the places of each sample that is read
            for number in range(run.first, run.last):
                if its := [place for place in range(at, at + each) if place in places and place not in given]:
                    wanted[number] = its
                at += each
            with closing(read_samples(self.folder, self.index, run.shard, list(wanted))) as read:
                for sample, its in zip(read, wanted.values(), strict=True):
                    for place in its:
                        yield place, self._item(sample, place % each, epoch)

    def _item(self, sample: StoredSample, crop: int, epoch: int) -> PairItem:
        # The same as PackedStore's, where whole frames were written: its items are numbered in this way.
        generator = item_generator(self.seed, epoch, sample.number + crop * len(self.index))
        facts = sample.facts
        name = f"{self.folder.address}: {facts.record.path}"
        frames = [
            Frame.of_raw(mosaic, side.sensor, name, side.exposure).with_levels(self.levels)
            for mosaic, side in ((sample.target_dn, facts.target), (sample.input_dn, facts.input))
        ]
        if self.dark_shading is not None:
            place = None if self.index.tile is None else (facts.top, facts.left)
            frames[1] = frames[1].less(self.dark_shading, place)
        drawn = Crop.draw(frames[0], generator, crop=self.crop, augment=self.augment)
        target, noisy = (
            replace(
                frame,
                mosaic=drawn.cut(frame).copy(),
                cfa=drawn.cfa,
                black_level_dn=drawn.levels(frame.black_level_dn),
            )
            for frame in frames
        )
        ratio = stated_ratio(facts.record, self.amplification) or facts.ratio
        pair = OpenedPair(facts.record, target, noisy, ratio, noisy.exposure)
        whole = Crop((slice(None), slice(None)), drawn.cfa, Orientation(), drawn.height, drawn.width)
        return PairItem.of(pair, whole)

    def __repr__(self) -> str:
        tile = "whole frames" if self.index.tile is None else f"tiles of {self.index.tile}"
        return (
            f"StreamedPairs({self.folder.address!r}, {self.index.dataset}: {len(self.index)} {tile} in "
            f"{len(self.index.shards)} shards, crop={self.crop}, augment={self.augment}, "
            f"crops_per_frame={self.crops_per_frame}, shuffle_buffer={self.shuffle_buffer}, seed={self.seed}, "
            f"levels={self.levels!r}, clip={self.clip!r}, amplification={self.amplification!r}"
            f"{shading_text(self.dark_shading)})"
        )


# --- who reads what, and in which order: an epoch's samples, split over ranks and workers without overlap or loss -----

# Shards are not dealt out whole, for then ranks and workers get unequal parts, or none where there are fewer shards
# than workers. The epoch's samples are one sequence, and each reader gets a part of it, which may begin in the middle
# of a shard. All is integer arithmetic on lengths: no reader has to know what another one does.

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Run:
    """Neighbouring samples of one shard: from ``first`` up to below ``last``."""

    shard: int
    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first


def exact_part(total: int, part: int, parts: int) -> range:
    """Return one of several parts that are all of it together; their lengths differ by one at most."""
    return range(total * part // parts, total * (part + 1) // parts)


def even_part(total: int, part: int, parts: int) -> range:
    """Return one of several parts of the same length; fewer than ``parts`` at the end are in none of them."""
    length = total // parts
    return range(part * length, (part + 1) * length)


def worker_part(items: range, worker: int, workers: int, batch_size: int) -> range:
    """Return a worker's part of a rank's items, in whole batches: at most one batch of a rank is smaller."""
    batches = exact_part(-(-len(items) // batch_size), worker, workers)
    first, last = items.start + batches.start * batch_size, items.start + batches.stop * batch_size
    return range(min(first, items.stop), min(last, items.stop))


def turns(batches: Sequence[int], given: int) -> list[tuple[int, int]]:
    """Return the workers in the order of their turns after so many batches of a rank, each with its share of them.

    A DataLoader asks its workers for a batch in turn, from the first one on, and passes over those that have no more.
    Where one goes on, its first worker takes the place of the one whose turn it was, and so on.

    Parameters
    ----------
    batches
        Of each worker's part (:func:`worker_part`): they differ by one at most.
    given
        How many batches were given out.
    """
    least, workers = min(batches), len(batches)
    rounds, turn = divmod(given, workers)
    if rounds >= least:  # the last round is of those that have one batch more
        last = [worker for worker, count in enumerate(batches) if count > least]
        rounds, turn = least, [*last, workers][min(given - least * workers, len(last))]
    shares = [min(count, rounds + (worker < turn)) for worker, count in enumerate(batches)]
    return [(place % workers, shares[place % workers]) for place in range(turn, turn + workers)]


def in_order(lengths: Sequence[int]) -> list[Run]:
    """Return all samples in the order of the shards."""
    return [Run(shard, 0, length) for shard, length in enumerate(lengths)]


def shuffled(lengths: Sequence[int], generator: np.random.Generator) -> list[Run]:
    """Return all samples with the shards in a drawn order, beginning at a drawn sample.

    The beginning moves the borders between readers, and with them the few samples that even parts leave out.
    """
    runs = [Run(int(shard), 0, lengths[shard]) for shard in generator.permutation(len(lengths))]
    total = sum(lengths)
    start = int(generator.integers(total))
    return [*cut(runs, range(start, total)), *cut(runs, range(start))]


def cut(runs: Sequence[Run], places: range) -> Iterator[Run]:
    """Yield what lies at some places of a sequence of runs."""
    borders: NDArray[np.int64] = np.cumsum([0, *map(len, runs)])
    for run, (begin, end) in zip(runs, pairwise(borders.tolist()), strict=True):
        first, last = max(begin, places.start), min(end, places.stop)
        if first < last:
            yield Run(run.shard, run.first + first - begin, run.first + last - begin)


def shuffled_through(items: Iterable[Item], size: int, generator: np.random.Generator) -> Iterator[Item]:
    """Yield all items, each time one drawn from a buffer of up to ``size``, which then gets the next.

    An item comes at most ``size - 1`` places early; 1 leaves the order as it is.
    """
    buffer: list[Item] = []
    for item in items:
        buffer.append(item)
        if len(buffer) >= size:
            yield _drawn(buffer, generator)
    while buffer:
        yield _drawn(buffer, generator)


def as_called(read: Iterator[tuple[int, Item]], order: Iterable[int]) -> Iterator[Item]:
    """Yield items as their places come in an order; what is read before its turn waits, and nothing is read ahead."""
    waiting: dict[int, Item] = {}
    for place in order:
        while place not in waiting:
            found, item = next(read)
            waiting[found] = item
        yield waiting.pop(place)


def _drawn(buffer: list[Item], generator: np.random.Generator) -> Item:
    place = int(generator.integers(len(buffer)))
    buffer[place], buffer[-1] = buffer[-1], buffer[place]
    return buffer.pop()
