"""Files to :class:`~eldata.records.RawFrame`: decoding by LibRaw, EXIF by exifread. The one decoder of this package.

Which figures are taken
-----------------------
mosaic
    LibRaw's visible area, copied, rows and columns that a DNG interleaves in order; the file is closed before the
    function returns. Floating-point DNGs and JPEG XL are decoded here (:mod:`eldata.raw.strips`), LibRaw says their
    visible area.
CFA
    Asked of LibRaw for the visible area's own first sites. rawpy's ``raw_pattern`` counts from the corner of the
    full raw image and is out of phase where a margin is odd. Of quad-Bayer and nona-Bayer the file's own tags: LibRaw
    decodes their pixels as any others, but takes a pattern of 4 x 4 for one of 8 x 2, and of 6 x 6 for X-Trans.
black level
    A DNG's own, exactly, at the sites of the visible area (:mod:`eldata.raw.black_levels`); LibRaw keeps its whole DN,
    has one mean of all deltas, and where an active area starts at an odd row or column gives the pattern to the wrong
    channels. Else LibRaw's per-channel figure: it joins the global level and the per-channel offsets, and for bodies
    without a recorded level it is measured in the masked pixels of that very file.
white level
    LibRaw's ``white_level``: the level at which the format saturates, from the file where the file has one (DNG).
    Of floats, JPEG XL, and a DNG with several CFA images, what is stated beside the pixels that are read.
    The per-channel ``camera_white_level_per_channel`` is missing for most cameras, comes from LibRaw's table or
    maker notes, and even for a DNG overrides what the file says. It is kept beside, for protocols that name it.
colour matrix
    A DNG's own ColorMatrix, exactly (of two that for D65, else the first for another daylight, else the second, as
    LibRaw chooses); else LibRaw's table for the model, which is for D65.
white balance
    As shot; a DNG's exactly, LibRaw's float32 to six decimals.
time taken
    EXIF's DateTimeOriginal and SubSecTimeOriginal; ``None`` if the clock was never set.
orientation
    Not applied: the mosaic stands as the sensor was read out, whichever way up the camera was held, so that two
    frames of a pair lie on each other.
camera, ISO, exposure time, aperture
    What the file states, exactly: EXIF, or what a format has in its place (:mod:`eldata.raw.exif`). ``None`` where it
    states none: LibRaw's figures are not taken, because it makes some up.

What LibRaw does not notice
---------------------------
LibRaw opens some truncated files as whole frames. So the extents that a TIFF-based or RAF file declares must lie
inside it, and the file must hold at least one bit per pixel (no lossless code is shorter). It also decodes files that
lost a part of their data, which are searched for what shows (:mod:`eldata.raw.damage`); only a recorded hash finds the
rest (``eldata lock``).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eldata.base.files import read_file
from eldata.errors import ArgumentError, RawFileError, UnusableRawError
from eldata.raw.black_levels import TAKING_PIXELS, BlackLevel, VisibleArea, check_black_counts, dng_black_level
from eldata.raw.damage import check_damage, check_samples, check_streams
from eldata.raw.exif import RawContainer
from eldata.raw.libraw import check_sizes, count_images, opened_raw, stated_cfa, stated_images, visible_cfa
from eldata.raw.sensor_facts import (
    as_shot_multipliers,
    camera_matrix,
    channel_whites,
    directory_remarks,
    dng_white_level,
    image_remarks,
)
from eldata.raw.stated import StatedFile
from eldata.raw.strips import read_stored
from eldata.raw.tiff import read_directories
from eldata.raw.unsupported import NEEDED, refuse_unsupported
from eldata.records import RawFrame, Sensor

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    import rawpy
    from numpy.typing import NDArray

    from eldata.raw.cfa import CfaRows
    from eldata.raw.tiff import Directory
    from eldata.records import RawHeader


def read_header(path: Path | str | StatedFile) -> RawHeader:
    """Read camera and exposure of a raw file without decoding its pixels.

    The file must be one that LibRaw opens, and hold all that it declares; or a mosaic of which a card states the rest.

    Raises
    ------
    RawFileError
        If the file is missing, empty, truncated or not a raw file, or needs more memory than there is.
    """
    if isinstance(path, StatedFile):
        return path.header
    return read_file(_header, Path(path), RawFileError)


def _header(path: Path) -> RawHeader:
    return _stated_header(_container(path))


def _container(path: Path) -> RawContainer:
    """Return what a file's container states, of a file that is not known not to work."""
    directories = read_directories(path)
    refuse_unsupported(path, directories)
    return RawContainer(path, directories)


