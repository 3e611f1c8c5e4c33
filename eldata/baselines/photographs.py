"""One photograph: a raw file in, a denoised DNG out, with the levels, colours and exposure of the camera's file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata import __version__
from eldata.base.files import atomic_write
from eldata.base.numbers import checked_number
from eldata.baselines.classical import BASELINES, SignalNoise
from eldata.baselines.networks import load_network
from eldata.baselines.noisy_frames import estimate_line, line_of_profile
from eldata.baselines.tiling import tiled
from eldata.errors import ArgumentError, DatasetError
from eldata.isp.rendering import brightening, preview
from eldata.raw.dng import write_dng
from eldata.raw.levels import packed_area, packed_black_level_dn, packing_sites, unpack
from eldata.raw.reading import read_header, read_raw
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.baselines.networks import NetworkDenoiser
    from eldata.noise.profile import CameraProfile
    from eldata.raw.levels import FrameLevels
    from eldata.records import RawFrame

METHODS = tuple(name for name, baseline in BASELINES.items() if baseline.uses_noise)
"""The denoisers of :data:`~eldata.baselines.BASELINES` that a photograph can be given to."""

_CLEANEST_DB, _NOISIEST_DB = 50.0, 5.0  # inputs of the network's training, and where it is known to gain
_SHOWN = 800  # packed pixels a side of a picture before and after


def denoise(
    frame: RawFrame, profile: CameraProfile | None = None, *,
    method: str = "network", ratio: float = 1.0, levels: FrameLevels = "metadata",
) -> NDArray[np.float32]:  # fmt: skip
    """Return a raw frame without its noise (docs/baselines.md has the methods, and the card of the network).

    Parameters
    ----------
    frame
        As :func:`eldata.raw.read_raw` returns it; of a Bayer camera for ``"network"``.
    profile
        Of its camera; what it says of the frame's ISO is what the method is told, and ``"network"`` takes the colour
        bias off. ``None``: the noise is what the DNG's NoiseProfile states, or else estimated from the frame.
    method
        One of :data:`METHODS`, or a network of yours, as :func:`load_network` takes it, which is told no noise.
    ratio
        What it is amplified by, above 0.
    levels
        As :func:`eldata.evaluate`'s protocols have them: the file's own, or the published constant.

    Returns
    -------
    ndarray
        (C, h, w) float32, packed, black at 0 and white at 1, times the ratio; not clipped.

    Raises
    ------
    DatasetError
        If the frame is not one that the method takes, states no ISO that the profile could be asked for, or without a
        profile does not tell its noise.
    ArgumentError
        If the profile does not know the ISO, the method is unknown, or the ratio is not above 0.

    Examples
    --------
    >>> from eldata.baselines import denoise
    >>> from eldata.noise import CameraProfile
    >>> from eldata.raw import read_raw
    >>> noisy = read_raw("eldata-demo/data/ELD-demo/DemoAlpha/scene-1/IMG_0012.dng")
    >>> denoise(noisy, CameraProfile.load("SonyA7S2"), ratio=100.0).shape  # one's own camera's
    (4, 256, 384)
    """
    return _denoise_packed(frame, profile, method, ratio, levels)[1]


def _denoise_packed(
    frame: RawFrame, profile: CameraProfile | None, method: str, ratio: float, levels: FrameLevels
) -> tuple[NDArray[np.float32], NDArray[np.float32], SignalNoise | None, str]:
    """Denoise a frame; return it packed and amplified, the result, its noise line, and the source of that line."""
    noisy, noise, known_from = Frame.of_decoded(frame).with_levels(levels), None, "known to the network alone"
    checked_number("ratio", ratio, above=0)
    if method not in METHODS:
        network = _load_network(method)
        image = noisy.normalise(network.clip or "none", ratio)
        sides = {"tile": network.tile, "overlap": network.overlap, "multiple": network.multiple}
        return image, tiled(network.run, image, **sides), None, known_from
    image = noisy.normalise("none", ratio)
    if profile is not None:
        iso = float(frame.exposure.iso or 0) or None
        noise = line_of_profile(profile, noisy.name, iso, ratio=ratio, range_dn=noisy.range_dn)
        known_from = f"by the profile of {profile.camera}"
    elif frame.noise_profile is not None:
        slope, offset = frame.noise_profile
        least = 1 / 12 / noisy.range_dn**2  # rounding to whole DN
        noise = SignalNoise(slope * ratio, max(offset, least) * ratio**2)
        known_from = "as the file's NoiseProfile states it"
    else:
        noise, known_from = estimate_line(image), "estimated from the photograph itself"
    return image, np.asarray(BASELINES[method].denoise(image, noise), dtype=np.float32), noise, known_from


def _load_network(model: str) -> NetworkDenoiser:
    """Load a user's network of single frames."""
    if ":" not in model and not Path(model).suffix:
        raise ArgumentError(
            f"no denoiser is called {model!r}; known are {', '.join(METHODS)}, a model's file, and package.module:name"
        )
    network = load_network(model)
    if network.window > 1:
        raise ArgumentError(f"{model} takes windows of {network.window} frames of a clip, and this is a photograph")
    return network


