"""A simulated camera for the tests, in plain numpy and scipy: nothing of the package's noise model is used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

BAYER = ((0, 1), (3, 2))
XTRANS = (
    (0, 2, 1, 2, 0, 1),
    (1, 1, 0, 1, 1, 2),
    (1, 1, 2, 1, 1, 0),
    (2, 0, 1, 0, 2, 1),
    (1, 1, 2, 1, 1, 0),
    (1, 1, 0, 1, 1, 2),
)


@dataclass(frozen=True)
class Camera:
    """The truth."""

    shape: tuple[int, int] = (1024, 1536)
    cfa: tuple[tuple[int, ...], ...] = BAYER
    gain: float = 1.0
    tukey_lambda: float = -0.05
    sigma_tl: float = 2.0
    sigma_row: float = 0.5
    bias: tuple[float, ...] = (1.5, -0.75, 0.5, -2.0)
    black: float = 512.0
    white: float = 16383.0
    prnu: float = 0.01
    dsnu: float = 0.6
    column_pattern: float = 0.3
    hot_share: float = 1e-4
    shading: float = 0.0

    def with_(self, **changes: object) -> Camera:
        return replace(self, **changes)  # type: ignore[arg-type] # of the tests' own making

    @property
    def channel(self) -> NDArray[np.int64]:
        pattern = np.array(self.cfa)
        period = len(pattern)
        rows, columns = np.ogrid[: self.shape[0], : self.shape[1]]
        channel: NDArray[np.int64] = pattern[rows % period, columns % period]
        return channel


class Body:
    """One specimen: its fixed pattern is drawn once."""

    def __init__(self, camera: Camera, generator: np.random.Generator) -> None:
        self.camera = camera
        self.generator = generator
        shape = camera.shape
        self.response = 1 + camera.prnu * generator.standard_normal(shape, dtype=np.float32)
        fixed = camera.dsnu * generator.standard_normal(shape, dtype=np.float32)
        fixed += camera.column_pattern * generator.standard_normal((1, shape[1]), dtype=np.float32)
        y, x = np.ogrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j]
        fixed += (camera.shading * (y + x**2)).astype(np.float32)
        self.hot = generator.random(shape, dtype=np.float32) < camera.hot_share
        count = int(self.hot.sum())
        fixed[self.hot] += (
            generator.uniform(15, 3000, count) * np.where(generator.random(count) < 0.8, 1, -0.05)
        ).astype(np.float32)
        self.fixed = fixed + camera.black + np.array(camera.bias, dtype=np.float32)[camera.channel]
        self.vignette = 1 - 0.25 * (y**2 + x**2).astype(np.float32)

    def noise(self) -> NDArray[np.float32]:
        """Tukey-lambda quantiles of uniforms in float64, and a normal offset per row."""
        c = self.camera
        u = np.clip(self.generator.random(c.shape), 1e-16, 1 - 1e-16)
        if c.tukey_lambda == 0:
            read = np.log(u / (1 - u))
        else:
            read = (u**c.tukey_lambda - (1 - u) ** c.tukey_lambda) / c.tukey_lambda
        row = c.sigma_row * self.generator.standard_normal((c.shape[0], 1))
        return (c.sigma_tl * read + row).astype(np.float32)

    def _digitised(self, values: NDArray[np.float32]) -> NDArray[np.uint16]:
        return np.clip(np.rint(values), 0, self.camera.white).astype(np.uint16)

    def bias_frame(self) -> NDArray[np.uint16]:
        return self._digitised(self.fixed + self.noise())

    def flat_frame(self, level_dn: float, *, shaded: bool = True, drift: float = 0.0) -> NDArray[np.uint16]:
        """A flat of a mean level over black, DN."""
        light = level_dn / self.camera.gain * (1 + drift) * self.response
        if shaded:
            light = light * self.vignette
        signal = self.camera.gain * self.generator.poisson(light).astype(np.float32)
        return self._digitised(self.fixed + self.noise() + signal)

    def bias_frames(self, count: int) -> list[NDArray[np.uint16]]:
        return [self.bias_frame() for _ in range(count)]

    def flat_pairs(
        self, levels: Sequence[float], *, shaded: bool = True, drift: float = 0.0
    ) -> list[tuple[NDArray[np.uint16], NDArray[np.uint16]]]:
        return [
            (self.flat_frame(level, shaded=shaded), self.flat_frame(level, shaded=shaded, drift=drift))
            for level in levels
        ]