def _stated_header(file: RawContainer) -> RawHeader:
    with opened_raw(file.path, file.directories) as raw:
        return _header_of(file, stated_images(raw, file.directories) or (None,), 0)


def _header_of(file: RawContainer, images: Sequence[Directory | None], image: int) -> RawHeader:
    header, main = file.header, _chosen(file.path, images, image)
    if main is not None and file.is_dng:
        check_black_counts(file.path, main)
    return replace(header, remarks=(*directory_remarks(file.path, main), *image_remarks(len(images), image)))


def facts_of(path: Path, *, decode: bool) -> tuple[RawHeader, Sensor | RawFileError | None]:
    """Return what :func:`eldata.raw.files.raw_facts` does."""
    file = _container(path)
    header = _stated_header(file)
    if not decode and not any(set(TAKING_PIXELS) & one.values.keys() for one in file.directories):
        return header, None
    try:
        frame = _frame(file, 0)
        if decode:
            check_streams(path, file.directories)
    except RawFileError as error:
        return header, error
    return replace(header, remarks=frame.remarks), frame.sensor


def read_raw(path: Path | str | StatedFile, *, image: int = 0) -> RawFrame:
    """Decode a raw file.

    Parameters
    ----------
    path
        The file; of a mosaic without levels of its own, the file with what a card states of it.
    image
        Which one, counted from 0, of a file that holds several of one size, such as the four of a pixel shift.

    Returns
    -------
    RawFrame
        The visible mosaic, (H, W) in DN, with sensor and exposure: uint16, or float32 of a floating-point DNG. Exposure
        fields that the file does not state are ``None`` (:func:`exposure_ratio` says which).

    Raises
    ------
    RawFileError
        If the file is missing, empty, truncated, not a raw file, already demosaiced (an RGB raw), without a CFA or
        with one that is not supported, or has no such image; or needs more memory than there is. The message names the
        file and the reason.

    Examples
    --------
    >>> from eldata.raw import read_raw
    >>> frame = read_raw("eldata-demo/data/ELD-demo/DemoAlpha/scene-1/IMG_0004.dng")
    >>> frame.mosaic.shape, frame.mosaic.dtype
    ((512, 768), dtype('uint16'))
    >>> frame.sensor.model, frame.sensor.black_level_dn, frame.sensor.white_level_dn
    ('Demo Alpha', (512.0, 512.0, 512.0, 512.0), 16383.0)
    >>> frame.exposure.iso, frame.exposure.exposure_s
    (Fraction(800, 1), Fraction(1, 200))
    """
    if image < 0:
        raise ArgumentError(f"image counts from 0; found {image}")
    if isinstance(path, StatedFile):
        return path.read()
    return read_file(partial(_decoded, image=image), Path(path), RawFileError)


def _decoded(path: Path, *, image: int) -> RawFrame:
    return _frame(_container(path), image)


def _frame(file: RawContainer, image: int) -> RawFrame:
    path, directories = file.path, file.directories
    check_samples(path, directories)
    with opened_raw(path, directories, image=image) as raw:
        tags = file.tags
        check_sizes(path, raw, directories)
        images = stated_images(raw, directories) or (None,) * count_images(path)
        main = _chosen(path, images, image)
        sizes = raw.sizes
        size = sizes.raw_height, sizes.raw_width
        if main is None and any(one.is_float and one.shape == size for one in directories):
            raise UnusableRawError(path, "its pixels are floating-point numbers, and no mosaic by its tags", NEEDED)
        if main is None and any(one.is_jpeg_xl and one.shape == size for one in directories):
            raise UnusableRawError(path, "already demosaiced (an RGB raw in JPEG XL), or no mosaic by its tags", NEEDED)
        header = _header_of(file, images, image)
        ours = main is not None and (main.is_float or main.is_jpeg_xl)
        stored = _stored_pixels(path, raw, main) if main and ours else _stored_by_libraw(file, raw, main, header)
        area = VisibleArea(sizes.top_margin, sizes.left_margin, (sizes.height, sizes.width), stored.cfa)
        pixels = _in_place(path, raw, stored.pixels, main)
        mosaic, white = area.of(pixels).copy(), stored.white_dn
        levels = dng_black_level(path, main, area, pixels) if main is not None and file.is_dng else None
        levels = levels or BlackLevel(stored.black_dn)
        black = levels.level_dn
        if not white > max(black):
            raise RawFileError(path, f"white level {white:g} DN is not above the black level {black} DN")
        decoder = None if ours else raw  # whatever LibRaw is asked, it decodes the pixels first
        matrix, illuminant = camera_matrix(decoder, directories)
        balance = as_shot_multipliers(path, decoder, directories, tags)
        make, model, (height, width) = header.make, header.model, area.shape
        sensor = Sensor(make, model, stored.cfa, black, white, height, width, balance, matrix, illuminant)
    check_damage(path, directories, mosaic, black, white)
    mosaic = levels.flatten(mosaic, area)
    return RawFrame(path, mosaic, sensor, header.exposure, stored.channel_whites_dn, (*header.remarks, *levels.remarks))


