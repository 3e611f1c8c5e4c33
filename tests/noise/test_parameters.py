"""One draw of parameters: what is refused, and the variance of the Tukey-lambda distribution."""

from __future__ import annotations

import itertools
import math
import pickle
from typing import Any

import numpy as np
import pytest
import torch
from scipy import integrate, stats

from eldata.errors import ArgumentError
from eldata.noise import NoiseParameters, tukey_lambda_variance

GOOD: dict[str, Any] = {
    "gain_dn_per_e": 1.5,
    "tukey_lambda": 0.1,
    "sigma_tl_dn": 1.0,
    "sigma_gauss_dn": 2.0,
    "sigma_row_dn": 0.5,
    "colour_bias_dn": (1.0, -2.0, 3.0, -4.0),
}
NUMBERS = [name for name in GOOD if name != "colour_bias_dn"]


def test_good_values_stay_as_they_are() -> None:
    parameters = NoiseParameters(**GOOD)
    assert parameters.as_dict() == GOOD
    assert pickle.loads(pickle.dumps(parameters)) == parameters


@pytest.mark.parametrize("make", [list, np.array, torch.tensor, tuple])
def test_a_colour_bias_of_any_kind_is_kept_as_a_tuple(make: Any) -> None:
    bias = make(GOOD["colour_bias_dn"])
    parameters = NoiseParameters(**GOOD | {"colour_bias_dn": bias})
    assert parameters == NoiseParameters(**GOOD)
    assert type(parameters.colour_bias_dn) is tuple
    assert hash(parameters) == hash(NoiseParameters(**GOOD))


@pytest.mark.parametrize("value", ["1.5", None, [1.0], 1j])
@pytest.mark.parametrize("name", NUMBERS)
def test_what_is_not_a_number_is_named(name: str, value: Any) -> None:
    with pytest.raises(ArgumentError, match=rf"^{name} must be one number, finite; found"):
        NoiseParameters(**GOOD | {name: value})


@pytest.mark.parametrize("value", [1.0, None, "0000", ("a", 0.0, 0.0, 0.0), [[0.0] * 4]])
def test_a_colour_bias_that_makes_no_sense(value: Any) -> None:
    with pytest.raises(ArgumentError, match=r"^colour_bias_dn (has four values|must be one number)"):
        NoiseParameters(**GOOD | {"colour_bias_dn": value})


def test_the_colour_bias_is_0_by_default() -> None:
    numbers = {name: GOOD[name] for name in NUMBERS}
    assert NoiseParameters(**numbers).colour_bias_dn == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_that_is_not_finite_is_named(name: str, value: float) -> None:
    with pytest.raises(ArgumentError, match=rf"^{name} must be finite; found -?(nan|inf)"):
        NoiseParameters(**GOOD | {name: value})


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_a_colour_bias_that_is_not_finite_is_named(place: int, value: float) -> None:
    bias = tuple(value if i == place else 0.0 for i in range(4))
    with pytest.raises(ArgumentError, match=r"^colour_bias_dn must be finite"):
        NoiseParameters(**GOOD | {"colour_bias_dn": bias})


@pytest.mark.parametrize("count", [0, 1, 3, 5])
def test_a_colour_bias_of_other_than_four_values(count: int) -> None:
    with pytest.raises(ArgumentError, match=r"^colour_bias_dn has four values, for R, G1, B and G2"):
        NoiseParameters(**GOOD | {"colour_bias_dn": (0.0,) * count})


@pytest.mark.parametrize("value", [0.0, -0.0, -1e-300, -2.0])
def test_a_gain_that_is_not_above_0(value: float) -> None:
    with pytest.raises(ArgumentError, match=r"^gain_dn_per_e must be above 0; found"):
        NoiseParameters(**GOOD | {"gain_dn_per_e": value})


@pytest.mark.parametrize("name", ["sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn"])
def test_a_negative_sigma(name: str) -> None:
    with pytest.raises(ArgumentError, match=rf"^{name} must not be negative; found -1e-09"):
        NoiseParameters(**GOOD | {name: -1e-9})
    assert getattr(NoiseParameters(**GOOD | {name: 0.0}), name) == 0.0


