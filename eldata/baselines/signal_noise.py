"""How the noise of an amplified frame grows with its signal: ``variance = offset + slope * signal``.

Shot noise of a gain K makes the slope, whatever does not depend on light the offset. Both are in units of the packed,
normalised and amplified frame: with ratio r and white - black of w DN, slope ``K r / w`` and offset
``(sigma r / w)^2``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.parameters import NoiseParameters

    Values = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class SignalNoise:
    """Variance of the noise over the signal.

    Attributes
    ----------
    slope
        Variance per unit of signal, 0 or more.
    offset
        Variance without light, above 0.
    """

    slope: float
    offset: float

    def variance(self, signal: Values) -> Values:
        """Return the variance where the expected signal is this; below 0 it is that of no light."""
        return np.asarray(self.offset + self.slope * np.maximum(signal, 0.0))


def noise_of_parameters(parameters: NoiseParameters, *, ratio: float, range_dn: float) -> SignalNoise:
    """Return what a camera's figures make: shot noise, read and row noise, rounding.

    Parameters
    ----------
    parameters
        Such as ``CameraProfile.measured(iso)``.
    ratio
        What the frame was multiplied by.
    range_dn
        White less black level.
    """
    scale = ratio / range_dn
    gauss, row = float(parameters.sigma_gauss_dn), float(parameters.sigma_row_dn)
    return SignalNoise(float(parameters.gain_dn_per_e) * scale, (gauss**2 + row**2 + 1 / 12) * scale**2)


def noise_of_image(image: Values) -> SignalNoise:
    """Estimate it from a frame itself (:func:`eldata.calibration.one_photograph.noise_line`), without row noise.

    Parameters
    ----------
    image
        (C, h, w), negative values kept.

    Raises
    ------
    DatasetError
        If the frame does not tell its noise: too small, textured all over, smoothed, or without noise.
    """
    from eldata.calibration.one_photograph.noise_line import noise_line

    found = noise_line(image)
    # A line fitted to bright parts alone may cross 0 before black.
    return SignalNoise(max(found.slope, 0.0), max(found.offset, found.least_variance / 4))
