"""Specs of the noise model: what they say, and what is refused."""

from __future__ import annotations

from itertools import combinations, permutations, product

import pytest

from eldata.errors import ArgumentError
from eldata.noise import PAPER_MODELS, Components, parse_components
from tests.cases import in_one_test

# The rows of the paper's ablation table: shot, read, colour bias, row, quantisation.
TABLE = {
    "G": Components("none", "gaussian", colour_bias=False, row=False, quantisation=False),
    "G+P": Components("gaussian", "gaussian", colour_bias=False, row=False, quantisation=False),
    "G+P*": Components("poisson", "gaussian", colour_bias=False, row=False, quantisation=False),
    "G*+P*": Components("poisson", "tukey-lambda", colour_bias=False, row=False, quantisation=False),
    "G*+P*+B": Components("poisson", "tukey-lambda", colour_bias=True, row=False, quantisation=False),
    "G*+P*+B+R": Components("poisson", "tukey-lambda", colour_bias=True, row=True, quantisation=False),
    "G*+P*+B+R+U": Components("poisson", "tukey-lambda", colour_bias=True, row=True, quantisation=True),
}


def every_model() -> list[tuple[str, ...]]:
    choices = product(("", "P", "P*"), ("", "G", "G*"), ("", "B"), ("", "R"), ("", "U"))
    return [names for choice in choices if (names := tuple(name for name in choice if name))]


def test_the_papers_rows() -> None:
    assert tuple(TABLE) == PAPER_MODELS
    assert {spec: parse_components(spec) for spec in PAPER_MODELS} == TABLE


@in_one_test("names", every_model())
def test_any_order_and_any_spacing(names: tuple[str, ...]) -> None:
    wanted = Components(
        shot="poisson" if "P*" in names else "gaussian" if "P" in names else "none",
        read="tukey-lambda" if "G*" in names else "gaussian" if "G" in names else "none",
        colour_bias="B" in names,
        row="R" in names,
        quantisation="U" in names,
    )
    for order in permutations(names):
        for joint in ("+", " + ", "+ ", "\t+  "):
            assert parse_components(joint.join(order)) == wanted
        assert parse_components(f"  {'+'.join(order)} ") == wanted


@in_one_test("names", every_model())
def test_the_spec_of_the_components_gives_them_back(names: tuple[str, ...]) -> None:
    components = parse_components("+".join(names))
    assert set(components.spec.split("+")) == set(names)
    assert parse_components(components.spec) == components


def test_the_papers_caret() -> None:
    assert parse_components("P^*+G^*") == parse_components("P*+G*")
    assert parse_components("P^* + G^* + B + R + U") == TABLE["G*+P*+B+R+U"]
    assert parse_components("P^*+G^*").spec == "P*+G*"


@in_one_test("spec", ["", " ", "+", "P++G", "+P", "P+", "p", "Q", "P**", "P *", "Poisson", "P,G", "P*G*", "B R"])
def test_what_is_no_component_is_named(spec: str) -> None:
    with pytest.raises(ArgumentError, match=r"is not a component; known are P, P\*, G, G\*, B, R, U") as caught:
        parse_components(spec)
    assert repr(spec) in str(caught.value)


@in_one_test("name", ["P", "P*", "G", "G*", "B", "R", "U"])
def test_a_name_that_stands_twice(name: str) -> None:
    other = "R" if name != "R" else "B"
    with pytest.raises(ArgumentError) as caught:
        parse_components(f"{name}+{other}+{name}")
    assert f"{name} is in it twice" in str(caught.value)


def test_both_spellings_of_one_name_are_the_same_name() -> None:
    with pytest.raises(ArgumentError, match=r"P\* is in it twice"):
        parse_components("P*+P^*")


@pytest.mark.parametrize(("first", "second", "source"), [("P", "P*", "photon shot noise"), ("G", "G*", "read noise")])
def test_two_models_of_one_source(first: str, second: str, source: str) -> None:
    for extra in (subset for size in range(4) for subset in combinations(("B", "R", "U"), size)):
        for order in permutations((first, second, *extra)):
            with pytest.raises(ArgumentError) as caught:
                parse_components("+".join(order))
            assert f"{first} and {second} are two models of the same {source}" in str(caught.value)
