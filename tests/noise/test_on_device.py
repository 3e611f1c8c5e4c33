"""Both engines alike; and the one for other devices, on the CPU and, where there is one, on a GPU."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from scipy import stats

from eldata.errors import ArgumentError
from eldata.noise import PAPER_MODELS, NoiseModel, NoiseParameters
from eldata.noise.exposures import Adc, Exposures
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
    Law,
    check_closed_forms,
    clean_of,
    compiled_dn,
    device_dn,
    on_device,
    poisson_p_value,
)
from tests.raw.helpers import BAYER, NONA, QUAD, XTRANS_COLOURS, Cfa

if TYPE_CHECKING:
    from collections.abc import Callable

FULL = "P*+G*+B+R+U"


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not CUDA, reason="there is no GPU"))])
def device(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def dark(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.zeros(shape, dtype=np.float32)


# --- the quantisation step, on both engines -------------------------------------------------------------------------

STEPS = [0.25, 4.0, 12.5]


@pytest.mark.parametrize("draw", ENGINES)
@pytest.mark.parametrize("step", STEPS)
def test_quantisation_of_another_step(step: float, draw: Callable[..., Any]) -> None:
    """U alone: 100000 pixels, Kolmogorov-Smirnov; the whole model: see check_closed_forms; and as the model says."""
    parameters = replace(PARAMETERS, quantisation_step_dn=step)
    values = draw("U", dark(1, 4, 250, 100), parameters, seed=3).ravel()
    assert stats.kstest(values, "uniform", (-step / 2, step)).pvalue > LEAST_P_VALUE
    check_closed_forms(draw, FULL, parameters, seed=4)
    model, law = NoiseModel(FULL), Law.of(FULL, parameters, 25.0)
    assert model.expected_variance_dn2(25.0, parameters) == pytest.approx(law.variance + law.row_variance)


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


@pytest.mark.parametrize("draw", [compiled_dn, device_dn])
def test_a_converter_ends_at_its_levels(draw: Callable[..., Any]) -> None:
    parameters = NoiseParameters(1.0, 0.0, 20.0, 0.0, 5.0)
    dn = draw("P*+G*+R", clean_of(np.array([0.0, 10.0, 70.0]), (4, 64, 64), parameters), parameters, adc=Adc(20, 100))
    codes = np.rint(dn + 20.0)
    np.testing.assert_allclose(dn + 20.0, codes, atol=1e-4)
    assert np.unique(codes).tolist() == list(range(101))


@pytest.mark.parametrize("draw", [compiled_dn, device_dn])
@pytest.mark.parametrize("adc", [None, Adc(512.0, 16383.0)])
def test_a_step_of_1_is_what_no_step_is(draw: Callable[..., Any], adc: Adc | None) -> None:
    """To the bit; and images of one batch have each their own step."""
    spec, clean = "P*+G*+B+R" + ("+U" if adc is None else ""), clean_of(np.array([3.0, 130.0]), (4, 16, 40), PARAMETERS)
    one = draw(spec, clean, PARAMETERS, seed=5, adc=adc)
    assert np.array_equal(one, draw(spec, clean, replace(PARAMETERS, quantisation_step_dn=1), seed=5, adc=adc))
    other = draw(spec, clean, replace(PARAMETERS, quantisation_step_dn=8.0), seed=5, adc=adc)
    if draw is compiled_dn:
        mixed = [PARAMETERS, replace(PARAMETERS, quantisation_step_dn=8.0)]
        both = draw(spec, clean, mixed, seed=5, adc=adc)
        assert np.array_equal(both, np.stack([one[0], other[1]]))
    assert not np.array_equal(one, other)


# --- moments and distributions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", ENGINES)
@pytest.mark.parametrize("spec", ["P", "G+P", FULL])
def test_means_and_variances(spec: str, draw: Callable[..., Any]) -> None:
    """See check_closed_forms for sizes and tolerances."""
    check_closed_forms(draw, spec, seed=1)


@pytest.mark.parametrize("signal_e", [0.02, 3.0, 130.0, 2000.0])
def test_shot_noise_is_poisson(signal_e: float, device: str) -> None:
    """262144 pixels, chi-square."""
    clean = clean_of(np.array([signal_e]), (4, 256, 256), PARAMETERS)
    dn = device_dn("P*", clean, PARAMETERS, seed=2, device=device)
    assert poisson_p_value(dn / PARAMETERS.gain_dn_per_e, signal_e) > LEAST_P_VALUE


@pytest.mark.parametrize("signal_e", [3.0, 25.0, 60.0])
def test_shot_noise_does_not_tell_of_read_noise(signal_e: float, device: str) -> None:
    """Variance of 50000 pixels, known to 0.7 %, within 5 errors: a correlation of -0.08, as torch's own, takes 6 %.

    So few pixels that on a GPU a thread draws all of one.
    """
    dn = device_dn("P*+G", clean_of(np.array([signal_e]), (4, 125, 100), PARAMETERS), PARAMETERS, device=device)
    law = Law.of("P*+G", PARAMETERS, signal_e)
    assert np.mean((dn - law.mean) ** 2) == pytest.approx(law.variance, abs=5 * law.variance_error(50_000, 500))


@pytest.mark.parametrize("draw", ENGINES)
@pytest.mark.parametrize("mean_e", [1e9, 1e12, 9e18, 1e19, 1e30])
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


def test_a_set_of_parameters_and_a_ratio_for_each_image(device: str) -> None:
    """16384 pixels an image: the mean and the deviation of each within 5 standard errors."""
    draws = [NoiseParameters(g, 0.1, 1.0, 3 * g, 0.0, (g, 2 * g, 3 * g, 4 * g)) for g in (0.5, 1.0, 4.0)]
    model, ratios = NoiseModel("G+B"), [50.0, 100.0, 200.0]
    exposures = Exposures.of(model.components, draws, ratios, 4, range_dn=1000.0)
    clean = torch.full((3, 4, 128, 128), 0.25, device=device)
    generator = torch.Generator(device).manual_seed(0)
    result = expose_on_device(clean, exposures, generator).cpu().numpy()
    for image, draw, ratio in zip(result.astype(np.float64), draws, ratios, strict=True):
        dn = image * 1000.0 / ratio - 250.0 / ratio
        sigma = draw.sigma_gauss_dn
        for channel, bias in zip(dn, draw.colour_bias_dn, strict=True):
            assert abs(channel.mean() - bias) < 5 * sigma / 128
            assert abs(channel.std() / sigma - 1) < 5 / math.sqrt(2 * 128 * 128)


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
@pytest.mark.parametrize("draw", ENGINES)
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


def test_the_same_state_gives_the_same_bits_and_the_generator_moves_on(device: str) -> None:
    clean = torch.full((2, 4, 16, 16), 0.25, device=device)
    first_generator, second_generator = (torch.Generator(device).manual_seed(9) for _ in range(2))
    for spec in (*PAPER_MODELS, "P"):
        first = on_device(spec, clean, PARAMETERS, first_generator)
        assert torch.equal(first, on_device(spec, clean, PARAMETERS, second_generator))
        assert not torch.equal(first, on_device(spec, clean, PARAMETERS, first_generator))
        second_generator.set_state(first_generator.get_state())
        assert first.shape == clean.shape
        assert first.dtype == torch.float32
        assert first.device == clean.device


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-math.inf, 1.0)])
def test_limits(low: float, high: float, device: str) -> None:
    clean = torch.linspace(0, 1.2, 4 * 64 * 64, device=device).reshape(1, 4, 64, 64)

    def draw(limits: tuple[float, float]) -> torch.Tensor:
        return on_device(FULL, clean, PARAMETERS, torch.Generator(device).manual_seed(0), limits=limits)

    free = draw((-math.inf, math.inf))
    assert free.min() < 0
    assert free.max() > 1
    assert torch.equal(draw((low, high)), free.clamp(low, high))


@pytest.mark.parametrize("draw", ENGINES)
def test_values_below_0_count_as_no_light(draw: Callable[..., Any]) -> None:
    clean = np.linspace(-0.5, 0, 4 * 16 * 16, dtype=np.float32).reshape(1, 4, 16, 16)
    clean[0, 2, 0, 0] = -np.inf
    for spec in (*PAPER_MODELS, "P", "B"):
        np.testing.assert_array_equal(draw(spec, clean, PARAMETERS), draw(spec, np.zeros_like(clean), PARAMETERS))


@pytest.mark.parametrize("draw", [compiled_dn, device_dn])
@pytest.mark.parametrize(("spec", "adc"), [("P*", None), ("P", None), ("G", Adc(0.0, 99.0)), (FULL, None)])
def test_nan_stays_where_it_is(spec: str, adc: Adc | None, draw: Callable[..., Any]) -> None:
    """On the CPU alone: a failed assertion on a GPU would take the rest of the run with it."""
    clean = np.full((1, 4, 8, 8), 0.25, np.float32)
    clean[0, 1, 2, 3] = np.nan
    np.testing.assert_array_equal(np.isnan(draw(spec, clean, PARAMETERS, adc=adc)), np.isnan(clean))


@pytest.mark.parametrize("shape", [(0, 4, 6, 6), (1, 4, 0, 6), (1, 4, 6, 0), (2, 9, 0, 0)])
def test_nothing_at_all(shape: tuple[int, ...], device: str) -> None:
    assert device_dn(FULL, dark(*shape), PARAMETERS, device=device).shape == shape


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
    for generator in (torch.Generator(), np.random.default_rng(0), None):
        with pytest.raises(ArgumentError, match=r"clean is on cuda:0: give a torch\.Generator of that device"):
            draw(generator)


def test_the_model_asks_for_a_generator_of_the_device() -> None:
    """The meta device stands for any other one."""
    clean = torch.zeros((4, 6, 8), device="meta")
    for generator in (torch.Generator(), np.random.default_rng(0)):
        with pytest.raises(ArgumentError, match=r"clean is on meta: give a torch\.Generator of that device"):
            NoiseModel()(clean, parameters=PARAMETERS, ratio=RATIO, range_dn=RANGE_DN, generator=generator)
