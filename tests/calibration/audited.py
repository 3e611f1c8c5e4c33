"""What the audit of bias frames finds in simulated cameras, with faults and without."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.bias_sums import BiasPairs
from eldata.calibration.checks import bias_findings, code_step, mean_step
from tests.calibration import draws
from tests.calibration.chain import calibrated, figures_of, given
from tests.calibration.simulation import XTRANS, Body, Camera

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.calibration.iso_results import Finding, MeasuredFigure
    from tests.calibration.faults import Planted

CAMERA = Camera(shape=(512, 768), shading=1.0)
FRAMES = 9


@dataclass(frozen=True)
class Audited:
    """One camera's bias frames through the estimators and the audit: each figure with it, and in truth."""

    findings: tuple[Finding, ...]
    after: dict[str, MeasuredFigure | None]
    truth: dict[str, float]

    @property
    def effects(self) -> dict[str, str]:
        return {one.check: one.effect for one in self.findings}


def audited(camera: Camera, frames: Sequence[NDArray[np.uint16]]) -> Audited:
    found = calibrated(camera, frames)
    audit = BiasPairs(found.fixed)
    for frame in frames:
        audit.add(frame)
    statistics = audit.statistics()
    step = code_step(statistics.codes)
    step_dn = float(step) if step > 1 else mean_step(statistics.codes)
    findings = bias_findings(statistics, found.bias, found.rows, found.read, step_dn)
    after, truth = {}, {}
    for name, (figure, value, error, true, scale) in figures_of(found, camera).items():
        after[name] = given(findings, figure, value, error, scale)
        truth[name] = true
    return Audited(findings, after, truth)


def planted(fault: Planted, seed: int, camera: Camera = CAMERA) -> Audited:
    return audited(camera, fault.bias_frames(Body(camera, np.random.default_rng(seed)), FRAMES))


def drawn_camera(generator: np.random.Generator) -> Camera:
    """A camera without a fault: any CFA, tails, noise and fixed pattern of the shipped profiles' ranges.

    One in five is quieter than any of these, down to noise that is lost in rounding.
    """
    xtrans = bool(generator.random() < 0.3)
    noise = draws.drawn_noise(generator, [100, 3200], 3 if xtrans else 4)[generator.integers(2)]
    quiet = float(np.exp(generator.uniform(np.log(0.1), np.log(0.6))))
    return Camera(
        shape=(390, 576) if xtrans else (384, 576),
        cfa=XTRANS if xtrans else draws.BAYER_PHASES[generator.integers(4)],
        gain=noise.gain_dn_per_e,
        tukey_lambda=noise.tukey_lambda,
        sigma_tl=quiet if generator.random() < 0.2 else noise.sigma_tl_dn,
        sigma_row=noise.sigma_row_dn,
        bias=noise.colour_bias_dn,
        black=2048.0,
        dsnu=float(generator.choice([0.0, 0.2, 0.6])),
        column_pattern=float(generator.choice([0.0, 0.3])),
        hot_share=float(generator.choice([0.0, 1e-4, 1e-3])),
        shading=float(generator.choice([0.0, 1.0, 5.0])),
    )


def clean(seed: int) -> tuple[Finding, ...]:
    """What is said of one of those, from 4 to 12 frames."""
    generator = np.random.default_rng(seed)
    camera = drawn_camera(generator)
    return audited(camera, Body(camera, generator).bias_frames(int(generator.choice([4, 5, 9, 12])))).findings
