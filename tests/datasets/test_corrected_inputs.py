"""A dark shading that was planted in files comes off the inputs to the bit: by every route, crop and orientation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eldata.datasets import DRVDataset, PackedStore, PairDataset
from eldata.errors import DatasetError, EldataError
from eldata.noise import DarkShading
from eldata.raw import read_raw
from eldata.records import Exposure
from eldata.sources.frames import Frame
from tests.datasets.comparing import same
from tests.drv_tree import NOISY, SENSOR, write_raw_clip
from tests.planted_shading import plant, shading_of
from tests.sid_tree import build_small_tree
from tests.sources.store.helpers import pack_tree
from tests.trees import BETA, Tree


def planted(tree: Any, camera: str) -> DarkShading:
    """Plant it in all noisy frames of a camera; return the shading that takes it off."""
    rows = [row for row in tree.manifest.records if row.role == "noisy" and row.camera == camera]
    files = [tree.data / row.path for row in rows]
    return shading_of(read_raw(files[0]).sensor, sorted(plant(files)))


def all_same(expected: Any, found: Any) -> None:
    for first, second in zip(expected, found, strict=True):
        same(first, second)


def test_files_and_stores(pristine: Tree, store: Path, tree: Tree, tmp_path: Path) -> None:
    """GBRG, published levels with the early clip and the file's without: DN are corrected before they are clipped."""
    shading = planted(tree, "DemoBeta")
    shading.save(tmp_path / "beta.npz")
    kept: dict[str, Any] = {"cameras": ["DemoBeta"]}
    options: dict[str, Any]
    for options in ({"clip": "both"}, {"clip": "none", "levels": "metadata", "crop": 12, "augment": True}):
        before = PairDataset(pristine.data, pristine.csv, **kept, **options)
        all_same(before, PairDataset(tree.data, tree.csv, **kept, **options, dark_shading=tmp_path / "beta.npz"))
    uncorrected = PairDataset(tree.data, tree.csv, **kept)
    assert not torch.equal(uncorrected[0]["input"], PairDataset(pristine.data, pristine.csv, **kept)[0]["input"])
    cut: dict[str, Any] = {"crop": 10, "crops_per_frame": 4, "clip": "none", "seed": 3}
    clean = PackedStore(store, **kept, **cut)
    corrected = PackedStore(pack_tree(tree, tmp_path / "planted.h5").store, **kept, **cut, dark_shading=shading)
    all_same(clean, corrected)
    all_same(clean.__getitems__(range(5)), corrected.__getitems__(range(5)))
    assert f"dark_shading={shading.digest[:15]}" in repr(corrected)


def test_x_trans_and_clips(tmp_path: Path) -> None:
    clean, other = (build_small_tree("sid-fuji", tmp_path / name, ["10019"]) for name in ("clean", "planted"))
    shading = planted(other, other.manifest.records[0].camera)
    options: dict[str, Any] = {"crop": 6, "augment": True, "clip": "none"}
    all_same(
        PairDataset(clean.data, clean.csv, **options),
        PairDataset(other.data, other.csv, **options, dark_shading=shading),
    )
    for name in ("raw", "raw-planted"):
        write_raw_clip(tmp_path / name, "0001", 5)
    isos = plant(sorted((tmp_path / "raw-planted" / "short" / "0001").iterdir()))
    assert isos == {float(NOISY.iso or 0)}
    options |= {"form": "raw", "crops_per_window": 3}
    all_same(
        DRVDataset(tmp_path / "raw", **options),
        DRVDataset(tmp_path / "raw-planted", dark_shading=shading_of(SENSOR, isos), **options),
    )


def test_a_shading_that_is_not_the_inputs(tree: Tree, tmp_path: Path) -> None:
    beta = read_raw(tree.file(2, BETA))
    sensor, isos = beta.sensor, (800, 1600, 3200)
    right, few = shading_of(sensor, isos), shading_of(sensor, (800, 1600))
    one_camera: dict[str, Any] = {"cameras": ["DemoBeta"]}
    refusals: list[tuple[str, Any, dict[str, Any]]] = [
        ("is of one body, Planted, and there are pairs or clips of 2 cameras", right, {}),
        ("IMG_0.*is of a .*, but .* Planted is of a Other 7", replace(right, model="Other 7"), one_camera),
        ("was not measured at ISO 3200", few, one_camera),
        ("has 64 x 96 pixels .* is of 66 x 96", shading_of(replace(sensor, height=66), isos), one_camera),
        ("or another CFA", shading_of(replace(sensor, cfa=((0, 1), (3, 2))), isos), one_camera),
        ("expected a DarkShading or the path of its file; found 3", 3, one_camera),
        ("cannot be read: No such file", tmp_path / "none.npz", one_camera),
    ]
    for words, shading, options in refusals:
        with pytest.raises(EldataError, match=words):
            list(PairDataset(tree.data, tree.csv, dark_shading=shading, **options))
    unstated = shading_of(sensor, isos, model="")
    assert PairDataset(tree.data, tree.csv, dark_shading=unstated, **one_camera)[0]["input"].shape[0] == 4
    with pytest.raises(DatasetError, match="not measured at ISO 3200"):  # before an item is read
        PackedStore(pack_tree(tree, tmp_path / "s.h5").store, dark_shading=few, **one_camera)
    with pytest.raises(DatasetError, match=r"f: states no ISO"):
        Frame.of_raw(beta.mosaic, sensor, "f", Exposure()).subtract(right)
    with pytest.raises(DatasetError, match="is not a raw frame in DN"):
        Frame.of_rgb(np.zeros((3, 8, 8), np.uint16), "f").subtract(right)
