"""Simulated cameras: light in, mosaics in DN out, with the noise that such exposures have.

The chain is the paper's (K. Wei et al., TPAMI 2021, section 3.1): photons to electrons with Poisson statistics, read
noise and one draw of row noise per mosaic row, a constant colour bias, amplification by the system gain, and rounding
to whole DN. Read noise is Gaussian here. The figures are of the order of the published calibrations.

It is written in plain numpy and shares no code with :mod:`eldata.noise`: what the model and its calibration find can be
checked against it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.raw.colour import camera_to_srgb
from eldata.records import Sensor

if TYPE_CHECKING:
    from fractions import Fraction

    from numpy.typing import NDArray

BASE_ISO = 100

# A sensor's response to sRGB white is this share of its range at the metered exposure.
METERED_SHARE = 0.9


def mosaic_light(radiance: NDArray[np.float32], sensor: Sensor) -> NDArray[np.float64]:
    """Return the light behind each pixel's colour filter, (H, W): sRGB white gives 1 over its white balance.

    Parameters
    ----------
    radiance
        (3, H, W), linear sRGB in [0, 1].
    sensor
        A Bayer sensor of that size.
    """
    camera: NDArray[np.float64] = radiance.astype(np.float64)
    if sensor.xyz_to_camera is not None:
        camera = np.einsum("ij,jhw->ihw", np.linalg.inv(camera_to_srgb(sensor.xyz_to_camera)), camera)
    if sensor.white_balance is not None:
        camera = camera / np.array(sensor.white_balance[:3])[:, None, None]
    camera = np.maximum(camera, 0)
    colours = np.array([0, 1, 2, 1])[sensor.cfa_pattern]  # of G1 and G2 alike
    rows, columns = np.ogrid[: sensor.height, : sensor.width]
    site = colours[rows % len(colours), columns % len(colours)]
    light: NDArray[np.float64] = np.take_along_axis(camera, site[None], axis=0)[0]
    return light


@dataclass(frozen=True, slots=True)
class SimulatedCamera:
    """A camera with known noise.

    Attributes
    ----------
    name
        Its folder in a dataset.
    sensor
        What its files say of it; ``height`` and ``width`` are set by :meth:`with_size`.
    base_gain_dn_per_e
        System gain K at ISO 100; it grows in proportion to the ISO.
    sigma_read_e, sigma_quantiser_dn
        Read noise before amplification (electrons) and after it (DN): sigma^2 = (K sigma_read)^2 + sigma_quantiser^2.
    sigma_row_e
        Row noise, electrons.
    colour_bias_e
        Bias of R, G1, B, G2, electrons.
    """

    name: str
    sensor: Sensor
    base_gain_dn_per_e: float
    sigma_read_e: float
    sigma_quantiser_dn: float
    sigma_row_e: float
    colour_bias_e: tuple[float, float, float, float]

    def with_size(self, height: int, width: int) -> SimulatedCamera:
        """Return the same camera with a frame of another size."""
        return replace(self, sensor=replace(self.sensor, height=height, width=width))

    def gain_dn_per_e(self, iso: int) -> float:
        """Return the system gain K at an ISO."""
        return self.base_gain_dn_per_e * iso / BASE_ISO

    def electrons(self, radiance: NDArray[np.float32], exposure: Fraction) -> NDArray[np.float64]:
        """Return the expected photoelectrons of a frame, (H, W).

        Parameters
        ----------
        radiance
            (3, H, W), linear sRGB in [0, 1].
        exposure
            Exposure time as a multiple of the metered one, at which white fills 0.9 of the range at ISO 100.
        """
        sensor = self.sensor
        mosaic = mosaic_light(radiance, sensor)
        span = sensor.white_level_dn - max(sensor.black_level_dn)
        electrons: NDArray[np.float64] = mosaic * (METERED_SHARE * span / self.base_gain_dn_per_e * float(exposure))
        return electrons

    def photograph(
        self, radiance: NDArray[np.float32], exposure: Fraction, iso: int, generator: np.random.Generator
    ) -> NDArray[np.uint16]:
        """Return one noisy mosaic in DN, (H, W) uint16; parameters as :meth:`electrons`."""
        sensor, gain = self.sensor, self.gain_dn_per_e(iso)
        shape = (sensor.height, sensor.width)
        signal = gain * generator.poisson(self.electrons(radiance, exposure))
        sigma_read = np.hypot(gain * self.sigma_read_e, self.sigma_quantiser_dn)
        read = generator.normal(0.0, sigma_read, shape)
        row = generator.normal(0.0, gain * self.sigma_row_e, (shape[0], 1))
        rows, columns = np.ogrid[: shape[0], : shape[1]]
        channel = sensor.cfa_pattern[rows % 2, columns % 2]
        offset = np.array(sensor.black_level_dn) + gain * np.array(self.colour_bias_e)
        dn: NDArray[np.float64] = np.clip(np.rint(signal + read + row + offset[channel]), 0, sensor.white_level_dn)
        return dn.astype(np.uint16)


# Two cameras that differ in everything that a loader could take for granted: CFA phase, black and white level (the
# second saturates below the published 16383 and has a black level per channel), colour, noise.
CAMERAS = (
    SimulatedCamera(
        name="DemoAlpha",
        sensor=Sensor(
            make="eldata",
            model="Demo Alpha",
            cfa=((0, 1), (3, 2)),
            black_level_dn=(512.0, 512.0, 512.0, 512.0),
            white_level_dn=16383.0,
            height=512,
            width=768,
            white_balance=(2.1, 1.0, 1.6, 1.0),
            xyz_to_camera=((0.6640, -0.1847, -0.0503), (-0.5238, 1.3010, 0.2474), (-0.0993, 0.1673, 0.6527)),
        ),
        base_gain_dn_per_e=0.094,
        sigma_read_e=1.8,
        sigma_quantiser_dn=1.0,
        sigma_row_e=0.35,
        colour_bias_e=(0.3, 0.25, 0.35, 0.25),
    ),
    SimulatedCamera(
        name="DemoBeta",
        sensor=Sensor(
            make="eldata",
            model="Demo Beta",
            cfa=((3, 2), (0, 1)),
            black_level_dn=(2047.0, 2048.0, 2049.0, 2048.0),
            white_level_dn=15303.0,
            height=512,
            width=768,
            white_balance=(1.9, 1.0, 1.75, 1.0),
            xyz_to_camera=((0.7034, -0.0804, -0.1014), (-0.4420, 1.2564, 0.2058), (-0.0851, 0.1994, 0.5758)),
        ),
        base_gain_dn_per_e=0.16,
        sigma_read_e=2.6,
        sigma_quantiser_dn=2.0,
        sigma_row_e=0.5,
        colour_bias_e=(-0.2, -0.1, 0.25, -0.1),
    ),
)
