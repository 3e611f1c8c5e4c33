"""Arrays of strangers, .npy, .npz and PNG: read by numpy and imagecodecs once their headers are agreed to.

A header is read first and handed to a check, and nothing is reserved, decompressed or decoded that it does not declare.
"""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from eldata.base.files import file_problem
from eldata.base.visible import in_line
from eldata.errors import FileError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

# --- npy ------------------------------------------------------------------------------------------------------------
# numpy reserves what a header declares, and makes any type that it names. So values must be numbers, and the file must
# hold as many bytes as it declares. Nothing is unpickled. Of a .npz no more is decompressed than a member declares, and
# its checksum is compared.

_MOST_HEADER_BYTES = 4096  # numpy pads that of plain numbers to 118 bytes
_MOST_DIMENSIONS = 32
_LONGEST_NAME = 64  # of a type
# What zipfile raises of damaged and hostile archives. A RuntimeError is how it refuses members that are encrypted, and,
# as the NotImplementedError derived from it, patched data and versions of the format that it does not know.
_DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OverflowError, UnicodeDecodeError, RuntimeError)


class NpyError(ValueError):
    """A file is not in numpy's format, not whole, or holds something else than numbers."""


@dataclass(frozen=True, slots=True)
class Declared:
    """What a file says of its array: the shape, and the type of its values as numpy calls it, such as ``float32``."""

    shape: tuple[int, ...]
    values: str


@dataclass(frozen=True, slots=True)
class NpyHeader(Declared):
    """Of a .npy file; also whether the first index runs fastest, and the type of values in the file's byte order."""

    fortran_order: bool
    dtype: np.dtype[Any]

    @property
    def value_bytes(self) -> int:
        """Bytes of all its values.

        Raises
        ------
        NpyError
            If they are not numbers.
        """
        if self.dtype.kind not in "biufc":
            raise NpyError(f"holds values of type {self.values}, not numbers")
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(file: IO[bytes]) -> NpyHeader:
    """Read the header of a .npy file, versions 1 and 2; the values follow.

    Raises
    ------
    NpyError
        If there is none, or one of more than 4 kB.
    """
    try:
        shape, fortran_order, dtype = _header_reader(file)(file, max_header_size=_MOST_HEADER_BYTES)
        header = NpyHeader(shape, str(dtype.newbyteorder("="))[:_LONGEST_NAME], fortran_order, dtype)
    except (NpyError, OSError, *_DAMAGE):
        raise
    except Exception as error:  # of whatever the header's literal and type lead to
        raise NpyError(f"is not a .npy file of numbers ({_first_line(error)})") from error
    if len(header.shape) > _MOST_DIMENSIONS or not all(0 <= side < 1 << 60 for side in header.shape):
        raise NpyError("has a header whose shape is not one of an array")
    return header


def _header_reader(file: IO[bytes]) -> Callable[..., Any]:
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0
    if version == (2, 0):
        return np.lib.format.read_array_header_2_0
    # 3.0 is for names of fields in other scripts.
    raise NpyError(f"is of version {version[0]}.{version[1]} of the .npy format; known are 1.0 and 2.0")


def read_npy(file: IO[bytes], size: int, check: Callable[[NpyHeader], None]) -> NDArray[Any]:
    """Read an array of numbers.

    Parameters
    ----------
    file
        At the beginning of the .npy file; it can seek.
    size
        How many bytes that has.
    check
        Is called with the header before memory is reserved, and raises if that is not what is wanted.

    Returns
    -------
    ndarray
        In the file's byte order and its order of values.

    Raises
    ------
    NpyError
        If it is not a .npy file, does not hold numbers, or has fewer bytes than its values or more.
    OSError
        If it cannot be read.
    """
    start = file.tell()
    header = read_npy_header(file)
    check(header)
    held = size - (file.tell() - start)
    if held != header.value_bytes:
        what = "truncated" if held < header.value_bytes else "were bytes inserted"
        raise NpyError(f"declares {header.value_bytes} bytes of values and has {held}: {what}?")
    file.seek(start)
    try:
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False, max_header_size=_MOST_HEADER_BYTES)
    except ValueError as error:
        raise NpyError(f"ends before its last value: truncated? ({_first_line(error)})") from error
    return array


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


# --- npz --------------------------------------------------------------------------------------------------------------


class NpzArchive:
    """An open .npz file.

    Attributes
    ----------
    names
        Of its members, in their order, without ``.npy``.
    """

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._members = archive.infolist()
        self.names = [member.filename.removesuffix(".npy") for member in self._members]

    def read(self, name: str, check: Callable[[NpyHeader], None]) -> NDArray[Any]:
        """Return an array, in the file's byte order and order of values; ``check`` as of :func:`read_npy`.

        Raises
        ------
        NpyError
            If there is no such member, or it is damaged.
        """
        if name not in self.names:
            raise NpyError(f"holds no array {name}")
        member = self._members[self.names.index(name)]
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise NpyError(f"compressed by method {member.compress_type}; expected numpy's savez_compressed")
        with _damage_named(), self._archive.open(member) as content:
            array = read_npy(content, member.file_size, check)
            content.read(1)  # at the end zipfile compares the checksum
        return array


