"""Files to :class:`~eldata.records.RawFrame`: the one decoder of this package.

Which figures are taken
-----------------------
mosaic
    LibRaw's visible area, copied; the file is closed before the function returns. Pixels that are not compressed are
    read from where tags place them, if LibRaw has confirmed that (:mod:`eldata.raw.mapped`). What LibRaw decodes as
    other pixels than are meant is refused (:mod:`eldata.raw.container`).
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
    What the file states, exactly: EXIF, or what a format has instead (:mod:`eldata.raw.container`). ``None``
    where it states none: LibRaw's figures are not taken, because it makes some up.

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

Remarks
-------
A remark is a sentence that says what was, or was not, done with a file that is read rightly. It is not a problem:
``read_raw`` gives them with the frame, and ``eldata verify`` says each once.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import struct
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import chain, product
from math import isfinite, lcm
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from eldata.base.files import read_file
from eldata.errors import RawFileError, UnusableRawError, check_choice
from eldata.raw import tiff
from eldata.raw.colour import neutral_of_white
from eldata.raw.container import NEEDED, check_container, make_cfa_error, read_container, refuse_unsupported
from eldata.raw.damage import border_remarks, check_damage, check_samples
from eldata.raw.levels import CfaRows, cfa_from, cfa_of_letters, packing_sites
from eldata.raw.mapped import Layout, answer_by_tags, form_of, form_of_tags, verdicts
from eldata.raw.stated import StatedFile
from eldata.records import D65, Matrix3, RawFrame, RawHeader, Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import rawpy
    from numpy.typing import NDArray

    from eldata.raw.container import RawContainer
    from eldata.raw.tiff import Directory

Decoder = Literal["mapped", "libraw"]
DECODER_VARIABLE = "ELDATA_DECODER"
Way = Literal["whole", "short", "tags"]

# By number, DNG specification 1.7.1, chapter 7.
_OPCODES = (
    *("WarpRectilinear", "WarpFisheye", "FixVignetteRadial", "FixBadPixelsConstant", "FixBadPixelsList"),
    *("TrimBounds", "MapTable", "MapPolynomial", "GainMap", "DeltaPerRow", "DeltaPerColumn", "ScalePerRow"),
    *("ScalePerColumn", "WarpRectilinear2"),
)
_NOT_APPLIED = (
    "the mosaic is what the sensor gave, as stored",
    "the mosaic keeps what they would correct, such as lens shading",
    "they are for a demosaiced image",
)
_DAYLIGHT = (1, 4, 20, 22, 23)  # daylight, flash, D55, D75, D50, as EXIF numbers sources of light
_THIRD_MATRIX = 52531


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
    return read_file(lambda path: _read_header(_read_container(path)), Path(path), RawFileError)


def raw_facts(path: Path, *, decode: bool) -> tuple[RawHeader, Sensor | RawFileError | None]:
    """Read a raw file's header and, if it is to be decoded, its sensor, or why it does not decode or is damaged.

    The header has what there is to remark of the file, as far as it is known without its pixels or with them.

    Raises
    ------
    RawFileError
        Like :func:`read_header`.
    """
    return read_file(lambda path: _read_facts(_read_container(path), decode), path, RawFileError)


def _read_facts(file: RawContainer, decode: bool) -> tuple[RawHeader, Sensor | RawFileError | None]:
    """Read a container's header and, if it is to be decoded, its sensor or the error of decoding."""
    header = _read_header(file)
    if not decode:
        return header, None
    try:
        frame = _read_frame(file, prove=True)
    except RawFileError as error:
        return header, error
    return replace(header, remarks=frame.remarks), frame.sensor


def _read_container(path: Path) -> RawContainer:
    """Read a file's container; refuse a truncated or unsupported file."""
    file = read_container(path)
    check_container(file)
    refuse_unsupported(file)
    return file


def _read_header(file: RawContainer) -> RawHeader:
    """Read a header that LibRaw can open too, with its remarks and a DNG's mean black and white level, DN."""
    if verdicts.get(form_of(file)) != "":
        with open_raw(file):  # LibRaw knows it
            pass
    if file.main is None:
        return file.header
    levels_dn = None
    if file.is_dng:  # LibRaw's cost decoding
        black = file.main.values.get(tiff.BLACK_LEVEL) or (0,)
        levels_dn = float(sum(black) / len(black)), dng_white_level(file.main)
    return replace(file.header, remarks=_container_remarks(file), levels_dn=levels_dn)


