"""Pixels of a mosaic, read from where its container's tags place them: all of them, or a part.

Uncompressed ones are not decoded, so that a crop costs what it costs from a memory map; of a DNG's lossless JPEGs those
are that a part touches. LibRaw has the last word: the first file of a
form (:func:`form_of`) that a process reads is decoded by it too, and every pixel compared (:mod:`eldata.raw.reading`).

A process keeps the last few files mapped. One that was replaced, cut off or written to since it was opened is refused
before a pixel of it is touched.
"""

from __future__ import annotations

import mmap
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import version
from multiprocessing import parent_process
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata import __version__
from eldata.base.compiled import in_threads
from eldata.errors import RawFileError
from eldata.raw import tiff
from eldata.raw._kernels import unpack_bits
from eldata.raw.container import RawContainer, StoredRows, version_of
from eldata.raw.tiff import Directory, Order

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray


_WHOLE_BITS = 16
_OF_DAMAGE = (tiff.PHOTOMETRIC, tiff.COMPRESSION, tiff.HEIGHT, tiff.WIDTH, tiff.ACTIVE_AREA)
_NOTES = {37500, 50740}  # a maker's: MakerNote, DNGPrivateData
_MOST_MAPPED = 16  # files of a process, a descriptor each: mapping one again takes a tenth of reading a crop


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the pixels of one file's visible area lie.

    Attributes
    ----------
    path, version
        The file, and what tells it from another one under its name.
    blocks
        Its strips or tiles, as :class:`eldata.raw.container.StoredRows` has them; one if they follow one another.
    block_bytes, bits, word_bytes, order
        Of a row of a block; of a pixel, packed from the highest bit on unless they are 16; of the words that packed
        ones lie in; of the bytes of 16.
    jpeg_rows
        Of a tile that is a lossless JPEG; 0 if they are not compressed.
    top, left, height, width
        The visible area.
    stated
        What the mosaic's directory states that :func:`eldata.raw.damage.check_damage` looks at; uncompressed strips as
        one, tiles as strips.
    """

    path: Path
    version: tuple[int, ...]
    blocks: tuple[tuple[int, int, int, int], ...]
    block_bytes: int
    bits: int
    word_bytes: int
    order: Order
    jpeg_rows: int
    top: int
    left: int
    height: int
    width: int
    stated: Directory

    @classmethod
    def of(cls, file: RawContainer, rows: StoredRows, corner: tuple[int, int], shape: tuple[int, int]) -> Layout:
        """Return the layout of a file's rows, of which an area is visible: its first row and column, and its size."""
        main, blocks = rows.main, rows.blocks
        if rows.are_one_run:
            blocks = ((0, 0, blocks[0][2], main.shape[0] * rows.row_bytes),)
        values = {tag: main.values[tag] for tag in _OF_DAMAGE if tag in main.values}
        run = (min(main.extents)[0],), (main.held,)
        values |= zip(tiff.STRIPS, zip(*main.extents, strict=True) if rows.jpeg else run, strict=True)
        jpeg_rows = main.number(tiff.TILE_HEIGHT, 0) if rows.jpeg else 0
        area = (*corner, *shape)
        stored = rows.block_bytes, rows.bits, rows.word_bytes, main.order, jpeg_rows
        return cls(file.path, file.version, blocks, *stored, *area, Directory(values))

    def read(self, rows: slice, columns: slice) -> NDArray[np.uint16]:
        """Return a part of the visible area, (rows, columns) in DN, not to be written to.

        Raises
        ------
        RawFileError
            If the file cannot be read, is not what it was, or does not decode.
        """
        with _naming(self.path):
            _check_version(self.path, self.version)
            content = _map(self.path, self.version)
        return self._cut(content, rows, columns)

    def read_whole(self) -> NDArray[np.uint16]:
        """Return all of the visible area, in memory of its own; raises like :meth:`read`."""
        with _naming(self.path):  # not by mapping it, whose pages would take four times as long
            content = np.fromfile(self.path, np.uint8)
            _check_version(self.path, self.version)
        return np.ascontiguousarray(self._cut(content, slice(None), slice(None)))

    def _cut(self, content: mmap.mmap | NDArray[np.uint8], rows: slice, columns: slice) -> NDArray[np.uint16]:
        """Return a part of the visible area from the file's bytes: of these bytes, if it lies there as it is."""
        first, last, _ = rows.indices(self.height)
        left, right, _ = columns.indices(self.width)
        out = np.empty((max(0, last - first), max(0, right - left)), np.uint16)

        def copy_block(block: tuple[int, int, int, int]) -> NDArray[np.uint16] | None:
            """Copy what the part has of a block, or return all of the part, where it lies in it as it is."""
            block_top, block_left, offset, length = block
            y, x = block_top - self.top, block_left * 8 // self.bits - self.left
            width = self.block_bytes * 8 // self.bits
            top, bottom = max(first, y), min(last, y + (self.jpeg_rows or length // self.block_bytes))
            start, stop = max(left, x), min(right, x + width)
            if top >= bottom or start >= stop:
                return None
            target = out[top - first : bottom - first, start - left : stop - left]
            if self.jpeg_rows:
                target[:] = self._decode(content, offset, length)[top - y : bottom - y, start - x : stop - x]
                return None
            stored = np.ndarray((length // self.block_bytes, self.block_bytes), np.uint8, content, offset)
            if self.bits != _WHOLE_BITS:
                unpack_bits(stored[top - y : bottom - y], self.bits, self.word_bytes - 1, start - x, target)
                return None
            pixels = stored.view(f"{self.order}u2")[top - y : bottom - y, start - x : stop - x]
            if target.shape == out.shape and offset % 2 == 0:
                return pixels.astype(np.uint16, copy=False)
            target[:] = pixels
            return None

        # Worker processes share the CPUs already.
        parts = in_threads(copy_block, self.blocks, None if self.jpeg_rows and parent_process() is None else 1)
        return next((part for part in parts if part is not None), out)

    def _decode(self, content: mmap.mmap | NDArray[np.uint8], offset: int, length: int) -> NDArray[Any]:
        """Decode a lossless JPEG, whose pixels follow one another, whatever its own rows and components."""
        from imagecodecs import ljpeg_decode

        try:
            pixels: NDArray[Any] = ljpeg_decode(bytes(content[offset : offset + length]))
            return pixels.reshape(-1, self.block_bytes * 8 // self.bits)
        except (RuntimeError, ValueError) as error:
            raise RawFileError(self.path, f"damaged: its lossless JPEG at byte {offset} does not decode") from error


def _check_version(path: Path, version: tuple[int, ...]) -> None:
    """Refuse another file than it was."""
    if version_of(status := path.stat()) != version:
        was = f"it had {version[0]} bytes and has {status.st_size} now"
        raise RawFileError(path, f"was replaced or written to since it was opened ({was}); begin again")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file of which the system refuses something."""
    try:
        yield
    except OSError as error:
        raise RawFileError(path, f"cannot be read: {error.strerror or error}") from error


@lru_cache(maxsize=_MOST_MAPPED)
def _map(path: Path, version: tuple[int, ...]) -> mmap.mmap:
    """Map a file; the last ones stay mapped, and as long as a part that was read is used."""
    with path.open("rb") as file:
        _check_version(path, version)
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


# --- what LibRaw has confirmed ----------------------------------------------------------------------------------------

_version_of = cache(version)  # which needs no import of rawpy
verdicts: dict[tuple[Any, ...], str] = {}
"""Of this process, by form: nothing if LibRaw has given the same, else what differs."""


def form_of(file: RawContainer) -> tuple[Any, ...]:
    """Describe where a file's pixels lie: alike for files laid out alike, empty where tags do not place them.

    The versions are in it, since verdicts are pickled with a source of frames, which may be kept.
    """
    rows = file.rows
    of_several = sum(directory.is_mosaic for directory in file.directories) > 1
    if rows is None or of_several or tiff.LINEARIZATION in rows.main.entries:
        return ()
    main, header = rows.main, file.header
    return (
        *(__version__, _version_of("rawpy")),
        *(header.make, header.model, file.is_dng, main.compression, rows.bits, main.order, main.shape),
        *(rows.block_bytes, rows.are_one_run, len(rows.blocks) > 1, rows.jpeg),
    )


def form_of_tags(file: RawContainer) -> tuple[Any, ...]:
    """Describe which tags state all but the pixels, so that LibRaw need not be asked; empty where they do not.

    Of a maker's notes LibRaw takes levels, odd margins it moves, and of a white level it keeps whole DN.
    """
    form, main, first = form_of(file), file.main, next(iter(file.directories), Directory({}))
    if not form or not file.is_dng or main is None:
        return ()
    tags = {tag for directory in file.directories for tag in directory.entries}
    counts = {tiff.COLOUR_MATRICES[0][0]: (first, 9), tiff.AS_SHOT_NEUTRAL: (first, 3), tiff.WHITE_LEVEL: (main, 1)}
    is_stated = all(len(directory.values.get(tag, ())) == count for tag, (directory, count) in counts.items())
    letters = main.cfa_letters or ()
    is_bayer = len(letters) == 2 and sorted("".join(letters)) == [*"BGGR"]
    if not (is_stated and is_bayer) or tags & _NOTES:
        return ()
    odd = (*(side % 2 for side in main.corner()), main.values[tiff.WHITE_LEVEL][0] % 1)
    if any(odd) or min(first.values[tiff.AS_SHOT_NEUTRAL]) <= 0:
        return ()
    return (*form, main.values.get(tiff.ACTIVE_AREA), letters, tuple(sorted(tags)))


def answer_by_tags(main: Directory) -> Any:
    """Give what a DNG's tags state of its mosaic, and what they leave open, under rawpy's names for it."""
    height, width = main.shape
    top, left, bottom, right = map(int, main.values.get(tiff.ACTIVE_AREA, (0, 0, height, width)))
    visible = {"top_margin": top, "left_margin": left, "height": bottom - top, "width": right - left}
    indices = [["RGB".index(letter) for letter in row] for row in main.cfa_letters or ()]
    return SimpleNamespace(
        sizes=SimpleNamespace(raw_height=height, raw_width=width, **visible),
        color_desc=b"RGB",
        raw_pattern=indices,
        raw_color=lambda y, x: indices[(y - top) % 2][(x - left) % 2],
        black_level_per_channel=(0,) * 3,
        white_level=main.number(tiff.WHITE_LEVEL, 0),
        camera_white_level_per_channel=None,
        camera_whitebalance=(0.0,) * 4,
        rgb_xyz_matrix=np.zeros((4, 3)),
    )
