"""The steps against the same formulas in plain float64 numpy, and their gradients against finite differences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from eldata.errors import ArgumentError
from eldata.isp.rendering import (
    bin_colours,
    gamma_curve,
    round_to_8_bits,
    truncate_to_8_bits,
    white_balance,
)

if TYPE_CHECKING:
    from collections.abc import Callable

# Which of R, G, B each packed channel shows (the SID code's order for nine).
COLOURS = {4: [0, 1, 2, 1], 9: [0, 1, 2, 0, 2, 1, 1, 1, 1]}
COLOURS |= {4 * n: [colour for colour in COLOURS[4] for _ in range(n)] for n in (4, 9)}  # quad-Bayer and nona-Bayer
MULTIPLIERS = torch.tensor([2.0, 1.0, 1.5, 1.25], dtype=torch.float64)
MATRIX = torch.tensor([[1.6, -0.5, -0.1], [-0.2, 1.5, -0.3], [0.0, -0.6, 1.6]], dtype=torch.float64)
LEADING = [(), (2,), (2, 3)]


def packed_data(channels: int, leading: tuple[int, ...] = (), seed: int = 0) -> torch.Tensor:
    values = np.random.default_rng(seed).uniform(0.05, 0.45, (*leading, channels, 3, 4))
    return torch.from_numpy(values)


@pytest.mark.parametrize("leading", LEADING)
@pytest.mark.parametrize("channels", COLOURS)
def test_white_balance(channels: int, leading: tuple[int, ...]) -> None:
    packed = packed_data(channels, leading)
    factors = [[2.0, 1.0, 1.5][colour] for colour in COLOURS[9]]
    if channels != 9:
        factors = np.repeat([2.0, 1.0, 1.5, 1.25], channels // 4).tolist()
    expected = packed.numpy() * np.array(factors)[:, None, None]
    np.testing.assert_allclose(white_balance(packed, MULTIPLIERS).numpy(), expected, rtol=1e-15)


@pytest.mark.parametrize("leading", LEADING)
@pytest.mark.parametrize("channels", COLOURS)
def test_binning_averages_the_channels_of_a_colour(channels: int, leading: tuple[int, ...]) -> None:
    packed = packed_data(channels, leading)
    colours = np.array(COLOURS[channels])
    expected = np.stack([packed.numpy()[..., colours == colour, :, :].mean(axis=-3) for colour in range(3)], axis=-3)
    np.testing.assert_allclose(bin_colours(packed).numpy(), expected, rtol=1e-14)


def test_the_slope_of_gamma_at_black_is_finite() -> None:
    linear = torch.tensor([0.0, -1.0, 1e-9, 1e-8, 0.5], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(gamma_curve(linear).sum(), linear)
    assert gradient.isfinite().all()
    assert gradient[:3].tolist() == [0, 0, 0]


# --- 8 bits -------------------------------------------------------------------------------------------------------


def test_truncation_is_that_of_the_eld_code() -> None:
    image = torch.from_numpy(np.random.default_rng(0).uniform(-0.1, 1.1, (3, 100, 100)).astype(np.float32))
    expected = torch.clamp((image * 255).int(), min=0, max=255)
    assert (truncate_to_8_bits(image).int() == expected).all()


@pytest.mark.parametrize(
    ("value", "truncated", "rounded"),
    [
        *((0.0, 0, 0), (0.5, 127, 128), (1.9 / 255, 1, 2), (254.9 / 255, 254, 255), (1.0, 255, 255)),
        *((3.0, 255, 255), (-1.0, 0, 0), (1 - 2e-16, 255, 255)),
    ],
)
def test_eight_bits(value: float, truncated: int, rounded: int) -> None:
    image = torch.full((3, 1, 1), value, dtype=torch.float64)
    assert truncate_to_8_bits(image).flatten().tolist() == [truncated] * 3
    assert round_to_8_bits(image).flatten().tolist() == [rounded] * 3


@pytest.mark.parametrize("function", [truncate_to_8_bits, round_to_8_bits])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_no_number_has_no_code(function: Callable[[torch.Tensor], torch.Tensor], value: float) -> None:
    with pytest.raises(ArgumentError, match="NaN or infinities"):
        function(torch.tensor([0.5, value]))


# --- refusals -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(3, 5, 6), (4, 5), (12, 5, 6), (2, 8, 5, 6)])
def test_what_is_not_packed_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ArgumentError, match=r"\(\.\.\., 4, h, w\)"):
        bin_colours(torch.zeros(shape))
    with pytest.raises(ArgumentError, match=r"\(\.\.\., 4, h, w\)"):
        white_balance(torch.zeros(shape), MULTIPLIERS)


def test_integers_are_refused() -> None:
    with pytest.raises(ArgumentError, match="floating-point"):
        bin_colours(torch.zeros(4, 5, 6, dtype=torch.int32))
