"""The array in a stranger's file: what the file declares of it is agreed to before anything is loaded.

Each format says shape and type in its header, and each has ways to make a reader reserve, decompress, follow or wait
for more than that. So each reader here looks at the header alone and hands that to a check, and then decodes into
memory of that size and no more.

npy
    The header is matched, not evaluated; the file holds as many bytes as it declares.
npz
    So does the member. Members are stored or deflated; no more is decompressed than is declared.
h5, mat of MATLAB 7.3
    One data set of numbers in the file itself: no links, no external or virtual storage, every chunk written. Filters
    are gzip, lzf, shuffle and Fletcher's checksum, which are undone here: HDF5's believe what a chunk says of itself.
tif, tiff
    A short chain of pages, whose strips or tiles are all there and inside the file, without compression or with a
    lossless one. Formats within TIFF that refer to other files are taken for plain TIFF.
mat of MATLAB 5 to 7
    The table of variables says shape and type; scipy reads the one that is wanted. Of either format an array has the
    shape that MATLAB shows.
png
    Size and depth from the header; no more compressed data than such pixels can need.
"""

from __future__ import annotations

import math
import struct
from itertools import product
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from eldata.base.files import file_problem
from eldata.base.pixels import Declared, opened_npz, read_npy, read_png
from eldata.base.visible import in_line
from eldata.errors import FileError, PredictionError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import h5py
    import tifffile
    from numpy.typing import NDArray

    Check = Callable[[Declared], None]
    Reader = Callable[[Path, Check, str], NDArray[Any]]

_PIECE_BYTES = 1 << 20
_MOST_NAMES = 1000  # of the arrays and groups of a file
_NAMES_SHOWN = 6
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
        reason = in_line(str(cause).splitlines()[0][:_LONGEST_REASON]) if str(cause) else type(cause).__name__
        raise error(path, f"cannot be read as {path.suffix[1:]} ({reason}); {advice}") from cause
    check(Declared(array.shape, str(array.dtype.newbyteorder("="))))
    return array


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
    shown = ", ".join(in_line(name[:_LONGEST_REASON]) for name in names[:_NAMES_SHOWN])
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

_SHUFFLE, _DEFLATE, _FLETCHER, _LZF = 2, 1, 3, 32000
_CHECKSUM_BYTES = 4


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
        return _h5_array(held.id)


def _h5_values(dataset: h5py.h5d.DatasetID) -> str:
    """Return the type of a data set's values; what is not a number is not made into a type of numpy."""
    import h5py

    stored = dataset.get_type()
    if dataset.get_space().get_simple_extent_type() != h5py.h5s.SIMPLE:
        return "a data set that is not an array"
    if stored.get_class() not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT):
        return "values that are not numbers"
    return str(stored.dtype.newbyteorder("="))


def _h5_array(dataset: h5py.h5d.DatasetID) -> NDArray[Any]:
    import h5py

    properties = dataset.get_create_plist()
    array: NDArray[Any] = np.empty(dataset.shape, dataset.dtype)
    layout = properties.get_layout()
    if layout == h5py.h5d.CHUNKED:
        _read_chunks(dataset, properties, array)
        return array
    if layout not in (h5py.h5d.CONTIGUOUS, h5py.h5d.COMPACT) or properties.get_external_count():
        raise ValueError("its values lie in other files")
    if dataset.get_storage_size() != array.nbytes:
        raise ValueError("its values were never written")
    dataset.read(h5py.h5s.ALL, h5py.h5s.ALL, array)
    return array


def _read_chunks(dataset: h5py.h5d.DatasetID, properties: h5py.h5p.PropDCID, array: NDArray[Any]) -> None:
    """Fill an array from the chunks that HDF5 finds; filters are undone here, within the size of a chunk."""
    filters = [properties.get_filter(number)[0] for number in range(properties.get_nfilters())]
    unknown = [number for number in filters if number not in (_SHUFFLE, _DEFLATE, _FLETCHER, _LZF)]
    if unknown:
        raise ValueError(f"HDF5's filter {unknown[0]}; expected gzip, lzf, shuffle, fletcher32 or none")
    sides = properties.get_chunk()
    chunk_bytes = math.prod(sides) * array.dtype.itemsize
    if chunk_bytes > max(2 * array.nbytes, _PIECE_BYTES):
        raise ValueError(f"chunks of {chunk_bytes} bytes for an array of {array.nbytes}")
    starts = [range(0, length, side) for length, side in zip(array.shape, sides, strict=True)]
    expected, found = math.prod(map(len, starts)), dataset.get_num_chunks()
    if found != expected:
        raise ValueError(f"{found} of its {expected} chunks were written")
    for start in product(*starts):
        stored_bytes = dataset.get_chunk_info_by_coord(start).size
        if stored_bytes > 2 * chunk_bytes + _PIECE_BYTES:
            raise ValueError(f"a chunk of {stored_bytes} bytes, expected up to {chunk_bytes}")
        mask, stored = dataset.read_direct_chunk(start)
        chunk = _unfiltered(stored, filters, mask, chunk_bytes, array.dtype).reshape(sides)
        part = tuple(slice(at, at + side) for at, side in zip(start, sides, strict=True))
        target = array[part]
        target[...] = chunk[tuple(slice(length) for length in target.shape)]


