from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from eldata.demo import scenes
from eldata.demo.tree import make_tree
from eldata.manifest.catalogue import Manifest
from eldata.raw.reading import read_raw
from tests.cases import in_one_test

SIZE = (64, 96)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Manifest]:
    folder = tmp_path_factory.mktemp("tree")
    return folder, make_tree(folder, scenes=2, size=SIZE)


def test_the_same_seed_gives_the_same_bytes(tree: tuple[Path, Manifest], tmp_path: Path) -> None:
    make_tree(tmp_path, scenes=2, size=SIZE)
    first, second = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")} for folder in (tree[0], tmp_path)
    )
    assert first == second
    assert len(first) == 2 * 2 * 16 + 2


def test_no_two_frames_share_their_noise(tree: tuple[Path, Manifest]) -> None:
    folder = tree[0] / "data" / "ELD-demo" / "DemoAlpha" / "scene-1"
    first, second = (read_raw(folder / f"IMG_{n:04d}.dng").mosaic.astype(float) for n in (1, 6))
    assert abs(np.corrcoef((first - first.mean()).ravel(), (second - second.mean()).ravel())[0, 1]) > 0.9  # one scene
    difference = first - second
    assert 1 < difference.std() < 100


# --- scenes -----------------------------------------------------------------------------------------------------------

BASE = (1, 2, 3, 4)
NUMBERS = (*BASE, 5, 6, 7, 8, 1001)
SIZES = ((64, 64), (65, 97), (256, 384), (301, 200), (64, 301))


@in_one_test("number", NUMBERS)
@in_one_test("height, width", SIZES)
def test_radiance_is_finite_float32_between_0_and_1(number: int, height: int, width: int) -> None:
    radiance = scenes.scene_radiance(number, height, width)
    assert radiance.shape == (3, height, width)
    assert radiance.dtype == np.float32
    assert np.isfinite(radiance).all()
    assert radiance.min() >= 0
    assert radiance.max() <= 1


@in_one_test("number", NUMBERS)
def test_scene_has_dark_and_bright_regions_and_small_highlights(number: int) -> None:
    radiance = scenes.scene_radiance(number, 256, 384)
    assert np.percentile(radiance, 1) < 5e-3
    assert np.percentile(radiance, 99.5) > 0.4
    assert 0 < (radiance == 1).mean() < 1e-3  # a glint may saturate, a surface may not


def test_scenes_and_their_variations_differ() -> None:
    pictures = {number: scenes.scene_radiance(number, 64, 96) for number in range(1, 13)}
    for one, other in itertools.combinations(pictures, 2):
        difference = np.abs(np.sqrt(pictures[one]) - np.sqrt(pictures[other])).mean()
        assert difference > 0.02, (one, other)


def test_a_scene_looks_the_same_at_two_sizes() -> None:
    for number in BASE:
        large = scenes.scene_radiance(number, 256, 384).reshape(3, 64, 4, 96, 4).mean((2, 4))
        small = scenes.scene_radiance(number, 64, 96)
        assert np.abs(np.sqrt(large) - np.sqrt(small)).mean() < 0.02, number
