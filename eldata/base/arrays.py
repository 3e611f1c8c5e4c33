"""Arrays in strangers' files: npy, npz, h5, mat, png and tiff, read by numpy, h5py, scipy, imagecodecs and tifffile.

A file's header is read first, and its shape and type go to a check; only then are values read. Nothing is unpickled, no
other file is followed, and nothing larger is reserved or decompressed than the header declares. A file that does not
hold all its values is refused, since libraries fill the rest with zeros.
"""

from __future__ import annotations

import logging
import math
import os
import struct
import sys
import zipfile
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from eldata.base.files import file_problem, read_file
from eldata.base.visible import in_line
from eldata.errors import FileError, PredictionError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    import h5py
    from numpy.typing import NDArray

_LONGEST_REASON = 200
_NAMES_SHOWN = 6


def is_tensor(value: object) -> bool:
    """Tell whether a value is a torch tensor, without importing torch where it is not used."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


@dataclass(frozen=True, slots=True)
class Declared:
    """Shape of a file's array and type of its values as numpy calls it, such as ``float32``, as its header has them."""

    shape: tuple[int, ...]
    values: str

    @property
    def value_bytes(self) -> int:
        """Bytes of all values, which are numbers."""
        return math.prod(self.shape) * np.dtype(self.values).itemsize


def read_array(
    path: Path,
    check: Callable[[Declared], None],
    *,
    name: str = "prediction",
    index: int | None = None,
    kind: str = "",
    error: type[FileError] = PredictionError,
    advice: str = "write it again",
) -> NDArray[Any]:
    """Read a file's array, in the file's byte order and order of values.

    Parameters
    ----------
    path
        npy, npz, h5, mat, png; anything else is taken for TIFF.
    check
        Raises a :class:`FileError` if what the file declares is not what is wanted; called before values are read.
    name
        The array to read if a file holds several.
    index
        Which part of its first side to read, as if it were all; ``None``: all of it.
    kind
        Such as ``.npz``, of a file of any name; by default its extension.
    error, advice
        The error to raise if a file cannot be read, and what to do about it.

    Raises
    ------
    FileError
        What ``check`` raises; ``error``, if the file cannot be read.
    """
    kind = kind or path.suffix
    steps = _read_in_steps(path, kind, name, index, mapped=index is not None)
    with _convert_errors(path, kind, error, advice), closing(steps):
        check(next(steps))
        array: NDArray[Any] = next(steps)
    check(Declared(array.shape, str(array.dtype.newbyteorder("="))))
    return array


def declared_array(
    path: Path,
    *,
    name: str = "prediction",
    index: int | None = None,
    error: type[FileError] = PredictionError,
    advice: str = "write it again",
) -> Declared:
    """Read the header of a file's array; raises like :func:`read_array`."""
    steps = _read_in_steps(path, path.suffix, name, index, mapped=True)
    with _convert_errors(path, path.suffix, error, advice), closing(steps):
        declared: Declared = next(steps)
        return declared


@contextmanager
def _convert_errors(path: Path, kind: str, error: type[FileError], advice: str) -> Iterator[None]:
    """Raise ``error``, with the file's name and the advice, for whatever reading the file raises."""
    if (problem := file_problem(path)) is not None:
        raise error(path, problem)
    try:
        yield
    except FileError as cause:
        raise (error(path, cause.reason) if type(cause) is FileError else cause) from None
    except Exception as cause:  # six libraries, each with its own kinds
        reason = in_line(_first_line(cause)[:_LONGEST_REASON])
        raise error(path, f"cannot be read as {kind[1:]} ({reason}); {advice}") from cause


def _read_in_steps(path: Path, kind: str, name: str, index: int | None, *, mapped: bool) -> Generator[Any, None, None]:
    """Yield the header of the file's array, or of a part of its first side, then that; map it if it can be."""
    kind = kind.lower()
    with path.open("rb") as file:
        beginning = file.read(6)
    if kind == ".mat" and beginning.startswith(b"\x89HDF"):
        raise FileError(path, "is HDF5 without MATLAB's header: name it .h5")
    if kind == ".h5" and beginning == b"MATLAB":
        raise FileError(path, "is a MATLAB file: name it .mat")
    steps = _read_npy(path, name, mapped=mapped) if kind == ".npy" else _READERS.get(kind, _read_tiff)(path, name)
    if index is None:
        yield from steps
        return
    declared: Declared = next(steps)
    if index >= (*declared.shape, 0)[0]:
        raise FileError(path, f"holds an array of shape {declared.shape}, which has no part {index}")
    yield Declared(declared.shape[1:], declared.values)
    yield np.array(next(steps)[index])