def read_raw(path: Path | str | StatedFile, decoder: Decoder | None = None) -> RawFrame:
    """Decode a raw file.

    Parameters
    ----------
    path
        The file; of a mosaic without levels of its own, the file with what a card states of it.
    decoder
        Of the pixels. ``"mapped"``: uncompressed ones are read where the file's tags place them, once LibRaw has given
        the same for the first such file of the process; ``"libraw"``: LibRaw always. ``None``: what the environment
        variable ``ELDATA_DECODER`` says, or else ``"mapped"``.

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
    ArgumentError
        If the decoder is unknown.

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
    return read_file(lambda path: _read_frame(_read_container(path), decoder), Path(path), RawFileError)


def open_frame(path: Path | StatedFile) -> tuple[RawFrame, Layout | None]:
    """Open a raw file whose pixels may be left where they are: then their layout is returned, and pixels only of a RAF.

    A file that is read so is not searched for damage. Raises like :func:`read_raw`.
    """
    if isinstance(path, StatedFile):
        return path.read(), None
    return read_file(lambda path: _open_frame(_read_container(path)), path, RawFileError)


def _open_frame(
    file: RawContainer, decoder: Decoder | None = None, *, prove: bool = False
) -> tuple[RawFrame, Layout | None]:
    """Read all but the pixels of a file whose layout LibRaw confirms, of the first of its form here; decode others."""
    chosen = decoder or os.environ.get(DECODER_VARIABLE) or "mapped"
    check_choice("decoder" if decoder else DECODER_VARIABLE, chosen, get_args(Decoder))
    remarks = _container_remarks(file)
    check_samples(file.path, file.directories)
    form, of_tags = (form_of(file), form_of_tags(file)) if chosen == "mapped" else ((), ())
    unproven = [key for key in (form, of_tags) if key and (prove or key not in verdicts)]
    whole: tuple[RawFrame, Layout | None] | None = None
    for key in unproven:
        whole = whole or _decode(file)
        found = _compare(file, *whole, "tags" if key == of_tags else "short")
        verdicts[key] = verdicts.get(key) or found  # one that differs counts for all
    verdict = verdicts.get(form)
    way: Way = "whole" if verdict != "" else "tags" if verdicts.get(of_tags) == "" else "short"
    frame, layout = _decode(file, way)
    frame = replace(frame, remarks=remarks + ((verdict,) if verdict else ()))
    return (frame, layout) if verdict == "" else (_examine(file, frame), None)


def _read_frame(file: RawContainer, decoder: Decoder | None = None, *, prove: bool = False) -> RawFrame:
    """Read a container's mosaic and its sensor's levels and colours; refuse damaged pixels."""
    frame, layout = _open_frame(file, decoder, prove=prove)
    if layout is not None and not frame.mosaic.flags.owndata:
        frame = replace(frame, mosaic=layout.read_whole())
    return frame if layout is None else _examine(file, frame)


def _examine(file: RawContainer, frame: RawFrame) -> RawFrame:
    """Refuse a frame whose pixels show damage; remark on its borders."""
    sensor = frame.sensor
    check_damage(file.path, file.directories, frame.mosaic, sensor.black_level_dn, sensor.white_level_dn)
    return replace(frame, remarks=frame.remarks + border_remarks(frame.mosaic))


def _decode(file: RawContainer, way: Way = "whole") -> tuple[RawFrame, Layout | None]:
    """Decode a frame and lay out what has rows.

    By LibRaw; ``"short"``: but for its pixels, from a copy of few rows; ``"tags"``: so, and of what a DNG states alone.
    A RAF has no short copy, since LibRaw looks its margins up by model and full size: it is decoded.
    """
    path, main, header, rows = file.path, file.main, file.header, file.rows
    short = way == "short" and main is not None
    first = file.directories[0] if file.directories else tiff.Directory({})
    by_tags = nullcontext(answer_by_tags(main)) if way == "tags" and main is not None else None
    with by_tags or open_raw(file, short=short) as raw:
        check_sizes(path, raw)
        if main is None:
            check_one_image(path)
        if by_tags is None:
            _unpack(file, raw)
        cfa, index_of = visible_cfa(path, raw, main)
        black, white = tuple(float(raw.black_level_per_channel[index]) for index in index_of), float(raw.white_level)
        if main is not None and file.is_dng:
            if sum(directory.is_mosaic for directory in file.directories) > 1:
                # What the image does not state, LibRaw takes from its proxy; by the specification black is 0.
                black, white = (0.0,) * len(index_of), dng_white_level(main)
            black = dng_black_levels(path, main, raw, cfa) or black
        if not white > max(black):
            raise RawFileError(path, f"white level {white:g} DN is not above the black level {black} DN")
        matrix, illuminant = camera_matrix(raw, first)
        balance = as_shot_multipliers(raw, first)
        whites, height, width = channel_whites(raw, index_of), raw.sizes.height, raw.sizes.width
        height += rows.main.shape[0] - raw.sizes.raw_height if short and rows is not None else 0
        corner = raw.sizes.top_margin, raw.sizes.left_margin
        is_left = by_tags is not None or short
        mosaic = np.broadcast_to(np.uint16(0), (height, width)) if is_left else raw.raw_image_visible.copy()
    layout = None if rows is None else Layout.of(file, rows, corner, (height, width))
    sensor = Sensor(header.make, header.model, cfa, black, white, height, width, balance, matrix, illuminant)
    noise = _read_noise_profile(main or first, first) if file.is_dng else None
    return RawFrame(path, mosaic, sensor, header.exposure, whites, (), header.orientation, noise), layout


def _compare(file: RawContainer, whole: RawFrame, place: Layout | None, way: Way) -> str:
    """Compare a file as it is mapped with what LibRaw decodes: what differs, or nothing."""
    begin = "its pixels are decoded by LibRaw, not read where its tags place them: "
    try:
        mapped, layout = (whole, place) if file.main is None else _decode(file, way)
        pixels = mapped.mosaic if layout is None else layout.read_whole()
    except RawFileError as error:
        return f"{begin}there, {error.reason}"
    mosaic, levels = whole.mosaic, attrgetter("sensor", "channel_white_levels_dn")
    if layout != place or levels(mapped) != levels(whole) or pixels.shape != mosaic.shape:
        return f"{begin}by its tags alone it has another size, or other levels or colours"
    if (different := pixels != mosaic).any():
        row, column = divmod(int(different.argmax()), mosaic.shape[1])
        found = f"there stand {pixels[row, column]} DN, and LibRaw has {mosaic[row, column]} DN"
        return f"{begin}at row {row}, column {column}, {found}"
    return ""


def _read_noise_profile(mosaic: Directory, first: Directory) -> tuple[float, float] | None:
    """Slope and offset of a DNG's NoiseProfile, averaged over its planes; None if it has no usable one.

    It stands with the raw image, which converters put in a SubIFD, or in the first directory.
    """
    values = mosaic.values.get(tiff.NOISE_PROFILE) or first.values.get(tiff.NOISE_PROFILE, ())
    stated = [float(value) for value in values]
    if not stated or len(stated) % 2 or not all(value >= 0 and isfinite(value) for value in stated):
        return None
    slope, offset = (sum(stated[part::2]) * 2 / len(stated) for part in (0, 1))
    return (slope, offset) if slope + offset > 0 else None


def _unpack(file: RawContainer, raw: rawpy.RawPy) -> None:
    """Decode the pixels; refuse those that are not a mosaic."""
    import rawpy

    raw.unpack()
    if raw.raw_type != rawpy.RawType.Flat or raw.num_colors == 1:
        shape = raw.raw_image.shape
        kind = "no colour filter array (monochrome)" if len(shape) == 2 else "already demosaiced (an RGB raw)"
        if len(shape) == 3 and file.header.make == "Canon" and not file.is_dng:
            kind = "already demosaiced (Canon's sRAW or mRAW)"
        raise UnusableRawError(file.path, f"{kind}: {shape} samples", NEEDED)


def exposure_ratio(reference: RawFrame | RawHeader, noisy: RawFrame | RawHeader) -> Fraction:
    """Compute (ISO * t) of the reference over (ISO * t) of the noisy frame, exactly.

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
    return reference.exposure.product(reference.path) / noisy.exposure.product(noisy.path)


