"""A dark shading that was planted in files comes off the inputs to the bit: by every route, crop and orientation."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
import torch

from eldata.datasets import DRVDataset, PackedStore, PairDataset
from eldata.errors import ArgumentError, DatasetError
from eldata.raw import read_raw
from eldata.records import Exposure
from eldata.sources.frames import Frame
from tests.drv_tree import NOISY, SENSOR, write_raw_clip, write_rgb_clip
from tests.planted_shading import plant, shading_of
from tests.sid_tree import build_small_tree
from tests.sources.store.helpers import pack_tree
from tests.trees import BETA, Tree

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.noise import DarkShading


def planted(tree: Any, camera: str) -> DarkShading:
    """Plant it in all noisy frames of a camera; return the shading that takes it off."""
    rows = [row for row in tree.manifest.records if row.role == "noisy" and row.camera == camera]
    files = [tree.data / row.path for row in rows]
    return shading_of(read_raw(files[0]).sensor, sorted(plant(files)))


def same(expected: Any, found: Any) -> None:
    assert len(expected) == len(found) > 0
    for index in range(len(expected)):
        for side in ("input", "target"):
            assert torch.equal(expected[index][side], found[index][side]), (index, side)


def test_files_and_stores(pristine: Tree, tree: Tree, tmp_path: Path) -> None:
    """GBRG, published levels with the early clip and the file's without: DN are corrected before they are clipped."""
    shading = planted(tree, "DemoBeta")
    shading.save(tmp_path / "beta.npz")
    kept: dict[str, Any] = {"cameras": ["DemoBeta"]}
    each: list[dict[str, Any]] = [{"clip": "both"}, {"clip": "none", "levels": "metadata", "crop": 12, "augment": True}]
    for options in each:
        before = PairDataset(pristine.data, pristine.csv, **kept, **options)
        same(before, PairDataset(tree.data, tree.csv, **kept, **options, dark_shading=tmp_path / "beta.npz"))
    uncorrected = PairDataset(tree.data, tree.csv, **kept)
    assert not torch.equal(uncorrected[0]["input"], PairDataset(pristine.data, pristine.csv, **kept)[0]["input"])

    stores = [pack_tree(of, tmp_path / f"{name}.h5").store for name, of in (("clean", pristine), ("planted", tree))]
    cut: dict[str, Any] = {"crop": 10, "crops_per_frame": 4, "clip": "none", "seed": 3}
    clean, corrected = (
        PackedStore(stores[0], **kept, **cut),
        PackedStore(stores[1], **kept, **cut, dark_shading=shading),
    )
    same(clean, corrected)
    batches = [one.__getitems__(range(5)) for one in (clean, corrected)]
    assert all(torch.equal(a["input"], b["input"]) for a, b in zip(*batches, strict=True))
    assert f"dark_shading={shading.digest[:15]}" in repr(corrected)


def test_x_trans_and_clips(tmp_path: Path) -> None:
    trees = [build_small_tree("sid-fuji", tmp_path / name, ["10019"]) for name in ("clean", "planted")]
    shading = planted(trees[1], trees[1].manifest.records[0].camera)
    options: dict[str, Any] = {"crop": 6, "augment": True, "clip": "none"}
    same(
        PairDataset(trees[0].data, trees[0].csv, **options),
        PairDataset(trees[1].data, trees[1].csv, **options, dark_shading=shading),
    )
    for name in ("raw", "raw-planted"):
        write_raw_clip(tmp_path / name, "0001", 5)
    isos = plant(sorted((tmp_path / "raw-planted" / "short" / "0001").iterdir()))
    assert isos == {float(NOISY.iso or 0)}
    shading, cut = shading_of(SENSOR, isos), {"crop": 8, "augment": True, "crops_per_window": 3, "clip": "none"}
    same(
        DRVDataset(tmp_path / "raw", form="raw", **cut),  # type: ignore[arg-type]
        DRVDataset(tmp_path / "raw-planted", form="raw", dark_shading=shading, **cut),  # type: ignore[arg-type]
    )


def test_a_shading_that_is_not_the_inputs(tree: Tree, tmp_path: Path) -> None:
    beta = read_raw(tree.file(2, BETA))
    sensor, isos = beta.sensor, (800, 1600, 3200)

    def refused(words: str, shading: Any, error: type[Exception] = DatasetError, **options: Any) -> None:
        kept = {"cameras": ["DemoBeta"]} | options
        with pytest.raises(error, match=words):
            for _ in PairDataset(tree.data, tree.csv, dark_shading=shading, **kept):
                pass

    right = shading_of(sensor, isos)
    refused(
        r"is of one body, Planted, and there are pairs or clips of 2 cameras.*choose",
        right,
        ArgumentError,
        cameras=None,
    )
    refused(
        r"IMG_0.*is of a .*, but the dark shading of Planted is of a Other 7; it belongs to one body",
        replace(right, model="Other 7"),
    )
    refused("was not measured at ISO 3200, and no other ISO tells", shading_of(sensor, (800, 1600)))
    refused(
        "has 64 x 96 pixels .*, but the dark shading of Planted is of 66 x 96",
        shading_of(replace(sensor, height=66), isos),
    )
    refused("or another CFA", shading_of(replace(sensor, cfa=((0, 1), (3, 2))), isos))
    refused("expected a DarkShading or the path of its file; found 3", 3, ArgumentError)
    refused("cannot be read: No such file", tmp_path / "none.npz", Exception)
    unstated = shading_of(sensor, isos, model="")
    assert PairDataset(tree.data, tree.csv, cameras=["DemoBeta"], dark_shading=unstated)[0]["input"].shape[0] == 4
    store = pack_tree(tree, tmp_path / "s.h5").store
    with pytest.raises(DatasetError, match="not measured at ISO 3200"):  # before an item is read
        PackedStore(store, cameras=["DemoBeta"], dark_shading=shading_of(sensor, (800, 1600)))
    with pytest.raises(DatasetError, match=r"f: states no ISO, and the dark shading of Planted differs by ISO"):
        Frame.of_raw(beta.mosaic, sensor, "f", Exposure()).subtract(right)
    write_rgb_clip(tmp_path / "drv", "0001", 5)
    with pytest.raises(DatasetError, match="is not a raw frame in DN"):
        DRVDataset(tmp_path / "drv", ids=["0001"], dark_shading=right)[0]
