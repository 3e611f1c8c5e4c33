"""Files to :class:`~eldata.records.RawFrame`: decoding by LibRaw, EXIF by exifread. The one decoder of this package.

Which figures are taken
-----------------------
mosaic
    LibRaw's visible area, copied, rows and columns that a DNG interleaves in order; the file is closed before the
    function returns. Floating-point DNGs are decoded here (:mod:`eldata.raw.strips`), LibRaw says their visible area.
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
    Of floats, and of a DNG with several CFA images, what is stated beside the pixels that are read.
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

Fork and threads
----------------
Each read tells the OpenMP runtime inside rawpy's wheel to use the calling thread alone. So no thread pool is
left behind for a forked worker to wait for, and reading is safe in DataLoader workers under fork and spawn.
"""

from __future__ import annotations

import ctypes
import io
import struct
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eldata.base.isolation import guarded_file
from eldata.errors import ArgumentError, RawFileError, UnusableRawError
from eldata.raw.black_levels import BlackLevel, VisibleArea, check_black_counts, dng_black_level
from eldata.raw.cfa import cfa_from, cfa_of_letters, packing_sites
from eldata.raw.containers import check_container
from eldata.raw.damage import check_damage, check_samples
from eldata.raw.exif import exif_tags, header_of
from eldata.raw.remarks import directory_remarks, image_remarks
from eldata.raw.sensor_facts import (
    as_shot_multipliers,
    camera_matrix,
    channel_whites,
    dng_white_level,
)
from eldata.raw.strips import read_floats
from eldata.raw.tiff import (
    ACTIVE_AREA,
    BLACK_DELTAS,
    CFA_PATTERN,
    COLUMN_INTERLEAVE,
    DNG_VERSION,
    ROW_INTERLEAVE,
    image_directories,
    read_directories,
)
from eldata.raw.unsupported import NEEDED, refuse_unsupported, unsupported_cfa
from eldata.records import RawFrame, Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from fractions import Fraction

    import rawpy
    from numpy.typing import NDArray

    from eldata.raw.cfa import CfaRows
    from eldata.raw.exif import Tags
    from eldata.raw.tiff import Directory
    from eldata.records import RawHeader

_MOST_IMAGES = 16  # of a pixel shift: cameras take up to 16

_Images = tuple["Directory | None", ...]


def read_header(path: Path | str) -> RawHeader:
    """Read camera and exposure of a raw file without decoding its pixels.

    The file must be one that LibRaw opens, and hold all that it declares.

    Raises
    ------
    RawFileError
        If the file is missing, empty, truncated or not a raw file; or, with :func:`eldata.isolation`, if its decoder
        crashes, hangs or needs too much memory.
    """
    return guarded_file(_header, Path(path), RawFileError)


def _header(path: Path) -> RawHeader:
    directories = read_directories(path)
    refuse_unsupported(path, directories)
    with opened_raw(path, directories) as raw:
        return _header_of(path, exif_tags(path), directories, _stated_images(raw, directories) or (None,), 0)


def _header_of(path: Path, tags: Tags, directories: Sequence[Directory], images: _Images, image: int) -> RawHeader:
    main = _chosen(path, images, image)
    if main is not None and _is_dng(directories):
        check_black_counts(path, main)
    remarks = *directory_remarks(main), *image_remarks(len(images), image)
    return replace(header_of(path, tags), remarks=remarks)


