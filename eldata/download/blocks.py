"""Blocks in an array of MATLAB's, such as those of SIDD: an archive of mosaics, each a member in NumPy's format.

The array is (images, blocks of each, rows, columns). Compressed as a whole, and with the first side running fastest, it
gives a block only to whom reads all of it: so blocks are unpacked once, and are files like any others from then on.
"""

from __future__ import annotations

import io
import zlib
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.array_files import read_array
from eldata.download.members import Member
from eldata.errors import ArchiveError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from eldata.base.pixels import Declared
    from eldata.download.members import NewFile

MARK = b"MATLAB 5.0 MAT-file"

_AGAIN = "is its download whole? Fetch it again"


def block_members(path: Path) -> tuple[Member, ...]:
    """Return a member for each block, ``<array>/<image>_<block>.npy``, counted from 0 in two digits.

    Raises
    ------
    ArchiveError
        If the file cannot be read, or does not hold one array of four sides.
    """
    return tuple(Member(name, name, "file", len(content), None, zlib.crc32(content)) for name, content in _blocks(path))


def unpack_blocks(files: Sequence[tuple[Member, NewFile]], path: Path) -> dict[str, bool]:
    """Write members to their files; return, by name, whether each got its place."""
    new_of = {member.name: new for member, new in files}
    placed = {}
    for name, content in _blocks(path):
        if name in new_of:
            with closing(new_of[name].open()) as target:
                target.write(content)
            placed[name] = new_of[name].finish()
    return placed


def _blocks(path: Path) -> Iterator[tuple[str, bytes]]:
    import scipy.io

    if path.suffix.lower() != ".mat":
        raise ArchiveError(path, "is a file of MATLAB's; give it a name that ends in .mat")
    try:
        held = [name for name, shape, _ in scipy.io.whosmat(path) if len(shape) == 4]
    except Exception as error:  # scipy's readers raise what a wrong number leads to
        raise ArchiveError(path, f"is damaged ({error}); {_AGAIN}") from error
    if len(held) != 1:
        found = ", ".join(held) or "none"
        raise ArchiveError(path, f"expected one array of blocks, (images, blocks, rows, columns); found {found}")
    array = read_array(path, _any_shape, name=held[0], error=ArchiveError, advice=_AGAIN)
    for image, block in np.ndindex(*array.shape[:2]):
        file = io.BytesIO()
        np.save(file, np.ascontiguousarray(array[image, block]), allow_pickle=False)
        yield f"{held[0]}/{image:02}_{block:02}.npy", file.getvalue()


def _any_shape(declared: Declared) -> None:
    """Take whatever array it is: its members are checked as an archive's are."""
