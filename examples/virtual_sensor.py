"""A sensor from photons to DN whose noise is not that of a formula: what the virtual benchmark photographs with.

A pixel collects photoelectrons (Poisson, with a response of its own and of its column) and dark current. Its source
follower adds Gaussian noise whose strength is the pixel's own, log-normal over the sensor, so that a frame's read
noise has heavy tails although no pixel's has; some pixels have a trap besides, whose charge comes and goes (random
telegraph noise). Offsets of pixels and columns, a glow from one edge, and a row offset that remembers the row above are
added, all in electrons, then the amplifier's gain, its own noise and offsets, and an ADC that rounds and clips. The
conversion gain switches at one ISO, and with it all that is in electrons before it.

Sources of the mechanisms: M. Konnik and J. Welsh, "High-level numerical simulations of noise in CCD and CMOS
photosensors: review and tutorial", arXiv:1412.4031 (photons to DN, PRNU, column offsets); X. Wang et al., "Random
telegraph signal in CMOS image sensor pixels", IEDM 2006 (telegraph pixels, and tails of the read noise over the
pixels). The figures are of the order of those published for ELD's cameras.

It is written in plain numpy, and shares no code with :mod:`eldata.noise`, :mod:`eldata.calibration` and
:mod:`eldata.demo.body`: what they find in its frames is found in a camera that is not theirs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from eldata.demo.camera import BASE_ISO, CAMERAS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from eldata.records import Sensor

    Plane = NDArray[np.float32]

# Between two frames a trap has forgotten its state; the share of time that it is filled differs from trap to trap.
_TRAP_FILLED: Final = (0.1, 0.9)


@dataclass(frozen=True, slots=True)
class ConversionGain:
    """What a pixel adds in one of the two gain modes, in electrons; standard deviations.

    Attributes
    ----------
    read_e
        Median of the pixels' noise.
    row_e
        Of the rows' offsets.
    pixel_offset_e, column_offset_e
        Of the offsets that stay: of pixels and of whole columns.
    trap_e
        Mean height of the telegraph pixels' steps, which are exponentially distributed.
    """

    read_e: float
    row_e: float
    pixel_offset_e: float
    column_offset_e: float
    trap_e: float


@dataclass(frozen=True, slots=True)
class SensorDesign:
    """A model of sensor; specimens of it differ in their pixels.

    Attributes
    ----------
    name
        The camera's folder in the dataset.
    sensor
        What its files say of it; the size is set by :meth:`with_size`.
    base_gain_dn_per_e
        System gain K at ISO 100; it grows in proportion to the ISO, in both modes.
    high_gain_iso
        From this ISO on the conversion gain is the high one.
    low, high
        The gain modes.
    adc_noise_dn
        Noise behind the amplifier, DN.
    read_spread, trap_share
        Standard deviation of the logarithm of the pixels' read noise, and the share of telegraph pixels.
    row_memory
        Correlation of a row's offset with that of the row above. From about 0.4 on the calibration sees so much slow
        drift in the rows that it withholds sigma_row.
    prnu, column_prnu
        Relative standard deviation of the response of pixels and of whole columns.
    glow_e
        The glow at the lower edge, electrons, in every frame.
    dark_e_per_s
        Mean dark current; log-normal over the pixels.
    black_error_dn
        By ISO, how far R, G1, B and G2 lie from the black level that the files state, DN.
    """

    name: str
    sensor: Sensor
    base_gain_dn_per_e: float
    high_gain_iso: int
    low: ConversionGain
    high: ConversionGain
    adc_noise_dn: float
    read_spread: float
    trap_share: float
    row_memory: float
    prnu: float
    column_prnu: float
    glow_e: float
    dark_e_per_s: float
    black_error_dn: Mapping[int, tuple[float, float, float, float]]

    def with_size(self, height: int, width: int) -> SensorDesign:
        """Return the same design with frames of another size."""
        return replace(self, sensor=replace(self.sensor, height=height, width=width))

    @property
    def isos(self) -> tuple[int, ...]:
        """The ISOs that it has, ascending."""
        return tuple(sorted(self.black_error_dn))

    @property
    def span_dn(self) -> float:
        """White less black, DN."""
        return self.sensor.white_level_dn - max(self.sensor.black_level_dn)

    def gain_dn_per_e(self, iso: int) -> float:
        """Return the system gain K at an ISO."""
        return self.base_gain_dn_per_e * iso / BASE_ISO

    def mode(self, iso: int) -> ConversionGain:
        """Return the gain mode at an ISO."""
        return self.high if iso >= self.high_gain_iso else self.low


class Camera(Protocol):
    """What takes frames, as :class:`Specimen` does, whoever simulates it."""

    @property
    def design(self) -> SensorDesign:
        """Its design."""

    def frame(
        self, photoelectrons: NDArray[np.floating] | float, exposure_s: float, iso: int, generator: np.random.Generator
    ) -> NDArray[np.uint16]:
        """Return one frame."""


class Specimen:
    """One sensor of a design: its pixels, drawn once.

    Parameters
    ----------
    design
        With the size of its frames.
    generator
        Draws the pixels; frames have generators of their own.
    """

    def __init__(self, design: SensorDesign, generator: np.random.Generator) -> None:
        self.design = design
        height, width = shape = design.sensor.height, design.sensor.width

        def normal(*size: int) -> Plane:
            return generator.standard_normal(size, dtype=np.float32)

        self._response = np.maximum(1 + design.prnu * normal(*shape), 0) * (1 + design.column_prnu * normal(1, width))
        self._read = np.exp(design.read_spread * normal(*shape))
        self._pixel_offset, self._column_offset = normal(*shape), normal(1, width)
        below = np.linspace(1, 0, height, dtype=np.float32)[:, None]
        self._glow_e = design.glow_e * np.exp(-6 * below)
        # Half of the pixels have less than a third of the mean; one in a thousand has thirty times it.
        dark = np.exp(1.5 * normal(*shape))
        self._dark_e_per_s = design.dark_e_per_s * dark / dark.mean(dtype=np.float64)
        self.trapped: NDArray[np.intp] = np.flatnonzero(generator.random(shape, dtype=np.float32) < design.trap_share)
        self._trap_height = generator.standard_exponential(self.trapped.size, dtype=np.float32)
        self._trap_filled = generator.uniform(*_TRAP_FILLED, self.trapped.size)

    def frame(
        self, photoelectrons: NDArray[np.floating] | float, exposure_s: float, iso: int, generator: np.random.Generator
    ) -> NDArray[np.uint16]:
        """Return one frame, (H, W) uint16, DN.

        Parameters
        ----------
        photoelectrons
            Expected in a pixel of mean response over the exposure, (H, W) or one number for all; 0 for a bias frame.
        exposure_s
            Exposure time, seconds: of the dark current alone.
        iso
            One of the ISOs whose black error the design states.
        generator
            Draws this frame.
        """
        design, mode = self.design, self.design.mode(iso)
        shape = self._response.shape
        expected = photoelectrons * self._response + exposure_s * self._dark_e_per_s
        charge = generator.poisson(expected).astype(np.float32)
        charge += mode.read_e * self._read * generator.standard_normal(shape, dtype=np.float32)
        filled = generator.random(self.trapped.size) < self._trap_filled
        charge.ravel()[self.trapped] += mode.trap_e * self._trap_height * (filled - self._trap_filled)
        charge += mode.pixel_offset_e * self._pixel_offset + mode.column_offset_e * self._column_offset + self._glow_e
        charge += mode.row_e * self._rows(generator)[:, None]
        values = design.gain_dn_per_e(iso) * charge
        values += design.adc_noise_dn * generator.standard_normal(shape, dtype=np.float32)
        zero = np.add(design.sensor.black_level_dn, design.black_error_dn[iso])
        pattern = design.sensor.cfa_pattern
        for row, column in np.ndindex(pattern.shape):
            values[row :: len(pattern), column :: pattern.shape[1]] += zero[pattern[row, column]]
        digital: NDArray[np.uint16] = np.clip(np.rint(values), 0, design.sensor.white_level_dn).astype(np.uint16)
        return digital

    def _rows(self, generator: np.random.Generator) -> Plane:
        """Return the rows' offsets in their standard deviation: each remembers the one above."""
        memory = self.design.row_memory
        fresh = generator.standard_normal(len(self._glow_e), dtype=np.float32)
        fresh[1:] *= (1 - memory**2) ** 0.5
        for row in range(1, len(fresh)):
            fresh[row] += memory * fresh[row - 1]
        return fresh


