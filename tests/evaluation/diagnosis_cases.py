"""Predictions with a known mistake, and honest ones: frames of simulated cameras, denoisers, and what goes wrong.

Nothing is written: each frame is photographed, packed, denoised and scored in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.restoration import denoise_tv_chambolle

from eldata.baselines.classical import BASELINES, SignalNoise
from eldata.demo.camera import CAMERAS, SimulatedCamera
from eldata.demo.scenes import scene_radiance
from eldata.evaluation.diagnosis import Inspection, Suspicion, find_mistake, find_suspicions, sketch
from eldata.evaluation.mistakes import Circumstances
from eldata.isp.rendering import preview
from eldata.metrics.image_score import Score, score_by
from eldata.protocols.named import PROTOCOLS
from eldata.protocols.protocol import Protocol
from eldata.raw.levels import XTRANS_CFA, Clip, pack, pack_normalised, unpack, with_levels
from eldata.records import Sensor

Array: TypeAlias = "NDArray[Any]"

ALPHA, BETA = CAMERAS


def _of(camera: SimulatedCamera, name: str, **sensor: Any) -> SimulatedCamera:
    return replace(camera, name=name, sensor=replace(camera.sensor, **sensor))


SIMULATED = {
    camera.name: camera
    for camera in (
        _of(ALPHA, "RGGB"),
        _of(BETA, "BGGR"),
        _of(ALPHA, "GBRG", cfa=((2, 3), (1, 0)), black_level_dn=(600.0,) * 4, white_level_dn=15892.0),
        _of(BETA, "GRBG", cfa=((1, 0), (2, 3)), black_level_dn=(256.0,) * 4, white_level_dn=14800.0),
        _of(ALPHA, "X-Trans", cfa=XTRANS_CFA, black_level_dn=(1022.0,) * 3),
    )
}
"""All phases of Bayer's pattern and X-Trans, with levels of their own."""

XTRANS = "X-Trans"


@dataclass(frozen=True, eq=False)
class Photograph:
    """A noisy frame and its reference, in DN."""

    path: str
    camera: SimulatedCamera
    ratio: int
    iso: int
    noisy: NDArray[np.uint16]
    clean: NDArray[np.uint16]

    def target(self, protocol: Protocol) -> Array:
        """What predictions are compared with."""
        if protocol.pixels == "srgb":
            return _rendered(self.packed(self.clean, "metadata", "both", 1.0), self.camera.sensor)
        return self.packed(self.clean, protocol.levels, protocol.reference_clip, 1.0)

    def input(self, protocol: Protocol, clip: Clip = "both") -> Array:
        """The amplified input; networks differ in whether they get its negative values."""
        return self.packed(self.noisy, protocol.levels, clip, float(self.ratio))

    def noise(self, levels: str) -> SignalNoise:
        """That of the amplified input, known: many of these scenes are too small and too busy to tell it."""
        camera, sensor = self.camera, leveled(self.camera.sensor, levels)
        scale = self.ratio / (sensor.white_level_dn - float(np.mean(sensor.black_level_dn)))
        gain = camera.gain_dn_per_e(self.iso)
        sigmas = (gain * camera.sigma_read_e, camera.sigma_quantiser_dn, gain * camera.sigma_row_e, 12**-0.5)
        return SignalNoise(gain * scale, float(np.sum(np.square(sigmas))) * scale**2)

    def packed(self, mosaic: Array, levels: str, clip: Clip, gain: float) -> Array:
        """A mosaic, normalised, clipped and amplified."""
        sensor = leveled(self.camera.sensor, levels)
        return pack_normalised(mosaic, sensor.cfa, sensor.black_level_dn, sensor.white_level_dn, clip=clip, gain=gain)


def leveled(sensor: Sensor, levels: Any) -> Sensor:
    """The sensor with a protocol's levels."""
    return with_levels(sensor, "metadata" if levels == "metadata-per-channel" else levels)


