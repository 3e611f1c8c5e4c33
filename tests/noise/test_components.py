"""Specs and parameters of the noise model: what they say, and what is refused."""

from __future__ import annotations

import math
import re
from itertools import permutations, product
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats

from eldata.errors import ArgumentError
from eldata.noise import PAPER_MODELS, Adc, NoiseModel, NoiseParameters, parse_components, tukey_lambda_variance
from eldata.noise.components import COMPONENTS
from tests.cases import in_one_test

CHOICES = product(("", "P", "P*"), ("", "G", "G*"), ("", "B"), ("", "R"), ("", "U"))
MODELS = [names for choice in CHOICES if (names := tuple(name for name in choice if name))]


def test_the_papers_rows() -> None:
    """Each has one component more than the one before, or a better one."""
    assert PAPER_MODELS == ("G", "G+P", "G+P*", "G*+P*", "G*+P*+B", "G*+P*+B+R", "G*+P*+B+R+U")
    assert {name for spec in PAPER_MODELS for name in parse_components(spec)} == {*COMPONENTS}


@in_one_test("names", MODELS)
def test_any_order_and_any_spacing(names: tuple[str, ...]) -> None:
    """The names in the order of the table; and a model's spec gives them back."""
    for order in permutations(names):
        for joint in ("+", "\t+  "):
            assert parse_components(f" {joint.join(order)}") == names
            assert parse_components(joint.join(order).replace("*", "^*")) == names, "the paper's caret"
    assert NoiseModel("+".join(names)).spec == "+".join(names)


@in_one_test(
    "spec, words",
    [
        *(
            (spec, rf"{re.escape(repr(spec))}.* is not a component; known are P, P\*, G, G\*, B, R, U, D")
            for spec in ("", "+", "P++G", "P+", "p", "P**", "P *", "P,G", "P*G*", "B R")
        ),
        *((f"{name}+{name}", "is in it twice") for name in COMPONENTS),
        ("P*+P^*", r"P\* is in it twice"),
        ("P*+R+P", r"P and P\* are two models of the same photon shot noise"),
        ("G+G*", r"G and G\* are two models of the same read noise"),
        *((f"P*+D+{name}", "the frames of D have their own") for name in COMPONENTS if name[0] != "P"),
        (5, "spec is a text such as"),
    ],
)
def test_what_is_no_spec(spec: str, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        parse_components(spec)


# --- parameters ------------------------------------------------------------------------------------------------------

GOOD: dict[str, Any] = {
    "gain_dn_per_e": 1.5,
    "tukey_lambda": 0.1,
    "sigma_tl_dn": 1.0,
    "sigma_gauss_dn": 2.0,
    "sigma_row_dn": 0.5,
    "colour_bias_dn": (1.0, -2.0, 3.0, -4.0),
}
NUMBERS = [name for name in GOOD if name != "colour_bias_dn"]


@pytest.mark.parametrize("make", [list, np.array, torch.tensor, tuple])
def test_a_colour_bias_of_any_kind_is_kept_as_a_tuple(make: Any) -> None:
    bias = make(GOOD["colour_bias_dn"])
    parameters = NoiseParameters(**GOOD | {"colour_bias_dn": bias})
    assert parameters == NoiseParameters(**GOOD)
    assert type(parameters.colour_bias_dn) is tuple
    assert hash(parameters) == hash(NoiseParameters(**GOOD))


OUT_OF_RANGE: list[tuple[str, Any, str]] = [
    *((name, value, "must be one number, finite") for name in NUMBERS for value in ("1.5", None)),
    *((name, value, "must be finite") for name in NUMBERS for value in (math.nan, -math.inf)),
    ("colour_bias_dn", (0.0, 0.0, 0.0, math.inf), "must be finite"),
    *(("colour_bias_dn", value, "has four values") for value in (1.0, None, (), (0.0,) * 3, (0.0,) * 5)),
    *(("colour_bias_dn", value, "") for value in ("0000", ("a", 0.0, 0.0, 0.0), [[0.0] * 4])),
    *(("gain_dn_per_e", value, "must be .* above 0") for value in (0.0, -1e-300)),
    *(("tukey_lambda", value, "must lie above") for value in (-0.5, 2.0000001)),
    *((name, -1e-9, "must not be negative") for name in ("sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")),
    *(("quantisation_step_dn", value, "") for value in (0.0, -1.0, math.nan, math.inf)),
]


@in_one_test("name, value, words", OUT_OF_RANGE)
def test_what_is_refused_is_named(name: str, value: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=rf"^{name} .*{words}"):
        NoiseParameters(**GOOD | {name: value})


def test_a_converter_of_no_range() -> None:
    with pytest.raises(ArgumentError, match="expected 0 <= black level < white level"):
        Adc(512.0, 512.0)


# --- the variance -------------------------------------------------------------------------------------------------

GRID = sorted(
    {
        *np.linspace(-0.49, 2.0, 250).tolist(),
        *(sign * 10.0**-exponent for exponent in (*range(1, 20), 50, 100, 150) for sign in (1, -1)),
        *(1e-160, -1e-170, 5e-324),
        *(math.nextafter(sign * 0.125, towards) for sign in (1, -1) for towards in (-1, 1)),
        *(0.125, -0.125),
    }
)


def test_the_variance_is_scipys() -> None:
    # scipy's own Padé form near 0 is good to about 1e-13.
    ours = np.array([tukey_lambda_variance(shape) for shape in GRID])
    theirs = np.array([float(stats.tukeylambda.var(shape)) for shape in GRID])
    np.testing.assert_allclose(ours, theirs, rtol=1e-11)


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