@dataclass(frozen=True, slots=True)
class DenoisedFile:
    """A denoised photograph.

    Attributes
    ----------
    path
        The DNG.
    noise
        Where the noise is known from, in words.
    remarks
        What its user should know, a sentence each.
    """

    path: Path
    noise: str
    remarks: tuple[str, ...]


def denoise_file(
    source: Path | str, out: Path | str, profile: CameraProfile | None = None, *,
    method: str = "network", ratio: float = 1.0, picture: Path | str | None = None,
) -> DenoisedFile:  # fmt: skip
    """Denoise a photograph into a DNG with the levels, colours, exposure and time of the camera's file.

    Nothing but pixels changes: they are whole DN of the same scale, with the same black level.

    Parameters
    ----------
    source
        A raw file of a Bayer or X-Trans camera.
    out
        The DNG; its folder must exist. It has the visible area of the source.
    profile, method, ratio
        As :func:`denoise` has them. What the ratio takes beyond white is clipped.
    picture
        PNG to write, too: the middle before and after, at one brightness.

    Raises
    ------
    RawFileError
        If the source cannot be read, or its pixels are no whole DN.
    DatasetError, ArgumentError
        As :func:`denoise`.
    EldataError
        If a file cannot be written.
    """
    path, header, frame = Path(out), read_header(source), read_raw(source)
    frame.whole_dn("a DNG")
    image, cleaned, noise, known_from = _denoise_packed(frame, profile, method, ratio, "metadata")
    if cleaned.shape != image.shape or not np.isfinite(cleaned).all():
        raise DatasetError(f"{source}: {method} made {cleaned.shape} of {image.shape}, or values that are not finite")
    if picture is not None:
        _write_picture(Path(picture), frame, image, cleaned)
    amplified = f", amplified {ratio:g} times" if ratio != 1 else ""
    software = f"eldata {__version__} denoise, {Path(method).name}{amplified}"
    write_dng(
        path, _round_to_dn(frame, cleaned), frame.sensor, frame.exposure,
        taken=header.taken, orientation=frame.orientation, software=software,
    )  # fmt: skip
    return DenoisedFile(path, known_from, (*frame.remarks, *_remark_on_noise(method, image, noise)))


def _round_to_dn(frame: RawFrame, cleaned: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return packed values as a mosaic in the frame's DN; clipped pixels stay clipped."""
    sensor, (height, width) = frame.sensor, frame.mosaic.shape
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn)[:, None, None]
    white = sensor.white_level_dn
    dn = np.rint(np.clip(black + cleaned * (white - black), 0.0, white)).astype(np.uint16)
    area, period = packed_area((height, width), sensor.cfa), packing_sites(sensor.cfa).period
    # Packing leaves out rows and columns at the edges: they get those a period further in, which have their colours.
    rows, columns = (
        np.where(place < 0, place + period, np.where(place >= length, place - period, place))
        for place, length in ((np.arange(height) - area.top, area.height), (np.arange(width) - area.left, area.width))
    )
    mosaic = unpack(dn, sensor.cfa)[rows[:, None], columns]
    mosaic[frame.mosaic >= white] = np.uint16(white)
    return mosaic


def _remark_on_noise(method: str, image: NDArray[np.float32], noise: SignalNoise | None) -> tuple[str, ...]:
    """Remark on noise outside of the range for which the network was trained."""
    if method != "network" or noise is None:
        return ()
    noise_db = -10 * float(np.log10(np.mean(noise.variance(np.clip(image, 0.0, 1.0)))))
    if _NOISIEST_DB <= noise_db <= _CLEANEST_DB:
        return ()
    how = "less" if noise_db > _CLEANEST_DB else "more"
    remark = (
        f"it has {how} noise ({noise_db:.0f} dB below white) than the photographs that the network was made for "
        f"({_NOISIEST_DB:g} to {_CLEANEST_DB:g} dB): compare before you keep it"
    )
    return (remark,)


def _write_picture(path: Path, frame: RawFrame, before: NDArray[np.float32], after: NDArray[np.float32]) -> None:
    """Write the middle of a photograph, before and after, side by side."""
    from PIL import Image

    middle = tuple(slice(max(0, (side - _SHOWN) // 2), (side + _SHOWN) // 2) for side in after.shape[1:])
    shown = [packed[:, *middle] for packed in (before, after)]
    factor = brightening(shown[1])
    pixels = np.concatenate([preview(packed * factor, frame.sensor) for packed in shown], axis=1)
    with atomic_write(path) as file:
        Image.fromarray(pixels).save(file, format="PNG")
