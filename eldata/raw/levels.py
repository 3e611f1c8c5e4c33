"""Which white level normalises a frame: the file's own, or the one that the published results were made with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

from eldata.errors import ArgumentError
from eldata.raw.cfa import pack_normalised

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from eldata.raw.cfa import Clip
    from eldata.records import RawFrame, Sensor

Levels = Literal["metadata", "published"]
LEVELS: tuple[Levels, ...] = get_args(Levels)

# The ELD and SID code divides by this white level for every camera, whatever its real one (ELD repository,
# sid_dataset.py; SID repository, test_Sony.py and test_Fuji.py).
PUBLISHED_WHITE_LEVEL_DN = 16383.0


def white_level_dn(sensor: Sensor, levels: Levels) -> float:
    """Return the white level in DN: the file's (``"metadata"``) or 16383 (``"published"``).

    Raises
    ------
    ArgumentError
        If ``levels`` is neither.
    """
    if levels not in LEVELS:
        raise ArgumentError(f"levels must be one of {', '.join(map(repr, LEVELS))}; found {levels!r}")
    return sensor.white_level_dn if levels == "metadata" else PUBLISHED_WHITE_LEVEL_DN


def packed_frame(frame: RawFrame, *, levels: Levels, clip: Clip, gain: float = 1.0) -> NDArray[np.float32]:
    """Return a frame packed and normalised, (C, h, w) float32 (see :func:`eldata.raw.cfa.pack_normalised`).

    The black level is the file's, per CFA channel, for either choice of ``levels``.
    """
    sensor = frame.sensor
    return pack_normalised(
        frame.mosaic, sensor.cfa, sensor.black_level_dn, white_level_dn(sensor, levels), clip=clip, gain=gain
    )