def _first_line(error: Exception) -> str:
    """Take the first line of an error's message, or its type if the message is empty."""
    return (str(error) or type(error).__name__).splitlines()[0]


def _choose(names: Sequence[str], wanted: str) -> str:
    """Choose a file's only array, or the wanted one among several."""
    if len(names) == 1:
        return names[0]
    if names.count(wanted) == 1:
        return wanted
    more = f" and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else ""
    raise ValueError(
        f"expected one array, or one called {wanted!r}; found {', '.join(names[:_NAMES_SHOWN]) or 'none'}{more}"
    )


# --- npy and npz ------------------------------------------------------------------------------------------------------

_MOST_HEADER_BYTES = 4096  # numpy pads that of plain numbers to 118 bytes
_LONGEST_TYPE = 64
_MOST_DIMENSIONS = 32


class NpyError(ValueError):
    """A file is not in numpy's format, not whole, or holds something else than numbers."""


def read_npy_header(file: IO[bytes]) -> Declared:
    """Read the header of a .npy file of numbers, versions 1 and 2; the values follow.

    Raises
    ------
    NpyError
        If there is none, one of more than 4 kB, or the values are not numbers.
    """
    try:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file, max_header_size=_MOST_HEADER_BYTES)
    except OSError:
        raise
    except Exception as error:  # of whatever the header's literal and type lead to
        raise NpyError(f"is not a .npy file of numbers ({_first_line(error)})") from error
    values = str(dtype.newbyteorder("="))[:_LONGEST_TYPE]
    if dtype.kind not in "biufc":
        raise NpyError(f"holds values of type {values}, not numbers")
    if len(shape) > _MOST_DIMENSIONS or not all(0 <= side < 1 << 60 for side in shape):
        raise NpyError("has a header whose shape is not one of an array")
    return Declared(shape, values)


def _read_npy_file(file: IO[bytes], size: int, *, mapped: Path | None = None) -> Generator[Any, None, None]:
    """Yield the header and the values of a .npy file of so many bytes, which can seek; or what of it is ``mapped``."""
    header = read_npy_header(file)
    if mapped is None:
        yield header
    held = size - file.tell()
    if held != header.value_bytes:
        what = "truncated" if held < header.value_bytes else "were bytes inserted"
        raise NpyError(f"declares {header.value_bytes} bytes of values and has {held}: {what}?")
    if mapped is not None:
        yield header
        yield np.lib.format.open_memmap(mapped, mode="r", max_header_size=_MOST_HEADER_BYTES)
    file.seek(0)
    try:
        array = np.lib.format.read_array(file, allow_pickle=False, max_header_size=_MOST_HEADER_BYTES)
    except ValueError as error:
        raise NpyError(f"ends before its last value: truncated? ({_first_line(error)})") from error
    file.read(1)  # at the end of an archive's member zipfile compares the checksum
    yield array


def _read_npy(path: Path, _: str, *, mapped: bool = False) -> Generator[Any, None, None]:
    """Yield the header, then the array of a .npy file."""
    with path.open("rb") as file:
        yield from _read_npy_file(file, path.stat().st_size, mapped=path if mapped else None)


def _read_npz(path: Path, name: str) -> Generator[Any, None, None]:
    """Yield the header, then the values of one array in a .npz archive."""
    if not zipfile.is_zipfile(path):
        raise NpyError("is not a whole npz archive")
    with zipfile.ZipFile(path) as archive:
        members = [(member.filename.removesuffix(".npy"), member) for member in archive.infolist()]
        chosen = _choose([own for own, _ in members], name)
        member = next(member for own, member in members if own == chosen)
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise NpyError(f"compressed by method {member.compress_type}; expected numpy's savez_compressed")
        with archive.open(member) as content:
            yield from _read_npy_file(content, member.file_size)


# --- HDF5 and MATLAB --------------------------------------------------------------------------------------------------

_MOST_CHUNK_SLACK = 1 << 20
# As MATLAB names its numbers; the rest (cell, struct, char, sparse ...) has no array.
_MATLAB_TYPES = {"double": "float64", "single": "float32", "logical": "bool"}
_MATLAB_TYPES |= {name: name for sign in ("", "u") for bits in (8, 16, 32, 64) for name in (f"{sign}int{bits}",)}


