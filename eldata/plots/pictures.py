"""Pictures beside each other, and small ones for a notebook."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from PIL import Image

from eldata.plots.axes import drawn_grid

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from eldata.plots.axes import Drawing, Theme

Panel: TypeAlias = tuple[str, "NDArray[Any]"]
"""Title, and pixels: (h, w, 3) uint8 colours, or (h, w) values that are drawn with their scale."""

_MOST_BYTES = 14_000  # of a thumbnail: two and a table stay below 40 kB as text
_SHARE_SHOWN = 0.998


def side_by_side(title: str, panels: Sequence[Panel]) -> Drawing:
    """Return a figure of pictures, an axes each; single values as a map with its scale."""
    return drawn_grid(title, [(name, _drawing_of(pixels)) for name, pixels in panels])


def _drawing_of(pixels: NDArray[Any]) -> Callable[[Axes, Theme], None]:
    def draw(axes: Axes, theme: Theme) -> None:
        del theme
        if pixels.ndim == 3:
            axes.imshow(pixels)
        else:
            low, high = np.quantile(pixels, (1 - _SHARE_SHOWN, _SHARE_SHOWN))
            image = axes.imshow(pixels, cmap="inferno", vmin=low, vmax=high)
            axes.figure.colorbar(image, ax=axes, shrink=0.8)
        axes.grid(visible=False)
        axes.set_axis_off()

    return draw


def thumbnail(pixels: NDArray[np.uint8], most: int) -> bytes:
    """Return (h, w, 3) as a JPEG of at most so many columns and rows, small enough for a notebook."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image = image.reduce(max(1, -(-max(image.size) // most)))
    for quality in (85, 70, 50, 30):
        buffer = io.BytesIO()
        image.save(buffer, format="JPEG", quality=quality)
        if buffer.tell() <= _MOST_BYTES:
            break
    return buffer.getvalue()
