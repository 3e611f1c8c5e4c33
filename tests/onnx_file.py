"""A model in ONNX's protobuf, written by hand: a single operator with fixed weights."""

from __future__ import annotations

import struct


def onnx_network() -> bytes:
    """A model of (1, c, h, w): y = x * 0.5, with any height and width."""

    def field(number: int, payload: bytes | int | str) -> bytes:
        if isinstance(payload, int):
            return bytes([number << 3, payload])
        content = payload.encode() if isinstance(payload, str) else payload
        return bytes([number << 3 | 2, len(content)]) + content

    def tensor_type(name: str) -> bytes:
        sides = b"".join(field(1, field(1, 1) if side == "n" else field(2, side)) for side in ("n", "c", "h", "w"))
        return field(1, name) + field(2, field(1, field(1, 1) + field(2, sides)))

    fixed = field(2, 1) + field(8, "k") + field(9, struct.pack("<f", 0.5))
    node = field(1, "x") + field(1, "k") + field(2, "y") + field(4, "Mul")
    graph = field(1, node) + field(2, "g") + field(5, fixed) + field(11, tensor_type("x")) + field(12, tensor_type("y"))
    return field(1, 8) + field(7, graph) + field(8, field(2, 13))