def _read_h5(path: Path, name: str) -> Generator[Any, None, None]:
    """Yield the header, then the values of one dataset at the root of an HDF5 file; other files are not followed."""
    import h5py

    with h5py.File(path, "r") as file:
        own = [item for item in file if file.get(item, getclass=True, getlink=True) is h5py.HardLink]  # no other file's
        dataset = file[_choose([item for item in own if file.get(item, getclass=True) is h5py.Dataset], name)]
        yield Declared(dataset.shape or (), str(dataset.dtype.newbyteorder("=")))
        _check_h5(dataset)
        yield dataset[()]


def _check_h5(dataset: h5py.Dataset) -> None:
    """Raise ``ValueError`` unless all values are in the file: HDF5 fills the rest with zeros."""
    if dataset.external or dataset.is_virtual:
        raise ValueError("its values lie in other files")
    stored_bytes = dataset.id.get_storage_size()
    if dataset.chunks is None:
        if stored_bytes != dataset.nbytes:
            raise ValueError("its values were never written")
        return
    chunk_bytes = math.prod(dataset.chunks) * dataset.dtype.itemsize
    if max(chunk_bytes, stored_bytes) > 2 * dataset.nbytes + _MOST_CHUNK_SLACK:
        raise ValueError(f"chunks of {chunk_bytes} bytes, {stored_bytes} in all, for an array of {dataset.nbytes}")
    expected = math.prod(-(-length // side) for length, side in zip(dataset.shape, dataset.chunks, strict=True))
    written = dataset.id.get_num_chunks()
    if written != expected:
        raise ValueError(f"{written} of its {expected} chunks were written")


def _read_mat(path: Path, name: str) -> Generator[Any, None, None]:
    """Yield the header, then the values of one variable in a MATLAB file."""
    import scipy.io
    from scipy.io.matlab import matfile_version

    if matfile_version(path)[0] == 2:  # MATLAB 7.3: HDF5, whose arrays have MATLAB's sides in reverse
        with closing(_read_h5(path, name)) as steps:
            declared: Declared = next(steps)
            yield Declared(declared.shape[::-1], declared.values)
            yield next(steps).transpose()
        return
    variables = {item: (shape, _MATLAB_TYPES.get(kind)) for item, shape, kind in scipy.io.whosmat(path)}
    chosen = _choose([item for item, (_, values) in variables.items() if values is not None], name)
    shape, values = variables[chosen]
    yield Declared(tuple(shape), values or "")
    yield np.asarray(scipy.io.loadmat(path, variable_names=[chosen])[chosen])


# --- TIFF -------------------------------------------------------------------------------------------------------------

# none, LZW, deflate, PackBits, LZMA, Zstandard: a decoder can be told how much to make. Others hold pictures.
_COMPRESSIONS = (1, 5, 8, 32946, 32773, 34925, 50000)
_LARGEST_TILE = 1 << 20  # pixels, where the image is smaller


def _read_tiff(path: Path, _: str) -> Generator[Any, None, None]:
    """Yield the header, then the values of a TIFF file's first image, of one or more pages."""
    import tifffile

    if not tifffile.logger().handlers:  # or Python prints its remarks beside our error
        tifffile.logger().addHandler(logging.NullHandler())
    # Formats within TIFF that refer to other files are read as plain TIFF.
    plain: dict[str, Any] = {f"is_{kind}": False for kind in tifffile.TIFF.FILE_FLAGS - {"shaped", "uniform"}}
    with tifffile.TiffFile(path, **plain) as file:
        if not file.pages or not file.series:
            raise ValueError("holds no image")
        series = file.series[0]
        yield Declared(tuple(series.shape), str(np.dtype(series.dtype)))
        pages: list[Any] = list(series.pages)
        if not all(pages) or math.prod(series.shape) != sum(math.prod(page.shape) for page in pages):
            raise ValueError("its pages do not hold as many values as it declares")
        for page in pages:
            _check_page(page, os.fstat(file.filehandle.fileno()).st_size)
        yield series.asarray(maxworkers=1, buffersize=1 << 24)


def _check_page(page: Any, file_bytes: int) -> None:
    """Raise ``ValueError`` unless all strips or tiles are in the file: tifffile fills the rest with zeros."""
    keyframe, offsets, counts = page.keyframe, page.dataoffsets, page.databytecounts
    if keyframe.compression not in _COMPRESSIONS:
        raise ValueError(f"compression {int(keyframe.compression)}; expected none or a lossless one")
    if keyframe.is_tiled and math.prod(keyframe.tile) > max(4 * math.prod(keyframe.shape), _LARGEST_TILE):
        raise ValueError(f"tiles of {keyframe.tile} pixels in a smaller page")
    pieces = math.prod(keyframe.chunked)
    if not len(offsets) == len(counts) in (1, pieces) or min(offsets) <= 0 or min(counts) <= 0:
        raise ValueError("strips or tiles are missing")
    if keyframe.compression == 1 and sum(counts) < keyframe.nbytes:
        raise ValueError(f"its strips or tiles have {sum(counts)} bytes, and its pixels {keyframe.nbytes}")
    if max(map(sum, zip(offsets, counts, strict=True))) > file_bytes:
        raise ValueError("its data lie beyond the end of the file: truncated?")


# --- png --------------------------------------------------------------------------------------------------------------
# Samples come as the file has them, in the order R, G, B, without gamma or colour management. imagecodecs (libpng)
# reads 16-bit RGB, which Pillow does not.

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 26
_END = b"\0\0\0\0IEND\xaeB`\x82"
_COLOURS = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}
_CHANNELS = {"grey": (), "grey with alpha": (2,), "RGB with alpha": (4,)}  # the others have three
# Chunks that pixels are made of. Texts and profiles are passed over: libpng makes 1.5 GB of 1.5 MB of compressed text.
_OF_PIXELS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
_MOST_PIXELS = 100_000_000  # of a frame that is read without knowing its size: the largest sensors with room for RGB


@dataclass(frozen=True, slots=True)
class PngHeader(Declared):
    """Of a PNG: (H, W) or (H, W, channels); also bits per sample, and ``grey``, ``RGB``, ``palette`` or with alpha."""

    bit_depth: int
    colour: str

    def __str__(self) -> str:
        return f"{self.bit_depth}-bit {self.colour}"

    @property
    def size(self) -> str:
        """In pixels, across and down."""
        return f"{self.shape[1]} x {self.shape[0]}"


def read_png_header(path: Path) -> PngHeader:
    """Read a PNG's header without decoding its pixels.

    Raises
    ------
    FileError
        If the file cannot be read, is not a PNG, or does not end like one: it is truncated.
    """
    head, tail, size = read_file(_read_ends, path, FileError)
    if not head.startswith(_SIGNATURE) or len(head) < _HEADER_BYTES:
        raise FileError(path, "is not a PNG file")
    if tail != _END:
        raise FileError(path, f"does not end as a PNG does ({size} bytes): truncated? copy or download it again")
    width, height, bit_depth, colour = struct.unpack_from(">IIBB", head, 16)
    name = _COLOURS.get(colour, f"colour type {colour}")
    shape = height, width, *_CHANNELS.get(name, (3,))
    return PngHeader(shape, "uint16" if bit_depth == 16 else "uint8", bit_depth, name)


def _read_ends(path: Path) -> tuple[bytes, bytes, int]:
    """Read the first bytes of a PNG, its last bytes, and its size."""
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(_END)))
        return head, file.read(), size


