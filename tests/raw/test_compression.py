"""Which TIFF headers say that data was lost, on headers made by hand."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest

from eldata.errors import RawFileError
from eldata.raw.container import lossy_compression
from tests.cases import in_one_test

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import Literal

WIDTH, HEIGHT = 96, 64
CFA, LINEAR, YCBCR = 32803, 34892, 6
SONY, LOSSY_JPEG, NONE, JPEG = 32767, 34892, 1, 7
SUB_IFDS = 330


def directory(order: str, at: int, entries: Sequence[tuple[int, int, tuple[int, ...]]], following: int = 0) -> bytes:
    """A TIFF directory that stands at ``at``: tag, type (3 SHORT, 4 LONG) and values; long values right behind it."""
    table, values = struct.pack(order + "H", len(entries)), b""
    behind = at + 2 + 12 * len(entries) + 4
    for tag, kind, numbers in sorted(entries):
        data = struct.pack(f"{order}{len(numbers)}{'H' if kind == 3 else 'I'}", *numbers)
        table += struct.pack(order + "HHI", tag, kind, len(numbers))
        if len(data) <= 4:
            table += data.ljust(4, b"\0")
        else:
            table += struct.pack(order + "I", behind + len(values))
            values += data
    return table + struct.pack(order + "I", following) + values


def raw_file(
    path: Path,
    *,
    compression: int,
    held: int | Sequence[int],
    photometric: int = CFA,
    order: Literal["<", ">"] = "<",
    sub: bool = True,
) -> Path:
    """A file whose raw image is in a sub-IFD, as in an ARW or a DNG; the preview in IFD0 is lossy."""
    strips = [held] if isinstance(held, int) else list(held)
    start, place = 8, 400
    offsets = [1000 + sum(strips[:index]) for index in range(len(strips))]
    image = [
        (256, 4, (WIDTH,)),
        (257, 4, (HEIGHT,)),
        (259, 3, (compression,)),
        (262, 3, (photometric,)),
        (273, 4, tuple(offsets)),
        (279, 4, tuple(strips)),
    ]
    preview = [(256, 4, (16,)), (257, 4, (16,)), (259, 3, (LOSSY_JPEG,)), (262, 3, (YCBCR,)), (SUB_IFDS, 4, (place,))]
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", start if sub else place)
    content = head + (directory(order, start, preview) if sub else b"")
    content = content.ljust(place, b"\0") + directory(order, place, image)
    path.write_bytes(content.ljust(1000, b"\0") + bytes(sum(strips)))
    return path


PIXELS = WIDTH * HEIGHT
CASES = {
    "Sony, one byte a pixel": ({"compression": SONY, "held": PIXELS}, "Sony's lossy compression"),
    "Sony, one byte a pixel, in strips": ({"compression": SONY, "held": [PIXELS // 4] * 4}, "Sony's lossy compression"),
    "Sony, 14 bits a pixel": ({"compression": SONY, "held": PIXELS * 14 // 8}, None),
    "Sony, 12 bits a pixel": ({"compression": SONY, "held": PIXELS * 12 // 8}, None),
    "Sony, uncompressed": ({"compression": NONE, "held": PIXELS * 2}, None),
    "eight bits without compression": ({"compression": NONE, "held": PIXELS}, None),
    "DNG, lossy JPEG": ({"compression": LOSSY_JPEG, "held": PIXELS // 3}, "lossy JPEG"),
    "DNG, lossless JPEG": ({"compression": JPEG, "held": PIXELS // 2 * 3}, None),
    "DNG, deflate": ({"compression": 8, "held": PIXELS}, None),
    "no mosaic (34892 is LinearRaw too)": (
        {"compression": JPEG, "held": PIXELS, "photometric": LINEAR},
        None,
    ),
    "in IFD0": ({"compression": SONY, "held": PIXELS, "sub": False}, "Sony's lossy compression"),
}


@in_one_test("order", ["<", ">"])
@in_one_test("name", CASES)
def test_what_headers_say(name: str, order: str, tmp_path: Path) -> None:
    options, words = CASES[name]
    found = lossy_compression(raw_file(tmp_path / "a.arw", **options, order=order))  # type: ignore[arg-type] # a table
    if words is None:
        assert found is None
    else:
        assert found is not None
        assert words in found


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = raw_file(tmp_path / "a.arw", compression=SONY, held=PIXELS)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(RawFileError, match="truncated"):
        lossy_compression(path)
