"""The demo's simulated camera body as the tests of one ISO use it: one record of truths, frames by the list."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from eldata.demo.body import Body as Specimen
from eldata.demo.body import FixedFeatures, KnownNoise, temporal_noise_dn
from eldata.records import Sensor
from tests.raw.helpers import xtrans_at

BAYER = ((0, 1), (3, 2))
XTRANS = xtrans_at(0, 0)


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
    vignetting: float = 0.5

    def with_(self, **changes: object) -> Camera:
        return replace(self, **changes)  # type: ignore[arg-type] # of the tests' own making

    @property
    def channel(self) -> NDArray[np.int64]:
        pattern = np.array(self.cfa)
        period = len(pattern)
        rows, columns = np.ogrid[: self.shape[0], : self.shape[1]]
        channel: NDArray[np.int64] = pattern[rows % period, columns % period]
        return channel

    @property
    def sensor(self) -> Sensor:
        return Sensor("eldata", "Test", self.cfa, (self.black,) * len(self.bias), self.white, *self.shape)

    @property
    def noise(self) -> KnownNoise:
        return KnownNoise(100, self.gain, self.tukey_lambda, self.sigma_tl, self.sigma_row, self.bias)

    @property
    def features(self) -> FixedFeatures:
        """The figures in DN hold at this camera's own gain."""
        return FixedFeatures(
            prnu=self.prnu,
            dsnu_dn=self.dsnu,
            column_pattern_dn=self.column_pattern,
            hot_share=self.hot_share,
            bias_shading_dn=self.shading,
            vignetting=self.vignetting,
            gain_dn_per_e=self.gain,
        )


class Body:
    """One specimen: its fixed pattern is drawn once, and its frames follow from the same generator."""

    def __init__(self, camera: Camera, generator: np.random.Generator) -> None:
        self.camera = camera
        self.generator = generator
        # The same draws twice: one specimen, under even light and behind a lens.
        even_light = replace(camera.features, vignetting=0.0)
        self._even = Specimen(camera.sensor, even_light, copy.deepcopy(generator))
        self._shaded = Specimen(camera.sensor, camera.features, generator)
        self.hot = self._shaded.hot
        self.fixed = self._shaded.offset_dn(camera.noise)

    @property
    def colour_bias_dn(self) -> tuple[float, ...]:
        """The bias with what the fixed pattern of this specimen adds to it."""
        return self._shaded.colour_bias_dn(self.camera.noise)

    def noise(self) -> NDArray[np.float32]:
        return temporal_noise_dn(self.camera.noise, self.camera.shape, self.generator)

    def bias_frame(self) -> NDArray[np.uint16]:
        return self._shaded.bias_frame(self.camera.noise, self.generator)

    def flat_frame(self, level_dn: float, *, shaded: bool = True, drift: float = 0.0) -> NDArray[np.uint16]:
        """A flat of a mean level over black in the middle, DN."""
        specimen = self._shaded if shaded else self._even
        return specimen.flat_frame(self.camera.noise, level_dn, self.generator, drift)

    def bias_frames(self, count: int) -> list[NDArray[np.uint16]]:
        return [self.bias_frame() for _ in range(count)]

    def flat_pairs(
        self, levels: Sequence[float], *, shaded: bool = True, drift: float = 0.0
    ) -> list[tuple[NDArray[np.uint16], NDArray[np.uint16]]]:
        return [
            (self.flat_frame(level, shaded=shaded), self.flat_frame(level, shaded=shaded, drift=drift))
            for level in levels
        ]
