"""Files to :class:`~eldata.records.RawFrame`: decoding by LibRaw, EXIF by exifread. The one decoder of this package.

Which figures are taken
-----------------------
mosaic
    LibRaw's visible area, copied; the file is closed before the function returns.
CFA
    Asked of LibRaw for the visible area's own first sites. rawpy's ``raw_pattern`` counts from the corner of the
    full raw image and is out of phase where a margin is odd.
black level
    A DNG's own BlackLevel, exactly, at the sites of the visible area; LibRaw rounds it, and where an active area starts
    at an odd row or column gives its pattern to the wrong channels. Else LibRaw's per-channel figure: it joins the
    global level and the per-channel offsets, and for bodies without a recorded level it is measured in the masked
    pixels of that very file.
white level
    LibRaw's ``white_level``: the level at which the format saturates, from the file where the file has one (DNG).
    The per-channel ``camera_white_level_per_channel`` is missing for most cameras, comes from LibRaw's table or
    maker notes, and even for a DNG overrides what the file says. It is kept beside, for protocols that name it.
colour matrix
    A DNG's own ColorMatrix (that for D65 if there are two); else LibRaw's table for the model.
white balance
    As shot; a DNG's exactly, LibRaw's float32 to six decimals.
time taken
    EXIF's DateTimeOriginal and SubSecTimeOriginal.
ISO, exposure time, aperture
    EXIF, from the EXIF IFD or IFD0, as fractions; where a format has no EXIF that exifread can read (CR3), LibRaw's
    float32 as the simplest fraction that rounds to it.

What LibRaw does not notice
---------------------------
LibRaw opens some truncated files as whole frames. So the extents that a TIFF-based or RAF file declares must lie
inside it, the file must hold at least one bit per pixel (no lossless code is shorter), and the last row must not
be empty. Damage inside compressed data shows in no field: only a recorded hash finds it (``eldata lock``).

Fork and threads
----------------
Each read tells the OpenMP runtime inside rawpy's wheel to use the calling thread alone. So no thread pool is
left behind for a forked worker to wait for, and reading is safe in DataLoader workers under fork and spawn.
"""

from __future__ import annotations

import ctypes
import math
from contextlib import contextmanager
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import ArgumentError, RawFileError
from eldata.raw.cfa import packed_channels
from eldata.raw.damage import check_damage
from eldata.raw.exif import check_raf, exif_tags, header_of, positive
from eldata.raw.tiff import ACTIVE_AREA, BLACK_DELTAS, BLACK_LEVEL, BLACK_REPEAT, read_directories
from eldata.records import RawFrame, Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from fractions import Fraction

    import rawpy

    from eldata.raw.exif import Tags
    from eldata.raw.tiff import Directory
    from eldata.records import Matrix3, RawHeader

_D65 = 21


def read_header(path: Path | str) -> RawHeader:
    """Read camera and exposure of a raw file without decoding its pixels.

    The file must be one that LibRaw opens, and hold all that it declares.

    Raises
    ------
    RawFileError
        If the file is missing, empty, truncated or not a raw file.
    """
    path = _existing(path)
    read_directories(path)  # refuses a file that does not hold what it declares
    with opened_raw(path) as raw:
        return header_of(path, raw, exif_tags(path))


def read_raw(path: Path | str) -> RawFrame:
    """Decode a raw file.

    Returns
    -------
    RawFrame
        The visible mosaic, (H, W) uint16 in DN, with sensor and exposure. Exposure fields that the file does not
        state are ``None`` (:func:`exposure_ratio` says which).

    Raises
    ------
    RawFileError
        If the file is missing, empty, truncated, not a raw file, already demosaiced (an RGB raw), without a CFA or
        with one that is neither Bayer nor X-Trans. The message names the file and the reason.
    """
    import rawpy

    path = _existing(path)
    directories = read_directories(path)
    with opened_raw(path) as raw:
        tags = exif_tags(path)
        raw.unpack()
        header = header_of(path, raw, tags)
        if raw.raw_type != rawpy.RawType.Flat or raw.num_colors == 1:
            shape = raw.raw_image.shape
            kind = "no colour filter array" if len(shape) == 2 else "already demosaiced (an RGB raw)"
            raise RawFileError(path, f"{kind}: {shape} samples; a mosaic of a Bayer or X-Trans sensor is needed")
        cfa, index_of = _cfa(path, raw)
        mosaic = raw.raw_image_visible.copy()
        black = _dng_black_level(path, raw, directories, cfa) or tuple(
            float(raw.black_level_per_channel[index]) for index in index_of
        )
        white = float(raw.white_level)
        if not white > max(black):
            raise RawFileError(path, f"white level {white:g} DN is not above the black level {black} DN")
        channel_whites = _channel_whites(raw, index_of)
        sensor = Sensor(
            make=header.make,
            model=header.model,
            cfa=cfa,
            black_level_dn=black,
            white_level_dn=white,
            height=mosaic.shape[0],
            width=mosaic.shape[1],
            white_balance=_white_balance(raw, tags),
            xyz_to_camera=_xyz_to_camera(raw, tags),
        )
        raw_pixels = raw.sizes.raw_height * raw.sizes.raw_width
    size = path.stat().st_size
    if size * 8 < raw_pixels:
        raise RawFileError(path, f"truncated: {size} bytes cannot hold {raw_pixels} pixels")
    check_damage(path, directories, mosaic, black, white)
    return RawFrame(path, mosaic, sensor, header.exposure, channel_whites)


