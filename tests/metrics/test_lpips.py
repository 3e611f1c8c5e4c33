"""LPIPS: against the authors' package (golden/lpips_generate.py says how its values were made), and what it refuses."""

from __future__ import annotations

import json
import math
import os
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eldata.base.files import sha256_of
from eldata.errors import ArgumentError, FileError
from eldata.metrics import LpipsWeights
from eldata.metrics import lpips as lpips_of
from eldata.metrics.lpips import BACKBONE_FILE, LINEAR_FILE
from tests.metrics.golden.lpips_images import CASES, KERNELS, Case, linear_state, noisy, texture
from tests.metrics.seeded_lpips import State, publish, seeded_states

GOLDEN: dict[str, Any] = json.loads((Path(__file__).parent / "golden" / "lpips.json").read_text(encoding="utf-8"))

# A feature is a sum of at most 3456 products (384 channels, 3 x 3), so that float32 moves the unit vector of a pixel by
# about sqrt(3456) 2^-24. With weights of at most 1, five layers and the inequality of Cauchy and Schwarz, a distance d
# moves by no more than 2 sqrt(5 d) times that.
ROUNDING = math.sqrt(384 * 3 * 3) * 2.0**-24


def tolerance(distance: float) -> float:
    return 2.0 * math.sqrt(5.0 * distance) * ROUNDING


@pytest.fixture(scope="module")
def states() -> tuple[State, State]:
    return seeded_states()


@pytest.fixture(scope="module")
def weights(states: tuple[State, State]) -> LpipsWeights:
    return LpipsWeights.of(*states)


# Against the authors' implementation


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_distances_are_those_of_the_authors_package(case: Case, weights: LpipsWeights) -> None:
    prediction, reference = (image.astype(np.float32) for image in case.make())
    expected = GOLDEN["cases"][case.name]["lpips"]
    assert expected > 5e-4
    assert lpips_of(prediction, reference, weights) == pytest.approx(expected, abs=tolerance(expected), rel=0)


def test_the_linear_layers_are_the_published_ones() -> None:
    """torchmetrics, with which this project is tested, brings the authors' file too."""
    installed = distribution("torchmetrics").locate_file("torchmetrics/functional/image/lpips_models/alex.pth")
    file = Path(str(installed))
    assert (file.stat().st_size, sha256_of(file)) == (LINEAR_FILE.size_bytes, LINEAR_FILE.sha256)
    state = torch.load(file, map_location="cpu", weights_only=True)
    assert {name: tuple(tensor.shape) for name, tensor in state.items()} == {
        name: values.shape for name, values in linear_state().items()
    }
    assert min(float(tensor.min()) for tensor in state.values()) >= 0.0


def test_the_backbone_carries_the_beginning_of_its_digest_in_its_name() -> None:
    assert BACKBONE_FILE.name == f"alexnet-owt-{BACKBONE_FILE.sha256.removeprefix('sha256:')[:8]}.pth"
    assert BACKBONE_FILE.source.endswith(f"/{BACKBONE_FILE.name}")


# Properties


def test_identical_images_have_no_distance_and_the_order_does_not_matter(weights: LpipsWeights) -> None:
    image = texture(40, 52).astype(np.float32)
    other = noisy(texture(40, 52), 0.05).astype(np.float32)
    assert lpips_of(image, image.copy(), weights) == 0.0
    assert lpips_of(image, other, weights) == lpips_of(other, image, weights) > 0.0
    black = np.zeros((3, 32, 32), np.float32)
    assert lpips_of(black, black, weights) == 0.0


def test_layout_and_type_do_not_matter(weights: LpipsWeights) -> None:
    prediction = (noisy(texture(40, 52), 0.05) * 64).round() / 64  # what bfloat16 holds
    reference = (texture(40, 52) * 64).round() / 64
    expected = lpips_of(prediction, reference, weights)
    assert lpips_of(prediction.astype(np.float32), reference.astype(np.float16), weights) == expected
    assert lpips_of(torch.from_numpy(prediction).bfloat16(), torch.from_numpy(reference), weights) == expected
    last = np.ascontiguousarray(prediction.transpose(1, 2, 0)).transpose(2, 0, 1)
    assert lpips_of(last, torch.from_numpy(reference).requires_grad_(), weights) == expected


def test_images_and_weights_are_left_as_they_were(weights: LpipsWeights) -> None:
    images = [image.astype(np.float32) for image in CASES[0].make()]
    before = [image.copy() for image in images]
    first = lpips_of(images[0], images[1], weights)
    for image, copy in zip(images, before, strict=True):
        np.testing.assert_array_equal(image, copy)
    assert lpips_of(images[0], images[1], weights) == first


def test_the_number_of_threads_does_not_matter_and_is_given_back(weights: LpipsWeights) -> None:
    prediction, reference = noisy(texture(96, 80), 0.1), texture(96, 80)
    before = torch.get_num_threads()
    found = set()
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            found.add(lpips_of(prediction, reference, weights))
            assert torch.get_num_threads() == threads
        with ThreadPoolExecutor(3) as pool:
            found.update(pool.map(lambda _: lpips_of(prediction, reference, weights), range(6)))
            assert set(pool.map(lambda _: torch.get_num_threads(), range(6))) == {3}
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)
    assert len(found) == 1


