"""Arrays as pictures: side by side in a figure, as small JPEGs, as greys and as colours of errors."""

from __future__ import annotations

import io
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from matplotlib import colormaps
from PIL import Image

from eldata.plots.axes import Drawing, Theme, drawn_grid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray


Panel: TypeAlias = tuple[str, "NDArray[Any]"]
"""Title, and pixels: (h, w, 3) uint8 colours, or (h, w) values that are drawn with their scale."""

_MOST_BYTES = 14_000  # of a thumbnail: two and a table stay below 40 kB as text
_SHARE_SHOWN = 0.998
_GREYS = 32  # noise does not compress: fewer greys than an eye tells apart here save a third


def side_by_side(title: str, panels: Sequence[Panel]) -> Drawing:
    """Return a figure of pictures, an axes each; single values as a map with its scale."""
    return drawn_grid(title, [(name, partial(_draw_pixels, pixels)) for name, pixels in panels])


def _draw_pixels(pixels: NDArray[Any], axes: Axes, _theme: Theme) -> None:
    """Draw a picture (h, w, 3), or single values (h, w) as a map with its scale."""
    if pixels.ndim == 3:
        axes.imshow(pixels)
    else:
        low, high = limits([pixels], 1 - _SHARE_SHOWN, _SHARE_SHOWN)
        image = axes.imshow(pixels, cmap="inferno", vmin=low, vmax=high)
        axes.figure.colorbar(image, ax=axes, shrink=0.8)
    axes.grid(visible=False)
    axes.set_axis_off()


# --- encoded ------------------------------------------------------------------------------------------------------


def thumbnail(pixels: NDArray[np.uint8], most: int) -> bytes:
    """Encode (h, w, 3) as a JPEG of at most so many columns and rows, small enough for a notebook."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image = image.reduce(max(1, -(-max(image.size) // most)))
    for quality in (85, 70, 50, 30):
        jpeg = _encode_image(image, format="JPEG", quality=quality)
        if len(jpeg) <= _MOST_BYTES:
            break
    return jpeg


def jpeg_of(pixels: NDArray[np.uint8], quality: int) -> bytes:
    """Encode (h, w, 3) as a JPEG whose colours are as fine as its brightness: noise of single pixels stays."""
    return _encode_image(Image.fromarray(np.ascontiguousarray(pixels)), format="JPEG", quality=quality, subsampling=0)


def grey_png(values: NDArray[Any], low: float, high: float) -> bytes:
    """Encode (h, w) as a PNG in which ``low`` and below is black, ``high`` and above white."""
    span = high - low if high > low else 1.0
    steps = np.rint(np.clip((values - low) / span, 0, 1) * (_GREYS - 1))
    pixels = np.rint(steps * (255 / (_GREYS - 1))).astype(np.uint8)
    return _encode_image(Image.fromarray(pixels), format="PNG", optimize=True)


def _encode_image(image: Image.Image, **options: Any) -> bytes:
    """Encode an image in a file format, given by Pillow's options."""
    buffer = io.BytesIO()
    image.save(buffer, **options)
    return buffer.getvalue()


# --- sizes and scales ---------------------------------------------------------------------------------------------


def block_means(values: NDArray[Any], step: int) -> NDArray[Any]:
    """Return means of blocks of so many rows and columns of (..., h, w); incomplete blocks at the ends are cut off."""
    height, width = (length // step * step for length in values.shape[-2:])
    cut = values[..., :height, :width]
    blocks = cut.reshape(*values.shape[:-2], height // step, step, width // step, step)
    return cast("NDArray[Any]", blocks.mean(axis=(-3, -1)))


def limits(planes: Sequence[NDArray[Any]], low: float, high: float) -> tuple[float, float]:
    """Find the values that these shares of all planes' entries stay below: black and white of a picture."""
    first, last = np.quantile(np.concatenate([plane.ravel() for plane in planes]), (low, high))
    return float(first), float(last)


def error_limit(errors: Sequence[NDArray[Any]]) -> float:
    """Find the error that 99.8 % of all stay below: the lightest colour of :func:`heat`; above 0."""
    every = [error.ravel() for error in errors]
    return max(float(np.quantile(np.concatenate(every), _SHARE_SHOWN)) if every else 0.0, 1e-6)


def heat(error: NDArray[Any], limit: float) -> NDArray[np.uint8]:
    """Return errors as colours from black over red to white, by their square root."""
    steps = np.rint(np.sqrt(np.clip(error / limit, 0, 1)) * 255).astype(np.intp)
    return cast("NDArray[np.uint8]", _heat_colours()[steps])


def _heat_colours() -> NDArray[np.uint8]:
    """Return the 256 colours of :func:`heat`, (256, 3)."""
    colours = np.asarray(colormaps["inferno"](np.linspace(0, 1, 256)))[:, :3]
    return cast("NDArray[np.uint8]", np.rint(colours * 255).astype(np.uint8))


def heat_gradient() -> str:
    """Return the colours of :func:`heat` as a CSS gradient from 0 to the limit."""
    stops = np.linspace(0, 1, 11)
    colours = _heat_colours()[np.rint(np.sqrt(stops) * 255).astype(np.intp)]
    return ", ".join(f"rgb({r} {g} {b}) {100 * stop:.0f}%" for (r, g, b), stop in zip(colours, stops, strict=True))
