from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eldata.baselines.tiling import tiled
from eldata.errors import ArgumentError


def network(layers: int) -> torch.nn.Module:
    torch.manual_seed(17)
    parts = [torch.nn.Sequential(torch.nn.Conv2d(4, 4, 3, padding=1), torch.nn.ReLU()) for _ in range(layers)]
    return torch.nn.Sequential(*parts, torch.nn.Conv2d(4, 4, 3, padding=1))


def run(module: torch.nn.Module, image: np.ndarray) -> np.ndarray:
    with torch.inference_mode():
        return np.asarray(module(torch.from_numpy(image)[None])[0].numpy())


@settings(max_examples=25, deadline=None)
@given(
    st.integers(9, 90), st.integers(9, 90), st.sampled_from([(32, 16), (48, 16), (64, 32)]), st.sampled_from([1, 4, 8])
)
def test_tiles_are_the_whole_image(height: int, width: int, sides: tuple[int, int], multiple: int) -> None:
    """Three convolutions of 3 x 3 reach 3 pixels; a quarter of an overlap of 16 is 4."""
    image = np.random.default_rng(height * 100 + width).random((4, height, width)).astype(np.float32)
    module = network(2)
    tile, overlap = sides
    whole = tiled(lambda part: run(module, part), image, tile=0, overlap=0, multiple=multiple)
    found = tiled(lambda part: run(module, part), image, tile=tile, overlap=overlap, multiple=multiple)
    assert found.shape == image.shape
    assert np.abs(found - whole).max() < 2e-6


def test_a_network_that_sees_further_differs() -> None:
    image = np.random.default_rng(0).random((4, 80, 80)).astype(np.float32)
    module = network(11)
    whole = run(module, image)
    found = tiled(lambda part: run(module, part), image, tile=32, overlap=16, multiple=1)
    assert 1e-6 < np.abs(found - whole).max() < 0.1
    wide = tiled(lambda part: run(module, part), image, tile=96, overlap=48, multiple=1)
    assert np.abs(wide - whole).max() < 2e-6


def test_pooling_networks_keep_their_grid() -> None:
    """A network that halves its image is the same at multiples of 2 alone, where tiles begin."""

    def halves(part: np.ndarray) -> np.ndarray:
        small = part.reshape(4, part.shape[1] // 2, 2, part.shape[2] // 2, 2).mean(axis=(2, 4))
        return np.repeat(np.repeat(small, 2, axis=1), 2, axis=2)

    image = np.random.default_rng(0).random((4, 75, 101)).astype(np.float32)
    whole = tiled(halves, image, tile=0, overlap=0, multiple=2)
    assert np.abs(tiled(halves, image, tile=32, overlap=8, multiple=2) - whole).max() < 1e-6


@pytest.mark.parametrize(("tile", "overlap", "multiple"), [(30, 8, 4), (32, 6, 4), (32, 20, 4), (-1, 0, 1), (32, 8, 0)])
def test_what_does_not_go_together(tile: int, overlap: int, multiple: int) -> None:
    with pytest.raises(ArgumentError, match="multiple"):
        tiled(lambda part: part, np.zeros((4, 64, 64), np.float32), tile=tile, overlap=overlap, multiple=multiple)


def test_images_that_do_not_fit_are_named() -> None:
    with pytest.raises(ArgumentError, match=r"of an image of \(4, 64, 64\) it made \(4, 62, 62\)"):
        tiled(lambda part: part[:, 1:-1, 1:-1], np.zeros((4, 64, 64), np.float32), tile=0, overlap=0, multiple=1)
    with pytest.raises(ArgumentError, match="too small to be extended to multiples of 16"):
        tiled(lambda part: part, np.zeros((4, 5, 64), np.float32), tile=0, overlap=0, multiple=16)
