"""Faults planted into simulated frames in plain numpy and scipy: what the audit has to find."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from tests.calibration.simulation import Body, Camera

    Frames = list[NDArray[np.float64]]
    Fault = Callable[[Frames, Camera, np.random.Generator], Frames]


def analogue(body: Body, count: int) -> Frames:
    """Bias frames before their values are rounded."""
    return [body.fixed.astype(np.float64) + body.noise() for _ in range(count)]


def digitised(frames: Iterable[NDArray[np.float64]]) -> list[NDArray[np.uint16]]:
    return [np.clip(np.rint(frame), 0, 65535).astype(np.uint16) for frame in frames]


@dataclass(frozen=True)
class Planted:
    """A fault of one size."""

    name: str
    fault: Fault

    def bias_frames(self, body: Body, count: int) -> list[NDArray[np.uint16]]:
        return digitised(self.fault(analogue(body, count), body.camera, body.generator))


def _lit(light_dn: Callable[[Camera, np.random.Generator], NDArray[np.float64]]) -> Fault:
    """Electrons of one and the same light in every frame."""

    def fault(frames: Frames, camera: Camera, generator: np.random.Generator) -> Frames:
        electrons = light_dn(camera, generator) / camera.gain
        return [frame + camera.gain * generator.poisson(electrons) for frame in frames]

    return fault


def corner_leak(peak_dn: float) -> Planted:
    """Light through the corner of a cap."""

    def light(camera: Camera, _: np.random.Generator) -> NDArray[np.float64]:
        height, width = camera.shape
        y, x = np.ogrid[0 : 1 : height * 1j, 0 : 1 : width * 1j]
        leak: NDArray[np.float64] = peak_dn * np.exp(-(x**2 + y**2) / 0.05)
        return leak

    return Planted(f"corner leak, {peak_dn:g} DN", _lit(light))


def _by_site(frames: Frames, camera: Camera, filtered: Callable[..., NDArray[np.float64]]) -> Frames:
    """Filter each site of the CFA's period by itself (X-Trans: pixels six apart)."""
    results, period = [frame.copy() for frame in frames], len(camera.cfa)
    for result in results:
        for row, column in np.ndindex(period, period):
            result[row::period, column::period] = filtered(result[row::period, column::period])
    return results


def blurred(share: float) -> Planted:
    """Each pixel gives this share of its value to its four neighbours of the same colour, and gets theirs."""
    weights = np.array([[0, share / 4, 0], [share / 4, 1 - share, share / 4], [0, share / 4, 0]])

    def fault(frames: Frames, camera: Camera, _: np.random.Generator) -> Frames:
        return _by_site(frames, camera, lambda site: ndimage.convolve(site, weights, mode="nearest"))

    return Planted(f"blur of {share:g}", fault)


def coarse(step: int) -> Planted:
    """Fewer bits than the file has: values in steps."""

    def fault(frames: Frames, _: Camera, __: np.random.Generator) -> Frames:
        return [step * np.rint(frame / step) for frame in frames]

    return Planted(f"values in steps of {step} DN", fault)


def mixed(share: float) -> Planted:
    """Each pixel gets this share of its left neighbour, of whatever colour."""

    def fault(frames: Frames, _: Camera, __: np.random.Generator) -> Frames:
        return [(1 - share) * frame + share * np.roll(frame, 1, axis=1) for frame in frames]

    return Planted(f"neighbours mixed by {share:g}", fault)
