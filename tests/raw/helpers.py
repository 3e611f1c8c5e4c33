"""Files, sensors and formulas that the tests of ``eldata.raw`` share.

The formulas are plain strided numpy, written from the published packing and not from the package's tables.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from eldata.errors import RawFileError
from eldata.raw import read_header, read_raw
from eldata.records import Exposure, Sensor

Cfa = tuple[tuple[int, ...], ...]
Scalar = TypeVar("Scalar", bound=np.generic)

# Channel indices: R = 0, G1 = 1 (in R's rows), B = 2, G2 = 3.
BAYER: dict[str, Cfa] = {
    "RGGB": ((0, 1), (3, 2)),
    "BGGR": ((2, 3), (1, 0)),
    "GRBG": ((1, 0), (2, 3)),
    "GBRG": ((3, 2), (0, 1)),
}

# One period of X-Trans as the SID code expects it, row by row.
SID_XTRANS = ("RBGBRG", "GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB")


def xtrans_at(down: int, right: int) -> Cfa:
    """The CFA of a mosaic whose corner lies (down, right) inside of the SID code's period."""
    return tuple(tuple("RGB".index(SID_XTRANS[(y + down) % 6][(x + right) % 6]) for x in range(6)) for y in range(6))


XTRANS: dict[str, Cfa] = {f"xtrans-{y}{x}": xtrans_at(y, x) for y in range(6) for x in range(6)}


def blocks_at(side: int, down: int, right: int) -> Cfa:
    """The CFA of a mosaic whose corner lies (down, right) inside of R R.. G G.. / G G.. B B.., in blocks of a side."""
    rows = ["R" * side + "G" * side] * side + ["g" * side + "B" * side] * side
    period = 2 * side
    return tuple(
        tuple("RGBg".index(rows[(y + down) % period][(x + right) % period]) for x in range(period))
        for y in range(period)
    )


QUAD: dict[str, Cfa] = {f"quad-{y}{x}": blocks_at(2, y, x) for y in range(4) for x in range(4)}
NONA: dict[str, Cfa] = {f"nona-{y}{x}": blocks_at(3, y, x) for y in range(6) for x in range(6)}
CFAS: dict[str, Cfa] = {
    **BAYER,
    **XTRANS,
    **QUAD,
    **{name: cfa for name, cfa in NONA.items() if (int(name[-2]) - int(name[-1])) % 3 == 0},
}
SOME_CFAS: dict[str, Cfa] = {
    **BAYER,
    **{name: CFAS[name] for name in ("xtrans-00", "xtrans-15", "xtrans-42")},
    **{name: CFAS[name] for name in ("quad-00", "quad-13", "nona-00", "nona-41")},
}
DNG_KINDS: dict[str, tuple[Cfa, Literal["none", "lossless-jpeg"]]] = {
    "compressed": (BAYER["RGGB"], "lossless-jpeg"),
    "uncompressed": (BAYER["GBRG"], "none"),
    "X-Trans, compressed": (xtrans_at(0, 0), "lossless-jpeg"),
    "X-Trans, uncompressed": (xtrans_at(1, 2), "none"),
}

# By packed channel.
BAYER_COLOURS = "RGBG"
XTRANS_COLOURS = "RGBRBGGGG"

EXPOSURE = Exposure(iso=Fraction(800), exposure_s=Fraction(1, 30), f_number=Fraction(28, 10))


def is_xtrans(cfa: Cfa) -> bool:
    return len(cfa) == 6 and max(map(max, cfa)) == 2  # it does not tell its greens apart


def levels_of(cfa: Cfa) -> int:
    """How many black levels it has."""
    return 3 if is_xtrans(cfa) else 4


def layout_of(cfa: Cfa) -> tuple[int, int, int]:
    """Packed channels, packed pixels along a period, mosaic pixels along a packed one."""
    return (9, 2, 3) if is_xtrans(cfa) else (len(cfa) ** 2, 1, len(cfa))


