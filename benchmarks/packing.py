"""Packing and normalising one mosaic."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from benchmarks import published
from benchmarks.harness import Row, in_turn
from eldata.raw import pack_normalised, read_raw

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from benchmarks.data import Files

_WHITE_LEVEL_DN = 16383.0


def run(files: Files, rounds: int, _cores: int) -> list[Row]:
    frame = read_raw(files.uncompressed)
    mosaic, sensor = frame.mosaic, frame.sensor
    black = np.array(sensor.black_level_dn, dtype=np.float32)

    def ours(out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        return pack_normalised(mosaic, sensor.cfa, sensor.black_level_dn, _WHITE_LEVEL_DN, out=out)

    def straightforward() -> NDArray[np.float32]:
        return published.pack(mosaic, sensor.cfa_pattern, black)

    reused = straightforward()
    assert np.array_equal(ours(), reused)
    # Packing reads 2 bytes per pixel and writes 4; a copy of 3 bytes per pixel moves as many.
    source = np.zeros(3 * mosaic.size, dtype=np.uint8)
    target = np.ones_like(source)
    timings = in_turn(
        rounds,
        {
            "published": straightforward,
            "new": ours,
            "reused": lambda: ours(reused),
            "filling a new output": lambda: np.full(reused.shape, 0.5, dtype=np.float32),
            "copy of as many bytes": lambda: np.copyto(target, source),
        },
    )
    return [
        timings.faster("new output each time", "new", "published", at_least=12, values="bit-identical"),
        timings.faster("out= reused", "reused", "published", at_least=12, values="bit-identical"),
        timings.cost("new output each time", "new", "filling a new output"),
        timings.cost("out= reused", "reused", "copy of as many bytes"),
    ]
