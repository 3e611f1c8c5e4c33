"""The noise model on the CPU: the converter, what its arguments do, noise on whole mosaics, noise of one's own."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from eldata.datasets import Arrays, SyntheticPairs
from eldata.errors import ArgumentError
from eldata.noise import Adc, NoiseDraw, NoiseModel, NoiseParameters
from eldata.noise.model import made_exposure, pack_whole, unpack_whole
from tests.cases import in_one_test
from tests.datasets.comparing import same_bits
from tests.noise.helpers import PARAMETERS, RANGE_DN, RATIO, compiled_dn
from tests.raw.helpers import CFAS, levels_of

FULL = "P*+G*+B+R+U"
FLAT = np.full((4, 6, 8), 0.25, dtype=np.float32)
PAIR = np.stack([FLAT, FLAT])


def noisy(clean: Any, spec: str = FULL, *, seed: int = 0, model: NoiseModel | None = None, **options: Any) -> Any:
    arguments: dict[str, Any] = {
        "parameters": PARAMETERS,
        "ratio": RATIO,
        "range_dn": RANGE_DN,
        "generator": np.random.default_rng(seed),
    }
    return (model or NoiseModel(spec))(clean, **arguments | options)


# --- the converter --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("black", [0.0, 512.0, 100.25])
def test_a_converter_rounds_to_the_nearest(black: float) -> None:
    values = np.linspace(0, 30, 241)[:-1]  # eighths of a DN
    values = values[np.abs((values + black) % 1 - 0.5) > 0.01]  # ties may fall either way in float32
    clean = np.repeat(values, 4).reshape(1, -1, 4).transpose(0, 2, 1)[..., None] * (RATIO / RANGE_DN)
    dn = compiled_dn("B", clean.astype(np.float32), NoiseParameters(1, 0, 0, 0, 0), adc=Adc(black, 16383.0))
    np.testing.assert_allclose(dn[0, 0, :, 0], np.rint(values + black) - black, atol=1e-4)


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


# --- clips and batches ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lead", [(), (2, 3), (2, 0)])
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


# --- kinds of data --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_the_dtype_stays(dtype: torch.dtype) -> None:
    wanted = torch.from_numpy(noisy(FLAT)).to(dtype)
    clean = torch.from_numpy(FLAT).to(dtype)  # 0.25 is exact in all
    tensor = noisy(clean)
    assert tensor.dtype == dtype
    assert torch.equal(tensor, wanted)
    if dtype != torch.bfloat16:  # which numpy does not have
        array = noisy(clean.numpy())
        assert array.dtype == wanted.numpy().dtype
        np.testing.assert_array_equal(array, wanted.numpy())


def test_neither_the_layout_nor_who_tells_the_range_changes_anything() -> None:
    same_bits(noisy(FLAT, range_dn=None, parameters=replace(PARAMETERS, range_dn=RANGE_DN)), noisy(FLAT))
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
    assert not noisy(torch.from_numpy(clean.copy()).requires_grad_()).requires_grad


# --- determinism ----------------------------------------------------------------------------------------------------


def test_several_generators_are_as_many_calls() -> None:
    """Images of several cameras, a pair of each under one generator: to the bit what calls for each pair give."""
    clean = np.random.default_rng(5).random((6, 9, 6, 8), dtype=np.float32)
    parameters = [replace(PARAMETERS, sigma_tl_dn=1.0 + number, tukey_lambda=0.1 * number) for number in range(6)]
    ratios, ranges = [100.0, 110.0, 120.0, 130.0, 140.0, 150.0], [900.0, 900.0, 15871.0, 15871.0, 7000.0, 7000.0]
    draws = [NoiseDraw(*fields) for fields in zip(parameters, ratios, ranges, strict=True)]
    model = NoiseModel()
    together = model.apply(clean, draws, [np.random.default_rng(seed) for seed in range(3)], threads=2)
    for seed, some in enumerate((slice(0, 2), slice(2, 4), slice(4, 6))):
        options: dict[str, Any] = {"parameters": parameters[some], "ratio": ratios[some], "range_dn": ranges[some][0]}
        same_bits(together[some], noisy(clean[some], seed=seed, threads=1, **options))
        same_bits(together[some], model.apply(clean[some], draws[some], np.random.default_rng(seed)))  # replayed
    with pytest.raises(ArgumentError, match="one generator, or several, each for as many of 6 images; found 4"):
        model.apply(clean, draws, [np.random.default_rng(0)] * 4)


# --- refusals -------------------------------------------------------------------------------------------------------

NO_NUMBERS: tuple[Any, ...] = ("100", "a", [], np.ones(2), 1j)
REFUSED: list[tuple[dict[str, Any], str]] = [
    *(({"clean": np.zeros(shape, np.float32)}, r"clean data \(\.\.\., C, h, w\)") for shape in ((), (4, 4))),
    *(
        ({"clean": np.zeros((channels, 4, 4), np.float32)}, rf"4 \(Bayer\), 9 .* 36 .* channels; found {channels}")
        for channels in (0, 3, 8)
    ),
    *(({"clean": np.ones((4, 4, 4)).astype(dtype)}, "^clean is .*; expected floating") for dtype in ("bool", "U4")),
    ({"clean": torch.ones((4, 4, 4), dtype=torch.complex64)}, "^clean is torch.complex64; expected floating numbers"),
    # Taken as normalised, 3000 DN would be 3000 times white, and almost without noise.
    *(
        ({"clean": clean}, r"^clean is (torch\.)?uint16, whole numbers .* give \(clean - black\)")
        for clean in (np.full((4, 4, 4), 3000, np.uint16), torch.full((4, 4, 4), 3000, dtype=torch.uint16))
    ),
    *(({"clean": clean}, "clean must be a numpy array or") for clean in ([[[0.5]]], None)),
    *(({name: "100"}, rf"^{name} must be") for name in ("ratio", "range_dn")),
    *(({name: np.ones(2)}, rf"^{name}: expected one, or one") for name in ("ratio", "range_dn")),
    *(
        ({name: value}, rf"^{name} must be finite and above 0; found")
        for name in ("ratio", "range_dn")
        for value in (0.0, math.nan, math.inf)
    ),
    ({"clean": np.zeros((3, 4, 4, 4), np.float32), "ratio": [1.0, 0.0, 2.0]}, "ratio must be finite and above 0"),
    *(({"threads": threads}, "^threads must be .*1 or more; found") for threads in (0, 2.5)),
    *(
        ({"clean": clean, "generator": generator}, r"a numpy\.random\.Generator or a torch\.Generator")
        for clean in (FLAT, torch.from_numpy(FLAT))
        for generator in (None, np.random.RandomState(0))
    ),
    *(({"parameters": given}, "parameters") for given in (None, {"gain_dn_per_e": 1.0}, [None])),
    ({"dark": FLAT[None]}, "dark= is for models with component D"),
    ({"range_dn": None}, r"give range_dn.*do not know it"),
    ({"clean": PAIR, "range_dn": None, "parameters": [PARAMETERS, replace(PARAMETERS, range_dn=9)]}, "differ in it"),
]


@in_one_test("given, said", REFUSED)
def test_what_a_call_refuses(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        noisy(given.get("clean", FLAT), **{name: value for name, value in given.items() if name != "clean"})


@in_one_test(
    "given, said",
    [
        ({"spec": "P*+X"}, "'X' is not a component"),
        ({"spec": "P*", "adc": 3}, r"adc must be an Adc, such as Adc\(512, 16383\); found 3"),
        ({"adc": Adc(0.0, 1.0)}, "U stands for the converter's rounding; leave it out with adc"),
        *(({"clip": clip}, "clip must be one of 'both'.*; found") for clip in ("lower", True)),
    ],
)
def test_what_a_model_refuses(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        NoiseModel(**given)


# --- memory of the caller's -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("columns", [1, 3, 64, 171, 512, 513])
def test_narrow_images_have_the_noise_of_their_pixels_numbers(columns: int) -> None:
    """Without row noise a pixel's number alone counts: however many rows a strip takes, one long row has the same."""
    rows = 1026 // columns
    clean = np.random.default_rng(2).random((1, 4, rows, columns), np.float32)
    line = noisy(clean.reshape(1, 4, 1, rows * columns), "P*+G*+B+U")
    same_bits(noisy(clean, "P*+G*+B+U").ravel(), line.ravel())


