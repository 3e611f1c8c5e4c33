"""StreamedPairs: the values of the store's pairs, each exactly once, in any process, in bounded memory."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections import Counter
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, get_worker_info

from eldata import StreamedPairs
from eldata.datasets import PackedStore, loading
from eldata.datasets.base import Sample
from eldata.datasets.loading import describe, evaluation_loader, set_epoch, training_loader
from eldata.datasets.ranks import Rank
from eldata.errors import ArgumentError, DatasetError
from eldata.sources.shards import index, reading, write_shards
from tests.sources.shards.helpers import identities, identity, unbatched
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path


def ranks(folder: Path, count: int, **options: Any) -> list[StreamedPairs]:
    return [StreamedPairs(str(folder), rank=Rank(number, count), **options) for number in range(count)]


# --- values -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [
        {"crop": None, "augment": False},
        {"crop": None, "augment": True, "levels": "metadata"},
        {"crop": 8, "seed": 4, "clip": "upper", "amplification": "nominal"},
        {"crop": 12, "augment": False, "clip": "none"},
    ],
)
@pytest.mark.parametrize("which", ["eld", "fuji"])
def test_whole_frames_give_the_stores_items_bit_for_bit(
    which: str, options: dict[str, Any], eld: Path, fuji: Path, tmp_path: Path
) -> None:
    """Two epochs, three crops a frame: every item of PackedStore, once."""
    store = {"eld": eld, "fuji": fuji}[which]
    write_shards(store, tmp_path / "shards", tile=None, samples_per_shard=5)
    streamed = StreamedPairs(str(tmp_path / "shards"), crops_per_frame=3, **options)
    stored = PackedStore(store, crops_per_frame=3, **options)
    assert len(streamed) == len(stored)
    for epoch in (0, 2):
        streamed.set_epoch(epoch)
        stored.set_epoch(epoch)
        ours, theirs = list(streamed), list(stored)
        assert set(ours[0]) == set(Sample.__annotations__)
        assert {key: type(value) for key, value in ours[0].items()} == {
            key: type(value) for key, value in theirs[0].items()
        }
        assert ours[0]["input"].dtype == ours[0]["target"].dtype == torch.float32
        assert sorted(identities(ours)) == sorted(identities(theirs))


@pytest.mark.parametrize("which", ["eld", "fuji"])
def test_a_crop_of_a_tile_is_a_part_of_the_frame(which: str, eld: Path, fuji: Path, tmp_path: Path) -> None:
    store = {"eld": eld, "fuji": fuji}[which]
    write_shards(store, tmp_path / "shards", tile=12, samples_per_shard=40)
    whole = {sample["path"]: sample for sample in PackedStore(store, crop=None, augment=False, clip="none")}
    places: dict[str, set[tuple[int, int]]] = {}
    for ours in StreamedPairs(str(tmp_path / "shards"), crop=6, augment=False, crops_per_frame=2, clip="none"):
        frame = whole[ours["path"]]
        height, width = frame["target"].shape[1:]
        found = [
            (int(y), int(x))
            for y, x in torch.nonzero(frame["target"][0] == ours["target"][0, 0, 0]).tolist()
            if y + 6 <= height
            and x + 6 <= width
            and torch.equal(frame["target"][:, y : y + 6, x : x + 6], ours["target"])
            and torch.equal(frame["input"][:, y : y + 6, x : x + 6], ours["input"])
        ]
        assert found
        places.setdefault(ours["path"], set()).update(found)
    assert len(places) == len(whole)
    spread = np.array([place for found in places.values() for place in found])
    assert (np.ptp(spread, axis=0) >= 8).all()


# --- each exactly once --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "workers"), [(1, 2), (3, 0), (3, 3)])
def test_all_ranks_and_workers_together_give_each_item_once(count: int, workers: int, frames: Path) -> None:
    """Shards of 7, 7, 7 and 3 samples; 9 readers where 3 ranks have 3 workers: more than shards."""
    wanted = Counter(identities(StreamedPairs(str(frames))))
    assert len(wanted) == 24
    got: Counter[str] = Counter()
    for dataset in ranks(frames, count):
        part = unbatched(evaluation_loader(dataset, 1, workers=workers, rank=dataset.rank))
        assert len(part) == len(dataset) == 24 // count
        got.update(part)
    assert got == Counter(identities(StreamedPairs(str(frames)).for_evaluation(1, Rank())))
    assert set(got.values()) == {1}


@pytest.mark.parametrize("workers", [0, 3])
def test_a_loader_of_ones_own_gives_each_item_once(workers: int, tiles: Path) -> None:
    options: dict[str, Any] = {"multiprocessing_context": loading._context("forkserver")} if workers else {}
    wanted = Counter(identities(StreamedPairs(str(tiles))))
    for count in (1, 2):
        got: Counter[str] = Counter()
        for dataset in ranks(tiles, count):
            got.update(unbatched(DataLoader(dataset, batch_size=7, num_workers=workers, **options)))
        assert got == wanted


def test_training_gives_every_rank_as_many_batches(frames: Path) -> None:
    """24 samples, 3 crops each: 72 items on 5 ranks are 14 each, 3 batches of 4, and 2 items dropped."""
    whole = Counter(identities(StreamedPairs(str(frames), crop=8, crops_per_frame=3)))
    got: Counter[str] = Counter()
    for number in range(5):
        dataset = StreamedPairs(str(frames), crop=8, crops_per_frame=3)
        loader = training_loader(dataset, 4, workers=0, rank=Rank(number, 5))
        part = unbatched(loader)
        assert (len(part), len(loader)) == (12, 3)
        got.update(part)
    assert not got - whole  # none twice, none else


def test_at_most_one_batch_of_a_rank_is_smaller(tiles: Path) -> None:
    """144 samples of 3 workers in batches of 10: torch's own way would drop or cut three batches."""
    loader = evaluation_loader(StreamedPairs(str(tiles)), 10, workers=3)
    sizes = [len(batch["path"]) for batch in loader]
    assert sorted(sizes) == [4, *[10] * 14]
    assert len(loader) == 15
    trained = training_loader(StreamedPairs(str(tiles)), 10, workers=3)
    assert [len(batch["path"]) for batch in trained] == [10] * 14 == [10] * len(trained)


