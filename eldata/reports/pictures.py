"""Grey pictures of measured arrays, pixel by pixel, as PNG, with the scale that they share."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_GREYS = 32  # noise does not compress: fewer greys than an eye tells apart here save a third


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture: what it is called, what it shows in words, and its pixels."""

    label: str
    alt: str
    png: bytes
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures on one scale.

    Attributes
    ----------
    name, title, caption
        Identifier, heading, and what to look for.
    pictures
        One or more.
    black, white
        What the darkest and the lightest grey stand for.
    pixelated
        Whether pixels are to stay squares when enlarged.
    """

    name: str
    title: str
    caption: str
    pictures: tuple[Picture, ...]
    black: str
    white: str
    pixelated: bool


def grey(label: str, alt: str, values: NDArray[Any], low: float, high: float) -> Picture:
    """Return a picture in which ``low`` and below is black, ``high`` and above white."""
    span = high - low if high > low else 1.0
    steps = np.rint(np.clip((values - low) / span, 0, 1) * (_GREYS - 1))
    pixels = np.rint(steps * (255 / (_GREYS - 1))).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", optimize=True)
    return Picture(label, alt, buffer.getvalue(), pixels.shape[1], pixels.shape[0])


def pooled(plane: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """Return a plane of at most ``most`` rows and columns: means of blocks."""
    step = max(1, -(-max(plane.shape) // most))
    height, width = (length // step * step for length in plane.shape)
    blocks = plane[:height, :width].reshape(height // step, step, width // step, step)
    means: NDArray[np.float64] = blocks.mean(axis=(1, 3))
    return means


def limits(planes: Sequence[NDArray[Any]], low: float, high: float) -> tuple[float, float]:
    """Return the values that these shares of the entries of all planes stay below: black and white of a picture."""
    first, last = np.quantile(np.concatenate([plane.ravel() for plane in planes]), (low, high))
    return float(first), float(last)
