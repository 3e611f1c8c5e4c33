"""The noise model on the CPU: closed forms, distributions, structure, and what its arguments do."""

from __future__ import annotations

import itertools
import math
import pickle
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from scipy import stats

from eldata.errors import ArgumentError
from eldata.noise import PAPER_MODELS, NoiseModel, NoiseParameters
from eldata.noise.exposures import Adc
from eldata.raw.cfa import XTRANS_CFA, unpack
from tests.cases import in_one_test
from tests.noise.helpers import (
    LAMBDAS,
    LEAST_P_VALUE,
    PARAMETERS,
    RANGE_DN,
    RATIO,
    SIGNALS_E,
    Law,
    check_closed_forms,
    clean_of,
    compiled_dn,
    poisson_p_value,
)
from tests.raw.helpers import XTRANS_COLOURS

if TYPE_CHECKING:
    from numpy.typing import NDArray

FULL = "P*+G*+B+R+U"
FLAT = np.full((4, 6, 8), 0.25, dtype=np.float32)


def noisy(clean: Any, spec: str = FULL, *, seed: int = 0, model: NoiseModel | None = None, **options: Any) -> Any:
    arguments: dict[str, Any] = {
        "parameters": PARAMETERS,
        "ratio": RATIO,
        "range_dn": RANGE_DN,
        "generator": np.random.default_rng(seed),
    }
    return (model or NoiseModel(spec))(clean, **arguments | options)


def same_bits(first: NDArray[np.float32], second: NDArray[np.float32]) -> None:
    assert first.dtype == second.dtype == np.float32
    np.testing.assert_array_equal(first.view(np.uint32), second.view(np.uint32))


# --- moments and distributions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [*PAPER_MODELS, "P", "P*", "R+U", "G*+R"])
def test_means_and_variances(spec: str) -> None:
    """See check_closed_forms for sizes and tolerances."""
    check_closed_forms(compiled_dn, spec, seed=1)


@pytest.mark.parametrize("spec", [*PAPER_MODELS, "P", "R", "U", "B"])
def test_the_closed_forms_that_the_model_states(spec: str) -> None:
    model = NoiseModel(spec)
    for signal_e, channel in itertools.product(SIGNALS_E.tolist(), range(4)):
        law = Law.of(spec, PARAMETERS, signal_e, PARAMETERS.colour_bias_dn[channel])
        assert model.expected_mean_dn(signal_e, PARAMETERS, channel) == pytest.approx(law.mean, rel=1e-12)
        variance = law.variance + law.row_variance
        assert model.expected_variance_dn2(signal_e, PARAMETERS) == pytest.approx(variance, rel=1e-11)


@pytest.mark.parametrize("signal_e", [0.02, 0.7, 3.0, 25.3, 130.0, 500.0, 2000.0])
def test_shot_noise_is_poisson(signal_e: float) -> None:
    """262144 pixels, chi-square; every value is a whole number of gains."""
    dn = compiled_dn("P*", clean_of(np.array([signal_e]), (4, 256, 256), PARAMETERS), PARAMETERS, seed=2)
    assert poisson_p_value(dn / PARAMETERS.gain_dn_per_e, signal_e) > LEAST_P_VALUE


def test_no_light_has_no_shot_noise() -> None:
    for spec in ("P", "P*"):
        assert not compiled_dn(spec, np.zeros((1, 4, 64, 64), np.float32), PARAMETERS).any()


@pytest.mark.parametrize("signal_e", [0.7, 25.0, 500.0])
def test_gaussian_shot_noise_is_normal(signal_e: float) -> None:
    """100000 pixels, Kolmogorov-Smirnov."""
    dn = compiled_dn("P", clean_of(np.array([signal_e]), (4, 125, 200), PARAMETERS), PARAMETERS, seed=3)
    gain = PARAMETERS.gain_dn_per_e
    off = (dn - gain * signal_e) / (gain * math.sqrt(signal_e))
    assert stats.kstest(off.ravel(), "norm").pvalue > LEAST_P_VALUE


