"""The array in a stranger's file: what the file declares of it is agreed to before anything is loaded.

Each format says shape and type in its header, and each has ways to make a reader reserve, decompress, follow or wait
for more than that. So each reader here looks at the header alone and hands that to a check; then numpy, h5py, tifffile
and imagecodecs read.

npy
    The header is matched, not evaluated; the file holds as many bytes as it declares, and no more: bytes that were
    inserted shift all that follow.
npz
    So does the member. Members are stored or deflated; no more is decompressed than is declared.
h5, mat of MATLAB 7.3
    One data set of numbers in the file itself: no links, no external or virtual storage, every chunk written, and
    filters that every copy of HDF5 has. The file ends where its superblock says.
tif, tiff
    Pages whose strips or tiles are all there and inside the file, without compression or with a lossless one; of
    uncompressed ones each has the bytes of its rows. Nothing follows the pixels that no tag or page accounts for.
    Formats within TIFF that refer to other files are taken for plain TIFF.
mat of MATLAB 5 to 7
    The table of variables says shape and type; scipy reads the one that is wanted. Of either format an array has the
    shape that MATLAB shows.
png
    Size and depth from the header; no more compressed data than such pixels can need, and nothing after the last chunk.
"""

from __future__ import annotations

import logging
import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.files import file_problem
from eldata.base.pixels import Declared, opened_npz, read_npy, read_png
from eldata.base.visible import in_line
from eldata.errors import FileError, PredictionError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import h5py
    from numpy.typing import NDArray

    Check = Callable[[Declared], None]
    Reader = Callable[[Path, Check, str], NDArray[Any]]

_MOST_NAMES = 1000  # of the arrays and groups of a file
_NAMES_SHOWN = 6
_LONGEST_NAME = 32
_LONGEST_REASON = 200


class _EnoughError(Exception):
    """Raised by a check that only wanted to know."""


class _UnfitError(Exception):
    """A file does not hold the one array that is wanted; the message reads on from the file's name."""


def read_array(
    path: Path,
    check: Check,
    *,
    name: str = "prediction",
    error: type[FileError] = PredictionError,
    advice: str = "write it again",
) -> NDArray[Any]:
    """Return a file's array, in the file's byte order and order of values.

    Parameters
    ----------
    path
        npy, npz, h5, mat, png; anything else is taken for TIFF.
    check
        Raises a :class:`FileError` if what the file declares, or then holds, is not what is wanted.
    name
        The array that is meant where a file holds several.
    error, advice
        What is raised of a file that cannot be read, and what to do about it.

    Raises
    ------
    FileError
        What ``check`` raises; ``error``, if the file cannot be read.
    """
    kind = path.suffix.lower().removeprefix(".")
    problem = file_problem(path)
    if problem is not None:
        raise error(path, problem)
    try:
        array = _READERS.get(kind, _read_tiff)(path, check, name)
    except (FileError, _EnoughError):
        raise
    except _UnfitError as unfit:
        raise error(path, str(unfit)) from None
    except Exception as cause:  # six libraries, each with its own kinds
        # Its first line; libpng's may be memory that is not text.
        _refuse_other_format(path, error)
        reason = in_line(str(cause).splitlines()[0][:_LONGEST_REASON]) if str(cause) else type(cause).__name__
        raise error(path, f"cannot be read as {path.suffix[1:]} ({reason}); {advice}") from cause
    check(Declared(array.shape, str(array.dtype.newbyteorder("="))))
    return array


# First bytes, the extension that is read so, and what such a file is.
_FORMATS = (
    (b"\x93NUMPY", ".npy", "a NumPy array"),
    (b"PK\x03\x04", ".npz", "a zip archive, as .npz is"),
    (b"\x89HDF", ".h5", "HDF5 without MATLAB's header, as h5py writes it, whose sides are not MATLAB's"),
    (b"MATLAB 7.3", ".mat", "MATLAB 7.3's, HDF5 whose sides MATLAB shows in reverse"),
    (b"MATLAB 5.0", ".mat", "MATLAB's"),
    (b"\x89PNG", ".png", "PNG"),
    (b"II*\0", ".tif", "TIFF"),
    (b"MM\0*", ".tif", "TIFF"),
)


