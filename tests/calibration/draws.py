"""Random cameras for tests of calibration, over the ranges of the shipped profiles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from eldata.demo.body import KnownNoise
from tests.calibration.simulation import XTRANS, Camera

# Of eldata/noise/profiles/*.json: gains, lambdas and biases of the rows, scales on the fitted lines. (The line of
# NikonD850-2 goes down to 0.1 DN; noise that quiet is lost in rounding, and the calibration says so.)
GAIN_DN_PER_E = (0.09, 29.0)
TUKEY_LAMBDA = (-0.24, 0.2)
SIGMA_TL_DN = (0.6, 35.0)
SIGMA_ROW_DN = (0.1, 4.2)
COLOUR_BIAS_DN = (-2.9, 6.1)

BAYER_PHASES = (((0, 1), (3, 2)), ((1, 0), (2, 3)), ((3, 2), (0, 1)), ((2, 3), (1, 0)))


def drawn_noise(generator: np.random.Generator, isos: Sequence[int], channels: int = 4) -> tuple[KnownNoise, ...]:
    """Draw a camera's noise at ISOs that span at most a factor of 300.

    The gain is in proportion to the ISO. The scales lie on a line over the gain in log-log coordinates, with a scatter
    of a tenth; lambda and the bias are drawn at each ISO anew.
    """
    ratio = max(isos) / min(isos)
    base = _log_uniform(generator, GAIN_DN_PER_E[0], GAIN_DN_PER_E[1] / ratio) / min(isos)
    slope = generator.uniform(0.45, 0.65)
    sigma_tl = _log_uniform(generator, SIGMA_TL_DN[0], max(SIGMA_TL_DN[1] / ratio**slope, SIGMA_TL_DN[0]))
    row_share = generator.uniform(0.1, 0.3)
    drawn = []
    for iso in isos:
        line, scatter = sigma_tl * (iso / min(isos)) ** slope, np.exp(0.1 * generator.standard_normal(2))
        common = generator.uniform(-2.0, 4.0)
        drawn.append(
            KnownNoise(
                iso=iso,
                gain_dn_per_e=base * iso,
                tukey_lambda=float(generator.uniform(*TUKEY_LAMBDA)),
                sigma_tl_dn=float(np.clip(line * scatter[0], *SIGMA_TL_DN)),
                sigma_row_dn=float(np.clip(row_share * line * scatter[1], *SIGMA_ROW_DN)),
                colour_bias_dn=tuple(np.clip(generator.normal(common, 0.7, channels), *COLOUR_BIAS_DN).tolist()),
            )
        )
    return tuple(drawn)


def drawn_camera(generator: np.random.Generator) -> Camera:
    """A camera without a fault: any CFA, tails, noise and fixed pattern of the shipped profiles' ranges.

    One in five is quieter than any of these, down to noise that is lost in rounding.
    """
    xtrans = bool(generator.random() < 0.3)
    noise = drawn_noise(generator, [100, 3200], 3 if xtrans else 4)[generator.integers(2)]
    quiet = float(np.exp(generator.uniform(np.log(0.1), np.log(0.6))))
    return Camera(
        shape=(390, 576) if xtrans else (384, 576),
        cfa=XTRANS if xtrans else BAYER_PHASES[generator.integers(4)],
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


def _log_uniform(generator: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(generator.uniform(math.log(low), math.log(high))))
