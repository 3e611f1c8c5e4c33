"""The crop engine over any source: files, stores, and a source of another package give the same items."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import ConcatDataset, DataLoader

from eldata import PackedStore, SIDDataset
from eldata.datasets import CleanFrames, PairDataset, SourcePairs, SyntheticPairs
from eldata.datasets.crops import Crop
from eldata.datasets.items import Sample
from eldata.errors import ArgumentError
from eldata.manifest.card import save_card
from eldata.raw import read_raw
from eldata.records import FrameRecord
from eldata.sources.frames import Frame, FrameSource
from tests.cases import in_one_test
from tests.datasets.comparing import same
from tests.evaluation.test_way_of_a_score import modules_called
from tests.raw.helpers import SOME_CFAS, Cfa, levels_of
from tests.sid_tree import build_small_tree
from tests.sources.store.helpers import pack_tree
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


@in_one_test("cfa", SOME_CFAS.values())
def test_turned_crops_are_normalised_by_their_own_greens_levels(cfa: Cfa) -> None:
    """Greens of unequal black levels; every pixel lies a quarter of its own range above its own."""
    black = np.array([500.0, 520.0, 504.0, 560.0])[: levels_of(cfa)]
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


# --- what becomes of a sample, and of samples of several datasets ----------------------------------------------------


def brighten(sample: dict[str, Any]) -> dict[str, Any]:
    """Change one tensor in place, replace another, and draw a number from torch."""
    sample["input"].mul_(2)
    return sample | {"target": sample["target"][:, :4] + 1, "path": "", "drawn": torch.rand(())}


def break_down(sample: dict[str, Any]) -> None:
    if sample["path"].endswith("IMG_0005.dng"):
        raise KeyError("inptu")


KINDS: dict[str, Any] = {
    "files": lambda tree, _, **options: PairDataset(tree.data, tree.csv, **options),
    "store": lambda _, store, **options: PackedStore(store, **options),
    "noise": lambda _, store, **options: SyntheticPairs(CleanFrames(store), "SonyA7S2", **options),
    "noise of files": lambda tree, _, **options: SyntheticPairs(CleanFrames(tree.data), "SonyA7S2", **options),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_transform_gets_the_whole_sample(kind: str, pristine: Tree, store: Path) -> None:
    """After crop and noise, alone and in batches, in workers too; what it returns is what there is."""
    for workers in (0, 2):
        plain, changed = (KINDS[kind](pristine, store, crop=8, transform=how) for how in (None, brighten))
        loader = DataLoader(changed, batch_size=3, num_workers=workers)
        batches = list(loader)
        for index, sample in enumerate(plain):
            batch, place = batches[index // 3], index % 3
            assert torch.equal(batch["input"][place], 2 * sample["input"])
            assert torch.equal(batch["target"][place], sample["target"][:, :4] + 1)
            assert (batch["path"][place], batch["scene"][place]) == ("", sample["scene"])
        plain.set_epoch(1)
        changed.set_epoch(1)
        assert torch.equal(changed[2]["input"], 2 * plain[2]["input"])
        assert "; transform: brighten" in repr(changed)
        assert repr(changed).replace("; transform: brighten", "") == repr(plain)


def test_an_error_of_a_transform_names_the_item(store: Path) -> None:
    broken = PackedStore(store, crop=8, transform=break_down, cameras=["DemoAlpha"])
    (number,) = (place for place, one in enumerate(broken.records) if one.path.endswith("IMG_0005.dng"))
    for work in (lambda: broken[number], lambda: broken.__getitems__([number])):
        with pytest.raises(KeyError, match="inptu") as caught:
            work()
        assert caught.value.__notes__ == [f"in transform= of PackedStore, for {broken.records[number].path}"]
    with pytest.raises(ArgumentError, match="transform= returned None"):
        broken[number - 1]


def test_samples_of_real_packed_and_made_pairs_go_into_one_batch(pristine: Tree, store: Path, tmp_path: Path) -> None:
    """As torch's own collate makes them, whichever comes first; a number that is not known is nan."""
    sony = build_small_tree("sid-sony", tmp_path, ["10003"])
    sets = [make(pristine, store, crop=8, augment=True) for make in KINDS.values()]
    sets.append(SIDDataset(sony.data, manifest=sony.csv, crop=8))
    joined: Any = ConcatDataset(sets)
    seen: dict[str, list[Any]] = {"iso": [], "nominal_ratio": [], "gain_dn_per_e": [], "path": []}
    for batch in DataLoader(joined, batch_size=7, num_workers=2, shuffle=True):
        assert set(batch) == set(Sample.__annotations__)
        assert batch["input"].shape == batch["target"].shape == (len(batch["path"]), 4, 8, 8)
        for name, column in seen.items():
            column.extend(batch[name] if name == "path" else batch[name].tolist())
    made = len(sets[2]) + len(sets[3])
    assert [len(column) for column in seen.values()] == [len(joined)] * 4
    assert np.isnan(seen["iso"]).sum() == made  # whose gain was drawn
    assert np.isfinite(seen["gain_dn_per_e"]).sum() == made
    assert np.isfinite(seen["nominal_ratio"]).all()


def test_an_index_is_one_number(store: Path) -> None:
    dataset = PackedStore(store, crop=8)
    dataset.set_epoch(0)
    same(dataset[np.int64(3)], dataset[np.uint8(3)])  # type: ignore[index]
    same(dataset[torch.tensor(23)], dataset[-1])  # type: ignore[index]
    for wrong in (slice(0, 10), "path", 1.0, [1, 2], np.array([1, 2])):
        with pytest.raises(ArgumentError, match=r"whole number; found .*torch\.utils\.data\.Subset\(dataset"):
            dataset[wrong]  # type: ignore[index]
    for outside in (24, -25):
        with pytest.raises(IndexError, match="outside of 24 items"):
            dataset[outside]