# --- order, epochs, restarts --------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [0, 3])
def test_an_epoch_goes_on_in_its_middle(workers: int, tiles: Path) -> None:
    """Whatever was given out before: 96 items of a rank in 13 batches of 7, of workers 6 and 7, or 4, 4 and 5."""

    def loader() -> DataLoader[Any]:
        dataset = StreamedPairs(str(tiles), crop=8, crops_per_frame=2, seed=5, shuffle_buffer=20)
        return training_loader(dataset, 7, workers=workers, rank=Rank(1, 3))

    whole, again = loader(), loader()
    set_epoch(whole, 2)
    wanted = unbatched(whole)
    assert len(wanted) == 7 * len(whole) == 91
    for first in (0, 1, 5, 12, 13, 14):  # by the same workers, one after the other
        set_epoch(again, 2, first_batch=first)
        assert unbatched(again) == wanted[7 * first :]
        assert len(again) == 13  # of an epoch
    set_epoch(again, 3)
    set_epoch(whole, 3)
    assert unbatched(again) == unbatched(whole) != wanted


def test_what_was_given_out_is_not_read_again(tiles: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 144 samples 96 were given out: the 48 others are read, those that lay in the buffer too, and no other."""
    read: list[int] = []
    checked = index.from_bytes

    def counted(content: bytes) -> Any:
        sample = checked(content)
        read.append(sample.number)
        return sample

    monkeypatch.setattr(reading, "from_bytes", counted)
    dataset = StreamedPairs(str(tiles), crop=8, shuffle_buffer=30)
    loader = training_loader(dataset, 12, workers=0)
    read.clear()  # one sample, for its size
    list(loader)
    assert sorted(read) == list(range(144))
    read.clear()
    set_epoch(loader, 0, first_batch=8)
    rest = list(loader)
    assert (len(read), len(set(read)), len(rest)) == (48, 48, 4)
    read.clear()
    assert len(list(dataset)) == len(list(dataset.for_evaluation(1, Rank()))) == 144  # which know nothing of it
    with pytest.raises(ArgumentError, match="first_batch=1: only a training loader can begin there"):
        set_epoch(evaluation_loader(dataset, workers=0), 0, first_batch=1)


def test_evaluation_is_in_order_and_does_not_change(tiles: Path) -> None:
    dataset = StreamedPairs(str(tiles), augment=False)
    ordered = dataset.for_evaluation(4, Rank())
    first = identities(ordered)
    assert identities(dataset) != first
    assert unbatched(evaluation_loader(dataset, 4, workers=0)) == first
    dataset.set_epoch(3)
    assert ordered.epoch == 3  # shared
    assert [one.split()[0] for one in identities(ordered)] == [one.split()[0] for one in first]


def test_neighbours_are_of_different_frames(tiles: Path) -> None:
    """Written shuffled: of 24 frames with 6 tiles each, neighbours are of one with p = 5/143; of 143 neighbours 5 are
    expected, and 20 or more have p < 1e-6 (Poisson).
    """
    paths = [
        one.split()[0] for one in identities(StreamedPairs(str(tiles), shuffle_buffer=1).for_evaluation(1, Rank()))
    ]
    assert sum(a == b for a, b in pairwise(paths)) < 20


# --- memory -------------------------------------------------------------------------------------------------------


# In a process of its own: what threads of other tests, such as a Dask scheduler's, allocate meanwhile would count too.
MEASURE_PEAK = """
import gc, sys, tracemalloc
from eldata import StreamedPairs

for folder in sys.argv[1:]:
    dataset = StreamedPairs(folder, crop=8, shuffle_buffer=3)
    if sum(1 for _ in dataset) != len(dataset):  # what is loaded and remembered once
        raise SystemExit("not every sample came")
    tracemalloc.start()
    count = 0
    for _ in dataset:
        count += 1
        if count % 8 == 0:  # else a large process collects so rarely that garbage is most of the peak
            gc.collect()
    print(count, tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()
"""


@pytest.mark.memory
def test_memory_is_bounded_by_the_buffer(tiles: Path, frames: Path) -> None:
    """All samples are 24 x 64 x 96 x 2 x 2 bytes = 590 kB; a buffer of 3 crops of 8 holds 3 x 2 kB."""
    command = [sys.executable, "-c", MEASURE_PEAK, str(frames), str(tiles)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    cases = ((frames, 590_000, 24), (tiles, 144 * 34 * 34 * 4, 144))
    for (folder, size, samples), line in zip(cases, done.stdout.splitlines(), strict=True):
        count, peak = map(int, line.split())
        assert count == samples
        largest = 2 * 24_576 + 4096 if folder == frames else 2 * 2312 + 4096
        # Beside the samples: records, and garbage of a few of them.
        assert peak < 6 * largest + 150_000 < size


def test_the_buffer_holds_crops_alone(frames: Path) -> None:
    """A view of the frame would keep the whole frame in memory."""
    dataset = StreamedPairs(str(frames), crop=8)
    items = [item for _, item in dataset._items(range(24), 0)]
    assert len(items) == 24
    for item in items:
        assert item.pair.input is not None
        for array in (item.pair.input.mosaic, item.pair.target.mosaic):
            assert isinstance(array, np.ndarray)
            assert (array.shape, array.base, array.flags.owndata) == ((16, 16), None, True)


def test_the_size_of_an_item_is_known_before(frames: Path, tiles: Path, fuji: Path, tmp_path: Path) -> None:
    write_shards(fuji, tmp_path / "fuji", tile=12)
    for folder, crop in ((frames, None), (frames, 8), (tiles, None), (tmp_path / "fuji", 6)):
        dataset = StreamedPairs(str(folder), crop=crop, augment=False)
        sample = next(iter(dataset))
        assert dataset.sample_bytes == sample["input"].nbytes + sample["target"].nbytes
    shuffled = StreamedPairs(str(tiles), shuffle_buffer=100)
    assert "MB a batch" in describe(training_loader(shuffled, 4))
    # 100 x 2 crops of 32 x 32 uint16, and one sample of 2 x 34 x 34 with its headers
    assert 100 * 4096 + 4 * 34 * 34 < shuffled.buffer_bytes < 100 * 4096 + 4 * 34 * 34 + 6000
    assert shuffled.for_evaluation(1, Rank()).buffer_bytes < 4 * 34 * 34 + 6000


# --- what is refused ----------------------------------------------------------------------------------------------


def test_wrong_arguments(tiles: Path, tmp_path: Path) -> None:
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"crop": 17}, "crop must be at most the tiles' side, 16; found 17"),
        ({"crop": 1}, "crops_per_frame and shuffle_buffer must be 1 or more and crop 2 or more; found 1, 64, 1"),
        ({"crops_per_frame": 0}, "found 0, 64, None"),
        ({"shuffle_buffer": 0}, "found 1, 0, None"),
        ({"seed": -1}, "seed must be 0 or more; found -1"),
        ({"levels": "mine"}, "levels must be one of 'metadata', 'published'"),
        ({"clip": "lower"}, "clip must be one of 'both', 'upper', 'none'; found 'lower'"),
        ({"amplification": "x"}, "amplification must be one of"),
        ({"attempts": 0}, r"attempts must be 1 or more and retry_wait_s 0 or more; found 0, 0\.5"),
    ]
    for options, words in wrong:
        with pytest.raises(ArgumentError, match=words):
            StreamedPairs(str(tiles), **options)


def test_frames_smaller_than_the_crop(frames: Path) -> None:
    with pytest.raises(DatasetError, match=r"frames: Demo.* 64 x 96 pixels are too few for a crop of 102 x 102"):
        next(iter(StreamedPairs(str(frames), crop=50)))


def test_it_says_what_it_is_but_no_secrets(tiles: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = StreamedPairs(str(tiles), crop=8, storage_options={"auto_mkdir": False})
    assert repr(dataset).startswith(f"StreamedPairs({str(tiles)!r}, eld-demo: 144 tiles of 16 in 3 shards, crop=8, ")
    assert "auto_mkdir" not in repr(dataset) + repr(dataset.folder)


def test_a_copy_in_a_worker_knows_its_rank(tiles: Path) -> None:
    """A spawned worker has no process group: the rank is asked for as the dataset is sent."""
    assert get_worker_info() is None
    sent = pickle.loads(pickle.dumps(StreamedPairs(str(tiles))))
    assert sent.rank == Rank(0, 1)
    other = pickle.loads(pickle.dumps(StreamedPairs(str(tiles), rank=Rank(2, 3))))
    assert other.rank == Rank(2, 3)
    assert identity(next(iter(other))) in set(identities(StreamedPairs(str(tiles))))
