"""Which levels normalise a frame: the file's own, or those that the published results were made with."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, get_args

from eldata.errors import DatasetError, check_choice
from eldata.raw.cfa import pack_normalised

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from eldata.raw.cfa import Clip
    from eldata.records import RawFrame, Sensor

# Choices of the white level, with the file's black level.
Levels = Literal["metadata", "published"]
LEVELS: tuple[Levels, ...] = get_args(Levels)

# Choices of both levels: those above, and the constants of one camera.
FrameLevels = Literal[Levels, "sid-sony", "sid-fuji"]
FRAME_LEVELS: tuple[FrameLevels, ...] = get_args(FrameLevels)

# The ELD and SID code divide by this white level for every camera, whatever its real one (ELD repository,
# sid_dataset.py; SID repository, test_Sony.py and test_Fuji.py).
PUBLISHED_WHITE_LEVEL_DN = 16383.0

# Black and white level that the SID code has for every file of a camera (the same places). The ELD code takes the black
# level of a Bayer file from the file, and that of X-Trans from here.
SID_LEVELS_DN: dict[str, tuple[float, float]] = {
    "sid-sony": (512.0, PUBLISHED_WHITE_LEVEL_DN),
    "sid-fuji": (1024.0, PUBLISHED_WHITE_LEVEL_DN),
}


def white_level_dn(sensor: Sensor, levels: Levels) -> float:
    """Return the white level in DN: the file's (``"metadata"``) or 16383 (``"published"``).

    Raises
    ------
    ArgumentError
        If ``levels`` is unknown.
    """
    check_choice("levels", levels, LEVELS)
    return sensor.white_level_dn if levels == "metadata" else PUBLISHED_WHITE_LEVEL_DN


def with_levels(sensor: Sensor, levels: FrameLevels) -> Sensor:
    """Return a sensor with the chosen black and white level.

    ``"metadata"``: the file's own. ``"published"``: white is 16383, black is the file's, per CFA channel.
    ``"sid-sony"`` (512 and 16383) and ``"sid-fuji"`` (1024 and 16383): the constants of the SID code, for comparison
    with numbers that were made with it.

    Raises
    ------
    ArgumentError
        If ``levels`` is unknown.
    """
    check_choice("levels", levels, FRAME_LEVELS)
    if levels == "metadata" or levels == "published":  # spelt out so that mypy narrows the type
        return replace(sensor, white_level_dn=white_level_dn(sensor, levels))
    black, white = SID_LEVELS_DN[levels]
    return replace(sensor, black_level_dn=(black,) * len(sensor.black_level_dn), white_level_dn=white)


def check_in_dn(name: str, sensor: Sensor, what: str) -> None:
    """Refuse a file that holds floating-point shares of white, for what is in DN.

    Raises
    ------
    DatasetError
        If its white level is 1 or less.
    """
    if sensor.white_level_dn <= 1:
        raise DatasetError(
            f"{name}: its white level is {sensor.white_level_dn:g}, so it holds shares of white and no DN, and {what} "
            "is in DN; use files that hold the sensor's numbers"
        )


def check_white_in_dn(name: str, sensor: Sensor, white_level_dn: float) -> None:
    """Refuse such a file for a white level that is not its own; raises like :func:`check_in_dn`."""
    if white_level_dn != sensor.white_level_dn:
        check_in_dn(name, sensor, f'a white level of {white_level_dn:g} (not the file\'s own, "metadata")')


def packed_frame(frame: RawFrame, *, levels: FrameLevels, clip: Clip, gain: float = 1.0) -> NDArray[np.float32]:
    """Return a frame packed and normalised, (C, h, w) float32; arguments as of :func:`eldata.raw.cfa.pack_normalised`.

    Raises
    ------
    ArgumentError
        If ``levels``, ``clip`` or ``gain`` is invalid.
    DatasetError
        If the white level is a constant and the file holds shares of white.
    """
    sensor = with_levels(frame.sensor, levels)
    check_white_in_dn(str(frame.path), frame.sensor, sensor.white_level_dn)
    black, white = sensor.black_level_dn, sensor.white_level_dn
    in_floats = frame.mosaic.dtype.kind == "f"
    return pack_normalised(frame.mosaic, sensor.cfa, black, white, clip=clip, gain=gain, corrected=in_floats)