# --- LibRaw -----------------------------------------------------------------------------------------------------------


@contextmanager
def open_raw(file: RawContainer, what: str = "decode", *, short: bool = False) -> Iterator[rawpy.RawPy]:
    """Open a raw file, or a short copy of it, with LibRaw. Its errors say that it cannot do ``what``.

    Raises
    ------
    RawFileError
        If LibRaw does not know the file or refuses it, then or inside the block.
    """
    import rawpy

    _set_openmp_threads()(1)  # a setting of the calling thread, so it is made for each read
    # Not rawpy.imread: it warns in every forked process, of what the line above removes.
    raw = rawpy.RawPy()
    try:
        _open_corrected(raw, file, short=short)
        yield raw
    except rawpy.LibRawFileUnsupportedError as error:
        raise RawFileError(file.path, "is not a raw file that LibRaw knows") from error
    except rawpy.LibRawError as error:
        reason = error.args[0] if error.args else error
        # "Unsufficient memory" is mostly said of sizes that cannot be, without asking for any.
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason)
        raise RawFileError(file.path, f"LibRaw cannot {what} it ({text}); is the file whole?") from error
    finally:
        raw.close()


def _open_corrected(raw: rawpy.RawPy, file: RawContainer, *, short: bool) -> None:
    """Open a file in LibRaw: itself, or a copy that is corrected, or one that is short too.

    LibRaw takes the bytes of a CFAPattern's 16-bit numbers for numbers, and strips for rows that follow one another.
    """
    wide = [image for image in file.directories if image.entries.get(tiff.CFA_PATTERN, (0, 0))[1] == tiff.SHORT]
    rows, descriptor = file.rows, None
    if rows is not None and (short or (file.is_dng and not rows.are_found)):
        content, descriptor = rows.rearrange(file.path, short=short)
    elif wide:
        content = mmap.mmap(-1, file.path.stat().st_size)
        content[:] = file.path.read_bytes()
    else:
        return _open_file(raw, file.path)
    try:
        with content:
            for directory in wide:
                entry, _ = directory.entries[tiff.CFA_PATTERN]
                numbers = bytes(min(int(number), 255) for number in directory.values[tiff.CFA_PATTERN])
                struct.pack_into(f"{directory.order}HHI", content, entry, tiff.CFA_PATTERN, 1, len(numbers))
                at = entry + 8
                if len(numbers) > 4:
                    (at,) = struct.unpack_from(f"{directory.order}I", content, at)
                content[at : at + len(numbers)] = numbers
            if descriptor is None:
                return raw.open_buffer(content)  # type: ignore[arg-type] # it has the method that is called
        raw.open_file(f"/proc/self/fd/{descriptor}")
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _open_file(raw: rawpy.RawPy, path: Path) -> None:
    """Open a file in LibRaw by its path or, if that is not UTF-8, by its content."""
    try:
        raw.open_file(str(path))
    except UnicodeEncodeError:  # rawpy knows names in UTF-8 alone
        with path.open("rb") as file:
            raw.open_buffer(file)


