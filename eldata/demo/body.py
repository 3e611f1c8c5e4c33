"""One specimen of a simulated camera: known noise, and a fixed pattern that is drawn once and stays.

A frame is, in DN and rounded to whole DN within [0, white]::

    D = black + colour bias + fixed pattern + K electrons + sigma_TL Q(u) + row noise
    electrons = Poisson(light x response),   u uniform in (0, 1),   row noise: one normal draw per mosaic row

with Q the quantile of the Tukey-lambda distribution (K. Wei et al., TPAMI 2021, section 3.1.2). It is written in plain
numpy and scipy and shares no code with :mod:`eldata.noise` and :mod:`eldata.calibration`: these are checked against it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.records import Sensor

# A hot pixel's offset at the features' own gain: mostly far above its neighbours, one in five a little below them.
_HOT_DN = (15.0, 3000.0)
_HOT_BRIGHT_SHARE = 0.8
_HOT_DARK_FACTOR = -0.05

# Nearer to 0 than this the quantile is its logistic limit to nine digits, and the plain formula loses more to rounding.
_LOGISTIC_BELOW = 1e-8


@dataclass(frozen=True, slots=True)
class KnownNoise:
    """The true noise of a camera at one ISO.

    Attributes
    ----------
    iso
        ISO speed.
    gain_dn_per_e
        System gain K, DN per photoelectron, above 0.
    tukey_lambda, sigma_tl_dn
        Shape and scale of the read noise; the shape above -0.5, where the variance is finite.
    sigma_row_dn
        Standard deviation of the rows' offsets, DN.
    colour_bias_dn
        Offset of each CFA channel from its black level, DN: R, G1, B, G2 (Bayer) or R, G, B (X-Trans).
    """

    iso: int
    gain_dn_per_e: float
    tukey_lambda: float
    sigma_tl_dn: float
    sigma_row_dn: float
    colour_bias_dn: tuple[float, ...]

    @property
    def sigma_gauss_dn(self) -> float:
        """Standard deviation of the read noise, DN: what a Gaussian model of it should find."""
        from scipy.stats import tukeylambda

        return self.sigma_tl_dn * float(tukeylambda.std(self.tukey_lambda))


@dataclass(frozen=True, slots=True)
class FixedFeatures:
    """What stays the same from frame to frame; 0 switches a feature off, and all are 0 unless given.

    The figures in DN hold at ``gain_dn_per_e`` and grow with the square root of the gain K: part of a real pattern
    arises before the amplifier (in proportion to K), part after it (the same at every K). The published fits of read
    noise over K have slopes near one half for the same reason.

    Attributes
    ----------
    prnu
        Relative standard deviation of the pixels' response to light.
    dsnu_dn, column_pattern_dn
        Standard deviation of the offsets of pixels, and of whole columns, DN.
    hot_share
        Share of hot pixels: four in five 15 to 3000 DN above the others, one in five up to 150 DN below them.
    bias_shading_dn
        Strength s of a smooth glow s (y + x^2), DN; x and y go from -1 to 1 over the frame.
    vignetting
        Relative fall-off of the light in the corners of flats, below 1; in the middle of the frame there is none.
    gain_dn_per_e
        The gain at which the figures in DN hold, DN per photoelectron.
    """

    prnu: float = 0.0
    dsnu_dn: float = 0.0
    column_pattern_dn: float = 0.0
    hot_share: float = 0.0
    bias_shading_dn: float = 0.0
    vignetting: float = 0.0
    gain_dn_per_e: float = 1.0

    def scale(self, gain_dn_per_e: float) -> float:
        """Compute the factor that scales figures in DN to a gain K."""
        return math.sqrt(gain_dn_per_e / self.gain_dn_per_e)


class Body:
    """One specimen of a camera.

    Parameters
    ----------
    sensor
        Bayer or X-Trans, with the size of the frames.
    features
        How strong its fixed pattern is.
    generator
        Draws the pattern; the frames have generators of their own.

    Attributes
    ----------
    channel
        CFA channel of each pixel, (H, W) uint8.
    response
        Relative response of each pixel to light, (H, W) float32, mean 1.
    hot
        The hot pixels, (H, W) bool: at the same places at every ISO.
    pattern_dn
        Fixed pattern at the features' own gain, (H, W) float32, DN.
    light
        Relative light on each pixel of a flat, (H, W) float32: 1 in the middle.
    """

    def __init__(self, sensor: Sensor, features: FixedFeatures, generator: np.random.Generator) -> None:
        self.sensor = sensor
        self.features = features
        shape = (sensor.height, sensor.width)
        pattern = sensor.cfa_pattern
        rows, columns = np.ogrid[: shape[0], : shape[1]]
        self.channel: NDArray[np.uint8] = pattern[rows % len(pattern), columns % pattern.shape[1]]
        self.response: NDArray[np.float32] = 1 + features.prnu * generator.standard_normal(shape, dtype=np.float32)
        np.maximum(self.response, 0, out=self.response)  # no pixel gives light back
        y, x = (np.linspace(-1, 1, size) for size in shape)
        fixed = features.dsnu_dn * generator.standard_normal(shape, dtype=np.float32)
        fixed += features.column_pattern_dn * generator.standard_normal((1, shape[1]), dtype=np.float32)
        fixed += (features.bias_shading_dn * (y[:, None] + x**2)).astype(np.float32)
        self.hot: NDArray[np.bool_] = generator.random(shape, dtype=np.float32) < features.hot_share
        count = int(self.hot.sum())
        height = generator.uniform(*_HOT_DN, count)
        bright = generator.random(count) < _HOT_BRIGHT_SHARE
        fixed[self.hot] += (height * np.where(bright, 1, _HOT_DARK_FACTOR)).astype(np.float32)
        self.pattern_dn: NDArray[np.float32] = fixed
        self.light: NDArray[np.float32] = 1 - features.vignetting / 2 * (y[:, None] ** 2 + x**2).astype(np.float32)

    def offset_dn(self, noise: KnownNoise) -> NDArray[np.float32]:
        """Return a frame without light and noise: black, colour bias and fixed pattern, (H, W), DN."""
        constant = np.add(self.sensor.black_level_dn, noise.colour_bias_dn).astype(np.float32)
        offset: NDArray[np.float32] = self.pattern_dn * self.features.scale(noise.gain_dn_per_e)
        offset += constant[self.channel]
        return offset

    def colour_bias_dn(self, noise: KnownNoise) -> tuple[float, ...]:
        """Return the true mean of each channel less its black level, DN, over all pixels.

        It is the colour bias of ``noise`` and what the fixed pattern of this specimen adds to it.
        """
        scale = self.features.scale(noise.gain_dn_per_e)
        return tuple(
            bias + scale * float(self.pattern_dn[self.channel == channel].mean(dtype=np.float64))
            for channel, bias in enumerate(noise.colour_bias_dn)
        )

    def bias_frame(self, noise: KnownNoise, generator: np.random.Generator) -> NDArray[np.uint16]:
        """Return a frame without light, (H, W) uint16, DN."""
        return self._digitise(self.offset_dn(noise) + temporal_noise_dn(noise, self.channel.shape, generator))

    def flat_frame(
        self, noise: KnownNoise, level_dn: float, generator: np.random.Generator, drift: float = 0.0
    ) -> NDArray[np.uint16]:
        """Return a frame of an evenly lit surface, (H, W) uint16, DN.

        Parameters
        ----------
        noise
            The camera at the frame's ISO.
        level_dn
            Mean signal over black in the middle of the frame, DN, 0 or more.
        generator
            Draws this frame's noise.
        drift
            Relative change of the light for this frame, -1 or more.
        """
        gain = noise.gain_dn_per_e
        electrons = generator.poisson(level_dn / gain * (1 + drift) * self.response * self.light)
        signal = (gain * electrons).astype(np.float32)
        return self._digitise(self.offset_dn(noise) + temporal_noise_dn(noise, self.channel.shape, generator) + signal)

    def _digitise(self, values_dn: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Round values to DN and clip them from 0 to white, uint16; the values are overwritten."""
        np.rint(values_dn, out=values_dn)
        np.clip(values_dn, 0, self.sensor.white_level_dn, out=values_dn)
        return values_dn.astype(np.uint16)


def temporal_noise_dn(noise: KnownNoise, shape: tuple[int, ...], generator: np.random.Generator) -> NDArray[np.float32]:
    """Return one frame's read and row noise before rounding, (H, W), DN."""
    read = noise.sigma_tl_dn * tukey_lambda_values(generator.random(shape), noise.tukey_lambda)
    read += noise.sigma_row_dn * generator.standard_normal((shape[0], 1))
    return read.astype(np.float32)


def tukey_lambda_values(probability: NDArray[np.float64], shape: float) -> NDArray[np.float64]:
    """Return quantiles ``(u^l - (1-u)^l) / l`` of the Tukey-lambda distribution, or its limit, the logistic, at l = 0.

    Probabilities are float64 in [0, 1): single precision would cut the tails at 6e-8, within the pixels of one frame.
    An exact 0 counts as 2^-54, half of the generator's step.
    """
    u = np.maximum(probability, 2.0**-54)
    rest = 1 - u
    if abs(shape) < _LOGISTIC_BELOW:
        u /= rest
        return np.log(u, out=u)
    np.power(u, shape, out=u)
    np.power(rest, shape, out=rest)
    u -= rest
    u /= shape
    return u
