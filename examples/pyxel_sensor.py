"""A CMOS camera simulated by Pyxel, of ESA and ESO: nobody of this project wrote how its noise comes about.

It needs `pip install pyxel-sim` (`pyxel` alone is a game engine); 3.0.2 was tried. Pyxel is described in
doi:10.1117/1.JATIS.8.4.048002. A frame goes through these of its models, in this order:

| model | argument | what it stands for |
| --- | --- | --- |
| `shot_noise` | `type="poisson"` | photons, two for each photoelectron expected |
| `simple_conversion` | `quantum_efficiency` 0.5 | which of them are collected (binomial) |
| `simple_dark_current` | `dark_rate` | dark current (Poisson) |
| `fixed_pattern_noise` | `fixed_pattern_noise_factor` | response of the pixels (log-normal); stays |
| `simple_measurement` | `charge_to_volt` | electrons to volts |
| `output_node_noise` | `std_deviation`, the specimen's seed | offsets of the pixels; stay |
| `output_node_noise_cmos` | `readout_noise`, `readout_noise_std` | read noise; strength drawn by pixel and frame |
| `uncorrelated_pink_noise_cmos` | `std` | 1/f noise of the readout, along the rows |
| `alternating_column_noise_cmos` | `std` | the same, of even and of odd columns apart |
| `simple_amplifier` | `pre_amplification` | the ISO's gain |
| `output_node_noise` | `std_deviation` | noise behind the amplifier |
| `dc_offset` | `offset` | black level |
| `simple_adc` | `adc_bit_resolution` 14 | DN; it truncates |

Pyxel has no telegraph pixels and no offsets of columns that stay, and its dark current is the same in all pixels: what
the design says of them is zero.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from pyxel.detectors import CMOS, ChargeToVoltSettings, CMOSCharacteristics, CMOSGeometry, Environment
from pyxel.models import charge_collection, charge_generation, charge_measurement, photon_collection
from pyxel.models.readout_electronics import simple_adc, simple_amplifier
from virtual_sensor import SENSORS, ConversionGain, SensorDesign

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BITS, _VOLTS_PER_DN = 14, 1e-4
_LOW_GAIN_V_PER_E, _HIGH_GAIN_V_PER_E = 40e-6, 120e-6
# Pyxel multiplies by QE x (1 + a log-normal number whose logarithm has the standard deviation QE x factor): with this
# QE the mean response is 1, and its spread a quarter of the factor.
_QUANTUM_EFFICIENCY = 0.5

# Figures of the order of full-frame cameras with two conversion gains. `row_e` is the 1/f noise, `column_offset_e` that
# of even and odd columns. The ADC truncates, so that black lies half a DN below the level stated.
PYXEL_CMOS: Final = SensorDesign(
    name="PyxelCMOS",
    sensor=replace(SENSORS[0].sensor, model="Pyxel CMOS"),
    base_gain_dn_per_e=0.2,
    high_gain_iso=1600,
    low=ConversionGain(read_e=3.2, row_e=0.5, pixel_offset_e=0.8, column_offset_e=0.3, trap_e=0.0),
    high=ConversionGain(read_e=1.6, row_e=0.3, pixel_offset_e=0.5, column_offset_e=0.2, trap_e=0.0),
    adc_noise_dn=1.5,
    read_spread=0.3,
    trap_share=0.0,
    row_memory=0.0,
    prnu=0.008,
    column_prnu=0.0,
    glow_e=0.0,
    dark_e_per_s=0.3,
    black_error_dn=dict.fromkeys((100, 200, 400, 800, 1600, 3200, 6400), (-0.5,) * 4),
)


class PyxelSpecimen:
    """One sensor of a design, as :class:`virtual_sensor.Specimen` is: ``generator`` draws what stays."""

    def __init__(self, design: SensorDesign, generator: np.random.Generator) -> None:
        self.design = design
        # Pyxel draws the pixels for every frame; with the same seeds they are the same pixels.
        self._response_seed, self._offset_seed = generator.integers(2**31, size=2).tolist()

    def frame(
        self, photoelectrons: NDArray[np.floating] | float, exposure_s: float, iso: int, generator: np.random.Generator
    ) -> NDArray[np.uint16]:
        """Return one frame, (H, W) uint16, DN; the arguments are those of :meth:`virtual_sensor.Specimen.frame`."""
        design, mode = self.design, self.design.mode(iso)
        volts_per_e = _HIGH_GAIN_V_PER_E if iso >= design.high_gain_iso else _LOW_GAIN_V_PER_E
        detector = CMOS(
            CMOSGeometry(row=design.sensor.height, col=design.sensor.width),
            Environment(),
            CMOSCharacteristics(
                quantum_efficiency=_QUANTUM_EFFICIENCY,
                charge_to_volt=ChargeToVoltSettings(volts_per_e),
                pre_amplification=design.gain_dn_per_e(iso) * _VOLTS_PER_DN / volts_per_e,
                adc_bit_resolution=_BITS,
                adc_voltage_range=(0.0, (2**_BITS - 1) * _VOLTS_PER_DN),
            ),
        )
        detector.set_readout(times=[exposure_s])
        detector.time_step = exposure_s
        detector.empty()
        seeds = iter(generator.integers(2**31, size=7).tolist())
        photons = np.broadcast_to(photoelectrons, detector.geometry.shape) / _QUANTUM_EFFICIENCY
        detector.photon.array = photons.astype(np.float64)
        photon_collection.shot_noise(detector, seed=next(seeds))
        charge_generation.simple_conversion(detector, seed=next(seeds))
        charge_generation.simple_dark_current(detector, dark_rate=design.dark_e_per_s, seed=next(seeds))
        charge_collection.simple_collection(detector)
        factor = design.prnu / _QUANTUM_EFFICIENCY**2
        charge_collection.fixed_pattern_noise(detector, fixed_pattern_noise_factor=factor, seed=self._response_seed)
        # Of Pyxel 3.0.2 this model doubles the signal that it finds; it finds none, and its noise is added afterwards.
        detector.signal.array = np.zeros(detector.geometry.shape)
        spread_e = design.read_spread * mode.read_e
        charge_measurement.output_node_noise_cmos(detector, mode.read_e, spread_e, seed=next(seeds))
        read_noise = detector.signal.array
        charge_measurement.simple_measurement(detector)
        detector.signal += read_noise
        charge_measurement.output_node_noise(detector, mode.pixel_offset_e * volts_per_e, seed=self._offset_seed)
        charge_measurement.uncorrelated_pink_noise_cmos(detector, std=mode.row_e, seed=next(seeds))
        charge_measurement.alternating_column_noise_cmos(detector, std=mode.column_offset_e, seed=next(seeds))
        simple_amplifier(detector)
        charge_measurement.output_node_noise(detector, design.adc_noise_dn * _VOLTS_PER_DN, seed=next(seeds))
        charge_measurement.dc_offset(detector, max(design.sensor.black_level_dn) * _VOLTS_PER_DN)
        simple_adc(detector, data_type="uint16")
        digital: NDArray[np.uint16] = detector.image.array
        return digital
