"""Faults planted into simulated frames in plain numpy and scipy: what the audit has to find."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tests.calibration.simulation import Body, Camera

Frames = list[NDArray[np.float64]]
Fault = Callable[[Frames, Camera, np.random.Generator], Frames]


def digitised(frames: Iterable[NDArray[np.float64]]) -> list[NDArray[np.uint16]]:
    return [np.clip(np.rint(frame), 0, 65535).astype(np.uint16) for frame in frames]


def plant(fault: Fault, body: Body, count: int) -> list[NDArray[np.uint16]]:
    """Bias frames with a fault, planted before their values are rounded."""
    frames = [body.fixed.astype(np.float64) + body.noise() for _ in range(count)]
    return digitised(fault(frames, body.camera, body.generator))


def corner_leak(peak_dn: float) -> Fault:
    """Electrons of light through the corner of a cap, the same in every frame."""

    def fault(frames: Frames, camera: Camera, generator: np.random.Generator) -> Frames:
        y, x = np.ogrid[0 : 1 : camera.shape[0] * 1j, 0 : 1 : camera.shape[1] * 1j]
        electrons = peak_dn * np.exp(-(x**2 + y**2) / 0.05) / camera.gain
        return [frame + camera.gain * generator.poisson(electrons) for frame in frames]

    return fault


def blurred(share: float) -> Fault:
    """Each pixel gives this share of its value to its four neighbours of the same site, and gets theirs."""
    weights = np.array([[0, share / 4, 0], [share / 4, 1 - share, share / 4], [0, share / 4, 0]])

    def fault(frames: Frames, camera: Camera, _: np.random.Generator) -> Frames:
        results, period = [frame.copy() for frame in frames], len(camera.cfa)
        for result in results:
            for row, column in np.ndindex(period, period):
                site = result[row::period, column::period]
                site[...] = ndimage.convolve(site, weights, mode="nearest")
        return results

    return fault


def coarse(step: int) -> Fault:
    """Fewer bits than the file has: values in steps."""

    def fault(frames: Frames, _: Camera, __: np.random.Generator) -> Frames:
        return [step * np.rint(frame / step) for frame in frames]

    return fault


def mixed(share: float) -> Fault:
    """Each pixel gets this share of its left neighbour, of whatever colour."""

    def fault(frames: Frames, _: Camera, __: np.random.Generator) -> Frames:
        return [(1 - share) * frame + share * np.roll(frame, 1, axis=1) for frame in frames]

    return fault