def test_gaussian_read_noise_is_normal() -> None:
    """100000 pixels, Kolmogorov-Smirnov."""
    dn = compiled_dn("G", np.zeros((1, 4, 125, 200), np.float32), PARAMETERS, seed=4)
    assert stats.kstest(dn.ravel() / PARAMETERS.sigma_gauss_dn, "norm").pvalue > LEAST_P_VALUE


@pytest.mark.parametrize("shape", LAMBDAS)
def test_read_noise_is_tukey_lambda(shape: float) -> None:
    """100000 pixels around a signal of 2 DN, Kolmogorov-Smirnov against scipy."""
    parameters = NoiseParameters(1.0, shape, 1.7, 0.0, 0.0)
    dn = compiled_dn("G*", clean_of(np.array([2.0]), (4, 125, 200), parameters), parameters, seed=5)
    off = (dn.ravel() - 2.0) / parameters.sigma_tl_dn
    assert np.isfinite(off).all()
    assert stats.kstest(off, stats.tukeylambda(shape).cdf).pvalue > LEAST_P_VALUE
    # The tails one by one: each of 25 draws in expectation, 5 standard deviations.
    for tail in ((off > stats.tukeylambda.isf(2.5e-4, shape)), (off < stats.tukeylambda.ppf(2.5e-4, shape))):
        assert abs(tail.sum() - 25) < 25


def test_quantisation_noise_is_uniform_over_one_dn() -> None:
    """100000 pixels, Kolmogorov-Smirnov."""
    dn = compiled_dn("U", np.zeros((1, 4, 125, 200), np.float32), PARAMETERS, seed=6)
    assert np.abs(dn).max() <= 0.5 + 1e-6
    assert stats.kstest(dn.ravel() + 0.5, "uniform").pvalue > LEAST_P_VALUE


def test_pixels_are_independent() -> None:
    """Neighbours along both axes, channels and frames: 65536 pairs each, correlations within 5 standard errors."""
    dn = compiled_dn("P*+G*+U", clean_of(np.array([3.0, 3.0]), (4, 257, 257), PARAMETERS), PARAMETERS, seed=7)
    pairs = [
        (dn[0, 0, :-1, :-1], dn[0, 0, 1:, :-1]),
        (dn[0, 0, :-1, :-1], dn[0, 0, :-1, 1:]),
        (dn[1, 0, :-1, :-1], dn[0, 0, :-1, :-1]),
        *((dn[0, a, :-1, :-1], dn[0, b, :-1, :-1]) for a, b in itertools.combinations(range(4), 2)),
    ]
    for first, second in pairs:
        assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 5 / 256


# --- colour bias and rows -------------------------------------------------------------------------------------------


def test_each_bayer_channel_has_its_own_bias() -> None:
    dn = compiled_dn("B", np.zeros((2, 4, 8, 8), np.float32), PARAMETERS)
    for channel, bias in enumerate(PARAMETERS.colour_bias_dn):
        np.testing.assert_allclose(dn[:, channel], bias, rtol=1e-6)


def test_each_xtrans_channel_has_the_bias_of_its_colour() -> None:
    dn = compiled_dn("B", np.zeros((1, 9, 8, 8), np.float32), PARAMETERS)
    red, green, blue, other_green = PARAMETERS.colour_bias_dn
    bias = {"R": red, "G": (green + other_green) / 2, "B": blue}
    for channel, colour in enumerate(XTRANS_COLOURS):
        np.testing.assert_allclose(dn[0, channel], bias[colour], rtol=1e-6)


def test_bayer_rows() -> None:
    """R and G1 share their mosaic row's draw, B and G2 the other's: 2 x 5000 rows, normal and independent."""
    dn = compiled_dn("R", np.zeros((2, 4, 2500, 5), np.float32), PARAMETERS, seed=8)
    np.testing.assert_array_equal(dn, np.repeat(dn[..., :1], 5, axis=-1))
    np.testing.assert_array_equal(dn[:, 0], dn[:, 1])
    np.testing.assert_array_equal(dn[:, 2], dn[:, 3])
    draws = dn[:, [0, 2], :, 0] / PARAMETERS.sigma_row_dn  # frame, red or blue row, packed row
    assert np.unique(draws).size > 0.999 * draws.size
    assert stats.kstest(draws.ravel(), "norm").pvalue > LEAST_P_VALUE
    correlation = np.asarray(np.corrcoef(draws.reshape(4, -1)))
    assert np.abs(correlation[np.triu_indices(4, 1)]).max() < 5 / math.sqrt(2500)
    in_order = draws[0].T.ravel()
    assert abs(np.corrcoef(in_order[:-1], in_order[1:])[0, 1]) < 5 / math.sqrt(5000)


