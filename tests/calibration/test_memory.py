"""What a calibration holds in memory: a few bytes for each pixel of the sensor, however many frames there are."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata.base.workers import Workers
from eldata.calibration import one_iso
from eldata.records import Role
from tests.calibration.in_memory import measured_in_memory
from tests.calibration.simulation import XTRANS, Camera

SMALL = np.random.default_rng(0).normal(512, 3, (5, 256, 256)).astype(np.uint16)
SHAPE = (2064, 3072)  # 6 megapixels: more than those of which all squares are kept


# Bytes per pixel, two a mosaic. In the first pass: the sum 4, the lowest and highest value 4, squares of a seventh of
# the rows 8 / 7; beside them either frames, or what finds the defects: their mask 1, and for each pixel of a channel
# (5/9 of X-Trans are green) its distance from the median twice, 4 each. Two threads hold two frames more, one that
# waits and one that is being decoded: 18.3 to 19.4 in 20 runs, beside other work.
# X-Trans needs most where its flats are compared (18.2).
@pytest.mark.memory
@pytest.mark.parametrize(
    ("cfa", "bias", "jobs", "most"),
    [("Bayer", 5, 1, 16), ("Bayer", 20, 1, 16), ("Bayer", 5, 2, 21), ("X-Trans", 5, 1, 19)],
)
def test_bytes_per_pixel(cfa: str, bias: int, jobs: int, most: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a frame kept out: the comparison with it takes a megapixel, of whatever sensor."""
    monkeypatch.setattr(one_iso, "HOLD_OUT_FROM", 1000)
    camera = Camera(shape=SHAPE) if cfa == "Bayer" else Camera(shape=SHAPE, cfa=XTRANS, bias=(0.0, 0.0, 0.0))
    measured_in_memory(Camera(shape=SMALL[0].shape).sensor, 5, 0, lambda _, number: SMALL[number])  # compiles
    noise = np.rint(np.random.default_rng(0).normal(0.0, 3.0, camera.shape)).astype(np.int16)

    def take(role: Role, number: int) -> NDArray[np.uint16]:
        """A frame that takes no more memory to make than it has; each is another one."""
        mosaic = np.roll(noise, (12 * number, 96 * number), (0, 1))
        if role == "flat":
            mosaic *= number // 2 + 2
            mosaic += 1500 * (number // 2 + 1) + 3 * number
        mosaic += int(camera.black)
        return mosaic.view(np.uint16)

    tracemalloc.start()
    measured_in_memory(camera.sensor, bias, 2, take, Workers(jobs))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert 8 < peak / noise.size < most
