"""Raw files that this package cannot use, by name and with what to do: said before LibRaw misreads or refuses them.

A mosaic is one plane of whole numbers in order, with one black level for each channel of its CFA. What the DNG
specification (1.7.1) allows beyond that is refused here: LibRaw does not decode it, or as other pixels than are meant.
LibRaw also takes the colours of a declared pattern of 4 x 4 for one of 8 x 2: it may come out as Bayer.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from eldata.base.numbers import counted
from eldata.errors import UnusableRawError
from eldata.raw import tiff
from eldata.raw.levels import cfa_of_letters

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eldata.raw.container import RawContainer
    from eldata.raw.tiff import Directory

NEEDED = "a mosaic of a Bayer, quad-Bayer, nona-Bayer or X-Trans sensor is needed"

_STATE = "state them in the mosaics of its set's card (docs/adding-a-dataset.md)"
_ARRAY = ("is an array, which states no colour filter array and neither black nor white level", _STATE)
_BY_HEAD = {
    b"\x93NUM": _ARRAY,
    b"MATL": _ARRAY,
    b"\x89HDF": _ARRAY,
    b"FOVb": ("is a Sigma X3F, whose Foveon sensor has no colour filter array", NEEDED),
    b"\xff\xd8\xff": ("is a JPEG picture whatever its name says", "use the raw file that the camera wrote with it"),
    b"PK\x03\x04": ("is a ZIP archive (Capture One's EIP is one)", "unpack it and use the raw file inside"),
    b"II\x1a\0\0\0HEAPCCDR": ("is a CRW (Canon's CIFF), which has no EXIF", "convert it with Adobe DNG Converter"),
}
_GREY_TIFF = (
    "is a grey TIFF, which states no colour filter array and neither black nor white level",
    f"use the camera's raw file, or {_STATE}",
)
# What only a camera's raw file has in a directory: a DNG's version, a CFA, and Kodak's, Leaf's, Imacon's, Sinar's and
# Hasselblad's own tags, by which LibRaw knows raws that call themselves grey.
_OF_CAMERAS = frozenset(
    (
        *(tiff.DNG_VERSION, tiff.CFA_REPEAT, tiff.CFA_PATTERN, 33405, 33424, *range(34303, 34311), 46275, 46279),
        *(50454, 50455, 50458, 50459, 61450, 64772, 65024, 65026),
    )
)
_GREY = (0, 1)  # of tiff.PHOTOMETRIC: white or black at 0

_WRITE = "read its pixels with tifffile and write a DNG whose mosaic is one uint16 plane (eldata.raw.write_dng)"
_NO_JPEG_XL = "convert it to a DNG of a version before 1.7 (Compatibility in Adobe DNG Converter), which has no JPEG XL"
_NO_DEFLATE = "convert it to one with lossless JPEG compression or without any (Adobe DNG Converter)"
_NO_GPR = "convert it to DNG with GoPro's gpr_tools (gpr_tools -i NAME.GPR -o NAME.DNG; github.com/gopro/gpr)"
# A mosaic's tag; which of its numbers are refused (none: every one but 1, which counts where the tag is not there);
# what is said, what to do.
_REFUSED: tuple[tuple[int, tuple[int, ...], str, str], ...] = (
    (tiff.SAMPLE_FORMAT, (3,), "has pixels that are floating-point numbers (its SampleFormat is {})", _WRITE),
    (tiff.COMPRESSION, (tiff.JPEG_XL,), "has pixels in JPEG XL (its Compression is {})", _NO_JPEG_XL),
    (tiff.COMPRESSION, (8, 32946), "is a DNG of whole numbers in Deflate compression", _NO_DEFLATE),
    (tiff.COMPRESSION, (9,), "is a GPR (GoPro, VC-5 compression)", _NO_GPR),
    (tiff.SAMPLES, (), "has several samples of each pixel, as of dual pixels (its SamplesPerPixel is {})", _WRITE),
    (tiff.ROW_INTERLEAVE, (), "has interleaved rows (its RowInterleaveFactor is {})", _WRITE),
    (tiff.COLUMN_INTERLEAVE, (), "has interleaved columns (its ColumnInterleaveFactor is {})", _WRITE),
    (tiff.CFA_LAYOUT, (), "unsupported colour filter array: its CFALayout is {} (staggered, as a Super CCD's)", NEEDED),
)
_OF_ANY_IMAGE = _REFUSED[:2]  # demosaiced ones too: LibRaw makes other numbers of floats
_CFA_NAMES = {  # by colours that no other kind has
    "CYGM": "CYGM (cyan, yellow, green, magenta), ",
    "W": "RGBW (with white sites), ",
    "E": "RGBE (with emerald sites), ",
}


def refuse_unsupported(container: RawContainer) -> None:
    """Refuse a file that is known not to work, from its first bytes and its directories (of a TIFF-based file).

    Raises
    ------
    UnusableRawError
        If the file is of a kind, a compression, a layout or a colour filter array that cannot be used; it says which.
    """
    path, directories = container.path, container.directories
    for magic, of_kind in _BY_HEAD.items():
        if container.head.startswith(magic):
            raise UnusableRawError(path, *of_kind)
    if _is_grey_tiff(directories):
        raise UnusableRawError(path, *_GREY_TIFF)
    mosaics = tiff.main_mosaics(directories)
    if not mosaics:
        if tiff.is_dng(directories):
            _refuse_layout(path, max(directories, key=lambda image: image.pixels), _OF_ANY_IMAGE)
        return
    main = mosaics[0]
    _refuse_layout(path, main, _REFUSED)
    if len(mosaics) > 1:
        text = f"holds {len(mosaics)} mosaics of one size (PhotometricInterpretation 32803), as of a pixel shift"
        raise UnusableRawError(path, text, _WRITE)
    if tiff.is_dng(directories):
        _refuse_black(path, main)
    pattern = main.cfa_letters  # without one LibRaw's word counts
    monochrome = pattern is not None and len(set("".join(pattern))) == 1  # said of the decoded samples
    if pattern is not None and not monochrome and cfa_of_letters(pattern) is None:
        raise unsupported_cfa(path, pattern)


def _refuse_layout(path: Path, image: Directory, refused: tuple[tuple[int, tuple[int, ...], str, str], ...]) -> None:
    for tag, numbers, text, advice in refused:
        number = image.number(tag, 1)
        if number in numbers or (not numbers and number != 1):
            raise UnusableRawError(path, text.format(number), advice)


def _refuse_black(path: Path, main: Directory) -> None:
    """Refuse a DNG whose black level is not stated by the site of the CFA."""
    levels, expected = main.values.get(tiff.BLACK_LEVEL, ()), math.prod(main.black_repeat)
    if len(levels) not in (0, expected):
        raise UnusableRawError(
            path,
            f"its BlackLevel has {counted(len(levels), 'number')}, expected {expected} by its BlackLevelRepeatDim: "
            "which is of which pixel is not known",
            "write it again with a BlackLevelRepeatDim that fits, such as 2 2 for four levels",
        )
    for tag, name in zip(tiff.BLACK_DELTAS, ("BlackLevelDeltaH", "BlackLevelDeltaV"), strict=True):
        if any(main.values.get(tag, ())):
            raise UnusableRawError(path, f"has a black level that differs by row or column (its {name})", _WRITE)
    if not levels and main.values.get(tiff.MASKED_AREAS):
        raise UnusableRawError(
            path,
            "states no BlackLevel, only the MaskedAreas to measure it in",
            "measure it there and state it (exiftool -SubIFD:BlackLevel=64 NAME.dng, or -IFD0:BlackLevel)",
        )


def _is_grey_tiff(directories: Sequence[Directory]) -> bool:
    """Say whether the largest image of a TIFF-based file is grey, and nothing says that a camera wrote it as raw."""
    largest = max(directories, key=lambda image: image.pixels, default=None)
    by_camera = any(_OF_CAMERAS & directory.entries.keys() for directory in directories)
    if largest is None or not largest.pixels or by_camera:
        return False
    return largest.number(tiff.PHOTOMETRIC, -1) in _GREY


def unsupported_cfa(path: Path, rows: Sequence[str]) -> UnusableRawError:
    """Make the error of a colour filter array, one period of it in letters by row, that cannot be used."""
    colours = "".join(sorted(set("".join(rows))))
    kind = next((name for letters, name in _CFA_NAMES.items() if set(letters) <= set(colours)), "")
    size = f"{len(rows)} x {len(rows[0]) if rows else 0}"
    if (size, colours) == ("8 x 8", "BGR"):
        kind = "as of hexadeca-Bayer, "
    return UnusableRawError(path, f"unsupported colour filter array: {kind}{size} sites of {colours}", NEEDED)
