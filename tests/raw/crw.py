"""A writer of Canon's CRW files that knows nothing of the package's reader: heaps of records, and no pixels."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_START = 26


def heap(*records: tuple[int, bytes]) -> bytes:
    """Contents of the records, then their table, then where it is; a type with 0x4000 keeps its content there."""
    contents, table = b"", b""
    for kind, content in records:
        if kind & 0x4000:
            table += struct.pack("<H8s", kind, content)
        else:
            table += struct.pack("<HII", kind, len(content), len(contents))
            contents += content + bytes(len(content) % 2)
    return contents + struct.pack("<H", len(records)) + table + struct.pack("<I", len(contents))


def crw(shot: Sequence[int], *, make_model: bytes = b"Canon\0Canon EOS D60\0", seconds: int = 1514811812) -> bytes:
    """A file whose ShotInfo begins with these numbers; ``seconds`` since 1970 by the camera's clock."""
    info = struct.pack("<33h", *shot, *[0] * (33 - len(shot)))
    sensor = struct.pack("<17h", 34, 3152, 2068, 0, 0, 72, 16, 3143, 2063, *[0] * 8)
    exif = heap((0x102A, info), (0x1031, sensor), (0x1835, struct.pack("<4I", 2, 0, 514, 0)))
    camera = heap((0x080A, make_model.ljust(32, b"\0")), (0x501C, struct.pack("<H", 50)))
    properties = heap((0x180E, struct.pack("<3I", seconds, 0, 0)), (0x2807, camera), (0x300B, exif))
    head = b"II" + struct.pack("<I", _START) + b"HEAPCCDR" + struct.pack("<I", 0x00010002) + bytes(8)
    return head + heap((0x2005, bytes(4000)), (0x300A, properties))


def write_crw(path: Path, shot: Sequence[int], **fields: bytes | int) -> None:
    path.write_bytes(crw(shot, **fields))  # type: ignore[arg-type] # as crw has them
