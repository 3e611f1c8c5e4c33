"""A file of which only so much can be read, for parsers that have no bounds of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

from eldata.errors import RawFileError

if TYPE_CHECKING:
    from pathlib import Path

# exifread reads number by number: 1,400 times in a real file of many tags, 9,000 times with a Canon's own. What is
# allowed here takes half a second; a directory of 65,535 entries that share their values asks for 65 million reads.
_MOST_READS = 1 << 18
_MOST_BYTES = 1 << 26


class BoundedFile:
    """What exifread needs of a file opened for reading: it gives up where a file keeps its reader busy."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path, self._file = path, file
        self._reads, self._bytes = _MOST_READS, _MOST_BYTES
        self.seek, self.tell = file.seek, file.tell

    def read(self, size: int = -1) -> bytes:
        """Return that many bytes, or what is left.

        Raises
        ------
        RawFileError
            If too much has been read, in pieces or bytes.
        """
        content = self._file.read(size)
        self._reads -= 1
        self._bytes -= len(content)
        if self._reads < 0 or self._bytes < 0:
            raise RawFileError(self._path, "damaged, or made to keep a reader busy: its EXIF declares far too much")
        return content
