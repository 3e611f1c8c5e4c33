"""Components C, W, T and F: columns, bands, telegraph pixels and PRNU as they are defined, on one sensor and on others.

Tolerances are five standard errors of the stated number of draws, with fixed seeds.
"""

from __future__ import annotations

import dataclasses
import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from eldata.datasets import Arrays, SyntheticPairs
from eldata.errors import ArgumentError, ProfileError
from eldata.noise import (
    CameraProfile,
    NoiseModel,
    NoiseStructure,
    RowSpectrum,
    RowWave,
    TelegraphPixels,
    parse_components,
)
from eldata.noise.compiled import expose_compiled
from eldata.noise.exposures import Exposures
from eldata.noise.on_device import expose_on_device
from eldata.raw.cfa import XTRANS_CFA, bayer_cfa, pack
from tests.noise.helpers import PARAMETERS, RANGE_DN

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

EDGES = (0.002, 0.01, 0.05, 0.5)
STRUCTURE = NoiseStructure(
    gain_dn_per_e=0.8,
    iso=800,
    sigma_column_dn=0.7,
    row_spectrum=RowSpectrum(EDGES, (40.0, 6.0, 0.5), (RowWave(0.125, 1.5),)),
    telegraph=TelegraphPixels(0.02, 6.0, 0.25, 0.05, 1.1, 0.9),
    prnu=0.02,
)
EVERY = dataclasses.replace(PARAMETERS, structure=STRUCTURE)
LETTERS = {"C": "sigma_column_dn", "W": "row_spectrum", "T": "telegraph", "F": "prnu"}


def made(spec: str, clean: NDArray[Any], seed: int = 0, *, sensor: int = 0, **options: Any) -> NDArray[np.float64]:
    """Noisy DN of clean DN."""
    model = NoiseModel(spec, sensor_seed=sensor)
    given: dict[str, Any] = {
        "parameters": EVERY,
        "ratio": 1.0,
        "range_dn": RANGE_DN,
        "generator": np.random.default_rng(seed),
    }
    noisy = model((clean / RANGE_DN).astype(np.float32), **given | options)
    return np.asarray(noisy, dtype=np.float64) * RANGE_DN


# --- what they make -------------------------------------------------------------------------------------------------


def test_a_column_has_one_offset_in_a_frame() -> None:
    """16 frames of 512 columns, X-Trans, whose packed columns are of two mosaic columns each; those of Bayer."""
    frames = NoiseModel("C").on_mosaic(
        np.zeros((16, 24, 512), np.float32),
        cfa=XTRANS_CFA,
        parameters=EVERY,
        ratio=1.0,
        range_dn=RANGE_DN,
        generator=np.random.default_rng(1),
    )
    columns = frames[:, 0] * RANGE_DN
    np.testing.assert_array_equal(frames, np.repeat(frames[:, :1], 24, axis=1))
    assert columns.std() == pytest.approx(0.7, rel=5 / math.sqrt(2 * columns.size))
    neighbours = float((columns[:, 1:] * columns[:, :-1]).mean()) / 0.49
    between = float((columns[1:] * columns[:-1]).mean()) / 0.49
    assert max(abs(neighbours), abs(between)) < 5 / math.sqrt(15 * 511)
    packed = made("C", np.zeros((4, 8, 100)))
    np.testing.assert_array_equal(packed[0], packed[3])  # R and G2 lie in columns of the same parity
    assert not np.any(packed[0] == packed[1])


