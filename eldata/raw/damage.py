"""Damage that decodes: files whose bytes were lost or overwritten, and which LibRaw nevertheless reads as whole frames.

A download into a file of the final size that breaks off, a power loss or a bad card leave pages of 0x00 or 0xFF in
place of data. What tells such a frame from a photograph:

in the file's image data (:func:`data_fault`)
    Compressed data have no long runs of one byte, unless zero bits stand for "no difference" and an area is clipped. A
    lossless JPEG allows few bytes behind 0xFF, and ends with a marker.
in the mosaic (:func:`mosaic_fault`)
    Long runs of 0 DN under a black level above 0, or of 65535 DN far above white. The noise, which a photograph has
    everywhere but where it is clipped: pixels that follow each other in exactly equal steps, rows that repeat.
in the codes of a lossless JPEG (:func:`check_streams`)
    Their number: the last pixel must end where the stream ends. This finds most other damage as well, and takes as long
    as decoding, so it is made where a file is to be trusted: ``eldata lock``, ``eldata verify --level full``.

Each rule is silent where a file might rightly look so. What none of them finds (bits that change values and not
lengths, overwritten uncompressed data) only a recorded hash does. docs/raw-files.md has the rates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import RawFileError
from eldata.raw.lossless_jpeg import MOST_HEADER, SOI, Stream, find_stream
from eldata.raw.tiff import ACTIVE_AREA, TILE_HEIGHT, TILE_WIDTH

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path
    from typing import IO

    from numpy.typing import NDArray

    from eldata.raw.tiff import Directory

_AGAIN = "copy or download it again"

# A sector of a disk, the least that a disk loses, and the same number of pixels. A page in memory has 4096 bytes: at
# least 2048 pixels.
_LEAST_RUN = 512
# In none of LibRaw's codes for it do zero bits stand for equal neighbours.
_NIKON = 34713
_UNCOMPRESSED, _JPEG = 1, 7
_BITS = 8  # of a byte: each sample takes at least one
_HEADERS = (1 << 12, MOST_HEADER)  # bytes to look for a stream's header in: most have some hundred
# Two directories may describe the same image; a file with more is made to keep a reader busy.
_MOST_SHARED = 4

# A stretch of one row, in which the differences of pixels 4 apart are compared: they are of one colour, in whatever
# order the components are coded. Noise with a standard deviation of 0.5 DN leaves fewer than half of their second
# differences zero. 20 of a stretch share no pixel, so all are zero with a probability below 2^-20; those of 32
# stretches in a row never are. The same holds for the differences of two rows.
_STRETCH = 64
_LAG = 4
_LEAST_STRETCHES = 32
_STEP = _LEAST_STRETCHES // 2
# 512 bytes of a code that repeats itself, of 16 bits at most, are 256 pixels.
_SMOOTH = 4
# Within a row, and from the row above of the same colours. Where rows repeat the one above they also repeat that one.
_ROWS_APART = (0, 2)
# Where a frame is clipped: at values beyond which so few of its pixels are, or in this part of their range.
_CLIPPED_SHARE = 0.005
_BRIGHT_SHARE = 0.75

# Of a frame with noise at most this share are stretches without noise that stand alone; of a simulated or denoised one
# more are.
_LONE_SHARE = 0.01


def check_damage(
    path: Path,
    directories: Sequence[Directory],
    mosaic: NDArray[Any],
    black_dn: Sequence[float],
    white_dn: float,
) -> None:
    """Raise :class:`RawFileError` if a decoded file shows that some of its data were lost.

    Takes a third of a millisecond and one to three percent of the time of decoding.

    Parameters
    ----------
    path
        The file.
    directories
        What :func:`~eldata.raw.tiff.read_directories` found in it: they say where its data are, which are examined too.
    mosaic
        (H, W) uint16 or float32 in DN, as decoded.
    black_dn, white_dn
        Black levels and white level in DN.
    """
    fault = mosaic_fault(mosaic, black_dn, white_dn)
    fault = fault or tiles_fault(directories, mosaic, black_dn) or data_fault(path, directories, mosaic)
    if fault is not None:
        raise RawFileError(path, f"damaged: {fault}; {_AGAIN}")


def check_samples(path: Path, directories: Sequence[Directory]) -> None:
    """Raise :class:`RawFileError` if a lossless JPEG declares more samples than its bytes can code.

    LibRaw decodes as many as are declared, whatever the image's size: 18 kB took it half a minute. Reads headers alone.
    """
    with path.open("rb") as file:
        for _, offset, count in _compressed(path, directories):
            stream = _header_of(file, offset, count)
            if stream is not None and stream.samples > _BITS * count:
                raise _damaged_header(path, offset, f"declares {stream.samples} samples in {count} bytes")


def _header_of(file: IO[bytes], offset: int, count: int) -> Stream | None:
    """Return the lossless JPEG that begins there, without its codes; None without a header that can be read."""
    for most in _HEADERS:
        file.seek(offset)
        try:
            return find_stream(np.frombuffer(file.read(min(count, most)), np.uint8))
        except ValueError:  # longer, or damaged: data_fault says how
            continue
    return None


def check_streams(path: Path, directories: Sequence[Directory]) -> None:
    """Raise :class:`RawFileError` if a lossless JPEG in a raw file does not end with its last pixel.

    Takes about as long as decoding. A file without lossless JPEGs passes.
    """
    for extent in _extents(path, directories):
        if extent.stream is not None:
            fault = extent.stream.count_fault()
            if fault is not None:
                raise RawFileError(path, f"damaged: {extent.say(fault)}; {_AGAIN}")


# --- the file's image data ------------------------------------------------------------------------------------


class _Extent:
    """A strip or tile of the raw image: its bytes, where they begin in the file, the lossless JPEG that they are."""

    def __init__(self, content: NDArray[np.uint8], offset: int, stream: Stream | None) -> None:
        self.content, self.offset, self.stream = content, offset, stream

    def say(self, fault: tuple[int, str]) -> str:
        at, what = fault
        return f"its image data, at byte {self.offset + at} of the file, {what}"


def _compressed(path: Path, directories: Sequence[Directory]) -> Iterator[tuple[Directory, int, int]]:
    """Yield directory, offset and length of each strip or tile of compressed data, of previews too."""
    left = _MOST_SHARED * path.stat().st_size
    for directory in directories:
        for offset, count in directory.extents if directory.compression != _UNCOMPRESSED else ():
            if min(offset, count) < 0:  # a preview's: of the raw image it is refused before
                continue
            left -= count
            if left < 0:
                raise RawFileError(path, f"damaged: its image data share the same bytes; {_AGAIN}")
            yield directory, offset, count


def _extents(path: Path, directories: Sequence[Directory]) -> Iterator[_Extent]:
    """Yield the compressed strips and tiles of the raw image."""
    # What says that it is compressed and is as large as if it were not, is not.
    small = [found for found in directories if not sum(count for _, count in found.extents) >= 2 * found.pixels > 0]
    with path.open("rb") as file:
        for directory, offset, count in _compressed(path, small):
            file.seek(offset)
            content = np.frombuffer(file.read(count), np.uint8)
            try:
                stream = find_stream(content)
            except ValueError as error:
                if directory.is_mosaic:
                    raise _damaged_header(path, offset, str(error)) from error
                continue  # a preview
            if directory.is_mosaic and directory.compression == _JPEG and content[: len(SOI)].tobytes() != SOI:
                raise _damaged_header(path, offset, "does not begin as a JPEG")
            # CR2 does not say which of its images is the mosaic; no preview is a lossless JPEG.
            if directory.is_mosaic or stream is not None:
                yield _Extent(content, offset, stream)


def _damaged_header(path: Path, offset: int, what: str) -> RawFileError:
    return RawFileError(path, f"damaged: its image data, from byte {offset} of the file on, {what}; {_AGAIN}")


def data_fault(path: Path, directories: Sequence[Directory], mosaic: NDArray[Any]) -> str | None:
    """Return what shows in the compressed data of a TIFF-based file that some were lost; None if nothing does.

    ``mosaic``: (H, W) uint16 as decoded: whether it has clipped areas decides what its data may look like.

    Raises
    ------
    RawFileError
        If the header of a strip's JPEG is damaged.
    """
    smooth: bool | None = None
    is_nikon = any(found.is_mosaic and found.compression == _NIKON for found in directories)
    for extent in _extents(path, directories):
        stream = extent.stream
        if stream is not None:
            fault = stream.fault()
            if fault is not None:
                return extent.say(fault)
            sure = not any(code.zeros_mean_no_difference for code in stream.codes)
            run = long_run(stream.content[stream.start : stream.end], 0)
            start = stream.start
        else:
            sure, start = is_nikon, 0
            run = long_run(extent.content, 0) or long_run(extent.content, 0xFF)
        if run is None:
            continue
        if not sure and smooth is None:
            smooth = _has_smooth_area(mosaic)
        if sure or not smooth:
            first, behind = run
            value = int(extent.content[start + first])
            return extent.say(
                (start + first, f"has {behind - first} bytes of 0x{value:02X} in a row, which cannot be code")
            )
    return None


def long_run(values: NDArray[Any], value: int) -> tuple[int, int] | None:
    """Return where the first run of at least 512 equal values begins, and the position behind it.

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