def _refuse_other_format(path: Path, error: type[FileError]) -> None:
    """Refuse a file that could not be read if its first bytes are of another kind than its name says."""
    with path.open("rb") as file:
        head = file.read(max(len(mark) for mark, _, _ in _FORMATS))
    known = _READERS.get(path.suffix.lower().removeprefix("."), _read_tiff)
    for mark, suffix, what in _FORMATS:
        if head.startswith(mark) and _READERS.get(suffix.removeprefix("."), _read_tiff) is not known:
            raise error(path, f"is {what}: name it {suffix}, or write it again as {path.suffix}")


def declared_array(
    path: Path, *, name: str = "prediction", error: type[FileError] = PredictionError, advice: str = "write it again"
) -> Declared:
    """Return what a file declares; raises like :func:`read_array`."""
    try:
        read_array(path, _enough, name=name, error=error, advice=advice)
    except _EnoughError as told:
        declared: Declared = told.args[0]
        return declared
    raise error(path, "declares no array")


def _enough(declared: Declared) -> None:
    raise _EnoughError(declared)


def _only(names: Sequence[str], wanted: str) -> str:
    """Return the name of a file's one array, or the wanted one among several."""
    if len(names) == 1:
        return names[0]
    if names.count(wanted) == 1:
        return wanted
    shown = ", ".join(in_line(name[:_LONGEST_NAME]) for name in names[:_NAMES_SHOWN])
    more = f" and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else ""
    called = f", or one called {wanted!r}" if wanted else ""
    raise _UnfitError(f"expected one array{called}; found {shown or 'none'}{more}")


# --- npy and npz --------------------------------------------------------------------------------------------------


def _read_npy(path: Path, check: Check, name: str) -> NDArray[Any]:
    del name
    with path.open("rb") as file:
        return read_npy(file, path.stat().st_size, check)


def _read_npz(path: Path, check: Check, name: str) -> NDArray[Any]:
    with opened_npz(path) as archive:
        return archive.read(_only(archive.names, name), check)


# --- h5 -----------------------------------------------------------------------------------------------------------

_H5_PACKERS = (1, 32000)  # gzip, lzf
_H5_FILTERS = (*_H5_PACKERS, 2, 3)  # shuffle, fletcher32


def _read_h5(path: Path, check: Check, name: str) -> NDArray[Any]:
    import h5py

    with h5py.File(path, "r") as file:
        if len(file) > _MOST_NAMES:
            raise _UnfitError(f"expected one array, or one called {name!r}; found {len(file)} items")
        kinds = {item: file.get(item, getclass=True, getlink=True) for item in file}
        links = [item for item, kind in kinds.items() if kind is not h5py.HardLink]
        if links:
            raise _UnfitError(
                f"{links[0][:_LONGEST_REASON]!r} is a link; expected the array itself: copy it into the file"
            )
        held = file[_only([item for item in kinds if file.get(item, getclass=True) is h5py.Dataset], name)]
        declared = Declared(held.shape or (), _h5_values(held.id))
        check(declared)
        _check_h5(held.id)
        _check_h5_end(path, file)
        array: NDArray[Any] = held[()]
        return array


def _check_h5_end(path: Path, file: h5py.File) -> None:
    """Raise ``ValueError`` if a file is longer than its superblock says (HDF5's format, II.A): HDF5 asks for less."""
    with path.open("rb") as content:
        content.seek(file.userblock_size)
        block = content.read(64)
        version = min(block[8], 2)
        width = block[13 if version < 2 else 9]
        at = (24, 28, 12)[version] + 2 * width
        end, size = int.from_bytes(block[at : at + width], "little"), content.seek(0, os.SEEK_END)
    if end < size:
        raise ValueError(f"{size} bytes, of which it accounts for {end}: were bytes inserted?")


def _h5_values(dataset: h5py.h5d.DatasetID) -> str:
    """Return the type of a data set's values; what is not a number is not made into a type of numpy."""
    import h5py

    stored = dataset.get_type()
    if dataset.get_space().get_simple_extent_type() != h5py.h5s.SIMPLE:
        return "a data set that is not an array"
    if stored.get_class() not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT):
        return "values that are not numbers"
    return str(stored.dtype.newbyteorder("="))


