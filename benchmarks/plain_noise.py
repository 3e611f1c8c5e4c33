"""The noise model the straightforward way: whole-array operations of numpy and scipy, or of torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.stats import tukeylambda

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from eldata.noise import NoiseParameters

RANGE_DN = 15871.0


def with_numpy(
    clean: NDArray[np.float32], p: NoiseParameters, ratio: float, generator: np.random.Generator
) -> NDArray[np.float32]:
    """Return a noisy (4, h, w): Poisson, the Tukey-lambda quantile of uniforms, row normals, uniforms."""
    return _composed(clean, p, ratio, generator, _quantile)


def with_scipy(
    clean: NDArray[np.float32], p: NoiseParameters, ratio: float, generator: np.random.Generator
) -> NDArray[np.float32]:
    """Return the same with read noise by ``tukeylambda.rvs``."""
    return _composed(clean, p, ratio, generator, _rvs)


def _composed(
    clean: NDArray[np.float32],
    p: NoiseParameters,
    ratio: float,
    generator: np.random.Generator,
    read: Callable[[float, tuple[int, ...], np.random.Generator], NDArray[np.float64]],
) -> NDArray[np.float32]:
    _, height, _ = clean.shape
    scale = RANGE_DN / ratio
    dn = p.gain_dn_per_e * generator.poisson(clean * (scale / p.gain_dn_per_e))
    dn = dn + p.sigma_tl_dn * read(p.tukey_lambda, clean.shape, generator)
    dn += np.asarray(p.colour_bias_dn)[:, None, None]
    rows = generator.normal(0.0, p.sigma_row_dn, (2, height, 1))
    dn += rows[[0, 0, 1, 1]]
    dn += generator.uniform(-0.5, 0.5, clean.shape)
    noisy: NDArray[np.float32] = (dn / scale).astype(np.float32)
    return noisy


def _quantile(shape: float, size: tuple[int, ...], generator: np.random.Generator) -> NDArray[np.float64]:
    u = generator.random(size)
    values: NDArray[np.float64] = np.log(u / (1 - u)) if shape == 0 else (u**shape - (1 - u) ** shape) / shape
    return values


def _rvs(shape: float, size: tuple[int, ...], generator: np.random.Generator) -> NDArray[np.float64]:
    values: NDArray[np.float64] = tukeylambda.rvs(shape, size=size, random_state=generator)
    return values


def with_torch(clean: torch.Tensor, p: NoiseParameters, ratio: float, generator: torch.Generator) -> torch.Tensor:
    """Return the same by torch operations, float32."""
    scale = RANGE_DN / ratio
    dn = torch.poisson(clean * (scale / p.gain_dn_per_e), generator=generator) * p.gain_dn_per_e
    u = torch.rand(clean.shape, generator=generator).clamp_(1e-7, 1 - 1e-7)
    shape = p.tukey_lambda
    read = torch.log(u / (1 - u)) if shape == 0 else (u**shape - (1 - u) ** shape) / shape
    dn = dn + p.sigma_tl_dn * read + torch.tensor(p.colour_bias_dn, dtype=torch.float32)[:, None, None]
    dn = dn + (torch.randn((2, clean.shape[1], 1), generator=generator) * p.sigma_row_dn)[[0, 0, 1, 1]]
    dn = dn + torch.rand(clean.shape, generator=generator) - 0.5
    return dn / scale