def test_rows_have_the_stated_spectrum() -> None:
    """400 frames of 256 rows: each of the bands' powers, and the wave, whose phase is another one in each frame."""
    packed = made("W", np.zeros((400, 4, 128, 2)), 2)
    rows = np.stack([packed[:, 0, :, 0], packed[:, 2, :, 1]], axis=2).reshape(400, 256)
    np.testing.assert_array_equal(packed[:, 1, :, 0], packed[:, 0, :, 1])  # R and G1 share their rows
    phases = np.exp(-2j * np.pi * 0.125 * np.arange(256))
    amplitudes = 2 * np.abs(rows @ phases) / 256
    assert amplitudes.mean() == pytest.approx(1.5, abs=0.05)
    assert abs(np.exp(1j * np.angle(rows @ phases)).mean()) < 5 / math.sqrt(2 * 400)
    window = np.hanning(257)[:-1]
    power = (np.abs(np.fft.rfft(rows * window, axis=1)) ** 2).mean(axis=0) / float(window @ window)
    frequency = np.fft.rfftfreq(256)
    for low, high, wanted in ((0.015, 0.042, 6.0), (0.06, 0.11, 0.5), (0.15, 0.5, 0.5)):
        band = power[(frequency > low) & (frequency < high)]
        assert band.mean() == pytest.approx(wanted, rel=5 * math.sqrt(2 / (400 * band.size)) + 0.03), (low, high)
    slow = math.sqrt(rows.mean(axis=1).var() / STRUCTURE.row_spectrum.power_dn2[0] * 256)  # type: ignore[union-attr]
    assert slow == pytest.approx(1, abs=0.3)  # the mean of 256 rows is a wave of 0 to 1/256


def test_pixels_have_their_own_response_to_light_on_a_sensor() -> None:
    light = np.full((4, 64, 96), 8000.0)
    first = made("F", light, 3) / 8000
    assert first.std() == pytest.approx(0.02, rel=5 / math.sqrt(2 * first.size))
    assert first.mean() == pytest.approx(1, abs=5 * 0.02 / math.sqrt(first.size))
    np.testing.assert_array_equal(first, made("F", light, 4) / 8000)
    crop = made("F", light[:, 10:30, 20:60], 5, place=(10, 20)) / 8000
    np.testing.assert_array_equal(crop, first[:, 10:30, 20:60])
    other = made("F", light, 3, sensor=1) / 8000
    assert abs(np.corrcoef(other.ravel(), first.ravel())[0, 1]) < 5 / math.sqrt(first.size)
    np.testing.assert_array_equal(made("F", np.zeros((4, 8, 8))), 0)


def test_photons_follow_the_response() -> None:
    """PRNU is of the light: the noise of a pixel's photons is that of what the pixel takes."""
    parameters = dataclasses.replace(EVERY, structure=dataclasses.replace(STRUCTURE, prnu=0.5))
    light = np.full((400, 4, 4, 4), 400.0)
    pixels = made("P*+F", light, 6, parameters=parameters)
    means, variances = pixels.mean(axis=0), pixels.var(axis=0, ddof=1)
    assert np.ptp(means) > 400
    np.testing.assert_allclose(variances, 0.8 * means, rtol=5 * math.sqrt(2 / 400), atol=0.8)


def test_telegraph_pixels_jump_between_two_levels_at_their_places() -> None:
    """64 frames of 24576 pixels."""
    frames = made("T", np.zeros((64, 4, 64, 96)), 7)
    jumping = np.any(frames != 0, axis=0)
    assert jumping.mean() == pytest.approx(0.02, abs=5 * math.sqrt(0.02 / jumping.size))
    levels = frames[:, jumping]
    is_upper = levels > 0
    np.testing.assert_allclose(levels[is_upper], 6 * 0.75, rtol=1e-5)
    np.testing.assert_allclose(levels[~is_upper], -6 * 0.25, rtol=1e-5)
    assert is_upper.mean() == pytest.approx(0.25, abs=5 * math.sqrt(0.1875 / levels.size))
    crop = made("T", np.zeros((64, 4, 20, 40)), 8, place=(10, 20))
    np.testing.assert_array_equal(np.any(crop != 0, axis=0), jumping[:, 10:30, 20:60])
    more = dataclasses.replace(STRUCTURE, telegraph=TelegraphPixels(0.1, 6.0, 0.5))
    wider = made("T", np.zeros((64, 4, 64, 96)), 9, parameters=dataclasses.replace(EVERY, structure=more))
    assert np.all(np.any(wider != 0, axis=0)[jumping])  # of an ISO with more of them, the same ones too


def test_all_of_a_mosaic_lies_on_the_sensor_that_its_crops_lie_on() -> None:
    """GBRG: packing begins with the first pixel; X-Trans: it drops some, which have a place before it."""
    given: dict[str, Any] = {"parameters": EVERY, "ratio": 1.0, "range_dn": RANGE_DN}
    for cfa in (bayer_cfa(), np.roll(XTRANS_CFA, (2, 1), (0, 1))):
        light = np.full((48, 60), 0.5, np.float32)
        whole = NoiseModel("F").on_mosaic(light, cfa=cfa, generator=np.random.default_rng(0), **given)
        packed = NoiseModel("F")(pack(light, cfa), generator=np.random.default_rng(1), **given)
        np.testing.assert_array_equal(pack(whole, cfa), packed)