def test_xtrans_rows() -> None:
    """Unpacked, each of 6000 mosaic rows is one draw: normal and independent."""
    dn = compiled_dn("R", np.zeros((1, 9, 2000, 4), np.float32), PARAMETERS, seed=9)
    mosaic = unpack(dn[0], XTRANS_CFA)
    assert mosaic.shape == (6000, 12)
    np.testing.assert_array_equal(mosaic, np.repeat(mosaic[:, :1], 12, axis=1))
    draws = mosaic[:, 0] / PARAMETERS.sigma_row_dn
    assert np.unique(draws).size > 0.999 * draws.size
    assert stats.kstest(draws, "norm").pvalue > LEAST_P_VALUE
    for step in (1, 2, 3, 6):
        assert abs(np.corrcoef(draws[:-step], draws[step:])[0, 1]) < 5 / math.sqrt(6000 - step)


# --- the converter --------------------------------------------------------------------------------------------------


def test_a_converter_gives_whole_numbers_within_its_range() -> None:
    adc = Adc(black_level_dn=20.0, white_level_dn=100.0)
    parameters = NoiseParameters(1.0, 0.0, 20.0, 0.0, 5.0)
    signals = np.array([0.0, 10.0, 70.0])
    dn = compiled_dn("P*+G*+R", clean_of(signals, (4, 64, 64), parameters), parameters, adc=adc)
    codes = np.rint(dn + 20.0)
    np.testing.assert_allclose(dn + 20.0, codes, atol=1e-4)
    assert codes.min() == 0
    assert codes.max() == 100
    assert np.unique(codes).size == 101


@pytest.mark.parametrize("black", [0.0, 512.0, 100.25])
def test_a_converter_rounds_to_the_nearest(black: float) -> None:
    values = np.linspace(0, 30, 241)[:-1]  # eighths of a DN
    values = values[np.abs((values + black) % 1 - 0.5) > 0.01]  # ties may fall either way in float32
    clean = np.repeat(values, 4).reshape(1, -1, 4).transpose(0, 2, 1)[..., None] * (RATIO / RANGE_DN)
    dn = compiled_dn("B", clean.astype(np.float32), NoiseParameters(1, 0, 0, 0, 0), adc=Adc(black, 16383.0))
    np.testing.assert_allclose(dn[0, 0, :, 0], np.rint(values + black) - black, atol=1e-4)


def test_a_converter_has_the_variance_of_uniform_quantisation() -> None:
    """262144 pixels of 2.1 DN deviation: mean and variance within 5 standard errors."""
    adc = Adc(512.0, 16383.0)
    dn = compiled_dn("G", clean_of(np.array([50.3]), (4, 256, 256), PARAMETERS), PARAMETERS, seed=10, adc=adc)
    law = Law.of("G+U", PARAMETERS, 50.3)
    model = NoiseModel("G", adc=adc)
    assert model.expected_variance_dn2(50.3, PARAMETERS) == pytest.approx(law.variance)
    assert abs(dn.mean() - law.mean) < 5 * law.mean_error(dn.size, 1)
    assert abs(np.mean((dn - law.mean) ** 2) - law.variance) < 5 * law.variance_error(dn.size, 1)


# --- clip, ratio and range ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("clip", ["none", "upper", "both"])
def test_the_clip_is_that_of_the_unclipped_result(clip: Any) -> None:
    clean = np.linspace(0, 1.2, 4 * 64 * 64, dtype=np.float32).reshape(4, 64, 64)
    free = noisy(clean)
    assert free.min() < 0
    assert free.max() > 1
    low, high = {"none": (-math.inf, math.inf), "upper": (-math.inf, 1), "both": (0, 1)}[clip]
    same_bits(noisy(clean, model=NoiseModel(clip=clip)), np.clip(free, np.float32(low), np.float32(high)))