def _rendered(packed: Array, sensor: Sensor) -> Array:
    return preview(packed, sensor).transpose(2, 0, 1).astype(np.float32) / np.float32(255)


def photographs(
    camera: str, seed: int, *, ratios: Sequence[int] = (100, 200), isos: Sequence[int] = (800, 1600, 3200)
) -> list[Photograph]:
    """What is looked at of an evaluation of one camera: an ISO and a scene each, at every factor."""
    height = 192 if camera != XTRANS else 384  # of the packed image 96 and 128 rows
    return [
        photograph(camera, 1 + (seed + index) % 8, iso, ratio, seed, height)
        for ratio in ratios
        for index, iso in enumerate(isos)
    ]


@cache
def photograph(name: str, scene: int, iso: int, ratio: int, seed: int, height: int) -> Photograph:
    """A pair, as :class:`~eldata.demo.camera.SimulatedCamera` takes it, of any colour filter array."""
    size = height, height * 3 // 2
    camera = SIMULATED[name].with_size(*size)
    light = _radiance(scene, *size)
    generator = np.random.default_rng([seed, scene, iso, ratio])
    noisy = _exposed(camera, camera.electrons(light, Fraction(100, ratio * iso)), iso, generator)
    clean = _exposed(camera, camera.electrons(light, Fraction(1)), 100, generator)
    return Photograph(f"{name}/scene-{scene}/{iso}-{ratio}", camera, ratio, iso, noisy, clean)


_radiance = cache(scene_radiance)


def _exposed(camera: SimulatedCamera, electrons: Array, iso: int, generator: np.random.Generator) -> NDArray[np.uint16]:
    sensor, gain = camera.sensor, camera.gain_dn_per_e(iso)
    read = generator.normal(0, np.hypot(gain * camera.sigma_read_e, camera.sigma_quantiser_dn), electrons.shape)
    rows = generator.normal(0, gain * camera.sigma_row_e, (len(electrons), 1))
    dn = np.rint(gain * generator.poisson(electrons) + read + rows + np.mean(sensor.black_level_dn))
    return np.clip(dn, 0, sensor.white_level_dn).astype(np.uint16)


# --- honest predictions -----------------------------------------------------------------------------------------------


def _planes(work: Callable[[Array], Array]) -> Callable[[Array], Array]:
    return lambda packed: np.stack([work(plane) for plane in packed]).astype(np.float32)


def _gaussian(sigma: float) -> Callable[[Array], Array]:
    return _planes(lambda plane: ndimage.gaussian_filter(plane, sigma))


def _moved(plane: Array) -> Array:
    return np.asarray(ndimage.shift(ndimage.gaussian_filter(plane, 1.0), 0.3, order=1, mode="nearest"))


def _total_variation(plane: Array) -> Array:
    noise = float(np.median(np.abs(np.diff(plane, axis=1))) / 0.954) + 1e-4  # from the differences of neighbours
    found = denoise_tv_chambolle(plane, weight=1.5 * noise)  # type: ignore[no-untyped-call] # scikit-image's
    return np.asarray(found)


def _coded(top: int) -> Callable[[Array], Array]:
    return lambda packed: np.rint(np.clip(_gaussian(1.0)(packed), 0, 1) * top).astype(np.float32) / np.float32(top)


def _tinted(packed: Array) -> Array:
    tints = np.linspace(1.1, 0.9, len(packed), dtype=np.float32)
    return np.asarray(_gaussian(1.0)(packed) * tints[:, None, None])