@contextmanager
def opened_npz(path: Path) -> Iterator[NpzArchive]:
    """Open a .npz file.

    Raises
    ------
    NpyError
        If it is not a whole archive.
    OSError
        If it cannot be read.
    """
    if not zipfile.is_zipfile(path):
        raise NpyError("is not a whole npz archive")
    with _damage_named():
        archive = zipfile.ZipFile(path)
    with archive:
        yield NpzArchive(archive)


@contextmanager
def _damage_named() -> Iterator[None]:
    try:
        yield
    except _DAMAGE as error:
        raise NpyError(_first_line(error)) from error


# --- png ------------------------------------------------------------------------------------------------------------
# Files as DRV and predictions have them, up to 16 bits per sample. Only chunks that are pixels are handed on: some
# bytes of compressed text or profile can stand for megabytes. imagecodecs (libpng) reads 16-bit RGB, which Pillow
# does not. Samples come as the file has them, in the order R, G, B, without gamma or colour management; OpenCV, which
# the DRV code uses, returns the same samples as B, G, R.

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 26
_END = b"\0\0\0\0IEND\xaeB`\x82"
_COLOURS = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}
_CHANNELS = {"grey": (), "grey with alpha": (2,), "RGB with alpha": (4,)}  # the others have three

# What pixels are made of, beside the header; texts, profiles and times are passed over: of 1.5 MB of compressed text
# libpng makes 1.5 GB, in a minute.
_OF_PIXELS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
_HEADER_CHUNK, _WHOLE_HEADER = b"\0\0\0\x0dIHDR", 33
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
    problem = file_problem(path)
    if problem is not None:
        raise FileError(path, problem)
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER_BYTES)
            size = file.seek(0, 2)
            file.seek(max(0, size - len(_END)))
            tail = file.read()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from error
    if not head.startswith(_SIGNATURE) or len(head) < _HEADER_BYTES:
        raise FileError(path, "is not a PNG file")
    if tail != _END:
        raise FileError(path, f"does not end as a PNG does ({size} bytes): truncated? copy or download it again")
    return _header(head[16:])


def _header(content: bytes | memoryview) -> PngHeader:
    width, height, bit_depth, colour = struct.unpack_from(">IIBB", content)
    name = _COLOURS.get(colour, f"colour type {colour}")
    shape = height, width, *_CHANNELS.get(name, (3,))
    return PngHeader(shape, "uint16" if bit_depth == 16 else "uint8", bit_depth, name)


def read_png(path: Path, check: Callable[[PngHeader], None] | None = None) -> NDArray[Any]:
    """Decode a PNG file: (H, W) or (H, W, channels), uint8 or uint16.

    Parameters
    ----------
    path
        The file.
    check
        Is called with the header before anything is decoded, and raises if that is not what is wanted.

    Raises
    ------
    ValueError
        If it is not a PNG file, is truncated, damaged or goes on after its end, or holds more compressed data than its
        pixels can need.
    OSError, RuntimeError
        If it cannot be read or decoded.
    """
    import imagecodecs

    content = memoryview(path.read_bytes())
    if content[:16] != _SIGNATURE + _HEADER_CHUNK or len(content) < _WHOLE_HEADER:
        raise ValueError("does not begin as a PNG file")
    if check is not None:
        check(_header(content[16:]))
    array: NDArray[Any] = imagecodecs.png_decode(b"".join(_pixel_chunks(content)))
    return array


def _pixel_chunks(content: memoryview) -> Iterator[memoryview]:
    """Yield the parts of a PNG file but for chunks that are not pixels; libpng checks what it is then given."""
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


def rgb_frame(path: Path) -> NDArray[np.float32]:
    """Read a 16-bit RGB PNG as a frame, (3, h, w) float32: its samples / 65535. Raises like :func:`read_rgb16`."""
    samples = read_rgb16(path).transpose(2, 0, 1)
    pixels = np.empty(samples.shape, np.float32)
    return np.divide(samples, np.float32(65535), out=pixels, dtype=np.float32)


def read_rgb16(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit RGB PNG.

    Returns
    -------
    ndarray
        (H, W, 3) uint16 in the order R, G, B.

    Raises
    ------
    FileError
        If the file cannot be read or decoded, or is not 16-bit RGB.
    """
    header = read_png_header(path)
    if (header.bit_depth, header.colour) != (16, "RGB"):
        raise FileError(path, f"expected a 16-bit RGB PNG, found {header}")
    if math.prod(header.shape[:2]) > _MOST_PIXELS:
        most = _MOST_PIXELS // 1_000_000
        raise FileError(path, f"expected up to {most} megapixels, found {header.size}; is it damaged?")
    try:
        array: NDArray[np.uint16] = read_png(path)
    except (OSError, RuntimeError, ValueError) as error:  # imagecodecs' errors are RuntimeErrors
        raise FileError(path, f"cannot be decoded ({in_line(str(error))}); copy or download it again") from error
    return array
