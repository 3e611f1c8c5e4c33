"""Calibration frames of a simulated camera with known noise: real DNG files, their manifest, and the truth.

Bias frames stand at the shortest exposure. Flats are pairs of equal exposure under one constant lamp: only the time
changes, in thirds of a stop, so that the signal is proportional to time x K over all ISOs.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial
from itertools import product
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from eldata.base.files import write_json
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.demo.body import Body, FixedFeatures, KnownNoise
from eldata.demo.camera import CAMERAS
from eldata.demo.tree import demo_card, write_shot
from eldata.errors import ArgumentError
from eldata.manifest.catalogue import Manifest, save_manifest
from eldata.manifest.table import number_text
from eldata.records import FrameRecord, Sensor

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path


NAME: Final = "calibration-demo"
_FOLDER: Final = "calibration"
BIAS_EXPOSURE_S: Final = Fraction(1, 8000)

# Exposure times as cameras name them, a third of a stop apart, from 1/8000 s to 30 s.
_TIME_NAMES: Final = """
1/8000 1/6400 1/5000 1/4000 1/3200 1/2500 1/2000 1/1600 1/1250 1/1000 1/800 1/640 1/500 1/400 1/320 1/250 1/200 1/160
1/125 1/100 1/80 1/60 1/50 1/40 1/30 1/25 1/20 1/15 1/13 1/10 1/8 1/6 1/5 1/4 0.3 0.4 0.5 0.6 0.8 1 1.3 1.6 2 2.5 3.2
4 5 6 8 10 13 15 20 25 30
"""
_TIMES_S: Final = tuple(Fraction(name) for name in _TIME_NAMES.split())
# The lamp: at this time and the camera's lowest gain a flat's mean fills 80 % of the range over black. The times' names
# are rounded, by 2.4 % along the powers of two from here, so the next ISOs may pass the 80 % by that.
_BRIGHTEST_S = Fraction(8, 5)
_BRIGHTEST_SHARE = 0.8
_ROUNDING_OF_TIMES = 1.03
# Four stops below it: 5 %.
_RANGE_STEPS = 12


@dataclass(frozen=True, slots=True)
class CalibrationCamera:
    """A camera whose noise is known at some ISOs.

    Attributes
    ----------
    name
        Its folder in the dataset.
    sensor
        What its files say of it; the size of the frames is given when they are made.
    noise
        The truth, one record per ISO.
    """

    name: str
    sensor: Sensor
    noise: tuple[KnownNoise, ...]

    def noise_at(self, iso: int) -> KnownNoise:
        """Return the truth at one of the ISOs at which it is known."""
        return {noise.iso: noise for noise in self.noise}[iso]


# ISO, lambda, sigma_TL, sigma_row (DN), colour bias of R, G1, B, G2 (DN). The scales scatter by some percent around
# sigma_TL = 0.70 (ISO / 100)^0.47 and sigma_row = 0.16 (ISO / 100)^0.52, near the lines of the Sony A7S II; at ISO 400
# lambda is 0, the logistic limit, as it is there; the bias is that of a black level that is a little off at each ISO.
_DEMO_GAMMA: Final = (
    (100, 0.11, 0.68, 0.165, (1.42, 1.36, 1.51, 1.38)),
    (200, 0.06, 1.02, 0.215, (-1.05, -1.12, -0.94, -1.08)),
    (400, 0.0, 1.26, 0.345, (-0.31, -0.24, -0.40, -0.27)),
    (800, -0.04, 1.95, 0.452, (0.62, 0.55, 0.71, 0.58)),
    (1600, -0.07, 2.66, 0.71, (2.31, 2.05, 2.47, 2.12)),
    (3200, -0.09, 3.35, 0.94, (-1.36, -1.21, -1.50, -1.18)),
    (6400, -0.11, 5.16, 1.36, (-2.20, -1.70, -2.46, -1.62)),
    (12800, -0.13, 6.62, 2.09, (0.90, 1.40, 0.55, 1.25)),
    (25600, -0.14, 9.80, 2.79, (1.80, 2.45, -1.30, -2.10)),
)
_DEMO_GAMMA_GAIN_PER_ISO: Final = 0.095 / 100

DEMO_GAMMA: Final = CalibrationCamera(
    name="DemoGamma",
    sensor=replace(CAMERAS[0].sensor, model="Demo Gamma", height=1024, width=1536, white_balance=(2.0, 1.0, 1.7, 1.0)),
    noise=tuple(
        KnownNoise(iso, _DEMO_GAMMA_GAIN_PER_ISO * iso, shape, sigma_tl_dn, sigma_row_dn, bias_dn)
        for iso, shape, sigma_tl_dn, sigma_row_dn, bias_dn in _DEMO_GAMMA
    ),
)

DEMO_FEATURES: Final = FixedFeatures(
    prnu=0.008, dsnu_dn=0.6, column_pattern_dn=0.3, hot_share=1e-4, bias_shading_dn=0.4, vignetting=0.3
)


@dataclass(frozen=True, slots=True)
class _Plan:
    """All frames that are to be taken; ``times_s`` are the flats' at each ISO of ``noise``, rising."""

    camera: CalibrationCamera
    features: FixedFeatures
    seed: int
    lamp_e_per_s: float
    bias_frames: int
    noise: tuple[KnownNoise, ...]
    times_s: tuple[tuple[Fraction, ...], ...]


