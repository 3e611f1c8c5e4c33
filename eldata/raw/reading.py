"""Files to :class:`~eldata.records.RawFrame`: decoding by LibRaw, EXIF by exifread. The one decoder of this package.

Which figures are taken
-----------------------
mosaic
    LibRaw's visible area, copied; the file is closed before the function returns. What LibRaw decodes as other pixels
    than are meant is refused (:mod:`eldata.raw.unsupported`).
CFA
    Asked of LibRaw for the visible area's own first sites. rawpy's ``raw_pattern`` counts from the corner of the
    full raw image and is out of phase where a margin is odd. Of quad-Bayer and nona-Bayer the file's own tags: LibRaw
    decodes their pixels as any others, but takes a pattern of 4 x 4 for one of 8 x 2, and of 6 x 6 for X-Trans.
black level
    A DNG's own, exactly, at the sites of the visible area; LibRaw keeps its whole DN, and where an active area starts
    at an odd row or column gives the pattern to the wrong channels. Else LibRaw's per-channel figure: it joins the
    global level and the per-channel offsets, and for bodies without a recorded level it is measured in the masked
    pixels of that very file.
white level
    LibRaw's ``white_level``: the level at which the format saturates, from the file where the file has one (DNG).
    Of a DNG with a proxy of its mosaic, what is stated beside the pixels that are read.
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
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import read_file
from eldata.errors import RawFileError, UnusableRawError
from eldata.raw.damage import border_remarks, check_damage, check_samples
from eldata.raw.exif import RawContainer
from eldata.raw.libraw import check_one_image, check_sizes, opened_raw, visible_cfa
from eldata.raw.sensor_facts import (
    as_shot_multipliers,
    camera_matrix,
    channel_whites,
    dng_black_levels,
    dng_mean_levels,
    dng_white_level,
    masked_remarks,
    opcode_remarks,
)
from eldata.raw.stated import StatedFile
from eldata.raw.strips import find_rows
from eldata.raw.tiff import MASKED_AREAS, is_dng, main_mosaics, read_directories
from eldata.raw.unsupported import NEEDED, refuse_unsupported
from eldata.records import RawFrame, Sensor

if TYPE_CHECKING:
    from fractions import Fraction

    import rawpy

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
    with opened_raw(file.path, file.directories):  # LibRaw knows it
        main = _main(file)
        if main is None:
            return file.header
        levels_dn = dng_mean_levels(main) if is_dng(file.directories) else None  # LibRaw's cost decoding
        return replace(file.header, remarks=_remarks(file, main), levels_dn=levels_dn)


def _main(file: RawContainer) -> Directory | None:
    return next(iter(main_mosaics(file.directories)), None)


def _remarks(file: RawContainer, main: Directory) -> tuple[str, ...]:
    rows = find_rows(file.path, file.directories)
    return opcode_remarks(main) + (() if rows is None else rows.remarks)


def facts_of(path: Path, *, decode: bool) -> tuple[RawHeader, Sensor | RawFileError | None]:
    """Return what :func:`eldata.raw.files.raw_facts` does."""
    file = _container(path)
    header, main = _stated_header(file), _main(file)
    if not decode and (main is None or MASKED_AREAS not in main.values):
        return header, None
    try:
        frame = _frame(file)
    except RawFileError as error:
        return header, error
    return replace(header, remarks=frame.remarks), frame.sensor


def read_raw(path: Path | str | StatedFile) -> RawFrame:
    """Decode a raw file.

    Parameters
    ----------
    path
        The file; of a mosaic without levels of its own, the file with what a card states of it.

    Returns
    -------
    RawFrame
        The visible mosaic, (H, W) uint16 in DN, with sensor and exposure; float32 of an array of floating-point numbers
        whose levels a card states. Exposure fields that the file does not state are ``None`` (:func:`exposure_ratio`
        says which).

    Raises
    ------
    RawFileError
        If the file is missing, empty, truncated, not a raw file, already demosaiced (an RGB raw), without a CFA or
        stored in a way or with a CFA that is not supported, or needs more memory than there is. The message names the
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
    if isinstance(path, StatedFile):
        return path.read()
    return read_file(_decoded, Path(path), RawFileError)


def _decoded(path: Path) -> RawFrame:
    return _frame(_container(path))


def _frame(file: RawContainer) -> RawFrame:
    path, directories, header, main = file.path, file.directories, file.header, _main(file)
    remarks = () if main is None else _remarks(file, main)
    check_samples(path, directories)
    with opened_raw(path, directories) as raw:
        check_sizes(path, raw)
        if main is None:
            check_one_image(path)
        _unpack(file, raw)
        cfa, index_of = visible_cfa(path, raw, main)
        black, white = tuple(float(raw.black_level_per_channel[index]) for index in index_of), float(raw.white_level)
        if main is not None and is_dng(directories):
            if sum(one.is_mosaic for one in directories) > 1:
                # What the image does not state, LibRaw takes from its proxy; by the specification black is 0.
                black, white = (0.0,) * len(index_of), dng_white_level(main)
            stated = dng_black_levels(path, main, raw, cfa)
            black = black if stated is None else stated
            remarks += masked_remarks(main, raw.raw_image, black)
        if not white > max(black):
            raise RawFileError(path, f"white level {white:g} DN is not above the black level {black} DN")
        matrix, illuminant = camera_matrix(raw, directories)
        balance = as_shot_multipliers(path, raw, directories, file.tags)
        mosaic, whites = raw.raw_image_visible.copy(), channel_whites(raw, index_of)
        height, width = mosaic.shape
        sensor = Sensor(header.make, header.model, cfa, black, white, height, width, balance, matrix, illuminant)
    check_damage(path, directories, mosaic, black, white)
    return RawFrame(path, mosaic, sensor, header.exposure, whites, (*remarks, *border_remarks(mosaic)))


def _unpack(file: RawContainer, raw: rawpy.RawPy) -> None:
    """Decode the pixels; refuse those that are no mosaic."""
    import rawpy

    raw.unpack()
    if raw.raw_type != rawpy.RawType.Flat or raw.num_colors == 1:
        shape = raw.raw_image.shape
        kind = "no colour filter array (monochrome)" if len(shape) == 2 else "already demosaiced (an RGB raw)"
        if len(shape) == 3 and file.header.make == "Canon" and not is_dng(file.directories):
            kind = "already demosaiced (Canon's sRAW or mRAW)"
        raise UnusableRawError(file.path, f"{kind}: {shape} samples", NEEDED)


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