@pytest.mark.parametrize(("ratio", "range_dn"), [(1.0, 16383.0), (100.0, 15871.0), (300.0, 1023.0), (0.5, 100.0)])
def test_the_result_is_dn_times_ratio_over_range(ratio: float, range_dn: float) -> None:
    # No light: the noise in DN is the same for the same key, whatever the ratio and the range.
    dark = np.zeros((4, 32, 32), np.float32)
    dn = noisy(dark, "G*+B+R+U", ratio=1.0, range_dn=1.0)
    np.testing.assert_allclose(
        noisy(dark, "G*+B+R+U", ratio=ratio, range_dn=range_dn), dn * ratio / range_dn, rtol=1e-6
    )
    # Without noise the signal comes back.
    np.testing.assert_allclose(
        noisy(FLAT, "B", ratio=ratio, range_dn=range_dn, parameters=NoiseParameters(2.0, 0, 0, 0, 0)), 0.25, rtol=1e-6
    )


@pytest.mark.parametrize("ratio", [1.0, 100.0])
def test_the_light_is_divided_by_the_ratio(ratio: float) -> None:
    """65536 pixels of shot noise: its variance within 5 standard errors."""
    range_dn, gain, clean = 1000.0, 2.0, 0.5
    signal_e = clean * range_dn / (ratio * gain)
    parameters = NoiseParameters(gain, 0, 0, 0, 0)
    result = noisy(
        np.full((4, 128, 128), clean, np.float32), "P*", ratio=ratio, range_dn=range_dn, parameters=parameters
    )
    dn = result.astype(np.float64) * range_dn / ratio
    law = Law.of("P*", parameters, signal_e)
    assert abs(dn.mean() - gain * signal_e) < 5 * law.mean_error(dn.size, 1)
    assert abs(np.mean((dn - law.mean) ** 2) - law.variance) < 5 * law.variance_error(dn.size, 1)


# --- clips and batches ----------------------------------------------------------------------------------------------


def test_one_draw_for_a_clip_and_fresh_noise_for_each_frame() -> None:
    """16 frames with one bias; their noise is uncorrelated (4 * 64 * 64 pixels, 5 standard errors)."""
    clip = np.full((16, 4, 64, 64), 0.25, np.float32)
    dn = noisy(clip, "G+B") * (RANGE_DN / RATIO)
    law = Law.of("G", PARAMETERS, 0.25 * RANGE_DN / RATIO / PARAMETERS.gain_dn_per_e)
    for frame in dn:
        for channel, bias in zip(frame, PARAMETERS.colour_bias_dn, strict=True):
            assert abs(channel.mean() - law.mean - bias) < 5 * law.mean_error(64 * 64, 1)
    centred = (dn - dn.mean(axis=(-1, -2), keepdims=True)).reshape(16, -1)
    assert np.abs(np.corrcoef(centred)[np.triu_indices(16, 1)]).max() < 5 / math.sqrt(centred.shape[1])


def test_a_draw_and_a_ratio_for_each_image() -> None:
    gains, ratios = (0.5, 1.0, 4.0), (100.0, 200.0, 300.0)
    draws = [NoiseParameters(gain, 0.1, gain, 0, 0, (gain, 0, 0, -gain)) for gain in gains]
    batch = np.full((3, 4, 32, 32), 0.25, np.float32)
    together = noisy(batch, parameters=draws, ratio=ratios)
    for number, (draw, ratio) in enumerate(zip(draws, ratios, strict=True)):
        alone = noisy(batch, parameters=draw, ratio=ratio)
        same_bits(together[number], alone[number])
    assert not np.array_equal(together[0], together[1])


def test_a_sequence_may_be_a_tuple_and_must_have_the_right_length() -> None:
    batch = np.zeros((2, 4, 4, 4), np.float32)
    same_bits(noisy(batch, parameters=(PARAMETERS, PARAMETERS)), noisy(batch))
    same_bits(noisy(batch, ratio=(RATIO, RATIO)), noisy(batch))
    for name, value in (("parameters", [PARAMETERS]), ("parameters", [PARAMETERS] * 3), ("ratio", [1.0] * 3)):
        refused: dict[str, Any] = {name: value}
        with pytest.raises(ArgumentError, match=rf"^{name}: expected one, or one for each of 2 images; found"):
            noisy(batch, **refused)