def exposure_ratio(reference: RawFrame | RawHeader, noisy: RawFrame | RawHeader) -> Fraction:
    """Return (ISO * t) of the reference over (ISO * t) of the noisy frame, exactly.

    Raises
    ------
    RawFileError
        If one of the files does not state its ISO or exposure time; the message says which.
    """
    return _exposure_product(reference) / _exposure_product(noisy)


def _exposure_product(frame: RawFrame | RawHeader) -> Fraction:
    for name, value in (("ISO", frame.exposure.iso), ("exposure time", frame.exposure.exposure_s)):
        if value is None:
            raise RawFileError(frame.path, f"states no {name}: neither EXIF nor IFD0 nor LibRaw has it")
    return frame.exposure.iso * frame.exposure.exposure_s  # type: ignore[operator] # checked above


# --- opening --------------------------------------------------------------------------------------------------


def _existing(path: Path | str) -> Path:
    path = Path(path)
    if path.is_dir():
        raise RawFileError(path, "is a folder, not a raw file")
    try:
        size = path.stat().st_size
        path.open("rb").close()
    except OSError as error:
        raise RawFileError(path, f"cannot be read: {error.strerror}") from error
    if size == 0:
        raise RawFileError(path, "is empty (0 bytes): copy or download it again")
    return path


@contextmanager
def opened_raw(path: Path, what: str = "decode") -> Iterator[rawpy.RawPy]:
    """Open a raw file with LibRaw, whose errors say that it cannot do ``what``.

    Raises
    ------
    RawFileError
        If LibRaw does not know the file or refuses it, then or inside the block.
    """
    import rawpy

    check_raf(path)
    _set_openmp_threads()(1)  # a setting of the calling thread, so it is made for each read
    # Not rawpy.imread: it warns in every forked process, of what the line above removes.
    raw = rawpy.RawPy()
    try:
        raw.open_file(str(path))
        raw.set_unpack_params(shot_select=0)
        yield raw
    except rawpy.LibRawFileUnsupportedError as error:
        raise RawFileError(path, "is not a raw file that LibRaw knows") from error
    except rawpy.LibRawError as error:
        reason = error.args[0] if error.args else error
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason)
        raise RawFileError(path, f"LibRaw cannot {what} it ({text}); is the file whole?") from error
    finally:
        raw.close()


@cache
def _set_openmp_threads() -> Callable[[int], object]:
    """Return omp_set_num_threads of the runtime that rawpy's wheel brings; or a function that does nothing."""
    import rawpy

    package = Path(rawpy.__file__).parent
    for library in sorted((package.parent / "rawpy.libs").glob("libgomp*")):
        return ctypes.CDLL(str(library)).omp_set_num_threads
    return lambda _: None


# --- sensor ---------------------------------------------------------------------------------------------------


