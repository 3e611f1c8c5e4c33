"""The pipeline against the same formulas in plain float64 numpy, its 8 bits, and what it refuses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from eldata.errors import ArgumentError
from eldata.isp.rendering import (
    Gamma,
    Rendering,
    bin_colours,
    colour_matrix,
    gamma_curve,
    render_pair_for_scoring,
    truncate_to_8_bits,
    white_balance,
)
from eldata.isp.response import ResponseCurve
from eldata.raw.colour import camera_to_srgb
from eldata.records import Sensor
from tests.raw.helpers import BAYER, XTRANS, make_sensor

SENSOR = make_sensor()
OTHER = make_sensor(
    model="Nocturne 2",
    white_balance=(1.7, 1.0, 2.2, 1.1),
    xyz_to_camera=((0.9, -0.3, -0.1), (-0.4, 1.2, 0.2), (0.0, 0.2, 0.6)),
)
GRID = np.linspace(0, 1, 64)
CURVES = ResponseCurve(np.broadcast_to(GRID, (3, 64)), np.stack([GRID**power for power in (0.4, 0.5, 0.6)]), "three")


def in_numpy(packed: NDArray[np.float64], sensor: Sensor, curves: Sequence[NDArray[np.float64]] | None = None) -> Any:
    """The published chain (ELD repository, util/process.py: process) in plain float64, of one image."""
    assert sensor.white_balance is not None
    assert sensor.xyz_to_camera is not None
    balance, sites = np.array(sensor.white_balance), len(packed) // 4  # of a colour's block: 1, or 4 of quad, 9 of nona
    colours, factors = np.repeat([0, 1, 2, 1], sites), np.repeat(balance, sites)
    if len(packed) == 9:
        colours = np.array([0, 1, 2, 0, 2, 1, 1, 1, 1])  # the SID code's order
        factors = balance[colours]
    balanced = np.clip(packed * factors[:, None, None], 0, 1)
    camera = np.stack([balanced[colours == colour].mean(axis=0) for colour in range(3)])
    linear = np.clip(np.tensordot(camera_to_srgb(sensor.xyz_to_camera), camera, axes=1), 0, 1)
    if curves is None:
        return np.maximum(linear, 1e-8) ** (1 / 2.2)
    return np.stack([np.interp(channel, GRID, curve) for channel, curve in zip(linear, curves, strict=True)])


def packed_data(channels: int, leading: tuple[int, ...] = (), *, high: float = 1.2, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).uniform(-0.2, high, (*leading, channels, 8, 6)))


@pytest.mark.parametrize("curves", [None, CURVES])
@pytest.mark.parametrize("channels", [4, 9, 16, 36])
def test_it_is_the_published_chain(channels: int, curves: ResponseCurve | None) -> None:
    rendering = Rendering.of(OTHER) if curves is None else Rendering.of(OTHER, curves)
    brightness = None if curves is None else list(curves.brightness)
    for leading in ((), (2,), (2, 3)):
        packed = packed_data(channels, leading)
        images = packed.numpy().reshape(-1, channels, 8, 6)
        expected = np.stack([in_numpy(image, OTHER, brightness) for image in images]).reshape(*leading, 3, 8, 6)
        np.testing.assert_allclose(rendering(packed).numpy(), expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("response", [Gamma(2.2), Gamma(1), CURVES])
@pytest.mark.parametrize("channels", [4, 9])
def test_gradients(channels: int, response: Gamma | ResponseCurve) -> None:
    """Well inside the range, where no clip lies; finite differences of 1e-6 stay on one segment of a curve."""
    values = np.random.default_rng(1).uniform(0.2, 0.3, (2, channels, 2, 3))
    packed = torch.from_numpy(values).requires_grad_()
    assert torch.autograd.gradcheck(Rendering.of(SENSOR, response), (packed,))


def test_the_slope_of_gamma_at_black_is_finite() -> None:
    linear = torch.tensor([0.0, -1.0, 1e-9, 1e-8, 0.5], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(gamma_curve(linear).sum(), linear)
    assert gradient.isfinite().all()
    assert gradient[:3].tolist() == [0, 0, 0]


def test_saturated_white_is_white_in_any_precision() -> None:
    for dtype in (torch.float32, torch.float64):
        assert Rendering.of(SENSOR)(torch.ones(4, 8, 6, dtype=dtype)).min() > 1 - 1e-6


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.float32, torch.float64])
def test_dtype_stays(dtype: torch.dtype) -> None:
    packed = packed_data(4, high=1.0)
    rendered = Rendering.of(SENSOR, CURVES)(packed.to(dtype))
    assert rendered.dtype == dtype
    assert (rendered.double() - Rendering.of(SENSOR, CURVES)(packed)).abs().mean() < 8 * torch.finfo(dtype).eps


@pytest.mark.parametrize("field", ["white_balance", "xyz_to_camera"])
def test_a_missing_colour_is_an_error(field: str) -> None:
    fields: dict[str, Any] = {field: None}
    sensor = make_sensor(**fields)
    with pytest.raises(ArgumentError, match=r"Acme Nocturne 1 has no (white balance|colour matrix).*Rendering\("):
        Rendering.of(sensor)


@pytest.mark.parametrize(
    "fields",
    [
        {"white_balance": (1.0, 1.0, 1.0)},
        {"white_balance": (0.0, 1.0, 1.0, 1.0)},
        {"white_balance": (float("nan"), 1.0, 1.0, 1.0)},
        {"camera_to_srgb": ((1.0, 0.0), (0.0, 1.0))},
        {"camera_to_srgb": ((float("inf"), 0, 0), (0, 1, 0), (0, 0, 1))},
    ],
)
def test_colours_that_make_no_sense_are_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match=next(iter(fields))):
        replace(Rendering.of(SENSOR), **fields)


def test_no_gamma_is_refused() -> None:
    for exponent in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ArgumentError, match="positive"):
            Gamma(exponent)


@pytest.mark.parametrize(
    ("shape", "dtype", "words"),
    [
        *((shape, torch.float32, r"\(\.\.\., 4, h, w\)") for shape in [(3, 5, 6), (4, 5), (12, 5, 6), (2, 8, 5, 6)]),
        ((4, 5, 6), torch.int32, "floating-point"),
    ],
)
def test_what_is_not_packed_is_refused(shape: tuple[int, ...], dtype: torch.dtype, words: str) -> None:
    for step in (bin_colours, lambda packed: white_balance(packed, torch.ones(4))):
        with pytest.raises(ArgumentError, match=words):
            step(torch.zeros(shape, dtype=dtype))
    with pytest.raises(ArgumentError, match=r"expected an image \(\.\.\., 3, h, w\)"):
        colour_matrix(torch.zeros(4, 5, 6), torch.eye(3))


# --- 8 bits -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "truncated"),
    [(0.0, 0), (0.5, 127), (1.9 / 255, 1), (254.9 / 255, 254), (1.0, 255), (3.0, 255), (-1.0, 0), (1 - 2e-16, 255)],
)
def test_eight_bits(value: float, truncated: int) -> None:
    image = torch.full((3, 1, 1), value, dtype=torch.float64)
    assert truncate_to_8_bits(image).flatten().tolist() == [truncated] * 3


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_no_number_has_no_code(value: float) -> None:
    with pytest.raises(ArgumentError, match="NaN or infinities"):
        truncate_to_8_bits(torch.tensor([0.5, value]))


# --- scoring ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", [make_sensor(BAYER["RGGB"]), make_sensor(XTRANS["xtrans-00"])])
def test_scored_codes_are_truncated_from_the_published_chain(sensor: Sensor) -> None:
    channels = 4 if len(sensor.cfa) == 2 else 9
    prediction, target = (packed_data(channels, (500,), seed=seed).numpy().astype(np.float32) for seed in (1, 2))
    prediction, target = (np.concatenate([*image], axis=-1) for image in (prediction, target))
    codes = render_pair_for_scoring(prediction, target, sensor)
    for packed, found in zip((prediction, target), codes, strict=True):
        scaled = np.float32(in_numpy(packed.astype(np.float64), sensor)) * np.float32(255)
        assert found.shape == (3, 8, 3000)
        assert found.dtype == np.uint8
        np.testing.assert_array_equal(found, np.floor(scaled))
    assert np.unique(codes[1]).size > 20


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_no_numbers_are_refused(bad: float) -> None:
    target = np.full((4, 8, 6), 0.5, np.float32)
    prediction = target.copy()
    prediction[0, 0, 0] = bad
    with pytest.raises(ArgumentError, match="prediction holds NaN or infinities"):
        render_pair_for_scoring(prediction, target, SENSOR)


@pytest.mark.parametrize("shapes", [((4, 8, 6), (4, 8, 7)), ((1, 4, 8, 6),) * 2, ((3, 8, 6),) * 2])
def test_other_shapes_are_refused(shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    with pytest.raises(ArgumentError, match="expected"):
        render_pair_for_scoring(np.zeros(shapes[0]), np.zeros(shapes[1]), SENSOR)
