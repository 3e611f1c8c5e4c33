"""A model in ONNX's protobuf, written by hand: a single operator with fixed weights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def onnx_network(operator: str = "Mul", weights: NDArray[np.floating[Any]] | float = 0.5) -> bytes:
    """A model of (1, c, h, w): y = operator(x, weights), with any height and width; by default y = x * 0.5."""

    def field(number: int, payload: bytes | int | str) -> bytes:
        if isinstance(payload, int):
            return bytes([number << 3, payload])
        content = payload.encode() if isinstance(payload, str) else payload
        return bytes([number << 3 | 2, len(content)]) + content

    def tensor_type(name: str) -> bytes:
        sides = b"".join(field(1, field(1, 1) if side == "n" else field(2, side)) for side in ("n", "c", "h", "w"))
        return field(1, name) + field(2, field(1, field(1, 1) + field(2, sides)))

    values = np.asarray(weights, "<f4")
    fixed = b"".join(field(1, side) for side in values.shape) + field(2, 1) + field(8, "k") + field(9, values.tobytes())
    node = field(1, "x") + field(1, "k") + field(2, "y") + field(4, operator)
    graph = field(1, node) + field(2, "g") + field(5, fixed) + field(11, tensor_type("x")) + field(12, tensor_type("y"))
    return field(1, 8) + field(7, graph) + field(8, field(2, 13))