@cache
def _set_openmp_threads() -> Callable[[int], object]:
    """Find omp_set_num_threads of the runtime that rawpy's wheel brings; or a function that does nothing."""
    import rawpy

    package = Path(rawpy.__file__).parent
    for library in sorted((package.parent / "rawpy.libs").glob("libgomp*")):
        return ctypes.CDLL(str(library)).omp_set_num_threads
    return lambda _: None


def check_sizes(path: Path, raw: rawpy.RawPy) -> None:
    """Refuse impossible sizes before memory is taken for the pixels."""
    sizes, held = raw.sizes, path.stat().st_size
    raw_pixels = sizes.raw_height * sizes.raw_width
    if held * tiff.MOST_PIXELS < raw_pixels:
        raise RawFileError(path, f"truncated: {held} bytes cannot hold {raw_pixels} pixels")
    inside = sizes.top_margin + sizes.height <= sizes.raw_height and sizes.left_margin + sizes.width <= sizes.raw_width
    if not (inside and sizes.height and sizes.width):
        raise RawFileError(
            path,
            f"damaged: its visible area of {sizes.height} x {sizes.width} pixels from {sizes.top_margin}, "
            f"{sizes.left_margin} on does not lie inside its {sizes.raw_height} x {sizes.raw_width} pixels",
        )


