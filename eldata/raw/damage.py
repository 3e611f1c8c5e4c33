"""Damage that decodes: files whose bytes were lost or overwritten, and which LibRaw nevertheless reads as whole frames.

A download into a file of the final size that breaks off, a power loss or a bad card leave pages of 0x00 or 0xFF instead
of data. No photograph shows such long runs:

in the file's image data (:func:`data_fault`)
    Compressed data have none, unless zero bits stand for "no difference" and an area is clipped.
in the mosaic (:func:`mosaic_fault`)
    0 DN under a black level above 0, or 65535 DN far above white.

Some cameras have rows or columns without picture at the edges (:func:`picture_area`), of 0 DN too: they are no damage.
Each rule is silent where a file might rightly look so. Other damage only a recorded hash finds (``eldata lock``).
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eldata.errors import RawFileError
from eldata.raw import tiff

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.raw.tiff import Directory

_AGAIN = "copy or download it again"

# A sector of a disk, the least that a disk loses, and the same number of pixels. A page in memory has 4096 bytes: at
# least 2048 pixels.
_LEAST_RUN = 512
# In none of LibRaw's codes for it do zero bits stand for equal neighbours.
_NIKON = 34713
_BITS = 8  # of a byte: each sample takes at least one
# Two directories may describe the same image; a file with more is made to keep a reader busy.
_MOST_SHARED = 4
_MOST_BORDER = 8  # a border has at most one of so many parts of a side
_FLAT = 64  # pixels in a row that are alike: there, a code may repeat itself

_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
_SOF3, _DHT, _SOS = 0xC3, 0xC4, 0xDA
_FRAMES = {*range(0xC0, 0xD0)} - {_DHT, 0xC8, 0xCC}
_HEADER = 1 << 16  # bytes to look for a stream's header in: most have some hundred


def check_damage(
    path: Path, directories: Sequence[Directory], mosaic: NDArray[Any], black_dn: Sequence[float], white_dn: float
) -> None:
    """Raise :class:`RawFileError` if a decoded file shows that some of its data were lost.

    Parameters
    ----------
    path
        The file.
    directories
        What :func:`~eldata.raw.tiff.read_directories` found in it: they say where its data are, which are examined too.
    mosaic
        (H, W) uint16 in DN, as decoded.
    black_dn, white_dn
        Black levels and white level in DN.
    """
    rows = _find_rows_between_zeros(mosaic) if min(black_dn) > 0 else slice(0, len(mosaic))
    fault = mosaic_fault(mosaic, black_dn, white_dn) or lost_rows_fault(directories, rows, len(mosaic))
    fault = fault or data_fault(path, directories, mosaic, rows)
    if fault is not None:
        raise RawFileError(path, f"damaged: {fault}; {_AGAIN}")


def check_samples(path: Path, directories: Sequence[Directory]) -> None:
    """Raise :class:`RawFileError` if a lossless JPEG declares more samples than its bytes can code.

    LibRaw decodes as many as are declared, whatever the image's size: 18 kB took it half a minute. Reads headers alone.
    """
    with path.open("rb") as file:
        for _, offset, count in _iter_compressed(path, directories):
            file.seek(offset)
            try:
                stream = find_stream(file.read(min(count, _HEADER)))
            except ValueError:  # damaged: data_fault says how
                continue
            if stream is not None and stream.samples > _BITS * count:
                raise _make_damage_error(path, offset, f"declares {stream.samples} samples in {count} bytes")


# --- the file's image data ------------------------------------------------------------------------------------


class Stream(NamedTuple):
    """The lossless JPEG (ITU-T T.81, process 14) of a strip or tile: what its header says."""

    start: int
    """Where its codes begin."""
    samples: int
    """Rows times columns times components."""
    code: bytes
    """Its bits, components and predictor, as the header has them, without its size."""
    zeros_mean_no_difference: bool
    """Whether zero bits stand for pixels that equal their neighbours, as in clipped areas."""


def find_stream(head: bytes) -> Stream | None:
    """Read the header of the lossless JPEG that begins so; None if it begins as something else, another JPEG included.

    Raises
    ------
    ValueError
        If it begins as a JPEG but its header is damaged; the message says how.
    """
    if not head.startswith(_SOI):
        return None
    at, lossless, size, tables, code = len(_SOI), False, (0, 0, 0), b"", b""
    try:
        while True:
            mark, marker, length = struct.unpack_from(">BBH", head, at)
            body = head[at + 4 : at + 2 + length]
            if mark != 0xFF or length < 2 or len(body) != length - 2:
                raise ValueError(f"has a damaged JPEG header at byte {at}")
            if marker in _FRAMES:
                lossless, size, code = marker == _SOF3, struct.unpack_from(">xHHB", body), body[:1] + body[5:]
            elif marker == _DHT:
                tables += body
            at += 2 + length
            if marker == _SOS:
                if not lossless or body[0] != size[2]:  # components in scans of their own: no camera writes that
                    return None
                first = _first_symbols(tables)
                used = [first[body[2 + 2 * index] >> 4] for index in range(body[0])]
                return Stream(at, size[0] * size[1] * size[2], code + body, 0 in used)
    except (struct.error, IndexError, KeyError) as error:
        raise ValueError(f"has a damaged JPEG header at byte {at}") from error


def _first_symbols(tables: bytes) -> dict[int, int]:
    """Read the first symbol of each Huffman table, by the table's number."""
    first = {}
    while tables:
        counts = tables[1:17]
        symbols = tables[17 : 17 + sum(counts)]
        if len(counts) != 16 or not symbols or len(symbols) != sum(counts):
            raise ValueError("has a damaged Huffman code in its JPEG header")
        first[tables[0] & 15] = symbols[0]
        tables = tables[17 + sum(counts) :]
    return first


