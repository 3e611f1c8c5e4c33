"""Flats of simulated cameras with faults planted in them, and what comes of K."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import erf

from eldata.calibration.checks import find_saturation, flat_findings
from eldata.calibration.flats import FlatPairs, photon_transfer
from eldata.demo.body import Body
from eldata.errors import DatasetError
from tests.calibration.chain import given
from tests.calibration.simulation import BAYER, Camera

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from eldata.calibration.iso_results import Finding
    from eldata.demo.body import KnownNoise

    Pair = tuple[NDArray[np.uint16], NDArray[np.uint16]]

BLACK, WHITE = 512.0, 16383.0
# Published reflectances of the 24 patches, rounded: red, green, blue.
PATCHES = np.array(
    [
        *[(17, 8, 5), (55, 30, 21), (12, 19, 33), (10, 15, 5), (23, 22, 43), (13, 51, 41)],
        *[(68, 20, 2), (6, 10, 38), (54, 9, 12), (11, 4, 14), (34, 50, 5), (75, 36, 2)],
        *[(2, 5, 29), (6, 30, 6), (43, 3, 4), (84, 57, 1), (50, 9, 30), (1, 24, 36)],
        *[(90, 90, 87), (59, 59, 58), (36, 36, 36), (19, 19, 19), (9, 9, 9), (3, 3, 3)],
    ]
)


@dataclass(frozen=True)
class Setting(Camera):
    """A camera and its flats; the levels are shares of the range, in the middle of the frame."""

    shape: tuple[int, int] = (512, 768)
    bias: tuple[float, ...] = (0.0,) * 4
    hot_share: float = 0.0
    vignetting: float = 0.3
    levels: Sequence[float] = (0.1, 0.3, 0.5, 0.7, 0.9)


def body_of(setting: Setting, generator: np.random.Generator) -> tuple[Body, KnownNoise]:
    return Body(setting.sensor, setting.features, generator), setting.noise


def clean(setting: Setting, generator: np.random.Generator, drift: float = 0.0) -> list[Pair]:
    body, noise = body_of(setting, generator)
    return [
        (
            body.flat_frame(noise, share * (WHITE - BLACK), generator),
            body.flat_frame(noise, share * (WHITE - BLACK), generator, drift),
        )
        for share in setting.levels
    ]


def clipped(white: int) -> Callable[..., list[Pair]]:
    def make(setting: Setting, generator: np.random.Generator) -> list[Pair]:
        ceiling = np.uint16(white)
        return [(np.minimum(a, ceiling), np.minimum(b, ceiling)) for a, b in clean(setting, generator)]

    return make


def unequal(step: float) -> Callable[..., list[Pair]]:
    return lambda setting, generator: clean(setting, generator, step)


def chart_light(shape: tuple[int, int], shift: tuple[float, float], blur: float = 1.5) -> NDArray[np.float32]:
    """The light of a chart that is turned by a degree, by CFA site: reflectances, blurred by a lens."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    y, x = y - shape[0] / 2 - shift[0], x - shape[1] / 2 - shift[1]
    angle = math.radians(1)
    across = (x * math.cos(angle) + y * math.sin(angle)) / (0.9 * shape[1] / 6) + 3
    down = (y * math.cos(angle) - x * math.sin(angle)) / (0.9 * shape[0] / 4) + 2

    def within(place: NDArray[np.float64], cells: int, size: float) -> list[NDArray[np.float64]]:
        width = blur / size * math.sqrt(2)
        return [0.5 * (erf((place - k - 0.08) / width) - erf((place - k - 0.92) / width)) for k in range(cells)]

    columns, rows = within(across, 6, 0.9 * shape[1] / 6), within(down, 4, 0.9 * shape[0] / 4)
    light = np.full(shape, 0.03)
    for number, colour in enumerate(PATCHES):
        cover = rows[number // 6] * columns[number % 6]
        for (row, column), channel in np.ndenumerate(np.array(BAYER)):
            reflectance = colour[(0, 1, 2, 1)[channel]] / 90
            light[row::2, column::2] += (reflectance - 0.03) * cover[row::2, column::2]
    return light.astype(np.float32)


def chart(pixels: float) -> Callable[..., list[Pair]]:
    """Pairs of a chart that moves between any two frames by so many pixels, one standard deviation."""

    def make(setting: Setting, generator: np.random.Generator) -> list[Pair]:
        body, noise = body_of(setting, generator)
        steady = body.light

        def frame(share: float) -> NDArray[np.uint16]:
            down, across = pixels * generator.standard_normal(2)
            body.light = steady * chart_light(setting.shape, (float(down), float(across)))
            return body.flat_frame(noise, share * (WHITE - BLACK), generator)

        return [(frame(share), frame(share)) for share in setting.levels]

    return make


def bent(share: float) -> Callable[..., list[Pair]]:
    """A response that is this share too low at white: s - share s^2 / range."""

    def make(setting: Setting, generator: np.random.Generator) -> list[Pair]:
        def respond(frame: NDArray[np.uint16]) -> NDArray[np.uint16]:
            signal = frame - BLACK + generator.random(frame.shape) - 0.5
            return np.rint(BLACK + signal - share * signal**2 / (WHITE - BLACK)).clip(0, WHITE).astype(np.uint16)

        return [(respond(a), respond(b)) for a, b in clean(setting, generator)]

    return make


def smoothed(weight: float) -> Callable[..., list[Pair]]:
    """Each pixel gets so much of the mean of its four neighbours of one colour."""

    def smooth(frame: NDArray[np.uint16]) -> NDArray[np.uint16]:
        wide = np.pad(frame.astype(np.float64), 2, mode="edge")
        around = (wide[:-4, 2:-2] + wide[4:, 2:-2] + wide[2:-2, :-4] + wide[2:-2, 4:]) / 4
        return np.rint((1 - weight) * frame + weight * around).astype(np.uint16)

    return lambda setting, generator: [(smooth(a), smooth(b)) for a, b in clean(setting, generator)]


QUIET = Setting(gain=0.09, sigma_tl=0.65)
LOUD = Setting(gain=27.0, sigma_tl=33.0)


@dataclass(frozen=True)
class Outcome:
    """What came of one camera: K and its error with all allowances (nan: withheld or refused), and what was said."""

    off: float
    error: float
    findings: tuple[Finding, ...]
    refused: str = ""


def outcome(setting: Setting, pairs: Sequence[Pair]) -> Outcome:
    """K as a share of the truth, from pairs as a calibration takes them."""
    flats = FlatPairs(setting.cfa, setting.sensor.black_level_dn, WHITE)
    for first, second in pairs:
        flats.add(first, second)
    piled = tuple(find_saturation(flats))
    try:
        transfer = photon_transfer(flats)
    except DatasetError as error:
        return Outcome(math.nan, math.nan, piled, str(error))
    findings = (*piled, *flat_findings(transfer))
    gain = given(findings, "gain", transfer.gain_dn_per_e, transfer.gain_error, transfer.gain_dn_per_e)
    off = transfer.gain_dn_per_e / setting.gain - 1
    return Outcome(off, math.nan if gain is None else gain.error / setting.gain, findings)