@pytest.mark.parametrize("lead", [(), (1,), (3,), (2, 3), (0,), (2, 0), (1, 2, 1, 2)])
@pytest.mark.parametrize("channels", [4, 9, 16, 36])
def test_any_leading_dimensions(lead: tuple[int, ...], channels: int) -> None:
    clean = np.full((*lead, channels, 6, 4), 0.25, np.float32)
    result = noisy(clean)
    assert result.shape == clean.shape
    flat = noisy(clean.reshape(-1, channels, 6, 4))
    same_bits(result.reshape(flat.shape), flat)
    tensor = noisy(torch.from_numpy(clean))
    assert tensor.shape == clean.shape
    same_bits(tensor.numpy(), result)


@pytest.mark.parametrize(
    "shape", [(4, 0, 5), (4, 5, 0), (9, 0, 0), (4, 1, 1), (9, 1, 1), (9, 3, 5), (4, 2, 1031), (16, 1, 3)]
)
def test_odd_sizes(shape: tuple[int, int, int]) -> None:
    result = noisy(np.full(shape, 0.25, np.float32))
    assert result.shape == shape
    assert np.isfinite(result).all()


# --- kinds of data --------------------------------------------------------------------------------------------------


def test_numpy_and_torch_give_the_same_bits() -> None:
    clean = np.random.default_rng(0).random((2, 4, 33, 47), dtype=np.float32)
    for make in (np.random.default_rng, lambda seed: torch.Generator().manual_seed(seed)):
        array = noisy(clean, generator=make(11))
        tensor = noisy(torch.from_numpy(clean), generator=make(11))
        assert isinstance(array, np.ndarray)
        assert isinstance(tensor, torch.Tensor)
        same_bits(tensor.numpy(), array)


@pytest.mark.parametrize("dtype", ["float16", "float32", "float64"])
def test_the_dtype_stays(dtype: str) -> None:
    clean = FLAT.astype(dtype)  # 0.25 is exact in all
    wanted = noisy(FLAT).astype(dtype)
    array = noisy(clean)
    assert array.dtype == wanted.dtype
    np.testing.assert_array_equal(array, wanted)
    tensor = noisy(torch.from_numpy(clean))
    assert tensor.dtype == getattr(torch, dtype)
    np.testing.assert_array_equal(tensor.numpy(), wanted)


def test_bfloat16_stays() -> None:
    tensor = noisy(torch.full((4, 6, 8), 0.25, dtype=torch.bfloat16))
    assert tensor.dtype == torch.bfloat16
    np.testing.assert_array_equal(tensor.float().numpy(), torch.from_numpy(noisy(FLAT)).bfloat16().float().numpy())


def test_the_layout_in_memory_changes_nothing() -> None:
    clean = np.random.default_rng(1).random((2, 4, 16, 12), dtype=np.float32)
    wanted = noisy(clean)
    same_bits(noisy(np.asfortranarray(clean)), wanted)
    same_bits(noisy(np.ascontiguousarray(clean[..., ::-1])[..., ::-1]), wanted)
    same_bits(noisy(clean.astype(">f4")).astype(np.float32), wanted)
    last = torch.from_numpy(clean).to(memory_format=torch.channels_last)
    same_bits(noisy(last).contiguous().numpy(), wanted)


def test_the_clean_data_is_not_written_to() -> None:
    clean = FLAT.copy()
    clean.setflags(write=False)
    result = noisy(clean)
    assert not np.shares_memory(result, clean)
    np.testing.assert_array_equal(clean, FLAT)
    tensor = torch.from_numpy(FLAT.copy()).requires_grad_()
    noisy_tensor = noisy(tensor)
    assert not noisy_tensor.requires_grad
    np.testing.assert_array_equal(tensor.detach().numpy(), FLAT)


def test_values_below_0_count_as_no_light() -> None:
    clean = np.linspace(-0.5, 0, 4 * 16 * 16, dtype=np.float32).reshape(4, 16, 16)
    for spec in (*PAPER_MODELS, "P", "B"):
        same_bits(noisy(clean, spec), noisy(np.zeros_like(clean), spec))