_ALPHA_BLACK_DN: Final = {
    100: (0.4, 0.3, 0.5, 0.3), 400: (-0.6, -0.5, -0.7, -0.5), 800: (0.7, 0.6, 0.8, 0.6),
    1600: (2.0, 1.8, 2.2, 1.8), 3200: (-1.7, -1.5, -1.9, -1.5), 6400: (-2.2, -1.8, -2.4, -1.8),
    12800: (0.9, 1.3, 0.6, 1.3),
}  # fmt: skip
_BETA_BLACK_DN: Final = {
    100: (-0.3, -0.2, 0.2, -0.2), 200: (0.8, 0.6, 0.9, 0.6), 400: (-0.5, -0.6, -0.3, -0.6),
    800: (-1.2, -1.0, -1.4, -1.0), 1600: (1.1, 1.4, 0.9, 1.4), 3200: (2.6, 2.9, 2.3, 2.9),
    6400: (-2.0, -1.5, -2.4, -1.5),
}  # fmt: skip

# Filters, black levels and colours are those of the demo's two cameras.
SENSORS: Final = (
    SensorDesign(
        name="BenchAlpha",
        sensor=replace(CAMERAS[0].sensor, model="Bench Alpha", height=384, width=576),
        base_gain_dn_per_e=0.095,
        high_gain_iso=2000,
        low=ConversionGain(read_e=2.9, row_e=0.45, pixel_offset_e=0.6, column_offset_e=0.25, trap_e=9.0),
        high=ConversionGain(read_e=1.4, row_e=0.22, pixel_offset_e=0.4, column_offset_e=0.12, trap_e=5.0),
        adc_noise_dn=1.0,
        read_spread=0.3,
        trap_share=0.02,
        row_memory=0.2,
        prnu=0.008,
        column_prnu=0.002,
        glow_e=0.8,
        dark_e_per_s=0.3,
        black_error_dn=_ALPHA_BLACK_DN,
    ),
    SensorDesign(
        name="BenchBeta",
        sensor=replace(CAMERAS[1].sensor, model="Bench Beta", white_level_dn=16383.0, height=384, width=576),
        base_gain_dn_per_e=0.16,
        high_gain_iso=640,
        low=ConversionGain(read_e=3.8, row_e=0.6, pixel_offset_e=0.9, column_offset_e=0.4, trap_e=10.0),
        high=ConversionGain(read_e=2.2, row_e=0.4, pixel_offset_e=0.7, column_offset_e=0.3, trap_e=8.0),
        adc_noise_dn=2.0,
        read_spread=0.35,
        trap_share=0.01,
        row_memory=0.2,
        prnu=0.012,
        column_prnu=0.004,
        glow_e=1.5,
        dark_e_per_s=0.5,
        black_error_dn=_BETA_BLACK_DN,
    ),
)