def _check_h5(dataset: h5py.h5d.DatasetID) -> None:
    """Raise ``ValueError`` unless the values are in the file: HDF5 fills what is not with zeros."""
    import h5py

    properties = dataset.get_create_plist()
    value_bytes = math.prod(dataset.shape) * dataset.dtype.itemsize
    layout, stored_bytes = properties.get_layout(), dataset.get_storage_size()
    if layout not in (h5py.h5d.CHUNKED, h5py.h5d.CONTIGUOUS, h5py.h5d.COMPACT) or properties.get_external_count():
        raise ValueError("its values lie in other files")
    if layout != h5py.h5d.CHUNKED:
        if stored_bytes != value_bytes:
            raise ValueError("its values were never written")
        return
    sides = properties.get_chunk()
    chunk_bytes = math.prod(sides) * dataset.dtype.itemsize
    if max(chunk_bytes, stored_bytes) > 2 * value_bytes + (1 << 20):
        raise ValueError(f"chunks of {chunk_bytes} bytes, {stored_bytes} in all, for an array of {value_bytes}")
    expected = math.prod(-(-length // side) for length, side in zip(dataset.shape, sides, strict=True))
    chunks: list[h5py.h5d.StoreInfo] = []
    dataset.chunk_iter(chunks.append)
    if len(chunks) != expected:
        raise ValueError(f"{len(chunks)} of its {expected} chunks were written")
    filters = [properties.get_filter(number)[0] for number in range(properties.get_nfilters())]
    unknown = [number for number in filters if number not in _H5_FILTERS]
    if unknown:
        raise ValueError(f"HDF5's filter {unknown[0]}; expected gzip, lzf, shuffle, fletcher32 or none")
    packed = sum(1 << place for place, number in enumerate(filters) if number in _H5_PACKERS)
    if any(chunk.size < chunk_bytes and not packed & ~chunk.filter_mask for chunk in chunks):
        raise ValueError(f"a chunk of less than its {chunk_bytes} bytes")


# --- MATLAB -------------------------------------------------------------------------------------------------------

# As MATLAB names them, of its numbers; the rest (cell, struct, char, sparse ...) has no array.
_MATLAB_TYPES = {"double": "float64", "single": "float32", "logical": "bool"}
_MATLAB_TYPES |= {name: name for sign in ("", "u") for bits in (8, 16, 32, 64) for name in (f"{sign}int{bits}",)}


def _read_mat(path: Path, check: Check, name: str) -> NDArray[Any]:
    import scipy.io
    from scipy.io.matlab import matfile_version

    if matfile_version(path)[0] == 2:  # HDF5, whose arrays have MATLAB's sides in reverse
        return _read_h5(path, lambda found: check(Declared(found.shape[::-1], found.values)), name).transpose()
    held = {item: (shape, _MATLAB_TYPES.get(kind)) for item, shape, kind in scipy.io.whosmat(path)}
    if len(held) > _MOST_NAMES:
        raise _UnfitError(f"expected one array, or one called {name!r}; found {len(held)} variables")
    chosen = _only([item for item, (_, values) in held.items() if values is not None], name)
    shape, values = held[chosen]
    check(Declared(tuple(shape), values or ""))
    return np.asarray(scipy.io.loadmat(path, variable_names=[chosen])[chosen])


# --- pictures -----------------------------------------------------------------------------------------------------


def _read_png(path: Path, check: Check, name: str) -> NDArray[Any]:
    del name
    return read_png(path, check)


# --- TIFF -------------------------------------------------------------------------------------------------------------
# tifffile fills strips that a file does not hold with zeros, and logs what else is wrong.

_COMPRESSIONS = {  # of which a decoder can be told how much to make: none that holds a picture of its own
    1: "none",
    5: "LZW",
    8: "deflate",
    32946: "deflate",
    32773: "PackBits",
    34925: "LZMA",
    50000: "Zstandard",
}
_LARGEST_TILE = 1 << 20  # pixels, where the image is smaller
_PADDED = 16  # bytes: Pillow fills the last of several pages up to a multiple


def _read_tiff(path: Path, check: Check, name: str) -> NDArray[Any]:
    import tifffile

    del name
    if not tifffile.logger().handlers:  # or Python prints what it says beside our error
        tifffile.logger().addHandler(logging.NullHandler())
    plain: dict[str, Any] = {f"is_{kind}": False for kind in tifffile.TIFF.FILE_FLAGS - {"shaped", "uniform"}}
    with tifffile.TiffFile(path, **plain) as file:
        if not file.pages or not file.series:
            raise _UnfitError("holds no image; write it again")
        series = file.series[0]
        check(Declared(tuple(series.shape), str(np.dtype(series.dtype))))
        pages: list[Any] = list(series.pages)
        if not all(pages) or math.prod(series.shape) != sum(math.prod(page.shape) for page in pages):
            raise ValueError("its pages do not hold as many values as it declares")
        size = os.fstat(file.filehandle.fileno()).st_size
        end = max(_end_of_page(page, size) for page in pages)
        if len(file.series) == 1 and not any(_is_behind(page, end) for page in file.pages):
            file.filehandle.seek(end)
            rest = file.filehandle.read(_PADDED)
            if len(rest) not in (0, end % 2, -end % _PADDED) or any(rest):
                raise ValueError(f"{size - end} bytes follow its pixels that nothing in it accounts for: inserted?")
        array: NDArray[Any] = series.asarray(maxworkers=1, buffersize=1 << 24)
    return array


def _end_of_page(page: Any, size: int) -> int:
    """Return where a page's pixels end; ``ValueError`` unless all strips or tiles are in a file of so many bytes."""
    keyframe, (offsets, counts) = page.keyframe, (page.dataoffsets, page.databytecounts)
    if int(keyframe.compression) not in _COMPRESSIONS:
        known = ", ".join(dict.fromkeys(_COMPRESSIONS.values()))
        raise ValueError(f"compression {int(keyframe.compression)}; expected {known}")
    tile = keyframe.tilewidth * keyframe.tilelength * max(keyframe.tiledepth, 1) if keyframe.is_tiled else 0
    if tile > max(4 * keyframe.imagewidth * keyframe.imagelength, _LARGEST_TILE):
        raise ValueError(f"tiles of {keyframe.tilewidth} x {keyframe.tilelength} pixels in a smaller page")
    pieces = math.prod(keyframe.chunked)
    if not len(offsets) == len(counts) in (1, pieces) or min(offsets) <= 0 or min(counts) <= 0:
        raise ValueError("strips or tiles are missing")
    if int(keyframe.compression) == 1:
        _check_counts(keyframe, counts, pieces)
    end = max(map(sum, zip(offsets, counts, strict=True)))
    if end > size:
        raise ValueError("its data lie beyond the end of the file: truncated?")
    return end


def _check_counts(keyframe: Any, counts: Sequence[int], pieces: int) -> None:
    """Raise ``ValueError`` unless strips or tiles without compression have the bytes of their rows.

    The last strip may be as long as the others; tifffile joins strips that follow each other.
    """
    bits = keyframe.bitspersample * (keyframe.samplesperpixel if keyframe.planarconfig == 1 else 1)
    row = -(-(keyframe.tilewidth if keyframe.is_tiled else keyframe.imagewidth) * bits // 8)
    if keyframe.is_tiled:
        piece = last = max(keyframe.tiledepth, 1) * keyframe.tilelength * row
        total = pieces * piece
    else:
        height, rows = keyframe.imagelength, min(keyframe.rowsperstrip, keyframe.imagelength)
        piece, last = rows * row, ((height - 1) % rows + 1) * row
        total = pieces // -(-height // rows) * height * row
    joined = len(counts) == 1 and counts[0] == total
    if not joined and not ({*counts} <= {piece, last} and sum(counts) in (total, pieces * piece)):
        raise ValueError(f"its strips or tiles have {sum(counts)} bytes, and its rows {total}")


_POINTERS = (330, 34665, 34853, 40965)  # to further directories: SubIFDs, EXIF, GPS, interoperability


def _is_behind(page: Any, end: int) -> bool:
    """Whether a page, its tags or what they point to may lie behind the end of pixels."""
    tags = getattr(page, "tags", ())  # of a page that is like the one before only the offset is known
    return page.offset >= end or any(tag.valueoffset >= end or tag.code in _POINTERS for tag in tags)


_READERS: dict[str, Reader] = {
    "npy": _read_npy,
    "npz": _read_npz,
    "h5": _read_h5,
    "mat": _read_mat,
    "png": _read_png,
}