@in_one_test("spec", [*PAPER_MODELS, "P", "P*", "B"])
@in_one_test("clip", ["none", "both"])
def test_nan_stays_where_it_is(spec: str, clip: Any) -> None:
    clean = np.full((4, 16, 16), 0.25, np.float32)
    holes = np.zeros(clean.shape, bool)
    holes[1, 3, 5] = holes[2, 0] = holes[3, 15, 15] = True
    result = noisy(np.where(holes, np.float32(np.nan), clean), model=NoiseModel(spec, clip=clip))
    np.testing.assert_array_equal(np.isnan(result), holes)
    np.testing.assert_array_equal(result[~holes], noisy(clean, model=NoiseModel(spec, clip=clip))[~holes])


# --- determinism ----------------------------------------------------------------------------------------------------


def test_any_number_of_threads_gives_the_same_bits() -> None:
    clean = np.random.default_rng(2).random((3, 4, 300, 410), dtype=np.float32)
    wanted = noisy(clean, threads=1)
    for threads in (2, 3, 8, None):
        same_bits(noisy(clean, threads=threads), wanted)
    xtrans = np.random.default_rng(2).random((9, 302, 402), dtype=np.float32)
    same_bits(noisy(xtrans, threads=1), noisy(xtrans, threads=5))


@pytest.mark.parametrize("make", [np.random.default_rng, lambda seed: torch.Generator().manual_seed(seed)])
def test_the_generator_moves_on(make: Any) -> None:
    generator = make(3)
    first, second = noisy(FLAT, generator=generator), noisy(FLAT, generator=generator)
    assert not np.array_equal(first, second)
    same_bits(first, noisy(FLAT, generator=make(3)))
    assert not np.array_equal(first, noisy(FLAT, generator=make(4)))


def test_a_component_keeps_its_draws_when_another_is_switched_off() -> None:
    clean = np.full((4, 32, 32), 0.25, np.float32)
    base = noisy(clean, "B", parameters=NoiseParameters(1.0, 0, 0, 0, 0)).astype(np.float64)
    parts = sum(noisy(clean, name).astype(np.float64) - base for name in ("P*", "G*", "B", "R", "U"))
    np.testing.assert_allclose(noisy(clean) - base, parts, atol=1e-5)


def test_no_global_generator_is_touched() -> None:
    before = torch.get_rng_state()
    noisy(FLAT)
    noisy(torch.from_numpy(FLAT), generator=torch.Generator().manual_seed(0))
    assert torch.equal(torch.get_rng_state(), before)


def test_several_generators_are_as_many_calls() -> None:
    """Images of several cameras, a pair of each under one generator: to the bit what calls for each pair give."""
    clean = np.random.default_rng(5).random((6, 9, 6, 8), dtype=np.float32)
    parameters = [replace(PARAMETERS, sigma_tl_dn=1.0 + number, tukey_lambda=0.1 * number) for number in range(6)]
    ratios, ranges = [100.0, 110.0, 120.0, 130.0, 140.0, 150.0], [900.0, 900.0, 15871.0, 15871.0, 7000.0, 7000.0]
    together = noisy(
        clean,
        parameters=parameters,
        ratio=ratios,
        range_dn=ranges,
        generator=[np.random.default_rng(seed) for seed in range(3)],
        threads=2,
    )
    for seed, some in enumerate((slice(0, 2), slice(2, 4), slice(4, 6))):
        alone = noisy(
            clean[some], parameters=parameters[some], ratio=ratios[some], range_dn=ranges[some][0], seed=seed, threads=1
        )
        same_bits(together[some], alone)
    with pytest.raises(ArgumentError, match="one generator, or several, each for as many of 6 images; found 4"):
        noisy(clean, generator=[np.random.default_rng(0)] * 4)


@pytest.mark.parametrize("ratio", [np.array([100.0, 200.0]), torch.tensor([100.0, 200.0])])
def test_ratios_as_an_array_or_a_tensor_are_understood_or_refused(ratio: Any) -> None:
    clean = np.zeros((2, 4, 4, 4), np.float32)
    try:
        result = noisy(clean, ratio=ratio)
    except ArgumentError as error:
        assert "ratio" in str(error)  # noqa: PT017 - either is fine, another error is not
    else:
        same_bits(result, noisy(clean, ratio=[100.0, 200.0]))


