"""A dataset's own frames, for scoring, and as protocols take them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.arrays import rgb_frame
from eldata.base.files import inside
from eldata.base.workers import require_files
from eldata.errors import ArgumentError
from eldata.raw.levels import CLIP_RANGES, pack, packed_black_level_dn, packed_frame, with_levels
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.isp.rendering import Response
    from eldata.manifest.catalogue import FrameFiles
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Clip, Levels
    from eldata.raw.stated import StatedFile
    from eldata.records import RawFrame, Sensor


@dataclass(frozen=True, slots=True)
class Originals:
    """A dataset's frames, in its files below an absolute folder."""

    files: FrameFiles

    def of(self, paths: Collection[str]) -> Originals:
        """Return the same for these frames alone: what a worker gets."""
        return Originals(self.files.only(paths))

    def place(self, path: str) -> Path:
        """Return where a frame's file lies.

        Raises
        ------
        ManifestError
            If its path leads out of the folder.
        """
        return inside(self.files.folder, path)

    def require(self, path: str) -> None:
        """Check that this machine sees a frame's file."""
        require_files(self.place(path))

    def raw(self, path: str) -> RawFrame:
        """Return a decoded frame.

        Raises
        ------
        RawFileError
            If it cannot be decoded.
        """
        from eldata.raw.reading import read_raw

        file: Path | StatedFile = self.files.at(path) if path in self.files.stated else self.place(path)
        return read_raw(file)

    def rgb(self, path: str) -> NDArray[np.float32]:
        """Return a frame of preprocessed RGB, (3, h, w) in [0, 1]."""
        return rgb_frame(self.place(path))

    def rendered(self, path: str) -> NDArray[np.float32]:
        """Return LibRaw's rendering of a raw file, (3, H, W) in [0, 1] of 256 levels.

        Raises
        ------
        RawFileError
            If the file cannot be rendered (:func:`eldata.isp.libraw.render_libraw`).
        """
        from eldata.isp.libraw import render_libraw

        pixels = np.ascontiguousarray(render_libraw(self.place(path)).transpose(2, 0, 1)).astype(np.float32)
        pixels /= np.float32(255)
        return pixels


# --- as protocols take them ----------------------------------------------------------------------------------------


def normalised_frame(
    frame: RawFrame, levels: Levels, *, clip: Clip, gain: float = 1.0, reference: Sensor | None = None
) -> NDArray[np.float32]:
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
    reference
        Of a noisy frame: its reference's sensor (:func:`eldata.raw.levels.with_levels`).

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
        return packed_frame(frame, levels=levels, clip=clip, gain=gain, reference=reference)
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


def rendered_frame(packed: NDArray[np.floating[Any]], frame: RawFrame, response: Response) -> NDArray[np.float64]:
    """Return a frame's packed image in sRGB by the ELD paper's pipeline, with the colours that its file states.

    (3, h, w) in [0, 1], of 256 levels, which float32 would move by more than scores are told apart.
    Raises :class:`ArgumentError` as :func:`eldata.isp.rendering.render_to_8_bits` does.
    """
    from eldata.isp.rendering import render_to_8_bits

    return render_to_8_bits(packed, frame.sensor, response=response) / 255.0


def levels_dn(
    frame: RawFrame, levels: Levels, reference: Sensor | None = None
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the black and the white levels in DN, one per CFA channel, that :func:`normalised_frame` takes."""
    sensor = frame.sensor
    if levels != "metadata-per-channel":
        sensor = with_levels(sensor, levels, reference)
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