def _iter_compressed(path: Path, directories: Sequence[Directory]) -> Iterator[tuple[Directory, int, int]]:
    """Yield directory, offset and length of each strip or tile of compressed data, of previews too."""
    left = _MOST_SHARED * path.stat().st_size
    for directory in directories:
        for offset, count in directory.extents if directory.compression != tiff.UNCOMPRESSED else ():
            if min(offset, count) < 0:  # a preview's: of the raw image it is refused before
                continue
            left -= count
            if left < 0:
                raise RawFileError(path, f"damaged: its image data share the same bytes; {_AGAIN}")
            yield directory, offset, count


def _make_damage_error(path: Path, offset: int, what: str) -> RawFileError:
    """Make the error that image data are damaged, with their offset in bytes and the fault."""
    return RawFileError(path, f"damaged: its image data, from byte {offset} of the file on, {what}; {_AGAIN}")


def data_fault(
    path: Path, directories: Sequence[Directory], mosaic: NDArray[Any], rows: slice = slice(None)
) -> str | None:
    """Describe what shows that some compressed data of a TIFF-based file were lost; None if nothing does.

    ``mosaic``: (H, W) uint16 as decoded: whether it has clipped areas decides what its data may look like. ``rows``:
    within a border's rows of zeros. Lost data decode to zeros; in a lossless JPEG they repeat the value before them.

    Raises
    ------
    RawFileError
        If the header of a strip's JPEG is damaged.
    """
    # What says that it is compressed and is as large as if it were not, is not.
    small = [directory for directory in directories if not directory.held >= 2 * directory.pixels > 0]
    with path.open("rb") as file:
        for directory, offset, count in _iter_compressed(path, small):
            file.seek(offset)
            content = np.frombuffer(file.read(count), np.uint8)
            try:
                stream = find_stream(content[:_HEADER].tobytes())
            except ValueError as error:
                if directory.is_mosaic:
                    raise _make_damage_error(path, offset, str(error)) from error
                continue  # a preview
            if directory.is_mosaic and directory.compression == tiff.JPEG and content[: len(_SOI)].tobytes() != _SOI:
                raise _make_damage_error(path, offset, "does not begin as a JPEG")
            # CR2 does not say which of its images is the mosaic; no preview is a lossless JPEG.
            if not directory.is_mosaic and stream is None:
                continue
            start = 0 if stream is None else stream.start
            run = _lost_run(content[start:])
            sure = directory.compression == _NIKON if stream is None else not stream.zeros_mean_no_difference
            if run is not None and (sure or not _has_flat_area(mosaic[rows] if stream is None else mosaic)):
                first, behind = run
                return (
                    f"its image data, at byte {offset + start + first} of the file, has {behind - first} bytes of "
                    f"0x{int(content[start + first]):02X} in a row, which cannot be code"
                )
    return None


def _lost_run(codes: NDArray[np.uint8]) -> tuple[int, int] | None:
    """Find where a long run of 0x00 or 0xFF begins and ends, but for what fills a strip up behind its last marker."""
    for value in (0, 0xFF):
        run = long_run(codes, value)
        if run is not None and not (run[1] == len(codes) and codes[: run[0]][-2:].tobytes() == _EOI):
            return run
    return None


