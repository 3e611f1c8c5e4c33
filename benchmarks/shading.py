"""A dark shading taken off inputs, against the same without it."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.data import SIZE
from benchmarks.harness import Row, in_turn
from eldata.datasets.crops import Crop
from eldata.noise import DarkShading, ShadingIso
from eldata.raw import bayer_cfa
from eldata.records import Exposure, Sensor
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.data import Files

_ISO = 1600
_SIDE = 512
_CROPS = 16


def run(_files: Files, rounds: int, _cores: int) -> list[Row]:
    generator = np.random.default_rng(0)
    sensor = Sensor("Acme", "Nocturne", bayer_cfa(), (512.0,) * 4, 16383.0, *SIZE)
    one = ShadingIso(
        iso=_ISO, mode=0, frames=9, sigma_dn=2, level_error_dn=(1.0, 2.0, 3.0, 4.0), standard_error_dn=(0.1,) * 4
    )
    shading = DarkShading(
        camera="Nocturne",
        source="",
        cfa=sensor.cfa,
        isos=(one,),
        slope_dn=generator.normal(0, 1e-3, (1, *SIZE)).astype(np.float32),
        offset_dn=generator.normal(0, 1, (1, *SIZE)).astype(np.float32),
        hot=np.zeros(SIZE, np.bool_),
    )
    mosaic = generator.integers(400, 900, SIZE, dtype=np.uint16)
    plain = Frame.of_raw(mosaic, sensor, "frame", Exposure(Fraction(_ISO), Fraction(1)))
    corrected = plain.subtract(shading)
    crops = [Crop.draw(plain, generator, crop=_SIDE, augment=True) for _ in range(_CROPS)]
    whole = Crop.draw(plain, generator, crop=None, augment=False)
    patch, all_of_it = (np.empty(crop.packed_shape, np.float32) for crop in (crops[0], whole))

    def cropped(frame: Frame) -> Callable[[], None]:
        def work() -> None:
            for crop in crops:
                crop.fill(frame, patch, gain=100.0)

        return work

    timings = in_turn(
        rounds,
        {
            "crops as they are": cropped(plain),
            "crops less it": cropped(corrected),
            "whole as it is": lambda: whole.fill(plain, all_of_it, gain=100.0),
            "whole less it": lambda: whole.fill(corrected, all_of_it, gain=100.0),
        },
    )
    return [
        timings.cost(f"{_CROPS} crops of {_SIDE}, turned", "crops less it", "crops as they are"),
        timings.cost("a whole frame of 12 MP", "whole less it", "whole as it is"),
    ]
