"""The crop engine over any source: files, stores, and a source of another package give the same items."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from eldata import PackedStore
from eldata.datasets import PairDataset, SourcePairs, raw2rgb
from eldata.datasets.synthetic.synthesis import Recipe, synthesize
from eldata.errors import DatasetError
from eldata.manifest.card import save_card
from eldata.noise import CameraProfile
from eldata.raw import pack, read_raw, write_dng
from eldata.raw.levels import packed_black_level_dn
from eldata.sources.frames import Frame, FrameSource
from tests.datasets.comparing import same
from tests.evaluation.test_way_of_a_score import modules_called
from tests.sources.store.helpers import pack_tree

if TYPE_CHECKING:
    from collections.abc import Iterable
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
    """From two files, decoding among it, and from a store."""
    for pairs, most in ((PairDataset(pristine.data, pristine.csv), 21), (PackedStore(store, crop=8), 11)):
        wanted = pairs[1]["path"]  # what is computed once, such as kernels
        passed, sample = modules_called(pairs.__getitem__, 1)
        assert sample["path"] == wanted
        assert len(passed) <= most, sorted(passed)


def test_turned_crops_are_normalised_by_their_own_greens_levels(tree: Tree, tmp_path: Path) -> None:
    """Greens of unequal black levels, in files whose every pixel lies a quarter of the range above its own."""
    for record in tree.manifest.records:
        raw = read_raw(tree.data / record.path)
        black = np.array([500.0, 520.0, 504.0, 560.0])
        sensor = replace(raw.sensor, black_level_dn=tuple(black), white_level_dn=16000.0)
        levels = np.tile(black[np.array(sensor.cfa)], (raw.mosaic.shape[0] // 2, raw.mosaic.shape[1] // 2))
        write_dng(
            tree.data / record.path, np.rint(levels + (16000 - levels) / 4).astype(np.uint16), sensor, raw.exposure
        )
    options: Any = {"crop": 16, "augment": True, "crops_per_frame": 4, "levels": "metadata", "clip": "none"}
    store = pack_tree(tree, tmp_path / "eld.h5").store
    for samples in (PairDataset(tree.data, tree.csv, **options), PackedStore(store, **options)):
        seen = 0
        for sample in samples:
            seen += 1
            input_, target = sample["input"] / sample["ratio"], sample["target"]
            # A DN of the range is 6.5e-5, half of which rounding took; the other green's level would be off by 2.6e-3.
            assert torch.allclose(target, torch.tensor(0.25), atol=4e-5, rtol=0)
            assert torch.allclose(input_.float(), torch.tensor(0.25), atol=4e-5, rtol=0)
        assert seen == 96


@pytest.mark.parametrize("clip", ["upper", "none"])
def test_the_clip_is_of_the_input_on_every_route(clip: Any, tree: Tree, tmp_path: Path) -> None:
    """Frames whose first period lies at 0 DN, below black, and whose second at the largest DN, above white.

    The target is the reference in [0, 1], by numpy; the input keeps what the clip keeps.
    """
    for record in tree.manifest.records:
        raw = read_raw(tree.data / record.path)
        raw.mosaic[:2, :2], raw.mosaic[:2, 2:4] = 0, 65535
        write_dng(tree.data / record.path, raw.mosaic, raw.sensor, raw.exposure)
    options: Any = {"levels": "metadata", "clip": clip}
    store = pack_tree(tree, tmp_path / "eld.h5").store
    stored = PackedStore(store, crop=None, augment=False, **options)
    ways: dict[str, Iterable[Any]] = {
        "files": PairDataset(tree.data, tree.csv, **options),
        "store": stored,
    }
    for name, samples in ways.items():
        for sample in samples:
            raw = read_raw(tree.data / sample["reference"])
            black = packed_black_level_dn(raw.sensor.cfa, raw.sensor.black_level_dn)[:, None, None]
            light = (pack(raw.mosaic, raw.sensor.cfa) - black) / (np.float32(raw.sensor.white_level_dn) - black)
            assert (light.min() < 0, light.max() > 1) == (True, True)
            np.testing.assert_array_equal(sample["target"].numpy(), np.clip(light, 0, 1), err_msg=name)
            assert sample["input"].min() < 0
            assert (sample["input"].max() > 1) == (clip == "none")
    in_srgb = raw2rgb(stored)[0]["target"]
    assert torch.equal(in_srgb, raw2rgb(PackedStore(store, crop=None, augment=False, levels="metadata"))[0]["target"])


@pytest.mark.parametrize(("protocol", "levels"), [("raw", "metadata"), ("eld", "published"), ("led-eld", "metadata")])
def test_levels_are_those_of_the_protocol_that_the_card_names(
    protocol: str, levels: Any, tree: Tree, tmp_path: Path
) -> None:
    """So that the input is what the set is scored with, on every route."""
    save_card(tree.csv.with_suffix(".json"), replace(tree.manifest.card, protocol=protocol))
    store = pack_tree(tree, tmp_path / "eld.h5").store
    usual: list[Any] = [
        PairDataset(tree.data, tree.csv),
        PackedStore(store, crop=None, augment=False),
    ]
    wanted = {sample["path"]: sample for sample in PairDataset(tree.data, tree.csv, levels=levels)}
    for dataset in usual:
        assert dataset.levels == levels
        for sample in dataset:
            assert torch.equal(sample["target"], wanted[sample["path"]]["target"])
    assert PairDataset(tree.data, tree.csv, levels="sid-sony").levels == "sid-sony"


def test_a_source_of_what_is_no_pair_is_refused(pristine: Tree, store: Path) -> None:
    source = Memory(pristine)
    record = PackedStore(store, ratios=[100]).records[0]
    source.raws[record.path] = source.raws[record.reference]
    with pytest.raises(DatasetError, match="expected an exposure ratio of"):
        SourcePairs(source, [record])


def test_crops_of_packed_arrays(pristine: Tree, tmp_path: Path) -> None:
    """A noisy frame that is a packed array is cut like one that is a raw file."""
    clean = tmp_path / "clean"
    clean.mkdir()
    (clean / "a.dng").write_bytes(pristine.file(1).read_bytes())
    made = synthesize(clean, tmp_path / "set", Recipe(CameraProfile.load("SonyA7S2"), format="npy", per_image=2))
    root = tmp_path / "set" / "data" / "set"
    whole = PairDataset(root, made.path, levels="metadata")
    cut = PairDataset(root, made.path, levels="metadata", crop=8, crops_per_frame=3)
    cut.set_epoch(0)
    for index, sample in enumerate(cut):
        other, part = whole[index % 2], cut.item(index).crop.slices
        top, left = (side.start // 2 for side in part)
        for name in ("input", "target"):
            assert torch.equal(sample[name], other[name][:, top : top + 8, left : left + 8])
