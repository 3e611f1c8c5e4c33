"""The crop engine over any source: files, stores, and a source of another package give the same items."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from eldata import PackedStore
from eldata.datasets import CleanFrames, PairDataset, SourcePairs, SyntheticPairs
from eldata.datasets.crops import Crop
from eldata.manifest.card import save_card
from eldata.raw import read_raw
from eldata.sources.frames import Frame, FrameSource
from tests.datasets.comparing import same
from tests.evaluation.test_way_of_a_score import modules_called
from tests.raw.helpers import BAYER
from tests.sources.store.helpers import pack_tree

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.records import FrameRecord
    from tests.trees import Tree


class Memory:
    """A source as another package may bring it."""

    reads_parts = True

    def __init__(self, tree: Tree) -> None:
        self.records: tuple[FrameRecord, ...] = tree.manifest.records
        self.raws = {record.path: read_raw(tree.data / record.path) for record in self.records}

    def frame(self, path: str) -> Frame:
        raw = self.raws[path]
        return Frame.of_raw(raw.mosaic, raw.sensor, path, raw.exposure)


def test_crops_of_files_stores_and_other_sources_are_the_same(pristine: Tree, store: Path) -> None:
    cropping: Any = {"crop": 6, "augment": True, "crops_per_frame": 2, "seed": 4}
    stored = PackedStore(store, **cropping)
    source = Memory(pristine)
    assert isinstance(source, FrameSource)
    others = [
        PairDataset(pristine.data, pristine.csv, **cropping),
        SourcePairs(source, stored.records, levels="published", **cropping),
    ]
    for other in others:
        assert len(other) == len(stored) == 48
        for epoch in (0, 3):
            stored.set_epoch(epoch)
            other.set_epoch(epoch)
            for ours, theirs in zip(stored, other, strict=True):
                same(ours, theirs)
        # Frames of two cameras, of several sizes: crops make batches all the same.
        for batch, wanted in zip(DataLoader(other, batch_size=7), DataLoader(stored, batch_size=7), strict=True):
            assert torch.equal(batch["input"], wanted["input"])
            assert batch["path"] == wanted["path"]
    assert "crop=6, augment=True, crops_per_frame=2, seed=4" in repr(others[0])


def test_one_item_passes_few_modules(pristine: Tree, store: Path) -> None:
    """From two files, decoding among it; from a store; with noise."""
    noisy = SyntheticPairs(CleanFrames(store, keep=9), "SonyA7S2", crop=8)
    for pairs, most in ((PairDataset(pristine.data, pristine.csv), 21), (PackedStore(store, crop=8), 11), (noisy, 15)):
        wanted = pairs[1]["path"]  # what is computed once, such as kernels
        passed, sample = modules_called(pairs.__getitem__, 1)
        assert sample["path"] == wanted
        assert len(passed) <= most, sorted(passed)


def test_turned_crops_are_normalised_by_their_own_greens_levels() -> None:
    """Greens of unequal black levels; every pixel lies a quarter of its own range above its own."""
    cfa, black = BAYER["GBRG"], np.array([500.0, 520.0, 504.0, 560.0])
    mosaic = np.tile((black + (16000 - black) / 4)[np.array(cfa)], (24, 24)).astype(np.float32)
    frame = Frame(mosaic, cfa, tuple(black), 16000.0, "")
    for seed in range(40):
        crop = Crop.draw(frame, np.random.default_rng(seed), crop=16, augment=True)
        out = np.empty(crop.packed_shape, np.float32)
        crop.fill(frame, out)
        np.testing.assert_allclose(out, 0.25, atol=1e-6)  # the other green's level would be off by 2.6e-3


@pytest.mark.parametrize(("protocol", "levels"), [("raw", "metadata"), ("eld", "published"), ("led-eld", "metadata")])
def test_levels_are_those_of_the_protocol_that_the_card_names(
    protocol: str, levels: Any, tree: Tree, tmp_path: Path
) -> None:
    """So that the input is what the set is scored with, on every route."""
    save_card(tree.csv.with_suffix(".json"), replace(tree.manifest.card, protocol=protocol))
    store = pack_tree(tree, tmp_path / "eld.h5").store
    assert PairDataset(tree.data, tree.csv).levels == PackedStore(store).levels == levels
    assert PairDataset(tree.data, tree.csv, levels="sid-sony").levels == "sid-sony"
