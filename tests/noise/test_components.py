"""Specs of the noise model: what they say, and what is refused."""

from __future__ import annotations

from itertools import permutations, product

import pytest

from eldata.errors import ArgumentError
from eldata.noise import PAPER_MODELS, NoiseModel, parse_components
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
    assert NoiseModel("+".join(names)).spec == "+".join(names)


def test_the_papers_caret() -> None:
    assert parse_components("P^* + G^* + B") == ("P*", "G*", "B")
    with pytest.raises(ArgumentError, match=r"P\* is in it twice"):
        parse_components("P*+P^*")


@in_one_test("spec", ["", "+", "P++G", "P+", "p", "P**", "P *", "P,G", "P*G*", "B R"])
def test_what_is_no_component_is_named(spec: str) -> None:
    with pytest.raises(ArgumentError, match=r"is not a component; known are P, P\*, G, G\*, B, R, U, D") as caught:
        parse_components(spec)
    assert repr(spec) in str(caught.value)


@in_one_test(
    "spec, words",
    [
        *((f"{name}+{name}", "is in it twice") for name in COMPONENTS),
        ("P*+R+P", r"P and P\* are two models of the same photon shot noise"),
        ("G+G*", r"G and G\* are two models of the same read noise"),
        *((f"P*+D+{name}", "the frames of D have their own") for name in COMPONENTS if name[0] != "P"),
        (5, "spec is a text such as"),
    ],
)
def test_components_that_exclude_each_other(spec: str, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        parse_components(spec)
