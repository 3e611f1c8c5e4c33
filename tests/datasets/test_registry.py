"""What every dataset of the registry must do. A new dataset is tested by being registered."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import pytest
import torch

from eldata.datasets import PairDataset, dataset_class, dataset_names, open_dataset
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.catalogue import shipped_manifest, shipped_names
from eldata.manifest.verify import verify
from tests.sid_tree import build_sid_tree
from tests.trees import build_published_tree

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from eldata.manifest.catalogue import Manifest

# How each dataset's files are faked: every published name, small DNG content.
TREES: dict[str, Callable[[Manifest, Path], None]] = {
    "eld": build_published_tree,
    "sid-sony": build_sid_tree,
    "sid-fuji": build_sid_tree,
}
EVERY = pytest.mark.parametrize("name", dataset_names())


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Per dataset a data root whose files have the published names and small DNG content."""
    made = {}
    for name in dataset_names():
        manifest = shipped_manifest(name)
        made[name] = tmp_path_factory.mktemp(name)
        TREES[name](manifest, made[name] / manifest.card.folder)
    return made


def opened(name: str, roots: dict[str, Path], **options: object) -> PairDataset:
    return open_dataset(name, roots[name] / shipped_manifest(name).card.folder, **options)


def test_there_are_datasets() -> None:
    assert "eld" in dataset_names()
    assert set(dataset_names()) <= set(shipped_names())


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(ArgumentError, match="no dataset is called 'elf'; known are eld"):
        dataset_class("elf")
    with pytest.raises(ArgumentError, match="no dataset is called 'elf'; known are eld"):
        open_dataset("elf")


@EVERY
def test_the_card_is_filled_in(name: str) -> None:
    manifest = shipped_manifest(name)
    assert manifest.name == manifest.path.stem == name
    for item in fields(manifest.card):
        if item.name == "subsets":
            continue  # not every set has named ones
        assert getattr(manifest.card, item.name), f"{item.name} is empty"
    assert manifest.card.homepage.startswith("https://")
    for download in manifest.card.downloads:
        assert download.address.startswith("https://")
    for camera in manifest.card.cameras.values():
        assert all(camera.models)
        assert camera.models
    assert {record.camera for record in manifest.records} == set(manifest.card.cameras), "no camera without files"


@EVERY
def test_the_published_names_can_be_read(name: str, roots: dict[str, Path]) -> None:
    """The real names with their extensions in their real case; and every camera's files open."""
    dataset = opened(name, roots)
    assert isinstance(dataset, PairDataset)
    assert dataset.name == name
    seen = set()
    for index, record in enumerate(dataset.records):
        if record.camera not in seen:
            seen.add(record.camera)
            sample = dataset[index]
            assert sample["path"] == record.path
            assert sample["input"].shape == sample["target"].shape
            assert sample["input"].dtype == sample["target"].dtype == torch.float32
            assert sample["ratio"] == pytest.approx(float(record.ratio), rel=0.1)
    assert seen == set(shipped_manifest(name).card.cameras)


@EVERY
def test_the_published_names_verify(name: str, roots: dict[str, Path]) -> None:
    assert verify([shipped_manifest(name)], roots[name], dataset=name, level="quick").ok


@EVERY
@pytest.mark.parametrize(
    ("options", "said", "field"),
    [
        ({"scenes": ["nowhere"]}, "no pair has scene nowhere; known are", "scene"),
        ({"isos": [7]}, "no pair has ISO 7; known are", "iso"),
        ({"ratios": [7]}, "no pair has ratio 7; known are", "ratio"),
    ],
)
def test_unknown_values_list_the_known(
    name: str, options: dict[str, object], said: str, field: str, roots: dict[str, Path]
) -> None:
    known = {getattr(record, field) for record in shipped_manifest(name).records if record.role == "noisy"} - {None}
    with pytest.raises(ArgumentError, match=said) as raised:
        opened(name, roots, **options)
    for value in known:
        assert str(value) in str(raised.value)


@pytest.mark.parametrize(("name", "options"), [("eld", {"cameras": ["Obscura"]}), ("sid-sony", {"camera": "Obscura"})])
def test_unknown_cameras_are_refused(name: str, options: dict[str, object], roots: dict[str, Path]) -> None:
    with pytest.raises(ArgumentError, match="Obscura"):
        opened(name, roots, **options)


@EVERY
def test_a_missing_folder_says_where_to_get_the_files(name: str, tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as raised:
        open_dataset(name, tmp_path / "nowhere")
    assert shipped_manifest(name).card.homepage in str(raised.value)


@EVERY
def test_the_class_says_what_it_is(name: str, roots: dict[str, Path]) -> None:
    dataset = opened(name, roots)
    assert repr(dataset).startswith(f"{type(dataset).__name__}(")
    assert "References" in (type(dataset).__doc__ or "")


def test_the_published_eld_set_is_240_pairs(roots: dict[str, Path]) -> None:
    dataset = opened("eld", roots)
    assert len(dataset) == 240
    sample = opened("eld", roots, cameras=["NikonD850"], scenes=[1], isos=[3200], ratios=[1])[0]
    assert (sample["ratio"], sample["nominal_ratio"], sample["flags"]) == (0.9375, 1.0, "inexact-ratio")
