"""A dark shading of whole DN, planted in raw files: taken off again, the files are what they were, to the bit."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldata.noise import DarkShading, ShadingIso
from eldata.raw import read_raw, write_dng
from eldata.records import Sensor

STEP = 1 / 32  # DN per ISO in every third pixel: whole DN at multiples of ISO 32


def pattern_of(shape: tuple[int, int], cfa: Any, iso: float) -> NDArray[np.uint16]:
    """Whole DN, which no pixel shares with its neighbours: the line of a pixel and the level of its channel."""
    y, x = np.indices(shape)
    channel = np.asarray(cfa)[y % len(cfa), x % len(cfa)]
    line = ((y + 2 * x) % 3 == 0) * iso * STEP + (5 * y + 3 * x) % 17
    found: NDArray[np.uint16] = (line + 2 * channel + iso // 400).astype(np.uint16)
    return found


def shading_of(sensor: Sensor, isos: Iterable[float], model: str | None = None) -> DarkShading:
    shape = sensor.height, sensor.width
    y, x = np.indices(shape)
    channels = max(map(max, sensor.cfa)) + 1
    return DarkShading(
        camera="Planted",
        source="a test",
        cfa=sensor.cfa,
        isos=tuple(
            ShadingIso(
                iso=iso,
                mode=0,
                frames=9,
                sigma_dn=2.0,
                level_error_dn=tuple(2.0 * channel + iso // 400 for channel in range(channels)),
                standard_error_dn=(0.1,) * channels,
            )
            for iso in isos
        ),
        slope_dn=(((y + 2 * x) % 3 == 0) * np.float32(STEP)).astype(np.float32)[None],
        offset_dn=((5 * y + 3 * x) % 17).astype(np.float32)[None],
        hot=np.zeros(shape, np.bool_),
        model=sensor.model if model is None else model,
    )


def plant(files: Iterable[Path]) -> set[float]:
    """Add the pattern to raw files; return their ISOs."""
    isos = set()
    for path in files:
        raw = read_raw(path)
        iso = float(raw.exposure.iso or 0)
        isos.add(iso)
        write_dng(path, raw.mosaic + pattern_of(raw.mosaic.shape, raw.sensor.cfa, iso), raw.sensor, raw.exposure)
    return isos