def test_closed_forms() -> None:
    """Of all together: 300 frames, whose rows, columns and pixels are new ones; the pixels' response is one draw."""
    spec = "P*+G*+R+C+T+F+U"
    signal = 0.8 * 500.0
    frames = made(spec, np.full((300, 4, 32, 32), signal), 10)
    model = NoiseModel(spec)
    expected = model.expected_variance_dn2(500.0, EVERY)
    assert frames.mean() == pytest.approx(model.expected_mean_dn(500.0, EVERY), abs=5 * math.sqrt(expected / 4096))
    # The response of 4096 pixels has a share of prnu^2 signal^2 that scatters by sqrt(2 / 4096).
    assert frames.var() == pytest.approx(expected, rel=5 * math.sqrt(2 / 4096))
    without = NoiseModel("P*+G*+R+U").expected_variance_dn2(500.0, EVERY)
    assert NoiseModel("P*+G*+R+C+U").expected_variance_dn2(500.0, EVERY) == pytest.approx(without)
    banded = NoiseModel("P*+G*+W+U").expected_variance_dn2(500.0, EVERY)
    assert banded - without == pytest.approx(STRUCTURE.row_spectrum.variance_dn2 - 0.81)  # type: ignore[union-attr]


# --- engines --------------------------------------------------------------------------------------------------------


def test_bits_do_not_depend_on_threads_or_batches() -> None:
    clean = np.random.default_rng(0).random((4, 4, 300, 260), dtype=np.float32)
    spec = parse_components("P*+G*+W+C+T+F+U")
    exposures = Exposures.of(spec, [EVERY] * 4, [1.0] * 4, 4, range_dn=RANGE_DN, sensor_seed=5, place=(2, 4))
    whole = expose_compiled(clean, exposures, key=9, threads=1)
    np.testing.assert_array_equal(whole, expose_compiled(clean, exposures, key=9, threads=3))
    half = Exposures.of(spec, [EVERY] * 2, [1.0] * 2, 4, range_dn=RANGE_DN, sensor_seed=5, place=(2, 4))
    np.testing.assert_array_equal(whole[:2], expose_compiled(clean[:2], half, key=9))


def test_other_devices_have_the_same_sensor() -> None:
    clean = np.full((2, 4, 32, 48), 0.5, np.float32)
    for spec in ("F", "T"):
        parts = parse_components(spec)
        exposures = Exposures.of(parts, [EVERY] * 2, [1.0] * 2, 4, range_dn=RANGE_DN, sensor_seed=3, place=(2, 2))
        here = expose_compiled(clean, exposures, key=1) - clean
        there = expose_on_device(torch.from_numpy(clean), exposures, torch.Generator().manual_seed(0)).numpy() - clean
        if spec == "F":
            np.testing.assert_allclose(there, here, atol=2e-6)
        else:
            np.testing.assert_array_equal(np.abs(there) * RANGE_DN > 0.5, np.abs(here) * RANGE_DN > 0.5)


def test_crops_of_a_dataset_lie_where_they_were_cut() -> None:
    """Ten items: their response is that of the sensor there."""
    clean = np.full((1, 4, 40, 48), 0.5, np.float32)
    profile = dataclasses.replace(CameraProfile.load("SonyA7S2"), structure=(STRUCTURE,))
    options: dict[str, Any] = {"crop": 16, "augment": True, "clip": "none", "ratio": 1.0}
    pairs = SyntheticPairs(
        Arrays(clean, range_dn=RANGE_DN), profile, model=NoiseModel("F"), crops_per_frame=10, **options
    )
    sensor = made("F", clean[0] * RANGE_DN) / RANGE_DN
    places = set()
    for item in range(10):
        noisy = np.asarray(pairs[item]["input"])
        found = [
            (y, x)
            for y in range(25)
            for x in range(33)
            if np.allclose(sensor[:, y : y + 16, x : x + 16], noisy, atol=1e-6)
        ]
        assert len(found) == 1
        places |= set(found)
    assert len(places) > 5
    with pytest.raises(ArgumentError, match="calibrate --structure"):
        SyntheticPairs(Arrays(clean, range_dn=RANGE_DN), "SonyA7S2", model=NoiseModel("F"), **options)