@pytest.mark.parametrize("mean_e", [1e9, 1e12, 9e18, 1e19, 1e30])
def test_any_number_of_photoelectrons(mean_e: float) -> None:
    """4096 draws: none is off by more than 7 deviations and the rounding to float32, and their mean by 6 errors."""
    draws = noisy(
        np.full((4, 32, 32), mean_e, np.float32),
        "P*",
        parameters=NoiseParameters(1.0, 0, 0, 0, 0),
        ratio=1.0,
        range_dn=1.0,
    ).astype(np.float64)
    rounding = mean_e * 2.0**-23
    assert np.abs(draws - np.float64(np.float32(mean_e))).max() < 7 * math.sqrt(mean_e) + rounding
    assert abs(draws.mean() - np.float64(np.float32(mean_e))) < 6 * math.sqrt(mean_e) / 64 + rounding


# --- refusals -------------------------------------------------------------------------------------------------------

NO_NUMBERS: tuple[Any, ...] = ("100", "a", [], np.ones(2), 1j)
REFUSED: list[tuple[dict[str, Any], str]] = [
    *(({"clean": np.zeros(shape, np.float32)}, r"clean data \(\.\.\., C, h, w\)") for shape in ((), (4,), (4, 4))),
    ({"clean": torch.zeros(4, 4)}, r"clean data \(\.\.\., C, h, w\); found shape"),
    *(
        ({"clean": np.zeros((channels, 4, 4), np.float32)}, rf"4 \(Bayer\), 9 .* 36 .* channels; found {channels}")
        for channels in (0, 1, 3, 5, 8)
    ),
    *(
        ({"clean": np.ones((4, 4, 4)).astype(dtype)}, "^clean is .*; expected floating numbers")
        for dtype in ("complex64", "bool", "object", "U4")
    ),
    ({"clean": torch.ones((4, 4, 4), dtype=torch.complex64)}, "^clean is torch.complex64; expected floating numbers"),
    *(({"clean": clean}, "clean") for clean in ([[[0.5]]], None, 0.5, "clean")),
    *(({name: value}, rf"^{name}(:| must be)") for name in ("ratio", "range_dn") for value in NO_NUMBERS),
    *(
        ({name: value}, rf"^{name} must be finite and above 0; found")
        for name in ("ratio", "range_dn")
        for value in (0.0, -1.0, math.nan, math.inf, -math.inf)
    ),
    ({"clean": np.zeros((3, 4, 4, 4), np.float32), "ratio": [1.0, 0.0, 2.0]}, "ratio must be finite and above 0"),
    *(({"threads": threads}, "^threads must be .*1 or more; found") for threads in (0, -1, 2.5, "2")),
    *(
        ({"clean": clean, "generator": generator}, r"a numpy\.random\.Generator or a torch\.Generator")
        for clean in (FLAT, torch.from_numpy(FLAT))
        for generator in (None, 0, np.random.RandomState(0), "numpy")
    ),
    *(({"parameters": given}, "parameters") for given in (None, {"gain_dn_per_e": 1.0}, "SonyA7S2", [None])),
]


