"""Photographs as scenes: those that an installed scikit-image has in its folder, in linear light.

Files are read where they lie, and nothing is downloaded: scikit-image fetches the rest of its pictures when they are
asked for. All that are named here are in the public domain or CC0, as its documentation states of each.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from PIL import Image

from eldata.demo.scenes import linear_light
from eldata.errors import EldataError

if TYPE_CHECKING:
    from numpy.typing import NDArray

# The two views of one stereo pair, or of one texture, never stand on both sides.
TEST_PICTURES: Final = ("astronaut.png", "coffee.png", "motorcycle_left.png", "hubble_deep_field.jpg", "camera.png")
TRAINING_PICTURES: Final = (
    *("chelsea.png", "rocket.jpg", "retina.jpg", "ihc.png", "brick.png", "grass.png", "gravel.png", "coins.png"),
    *("moon.png", "page.png", "cell.png"),
)
# The light on pictures without colour: under white light all channels would show the same.
_TINTS: Final = {
    "camera.png": (1.0, 0.92, 0.8),
    "brick.png": (1.0, 0.62, 0.45),
    "grass.png": (0.55, 0.9, 0.4),
    "gravel.png": (1.0, 0.9, 0.78),
    "coins.png": (1.0, 0.8, 0.5),
    "moon.png": (0.85, 0.92, 1.0),
    "page.png": (1.0, 0.95, 0.8),
    "cell.png": (0.7, 0.85, 1.0),
}


def picture_folder() -> Path | None:
    """Return where an installed scikit-image keeps its pictures; ``None`` if it is not installed."""
    found = find_spec("skimage")
    if found is None or found.origin is None:
        return None
    return Path(found.origin).parent / "data"


def pictures_of(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return those of the pictures that are there, in their order."""
    folder = picture_folder()
    return () if folder is None else tuple(name for name in names if (folder / name).is_file())


def picture_radiance(name: str, height: int, width: int) -> NDArray[np.float32]:
    """Return a picture's middle as linear light: float32 (3, height, width) in sRGB primaries, from 0 to 1.

    Parameters
    ----------
    name
        One of those that :func:`pictures_of` has found.
    height, width
        The size that it is scaled to, in pixels.

    Raises
    ------
    EldataError
        If scikit-image is not installed.
    """
    folder = picture_folder()
    if folder is None:
        raise EldataError(f"the picture {name} is scikit-image's: pip install 'eldata[baselines]'")
    with Image.open(folder / name) as image:
        srgb = np.asarray(image.convert("RGB"))
    high, wide = srgb.shape[:2]
    cut_high, cut_wide = min(high, round(wide * height / width)), min(wide, round(high * width / height))
    top, left = (high - cut_high) // 2, (wide - cut_wide) // 2
    light = linear_light(srgb[top : top + cut_high, left : left + cut_wide])
    channels = [
        Image.fromarray(np.ascontiguousarray(light[..., channel])).resize((width, height), Image.Resampling.BICUBIC)
        for channel in range(3)
    ]
    tint = np.array(_TINTS.get(name, (1.0, 1.0, 1.0)), np.float32)[:, None, None]
    return np.clip(np.stack([np.asarray(channel, np.float32) for channel in channels]), 0, 1) * tint
