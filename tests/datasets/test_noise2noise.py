"""Noise2Noise: two noisy frames of one scene, ISO and ratio, cut at the same place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from eldata.datasets import Noise2Noise, PackedStore, SIDDataset
from eldata.errors import ArgumentError
from tests.sid_tree import SmallTree, build_small_tree
from tests.sources.store.helpers import pack_tree

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> SmallTree:
    """Bursts of one scene at several ratios."""
    return build_small_tree("sid-sony", tmp_path_factory.mktemp("sony"), ["10003"])


@pytest.fixture(scope="module")
def store(tree: SmallTree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack_tree(tree, tmp_path_factory.mktemp("store") / "sony.h5").store


@pytest.fixture
def pairs(store: Path) -> PackedStore:
    return PackedStore(store, crop=8, augment=True, crops_per_frame=3, clip="none", seed=4)


def test_each_item_is_two_exposures_of_one_place(pairs: PackedStore) -> None:
    """The same crop of the whole frames, each in turn the input, every other frame of its burst a target in time."""
    noisy = Noise2Noise(pairs)
    noisy.set_epoch(0)
    bursts: dict[object, set[str]] = {}
    for record in pairs.records:
        bursts.setdefault((record.ratio, record.iso), set()).add(record.path)
    assert max(map(len, bursts.values())) > 2
    assert len(noisy) == 3 * sum(len(burst) for burst in bursts.values() if len(burst) > 1)
    frames = {record.path: number for number, record in enumerate(pairs.records)}
    parts = [[*pairs.draw_item(n, np.random.default_rng(0)).parts][1] for n in frames.values()]
    opened = {id(part.frame): pairs.records[n] for n, part in enumerate(parts)}
    met = set()
    for index in range(len(noisy)):
        item = noisy.item(index)
        one, other = (opened[id(part.frame)] for part in item.parts)
        assert one.path != other.path
        assert {one.path, other.path} <= bursts[one.ratio, one.iso]
        met.add((one.path, other.path))
        sample = noisy[index]
        assert sample["path"] == one.path
        for side, record in (("input", one), ("target", other)):
            part = parts[frames[record.path]]
            expected = np.empty(item.crop.packed_shape, np.float32)
            item.crop.fill(part.frame, expected, clip="none", gain=part.gain)
            np.testing.assert_array_equal(sample[side].numpy(), expected)  # type: ignore[literal-required]
        assert not torch.equal(sample["input"], sample["target"])
    assert len(met) > len(noisy) // 3  # three crops of a frame seldom have one and the same target


def test_two_crops_of_a_grid_have_one_place(store: Path) -> None:
    """Each crop of each noisy frame that has another of its kind, once, and the target's from the same place."""
    pairs = PackedStore(store, crop=8, crops="grid", augment=False)
    noisy = Noise2Noise(pairs)
    each = len(pairs) // len(pairs.records)
    items = [noisy.item(index) for index in range(len(noisy))]
    places = {(part.facts["path"], str(item.crop.slices)) for item in items for part in [*item.parts][:1]}
    assert len(places) == len(noisy) > each > 1
    assert len(noisy) % each == 0
    assert {str(item.crop.slices) for item in items} == {str(pairs.item(n).crop.slices) for n in range(len(pairs))}


def test_what_has_no_second_exposure_is_refused(tree: SmallTree, store: Path) -> None:
    with pytest.raises(ArgumentError, match="pack the dataset"):
        Noise2Noise(SIDDataset(tree.data, manifest=tree.csv))
    single = PackedStore(store)
    single.records = single.records[:1]
    with pytest.raises(ArgumentError, match="of 1 pairs none has another one"):
        Noise2Noise(single)