def colours_of(cfa: Cfa) -> str:
    """By packed channel, as letters."""
    return XTRANS_COLOURS if is_xtrans(cfa) else "".join(colour * (len(cfa) // 2) ** 2 for colour in BAYER_COLOURS)


def indices_of(cfa: Cfa) -> list[int]:
    """Index in the CFA, and of its black level, by packed channel."""
    if is_xtrans(cfa):
        return ["RGB".index(colour) for colour in XTRANS_COLOURS]
    return [index for index in range(4) for _ in range((len(cfa) // 2) ** 2)]


def start_of(cfa: Cfa) -> Cfa:
    """The CFA at the corner of the packed area."""
    rows, columns = reference_area((100, 100), cfa)
    rolled = np.roll(np.array(cfa), (-rows.start, -columns.start), (0, 1))
    return tuple(tuple(row) for row in rolled.tolist())


def letters(cfa: Cfa) -> list[str]:
    """Colours of a CFA, as RGB letters."""
    return ["".join("RGBG"[index] for index in row) for row in cfa]


def random_mosaic(height: int, width: int, *, seed: int = 0, low: int = 500, high: int = 16000) -> NDArray[np.uint16]:
    return np.random.default_rng(seed).integers(low, high, (height, width), dtype=np.uint16)


def make_sensor(cfa: Cfa = BAYER["RGGB"], height: int = 60, width: int = 64, **fields: Any) -> Sensor:
    """A camera that is in no table of LibRaw's; Bayer channels have four different black levels."""
    values: dict[str, Any] = {
        "make": "Acme",
        "model": "Nocturne 1",
        "cfa": cfa,
        "black_level_dn": (256.0, 256.0, 256.0) if is_xtrans(cfa) else (512.0, 509.0, 511.0, 514.0),
        "white_level_dn": 15871.0,
        "height": height,
        "width": width,
        "white_balance": (2.1, 1.0, 1.5, 1.0),
        "xyz_to_camera": ((0.6612, -0.1321, -0.0534), (-0.5041, 1.3012, 0.2217), (-0.1034, 0.2159, 0.6105)),
    }
    values.update(fields)
    return Sensor(**values)


def sid_pack(im: NDArray[Scalar]) -> NDArray[Scalar]:
    """The published SID packing of an X-Trans mosaic whose sides are multiples of 6, in strided slices."""
    height, width = im.shape
    out = np.empty((9, height // 3, width // 3), im.dtype)
    # Of channels 0 to 4: where in the 6x6 period packed pixels (0, 0), (0, 1), (1, 0) and (1, 1) come from.
    sites = {
        0: ((0, 0), (0, 4), (3, 1), (3, 3)),  # R
        1: ((0, 2), (0, 5), (3, 2), (3, 5)),  # G
        2: ((0, 1), (0, 3), (3, 0), (3, 4)),  # B
        3: ((1, 2), (2, 5), (5, 2), (4, 5)),  # R
        4: ((2, 2), (1, 5), (4, 2), (5, 5)),  # B
    }
    for channel, ((a, b), (c, d), (e, f), (g, h)) in sites.items():
        out[channel, 0::2, 0::2] = im[a::6, b::6]
        out[channel, 0::2, 1::2] = im[c::6, d::6]
        out[channel, 1::2, 0::2] = im[e::6, f::6]
        out[channel, 1::2, 1::2] = im[g::6, h::6]
    out[5] = im[1::3, 0::3]
    out[6] = im[1::3, 1::3]
    out[7] = im[2::3, 0::3]
    out[8] = im[2::3, 1::3]
    return out


def restarts(cfa: Cfa) -> set[tuple[int, int]]:
    """The (rows, columns) to lose, below 6 each, after which an X-Trans CFA starts as the SID code's does."""
    here, wanted = np.array(cfa), np.array(xtrans_at(0, 0))
    return {
        (top, left)
        for top in range(6)
        for left in range(6)
        if np.array_equal(np.roll(here, (-top, -left), (0, 1)), wanted)
    }


def reference_area(shape: tuple[int, int], cfa: Cfa) -> tuple[slice, slice]:
    """The packed area by the stated crop rule (of two ties, the one that loses fewer rows)."""
    period = len(cfa)
    if is_xtrans(cfa):
        top, left = min(restarts(cfa), key=lambda crop: (sum(crop), crop))
    elif period == 2:
        top, left = 0, 0
    else:  # up to where another block begins
        columns = list(zip(*cfa, strict=True))
        top = next(y for y in range(period) if cfa[y] != cfa[y - 1])
        left = next(x for x in range(period) if columns[x] != columns[x - 1])
    height = (shape[0] - top) // period * period
    width = (shape[1] - left) // period * period
    return slice(top, top + height), slice(left, left + width)


def reference_pack(mosaic: NDArray[Scalar], cfa: Cfa) -> NDArray[Scalar]:
    """Packing by strided slices: by where the colours stand, X-Trans by the SID code."""
    rows, columns = reference_area((mosaic.shape[0], mosaic.shape[1]), cfa)
    im = mosaic[rows, columns]
    if is_xtrans(cfa):
        return sid_pack(im)
    period = len(cfa)
    side = period // 2
    row, column = next(
        (y, x)
        for y in (0, side)
        for x in (0, side)
        if letters(cfa)[(rows.start + y) % period][(columns.start + x) % period] == "R"
    )
    corners = ((row, column), (row, side - column), (side - row, side - column), (side - row, column))
    within = [(y, x) for y in range(side) for x in range(side)]
    return np.stack([im[y + down :: period, x + right :: period] for y, x in corners for down, right in within])


def check_refused(path: Path, words: str, *readers: Callable[[Path], object]) -> RawFileError:
    """Assert that a file is refused in one line that names it: by ``read_raw`` and ``read_header`` if none is given."""
    for read in readers or (read_raw, read_header):
        with pytest.raises(RawFileError, match=words) as caught:
            read(path)
        assert caught.value.path == path
        assert str(caught.value) == f"{path}: {caught.value.reason}"
        assert "\n" not in str(caught.value)
    return caught.value


Tag = tuple[int, str, int, object, bool]


def write_plain_dng(
    path: Path, data: NDArray[np.uint16] | Iterator[bytes], pattern: Sequence[str] | None = ("RG", "GB"), *tags: Tag,
    make: str = "Acme", model: str = "Nocturne 1", photometric: int = 32803, white: int | None = 16000,
    **options: Any,
) -> None:  # fmt: skip
    """Write a DNG with tifffile and nothing of the package: no EXIF IFD, no colour, no black level."""
    all_tags: list[Tag] = [
        (271, "s", 0, make, True),
        (272, "s", 0, model, True),
        (50706, "B", 4, bytes((1, 4, 0, 0)), True),
        (50707, "B", 4, bytes((1, 1, 0, 0)), True),
        (50708, "s", 0, f"{make} {model}", True),
        *tags,
    ]
    if white is not None:
        all_tags.append((50717, "I", 1, white, True))
    if pattern is not None:
        rows, columns = len(pattern), len(pattern[0])
        colours = bytes("RGB".index(letter) for row in pattern for letter in row)
        all_tags += [(33421, "H", 2, (rows, columns), True), (33422, "B", rows * columns, colours, True)]
    tifffile.imwrite(path, data, photometric=photometric, metadata=None, extratags=all_tags, **options)


def add_tags(path: Path, *tags: Tag) -> None:
    """Add tags of bytes, shorts, longs or pairs to the first directory of a little-endian DNG, or change them."""
    content = bytearray(path.read_bytes())
    (at,) = struct.unpack_from("<I", content, 4)
    count = struct.unpack_from("<H", content, at)[0]
    entries = {
        struct.unpack_from("<H", content, at + 2 + 12 * i)[0]: content[at + 2 + 12 * i :][:12] for i in range(count)
    }
    for code, kind, number, value, _ in tags:
        values = value if isinstance(value, (tuple, bytes)) else (value,)
        data = struct.pack(f"<{len(values)}{kind[-1]}", *values)
        place = data.ljust(4, b"\0")
        if len(data) > 4:
            place = struct.pack("<I", len(content))
            content += data + b"\0" * (len(data) % 2)
        entries[code] = bytearray(struct.pack("<HHI", code, _KINDS[kind], number)) + place
    struct.pack_into("<I", content, 4, len(content))
    content += struct.pack("<H", len(entries)) + b"".join(entries[code] for code in sorted(entries)) + b"\0" * 4
    path.write_bytes(content)


_KINDS = {"B": 1, "H": 3, "I": 4, "2I": 5, "i": 9, "2i": 10, "d": 12}


def active_area(top: int, left: int, bottom: int, right: int) -> Tag:
    return (50829, "I", 4, (top, left, bottom, right), True)


def black_levels(pattern: Sequence[Sequence[int]]) -> tuple[Tag, Tag]:
    """BlackLevelRepeatDim and BlackLevel."""
    flat = tuple(level for row in pattern for level in row)
    return (50713, "H", 2, (len(pattern), len(pattern[0])), True), (50714, "I", len(flat), flat, True)


OPCODE_LISTS = (51008, 51009, 51022)


def opcode_list(number: int, *opcodes: int, length: int = 20, declared: int | None = None) -> Tag:
    """OpcodeList1, 2 or 3 of opcodes by number, each with as many bytes of parameters."""
    parts = [struct.pack(">IBBBBII", opcode, 1, 3, 0, 0, 1, length) + b"\xff" * length for opcode in opcodes]
    data = struct.pack(">I", len(opcodes) if declared is None else declared) + b"".join(parts)
    return OPCODE_LISTS[number - 1], "B", len(data), data, True