def test_where_to_write() -> None:
    clean = np.random.default_rng(1).random((2, 4, 6, 8), np.float32)
    out = np.full_like(clean, np.nan)
    assert np.shares_memory(noisy(clean, out=out), out)
    same_bits(out, noisy(clean))
    for wrong in (clean, np.empty((2, 4, 6, 8)), np.empty((2, 4, 6, 16), np.float32)[..., ::2], [0.0]):
        with pytest.raises(ArgumentError, match=r"out must be a writeable .* of shape \(2, 4, 6, 8\)"):
            noisy(clean, out=wrong)
    with pytest.raises(ArgumentError, match="out= is for arrays"):
        noisy(torch.zeros(2, 4, 6, 8), out=np.empty((2, 4, 6, 8), np.float32))


# --- whole mosaics: no pixel is left out ---------------------------------------------------------------------------

OF_MOSAIC = NoiseParameters(1.5, -0.1, 2.0, 3.0, 4.0, (10.0, 20.0, 30.0, 40.0))


@in_one_test("name", CFAS)
@in_one_test("shape", [(12, 18), (13, 17), (2, 3, 11, 8), (6, 6), (1, 1)])
def test_whole_mosaics_come_back(name: str, shape: tuple[int, ...]) -> None:
    mosaic = np.random.default_rng(0).random(shape).astype(np.float32)
    packed = pack_whole(mosaic, CFAS[name])
    np.testing.assert_array_equal(unpack_whole(packed, CFAS[name], shape[-2:]), mosaic)  # type: ignore[arg-type] # two
    tensor = pack_whole(torch.from_numpy(mosaic), CFAS[name])
    np.testing.assert_array_equal(tensor.numpy(), packed)