def check_one_image(path: Path) -> None:
    """Refuse a file whose directories name no mosaic, if LibRaw knows several images in it: a second one is asked for.

    Raises
    ------
    UnusableRawError
        If it does.
    """
    import rawpy

    raw = rawpy.RawPy()
    try:
        raw.set_unpack_params(shot_select=1)  # before it is opened: which of its images, is chosen then
        _open_file(raw, path)
        raw.unpack()
    except rawpy.LibRawRequestForNonexistentImageError:
        return
    except rawpy.LibRawError:  # there is one more, whatever is wrong with it
        pass
    finally:
        raw.close()
    advice = "write the one that you need as a DNG of its own (dnglab convert --image-index 0, for example)"
    raise UnusableRawError(path, "holds several images, as of a pixel shift or of dual pixels", advice)


# --- colour filter array ----------------------------------------------------------------------------------------------


def visible_cfa(path: Path, raw: rawpy.RawPy, main: Directory | None) -> tuple[CfaRows, tuple[int, ...]]:
    """Ask for the visible area's CFA in our channel indices, and LibRaw's colour index of each of them."""
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
        raise make_cfa_error(path, letters)
    libraw_index = dict(zip(chain(*cfa), chain(*sites), strict=True))
    return cfa, tuple(libraw_index[channel] for channel in sorted(libraw_index))


def _stated_cfa(raw: rawpy.RawPy, main: Directory) -> tuple[CfaRows, tuple[int, ...]] | None:
    """CFA as :func:`visible_cfa` has it, from the tags of its image; None if they state none that works."""
    whole, names = cfa_of_letters(main.cfa_letters or ()), raw.color_desc.decode("ascii", "replace")
    if whole is None or not set("RGB") <= set(names):
        return None
    # The pattern starts at the active area; LibRaw moves an odd margin on to the next even one.
    top, left = main.corner()
    cfa = cfa_from(whole, raw.sizes.top_margin - top, raw.sizes.left_margin - left)
    indices = (names.index("R"), names.index("G"), names.index("B"), names.rindex("G"))
    return cfa, indices[: packing_sites(cfa).levels]


# --- levels and colours -----------------------------------------------------------------------------------------------


def dng_white_level(mosaic: Directory) -> float:
    """WhiteLevel of a DNG; where it states none, by the specification the largest number."""
    (white, *_) = mosaic.values.get(tiff.WHITE_LEVEL) or ((1 << mosaic.number(tiff.BITS, 16)) - 1,)
    return float(white)


def dng_black_levels(path: Path, mosaic: Directory, raw: rawpy.RawPy, cfa: CfaRows) -> tuple[float, ...] | None:
    """Black level of each channel of the visible area's CFA that a DNG states; None if it states none.

    BlackLevel is a pattern that counts from the active area's first pixel (DNG specification 1.7.1, chapter 5).

    Raises
    ------
    UnusableRawError
        If the pattern has several levels for sites of one channel.
    """
    if not any(mosaic.values.get(tag) for tag in (tiff.BLACK_LEVEL, *tiff.BLACK_DELTAS)):  # others are refused
        return None
    rows, columns = mosaic.black_repeat
    pattern = mosaic.values.get(tiff.BLACK_LEVEL) or (0,) * (rows * columns)
    period = len(cfa)
    top, left = mosaic.corner()
    down, right = raw.sizes.top_margin - top, raw.sizes.left_margin - left  # LibRaw's area may start a pixel off it
    levels: dict[int, set[float]] = {}
    for y, x in product(range(lcm(period, rows)), range(lcm(period, columns))):
        level = pattern[(y + down) % rows * columns + (x + right) % columns]
        levels.setdefault(cfa[y % period][x % period], set()).add(float(level))
    if any(len(of_channel) > 1 for of_channel in levels.values()):
        raise UnusableRawError(
            path,
            f"its BlackLevel (repeated every {rows} x {columns} pixels) differs between sites of one colour",
            "one level per channel is needed",
        )
    return tuple(levels[channel].pop() for channel in sorted(levels))


def channel_whites(raw: rawpy.RawPy, index_of: Sequence[int]) -> tuple[float, ...] | None:
    """LibRaw's white level per channel of the CFA, given LibRaw's indices of them; None if it has none."""
    levels = raw.camera_white_level_per_channel
    if levels is None or not all(levels[index] > 0 for index in index_of):
        return None
    return tuple(float(levels[index]) for index in index_of)