def _cfa(path: Path, raw: rawpy.RawPy) -> tuple[tuple[tuple[int, ...], ...], tuple[int, ...]]:
    """Return the visible area's CFA in our channel indices, and LibRaw's colour index of each of them."""
    names = raw.color_desc.decode("ascii", "replace")
    try:
        pattern = raw.raw_pattern
    except NotImplementedError as error:  # what rawpy raises for a CFA that it has no pattern for
        raise RawFileError(path, f"unsupported colour filter array ({error})") from error
    period = 0 if pattern is None else len(pattern)
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    sites = [[raw.raw_color(top + y, left + x) for x in range(period)] for y in range(period)]
    colours = [[names[index] for index in row] for row in sites]
    flat = sorted(colour for row in colours for colour in row)
    if period == 2 and flat == ["B", "G", "G", "R"]:
        ours = [[{"R": 0, "B": 2}.get(c, 1 if "R" in row else 3) for c in row] for row in colours]
    elif period == 6 and set(flat) == {"R", "G", "B"}:
        ours = [["RGB".index(c) for c in row] for row in colours]
    else:
        raise RawFileError(
            path,
            f"unsupported colour filter array: {period} x {period} of {''.join(flat)}; Bayer or X-Trans is needed",
        )
    rows = tuple(map(tuple, ours))
    try:
        packed_channels(rows)
    except ArgumentError as error:
        raise RawFileError(path, f"unsupported colour filter array {rows}; Bayer or X-Trans is needed") from error
    libraw_index = dict(zip(chain(*ours), chain(*sites), strict=True))
    return rows, tuple(libraw_index[channel] for channel in sorted(libraw_index))


def _dng_black_level(
    path: Path, raw: rawpy.RawPy, directories: Sequence[Directory], cfa: tuple[tuple[int, ...], ...]
) -> tuple[float, ...] | None:
    """Return a DNG's BlackLevel per channel of the visible area; None if LibRaw's figure is to be taken."""
    mosaic = next((d for d in directories if d.is_mosaic and BLACK_LEVEL in d.values), None)
    if mosaic is None or any(tag in mosaic.values for tag in BLACK_DELTAS):  # LibRaw adds the deltas' mean
        return None
    rows, columns = map(int, mosaic.values.get(BLACK_REPEAT, (1, 1)))
    pattern = mosaic.values[BLACK_LEVEL]
    if len(pattern) != rows * columns or not pattern:
        return None
    # The pattern starts at the active area; LibRaw's visible area may start a pixel off it.
    active = mosaic.values.get(ACTIVE_AREA, (0, 0))
    top, left = raw.sizes.top_margin - int(active[0]), raw.sizes.left_margin - int(active[1])
    levels: dict[int, set[float]] = {}
    period = len(cfa)
    for y in range(math.lcm(period, rows)):
        for x in range(math.lcm(period, columns)):
            level = pattern[(y + top) % rows * columns + (x + left) % columns]
            levels.setdefault(cfa[y % period][x % period], set()).add(float(level))
    if any(len(found) > 1 for found in levels.values()):
        raise RawFileError(path, "its BlackLevel differs between sites of one colour; one level per channel is needed")
    return tuple(levels[channel].pop() for channel in sorted(levels))


def _channel_whites(raw: rawpy.RawPy, index_of: Sequence[int]) -> tuple[float, ...] | None:
    levels = raw.camera_white_level_per_channel
    if levels is None or not all(levels[index] > 0 for index in index_of):
        return None
    return tuple(float(levels[index]) for index in index_of)


def _white_balance(raw: rawpy.RawPy, tags: Tags) -> tuple[float, float, float, float] | None:
    neutral = tags.get("Image Tag 0xC628")  # a DNG's AsShotNeutral: the camera's response to white, exactly
    response = [] if neutral is None else [positive(value) for value in neutral.values]
    if len(response) == 3 and response[0] and response[1] and response[2]:
        return float(response[1] / response[0]), 1.0, float(response[1] / response[2]), 1.0
    red, green, blue, second_green = raw.camera_whitebalance
    if not (red > 0 and green > 0 and blue > 0):
        return None
    # LibRaw keeps float32: six decimals give back the number that the file states.
    values = (red, green, blue, second_green if second_green > 0 else green)
    return tuple(round(float(value) / float(green), 6) for value in values)  # type: ignore[return-value] # of four


def _xyz_to_camera(raw: rawpy.RawPy, tags: Tags) -> Matrix3 | None:
    by_illuminant = {}
    for matrix_tag, illuminant_tag in (("0xC621", "0xC65A"), ("0xC622", "0xC65B")):
        matrix = tags.get(f"Image Tag {matrix_tag}")
        if matrix is not None and len(matrix.values) == 9:
            illuminant = tags.get(f"Image Tag {illuminant_tag}")
            by_illuminant[illuminant.values[0] if illuminant is not None else 0] = [
                float(value) for value in matrix.values
            ]
    if by_illuminant:
        values = np.array(by_illuminant.get(_D65) or list(by_illuminant.values())[-1]).reshape(3, 3)
    else:
        values = np.asarray(raw.rgb_xyz_matrix[:3], dtype=np.float64)
    if not values.any():
        return None
    return tuple(tuple(round(float(value), 6) for value in row) for row in values)  # type: ignore[return-value] # 3x3
