"""Is a raw file compressed with loss? What its TIFF directories say; other formats do not say it where we can read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.raw.tiff import COMPRESSION, read_directories

if TYPE_CHECKING:
    from pathlib import Path

_SONY, _LOSSY_JPEG = 32767, 34892


def lossy_compression(path: Path) -> str | None:
    """Return what loses data in a raw file, in words, or ``None`` if nothing known does.

    Known are Sony's compressed ARW 2 (one byte per pixel: 11 of 14 bits by a curve, differences within 16 pixels) and
    the lossy JPEG of DNG. Nikon's lossy NEF says so in its maker notes alone, Canon's CRAW in a container that is not
    TIFF: the gaps that such compression leaves between the values show it
    (:func:`eldata.calibration.audit.frame_checks.missing_codes`).

    Raises
    ------
    RawFileError
        If the file is truncated.
    """
    for directory in read_directories(path):
        if not directory.is_mosaic:
            continue
        compression = directory.values.get(COMPRESSION, ())
        held = sum(count for _, count in directory.extents)
        if _SONY in compression and held == directory.pixels:
            return "Sony's lossy compression (choose uncompressed raw in the camera)"
        if _LOSSY_JPEG in compression:
            return "a DNG's lossy JPEG compression (convert from the original without it)"
    return None