def mosaic_fault(mosaic: NDArray[Any], black_dn: Sequence[float], white_dn: float) -> str | None:
    """Return what no photograph can show, of a mosaic (H, W) in DN, and where; None if nothing is found."""
    pixels = mosaic.reshape(-1)
    if min(black_dn) > 0:
        levels = " ".join(f"{level:g}" for level in dict.fromkeys(black_dn))
        run = long_run(pixels, 0)
        if run is not None:
            return f"{_place(mosaic, *run)} are 0 DN, below the black level {levels} DN"
        if not mosaic[-1].any():
            return f"its last row is all 0 DN, below the black level {levels} DN"
    if white_dn < 1 << 15:
        run = long_run(pixels, (1 << 16) - 1)
        if run is not None:
            return f"{_place(mosaic, *run)} are 65535 DN, far above the white level {white_dn:g} DN"
    return _noise_fault(mosaic)


def tiles_fault(directories: Sequence[Directory], mosaic: NDArray[Any], black_dn: Sequence[float]) -> str | None:
    """Return what no photograph can show of uncompressed tiles, of which a lost page takes a few columns of many rows.

    Compressed tiles are examined in the file itself (:func:`data_fault`).
    """
    if min(black_dn) <= 0:
        return None
    for found in directories:
        if not found.is_mosaic or found.compression != _UNCOMPRESSED:
            continue
        width, height = found.number(TILE_WIDTH, 0), found.number(TILE_HEIGHT, 0)
        if width < 1 or height < 1:
            continue
        top, left = map(int, found.values.get(ACTIVE_AREA, (0, 0))[:2])
        rows, columns = range(-top, mosaic.shape[0], height), range(-left, mosaic.shape[1], width)
        if len(rows) * len(columns) > len(found.extents):  # made to keep a reader busy: tiles of a pixel
            continue
        tiles = [mosaic[max(0, y) : max(0, y + height), max(0, x) : max(0, x + width)] for y in rows for x in columns]
        run = long_run(np.concatenate([tile.reshape(-1) for tile in tiles]), 0)
        if run is not None:
            count, levels = run[1] - run[0], " ".join(f"{level:g}" for level in dict.fromkeys(black_dn))
            return f"{count} pixels in a row of its tiles are 0 DN, below the black level {levels} DN"
    return None