@pytest.mark.parametrize(
    "name", ["RGGB", "GBRG", "BGGR", "xtrans-00", "xtrans-23", "quad-00", "quad-23", "nona-00", "nona-14"]
)
def test_rows_and_biases_are_those_of_the_mosaic(name: str) -> None:
    """R alone: every mosaic row is constant, and the rows are independent. B alone: the bias follows the CFA."""
    cfa = np.asarray(CFAS[name])
    clean = np.zeros((601, 37), np.float32)

    def noise(spec: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        generator = np.random.default_rng(1)
        model = NoiseModel(spec)
        noisy = model.on_mosaic(
            clean, cfa=cfa, parameters=OF_MOSAIC, ratio=100.0, range_dn=RANGE_DN, generator=generator
        )
        assert noisy.shape == clean.shape
        return noisy * np.float32(RANGE_DN / 100)

    rows = noise("R")
    assert np.ptp(rows, axis=1).max() == 0
    draws = rows[:, 0].astype(np.float64)
    n = len(draws)
    # 5 standard errors of a standard deviation and of a lag-one correlation.
    assert abs(draws.std() / OF_MOSAIC.sigma_row_dn - 1) < 5 / np.sqrt(2 * n)
    assert abs(np.corrcoef(draws[1:], draws[:-1])[0, 1]) < 5 / np.sqrt(n)

    bias = noise("B")
    y, x = np.indices(clean.shape)
    index = cfa[y % len(cfa), x % len(cfa)]
    levels = np.array([10.0, 20.0, 30.0, 40.0] if levels_of(CFAS[name]) == 4 else [10.0, 30.0, 30.0])
    np.testing.assert_allclose(bias, levels[index], rtol=1e-5)


# --- noise of one's own ---------------------------------------------------------------------------------------------

DRAW = NoiseDraw(NoiseParameters(1.0, 0.0, 0.0, 0.0, 0.0), 100.0, 15871.0)


def brighter(clean: Any, *, parameters: Any, ratio: float, range_dn: float, generator: np.random.Generator) -> Any:
    """Twice the light and 1 % of noise, from all that it is told."""
    clean *= 2
    return clean + generator.normal(0, 0.01, clean.shape) + 0 * (parameters.gain_dn_per_e + ratio + range_dn)


class Scaled:
    """An object, as a torch module is."""

    def __init__(self, by: float) -> None:
        self.by = by

    def __call__(self, clean: Any, **_: Any) -> Any:
        return torch.from_numpy(clean) * self.by

    def __repr__(self) -> str:
        return f"Scaled({self.by})"


def adapted(clean: Any, *, ratio: float, generator: np.random.Generator, **_: Any) -> Any:
    """Call a network of somebody else's, which draws from torch's own generator, as docs/noise.md shows."""
    with torch.inference_mode(), torch.random.fork_rng([]):
        torch.manual_seed(int(generator.integers(2**63 - 1)))
        image = torch.from_numpy(clean).reshape(-1, *clean.shape[-3:]) / ratio
        return ((image + 0.01 * torch.randn(image.shape)) * ratio).reshape(clean.shape).numpy()


def pairs(model: Any, **options: Any) -> SyntheticPairs:
    source = Arrays(np.full((1, 4, 64, 64), 0.3, np.float32), range_dn=15871.0)
    return SyntheticPairs(source, "SonyA7S2", model=model, **{"crop": 32, "crops_per_frame": 4} | options)


def test_a_function_makes_the_noise() -> None:
    """4096 pixels of 1 % noise around twice the light: mean and deviation within 5 standard errors."""
    item = pairs(brighter)[1]
    noise = item["input"].double().numpy() - 0.6
    assert abs(noise.mean()) < 5 * 0.01 / 64
    assert abs(noise.std() / 0.01 - 1) < 5 / np.sqrt(2 * 4096)
    assert torch.equal(item["target"], torch.full((4, 32, 32), 0.3))  # what it wrote to was its own
    assert torch.equal(item["input"], pairs(brighter)[1]["input"])
    assert not torch.equal(item["input"], pairs(brighter)[2]["input"])
    assert item["input"].dtype == torch.float32


def test_an_object_and_the_clip_of_the_dataset() -> None:
    """A tensor of the CPU is as good as an array; the dataset clips as it does for our own model."""
    for by, clip, value in ((5.0, "both", 1.0), (5.0, "none", 1.5), (-1.0, "upper", -0.3), (-1.0, "both", 0.0)):
        item = pairs(Scaled(by), clip=clip)[0]
        np.testing.assert_allclose(item["input"].numpy(), value, rtol=1e-6)
    assert "Scaled(2.0), clip='upper'" in repr(pairs(Scaled(2.0), clip="upper"))
    assert "brighter, clip='both'" in repr(pairs(brighter))


@in_one_test(
    "model, words",
    [
        ("G+P", r"give NoiseModel\('G\+P'\)"),
        (5, "must be a NoiseModel, or an object to be called as .*; found 5"),
        (NoiseModel, "must be a NoiseModel, .*; found <class"),
        (lambda clean: clean, "cannot be called .* unexpected keyword"),
        (lambda clean, iso, **_: clean * iso, "cannot be called .* missing .*: 'iso'"),
    ],
)
def test_what_cannot_make_noise_is_refused_before_the_first_item(model: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        pairs(model)


@in_one_test(
    "result, words",
    [
        (FLAT[0], r"<lambda> returned float32 of shape \(6, 8\); expected .*, \(4, 6, 8\)"),
        (FLAT.astype(np.uint16), "returned uint16 of shape"),
        (None, "returned NoneType; expected"),
    ],
)
def test_what_is_not_an_exposure(result: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        made_exposure(lambda *_, **__: result, FLAT, DRAW, np.random.default_rng(0))


def test_a_network_of_somebody_elses() -> None:
    before = torch.random.get_rng_state()
    items = [pairs(adapted, ratio=1.0)[index]["input"] for index in (0, 1, 0)]
    assert torch.equal(before, torch.random.get_rng_state())  # which the dataset's user may draw from, too
    assert torch.equal(items[0], items[2])
    assert not torch.equal(items[0], items[1])
    noise = items[0].double() - 0.3
    assert abs(float(noise.std()) / 0.01 - 1) < 5 / np.sqrt(2 * 4096)
