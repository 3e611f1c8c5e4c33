from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from eldata.errors import ArgumentError
from eldata.isp.rendering import Gamma, Rendering, render_pair_for_scoring
from eldata.isp.response import ResponseCurve
from eldata.raw.colour import camera_to_srgb
from tests.raw.helpers import BAYER, XTRANS, make_sensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.records import Sensor

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
    colours = [0, 1, 2, 1] if len(packed) == 4 else [0, 1, 2, 0, 2, 1, 1, 1, 1]
    factors = [sensor.white_balance[at] for at in (range(4) if len(packed) == 4 else colours)]
    balanced = np.clip(packed * np.array(factors)[:, None, None], 0, 1)
    camera = np.stack([balanced[np.array(colours) == colour].mean(axis=0) for colour in range(3)])
    linear = np.clip(np.tensordot(camera_to_srgb(sensor.xyz_to_camera), camera, axes=1), 0, 1)
    if curves is None:
        return np.maximum(linear, 1e-8) ** (1 / 2.2)
    return np.stack([np.interp(channel, GRID, curve) for channel, curve in zip(linear, curves, strict=True)])


def packed_data(channels: int, leading: tuple[int, ...] = (), *, high: float = 1.2, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).uniform(-0.2, high, (*leading, channels, 8, 6)))


@pytest.mark.parametrize("curves", [None, CURVES])
@pytest.mark.parametrize("channels", [4, 9])
def test_it_is_the_published_chain(channels: int, curves: ResponseCurve | None) -> None:
    packed = packed_data(channels)
    rendering = Rendering.of(OTHER) if curves is None else Rendering.of(OTHER, curves)
    expected = in_numpy(packed.numpy(), OTHER, None if curves is None else list(curves.brightness))
    np.testing.assert_allclose(rendering(packed).numpy(), expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("response", [Gamma(2.2), Gamma(1), CURVES])
@pytest.mark.parametrize("channels", [4, 9])
def test_gradients(channels: int, response: Gamma | ResponseCurve) -> None:
    """Well inside the range, where no clip lies; finite differences of 1e-6 stay on one segment of a curve."""
    values = np.random.default_rng(1).uniform(0.2, 0.3, (2, channels, 2, 3))
    packed = torch.from_numpy(values).requires_grad_()
    assert torch.autograd.gradcheck(Rendering.of(SENSOR, response), (packed,))


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


# --- scoring ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", [make_sensor(BAYER["RGGB"]), make_sensor(XTRANS["xtrans-00"])])
def test_scored_codes_are_truncated_from_the_published_chain(sensor: Sensor) -> None:
    channels = 4 if len(sensor.cfa) == 2 else 9
    prediction, target = (packed_data(channels, seed=seed).numpy().astype(np.float32) for seed in (1, 2))
    codes = render_pair_for_scoring(prediction, target, sensor)
    for packed, found in zip((prediction, target), codes, strict=True):
        scaled = np.float32(in_numpy(packed.astype(np.float64), sensor)) * np.float32(255)
        assert found.shape == (3, 8, 6)
        assert found.dtype == np.uint8
        np.testing.assert_array_equal(found, np.floor(scaled))
    assert np.unique(codes[1]).size > 20


def test_scored_codes_are_those_of_the_published_arithmetic() -> None:
    """In float32 throughout, as there, a value within 1e-5 of a whole code may fall on its other side."""
    packed = np.random.default_rng(0).uniform(0, 1, (4, 100, 100)).astype(np.float32)
    assert SENSOR.white_balance is not None
    assert SENSOR.xyz_to_camera is not None
    tensor = torch.from_numpy(packed)
    balanced = (tensor * torch.tensor(SENSOR.white_balance).view(4, 1, 1)).clamp(0, 1)
    rgb = torch.stack([balanced[0], balanced[[1, 3]].mean(dim=0), balanced[2]])
    matrix = torch.tensor(camera_to_srgb(SENSOR.xyz_to_camera), dtype=torch.float32)
    linear = (rgb.permute(1, 2, 0)[..., None, :] * matrix).sum(dim=-1).permute(2, 0, 1).clamp(0, 1)
    published = ((linear.clamp(min=1e-8) ** (1 / 2.2)) * 255).int().clamp(0, 255).numpy()
    ours = render_pair_for_scoring(packed, packed, SENSOR)[0].astype(int)
    # A share of 1e-5 lies so near to a whole code that float32 decides: of 30000 values 0.3, and 5 once in 1e6 times.
    assert np.abs(ours - published).max() <= 1
    assert (ours != published).sum() <= 5


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
