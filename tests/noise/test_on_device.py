"""Both engines alike; and the one for other devices, on the CPU and, where there is one, on a GPU."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats

from eldata.errors import ArgumentError
from eldata.noise import Adc, NoiseDraw, NoiseModel, NoiseParameters
from eldata.noise.components import COMPONENTS
from eldata.noise.on_device import expose_on_device
from eldata.raw.levels import XTRANS_CFA, pack, unpack
from tests.cases import in_one_test
from tests.noise.helpers import (
    CUDA,
    ENGINES,
    LAMBDAS,
    LEAST_P_VALUE,
    PARAMETERS,
    RANGE_DN,
    RATIO,
    SIGNALS_E,
    Law,
    clean_of,
    compiled_dn,
    device_dn,
    plain_dn,
)
from tests.raw.helpers import BAYER, NONA, QUAD, XTRANS_COLOURS, Cfa

FULL = "P*+G*+B+R+U"


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not CUDA, reason="there is no GPU"))])
def device(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def dark(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.zeros(shape, dtype=np.float32)


# --- the converter, on both engines ----------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", [compiled_dn, device_dn])
def test_a_converter_of_another_step(draw: Callable[..., Any]) -> None:
    """Codes are multiples of 4 DN as of 12 bits in 14, or of 12.5 rounded to whole ones, and saturate as others do.

    A ramp goes through all codes; one of its values in a thousand lies so near to a middle that float32 decides.
    """
    black, white = 512.0, 16383.0
    ramp = np.linspace(0, 17000, 40_000).reshape(1, 4, 100, 100)
    clean = (ramp * (RATIO / RANGE_DN)).astype(np.float32)
    for step in (4.0, 12.5):
        parameters = NoiseParameters(1.0, 0.0, 0.0, 0.0, 0.0, quantisation_step_dn=step)
        codes = draw("R", clean, parameters, adc=Adc(black, white)) + black
        expected = np.minimum(np.round(step * np.round((ramp + black) / step)), white)
        differ = np.abs(codes - expected) > 0.01
        assert differ.mean() < 1e-3
        assert np.unique(np.rint(codes[~differ])).size == np.unique(expected).size
        if step == 4:
            assert {*np.unique(np.rint(codes) % 4)} == {0, white % 4}


# --- moments and distributions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", [*ENGINES, plain_dn])
@pytest.mark.parametrize(("spec", "step"), [("P", 1.0), ("G+P", 1.0), (FULL, 1.0), (FULL, 12.5)])
def test_means_and_variances(spec: str, step: float, draw: Callable[..., Any]) -> None:
    """Channel means and the variance at each signal.

    Each image has 4096 rows of 16 entries in each of four channels: 65536 pixels for a mean, 262144 pixels in 8192
    mosaic rows for the variance. 5 standard errors, 35 comparisons: false alarms below 1e-4 for all seven models.
    """
    parameters = replace(PARAMETERS, quantisation_step_dn=step)
    shape = (4, 4096, 16)
    pixels, rows = 4096 * 16, 4096
    dn = draw(spec, clean_of(SIGNALS_E, shape, parameters), parameters, seed=1)
    assert np.isfinite(dn).all()
    for signal_e, image in zip(SIGNALS_E, dn, strict=True):
        laws = [Law.of(spec, parameters, float(signal_e), bias) for bias in parameters.colour_bias_dn]
        for channel, law in zip(image, laws, strict=True):
            # The second term: float32 of the clean value, of the product and of the result.
            tolerance = 5 * law.mean_error(pixels, rows) + 3e-7 * abs(law.mean)
            assert abs(channel.mean() - law.mean) <= tolerance, (signal_e, channel.mean(), law)
        square = np.mean([np.mean((channel - law.mean) ** 2) for channel, law in zip(image, laws, strict=True)])
        law = laws[0]
        tolerance = 5 * law.variance_error(4 * pixels, 2 * rows) + 1e-9
        assert abs(square - law.variance - law.row_variance) < tolerance, (signal_e, square, law)


@pytest.mark.parametrize("draw", ENGINES)
@pytest.mark.parametrize("name", COMPONENTS)
def test_engines_draw_from_the_definition_of_each_component(name: str, draw: Callable[..., Any]) -> None:
    """Kolmogorov-Smirnov of two samples, of a pixel in each of 20000 mosaic rows, per channel at three signals.

    Poisson counts have ties, which make the test stricter than it says.
    """
    for signal_e in (0.0, 2.5, 400.0):
        clean = clean_of(np.array([signal_e]), (4, 20_000, 1), PARAMETERS)
        theirs, ours = plain_dn(name, clean, PARAMETERS, seed=5), draw(name, clean, PARAMETERS, seed=6)
        for of_definition, of_engine in zip(theirs[0, ..., 0], ours[0, ..., 0], strict=True):
            rounded = np.round(of_definition, 3), np.round(of_engine.astype(np.float64), 3)
            assert stats.ks_2samp(*rounded).pvalue > LEAST_P_VALUE, signal_e


def test_each_image_has_its_own_draw(device: str) -> None:
    """16384 pixels an image: the mean and the deviation of each within 5 standard errors."""
    draws = [
        NoiseDraw(NoiseParameters(gain, 0.1, 1.0, 3 * gain, 0.0, (gain, 2 * gain, 3 * gain, 4 * gain)), ratio, 1000.0)
        for gain, ratio in ((0.5, 50.0), (1.0, 100.0), (4.0, 200.0))
    ]
    clean = torch.full((3, 4, 128, 128), 0.25, device=device)
    result = expose_on_device(clean, draws, ("G", "B"), torch.Generator(device).manual_seed(0)).cpu().numpy()
    for image, draw in zip(result.astype(np.float64), draws, strict=True):
        dn, sigma = (image - 0.25) * 1000.0 / draw.ratio, draw.parameters.sigma_gauss_dn
        for channel, bias in zip(dn, draw.parameters.colour_bias_dn, strict=True):
            assert abs(channel.mean() - bias) < 5 * sigma / 128
            assert abs(channel.std() / sigma - 1) < 5 / math.sqrt(2 * 128 * 128)


@pytest.mark.parametrize("signal_e", [3.0, 25.0, 60.0])
def test_shot_noise_does_not_tell_of_read_noise(signal_e: float, device: str) -> None:
    """Variance of 50000 pixels, known to 0.7 %, within 5 errors: a correlation of -0.08, as torch's own, takes 6 %.

    So few pixels that on a GPU a thread draws all of one.
    """
    dn = device_dn("P*+G", clean_of(np.array([signal_e]), (4, 125, 100), PARAMETERS), PARAMETERS, device=device)
    law = Law.of("P*+G", PARAMETERS, signal_e)
    assert np.mean((dn - law.mean) ** 2) == pytest.approx(law.variance, abs=5 * law.variance_error(50_000, 500))


@pytest.mark.parametrize("draw", ENGINES)
@pytest.mark.parametrize("mean_e", [1e9, 9e18, 1e30])
def test_any_number_of_photoelectrons(mean_e: float, draw: Callable[..., Any]) -> None:
    """4096 draws: none is off by more than 7 deviations and four roundings to float32, and the spread by 5 errors."""
    parameters = NoiseParameters(1.0, 0.0, 0.0, 0.0, 0.0)
    drawn = draw("P*", clean_of(np.array([mean_e]), (4, 32, 32), parameters), parameters)
    off, rounding, deviation = drawn - mean_e, mean_e * 2.0**-22, math.sqrt(mean_e)
    assert np.abs(off).max() < 7 * deviation + rounding
    assert abs(off.mean()) < 6 * deviation / 64 + rounding
    if mean_e <= 1e12:  # where float32 resolves it
        assert abs(off.std() / deviation - 1) < 5 / math.sqrt(2 * 4096)


@pytest.mark.parametrize("shape", LAMBDAS)
def test_read_noise_is_tukey_lambda(shape: float, device: str) -> None:
    """100000 pixels, Kolmogorov-Smirnov against scipy."""
    parameters = NoiseParameters(1.0, shape, 1.7, 0.0, 0.0)
    dn = device_dn("G*", dark(1, 4, 125, 200), parameters, seed=3, device=device)
    assert stats.kstest(dn.ravel() / 1.7, stats.tukeylambda(shape).cdf).pvalue > LEAST_P_VALUE


# --- tails ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [-0.49, -0.1, 0.0, 0.1, 2.0])
def test_the_ends_of_the_uniform_numbers_give_finite_draws(shape: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lowest and the highest number that torch's float64 generator gives: 0 and 1 - 2^-53."""
    ends = torch.tensor([0.0, 2.0**-53, 0.5, 1 - 2.0**-52, 1 - 2.0**-53], dtype=torch.float64)

    def rand(size: Any, **options: Any) -> torch.Tensor:
        count = math.prod(size)
        return ends.repeat(-(-count // len(ends)))[:count].reshape(tuple(size))

    monkeypatch.setattr(torch, "rand", rand)
    dn = device_dn("G*", dark(1, 4, 5, 1), NoiseParameters(1.0, shape, 1.0, 0.0, 0.0))
    assert np.isfinite(dn).all()
    assert (np.diff(dn[0, 0, :, 0]) >= 0).all()


# --- colour bias and rows -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", ENGINES)
def test_each_channel_has_its_bias(draw: Callable[..., Any]) -> None:
    red, green, blue, other_green = PARAMETERS.colour_bias_dn
    colours = {"R": red, "G": (green + other_green) / 2, "B": blue}
    biases = [np.repeat([red, green, blue, other_green], count) for count in (1, 4, 9)]  # Bayer, quad, nona: a block's
    for expected in (*biases, np.array([colours[colour] for colour in XTRANS_COLOURS])):
        dn = draw("B", dark(2, len(expected), 3, 5), PARAMETERS)
        np.testing.assert_allclose(dn, np.broadcast_to(expected[:, None, None], dn.shape), rtol=1e-6)


SIZES = [(1, 1), (1, 2), (2, 1), (1, 7), (7, 1), (2, 2), (3, 5), (5, 3), (4, 6), (9, 9)]


@in_one_test("height, width", SIZES)
@pytest.mark.parametrize(
    "cfa", [BAYER["RGGB"], XTRANS_CFA, QUAD["quad-00"], NONA["nona-30"]], ids=["Bayer", "X-Trans", "quad", "nona"]
)
@pytest.mark.parametrize("draw", [*ENGINES, plain_dn])
def test_rows(cfa: Cfa, height: int, width: int, draw: Callable[..., Any]) -> None:
    """Entries have the same noise just if they come from the same mosaic row."""
    whole = pack(np.repeat(np.arange(60)[:, None], 60, axis=1), cfa)
    rows = whole[:, :height, :width].ravel()
    dn = draw("R", dark(2, len(whole), height, width), PARAMETERS)
    for image in dn.reshape(2, -1):
        np.testing.assert_array_equal(image[:, None] == image, rows[:, None] == rows)
    assert np.unique(dn).size == 2 * np.unique(rows).size


@pytest.mark.parametrize("draw", ENGINES)
@pytest.mark.parametrize(("cfa", "shape"), [(BAYER["RGGB"], (4, 3000, 530)), (XTRANS_CFA, (9, 2000, 518))])
def test_row_noise_is_normal_and_independent(cfa: Cfa, shape: tuple[int, ...], draw: Callable[..., Any]) -> None:
    """6000 mosaic rows, Kolmogorov-Smirnov and neighbours within 5 standard errors; whatever the columns."""
    mosaic = unpack(draw("R", dark(1, *shape), PARAMETERS, seed=7)[0], cfa)
    np.testing.assert_array_equal(mosaic, np.broadcast_to(mosaic[:, :1], mosaic.shape))
    draws = mosaic[:, 0]
    assert len(draws) == 6000
    assert np.unique(draws).size > 0.999 * 6000  # no draw is used twice (float32 may coincide)
    assert stats.kstest(draws / PARAMETERS.sigma_row_dn, "norm").pvalue > LEAST_P_VALUE
    for lag in (1, 2, 3, 6):
        assert abs(np.corrcoef(draws[:-lag], draws[lag:])[0, 1]) < 5 / math.sqrt(6000 - lag)


# --- the rest -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", [compiled_dn, device_dn])
@pytest.mark.parametrize(("spec", "adc"), [("P*", None), ("P", None), ("G", Adc(0.0, 99.0)), (FULL, None)])
def test_nan_stays_where_it_is(spec: str, adc: Adc | None, draw: Callable[..., Any]) -> None:
    """On the CPU alone: a failed assertion on a GPU would take the rest of the run with it."""
    clean = np.full((1, 4, 8, 8), 0.25, np.float32)
    clean[0, 1, 2, 3] = np.nan
    np.testing.assert_array_equal(np.isnan(draw(spec, clean, PARAMETERS, adc=adc)), np.isnan(clean))


@pytest.mark.parametrize("draw", ENGINES)
def test_values_below_0_count_as_no_light(draw: Callable[..., Any]) -> None:
    clean = np.linspace(-0.5, 0, 4 * 16 * 16, dtype=np.float32).reshape(1, 4, 16, 16)
    clean[0, 2, 0, 0] = -np.inf
    for spec in (FULL, "G+P"):
        np.testing.assert_array_equal(draw(spec, clean, PARAMETERS), draw(spec, np.zeros_like(clean), PARAMETERS))


# --- through the model ----------------------------------------------------------------------------------------------


@pytest.mark.skipif(not CUDA, reason="there is no GPU")
@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
@pytest.mark.parametrize("lead", [(), (2,), (2, 3)])
def test_the_model_on_a_gpu(lead: tuple[int, ...], dtype: torch.dtype) -> None:
    clean = torch.full((*lead, 4, 6, 8), 0.25, dtype=dtype, device="cuda")

    def draw(generator: Any) -> torch.Tensor:
        return NoiseModel()(clean, parameters=PARAMETERS, ratio=RATIO, range_dn=RANGE_DN, generator=generator)

    result = draw(torch.Generator("cuda").manual_seed(0))
    assert (result.shape, result.dtype, result.device) == (clean.shape, dtype, clean.device)
    assert torch.equal(result, draw(torch.Generator("cuda").manual_seed(0)))


def test_the_model_asks_for_a_generator_of_the_device() -> None:
    """The meta device stands for any other one."""
    clean = torch.zeros((4, 6, 8), device="meta")
    for generator in (torch.Generator(), np.random.default_rng(0)):
        with pytest.raises(ArgumentError, match=r"clean is on meta: give a torch\.Generator of that device"):
            NoiseModel()(clean, parameters=PARAMETERS, ratio=RATIO, range_dn=RANGE_DN, generator=generator)