@pytest.mark.parametrize("value", [-0.5, -0.6, -3.0, 2.0000001, 5.0])
def test_a_lambda_out_of_range(value: float) -> None:
    with pytest.raises(ArgumentError, match=r"^tukey_lambda must lie above -0\.5 and not above 2; found"):
        NoiseParameters(**GOOD | {"tukey_lambda": value})


@pytest.mark.parametrize("value", [math.nextafter(-0.5, 0), 0.0, 2.0])
def test_the_ends_of_the_range_of_lambda(value: float) -> None:
    assert NoiseParameters(**GOOD | {"tukey_lambda": value}).tukey_lambda == value


# --- the variance -------------------------------------------------------------------------------------------------

GRID = sorted(
    {
        *np.linspace(-0.49, 2.0, 250).tolist(),
        *(sign * 10.0**-exponent for exponent in (*range(1, 20), 50, 100, 150) for sign in (1, -1)),
        *(math.nextafter(sign * 0.125, towards) for sign in (1, -1) for towards in (-1, 1)),
        *(0.125, -0.125),
    }
)


def test_the_variance_is_scipys() -> None:
    # scipy's own Padé form near 0 is good to about 1e-13.
    ours = np.array([tukey_lambda_variance(shape) for shape in GRID])
    theirs = np.array([float(stats.tukeylambda.var(shape)) for shape in GRID])
    np.testing.assert_allclose(ours, theirs, rtol=1e-11)


@pytest.mark.parametrize("shape", [1e-160, -1e-160, 1e-170, -1e-170, 5e-324, -5e-324])
def test_the_variance_of_shapes_whose_square_is_0_or_nearly(shape: float) -> None:
    assert tukey_lambda_variance(shape) == pytest.approx(math.pi**2 / 3, rel=1e-11)


@pytest.mark.parametrize(
    ("shape", "variance"), [(0.0, math.pi**2 / 3), (0.5, 4 - math.pi), (1.0, 1 / 3), (2.0, 1 / 12)]
)
def test_the_variances_that_have_a_name(shape: float, variance: float) -> None:
    assert tukey_lambda_variance(shape) == pytest.approx(variance, rel=1e-14)


@pytest.mark.parametrize("shape", [-0.3, -0.1249, -0.01, 1e-6, 0.1142857, 0.1251, 0.7])
def test_the_variance_is_the_integral_of_the_squared_quantile(shape: float) -> None:
    def squared(t: float) -> float:  # u = exp(-t), where the tail is smooth
        u = math.exp(-t)
        quantile: float = (u**shape - (1 - u) ** shape) / shape
        return quantile * quantile * u

    half, _ = integrate.quad(squared, math.log(2), 200, epsabs=0, epsrel=1e-11, limit=200)
    assert tukey_lambda_variance(shape) == pytest.approx(2 * half, rel=1e-8)


def test_dn_are_rounded_as_files_hold_them() -> None:
    """To steps of 1, of 4, and of 5/4 that are then whole: codes 0, 1, 2, 3, 4 are 0, 1, 2, 4, 5 DN."""
    values = np.array([0.0, 0.4, 0.7, 1.8, 1.9, 2.6, 3.2, 5.9, 6.1])
    for step, expected in (
        (1.0, [0, 0, 1, 2, 2, 3, 3, 6, 6]),
        (4.0, [0, 0, 0, 0, 0, 4, 4, 4, 8]),
        (1.25, [0, 0, 1, 1, 2, 2, 4, 6, 6]),
    ):
        parameters = NoiseParameters(1.0, 0.0, 0.0, 0.0, 0.0, quantisation_step_dn=step)
        assert parameters.rounded(values).tolist() == expected


@pytest.mark.parametrize("switch", [-0.125, 0.0, 0.125])
def test_no_step_where_the_formula_changes(switch: float) -> None:
    below, here, above = (tukey_lambda_variance(switch + step) for step in (-1e-9, 0.0, 1e-9))
    assert below > here > above
    # The two sides' slopes agree: a step of 1e-13 would change them by 1e-4.
    assert (below - here) / (here - above) == pytest.approx(1, abs=1e-4)


def test_the_variance_falls_with_the_shape() -> None:
    values = [tukey_lambda_variance(shape) for shape in np.linspace(-0.499, 2, 500).tolist()]
    assert all(first > second for first, second in itertools.pairwise(values))