def _pixel_chunks(content: memoryview) -> Iterator[memoryview]:
    """Yield the parts of a PNG file that pixels are made of; libpng checks their content."""
    yield content[:8]
    at, kind = 8, b""
    while kind != b"IEND":
        if len(content) < at + 12:
            raise ValueError("ends without its last chunk: truncated?")
        length, kind = struct.unpack_from(">I4s", content, at)
        if kind in _OF_PIXELS:
            yield content[at : at + length + 12]
        at += length + 12
    if at != len(content):
        raise ValueError(f"{len(content) - at} bytes follow its last chunk")


def _read_png(path: Path, _: str) -> Generator[Any, None, None]:
    """Yield the header, then the pixels of a PNG."""
    import imagecodecs

    yield read_png_header(path)
    yield imagecodecs.png_decode(b"".join(_pixel_chunks(memoryview(path.read_bytes()))))


def read_rgb16(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit RGB PNG: (H, W, 3) uint16 in the order R, G, B.

    Raises
    ------
    FileError
        If the file cannot be read or decoded, or is not 16-bit RGB.
    """

    def check(declared: Declared) -> None:
        """Refuse other samples than 16-bit RGB, and more of them than a camera has."""
        if declared.values != "uint16" or declared.shape[2:] != (3,):
            raise FileError(path, f"expected a 16-bit RGB PNG, found {declared}")
        if math.prod(declared.shape[:2]) > _MOST_PIXELS:
            size = f"{declared.shape[1]} x {declared.shape[0]}"
            raise FileError(path, f"expected up to {_MOST_PIXELS // 10**6} megapixels, found {size}; is it damaged?")

    return read_array(path, check, kind=".png", error=FileError, advice="copy or download it again")


_READERS: dict[str, Callable[[Path, str], Generator[Any, None, None]]] = {
    ".npy": _read_npy,
    ".npz": _read_npz,
    ".h5": _read_h5,
    ".mat": _read_mat,
    ".png": _read_png,
}
