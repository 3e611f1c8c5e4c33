"""One photograph: a raw file in, a denoised DNG out, with the levels, colours and exposure of the camera's file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata import __version__
from eldata.base.files import atomic_write
from eldata.base.numbers import checked_number
from eldata.baselines.classical import BASELINES, SignalNoise
from eldata.baselines.networks import NetworkDenoiser, load_network
from eldata.baselines.noisy_frames import estimate_line, line_of_profile
from eldata.baselines.tiling import tile_bands
from eldata.errors import ArgumentError, DatasetError
from eldata.isp.rendering import brightening, preview
from eldata.manifest.catalogue import carded_names, shipped_card
from eldata.manifest.own import name_camera
from eldata.noise.profile import CameraProfile, profile_of
from eldata.raw.dng import write_dng
from eldata.raw.levels import Clip, FrameLevels, packed_area, packed_black_level_dn, packed_shape, packing_sites, unpack
from eldata.raw.reading import read_header, read_raw
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from eldata.baselines.tiling import Read, Values
    from eldata.records import RawFrame

METHODS = tuple(name for name, baseline in BASELINES.items() if baseline.uses_noise)
"""The denoisers of :data:`~eldata.baselines.BASELINES` that a photograph can be given to."""

_CLEANEST_DB, _NOISIEST_DB = 50.0, 5.0  # inputs of the network's training, and where it is known to gain
_SHOWN = 800  # packed pixels a side of a picture before and after
_ROWS = 256  # packed, that are read at once to find the noise


def denoise(
    frame: RawFrame, profile: CameraProfile | None = None, *,
    method: str = "network", ratio: float = 1.0, levels: FrameLevels = "metadata",
    profile_of_another_camera: bool = False,
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
    profile_of_another_camera
        Whether the profile may be of a camera of another name. A camera's name is its model in EXIF, without spaces,
        or what a set that ships calls it.

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
        If the profile does not know the ISO or is of another camera, the method is unknown, or the ratio is not above
        0.

    Examples
    --------
    >>> from eldata.baselines import denoise
    >>> from eldata.noise import CameraProfile
    >>> from eldata.raw import read_raw
    >>> noisy = read_raw("eldata-demo/data/ELD-demo/DemoAlpha/scene-1/IMG_0012.dng")
    >>> profile = CameraProfile.load("SonyA7S2")  # one's own camera's
    >>> denoise(noisy, profile, ratio=100.0, profile_of_another_camera=True).shape
    (4, 256, 384)
    """
    work = _plan_work(frame, profile, method, ratio, levels, profile_of_another_camera)
    return np.concatenate(list(work.bands()), axis=1)


@dataclass(frozen=True, slots=True)
class _Work:
    """A frame to denoise: how it is read, packed and amplified; what denoises a tile; and what is known of its noise.

    No more of it than a row of tiles is held in memory, beside the mosaic.
    """

    read: Read
    shape: tuple[int, int, int]
    function: Callable[[NDArray[np.float32]], Values]
    sides: dict[str, int]
    noise: SignalNoise | None
    known_from: str

    def bands(self) -> Iterator[NDArray[np.float32]]:
        """Yield the denoised frame in bands of rows, from top to bottom."""
        return tile_bands(self.function, self.read, self.shape[1:], **self.sides)


def _plan_work(
    frame: RawFrame, profile: CameraProfile | None, method: str, ratio: float, levels: FrameLevels, another: bool
) -> _Work:
    """Choose what denoises a frame, and find its noise."""
    noisy = Frame.of_decoded(frame).with_levels(levels)
    shape = _, height, width = packed_shape(noisy.shape, noisy.cfa)
    checked_number("ratio", ratio, above=0)
    if method not in METHODS:
        network = _load_network(method)
        read = partial(_read_packed, noisy, network.clip or "none", ratio)
        sides = {"tile": network.tile, "overlap": network.overlap, "multiple": network.multiple}
        return _Work(read, shape, network.run, sides, None, "known to the network alone")
    read, baseline = partial(_read_packed, noisy, "none", ratio), BASELINES[method]
    if profile is not None:
        is_own = profile.camera.casefold() in _name_camera(frame.sensor.model)
        if not is_own:
            profile_of(frame.sensor.model or "that the file does not name", (profile,), another=another)
        iso = float(frame.exposure.iso or 0) or None
        noise = line_of_profile(profile, noisy.name, iso, ratio=ratio, range_dn=noisy.range_dn)
        known_from = f"by the profile of {profile.camera}{'' if is_own else ', another camera'}"
    elif frame.noise_profile is not None:
        slope, offset = frame.noise_profile
        least = 1 / 12 / noisy.range_dn**2  # rounding to whole DN
        noise = SignalNoise(slope * ratio, max(offset, least) * ratio**2)
        known_from = "as the file's NoiseProfile states it"
    else:
        tops = range(0, height, _ROWS)
        noise = estimate_line(read(slice(top, min(top + _ROWS, height)), slice(0, width)) for top in tops)
        known_from = "estimated from the photograph itself"
    return _Work(read, shape, lambda tile: baseline.function(tile, noise), baseline.sides, noise, known_from)