@dataclass(frozen=True, slots=True)
class _Shot:
    """One frame to take: small, for worker processes."""

    plan: _Plan
    path: Path
    role: Literal["bias", "flat"]
    iso_index: int
    frame_index: int
    exposure_s: Fraction

    @property
    def noise(self) -> KnownNoise:
        """The noise at its ISO."""
        return self.plan.noise[self.iso_index]


def make_calibration_frames(
    folder: Path, *,
    camera: CalibrationCamera = DEMO_GAMMA, isos: Sequence[int] = (100, 400, 1600, 6400), bias_frames: int = 10,
    flat_levels: int = 5, size: tuple[int, int] = (1024, 1536), seed: int = 0,
    features: FixedFeatures = DEMO_FEATURES, workers: Workers = IN_THIS_PROCESS,
) -> Manifest:  # fmt: skip
    """Take bias and flat-field frames with a simulated camera into ``folder``.

    Writes ``folder/data/calibration/<camera>/{bias,flat}/ISO<iso>/IMG_<nnnn>.dng``,
    ``folder/manifests/calibration-demo.{csv,json}`` and ``folder/truth.json``, which holds all that is known.

    Parameters
    ----------
    folder
        Made if it is not there.
    camera
        The camera with its known noise.
    isos
        ISOs that the camera knows.
    bias_frames
        Bias frames per ISO.
    flat_levels
        Pairs of flats per ISO, 2 to 13: their mean goes from about 5 % to about 80 % of the range over black.
    size
        (H, W) of the mosaics in pixels.
    seed
        The same seed gives the same files, wherever they are made.
    features
        How strong the fixed pattern is.
    workers
        What runs the work.

    Raises
    ------
    ArgumentError
        If an ISO has no exposure time from 1/8000 s on that gives its flats.
    """
    camera = replace(camera, sensor=replace(camera.sensor, height=size[0], width=size[1]))
    noise = tuple(camera.noise_at(iso) for iso in isos)
    body = _draw_body(camera.sensor, features, seed)
    lamp = _lamp_e_per_s(camera, body)
    times = tuple(_flat_times_s(camera.sensor, known, lamp * _average_light(body), flat_levels) for known in noise)
    plan = _Plan(camera, features, seed, lamp, bias_frames, noise, times)

    data, manifests = folder / "data" / _FOLDER, folder / "manifests"
    shots = tuple(_plan_shots(data, plan))
    manifests.mkdir(parents=True, exist_ok=True)
    try:
        for _ in workers.run(_take_frame, shots, label="calibration frames", unit="frame"):
            pass
    finally:
        _draw_body.cache_clear()  # a caller's process need not keep its arrays
    write_json(folder / "truth.json", _collect_truth(plan, body), indent=1)
    row = partial(FrameRecord, camera=camera.name, width=size[1], height=size[0])
    records = [
        row(shot.path.relative_to(data).as_posix(), shot.role, iso=Fraction(shot.noise.iso), exposure_s=shot.exposure_s)
        for shot in shots
    ]
    sources = "eldata.demo: a simulated camera; truth.json beside the manifests' folder holds its noise"
    sensors = {camera.name: camera.sensor}
    card = demo_card(NAME, "Simulated calibration frames", _FOLDER, sensors, records, sources)
    return save_manifest(manifests / f"{NAME}.csv", card, records)


@lru_cache(maxsize=1)
def _draw_body(sensor: Sensor, features: FixedFeatures, seed: int) -> Body:
    """Draw the specimen, once in each process."""
    return Body(sensor, features, np.random.default_rng([seed, 0]))


def _span_dn(sensor: Sensor) -> float:
    """Compute the range from the highest black level to white, DN."""
    return sensor.white_level_dn - max(sensor.black_level_dn)