DCT = "sliding DCT"
DENOISERS: dict[str, Callable[[Array], Array]] = {
    "Gaussian, sigma 0.5": _gaussian(0.5),
    "Gaussian, sigma 1": _gaussian(1.0),
    "Gaussian, sigma 2.5": _gaussian(2.5),
    "Gaussian, sigma 6": _gaussian(6.0),
    "median 3 x 3": _planes(lambda plane: ndimage.median_filter(plane, 3)),
    "median 5 x 5": _planes(lambda plane: ndimage.median_filter(plane, 5)),
    "total variation": _planes(_total_variation),
    "means of 4 x 4": _planes(lambda plane: ndimage.zoom(ndimage.zoom(plane, 0.25, order=1), 4, order=0)),
    DCT: lambda packed: packed,  # which needs the noise, too (denoised)
    "Gaussian, moved by 0.3 pixels": _planes(_moved),
    "Gaussian, 7 % too dark": lambda packed: np.float32(0.93) * _gaussian(1.0)(packed),
    "Gaussian, 15 % too bright": lambda packed: np.float32(1.15) * _gaussian(1.0)(packed),
    "Gaussian, tinted by 10 %": _tinted,
    "Gaussian in 16 bits": _coded(65535),
    "Gaussian in 8 bits": _coded(255),
    "Gaussian in float16": lambda packed: _gaussian(1.0)(packed).astype(np.float16).astype(np.float32),
}
"""Of the amplified input."""

NEAR = {"the reference and noise of 0.003": 0.003, "the reference and noise of 0.02": 0.02}
"""Predictions that start from the reference."""

HONEST = (*DENOISERS, *NEAR)
# Those that start from the reference have no input.
HONEST_INPUTS: tuple[tuple[str, Clip], ...] = (
    *((name, "both") for name in HONEST),
    *((name, "none") for name in DENOISERS),
)
PLANTED_IN = ("sliding DCT", "Gaussian, sigma 1", "the reference and noise of 0.003")


def predicted(shot: Photograph, protocol: str, name: str, clip: Clip = "none") -> Array:
    """What a denoiser makes of a frame; of renderings the denoised frame, rendered."""
    rules = PROTOCOLS[protocol]
    if name in NEAR:
        target = shot.target(rules)
        noise = np.random.default_rng(shot.ratio * shot.iso).normal(0, NEAR[name], target.shape)
        return np.clip(target + noise, 0, 1).astype(np.float32)
    if rules.pixels == "srgb":
        return _rendered(denoised(shot, "metadata", name, clip), shot.camera.sensor)
    return denoised(shot, rules.levels, name, clip)


@cache
def denoised(shot: Photograph, levels: str, name: str, clip: Clip) -> Array:
    """What a denoiser makes of the amplified input."""
    packed = shot.packed(shot.noisy, levels, clip, float(shot.ratio))
    return np.asarray(BASELINES["dct"].denoise(packed, shot.noise(levels))) if name == DCT else DENOISERS[name](packed)


# --- mistakes ---------------------------------------------------------------------------------------------------------

Making: TypeAlias = "Callable[[Array, Photograph, Protocol], Array]"


def _alone(change: Callable[[Array], Array]) -> Making:
    """Of the prediction alone."""
    return lambda p, _shot, _protocol: change(p)


def _reordered(*order: int) -> Making:
    return _alone(lambda p: p[list(order)])


def _shifted(by: tuple[int, int]) -> Making:
    return _alone(lambda p: np.roll(p, by, (1, 2)))


def _shifted_in_mosaic(by: tuple[int, int]) -> Making:
    def make(p: Array, shot: Photograph, _protocol: Protocol) -> Array:
        cfa = XTRANS_CFA if shot.camera.name == XTRANS else shot.camera.sensor.cfa
        return pack(np.ascontiguousarray(np.roll(unpack(np.ascontiguousarray(p), cfa), by, (0, 1))), cfa)

    return make


def _in_dn(change: Callable[[Array, float, float, float], Array]) -> Making:
    """Of DN, given black, the protocol's white, and another white level that could be taken."""

    def make(p: Array, shot: Photograph, protocol: Protocol) -> Array:
        sensor = leveled(shot.camera.sensor, protocol.levels)
        black, white = float(np.mean(sensor.black_level_dn)), sensor.white_level_dn
        own = shot.camera.sensor.white_level_dn
        return change(np.clip(p, 0, 1) * (white - black) + black, black, white, 16383.0 if white == own else own)

    return make