def as_shot_multipliers(raw: rawpy.RawPy, first: Directory) -> tuple[float, float, float, float] | None:
    """Multipliers of R, G1, B, G2 as shot, G1 = 1; None if they are not known.

    From the ``first`` directory of a DNG; LibRaw is asked for what the file does not state.
    """
    neutral = tuple(map(Fraction, first.values.get(tiff.AS_SHOT_NEUTRAL, ())))
    if len(neutral) == 3 and min(neutral) > 0:
        return float(neutral[1] / neutral[0]), 1.0, float(neutral[1] / neutral[2]), 1.0
    white = _neutral_of_white(first)
    red, green, blue, second_green = raw.camera_whitebalance if white is None else (*1 / white, 0)
    if not (red > 0 and green > 0 and blue > 0):
        return None
    # LibRaw keeps float32: six decimals give back the number that the file states.
    values = (red, green, blue, second_green if second_green > 0 else green)
    return tuple(round(float(value) / float(green), 6) for value in values)  # type: ignore[return-value] # of four


def _neutral_of_white(first: Directory) -> NDArray[np.float64] | None:
    """Camera's response to a DNG's AsShotWhiteXY, in R, G, B; None if its tags do not say it."""

    def read_numbers(tag: int, otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
        """Read a tag in the shape of ``otherwise``, which replaces a missing tag or another count of numbers."""
        values = np.array([float(value) for value in first.values.get(tag, ())])
        return values.reshape(otherwise.shape) if values.size == otherwise.size else otherwise

    white = read_numbers(tiff.AS_SHOT_WHITE_XY, np.zeros(2))
    of_camera, of_profile = ((first.texts.get(tag), first.values.get(tag)) for tag in tiff.SIGNATURES)
    lights = [
        (_illuminant(first, illuminant), matrix, read_numbers(tag if of_camera == of_profile else 0, np.eye(3)))
        for (matrix_tag, illuminant), tag in zip(tiff.COLOUR_MATRICES, tiff.CALIBRATIONS, strict=True)
        if (matrix := read_numbers(matrix_tag, np.zeros((3, 3)))).any()
    ]
    if not white[1] > 0 or not lights or _THIRD_MATRIX in first.entries:
        return None
    neutral = read_numbers(tiff.ANALOG_BALANCE, np.ones(3)) * neutral_of_white(white[0], white[1], lights)
    return neutral if (neutral > 0).all() else None


def camera_matrix(raw: rawpy.RawPy, first: Directory) -> tuple[Matrix3 | None, int]:
    """Matrix from XYZ to the camera's colours, and the light that it is for; None if it is not known.

    Of a DNG's two matrices that for D65, else the first for another daylight, else the second: LibRaw's order.
    """
    stated = [
        (_illuminant(first, illuminant), first.values[matrix])
        for matrix, illuminant in tiff.COLOUR_MATRICES
        if len(first.values.get(matrix, ())) == 9
    ]
    illuminant, numbers = D65, [round(float(value), 6) for row in raw.rgb_xyz_matrix[:3] for value in row]  # its table
    if stated:
        of_d65 = [light for light in stated if light[0] == D65]
        preferred = of_d65 or [light for light in stated if light[0] in _DAYLIGHT]
        illuminant, values = (preferred or stated[-1:])[0]
        numbers = [float(value) for value in values]
    if not any(numbers):
        return None, D65
    x, y, z, *others = numbers
    return ((x, y, z), (others[0], others[1], others[2]), (others[3], others[4], others[5])), illuminant


def _illuminant(first: Directory, tag: int) -> int:
    """Read the number of a source of light; 0, "unknown", if none of 16 bits is stated."""
    number = first.number(tag, 0)
    return number if 0 <= number < 1 << 16 else 0


# --- remarks ----------------------------------------------------------------------------------------------------------


def _container_remarks(file: RawContainer) -> tuple[str, ...]:
    """Remark on each of a mosaic's lists of opcodes, and on byte counts that are too small."""
    if file.main is None:
        return ()
    remarks = [] if file.rows is None else [*file.rows.remarks]
    for number, (tag, meaning) in enumerate(zip(tiff.OPCODE_LISTS, _NOT_APPLIED, strict=True), 1):
        codes = map(int, file.main.values.get(tag, ()))
        names = dict.fromkeys(_OPCODES[code - 1] if 0 < code <= len(_OPCODES) else "unknown" for code in codes)
        if names:
            remarks.append(f"its OpcodeList{number} ({', '.join(names)}) is not applied: {meaning}")
    return tuple(remarks)
