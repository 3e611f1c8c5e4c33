"""Plain-text tables, aligned."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> str:
    """Return lines of aligned columns: those of the indices ``left`` to the left, the others to the right."""
    widths = [max(len(cell) for cell in column) for column in zip(header, *rows, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if index in left else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (header, ["-" * width for width in widths], *rows)
    ]
    return "\n".join(lines)


def with_error(value: float, error: float) -> str:
    """Return ``value ± error`` with the digits that mean something: two of the error up to 0.29, one from 0.3 on.

    A value without a standard error (nan, infinite, 0) stands alone with five digits.
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:.5g}"
    places = max(0, math.ceil(-math.log10(error / 3)))
    return f"{round(value, places) + 0.0:.{places}f} ± {error:.{places}f}"
