"""Frames as a protocol takes them: normalised with its levels, or rendered."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.cfa import pack
from eldata.raw.levels import CLIP_RANGES, packed_black_level_dn, packed_frame, with_levels
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Clip, Levels
    from eldata.records import RawFrame


def normalised_frame(frame: RawFrame, levels: Levels, *, clip: Clip, gain: float = 1.0) -> NDArray[np.float32]:
    """Return a frame packed, normalised with a protocol's levels, clipped, amplified and clipped again.

    Parameters
    ----------
    frame
        A decoded frame.
    levels
        As :attr:`eldata.protocols.Protocol.levels` has them; ``metadata-per-channel`` means the frame's one white level
        where LibRaw states none for each channel.
    clip, gain
        As :func:`eldata.raw.levels.pack_normalised` has them.

    Returns
    -------
    ndarray
        (C, h, w) float32.

    Raises
    ------
    ArgumentError
        If the levels or the gain are invalid.
    """
    if levels != "metadata-per-channel":
        return packed_frame(frame, levels=levels, clip=clip, gain=gain)
    whites = frame.channel_white_levels_dn
    if whites is None or len(set(whites)) == 1:
        white = frame.sensor.white_level_dn if whites is None else whites[0]
        leveled = replace(frame, sensor=replace(frame.sensor, white_level_dn=white))
        return packed_frame(leveled, levels="metadata", clip=clip, gain=gain)
    cfa = frame.sensor.cfa
    black = packed_black_level_dn(cfa, frame.sensor.black_level_dn)[:, None, None]
    white_of = packed_black_level_dn(cfa, whites)[:, None, None]  # one level per CFA channel, like black
    if not np.all(white_of > black):
        raise ArgumentError(f"a white level of {whites} DN is not above its black level")
    low, high = (np.float32(limit) for limit in CLIP_RANGES[clip])
    packed = pack(frame.mosaic, cfa).astype(np.float32)
    packed -= black
    packed /= white_of - black
    np.clip(packed, low, high, out=packed)
    if gain != 1.0:
        packed *= np.float32(gain)
        np.clip(packed, low, high, out=packed)
    return packed


def levels_dn(frame: RawFrame, levels: Levels) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the black and the white levels in DN, one per CFA channel, that :func:`normalised_frame` takes."""
    sensor = frame.sensor
    if levels != "metadata-per-channel":
        sensor = with_levels(sensor, levels)
    white = (sensor.white_level_dn,) * len(sensor.black_level_dn)
    whites = frame.channel_white_levels_dn if levels == "metadata-per-channel" else None
    if whites is None or len(set(whites)) == 1:
        return sensor.black_level_dn, white if whites is None else whites[:1] * len(white)
    return sensor.black_level_dn, whites


def less_shading(frame: RawFrame, shading: DarkShading, name: str) -> RawFrame:
    """Return a frame less a dark shading, its mosaic in float32 DN; ``name`` is for messages.

    Raises
    ------
    DatasetError
        As :meth:`eldata.sources.frames.Frame.less` does.
    """
    less = Frame.of_raw(frame.mosaic, frame.sensor, name, frame.exposure).less(shading)
    return replace(frame, mosaic=less.read(slice(None), slice(None)).copy())


def rendered_reference(path: Path) -> NDArray[np.float32]:
    """Return LibRaw's rendering of a raw file, (3, H, W) float32 in [0, 1], of 256 levels.

    Raises
    ------
    RawFileError
        If the file cannot be rendered (:func:`eldata.isp.libraw.render_libraw`).
    """
    from eldata.isp.libraw import render_libraw

    pixels = np.ascontiguousarray(render_libraw(path).transpose(2, 0, 1)).astype(np.float32)
    pixels /= np.float32(255)
    return pixels