def test_threads_that_come_and_go_change_nothing(weights: LpipsWeights) -> None:
    """Of pools of two new threads, some 3 in 100 gave other values when a thread took the process's number late."""
    images = [(noisy(texture(72, 96), 0.05 * step), texture(72, 96)) for step in (1, 2, 3, 4)]
    alone = [lpips_of(prediction, reference, weights) for prediction, reference in images]
    for _ in range(200):
        with ThreadPoolExecutor(2) as pool:
            assert list(pool.map(lambda pair: lpips_of(pair[0], pair[1], weights), images)) == alone


# Images that it refuses

GOOD = np.full((3, 40, 40), 0.5, np.float32)
SMALL = GOOD[:, :30]
GREY = GOOD[:1]
PACKED = np.full((4, 40, 40), 0.5, np.float32)
BATCH = GOOD[None]
WIDE = GOOD * 255
SIGNED = GOOD - 1
CODES = (GOOD * 255).astype(np.uint8)
HOLE = np.where(np.arange(40) == 7, np.nan, GOOD)


@pytest.mark.parametrize(
    ("prediction", "reference", "message"),
    [
        (SMALL, SMALL, "an image of 30 x 40 pixels is too small: LPIPS needs at least 31 x 31"),
        (GREY, GREY, r"sRGB images \(3, h, w\); found 1 channel: render raw images first"),
        (PACKED, PACKED, r"found 4 channels: render raw images first \(docs/srgb.md\)"),
        (GOOD[0], GOOD[0], "found 1 channel"),
        (BATCH, BATCH, "the prediction is a batch of shape"),
        (WIDE, GOOD, r"in \[0, 1\]; the prediction holds 127.5 to 127.5: clip or scale it"),
        (GOOD, SIGNED, r"the reference holds -0.5 to -0.5"),
        (HOLE, GOOD, "the prediction holds nan to nan"),
        (GOOD, CODES, r"the reference holds integers \(uint8\)"),
        (GOOD, GOOD[:, :, :39], "differ in shape"),
        ([[0.5]], GOOD, "the prediction must be a numpy array or a torch tensor, not list"),
    ],
)
def test_images_that_are_refused(prediction: Any, reference: Any, message: str, weights: LpipsWeights) -> None:
    with pytest.raises(ArgumentError, match=message):
        lpips_of(prediction, reference, weights)


# Weights that it refuses


def test_weights_of_another_network_are_refused(states: tuple[State, State]) -> None:
    backbone, linear = states
    without = {name: tensor for name, tensor in backbone.items() if name != "features.6.bias"}
    with pytest.raises(ArgumentError, match=r"torchvision's AlexNet lacks 'features.6.bias'; it has features.0.weight"):
        LpipsWeights.of(without, linear)
    with pytest.raises(ArgumentError, match=r"lin1.model.1.weight of the linear layers .* \(1, 192, 1, 1\), found"):
        LpipsWeights.of(backbone, linear | {"lin1.model.1.weight": torch.zeros(1, 128, 1, 1)})
    with pytest.raises(ArgumentError, match=r"features.0.bias .* found torch.float64 \(64,\)"):
        LpipsWeights.of(backbone | {"features.0.bias": backbone["features.0.bias"].double()}, linear)
    with pytest.raises(ArgumentError, match=r"lin0.model.1.weight .* found list"):
        LpipsWeights.of(backbone, linear | {"lin0.model.1.weight": [0.0]})  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"features.10.weight .* NaN or infinities"):
        LpipsWeights.of(backbone | {"features.10.weight": torch.full(KERNELS["features.10"], math.nan)}, linear)


def test_weights_are_loaded_from_a_folder(
    tmp_path: Path, states: tuple[State, State], weights: LpipsWeights, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish(tmp_path / "weights", states, monkeypatch)
    prediction, reference = CASES[0].make()
    loaded = LpipsWeights.load(tmp_path / "weights")
    assert lpips_of(prediction, reference, loaded) == lpips_of(prediction, reference, weights)


def test_files_that_are_not_the_published_ones_are_refused(
    tmp_path: Path, states: tuple[State, State], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "weights"
    with pytest.raises(FileError, match=r"7be5be79.pth: cannot be read: .*torchvision's AlexNet, from http"):
        LpipsWeights.load(folder)
    publish(folder, states, monkeypatch)
    linear = folder / "alex.pth"
    whole = linear.read_bytes()
    sizes = f"{len(whole)} bytes; found {len(whole) - 1} bytes"
    for content, message in [
        (b"", "is empty"),
        (whole[:-1], f"expected the linear layers of LPIPS 0.1 for AlexNet, {sizes}: copy it again from lpips/weights"),
        (bytes([whole[0] ^ 1]) + whole[1:], r"expected the linear layers .* sha256:.*; found sha256:"),
    ]:
        linear.write_bytes(content)
        with pytest.raises(FileError, match=f"alex.pth: {message}"):
            LpipsWeights.load(folder)
    linear.unlink()
    linear.mkdir()
    with pytest.raises(FileError, match=r"alex.pth: is a folder, not a file"):
        LpipsWeights.load(folder)


def test_a_strangers_file_is_not_opened_as_weights(
    tmp_path: Path, states: tuple[State, State], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the right size, but with other bytes: its pickle would make a folder."""
    publish(tmp_path / "weights", states, monkeypatch)
    linear = tmp_path / "weights" / "alex.pth"
    attack = f"cos\nmkdir\n(V{tmp_path / 'made'}\ntR.".encode()
    linear.write_bytes(attack.ljust(linear.stat().st_size, b"\0"))
    with pytest.raises(FileError, match="found sha256:"):
        LpipsWeights.load(tmp_path / "weights")
    assert not os.path.lexists(tmp_path / "made")
