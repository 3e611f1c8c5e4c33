"""PackedStore: bit for bit what the raw route gives, by whatever process; CleanFrames; conversion of DN batches."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import psutil  # type: ignore[import-untyped,unused-ignore] # types-psutil may be there or not
import pytest

from eldata import PackedStore, SyntheticPairs
from eldata.datasets import CleanFrames, PairDataset
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.card import Subset, save_card
from eldata.raw import write_dng
from eldata.sources.store import build_store, source_of_dataset
from tests.datasets.comparing import same
from tests.raw.helpers import BAYER, EXPOSURE, make_sensor, random_mosaic
from tests.sid_tree import build_small_tree
from tests.sources.store.helpers import pack_folder, pack_tree, write_clean
from tests.trees import BETA, Tree

if TYPE_CHECKING:
    from pathlib import Path

# --- the raw route ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sets(pristine: Tree, store: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Tree, Path]]:
    """Trees and their stores: RGGB and GBRG; X-Trans, compressed."""
    folder = tmp_path_factory.mktemp("fuji")
    fuji = build_small_tree("sid-fuji", folder, ["10019"])
    return {
        "eld": (pristine, store),
        "fuji": (fuji, pack_tree(fuji, folder / "fuji.h5", compression="zstd").store),
    }


@pytest.mark.parametrize(
    ("name", "levels", "clip", "amplification"),
    [
        ("eld", "published", "both", "metadata"),
        ("eld", "metadata", "upper", "nominal"),
        ("eld", "metadata", "none", "metadata"),
        ("fuji", "published", "both", "metadata"),
        ("fuji", "sid-fuji", "upper", "metadata"),
    ],
)
def test_whole_frames_equal_the_raw_route(
    name: str, levels: Any, clip: Any, amplification: Any, sets: dict[str, tuple[Tree, Path]]
) -> None:
    tree, store = sets[name]
    options: dict[str, Any] = {"levels": levels, "clip": clip, "amplification": amplification}
    raw = PairDataset(tree.data, tree.csv, **options)
    stored = PackedStore(store, crop=None, augment=False, **options)
    assert stored.records == raw.records
    for ours, theirs in zip(stored, raw, strict=True):
        same(ours, theirs)


def test_clean_crops_are_those_of_the_raw_files(tmp_path: Path) -> None:
    """Bayer and X-Trans of every phase: SyntheticPairs cannot tell the two sources apart."""
    folder = write_clean(tmp_path / "raws")
    store = pack_folder(folder, tmp_path / "clean.h5", compression="lz4").store
    levels: Any
    for levels in ("metadata", "published"):
        ours, theirs = (
            SyntheticPairs(CleanFrames(source, levels=levels), "SonyA7S2", crop=8, crops_per_frame=5, seed=2)
            for source in (store, folder)
        )
        for mine, other in zip(ours, theirs, strict=True):
            assert mine["path"].rpartition("/")[2] == other["path"].rpartition("/")[2]
            same(dict(mine) | {"path": ""}, dict(other) | {"path": ""})


# --- choices and refusals -----------------------------------------------------------------------------------------


def test_choices_among_the_stores_pairs(store: Path) -> None:
    dataset = PackedStore(store, cameras=["DemoBeta"], ratios=[100, 200], crop=8, seed=3)
    assert {record.camera for record in dataset.records} == {"DemoBeta"}
    assert {record.ratio for record in dataset.records} == {100, 200}
    assert list(dataset.frame["path"]) == [record.path for record in dataset.records]
    text = repr(dataset)
    for part in ("PackedStore", "6 of ", "DemoBeta", "crop=8", "augment=True", "seed=3", "levels='published'"):
        assert part in text
    for options, word in (
        ({"cameras": ["X"]}, "known are DemoAlpha, DemoBeta"),
        ({"levels": "camera"}, "levels must be one of"),
        ({"clip": "lower"}, "clip must be one of"),
        ({"amplification": "x"}, "amplification must be one of"),
        ({"subset": "x"}, "no subset is called 'x'"),
        ({"crop": 1}, "crop 2 or more"),
        ({"crops_per_frame": 0}, "crops_per_frame must be 1 or more"),
    ):
        with pytest.raises(ArgumentError, match=word):
            PackedStore(store, **options)
    with pytest.raises(DatasetError, match="too few for a crop"):
        PackedStore(store, crop=48)[0]


def test_a_store_of_a_part_and_its_subsets(tree: Tree, tmp_path: Path) -> None:
    card = tree.manifest.card
    subsets = (Subset("beta", "one camera", "", 12, paths="DemoBeta/*"), Subset("all", "all", "", 24))
    save_card(tree.csv.with_suffix(".json"), replace(card, subsets=subsets))
    source = source_of_dataset(card.name, root=tree.root, manifest=tree.csv, subset="beta")
    assert {path.rpartition("/")[0] for path, _ in source.files} == {BETA}
    build_store(source, tmp_path / "beta.h5")
    for subset in (None, "beta"):
        assert len(PackedStore(tmp_path / "beta.h5", crop=8, subset=subset)) == 12
    with pytest.raises(DatasetError, match="lacks 12 of the 24 chosen pairs, such as DemoAlpha/"):
        PackedStore(tmp_path / "beta.h5", subset="all")


# --- memory -------------------------------------------------------------------------------------------------------


@pytest.mark.memory
def test_memory_does_not_grow_with_the_store(tmp_path: Path) -> None:
    """120 frames of 1.5 MB each, every one read: 180 MB, or 8 MB if nothing is kept."""
    folder = tmp_path / "raws"
    folder.mkdir()
    sensor = make_sensor(BAYER["RGGB"], 768, 1024)
    write_dng(folder / "000.dng", random_mosaic(768, 1024), sensor, EXPOSURE)
    for number in range(1, 120):
        os.link(folder / "000.dng", folder / f"{number:03d}.dng")
    source = CleanFrames(pack_folder(folder, tmp_path / "store.h5", workers=2).store)
    process = psutil.Process()

    def read(indices: range) -> int:
        for index in indices:
            source.frame(index).read(slice(100, 600), slice(100, 600)).sum()
            source.frame(index).whole().sum()
        info = process.memory_info()
        resident: int = info.rss - info.shared  # what is mapped of the file is the system's to drop
        return resident

    after_few = read(range(5))
    assert read(range(120)) - after_few < 24e6