def read_raw(path: Path | str, *, image: int = 0) -> RawFrame:
    """Decode a raw file.

    Parameters
    ----------
    path
        The file.
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
        with one that is not supported, or has no such image; or, with :func:`eldata.isolation`, if its decoder
        crashes, hangs or needs too much memory. The message names the file and the reason.

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
    return guarded_file(partial(_decoded, image=image), Path(path), RawFileError)


def _decoded(path: Path, *, image: int) -> RawFrame:
    directories = read_directories(path)
    refuse_unsupported(path, directories)
    check_samples(path, directories)
    with opened_raw(path, directories, image=image) as raw:
        tags = exif_tags(path)
        _check_sizes(path, raw)
        images = _stated_images(raw, directories) or (None,) * count_images(path)
        main = _chosen(path, images, image)
        size = raw.sizes.raw_height, raw.sizes.raw_width
        if main is None and any(one.is_float and one.shape == size for one in directories):
            raise UnusableRawError(path, "its pixels are floating-point numbers, and no mosaic by its tags", NEEDED)
        header = _header_of(path, tags, directories, images, image)
        # Whatever else LibRaw is asked, it decodes the pixels first.
        decoder = None if main is not None and main.is_float else raw
        if main is not None and main.is_float:
            stored = _stored_floats(path, raw, main)
        else:
            stored = _stored_by_libraw(path, raw, main, directories, header)
        sizes = raw.sizes
        area = VisibleArea(sizes.top_margin, sizes.left_margin, (sizes.height, sizes.width), stored.cfa)
        pixels = _in_place(path, raw, stored.pixels, main)
        mosaic, white = area.of(pixels).copy(), stored.white_dn
        levels = dng_black_level(path, main, area, pixels) if main is not None and _is_dng(directories) else None
        levels = levels or BlackLevel(stored.black_dn)
        black = levels.level_dn
        if not white > max(black):
            raise RawFileError(path, f"white level {white:g} DN is not above the black level {black} DN")
        matrix, illuminant = camera_matrix(decoder, directories)
        sensor = Sensor(
            make=header.make,
            model=header.model,
            cfa=stored.cfa,
            black_level_dn=black,
            white_level_dn=white,
            height=mosaic.shape[0],
            width=mosaic.shape[1],
            white_balance=as_shot_multipliers(path, decoder, directories, tags),
            xyz_to_camera=matrix,
            matrix_illuminant=illuminant,
        )
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


def _stored_floats(path: Path, raw: rawpy.RawPy, main: Directory) -> _Stored:
    stated = _stated_cfa(raw, main)
    if stated is None:
        raise RawFileError(path, "states no colour filter array that can be used, and its pixels are floats")
    cfa, index_of = stated
    return _Stored(read_floats(path, main), cfa, (0.0,) * len(index_of), dng_white_level(main), None)


def _stored_by_libraw(
    path: Path, raw: rawpy.RawPy, main: Directory | None, directories: Sequence[Directory], header: RawHeader
) -> _Stored:
    import rawpy

    raw.unpack()
    is_dng = _is_dng(directories)
    if raw.raw_type != rawpy.RawType.Flat or raw.num_colors == 1:
        raise _without_cfa(path, raw.raw_image.shape, header, is_dng=is_dng)
    cfa, index_of = _cfa(path, raw, main)
    black, white = tuple(float(raw.black_level_per_channel[index]) for index in index_of), float(raw.white_level)
    if main is not None and is_dng and sum(one.is_mosaic for one in directories) > 1:
        # What one of several CFA images does not state, LibRaw takes from another; by the specification black is 0.
        black, white = (0.0,) * len(index_of), dng_white_level(main)
    return _Stored(raw.raw_image, cfa, black, white, channel_whites(raw, index_of))


def _without_cfa(path: Path, shape: tuple[int, ...], header: RawHeader, *, is_dng: bool) -> UnusableRawError:
    kind = "no colour filter array (monochrome)" if len(shape) == 2 else "already demosaiced (an RGB raw)"
    if len(shape) == 3 and header.make == "Canon" and not is_dng:
        kind = "already demosaiced (Canon's sRAW or mRAW)"
    return UnusableRawError(path, f"{kind}: {shape} samples", NEEDED)


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


# --- opening --------------------------------------------------------------------------------------------------


def _check_sizes(path: Path, raw: rawpy.RawPy) -> None:
    """Refuse impossible sizes before memory is taken for the pixels."""
    sizes, held = raw.sizes, path.stat().st_size
    raw_pixels = sizes.raw_height * sizes.raw_width
    if held * 8 < raw_pixels:
        raise RawFileError(path, f"truncated: {held} bytes cannot hold {raw_pixels} pixels")
    inside = sizes.top_margin + sizes.height <= sizes.raw_height and sizes.left_margin + sizes.width <= sizes.raw_width
    if not (inside and sizes.height and sizes.width):
        raise RawFileError(
            path,
            f"damaged: its visible area of {sizes.height} x {sizes.width} pixels from {sizes.top_margin}, "
            f"{sizes.left_margin} on does not lie inside its {sizes.raw_height} x {sizes.raw_width} pixels",
        )


def _is_dng(directories: Sequence[Directory]) -> bool:
    return any(DNG_VERSION in directory.values for directory in directories)


def _stated_images(raw: rawpy.RawPy, directories: Sequence[Directory]) -> _Images:
    return image_directories(directories, (raw.sizes.raw_height, raw.sizes.raw_width))


def count_images(path: Path) -> int:
    """Return how many images LibRaw knows in a file of another format; each but the first is decoded for it."""
    import rawpy

    for count in range(1, _MOST_IMAGES):
        raw = rawpy.RawPy()
        try:
            raw.set_unpack_params(shot_select=count)
            _open(raw, path)
            raw.unpack()
        except rawpy.LibRawRequestForNonexistentImageError:
            return count
        except rawpy.LibRawError:  # there is one more, whatever is wrong with it
            return count + 1
        finally:
            raw.close()
    return _MOST_IMAGES


def _chosen(path: Path, images: _Images, image: int) -> Directory | None:
    if not 0 <= image < len(images):
        raise RawFileError(path, f"has no image {image}: it holds {len(images)}, counted from 0")
    return images[image]


def check_libraw_decodes(path: Path, raw: rawpy.RawPy, directories: Sequence[Directory]) -> None:
    """Refuse a DNG whose pixels LibRaw takes for others than they are, for what LibRaw makes of them itself."""
    for main in filter(None, _stated_images(raw, directories)[:1]):
        found = "floating-point or interleaved pixels" if main.is_float or _interleaved(main) != (1, 1) else ""
        if any(len(set(main.values.get(tag, ()))) > 1 for tag in BLACK_DELTAS):
            found = "black levels by row or column"
        if found:
            todo = "pack it and use eldata.isp.Rendering"
            raise UnusableRawError(path, f"has {found}, of which LibRaw makes a wrong picture", todo)


def _interleaved(main: Directory) -> tuple[int, int]:
    return main.number(ROW_INTERLEAVE, 1), main.number(COLUMN_INTERLEAVE, 1)


def _in_place(path: Path, raw: rawpy.RawPy, stored: NDArray[Any], main: Directory | None) -> NDArray[Any]:
    """Return what is stored, whose rows and columns may be interleaved, in order."""
    if main is not None and _interleaved(main) != (1, 1):
        for axis, fields in enumerate(_interleaved(main)):
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


@contextmanager
def opened_raw(
    path: Path, directories: Sequence[Directory], what: str = "decode", image: int = 0
) -> Iterator[rawpy.RawPy]:
    """Open a raw file, whose directories are given, with LibRaw.

    Its errors say that it cannot do ``what``; ``image`` as of :func:`read_raw`.

    Raises
    ------
    RawFileError
        If LibRaw does not know the file or refuses it, then or inside the block.
    """
    import rawpy

    check_container(path)
    _set_openmp_threads()(1)  # a setting of the calling thread, so it is made for each read
    # Not rawpy.imread: it warns in every forked process, of what the line above removes.
    raw = rawpy.RawPy()
    try:
        raw.set_unpack_params(shot_select=image)  # before it is opened: which of a DNG's images, is chosen then
        if any(one.wide_cfa for one in directories):
            raw.open_buffer(io.BytesIO(_with_narrow_cfa(path, directories)))
        else:
            _open(raw, path)
        yield raw
    except rawpy.LibRawFileUnsupportedError as error:
        raise RawFileError(path, "is not a raw file that LibRaw knows") from error
    except rawpy.LibRawError as error:
        reason = error.args[0] if error.args else error
        # "Unsufficient memory" is mostly said of sizes that cannot be, without asking for any.
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason)
        raise RawFileError(path, f"LibRaw cannot {what} it ({text}); is the file whole?") from error
    finally:
        raw.close()


def _with_narrow_cfa(path: Path, directories: Sequence[Directory]) -> bytes:
    """Return a file whose CFAPatterns are of bytes: LibRaw takes the bytes of 16-bit numbers for numbers."""
    content = bytearray(path.read_bytes())
    for one in directories:
        if one.wide_cfa is not None:
            numbers = bytes(min(int(number), 255) for number in one.values[CFA_PATTERN])
            struct.pack_into(f"{one.order}HHI", content, one.wide_cfa, CFA_PATTERN, 1, len(numbers))
            at = one.wide_cfa + 8
            if len(numbers) > 4:
                (at,) = struct.unpack_from(f"{one.order}I", content, at)
            content[at : at + len(numbers)] = numbers
    return bytes(content)


def _open(raw: rawpy.RawPy, path: Path) -> None:
    try:
        raw.open_file(str(path))
    except UnicodeEncodeError:  # rawpy knows names in UTF-8 alone
        with path.open("rb") as file:
            raw.open_buffer(file)


@cache
def _set_openmp_threads() -> Callable[[int], object]:
    """Return omp_set_num_threads of the runtime that rawpy's wheel brings; or a function that does nothing."""
    import rawpy

    package = Path(rawpy.__file__).parent
    for library in sorted((package.parent / "rawpy.libs").glob("libgomp*")):
        return ctypes.CDLL(str(library)).omp_set_num_threads
    return lambda _: None


