"""Raw files that this package cannot use, by name and with what to do: said before LibRaw misreads or refuses them.

LibRaw takes the colours of a declared pattern of 4 x 4 for one of 8 x 2: it may come out as Bayer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.errors import UnusableRawError
from eldata.raw import tiff
from eldata.raw.cfa import cfa_of_letters
from eldata.raw.strips import check_floats, check_jpeg_xl

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

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
}
_VC5 = 9  # a compression
_GPR = (
    "is a GPR (GoPro, VC-5 compression), which LibRaw cannot decode",
    "convert it to DNG with GoPro's gpr_tools (gpr_tools -i NAME.GPR -o NAME.DNG; github.com/gopro/gpr)",
)
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
_DEFLATE = (8, 32946)
_WHOLE_IN_DEFLATE = (
    "is a DNG of whole numbers in Deflate compression, which LibRaw cannot decode",
    "convert it to one with lossless JPEG compression or without any (Adobe DNG Converter)",
)
_HEXADECA = 4  # sites along a side of its blocks
_LAYOUT_RECTANGULAR = 1


def refuse_unsupported(path: Path, directories: Sequence[Directory]) -> None:
    """Refuse a file that is known not to work, from its first bytes and its directories (of a TIFF-based file).

    Raises
    ------
    UnusableRawError
        If the file is of a kind, a compression or a colour filter array that cannot be used; it says which.
    """
    with path.open("rb") as file:
        head = file.read(4)
    for magic, found in _BY_HEAD.items():
        if head.startswith(magic):
            raise UnusableRawError(path, *found)
    if _is_grey_tiff(directories):
        raise UnusableRawError(path, *_GREY_TIFF)
    for directory in directories:
        if not directory.is_mosaic:
            continue
        if directory.is_float:
            check_floats(path, directory)
        elif directory.is_jpeg_xl:
            check_jpeg_xl(path, directory)
        elif directory.compression in _DEFLATE:
            raise UnusableRawError(path, *_WHOLE_IN_DEFLATE)
        elif directory.compression == _VC5:
            raise UnusableRawError(path, *_GPR)
        layout = directory.number(tiff.CFA_LAYOUT, _LAYOUT_RECTANGULAR)
        if layout != _LAYOUT_RECTANGULAR:
            raise UnusableRawError(
                path,
                f"unsupported colour filter array: its CFALayout is {layout} (staggered rows or columns, such as a "
                "Super CCD's)",
                NEEDED,
            )
        pattern = directory.cfa_letters  # without one LibRaw's word counts
        monochrome = pattern is not None and len(set("".join(pattern))) == 1  # said of the decoded samples
        if pattern is not None and not monochrome and cfa_of_letters(pattern) is None:
            raise unsupported_cfa(path, pattern)


def _is_grey_tiff(directories: Sequence[Directory]) -> bool:
    """Return whether the largest image of a TIFF-based file is grey, and nothing says that a camera wrote it as raw."""
    largest = max(directories, key=lambda one: one.pixels, default=None)
    if largest is None or not largest.pixels or any(one.tags & _OF_CAMERAS for one in directories):
        return False
    return largest.number(tiff.PHOTOMETRIC, -1) in _GREY


def unsupported_cfa(path: Path, rows: Sequence[str]) -> UnusableRawError:
    """Return the error of a colour filter array, one period of it in letters by row, that cannot be used."""
    size, colours = f"{len(rows)} x {len(rows[0]) if rows else 0}", "".join(sorted(set("".join(rows))))
    found = f"unsupported colour filter array: {_kind(rows)}{size} sites of {colours}"
    return UnusableRawError(path, found, NEEDED)


def _kind(rows: Sequence[str]) -> str:
    """Return the name of an unsupported colour filter array with a comma behind it; nothing if it has none."""
    colours = set("".join(rows))
    corners = [row[::_HEXADECA] for row in rows[::_HEXADECA]]
    in_blocks = ["".join(colour * _HEXADECA for colour in row) for row in corners for _ in range(_HEXADECA)]
    if len(corners) == 2 and [*rows] == in_blocks and cfa_of_letters(corners) is not None:
        return f"hexadeca-Bayer (blocks of {_HEXADECA} x {_HEXADECA} sites of one colour), "
    if colours == set("CYGM"):
        return "CYGM (cyan, yellow, green, magenta), "
    if "W" in colours:
        return "RGBW (with white sites), "
    if "E" in colours:
        return "RGBE (with emerald sites), "
    if len(rows) == 4 and rows[0] == rows[2] != rows[1] == rows[3] and rows[0] == rows[1][2:] + rows[1][:2]:
        return "a Super CCD (turned by 45 degrees), "
    return ""
