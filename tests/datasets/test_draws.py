"""Which draw an item gets: the k-th time that it is asked for the k-th, by any workers, or a set epoch's; and turns."""

from __future__ import annotations

import copy
import itertools
import os
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import ConcatDataset, DataLoader, DistributedSampler, Subset, random_split
from torchdata.stateful_dataloader import StatefulDataLoader

from eldata import PackedStore, SyntheticClips, SyntheticPairs
from eldata.datasets import (
    Arrays,
    CleanClips,
    CleanFrames,
    PairDataset,
    describe,
    evaluation_loader,
    raw2rgb,
    set_epoch,
    training_loader,
)
from eldata.datasets.synthetic.draws import Turns
from eldata.raw.levels import XTRANS_CFA
from eldata.sources.frames import Frame
from tests.datasets.comparing import same
from tests.datasets.mosaics import Mosaics
from tests.raw.helpers import BAYER, random_mosaic
from tests.trees import Tree
from tests.waiting import PATIENCE_S

# Python 3.12 and later warn of any fork in a process that has threads.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


FRAMES = np.random.default_rng(0).random((5, 4, 40, 40), np.float32)
CLIPS = CleanClips([Arrays(FRAMES, range_dn=15871.0)] * 3)

KINDS: dict[str, Any] = {
    "files": lambda tree, _: PairDataset(tree.data, tree.csv, crop=8, seed=3),
    "store": lambda _, store: PackedStore(store, crop=8, crops_per_frame=2, seed=3),
    "grid": lambda _, store: PackedStore(store, crop=24, crops="grid", seed=3),
    "synthetic": lambda _, store: SyntheticPairs(CleanFrames(store), "SonyA7S2", crop=8, crops_per_frame=2),
    "clips": lambda *_: SyntheticClips(CLIPS, "SonyA7S2", frames=2, crop=8),
    "rendered": lambda _, store: raw2rgb(PackedStore(store, crop=8, seed=3, cameras=["DemoAlpha"])),
    "parts": lambda _, store: ConcatDataset([Subset(PackedStore(store, crop=8, seed=3), range(5, 12))]),
}


def passes(loader: Any, count: int = 3) -> list[list[Any]]:
    return [list(loader) for _ in range(count)]


def of_epoch(dataset: Any, epoch: int) -> Any:
    set_epoch(evaluation_loader(dataset, num_workers=0), epoch)
    return dataset


@pytest.mark.parametrize("kind", KINDS)
def test_each_pass_of_a_plain_loader_is_the_next_epoch(kind: str, pristine: Tree, store: Path) -> None:
    """To the bit those of ``set_epoch(0)``, ``set_epoch(1)``, ...; a set one repeats, as the items of a pass did."""
    plain = passes(DataLoader(KINDS[kind](pristine, store), batch_size=5))
    for epoch, batches in enumerate(plain):
        fixed = of_epoch(KINDS[kind](pristine, store), epoch)
        for again in passes(DataLoader(fixed, batch_size=5), 2):
            for one, other in zip(batches, again, strict=True):
                same(one, other)
    for one, other in itertools.combinations(plain, 2):
        sides = [torch.cat([batch["target"] for batch in batches]) for batches in (one, other)]
        unlike = [not torch.equal(*pair) for pair in zip(*sides, strict=True)]
        assert np.mean(unlike) > 0.5  # of a grid one in eight is turned as before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.parametrize(
    ("method", "persistent"),
    [("fork", False), ("fork", True), pytest.param("spawn", True, marks=pytest.mark.study)],  # which imports torch
)
def test_workers_do_not_matter(method: str, persistent: bool, store: Path) -> None:
    """Two, kept or not: the items of no worker. Those left at the end of a pass were asked for once alike."""
    wanted = passes(DataLoader(KINDS["synthetic"](None, store), batch_size=5), 2)
    dataset = KINDS["synthetic"](None, store)
    options: dict[str, Any] = {"persistent_workers": persistent, "multiprocessing_context": method}
    loader = DataLoader(dataset, batch_size=5, num_workers=2, timeout=PATIENCE_S, **options)
    for one, other in zip(itertools.chain(*wanted), itertools.chain(*passes(loader, 2)), strict=True):
        same(one, other)
    same(dataset[7], of_epoch(KINDS["synthetic"](None, store), 2)[7])  # this process counts on


