"""The clips of st_rred.json: pairs of clips that numpy alone makes again anywhere, from the raw bits of PCG64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Clip = npt.NDArray[np.float64]


def uniform(seed: int, *shape: int) -> Clip:
    """Numbers in [0, 1). The bits of a seeded PCG64 are promised to stay; those of a Generator's methods are not."""
    bits = np.random.PCG64(seed).random_raw(int(np.prod(shape)))
    return np.ldexp((np.asarray(bits, np.uint64) >> np.uint64(11)).astype(np.float64), -53).reshape(shape)


def scene(frames: int, height: int, width: int, seed: int = 0, speed: int = 3) -> Clip:
    """A texture of several scales, (T, H, W) in [0.1, 0.9], that moves by ``speed`` rows and columns a frame."""
    side = 32 * (2 + (max(height, width) + speed * frames) // 32)
    texture = np.zeros((side, side))
    for scale, weight in ((2, 0.1), (8, 0.3), (32, 0.6)):
        coarse = uniform(seed + scale, side // scale, side // scale)
        texture += weight * np.kron(coarse, np.ones((scale, scale)))
    texture = blur(texture[np.newaxis], 1)[0]
    return 0.1 + 0.8 * np.stack(
        [texture[speed * t : speed * t + height, speed * t : speed * t + width] for t in range(frames)]
    )


def still(frames: int, height: int, width: int, seed: int = 0) -> Clip:
    """One frame, repeated: DRV's reference."""
    return scene(frames, height, width, seed, speed=0)


def blur(clip: Clip, radius: int) -> Clip:
    """Mean over a square of 2 radius + 1 pixels a side, edges mirrored."""
    padded = np.pad(clip, ((0, 0), (radius, radius), (radius, radius)), "reflect")
    height, width = clip.shape[1:]
    offsets = range(2 * radius + 1)
    total = sum(padded[:, y : y + height, x : x + width] for y in offsets for x in offsets)
    return np.asarray(total) / (2 * radius + 1) ** 2


def noise(clip: Clip, amplitude: float, seed: int = 1000) -> Clip:
    """Fresh uniform noise in every frame."""
    return clip + amplitude * (2.0 * uniform(seed, *clip.shape) - 1.0)


def flicker(clip: Clip, gain: float) -> Clip:
    """Even frames are darker, odd frames brighter by ``gain``."""
    gains = 1.0 + gain * np.where(np.arange(len(clip)) % 2, 1.0, -1.0)
    return clip * gains[:, np.newaxis, np.newaxis]


def drop(clip: Clip) -> Clip:
    """Frames 1, 3, 5... are lost; the one before is shown again."""
    return clip[np.arange(len(clip)) // 2 * 2]


def packed(clip: Clip) -> Clip:
    """(T, 4, h, w): R, G1, B, G2 of a mosaic whose colours differ in gain."""
    gains = (0.5, 1.0, 0.7, 0.98)
    corners = ((0, 0), (0, 1), (1, 1), (1, 0))
    return np.stack([g * clip[:, y::2, x::2] for g, (y, x) in zip(gains, corners, strict=True)], axis=1)


@dataclass(frozen=True)
class Case:
    """A prediction and its reference, made when asked for."""

    name: str
    make: Callable[[], tuple[Clip, Clip]]
    peak: float = 255.0


def _case(
    name: str, reference: Clip, distort: Callable[[Clip], Clip], peak: float = 255.0,
    layout: Callable[[Clip], Clip] = lambda clip: clip,
) -> Case:  # fmt: skip
    return Case(name, lambda: (layout(distort(reference)), layout(reference)), peak)


CASES = (
    _case("noise, smallest size, 2 frames", scene(2, 41, 41), lambda c: noise(c, 0.1)),
    _case("blur, 3 frames, odd size", scene(3, 59, 83), lambda c: blur(c, 3)),
    _case("noise, 4 frames, odd size", scene(4, 97, 131), lambda c: noise(c, 0.05)),
    _case("blurred noise, 5 frames", scene(5, 120, 90), lambda c: blur(noise(c, 0.2), 2)),
    _case("flicker, 8 frames", scene(8, 64, 72), lambda c: flicker(c, 0.02)),
    _case("frame drops at odd frames, 6 frames", scene(6, 76, 61), drop),
    _case("frame drops at even frames, 7 frames", scene(7, 90, 61), lambda c: np.concatenate([c[:1], drop(c[1:])])),
    _case("flat offset and noise, 7 frames", scene(7, 50, 150), lambda c: noise(c + 0.1, 0.02)),
    _case("still reference, noise, 5 frames", still(5, 100, 101), lambda c: noise(c, 0.1)),
    _case("still reference, noise, 5 frames, peak 1", still(5, 100, 101), lambda c: noise(c, 0.1), 1.0),
    _case("blur, 2 frames, peak 1", scene(2, 200, 333), lambda c: blur(c, 4), 1.0),
    _case("packed raw, 4 frames", scene(4, 130, 122), lambda c: noise(c, 0.1), 255.0, packed),
    _case("packed raw, 5 frames, peak 1", scene(5, 166, 150), lambda c: blur(noise(c, 0.1), 1), 1.0, packed),
)

BAND_IMAGE = scene(1, 75, 92, seed=7)[0]
"""The image whose band at an eighth of the size is kept."""