def _unfiltered(stored: bytes, filters: Sequence[int], mask: int, size: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Undo the filters of a chunk that its mask does not except, last to first."""
    import imagecodecs

    content: Any = stored
    shuffled = False
    for place, number in reversed(list(enumerate(filters))):
        if mask >> place & 1:
            continue
        if number == _FLETCHER:
            content = _checked(content)
        elif number == _DEFLATE:
            content = _inflated(content, size)
        elif number == _LZF:
            content = imagecodecs.lzf_decode(content, out=size)
        else:
            shuffled = True  # it stands first, so it comes last here
    if len(content) != size:
        raise ValueError(f"a chunk of {len(content)} bytes, expected {size}")
    planes = np.frombuffer(content, np.uint8)
    if shuffled:
        planes = planes.reshape(dtype.itemsize, -1).T
        return np.ascontiguousarray(planes).reshape(-1).view(dtype)
    return planes.view(dtype)


def _checked(content: bytes) -> bytes:
    import imagecodecs

    body = content[:-_CHECKSUM_BYTES]
    found = imagecodecs.h5checksum_fletcher32(body)
    if found != int.from_bytes(content[-_CHECKSUM_BYTES:], "little"):
        raise ValueError("a chunk that its checksum does not fit")
    return body


def _inflated(content: bytes, size: int) -> bytes:
    """Return deflated bytes as they were, ``size`` of them and no more."""
    import imagecodecs

    try:
        return bytes(imagecodecs.zlib_decode(content, out=size))
    except RuntimeError as error:
        raise ValueError(f"a chunk that is damaged, or expands beyond its {size} bytes") from error


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
# tifffile follows the chain of pages as far as it goes, in a circle too, logs what is wrong with them, and fills strips
# that a file does not hold with zeros: so they are walked before it does.

_COMPRESSIONS = {  # of which a decoder can be told how much to make: none that holds a picture of its own
    1: "none",
    5: "LZW",
    8: "deflate",
    32946: "deflate",
    32773: "PackBits",
    34925: "LZMA",
    50000: "Zstandard",
}

_MOST_PAGES = 64  # the planes of a packed frame are 4 to 36
_MOST_TAGS = 256
_MOST_TAG_BYTES = 16 << 20  # of all pages; 100,000 strips of offsets and lengths take 1.6 MB
_LARGEST_TILE = 1 << 20  # pixels, where the image is smaller
_SUB_IFDS = 330
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}


def _read_tiff(path: Path, check: Check, name: str) -> NDArray[Any]:
    import tifffile

    del name
    _check_pages(path)
    plain: dict[str, Any] = {f"is_{kind}": False for kind in tifffile.TIFF.FILE_FLAGS - {"shaped", "uniform"}}
    with tifffile.TiffFile(path, **plain) as file:
        series = file.series[0]
        check(Declared(tuple(series.shape), str(np.dtype(series.dtype))))
        _check_segments(series, path.stat().st_size)
        array: NDArray[Any] = series.asarray(maxworkers=1, buffersize=16 * _PIECE_BYTES)
    return array


class _TiffError(ValueError):
    """A TIFF file is damaged, or made to keep its reader busy."""


class _TiffForm:
    """How a file writes its numbers: classic TIFF or BigTIFF, in either byte order."""

    def __init__(self, head: bytes) -> None:
        order = {b"II": "<", b"MM": ">"}.get(head[:2])
        version = struct.unpack(f"{order}H", head[2:4])[0] if order and len(head) == 16 else 0
        if version not in (42, 43):
            raise _TiffError("does not begin as a TIFF file does")
        is_big = version == 43
        self.count = struct.Struct(f"{order}{'Q' if is_big else 'H'}")
        self.entry = struct.Struct(f"{order}{'HHQQ' if is_big else 'HHII'}")
        self.offset = struct.Struct(f"{order}{'Q' if is_big else 'I'}")
        self.first = self.offset.unpack_from(head, 8 if is_big else 4)[0]


def _check_pages(path: Path) -> None:
    """Walk the chain of pages before anything else does; ``OSError`` if the file cannot be read."""
    size = path.stat().st_size
    with path.open("rb") as file:
        form = _TiffForm(file.read(16))
        at, left = form.first, _MOST_TAG_BYTES
        seen: set[int] = set()
        while at:
            if at in seen or len(seen) == _MOST_PAGES:
                raise _TiffError(f"its pages go in a circle, or are more than {_MOST_PAGES}")
            seen.add(at)
            at, used = _next_page(file, form, at, size)
            left -= used
            if left < 0:
                raise _TiffError(f"the tags of its pages take more than {_MOST_TAG_BYTES} bytes")
    if not seen:
        raise _TiffError("has no page")


def _next_page(file: IO[bytes], form: _TiffForm, at: int, size: int) -> tuple[int, int]:
    """Return where the page after one is, and how many bytes the one's tags take."""
    file.seek(min(at, size))
    head = file.read(form.count.size)
    count = form.count.unpack(head)[0] if len(head) == form.count.size else 0
    if not 0 < count <= _MOST_TAGS:
        raise _TiffError(f"a page at byte {at} of {size} has {count} tags; expected 1 to {_MOST_TAGS}")
    table = file.read(count * form.entry.size + form.offset.size)
    if len(table) < count * form.entry.size + form.offset.size:
        raise _TiffError(f"ends within the tags of a page at byte {at} of {size}")
    used = 0
    for tag, kind, number, value in form.entry.iter_unpack(table[: -form.offset.size]):
        length = number * _TYPE_BYTES.get(kind, 1)
        if length > form.offset.size and value + length > size:
            raise _TiffError(f"its tag {tag} lies beyond the end of the file")
        if tag == _SUB_IFDS:
            raise _TiffError("has pages within its pages")
        used += length
    following: int = form.offset.unpack(table[-form.offset.size :])[0]
    return following, used


def _check_segments(series: tifffile.TiffPageSeries, size: int) -> None:
    """Check the strips or tiles of all pages of an array in a file of so many bytes."""
    pages: list[Any] = list(series.pages)
    if not all(pages) or math.prod(series.shape) != sum(math.prod(page.shape) for page in pages):
        raise _TiffError("its pages do not hold as many values as it declares")
    for page in pages:
        keyframe = page.keyframe
        if int(keyframe.compression) not in _COMPRESSIONS:
            known = ", ".join(dict.fromkeys(_COMPRESSIONS.values()))
            raise _TiffError(f"compression {int(keyframe.compression)}; expected {known}")
        tile = keyframe.tilewidth * keyframe.tilelength * max(keyframe.tiledepth, 1) if keyframe.is_tiled else 0
        if tile > max(4 * keyframe.imagewidth * keyframe.imagelength, _LARGEST_TILE):
            raise _TiffError(f"tiles of {keyframe.tilewidth} x {keyframe.tilelength} pixels in a smaller page")
        extents = list(zip(page.dataoffsets, page.databytecounts, strict=True))
        if not _is_whole(keyframe, extents):
            raise _TiffError("strips or tiles are missing")
        if max(offset + count for offset, count in extents) > size:
            raise _TiffError("its data lie beyond the end of the file: truncated?")


def _is_whole(keyframe: Any, extents: list[tuple[int, int]]) -> bool:
    """Return whether a page has all its strips or tiles; tifffile joins those that follow each other."""
    if not all(offset > 0 and count > 0 for offset, count in extents):
        return False
    if keyframe.is_contiguous or len(extents) == 1 < math.prod(keyframe.chunked):
        return int(keyframe.compression) == 1 and sum(count for _, count in extents) >= int(keyframe.nbytes)
    return bool(len(extents) == math.prod(keyframe.chunked))


_READERS: dict[str, Reader] = {
    "npy": _read_npy,
    "npz": _read_npz,
    "h5": _read_h5,
    "mat": _read_mat,
    "png": _read_png,
}