@pytest.mark.filterwarnings("ignore:'set_vital' is deprecated:UserWarning")  # torchdata's own
def test_torchs_splits_samplers_and_stateful_loader(store: Path) -> None:
    """A dataset ends by an IndexError, as theirs do; and a copy's loader goes on in the middle of an epoch."""
    pairs = of_epoch(KINDS["store"](None, store), 1)
    ranks: list[Any] = [DistributedSampler(pairs, 2, rank) for rank in (0, 1)]
    for parts in ([part.indices for part in random_split(pairs, [0.25, 0.75])], ranks):
        assert sorted(itertools.chain(*parts)) == list(range(len(pairs)))
    assert len(list(pairs)) == len(pairs)
    loader, later = (StatefulDataLoader(each, batch_size=5) for each in (pairs, copy.deepcopy(pairs)))
    batches = iter(loader)
    next(batches)
    later.load_state_dict(loader.state_dict())
    for one, other in zip(batches, later, strict=True):
        same(one, other)


def test_to_look_at_an_item_is_not_to_ask_for_it(store: Path) -> None:
    dataset = KINDS["synthetic"](None, store)
    dataset.plot(0)
    dataset._repr_html_()
    assert "workers: " in describe(training_loader(dataset, 2))  # which reads an item for its size
    same(dataset[0], of_epoch(KINDS["synthetic"](None, store), 0)[0])


class Unlike(Mosaics):
    """The third frame is X-Trans."""

    def frame(self, index: int) -> Frame:
        is_bayer = index < 2
        cfa = BAYER["RGGB"] if is_bayer else XTRANS_CFA
        return Frame(self.mosaics[index], cfa, (0.0,) * (4 if is_bayer else 3), 65535.0, f"mosaic {index}")


@pytest.mark.parametrize("reads_parts", [False, True])
def test_items_that_fit_no_batch_are_drawn_once(reads_parts: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Unlike, "reads_parts", reads_parts, raising=False)
    source = Unlike([random_mosaic(60, 60, seed=number) for number in range(3)], BAYER["RGGB"])
    dataset, alone = (SyntheticPairs(source, "SonyA7S2", crop=8) for _ in range(2))
    for one, other in zip(dataset.__getitems__([0, 1, 2, 0]), [*alone, alone[0]], strict=True):
        same(one, other)
    same(dataset[2], of_epoch(alone, 1)[2])


# --- turns ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weights", [[1.0], [1.0, 1.0, 1.0], [5.0, 1.0, 0.01, 2.0], [0.1, 0.2]])
def test_groups_come_by_their_weights_and_their_members_stay_level(weights: list[float]) -> None:
    """At each place a group's members differ by one use at most; at each block's end groups have had their shares."""
    sizes = [5, 3, 4, 6][: len(weights)]
    turns, counts = Turns(0, weights, sizes), [Counter[int]() for _ in weights]
    shares = np.array(weights) / sum(weights)
    for place in range(640):
        group, (member,) = turns.at(place)
        counts[group][member] += 1
        used = [counts[group][one] for one in range(sizes[group])]
        assert max(used) - min(used) <= 1
        if place % 64 == 63:
            found = np.array([count.total() for count in counts])
            assert np.abs(found - shares * (place + 1)).max() < len(weights)
    starts = {turns.at(place)[0] for place in range(0, 640, 64)}
    assert len(starts) > 1 or len(weights) == 1, "blocks do not begin alike"
    first = [turns.at(place) for place in range(60)]
    assert first[::-1] == [Turns(0, weights, sizes).at(place) for place in reversed(range(60))]
    assert first != [Turns(4, weights, sizes).at(place) for place in range(60)]
    if len(weights) == 1:  # rounds of all members, in orders that differ from round to round
        assert len({tuple(first[start : start + 5]) for start in range(0, 60, 5)}) > 9


@pytest.mark.parametrize("each", [2, 3, 5])
def test_members_of_one_turn_are_different(each: int) -> None:
    """Nor does a round have one twice; those that it leaves out stand in others."""
    for size in (each, 2 * each + 1):
        turns, seen = Turns(1, [1.0], [size], each), set[int]()
        for first in range(0, 200, size // each):
            used = [member for place in range(first, first + size // each) for member in turns.at(place)[1]]
            assert len(set(used)) == len(used) == size // each * each
            seen.update(used)
        assert seen == set(range(size))