# --- refusals, files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LETTERS)
def test_a_component_without_its_figures(name: str) -> None:
    clean = np.zeros((4, 8, 8))
    without: dict[str, Any] = {LETTERS[name]: None}
    for structure in (None, dataclasses.replace(STRUCTURE, **without)):
        with pytest.raises(ArgumentError, match=rf"{name} makes .*structure\.{LETTERS[name]}.*calibrate --structure"):
            made(f"P*+{name}", clean, parameters=dataclasses.replace(EVERY, structure=structure))
    assert made("P*+G*+B+R+U", clean, parameters=PARAMETERS).shape == clean.shape
    made("P*+G*+B+R+U", clean, parameters=EVERY)


def test_components_that_do_not_go_together() -> None:
    with pytest.raises(ArgumentError, match="R and W are two models of the same row noise"):
        parse_components("P*+R+W")
    for name, source in (("C", "column noise"), ("W", "row noise"), ("T", "telegraph pixels")):
        with pytest.raises(ArgumentError, match=f"the frames of D have their own {source}"):
            parse_components(f"P*+D+{name}")
    assert parse_components("P*+F+D").spec == "P*+F+D"  # dark frames know nothing of light
    assert parse_components("U+T+C+W+B+G*+F+P*").spec == "P*+G*+F+B+W+C+T+U"


def test_a_place_is_on_the_sensor() -> None:
    for place in ((0,), (-3, 0), (0.5, 0), "ab", (0, 1 << 20)):
        with pytest.raises(ArgumentError, match="place is the row and column"):
            made("F", np.zeros((4, 8, 8)), place=place)


def test_a_profile_keeps_its_figures(tmp_path: Path) -> None:
    plain = CameraProfile.load("SonyA7S2")
    loud = dataclasses.replace(STRUCTURE, gain_dn_per_e=4.0, iso=None, row_spectrum=None, telegraph=None)
    profile = dataclasses.replace(plain, structure=(STRUCTURE, loud))
    profile.save(tmp_path / "camera.json")
    assert CameraProfile.load(tmp_path / "camera.json") == profile
    assert json.loads((tmp_path / "camera.json").read_text(encoding="utf-8"))["schema"] == 3
    switching = dataclasses.replace(CameraProfile.load("SonyA7S2-PMN"), structure=(STRUCTURE,))
    switching.save(tmp_path / "modes.json")
    assert CameraProfile.load(tmp_path / "modes.json") == switching
    assert "structure" not in plain.as_dict()
    generator = np.random.default_rng(0)
    assert profile.sample(generator, gain_dn_per_e=1.0).structure == STRUCTURE
    assert profile.sample(generator, gain_dn_per_e=3.0).structure == loud
    assert plain.sample(generator).structure is None
    assert switching.measured(800).structure == STRUCTURE


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("prnu",), -0.1, r"structure\[0\].prnu: expected a finite number.*-0.1"),
        (("gain_dn_per_e",), 0, r"structure\[0\].gain_dn_per_e"),
        (("telegraph", "share"), 2.0, r"structure\[0\].telegraph.share: .*share and a duty from 0 to 1"),
        (("row_spectrum", "edges_per_row"), [0.2, 0.1, 0.3, 0.5], r"row_spectrum.power_dn2: .*ascending edges"),
        (("row_spectrum", "waves"), [{"frequency_per_row": 0.7, "amplitude_dn": 1}], "frequency between 0 and 0.5"),
        (("stripes",), 1, "stripes: is unknown"),
    ],
)
def test_a_wrong_figure_of_a_file_is_named(place: tuple[str, ...], value: Any, words: str, tmp_path: Path) -> None:
    profile = dataclasses.replace(CameraProfile.load("SonyA7S2"), structure=(STRUCTURE,))
    data: Any = json.loads(json.dumps({"schema": 3} | profile.as_dict()))
    inner = data["structure"][0]
    for name in place[:-1]:
        inner = inner[name]
    inner[place[-1]] = value
    (tmp_path / "camera.json").write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(ProfileError, match=words):
        CameraProfile.load(tmp_path / "camera.json")
