"""Arrays in the .npy format of strangers: what the header declares is looked at before anything is loaded.

numpy's own reader evaluates the header as Python, makes any type that it names, and reserves what it declares. Here the
header is matched against the three fields that it may have, values are numbers, and memory is reserved once the caller
has agreed to shape and type and the file is known to hold that many bytes.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

_MAGIC = b"\x93NUMPY"
_LENGTH_BYTES = {(1, 0): 2, (2, 0): 4, (3, 0): 4}
_MOST_HEADER_BYTES = 4096  # numpy pads that of plain numbers to 118 bytes
_MOST_DIMENSIONS = 32
_PIECE_BYTES = 1 << 20  # a member of an archive is decompressed in such pieces

_FIELD = re.compile(
    r"""\s*(?P<quote>['"])(?P<name>descr|fortran_order|shape)(?P=quote)\s*:\s*
        (?: '(?P<single>[ -~]{0,64}?)' | "(?P<double>[ -~]{0,64}?)" | (?P<records>\[[ -~]*\])
          | (?P<flag>True|False) | \((?P<sides>[\d\s,L]*)\) )
        \s*(?:,|$)""",
    re.VERBOSE,
)
_NUMBERS = re.compile(r"[<>=|]?(?:b1|[iu][1248]|f[248]|c8|c16)")


class NpyError(ValueError):
    """A file is not in the .npy format, not whole, or holds something else than numbers."""


@dataclass(frozen=True, slots=True)
class NpyHeader:
    """What a .npy file declares.

    Attributes
    ----------
    descr
        The type of its values as the file names it, such as ``<f4``; printable ASCII.
    fortran_order
        Whether the first index runs fastest.
    shape
        Its sides.
    """

    descr: str
    fortran_order: bool
    shape: tuple[int, ...]

    @property
    def dtype(self) -> np.dtype[Any] | None:
        """The type of its values, in the file's byte order; ``None`` if they are not numbers."""
        return np.dtype(self.descr) if _NUMBERS.fullmatch(self.descr) else None

    @property
    def values(self) -> str:
        """The type in words, whatever its byte order: ``float32``; of other things what the file calls them."""
        return self.descr if self.dtype is None else str(self.dtype.newbyteorder("="))

    @property
    def value_bytes(self) -> int:
        """Bytes of all its values.

        Raises
        ------
        NpyError
            If they are not numbers.
        """
        if self.dtype is None:
            raise NpyError(f"holds values of type {self.descr}, not numbers")
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(file: IO[bytes]) -> NpyHeader:
    """Read the header of a .npy file, versions 1 to 3; the values follow.

    Raises
    ------
    NpyError
        If there is none.
    """
    magic = file.read(8)
    if magic[:6] != _MAGIC or len(magic) < 8:
        raise NpyError("does not begin as a .npy file does")
    version = magic[6], magic[7]
    if version not in _LENGTH_BYTES:
        raise NpyError(f"is of version {version[0]}.{version[1]} of the .npy format; known are 1.0, 2.0 and 3.0")
    length = int.from_bytes(file.read(_LENGTH_BYTES[version]), "little")
    if length > _MOST_HEADER_BYTES:
        raise NpyError(f"has a header of {length} bytes; expected up to {_MOST_HEADER_BYTES}")
    header = file.read(length)
    if len(header) < length:
        raise NpyError("ends within its header")
    return _parsed(header.decode("latin1").strip())


def _parsed(text: str) -> NpyHeader:
    fields: dict[str, re.Match[str]] = {}
    at, end = 1, len(text) - 1
    while text[at:end].strip():
        field = _FIELD.match(text, at, end)
        if field is None or field["name"] in fields:
            break
        fields[field["name"]] = field
        at = field.end()
    kinds = {name: field.lastgroup for name, field in fields.items()}
    if not (text.startswith("{") and text.endswith("}")) or text[at:end].strip() or len(fields) != 3:
        raise NpyError("has a header without descr, fortran_order and shape, or with more")
    if kinds["descr"] not in ("single", "double", "records") or (kinds["fortran_order"], kinds["shape"]) != (
        "flag",
        "sides",
    ):
        raise NpyError("has a header whose descr, fortran_order or shape is something else")
    sides = [side.strip().removesuffix("L") for side in fields["shape"]["sides"].split(",") if side.strip()]
    if len(sides) > _MOST_DIMENSIONS or not all(re.fullmatch(r"[0-9]{1,18}", side) for side in sides):
        raise NpyError("has a header whose shape is not one of an array")
    descr = next(text for text in fields["descr"].group("single", "double", "records") if text is not None)
    return NpyHeader(descr, fields["fortran_order"]["flag"] == "True", tuple(map(int, sides)))


def read_npy(file: IO[bytes], size: int, check: Callable[[NpyHeader], None]) -> NDArray[Any]:
    """Read an array of numbers.

    Parameters
    ----------
    file
        At the beginning of the .npy file.
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
    flat: NDArray[Any] = np.empty(math.prod(header.shape), header.dtype)
    rest = flat.view(np.uint8).data
    while len(rest):
        piece = file.read(min(len(rest), _PIECE_BYTES))
        if not piece:
            raise NpyError(f"ends {len(rest)} bytes before its last value: truncated?")
        rest[: len(piece)] = piece
        rest = rest[len(piece) :]
    return flat.reshape(header.shape[::-1]).T if header.fortran_order else flat.reshape(header.shape)