def _has_flat_area(mosaic: NDArray[Any]) -> bool:
    """Whether many pixels in a row equal the nearest of their colour, to the left or above."""
    for alike in (mosaic[:, 2:] == mosaic[:, :-2], mosaic[2:] == mosaic[:-2]):
        whole = alike[:, : alike.shape[1] // _FLAT * _FLAT].reshape(len(alike), -1, _FLAT)
        if whole.all(axis=2).any():
            return True
    return False


def long_run(values: NDArray[Any], value: int) -> tuple[int, int] | None:
    """Find where the first run of at least 512 equal values begins, and the position behind it.

    Reads little of an array (n,) without such a run.
    """
    size = _LEAST_RUN // 2  # so that a long run covers at least one block
    blocks = values[: len(values) // size * size].reshape(-1, size)
    full = np.flatnonzero(blocks[:, 0] == value)
    full = full[blocks[full, -1] == value]
    full = full[(blocks[full] == value).all(axis=1)]
    if not len(full):
        return None
    for group in np.split(full, np.flatnonzero(np.diff(full) > 1) + 1):
        first, behind = int(group[0]) * size, (int(group[-1]) + 1) * size
        before, after = values[max(0, first - size) : first][::-1] != value, values[behind : behind + size] != value
        first -= int(before.argmax()) if before.any() else len(before)
        behind += int(after.argmax()) if after.any() else len(after)
        if behind - first >= _LEAST_RUN:
            return first, behind
    return None


# --- the mosaic -----------------------------------------------------------------------------------------------


def picture_area(mosaic: NDArray[Any]) -> tuple[slice, slice]:
    """Find the rows and columns of a mosaic (H, W) within a border whose rows and columns are each of one value.

    No border are an edge that is saturated, or clipped at black, and noise too faint to change the DN: there the next
    row or column has the same value in most of its pixels. Nor is what takes an eighth of a side or more.
    """
    rows = _find_inner(mosaic)
    columns = _find_inner(mosaic[rows].T)
    return _find_inner(mosaic[:, columns]), columns  # rows of another value than the columns that cross them


def _find_inner(lines: NDArray[Any]) -> slice:
    """Find the lines between the first and the last one that hold picture."""
    return slice(_count_leading(lines), len(lines) - _count_leading(lines[::-1]))


def _count_leading(lines: NDArray[Any]) -> int:
    """Count the first lines that hold no picture."""
    count, most = 0, len(lines) // _MOST_BORDER
    while count < most and (lines[count] == lines[count][0]).all():
        count += 1
    is_border = 0 < count < most and (lines[count] == lines[count - 1][0]).mean() < 0.5
    return count if is_border else 0


def border_remarks(mosaic: NDArray[Any]) -> tuple[str, ...]:
    """Remark on a border without picture."""
    rows, columns = picture_area(mosaic)
    height, width = mosaic.shape
    lines = {
        "top": mosaic[: rows.start],
        "bottom": mosaic[rows.stop :],
        "left": mosaic[:, : columns.start].T,
        "right": mosaic[:, columns.stop :].T,
    }
    sides = [f"{len(part)} at the {side} (of {part[0, -1]} DN)" for side, part in lines.items() if len(part)]
    if not sides:
        return ()
    area = f"{rows.start}:{rows.stop},{columns.start}:{columns.stop}"
    where = f"{' and '.join(sides)} of its {height} rows and {width} columns"
    return (f"{where} hold no picture: calibrate leaves them out (--crop {area}), scores count them",)


def mosaic_fault(mosaic: NDArray[Any], black_dn: Sequence[float], white_dn: float) -> str | None:
    """Describe what no photograph can show in a mosaic (H, W) in DN, and where; None if nothing is found."""
    if min(black_dn) > 0:
        below = f"0 DN, below the black level {' '.join(f'{level:g}' for level in dict.fromkeys(black_dn))} DN"
        rows, columns = _find_picture(mosaic)
        inner = mosaic[rows, columns]
        if (run := long_run(inner.reshape(-1), 0)) is not None:
            row, column = divmod(run[0], inner.shape[1])
            place = f"row {row + rows.start}, column {column + columns.start}"
            return f"{run[1] - run[0]} pixels in a row, from {place} on, are {below}"
        if not inner[-1].any():
            return f"its last row is all {below}"
    if white_dn < 1 << 15 and (run := long_run(mosaic.reshape(-1), (1 << 16) - 1)) is not None:
        row, column = divmod(run[0], mosaic.shape[1])
        count = run[1] - run[0]
        return (
            f"{count} pixels in a row, from row {row}, column {column} on, are 65535 DN, far above the white level "
            f"{white_dn:g} DN"
        )
    return None


def _find_picture(mosaic: NDArray[Any]) -> tuple[slice, slice]:
    """Find the picture's area, and with it a single last row or last rows that begin before their first pixel.

    So end files whose last bytes were lost.
    """
    rows, columns = picture_area(mosaic)
    behind = len(mosaic) - rows.stop
    if behind == 1 or (behind and mosaic[rows.stop - 1, -1] == mosaic[-1, -1]):
        rows = slice(rows.start, len(mosaic))
    return rows, columns


def _find_rows_between_zeros(mosaic: NDArray[Any]) -> slice:
    """Find the rows within a border's rows of zeros."""
    rows, _ = _find_picture(mosaic)
    return slice(0 if mosaic[0].any() else rows.start, len(mosaic) if mosaic[-1].any() else rows.stop)


def lost_rows_fault(directories: Sequence[Directory], rows: slice, height: int) -> str | None:
    """Describe rows of zeros at an uncompressed mosaic's edge that begin or end with a sector of the disk.

    So do rows that a disk or a download has lost; a border's rows do so by chance, or where all rows are whole sectors.
    """
    for directory in directories:
        stored_height, extents = directory.shape[0], directory.extents
        if not directory.is_mosaic or directory.compression != tiff.UNCOMPRESSED or not extents or stored_height <= 0:
            continue
        row_bytes = directory.held // stored_height
        first = min(extents)[0] + directory.corner()[0] * row_bytes
        for row in {rows.start, rows.stop} - {0, height}:
            if (first + row * row_bytes) % _LEAST_RUN == 0:
                return f"its rows of 0 DN, {'up to' if row == rows.start else 'from'} row {row}, are whole sectors"
    return None
