"""The benchmark's sensor: each mechanism found again in its frames, by moments that are written down here."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eldata.demo.sensor import BENCHMARK_SENSORS, SensorDesign, Specimen
from tests.test_architecture import ROOT, below, imports_of

SIDE = 200
PIXELS = SIDE * SIDE
# Beyond this many standard errors a normal deviate lies once in 1.5e6: no test here makes twenty.
SURE = 4.9


def specimen(design: SensorDesign, **other: object) -> Specimen:
    return Specimen(replace(design.with_size(SIDE, SIDE), **other), np.random.default_rng(7))  # type: ignore[arg-type]


def frames(body: Specimen, iso: int, count: int, electrons: float = 0.0) -> np.ndarray:
    return np.stack(
        [body.frame(electrons, 0.001, iso, np.random.default_rng([iso, index])) for index in range(count)]
    ).astype(float)


def test_it_shares_no_code_with_what_is_checked_against_it() -> None:
    """Neither directly nor through what it imports."""
    reached, ahead = set(), {"eldata.demo.sensor"}
    while ahead:
        name = ahead.pop()
        reached.add(name)
        place = ROOT / Path(*name.split("."))
        file = place.with_suffix(".py")
        if file.is_file():
            found = imports_of(ast.parse(file.read_text(encoding="utf-8")), name.rpartition(".")[0])
            ahead |= {one.rpartition(".")[0] for one, runtime in found if runtime} - reached
    assert "eldata.raw.colour" in reached
    assert not [name for name in reached if below(name, "eldata.noise", "eldata.calibration", "eldata.demo.body")]


@pytest.mark.parametrize("design", BENCHMARK_SENSORS, ids=lambda design: design.name)
@pytest.mark.parametrize("iso", [400, 3200])
def test_photons_are_poisson_and_the_gain_is_what_it_says(design: SensorDesign, iso: int) -> None:
    """Photon transfer over two frames: variance over mean of 2000 electrons, less that of the dark, is K.

    The variance of a difference of n pixels has the relative error sqrt(2 / n), of the heavier dark one a little more.
    """
    body = specimen(design)
    light, dark = frames(body, iso, 2, 2000.0), frames(body, iso, 2)
    found = (np.var(light[1] - light[0]) - np.var(dark[1] - dark[0])) / 2 / (light.mean() - dark.mean())
    assert found == pytest.approx(design.gain_dn_per_e(iso), rel=SURE * np.sqrt(2 / PIXELS) * 1.2)


def test_read_noise_is_the_pixels_own_and_heavy_tailed() -> None:
    """Two pairs of frames agree on which pixels are noisy; one difference has more kurtosis than a normal one.

    Of n log-normal scales the mean of exp(4 s^2) - 1 = 0.43 (times 3) is kurtosis, diluted by 1 DN of the ADC; normal
    pixels would give 0 with an error of sqrt(24 / n) = 0.024, and no correlation, with one of 1 / sqrt(n).
    """
    body = specimen(BENCHMARK_SENSORS[0], trap_share=0.0, row_memory=0.0)
    a, b, c, d = frames(body, 3200, 4)
    first, second = np.abs(a - b), np.abs(c - d)
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 2 * SURE / np.sqrt(PIXELS)
    difference = (a - b) - (a - b).mean(axis=1, keepdims=True)
    kurtosis = np.mean(difference**4) / np.mean(difference**2) ** 2 - 3
    assert kurtosis > 2 * SURE * np.sqrt(24 / PIXELS)


def test_traps_make_few_pixels_jump_and_the_same_ones_always() -> None:
    """Of 30 frames, the pixels whose variance is ten times the median's are trapped ones.

    A sound pixel's variance over 30 frames follows chi^2 of 29 over its own; its own spreads by exp(2 * 0.3 z).
    With the spread off, ten times the median lies beyond a probability of 1e-30.
    """
    body = specimen(BENCHMARK_SENSORS[0], read_spread=0.0)
    variance = frames(body, 3200, 30).var(axis=0).ravel()
    jumping = np.flatnonzero(variance > 10 * np.median(variance))
    assert len(jumping) > 50
    assert set(jumping.tolist()) <= set(body.trapped.tolist())
    share = len(body.trapped) / PIXELS
    assert share == pytest.approx(0.02, abs=SURE * np.sqrt(0.02 * 0.98 / PIXELS))


def test_rows_remember_the_row_above() -> None:
    """The row means of a difference have the correlation of the memory from row to row, in 60 x 200 rows."""
    body = specimen(BENCHMARK_SENSORS[1], row_memory=0.6, read_spread=0.0, trap_share=0.0)
    rows = np.diff(frames(body, 3200, 61), axis=0).mean(axis=2)[::2]
    rows -= rows.mean()
    found = np.mean(rows[:, 1:] * rows[:, :-1]) / np.mean(rows**2)
    # The pixels' noise adds (sigma_read^2 + ADC) / columns to a row's variance, which no other row shares.
    mode, gain = body.design.high, body.design.gain_dn_per_e(3200)
    row = (gain * mode.row_e) ** 2
    pixels = ((gain * mode.read_e) ** 2 + body.design.adc_noise_dn**2) / SIDE
    assert found == pytest.approx(0.6 * row / (row + pixels), abs=SURE * 1.5 / np.sqrt(30 * SIDE))


def test_the_conversion_gain_switches() -> None:
    """At the same K the low mode's noise, in electrons, is that of the low mode."""
    design = BENCHMARK_SENSORS[0]
    quiet = {"trap_share": 0.0, "read_spread": 0.0, "row_memory": 0.0}
    low, high = (specimen(design, high_gain_iso=iso, **quiet) for iso in (25600, 200))
    for body, mode in ((low, design.low), (high, design.high)):
        a, b = frames(body, 1600, 2)
        gain = design.gain_dn_per_e(1600)
        expected = gain**2 * (mode.read_e**2 + mode.row_e**2) + design.adc_noise_dn**2 + 1 / 12
        # The rows' share of the variance scatters by sqrt(2 / rows): all of it is allowed that much.
        rows = gain**2 * mode.row_e**2 / expected
        error = np.hypot(np.sqrt(2 / PIXELS), rows * np.sqrt(2 / SIDE))
        assert np.var(a - b) / 2 == pytest.approx(expected, rel=SURE * error)


def test_frames_end_at_zero_and_white() -> None:
    body = specimen(BENCHMARK_SENSORS[0], black_error_dn={3200: (-540.0,) * 4})
    dark = body.frame(0.0, 0.001, 3200, np.random.default_rng(0))
    bright = body.frame(1e6, 0.001, 3200, np.random.default_rng(0))
    assert dark.dtype == np.uint16
    assert (dark == 0).mean() > 0.9
    assert (bright == 16383).all()
