"""Archives of arrays in the .npz format of strangers: members are looked at before anything is loaded.

No more of a member is decompressed than it declares, and its checksum is compared.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from eldata.base.npy import NpyError, read_npy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.base.npy import NpyHeader

_PIECE_BYTES = 1 << 20
# What zipfile raises of damaged and hostile archives. A RuntimeError is how it refuses members that are encrypted, and,
# as the NotImplementedError derived from it, patched data and versions of the format that it does not know.
_DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OverflowError, UnicodeDecodeError, RuntimeError)


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
        try:
            with self._archive.open(member) as content:
                array = read_npy(content, member.file_size, check)
                if content.read(1):  # at the end zipfile compares the checksum
                    raise NpyError("the member goes on after its array")
                if content.tell() != member.file_size:
                    raise NpyError(f"a member of {content.tell()} bytes that declares {member.file_size}")
        except _DAMAGE as error:
            raise NpyError(str(error) or type(error).__name__) from error
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
        try:
            archive = zipfile.ZipFile(file)
        except _DAMAGE as error:
            raise NpyError(str(error) or type(error).__name__) from error
        with archive:
            yield NpzArchive(archive)


class _SmallReads(io.BufferedReader):
    """A file of which no part is read that is larger than a member's piece, such as an endless list of members."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or size < 0:
            at = self.tell()
            size = self.seek(0, io.SEEK_END) - at
            self.seek(at)
        if size > _PIECE_BYTES:
            raise zipfile.BadZipFile(f"its list of members takes {size} bytes")
        return super().read(size)
