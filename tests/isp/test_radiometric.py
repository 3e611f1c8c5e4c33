"""Response curves recovered from simulated exposures and charts whose curve is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.errors import ArgumentError
from eldata.isp.radiometric import CurveModel, fit_to_exposures, fit_to_samples
from eldata.isp.response import ResponseCurve
from tests.isp.curves import GRID, family

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

RESPONSES = CurveModel.of_curves(family(), 5)
INVERSES = CurveModel.of_curves(family(), 5, inverse=True)
TIMES_S = (1 / 60, 1 / 30, 1 / 15, 1 / 8, 1 / 4)


def in_model(model: CurveModel, number: int) -> ResponseCurve:
    """The curve of the model next to one of the family: what a fit can recover exactly."""
    e, b = family()[number].irradiance[0], family()[number].brightness[0]
    values = np.interp(model.grid, b, e) if model.inverse else np.interp(model.grid, e, b)
    nearest = model.values(model.components @ (values - model.mean))
    return ResponseCurve(nearest, model.grid) if model.inverse else ResponseCurve(model.grid, nearest)


def exposures(
    curves: Sequence[ResponseCurve], dtype: Any = np.uint8, times_s: Sequence[float] = TIMES_S, noise: float = 0.0
) -> list[NDArray[Any]]:
    """A scene of nine stops, 50 x 50 flat patches of 8 x 8 pixels, photographed at several times; codes of the dtype.

    ``noise`` is a standard deviation in codes of 8 bits.
    """
    generator = np.random.default_rng(0)
    scene = np.exp2(generator.uniform(-9, 0, (len(curves), 50, 50)))
    full = np.iinfo(dtype).max
    images = []
    for time in times_s:
        light = np.clip(scene * time / times_s[len(times_s) // 2], 0, 1)
        brightness = np.array(
            [np.interp(e, c.irradiance[0], c.brightness[0]) for e, c in zip(light, curves, strict=True)]
        )
        pixels = brightness.repeat(8, axis=1).repeat(8, axis=2)
        codes = np.rint(full * (pixels + generator.normal(0, noise / 255, pixels.shape)))
        images.append(np.clip(codes, 0, full).astype(dtype))
    return images if len(curves) == 3 else [image[0] for image in images]


def largest_difference(found: ResponseCurve, wanted: ResponseCurve, channel: int = 0) -> float:
    """In brightness, over all irradiances."""
    values = [np.interp(GRID, c.irradiance[at], c.brightness[at]) for c, at in ((found, channel), (wanted, 0))]
    return float(np.abs(values[0] - values[1]).max())


# --- exposures ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "dtype"), [(0, np.uint8), (5, np.uint8), (15, np.uint8), (5, np.uint16)])
def test_a_curve_comes_back_from_exposures(number: int, dtype: Any) -> None:
    """To half a code: the largest error of one reading; the fit rests on some 20000 pairs of readings."""
    truth = in_model(INVERSES, number)
    fit = fit_to_exposures(INVERSES, exposures([truth], dtype), TIMES_S)
    full = np.iinfo(dtype).max
    assert largest_difference(fit.curve, truth) < 0.5 / full
    # What is left is the rounding of codes, uniform over one code: 1 / sqrt(12) of it.
    assert fit.rms_brightness[0] * full == pytest.approx(12**-0.5, rel=0.03)
    assert fit.samples[0] > 10_000


def test_the_order_and_unit_of_the_times_do_not_matter() -> None:
    images = exposures([in_model(INVERSES, 5)])
    fit = fit_to_exposures(INVERSES, images, TIMES_S)
    turned = fit_to_exposures(INVERSES, images[::-1], [1000 * time for time in TIMES_S[::-1]])
    assert largest_difference(turned.curve, fit.curve) < 1e-5


def test_noise_leaves_the_curve_where_it_is() -> None:
    """Two codes of noise a pixel are a quarter of a code in the mean of 64: less than rounding is without noise."""
    truth = in_model(INVERSES, 5)
    fit = fit_to_exposures(INVERSES, exposures([truth], noise=2.0), TIMES_S)
    assert largest_difference(fit.curve, truth) < 0.5 / 255
    assert fit.rms_brightness[0] * 255 == pytest.approx(2 / 8, rel=0.05)


def test_blocks_across_edges_are_left_out() -> None:
    """Four pixels off the patches, every block holds two or four of them; a response does not commute with a mean."""
    truth = in_model(INVERSES, 5)
    shifted = [image[4:, 4:] for image in exposures([truth])]
    with pytest.raises(ArgumentError, match=r"only \d\d pairs of flat blocks"):  # of some 22000
        fit_to_exposures(INVERSES, shifted, TIMES_S)
    aligned = fit_to_exposures(INVERSES, [image[8:, 8:] for image in exposures([truth])], TIMES_S)
    assert largest_difference(aligned.curve, truth) < 0.5 / 255


def test_wrong_times_show() -> None:
    truth = in_model(INVERSES, 5)
    fit = fit_to_exposures(INVERSES, exposures([truth]), [time**1.3 for time in TIMES_S])
    assert largest_difference(fit.curve, truth) > 5 / 255


@pytest.mark.parametrize(
    ("images", "times_s", "words"),
    [
        ([np.zeros((9, 9), np.uint8)], [1.0], "two or more images"),
        ([np.zeros((9, 9), np.uint8)] * 2, [1.0], "2 images and 1 times"),
        ([np.zeros((9, 9), np.uint8), np.zeros((9, 8), np.uint8)], [1.0, 2.0], "one size"),
        ([np.zeros((9, 9, 3), np.uint8)] * 2, [1.0, 2.0], r"\(3, H, W\)"),
        ([np.zeros((9, 9), np.float32)] * 2, [1.0, 2.0], "uint8 or of uint16"),
        ([np.zeros((9, 9), np.uint8), np.zeros((9, 9), np.uint16)], [1.0, 2.0], "uint8 or of uint16"),
        ([np.zeros((9, 9), np.uint8)] * 2, [1.0, 1.0], "all different"),
        ([np.zeros((9, 9), np.uint8)] * 2, [0.0, 1.0], "above 0 s"),
        ([np.zeros((99, 99), np.uint8)] * 2, [0.5, 1.0], "only 0 pairs of flat blocks are well exposed"),
        ([np.full((99, 99), 90, np.uint8), np.full((99, 99), 99, np.uint8)], [0.5, 1.0], "too much alike"),
    ],
)
def test_exposures_that_make_no_sense_are_refused(images: list[NDArray[Any]], times_s: list[float], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        fit_to_exposures(INVERSES, images, times_s)


@pytest.mark.parametrize("block", [0, 401])
def test_blocks_must_fit(block: int) -> None:
    with pytest.raises(ArgumentError, match="block must be from 1"):
        fit_to_exposures(INVERSES, exposures([in_model(INVERSES, 5)]), TIMES_S, block=block)


# --- readings of known irradiance ---------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [0, 5, 15])
def test_a_curve_comes_back_from_a_chart(number: int) -> None:
    truth = in_model(RESPONSES, number)
    irradiance = np.exp2(np.random.default_rng(number).uniform(-7, 0, 200))
    codes = np.rint(255 * np.interp(irradiance, truth.irradiance[0], truth.brightness[0]))
    fit = fit_to_samples(RESPONSES, irradiance, codes / 255)
    assert largest_difference(fit.curve, truth) < 0.5 / 255
    assert fit.rms_brightness[0] * 255 == pytest.approx(12**-0.5, rel=0.15)  # 200 readings: 5 % standard error
    assert fit.samples == (200,)


def test_a_chart_with_three_colours() -> None:
    irradiance = np.random.default_rng(0).uniform(0.01, 1, (3, 100))
    truths = [in_model(RESPONSES, number) for number in (2, 5, 10)]
    brightness = [np.interp(e, t.irradiance[0], t.brightness[0]) for e, t in zip(irradiance, truths, strict=True)]
    fit = fit_to_samples(RESPONSES, irradiance, np.array(brightness))
    for channel, truth in enumerate(truths):
        assert largest_difference(fit.curve, truth, channel) < 1e-9


def test_a_fit_that_would_fall_rises() -> None:
    """Readings of a curve that falls in the middle: the best curve of the model that does not."""
    irradiance = np.linspace(0.01, 0.99, 99)
    falling = irradiance + 0.9 * np.sin(2 * np.pi * irradiance) / (2 * np.pi) * 3
    assert (np.diff(falling) < 0).any()
    brightness = falling.clip(0, 1)
    mean, components = RESPONSES.at(irradiance)
    free = RESPONSES.values(np.linalg.lstsq(components, brightness - mean, rcond=None)[0].astype(np.float64))
    assert np.diff(free).min() < -1e-5  # without the condition it would fall

    fit = fit_to_samples(RESPONSES, irradiance, brightness)
    assert np.diff(fit.curve.brightness[0]).min() >= 0
    # No rising curve nearby fits better: steps from the solution that keep it rising raise the error.
    generator = np.random.default_rng(0)
    tried = 0
    for step in generator.normal(0, 0.02, (4000, 5)):
        weights = fit.weights[0] + step
        if np.diff(RESPONSES.values(weights)).min() >= 0:
            tried += 1
            assert np.sqrt(np.mean((mean + components @ weights - brightness) ** 2)) >= fit.rms_brightness[0] - 1e-9
    assert tried > 20


@pytest.mark.parametrize(
    ("irradiance", "brightness", "words"),
    [
        ([0.1, 0.2], [0.1, 0.2], "2 readings are too few for 5 components"),
        ([0.5] * 9, [0.7] * 9, "too much alike"),
        ([0.1, 1.2], [0.1, 0.2], r"irradiance must lie in \[0, 1\]"),
        ([0.1, 0.2], [np.nan, 0.2], r"brightness must lie in \[0, 1\]"),
        ([0.1, 0.2], [0.1], "of one shape"),
    ],
)
def test_readings_that_make_no_sense_are_refused(irradiance: list[float], brightness: list[float], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        fit_to_samples(RESPONSES, np.array(irradiance), np.array(brightness))


# --- the model ----------------------------------------------------------------------------------------------------


def test_the_models_components_are_those_of_scipys_svd() -> None:
    values = np.array([curve.brightness[0] for curve in family()])
    np.testing.assert_allclose(RESPONSES.mean, values.mean(axis=0), atol=1e-12)
    covariance = np.cov(values.T)
    for component in RESPONSES.components:
        assert np.linalg.norm(component) == pytest.approx(1)
        along = component @ covariance @ component
        np.testing.assert_allclose(covariance @ component, along * component, atol=1e-9)  # an eigenvector


def test_models_are_not_mixed_up() -> None:
    with pytest.raises(ArgumentError, match=r"models inverse responses.*emor\.txt"):
        fit_to_samples(INVERSES, np.array([0.5]), np.array([0.5]))
    with pytest.raises(ArgumentError, match=r"models responses.*invemor\.txt"):
        fit_to_exposures(RESPONSES, [], [])


def test_models_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ArgumentError, match="need more than 16 curves; found 16"):
        CurveModel.of_curves(family(), 16)
    with pytest.raises(ArgumentError, match="has 5 components; asked for 6"):
        RESPONSES.first(6)
    one = np.ones((1, 1024))
    for grid, mean, components, words in (
        (GRID[:9], GRID, 0 * one, "expected a grid"),
        (GRID, GRID * np.nan, 0 * one, "NaN"),
        (GRID, GRID[::-1], 0 * one, "mean curve must rise"),
        (GRID, GRID, one, "0 at both ends"),
    ):
        with pytest.raises(ArgumentError, match=words):
            CurveModel(grid, mean, components, inverse=False)