@in_one_test("given, said", REFUSED)
def test_what_a_call_refuses(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        noisy(given.get("clean", FLAT), **{name: value for name, value in given.items() if name != "clean"})


@in_one_test(
    "given, said",
    [
        ({"spec": "P*+X"}, "'X' is not a component"),
        *(({"spec": spec}, "spec is a text such as .*; found") for spec in (None, 5, ["P*", "G*"], b"P*")),
        ({"spec": "P*", "adc": 3}, r"adc must be an Adc, such as Adc\(512, 16383\); found 3"),
        ({"adc": Adc(0.0, 1.0)}, "U stands for the converter's rounding; leave it out with adc"),
        *(({"clip": clip}, "clip must be one of 'both'.*; found") for clip in ("lower", "", False, True, (0, 1))),
    ],
)
def test_what_a_model_refuses(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        NoiseModel(**given)


def test_levels_of_a_converter_that_make_no_sense() -> None:
    for levels in (("a", 1.0), (0.0, None), (10.0, 5.0), (-1.0, 5.0)):
        with pytest.raises(ArgumentError, match=r"(black|white).level"):
            Adc(*levels)


@pytest.mark.parametrize("clean", [np.full((4, 4, 4), 3000, np.uint16), np.ones((4, 4, 4), np.int64)], ids=str)
def test_whole_numbers_are_dn_and_not_normalised(clean: Any) -> None:
    """Taken as normalised, 3000 DN would be 3000 times white, and almost without noise."""
    words = (
        rf"^clean is (torch\.)?{clean.dtype}, whole numbers .* give \(clean - black\) / \(white - black\) in float32"
    )
    for given in (clean, torch.from_numpy(clean)):
        with pytest.raises(ArgumentError, match=words):
            noisy(given)
    with pytest.raises(ArgumentError, match=words):
        NoiseModel().on_mosaic(
            clean[0],
            cfa=((0, 1), (3, 2)),
            parameters=PARAMETERS,
            ratio=1.0,
            range_dn=1.0,
            generator=np.random.default_rng(0),
        )


# --- the object -----------------------------------------------------------------------------------------------------


def test_the_repr_rebuilds_the_model() -> None:
    for model in (
        NoiseModel(),
        NoiseModel(clip="none"),
        NoiseModel("R + P", clip="upper"),
        NoiseModel("P*", adc=Adc(512.0, 16383.0)),
    ):
        again = eval(repr(model), {"NoiseModel": NoiseModel, "Adc": Adc})  # noqa: S307 - our own text
        assert (again.components, again.clip, again.adc) == (model.components, model.clip, model.adc)
    assert repr(NoiseModel()) == "NoiseModel('P*+G*+B+R+U')"
    assert repr(NoiseModel(clip="upper").with_clip("none")) == "NoiseModel('P*+G*+B+R+U', clip='none')"


def test_a_model_pickles() -> None:
    model = NoiseModel("P*+G*+R", clip="both", adc=Adc(512.0, 16383.0))
    again = pickle.loads(pickle.dumps(model))
    assert repr(again) == repr(model)
    same_bits(noisy(FLAT, model=again), noisy(FLAT, model=model))


# --- memory of the caller's -----------------------------------------------------------------------------------------


def test_where_to_write() -> None:
    clean = np.random.default_rng(1).random((2, 4, 6, 8), np.float32)
    out = np.full_like(clean, np.nan)
    assert noisy(clean, out=out) is out or np.shares_memory(noisy(clean, out=out), out)
    same_bits(out, noisy(clean))


@pytest.mark.parametrize(
    "wrong",
    [
        np.empty((2, 4, 6, 9), np.float32),
        np.empty((2, 4, 6, 8), np.float64),
        np.empty((2, 4, 6, 16), np.float32)[..., ::2],
        [0.0],
        "the clean image",
    ],
    ids=["shape", "dtype", "not contiguous", "no array", "clean"],
)
def test_where_nothing_can_be_written(wrong: Any) -> None:
    clean = np.zeros((2, 4, 6, 8), np.float32)
    with pytest.raises(
        ArgumentError, match=r"out must be a writeable C-contiguous float32 array of shape \(2, 4, 6, 8\)"
    ):
        noisy(clean, out=clean if isinstance(wrong, str) else wrong)
    with pytest.raises(ArgumentError, match="out= is for arrays"):
        noisy(torch.zeros(2, 4, 6, 8), out=np.empty((2, 4, 6, 8), np.float32))


@pytest.mark.parametrize("columns", [1, 3, 64, 171, 512, 513])
def test_narrow_images_have_the_noise_of_their_pixels_numbers(columns: int) -> None:
    """Without row noise a pixel's number alone counts: however many rows a strip takes, one long row has the same."""
    rows = 1026 // columns
    clean = np.random.default_rng(2).random((1, 4, rows, columns), np.float32)
    line = noisy(clean.reshape(1, 4, 1, rows * columns), "P*+G*+B+U")
    same_bits(noisy(clean, "P*+G*+B+U").ravel(), line.ravel())