def _read_packed(frame: Frame, clip: Clip, ratio: float, rows: slice, columns: slice) -> NDArray[np.float32]:
    """Read a part of a frame, packed, normalised and amplified; of X-Trans it begins and ends at even places."""
    area, sites = packed_area(frame.shape, frame.cfa), packing_sites(frame.cfa)
    down, right = (
        slice(first + sites.scale * part.start, first + sites.scale * part.stop)
        for first, part in ((area.top, rows), (area.left, columns))
    )
    return replace(frame, mosaic=frame.read(down, right), cfa=sites.cfa).normalise(clip, ratio)


def _name_camera(model: str) -> set[str]:
    """Name a camera in lower case: by its model, and as the sets that ship do."""
    cards = map(shipped_card, carded_names())
    known = {
        name for card in cards for name, camera in card.cameras.items()
        if model.casefold() in map(str.casefold, camera.models)
    }  # fmt: skip
    return {name.casefold() for name in (*known, name_camera(model))}


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
    profile_of_another_camera: bool = False,
) -> DenoisedFile:  # fmt: skip
    """Denoise a photograph into a DNG with the levels, colours, exposure and time of the camera's file.

    Nothing but pixels changes: they are whole DN of the same scale, with the same black level.

    Parameters
    ----------
    source
        A raw file of a Bayer or X-Trans camera.
    out
        The DNG; its folder must exist. It has the visible area of the source.
    profile, method, ratio, profile_of_another_camera
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
    work = _plan_work(frame, profile, method, ratio, "metadata", profile_of_another_camera)
    mosaic, light = _denoise_mosaic(frame, work, method)
    if picture is not None:
        _write_picture(Path(picture), frame, work, mosaic)
    write_dng(
        path, mosaic, frame.sensor, frame.exposure,
        taken=header.taken, orientation=frame.orientation, software=describe_work(method, ratio, profile),
    )  # fmt: skip
    return DenoisedFile(path, work.known_from, (*frame.remarks, *_remark_on_noise(method, light, work.noise)))


def describe_work(method: str, ratio: float, profile: CameraProfile | None) -> str:
    """Describe in a DNG's Software what :func:`denoise_file` did."""
    told = f", profile of {profile.camera}" if profile is not None else ""
    amplified = f", amplified {ratio:g} times" if ratio != 1 else ""
    return f"eldata {__version__} denoise, {Path(method).name}{told}{amplified}"


def _denoise_mosaic(frame: RawFrame, work: _Work, method: str) -> tuple[NDArray[np.uint16], float]:
    """Denoise a frame into a mosaic in its DN, clipped pixels as they are; return also its mean light, 1 at white."""
    sensor, (height, width) = frame.sensor, frame.mosaic.shape
    area, sites = packed_area((height, width), sensor.cfa), packing_sites(sensor.cfa)
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn)[:, None, None]
    white, top, light = sensor.white_level_dn, area.top, 0.0
    mosaic = np.empty((height, width), np.uint16)
    for band in work.bands():
        if len(band) != sites.channels or not np.isfinite(band).all():
            raise DatasetError(
                f"{frame.path}: {method} made {len(band)} channels of {sites.channels}, or values that are not finite"
            )
        light += float(np.clip(band, 0.0, 1.0).sum(dtype=np.float64))
        dn = np.multiply(band, white - black, out=band)  # in its place, for less memory
        dn += black
        part = unpack(np.rint(np.clip(dn, 0.0, white, out=dn), out=dn).astype(np.uint16), sites.cfa)
        mosaic[top : top + len(part), area.left : area.left + area.width] = part
        top += len(part)
    # Packing leaves out rows and columns at the edges: they get those a period further in, which have their colours.
    for lines, first, count in ((mosaic, area.top, area.height), (mosaic.T, area.left, area.width)):
        behind = first + count
        lines[:first] = lines[sites.period : sites.period + first]
        lines[behind:] = lines[behind - sites.period : len(lines) - sites.period]
    mosaic[frame.mosaic >= white] = np.uint16(white)
    return mosaic, light / (area.height * area.width)


def _remark_on_noise(method: str, light: float, noise: SignalNoise | None) -> tuple[str, ...]:
    """Remark on noise outside of the range for which the network was trained."""
    if method != "network" or noise is None:
        return ()
    noise_db = -10 * float(np.log10(noise.offset + noise.slope * light))
    if _NOISIEST_DB <= noise_db <= _CLEANEST_DB:
        return ()
    how = "less" if noise_db > _CLEANEST_DB else "more"
    remark = (
        f"it has {how} noise ({noise_db:.0f} dB below white) than the photographs that the network was made for "
        f"({_NOISIEST_DB:g} to {_CLEANEST_DB:g} dB): compare before you keep it"
    )
    return (remark,)


def _write_picture(path: Path, frame: RawFrame, work: _Work, mosaic: NDArray[np.uint16]) -> None:
    """Write the middle of a photograph, before and after, side by side."""
    from PIL import Image

    # Even places, as X-Trans is read.
    middle = [slice(max(0, (side - _SHOWN) // 4 * 2), (side + _SHOWN) // 4 * 2) for side in work.shape[1:]]
    middle = [slice(part.start, min(part.stop, side)) for part, side in zip(middle, work.shape[1:], strict=True)]
    after = Frame.of_decoded(replace(frame, mosaic=mosaic))
    shown = [work.read(*middle), _read_packed(after, "none", 1.0, *middle)]
    factor = brightening(shown[1])
    pixels = np.concatenate([preview(packed * factor, frame.sensor) for packed in shown], axis=1)
    with atomic_write(path) as file:
        Image.fromarray(pixels).save(file, format="PNG")