def _encoded(p: Array) -> Array:
    p = np.clip(p, 0, 1)
    return np.where(p <= 0.0031308, 12.92 * p, 1.055 * p ** (1 / 2.4) - 0.055)


def _power(exponent: float) -> Making:
    return _alone(lambda p: np.clip(p, 0, 1) ** exponent)


def _amplified(power: int) -> Making:
    return lambda p, shot, _protocol: np.clip(p * float(shot.ratio) ** power, 0, 1)


_PIXELS, _MOSAIC = "packed pixels (down, right)", "pixels of the mosaic (down, right)"
_GAMMA, _LINEAR = "as if encoded for a screen (gamma)", "as if made linear once more (gamma)"
_65535 = "as if DN were divided by 65535"

OF_BAYER: dict[str, tuple[Making, str]] = {
    "packed R, G1, G2, B": (_reordered(0, 1, 3, 2), "as if packed R, G1, G2, B"),
    "R and B exchanged": (_reordered(2, 1, 0, 3), "as if packed B, G1, R, G2"),
    "packed as if BGGR": (_reordered(2, 3, 0, 1), "as if packed B, G2, R, G1"),
    "packed as if GRBG": (_reordered(1, 0, 3, 2), "as if packed G1, R, G2, B"),
    "packed as if GBRG": (_reordered(3, 2, 1, 0), "as if packed G2, B, G1, R"),
    "planes as quadrants": (
        lambda p, shot, _protocol: pack(np.block([[p[0], p[1]], [p[3], p[2]]]), shot.camera.sensor.cfa),
        "as if the four planes were the quadrants of one mosaic",
    ),
}
OF_XTRANS: dict[str, tuple[Making, str]] = {
    "R and B exchanged": (
        _reordered(2, 1, 0, 4, 3, 5, 6, 7, 8),
        "as if packed in the order 2, 1, 0, 4, 3, 5, 6, 7, 8 of its channels",
    )
}
OF_PLACE: dict[str, tuple[Making, str]] = {
    f"shifted by {by}": (_shifted(by), f"as if shifted by {by} {_PIXELS}") for by in ((1, 0), (0, -1), (2, 1), (-2, 2))
}
OF_MOSAIC: dict[str, tuple[Making, str]] = {
    f"mosaic shifted by {by}": (_shifted_in_mosaic(by), f"as if shifted by {by} {_MOSAIC}") for by in ((1, 0), (-1, 1))
}
OF_LEVELS: dict[str, tuple[Making, str]] = {
    "black not subtracted": (_in_dn(lambda dn, _black, white, _other: dn / white), "as if black were not subtracted"),
    "black subtracted twice": (
        _in_dn(lambda dn, black, white, _other: np.maximum(dn - 2 * black, 0) / (white - black)),
        "as if black were subtracted twice",
    ),
    "DN / 65535": (_in_dn(lambda dn, _black, _white, _other: dn / 65535), _65535),
    "(DN - black) / 65535": (_in_dn(lambda dn, black, _white, _other: (dn - black) / 65535), _65535),
    "another white level": (
        _in_dn(lambda dn, black, _white, other: (dn - black) / (other - black)),
        "as if normalised with white level",
    ),
    "clipped at 0.25": (_alone(lambda p: np.minimum(p, np.float32(0.25))), "as if clipped at 0.25"),
    "not amplified": (_amplified(-1), "as if not amplified"),
    "amplified twice": (_amplified(1), "as if amplified twice"),
    "the input copied": (lambda _p, shot, protocol: shot.input(protocol), "as if the noisy input, amplified"),
}
OF_CURVES: dict[str, tuple[Making, str]] = {
    "sRGB curve": (_alone(_encoded), _GAMMA),
    "gamma 2.2": (_power(1 / 2.2), _GAMMA),
    "made linear once more": (_power(2.2), _LINEAR),
    "inverted": (_alone(lambda p: 1 - p), "as if inverted (1 - value)"),
    "in [-1, 1]": (_alone(lambda p: 2 * p - 1), "as if in [-1, 1], not in [0, 1]"),
    "all zeros": (_alone(np.zeros_like), "every value is 0"),
}
OF_COLOURS: dict[str, tuple[Making, str]] = {
    "B, G, R": (_reordered(2, 1, 0), "as if in the order B, G, R"),
    **{
        name: (make, words.replace("packed pixels", "pixels")) for name, (make, words) in (OF_PLACE | OF_CURVES).items()
    },
}


