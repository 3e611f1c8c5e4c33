"""Noise on whole mosaics: no pixel left out, rows are mosaic rows, channels get their own bias."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from eldata.noise import NoiseModel, NoiseParameters
from eldata.noise.model import pack_whole, unpack_whole
from tests.cases import in_one_test
from tests.raw.helpers import CFAS, levels_of

RANGE = 15000.0
PARAMETERS = NoiseParameters(1.5, -0.1, 2.0, 3.0, 4.0, (10.0, 20.0, 30.0, 40.0))


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
        noisy = model.on_mosaic(clean, cfa=cfa, parameters=PARAMETERS, ratio=100.0, range_dn=RANGE, generator=generator)
        assert noisy.shape == clean.shape
        return noisy * np.float32(RANGE / 100)

    rows = noise("R")
    assert np.ptp(rows, axis=1).max() == 0
    draws = rows[:, 0].astype(np.float64)
    n = len(draws)
    # 5 standard errors of a standard deviation and of a lag-one correlation.
    assert abs(draws.std() / PARAMETERS.sigma_row_dn - 1) < 5 / np.sqrt(2 * n)
    assert abs(np.corrcoef(draws[1:], draws[:-1])[0, 1]) < 5 / np.sqrt(n)

    bias = noise("B")
    y, x = np.indices(clean.shape)
    index = cfa[y % len(cfa), x % len(cfa)]
    levels = np.array([10.0, 20.0, 30.0, 40.0] if levels_of(CFAS[name]) == 4 else [10.0, 30.0, 30.0])
    np.testing.assert_allclose(bias, levels[index], rtol=1e-5)