def _place(mosaic: NDArray[Any], first: int, behind: int) -> str:
    row, column = divmod(first, mosaic.shape[1])
    return f"{behind - first} pixels in a row, from row {row}, column {column} on,"


class _Stretches:
    """The stretches of a mosaic's rows, by number: those of a row after each other, row after row."""

    def __init__(self, mosaic: NDArray[Any]) -> None:
        self.pixels = mosaic.reshape(-1)
        self.width = mosaic.shape[1]
        self.length = min(_STRETCH, self.width)
        self.a_row = self.width // self.length
        self.count = self.a_row * mosaic.shape[0]
        self.some = np.sort(self.pixels[self.begin(np.arange(0, self.count, _STEP))])

    def begin(self, numbers: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the position of each one's first pixel."""
        first: NDArray[np.intp] = numbers // self.a_row * self.width + numbers % self.a_row * self.length
        return first

    def noiseless(self, numbers: NDArray[np.intp], rows: int) -> NDArray[np.intp]:
        """Return those of some stretches whose pixels follow from others without noise.

        ``rows`` 0: they change in equal steps, which may be zero. Else: they differ from those so many rows above by a
        constant, which may be zero. uint16 wraps as decoders do.
        """
        numbers = numbers[numbers >= rows * self.a_row]
        begin, above = self.begin(numbers), rows * self.width
        for at in range(self.length - (1 if rows else 2 * _LAG)):
            first, second = self.pixels[begin + at], self.pixels[begin + (at + 1 if rows else at + _LAG)]
            if rows:
                kept = second - first == self.pixels[begin + (at + 1 - above)] - self.pixels[begin + (at - above)]
            else:
                kept = second - first == self.pixels[begin + (at + 2 * _LAG)] - second
            numbers, begin = numbers[kept], begin[kept]
            if not len(numbers):
                break
        return numbers

    def lost(self, numbers: NDArray[np.intp], rows: int) -> NDArray[np.intp]:
        """Return those of :meth:`noiseless` that are not clipped, where pixels are rightly alike."""
        numbers = self.noiseless(numbers, rows)
        values = self.pixels[self.begin(numbers)[:, None] + np.arange(self.length)]
        flat = (values[:, _LAG:] == values[:, :-_LAG]).all(axis=1)
        margin = _CLIPPED_SHARE * len(self.some)
        low = np.searchsorted(self.some, values.min(axis=1), "left") < margin
        high = len(self.some) - np.searchsorted(self.some, values.max(axis=1), "right") < margin
        # Each column may be clipped at a value of its own.
        darkest, brightest = float(self.some[0]), float(self.some[-1])
        bright = values.min(axis=1) >= darkest + _BRIGHT_SHARE * (brightest - darkest)
        kept: NDArray[np.intp] = numbers[~(bright | flat & (low | high))]
        return kept


def _noise_fault(mosaic: NDArray[Any]) -> str | None:
    """Find a long run of stretches without noise that are not clipped, in a frame with noise."""
    stretches = _Stretches(mosaic)
    probed = np.arange(0, stretches.count, _STEP)
    for rows in _ROWS_APART:
        # A camera may repair a row by a neighbour's; two rows and more it does not.
        least = max(_LEAST_STRETCHES, 2 * stretches.a_row if rows else 0)
        lost = stretches.lost(probed, rows)
        follow = np.diff(lost) == _STEP
        lone = len(lost) - np.count_nonzero(np.append(follow, False) | np.append(False, follow))
        if 2 * len(lost) > len(probed) or lone > _LONE_SHARE * len(probed):
            return None  # simulated or denoised: it has such stretches anywhere
        behind = -1
        for number in lost[:-1][follow]:
            if number < behind:
                continue
            behind = number + 2 * least
            near = np.arange(max(0, number - least), min(stretches.count, behind))
            found = stretches.lost(near, rows)
            for run in np.split(found, np.flatnonzero(np.diff(found) > 1) + 1):
                if len(run) >= least:
                    row, column = divmod(int(stretches.begin(run[:1])[0]), stretches.width)
                    place = f"{len(run) * stretches.length} pixels or more, from row {row}, column {column} on,"
                    if rows:
                        return f"{place} repeat those {rows} rows above, noise included"
                    return f"{place} are alike or follow each other in equal steps, without noise"
    return None


def _has_smooth_area(mosaic: NDArray[Any]) -> bool:
    """Whether some stretches in a row are without noise: there, a code may repeat itself."""
    stretches = _Stretches(mosaic)
    for rows in _ROWS_APART:
        found = stretches.noiseless(np.arange(stretches.count), rows)
        if (found[_SMOOTH - 1 :] - found[: 1 - _SMOOTH] == _SMOOTH - 1).any():
            return True
    return False
