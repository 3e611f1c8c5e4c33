"""Arrays of strangers in numpy's two formats, .npy and .npz, read by numpy once their headers are agreed to.

numpy reserves what a header declares, and makes any type that it names. So the header is read first and handed to a
check, values must be numbers, and the file must hold as many bytes as it declares. Nothing is unpickled. Of a .npz no
more is decompressed than a member declares, and its checksum is compared.
"""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

_MOST_HEADER_BYTES = 4096  # numpy pads that of plain numbers to 118 bytes
_MOST_DIMENSIONS = 32
_LARGEST_READ = 1 << 20
_LONGEST_NAME = 64  # of a type
# What zipfile raises of damaged and hostile archives. A RuntimeError is how it refuses members that are encrypted, and,
# as the NotImplementedError derived from it, patched data and versions of the format that it does not know.
_DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OverflowError, UnicodeDecodeError, RuntimeError)


class NpyError(ValueError):
    """A file is not in numpy's format, not whole, or holds something else than numbers."""


@dataclass(frozen=True, slots=True)
class NpyHeader:
    """What a .npy file declares: sides, whether the first index runs fastest, type of values in its byte order."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype[Any]

    @property
    def kind(self) -> str:
        """The type in words, whatever its byte order: ``float32``; shortened, where it is not of numbers."""
        return str(self.dtype.newbyteorder("="))[:_LONGEST_NAME]

    @property
    def value_bytes(self) -> int:
        """Bytes of all its values.

        Raises
        ------
        NpyError
            If they are not numbers.
        """
        if self.dtype.kind not in "biufc":
            raise NpyError(f"holds values of type {self.kind}, not numbers")
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(file: IO[bytes]) -> NpyHeader:
    """Read the header of a .npy file, versions 1 and 2; the values follow.

    Raises
    ------
    NpyError
        If there is none, or one of more than 4 kB.
    """
    try:
        header = NpyHeader(*_header_reader(file)(file, max_header_size=_MOST_HEADER_BYTES))
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
        If it is not a .npy file, does not hold numbers, or ends before its last value.
    OSError
        If it cannot be read.
    """
    start = file.tell()
    header = read_npy_header(file)
    check(header)
    held = size - (file.tell() - start)
    if held < header.value_bytes:
        raise NpyError(f"declares {header.value_bytes} bytes of values and has {held}: truncated?")
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
            if content.read(1):  # at the end zipfile compares the checksum
                raise NpyError("the member goes on after its array")
            if content.tell() != member.file_size:
                raise NpyError(f"a member of {content.tell()} bytes that declares {member.file_size}")
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
    with _SmallReads(path.open("rb", buffering=0)) as file:
        with _damage_named():
            archive = zipfile.ZipFile(file)
        with archive:
            yield NpzArchive(archive)


@contextmanager
def _damage_named() -> Iterator[None]:
    try:
        yield
    except _DAMAGE as error:
        raise NpyError(_first_line(error)) from error


class _SmallReads(io.BufferedReader):
    """A file of which no large part is read at once, such as an endless list of members."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or size < 0:
            at = self.tell()
            size = self.seek(0, io.SEEK_END) - at
            self.seek(at)
        if size > _LARGEST_READ:
            raise zipfile.BadZipFile(f"its list of members takes {size} bytes")
        return super().read(size)