def _lamp_e_per_s(camera: CalibrationCamera, body: Body) -> float:
    """Return the lamp's light in mid-frame, photoelectrons per second: the same for any choice of ISOs."""
    lowest_gain = min(noise.gain_dn_per_e for noise in camera.noise)
    mean_e = _BRIGHTEST_SHARE * _span_dn(camera.sensor) / lowest_gain
    return mean_e / float(_BRIGHTEST_S) / _average_light(body)


def _average_light(body: Body) -> float:
    """Average a body's relative light over the frame."""
    return float(body.light.mean(dtype=np.float64))


def _flat_times_s(sensor: Sensor, noise: KnownNoise, mean_e_per_s: float, levels: int) -> tuple[Fraction, ...]:
    """Return the exposure times of the flats at one ISO, evenly spread over four stops and rising."""
    longest_s = _ROUNDING_OF_TIMES * _BRIGHTEST_SHARE * _span_dn(sensor) / (mean_e_per_s * noise.gain_dn_per_e)
    last = sum(time <= longest_s for time in _TIMES_S) - 1
    first = last - _RANGE_STEPS
    if first < 0:
        raise ArgumentError(
            f"flats at ISO {noise.iso} would need exposures below 1/8000 s: its gain of {noise.gain_dn_per_e:.3g} "
            "DN/e- is too far above the camera's lowest"
        )
    return tuple(_TIMES_S[first + round(_RANGE_STEPS * index / (levels - 1))] for index in range(levels))


def _plan_shots(data: Path, plan: _Plan) -> Iterator[_Shot]:
    """Yield the frames as a photographer would take them: all bias frames, then, cap off, the flats in pairs."""
    number = 0
    roles: tuple[Literal["bias", "flat"], ...] = ("bias", "flat")
    for role, (iso_index, (noise, times)) in product(roles, enumerate(zip(plan.noise, plan.times_s, strict=True))):
        bias = (BIAS_EXPOSURE_S,) * plan.bias_frames
        flats = tuple(time for time in times for _ in range(2))
        first, exposures = (0, bias) if role == "bias" else (len(bias), flats)
        for frame_index, exposure_s in enumerate(exposures, first):
            number += 1
            path = data / plan.camera.name / role / f"ISO{noise.iso}" / f"IMG_{number:04d}.dng"
            yield _Shot(plan, path, role, iso_index, frame_index, exposure_s)


def _take_frame(shot: _Shot) -> None:
    """Take one frame and write it."""
    # 1 + the index: the specimen's own draws have 0 there.
    plan, noise = shot.plan, shot.noise
    generator = np.random.default_rng([plan.seed, 1 + shot.iso_index, shot.frame_index])
    body = _draw_body(plan.camera.sensor, plan.features, plan.seed)
    if shot.role == "bias":
        mosaic = body.bias_frame(noise, generator)
    else:
        level_dn = plan.lamp_e_per_s * float(shot.exposure_s) * noise.gain_dn_per_e  # over black, in the middle
        mosaic = body.flat_frame(noise, level_dn, generator)
    write_shot(shot.path, mosaic, plan.camera.sensor, Fraction(noise.iso), shot.exposure_s)


def _collect_truth(plan: _Plan, body: Body) -> dict[str, object]:
    """Collect the true parameters, for JSON; exposure times as exact text, as in the manifest."""
    sensor, mean_light = plan.camera.sensor, _average_light(body)
    return {
        "camera": plan.camera.name,
        "seed": plan.seed,
        "height": sensor.height,
        "width": sensor.width,
        "cfa": sensor.cfa,
        "black_level_dn": sensor.black_level_dn,
        "white_level_dn": sensor.white_level_dn,
        "features": asdict(plan.features),
        "hot_pixels": int(body.hot.sum()),
        "lamp_e_per_s": plan.lamp_e_per_s,
        "mean_light": mean_light,
        "bias_frames": plan.bias_frames,
        "bias_exposure_s": number_text(BIAS_EXPOSURE_S),
        "isos": [
            {
                **asdict(noise),
                "sigma_gauss_dn": noise.sigma_gauss_dn,
                # What this specimen's frames hold: the mean of its fixed pattern added.
                "colour_bias_with_pattern_dn": body.colour_bias_dn(noise),
                "pattern_scale": plan.features.scale(noise.gain_dn_per_e),
                "flats": [
                    {
                        "exposure_s": number_text(time),
                        "mean_level_dn": plan.lamp_e_per_s * mean_light * float(time) * noise.gain_dn_per_e,
                    }
                    for time in times
                ],
            }
            for noise, times in zip(plan.noise, plan.times_s, strict=True)
        ],
    }
