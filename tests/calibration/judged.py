"""Cameras whose noise models are judged: the simulated camera, faults planted in its frames, and frames as a model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from eldata.calibration.acceptance.comparison import check_iso_noise
from eldata.noise.mosaic import pack_whole, unpack_whole
from eldata.noise.parameters import NoiseParameters
from tests.calibration.faults import NONE, Planted, digitised
from tests.calibration.in_memory import ISO, FramesInMemory, calibrated_in_memory, iso_frames
from tests.calibration.simulation import Body, Camera

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.calibration.acceptance.results import IsoAcceptance
    from eldata.calibration.iso_results import IsoCalibration


@dataclass
class Specimen:
    """One body with a fault, and as a noise model: its own further frames, of the light that it is given.

    The fault is of the body, not of a frame: where it draws pixels, they are the same in every frame.
    """

    camera: Camera
    fault: Planted = NONE
    seed: int = 0

    def __post_init__(self) -> None:
        self.body = Body(self.camera, np.random.default_rng([self.seed, 1]))
        self.response = self.body._even.response

    def frame(self, light_dn: NDArray[np.float64] | float, generator: np.random.Generator) -> NDArray[np.uint16]:
        gain = self.camera.gain
        self.body.generator = generator
        analogue = self.body.fixed + self.body.noise() + gain * generator.poisson(light_dn / gain * self.response)
        places = np.random.default_rng([self.seed, 2])  # where pixels are faulty; see Both
        faulty = self.fault.fault([analogue], self.camera, cast("np.random.Generator", Both(places, generator)))
        return digitised(faulty)[0]

    def __call__(self, clean: NDArray[np.float32], *, range_dn: float, generator: np.random.Generator, **_: Any) -> Any:
        light = unpack_whole(clean.astype(np.float64), self.camera.cfa, self.camera.shape) * range_dn
        mosaic = self.frame(np.maximum(light, 0), generator) - self.camera.black
        return pack_whole((mosaic / range_dn).astype(np.float32), self.camera.cfa)


@dataclass
class Both:
    """What a fault draws: places, by ``random``, from one generator, and everything else from another."""

    places: np.random.Generator
    values: np.random.Generator

    def random(self, *arguments: Any) -> Any:
        return self.places.random(*arguments) if arguments else self.values.random()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.values, name)


def truth(camera: Camera) -> NoiseParameters:
    sigma = camera.noise.sigma_gauss_dn
    bias = camera.bias
    return NoiseParameters(camera.gain, camera.tukey_lambda, camera.sigma_tl, sigma, camera.sigma_row, bias, iso=ISO)  # type: ignore[arg-type] # four numbers


def calibrated(specimen: Specimen, light_dn: Sequence[float], *stream: int) -> IsoCalibration:
    """Measure a specimen: of ten bias frames, one of them kept out, and a pair of each light."""

    def take(role: str, number: int) -> NDArray[np.uint16]:
        light = light_dn[number // 2] if role == "flat" else 0.0
        return specimen.frame(light, np.random.default_rng([*stream, 9, role == "flat", number]))

    return calibrated_in_memory(specimen.camera.sensor, 10, len(light_dn), take)


def judged(
    model: Any,
    specimen: Specimen,
    *,
    bias: int = 8,
    flats: tuple[float, ...] = (),
    seed: int = 0,
    parameters: NoiseParameters | None = None,
    **options: Any,
) -> IsoAcceptance:
    """Judge a model against frames of a specimen that no model has seen."""

    def take(role: str, number: int) -> NDArray[np.uint16]:
        light: Any = 0.0
        if role == "flat":
            height, width = specimen.camera.shape
            y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
            light = flats[number // 2] * (1 - 0.1 * (y**2 + x**2))
        return specimen.frame(light, np.random.default_rng([seed, 3, role == "flat", number]))

    frames = cast("Any", FramesInMemory(specimen.camera.sensor, take))
    chosen = iso_frames(bias, len(flats))
    return check_iso_noise(model, parameters or truth(specimen.camera), frames, chosen, seed=seed, **options)