class _Stored(NamedTuple):
    """All pixels of a file as they are stored, the visible area's CFA, levels in DN: black if the file states none."""

    pixels: NDArray[Any]
    cfa: CfaRows
    black_dn: tuple[float, ...]
    white_dn: float
    channel_whites_dn: tuple[float, ...] | None


def _stored_pixels(path: Path, raw: rawpy.RawPy, main: Directory) -> _Stored:
    stated = stated_cfa(raw, main)
    if stated is None:
        raise RawFileError(path, "states no colour filter array that can be used, and LibRaw does not know it")
    cfa, index_of = stated
    return _Stored(read_stored(path, main), cfa, (0.0,) * len(index_of), dng_white_level(main), None)


def _stored_by_libraw(file: RawContainer, raw: rawpy.RawPy, main: Directory | None, header: RawHeader) -> _Stored:
    import rawpy

    raw.unpack()
    if raw.raw_type != rawpy.RawType.Flat or raw.num_colors == 1:
        shape = raw.raw_image.shape
        kind = "no colour filter array (monochrome)" if len(shape) == 2 else "already demosaiced (an RGB raw)"
        if len(shape) == 3 and header.make == "Canon" and not file.is_dng:
            kind = "already demosaiced (Canon's sRAW or mRAW)"
        raise UnusableRawError(file.path, f"{kind}: {shape} samples", NEEDED)
    cfa, index_of = visible_cfa(file.path, raw, main)
    black, white = tuple(float(raw.black_level_per_channel[index]) for index in index_of), float(raw.white_level)
    if main is not None and file.is_dng and sum(one.is_mosaic for one in file.directories) > 1:
        # What one of several CFA images does not state, LibRaw takes from another; by the specification black is 0.
        black, white = (0.0,) * len(index_of), dng_white_level(main)
    return _Stored(raw.raw_image, cfa, black, white, channel_whites(raw, index_of))


def exposure_ratio(reference: RawFrame | RawHeader, noisy: RawFrame | RawHeader) -> Fraction:
    """Return (ISO * t) of the reference over (ISO * t) of the noisy frame, exactly.

    Raises
    ------
    RawFileError
        If one of the files does not state its ISO or exposure time; the message says which.

    Examples
    --------
    >>> from eldata.raw import exposure_ratio, read_header
    >>> folder = "eldata-demo/data/ELD-demo/DemoAlpha/scene-1"
    >>> exposure_ratio(read_header(f"{folder}/IMG_0006.dng"), read_header(f"{folder}/IMG_0004.dng"))
    Fraction(100, 1)
    """
    return _exposure_product(reference) / _exposure_product(noisy)


def _exposure_product(frame: RawFrame | RawHeader) -> Fraction:
    for name, value in (("ISO", frame.exposure.iso), ("exposure time", frame.exposure.exposure_s)):
        if value is None:
            raise RawFileError(frame.path, f"states no {name}, and an exposure ratio needs it: use the original file")
    return frame.exposure.iso * frame.exposure.exposure_s  # type: ignore[operator] # checked above


def _chosen(path: Path, images: Sequence[Directory | None], image: int) -> Directory | None:
    if not 0 <= image < len(images):
        raise RawFileError(path, f"has no image {image}: it holds {len(images)}, counted from 0")
    return images[image]


def _in_place(path: Path, raw: rawpy.RawPy, stored: NDArray[Any], main: Directory | None) -> NDArray[Any]:
    """Return what is stored, whose rows and columns may be interleaved, in order."""
    if main is not None and main.interleaved != (1, 1):
        for axis, fields in enumerate(main.interleaved):
            stored = _in_order(stored, fields, axis)
    sizes = raw.sizes
    if stored.shape != (sizes.raw_height, sizes.raw_width):
        raise RawFileError(
            path,
            f"damaged: expected {sizes.raw_height} x {sizes.raw_width} pixels as LibRaw does; found {stored.shape}",
        )
    return stored


def _in_order(stored: NDArray[Any], fields: int, axis: int) -> NDArray[Any]:
    """Return rows or columns in order that are stored field after field, each of which has every ``fields``-th one."""
    size = stored.shape[axis]
    places = np.concatenate([np.arange(first, size, fields) for first in range(fields)])
    return np.take(stored, np.argsort(places), axis)
