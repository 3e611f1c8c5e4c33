"""Response curves, and their tables in text files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.interpolate import interp1d

from eldata.errors import ArgumentError, FileError
from eldata.isp.response import ResponseCurve, read_response_table

GRID = np.linspace(0, 1, 1024)
CURVES = [GRID ** (1 / 2.2), np.log1p(30 * GRID) / np.log1p(30), GRID**0.9 * (3 - 2 * GRID**0.9) * GRID**0.9]
UNEVEN = np.array([0.0, 0.1, 0.15, 0.6, 1.0])
THREE = ResponseCurve(
    np.broadcast_to(UNEVEN, (3, 5)),
    np.array([[0, 0.3, 0.5, 0.8, 1], [0, 0.2, 0.2, 0.9, 1], [0, 0.0, 0.4, 1.0, 1]]),
    "uneven",
)


def image(*leading: int, low: float = 0.0, high: float = 1.0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(low, high, (*leading, 3, 6, 5)))


@pytest.mark.parametrize("leading", [(), (2,), (2, 3)])
def test_interpolation_is_that_of_scipy(leading: tuple[int, ...]) -> None:
    values = image(*leading)
    result = THREE(values).numpy()
    for channel in range(3):
        expected = interp1d(THREE.irradiance[channel], THREE.brightness[channel])(values[..., channel, :, :])
        np.testing.assert_allclose(result[..., channel, :, :], expected, atol=1e-14)


def test_one_curve_serves_any_shape() -> None:
    curve = ResponseCurve(GRID, CURVES[0])
    values = torch.linspace(0, 1, 777, dtype=torch.float64)
    np.testing.assert_allclose(curve(values), np.interp(values, GRID, curve.brightness[0]), atol=1e-14)
    np.testing.assert_allclose(curve(image()), np.interp(image(), GRID, curve.brightness[0]), atol=1e-14)


def test_points_and_ends_are_met_and_the_outside_is_clipped() -> None:
    values = torch.from_numpy(np.tile(UNEVEN[:, None, None, None], (1, 3, 1, 1)))
    np.testing.assert_allclose(THREE(values)[:, :, 0, 0], THREE.brightness.T, atol=1e-15)
    outside = torch.tensor([-3.0, 0.0, 1.0, 7.0]).view(4, 1, 1, 1).expand(4, 3, 1, 1)
    assert THREE(outside)[:, :, 0, 0].tolist() == [[0.0] * 3, [0.0] * 3, [1.0] * 3, [1.0] * 3]


def test_gradients_are_finite_everywhere() -> None:
    values = torch.from_numpy(np.tile(np.array([-1.0, 0.0, 0.1, 0.15, 0.6, 1.0, 2.0]), (3, 1))[..., None])
    values.requires_grad_()
    (gradient,) = torch.autograd.grad(THREE(values).sum(), values)
    assert gradient.isfinite().all()


def test_ends_with_few_digits_are_set() -> None:
    curve = ResponseCurve(np.array([0.0, 0.5, 0.99999]), np.array([1e-6, 0.7, 1.00001]))
    assert (curve.irradiance[0, -1], curve.brightness[0, 0], curve.brightness[0, -1]) == (1, 0, 1)


@pytest.mark.parametrize(
    ("irradiance", "brightness", "words"),
    [
        ([0, 0.5, 0.5, 1], [0, 0.2, 0.4, 1], "irradiance must rise from point to point; point 3 has 0.5 after 0.5"),
        ([0, 0.2, 0.5, 1], [0, 0.4, 0.2, 1], "brightness must never fall; point 3 has 0.2 after 0.4"),
        ([0, 0.5, 0.9], [0, 0.5, 1], "irradiance must go from 0 to 1"),
        ([0, 0.5, 1], [0.1, 0.5, 1], "brightness must go from 0 to 1"),
        ([0, np.nan, 1], [0, 0.5, 1], "NaN"),
        ([0], [0], "2 or more points"),
        ([], [], "2 or more points"),
        ([0, 1], [0, 0.5, 1], "2 or more points"),
        ([[0, 1]] * 2, [[0, 1]] * 2, "2 or more points"),
    ],
)
def test_what_is_no_response_is_refused(irradiance: list[float], brightness: list[float], words: str) -> None:
    with pytest.raises(ArgumentError, match=f"^mine: .*{words}"):
        ResponseCurve(np.array(irradiance), np.array(brightness), "mine")


def test_three_curves_need_three_channels() -> None:
    for shape in ((4, 6, 5), (3,), (3, 6)):
        with pytest.raises(ArgumentError, match=r"expected an image \(\.\.\., 3, h, w\)"):
            THREE(torch.zeros(shape))


# --- tables ---------------------------------------------------------------------------------------------------------


def test_a_table_of_two_columns(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("# irradiance, brightness\n0, 0\n\n0.25, 0.5 # grey\n1;1\n")
    curve = read_response_table(path)
    assert (curve.irradiance.tolist(), curve.brightness.tolist()) == ([[0, 0.25, 1]], [[0, 0.5, 1]])
    assert curve.name == "mine"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 0\n0.5 0.7\n0.6 0.6\n1 1\n", "brightness must never fall"),
        ("0 0\nnan 1\n", "line 2: expected a finite number, found 'nan'"),
        ("0 0 0\n1 1 1\n", "lines of 2 numbers"),
        ("0 0\n0.5\n1 1\n", "lines of 2 numbers"),
        ("# nothing\n", "no line of numbers"),
    ],
)
def test_a_table_that_is_none_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "curve.txt"
    path.write_text(text)
    with pytest.raises(FileError, match=rf"curve\.txt: .*{words}"):
        read_response_table(path)


@pytest.mark.parametrize("colours", [1, 3])
def test_a_table_of_four_columns(colours: int, tmp_path: Path) -> None:
    """As numpy writes it, to the last bit; of two columns too."""
    brightness = np.array(CURVES[:colours])
    np.savetxt(
        tmp_path / "curve.txt", np.column_stack([GRID, *brightness]), fmt="%.17g", header="irradiance brightness"
    )
    curve = read_response_table(tmp_path / "curve.txt")
    np.testing.assert_array_equal(curve.brightness, brightness)
    np.testing.assert_array_equal(curve.irradiance, np.broadcast_to(GRID, brightness.shape))