def mistakes_of(camera: str, protocol: Protocol) -> dict[str, tuple[Making, str]]:
    """What can be wrong with predictions for a camera under a protocol, how it is made, and its name."""
    if protocol.pixels == "srgb":
        return OF_COLOURS
    own = OF_XTRANS if camera == XTRANS else OF_BAYER
    return own | OF_PLACE | OF_MOSAIC | OF_LEVELS | OF_CURVES


# --- what is said of them ---------------------------------------------------------------------------------------------


@cache
def honest_psnr_db(camera: str, seed: int, protocol: str, denoiser: str) -> float:
    """The mean PSNR of a denoiser's predictions."""
    rules, scores = PROTOCOLS[protocol], []
    for shot in photographs(camera, seed):
        target, prediction = shot.target(rules), predicted(shot, protocol, denoiser).astype(np.float32)
        crop = rules.crop(target.shape)
        scores.append(score_by(prediction[crop], target[crop], rules.rules).psnr_db)
    return float(np.mean(scores))


def inspected(shot: Photograph, protocol: Protocol, prediction: Array) -> Inspection:
    """What a frame shows."""
    target, prediction = shot.target(protocol), np.ascontiguousarray(prediction, np.float32)
    crop = protocol.crop(target.shape)

    def score(other: Array) -> Score:
        return score_by(other[crop], target[crop], protocol.rules)

    now = Circumstances(
        protocol=protocol,
        sensor=shot.camera.sensor if protocol.pixels == "packed" else None,
        ratio=float(shot.ratio),
        score=score,
        amplified=partial(shot.input, protocol),
    )
    psnr_db = score(prediction).psnr_db
    mistake = find_mistake(prediction, target, psnr_db, now)
    return Inspection(shot.path, shot.camera.name, now.ratio, psnr_db, mistake, sketch(prediction), sketch(target))


def suspicions(
    shots: Sequence[Photograph], protocol: Protocol, predict: Callable[[Photograph], Array]
) -> tuple[Suspicion, ...]:
    """What an evaluation of these frames says."""
    return find_suspicions([inspected(shot, protocol, predict(shot)) for shot in shots])


@dataclass(frozen=True)
class Outcome:
    """An evaluation with a mistake: what it costs in dB, whether it was named, and what was said."""

    cost_db: float
    named: bool
    said: tuple[Suspicion, ...]


def planted(camera: str, seed: int, protocol: str, denoiser: str, mistake: str) -> Outcome:
    """Make the mistake with every prediction of a denoiser."""
    rules, shots = PROTOCOLS[protocol], photographs(camera, seed)
    make, words = mistakes_of(camera, rules)[mistake]

    found = [inspected(shot, rules, make(predicted(shot, protocol, denoiser), shot, rules)) for shot in shots]
    said = find_suspicions(found)
    cost_db = honest_psnr_db(camera, seed, protocol, denoiser) - float(np.mean([one.psnr_db for one in found]))
    return Outcome(cost_db, len(said) == 1 and not said[0].where and said[0].words.startswith(words), said)


def accused(camera: str, seed: int, protocol: str, denoiser: str, clip: Clip) -> tuple[Suspicion, ...]:
    """What is said of honest predictions, at factors from 1 to 300 and ISOs from 100 to 12800."""
    shots = photographs(camera, seed)
    if seed % 2:
        shots = photographs(camera, seed, ratios=(1, 10, 300), isos=(100, 1600, 12800))
    return suspicions(shots, PROTOCOLS[protocol], lambda shot: predicted(shot, protocol, denoiser, clip))