# --- sensor ---------------------------------------------------------------------------------------------------


def _cfa(path: Path, raw: rawpy.RawPy, main: Directory | None) -> tuple[CfaRows, tuple[int, ...]]:
    """Return the visible area's CFA in our channel indices, and LibRaw's colour index of each of them."""
    stated = None if main is None else _stated_cfa(raw, main)
    if stated is not None and packing_sites(stated[0]).block > 1:
        return stated
    names = raw.color_desc.decode("ascii", "replace")
    try:
        pattern = raw.raw_pattern
    except NotImplementedError as error:  # what rawpy raises for a CFA that it has no pattern for
        raise RawFileError(path, f"unsupported colour filter array ({error})") from error
    period = 0 if pattern is None else len(pattern)
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    sites = [[raw.raw_color(top + y, left + x) for x in range(period)] for y in range(period)]
    letters = ["".join(names[index] for index in row) for row in sites]
    cfa = cfa_of_letters(letters)
    if cfa is None:
        raise unsupported_cfa(path, letters)
    libraw_index = dict(zip(chain(*cfa), chain(*sites), strict=True))
    return cfa, tuple(libraw_index[channel] for channel in sorted(libraw_index))


def _stated_cfa(raw: rawpy.RawPy, main: Directory) -> tuple[CfaRows, tuple[int, ...]] | None:
    """Return what :func:`_cfa` does, from the tags beside the pixels; None if they state none that is supported."""
    whole, names = cfa_of_letters(main.cfa_letters or ()), raw.color_desc.decode("ascii", "replace")
    if whole is None or not set("RGB") <= set(names):
        return None
    # The pattern starts at the active area; LibRaw moves an odd margin on to the next even one.
    top, left = map(int, main.values.get(ACTIVE_AREA, (0, 0))[:2])
    cfa = cfa_from(whole, raw.sizes.top_margin - top, raw.sizes.left_margin - left)
    indices = (names.index("R"), names.index("G"), names.index("B"), names.rindex("G"))
    return cfa, indices[: packing_sites(cfa).levels]
