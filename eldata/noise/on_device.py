"""The noise model in torch's own operations, for tensors on a GPU or any other device."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch

from eldata.noise.components import mosaic_rows, packed_rows
from eldata.noise.parameters import Adc, NoiseDraw, key_from

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray


# Uniforms are float64 multiples of 2^-53 from 0 on: half a step keeps them off 0; the largest must not round to 1.
_HALF_STEP = 2.0**-54
_LARGEST = 1 - 2.0**-53

_LARGEST_MEAN = 2.0**30


def expose_on_device(
    clean: torch.Tensor,
    draws: Sequence[NoiseDraw],
    components: Sequence[str],
    generator: torch.Generator,
    *,
    adc: Adc | None = None,
    limits: tuple[float, float] = (-math.inf, math.inf),
    dark: NDArray[np.float32] | None = None,
) -> torch.Tensor:
    """Add noise to ``clean`` (N, C, h, w) float32 on its device; other arguments as in ``expose_compiled``."""
    device, size = clean.device, clean.shape

    def per_image(values: Sequence[float], dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """Make a tensor (N, 1, 1, 1) of one value for each image."""
        return torch.tensor(values, dtype=dtype, device=device)[:, None, None, None]

    def collect(name: str, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """Collect a parameter of all draws as a tensor (N, 1, 1, 1)."""
        return per_image([getattr(draw.parameters, name) for draw in draws], dtype)

    def draw_normal() -> torch.Tensor:
        """Draw a standard normal number for each pixel."""
        return torch.randn(size, generator=generator, device=device)

    gain, scale = collect("gain_dn_per_e"), per_image([draw.range_dn / draw.ratio for draw in draws])
    # DN above black: K I. An infinite clean value stays the largest number, which the clip then takes.
    dn = clean.clamp(0.0, torch.finfo(torch.float32).max) * scale
    if "P*" in components:
        dn = torch.where(dn.isnan(), dn, _poisson(torch.nan_to_num(dn / gain, nan=0.0), generator) * gain)
    if "P" in components:
        dn = dn + (gain * dn).sqrt() * draw_normal()
    if "G*" in components:
        dn = dn + collect("sigma_tl_dn") * _tukey_lambda(size, collect("tukey_lambda", torch.float64), generator)
    if "G" in components:
        dn = dn + collect("sigma_gauss_dn") * draw_normal()
    if "B" in components:
        bias = [draw.parameters.channel_bias_dn(size[1]) for draw in draws]
        dn = dn + torch.tensor(bias, dtype=torch.float32, device=device).reshape(*size[:2], 1, 1)
    if "R" in components:
        dn = dn + _row_noise(size, collect("sigma_row_dn"), generator)
    if dark is not None:
        dn = dn + torch.from_numpy(dark).to(device)
    if "U" in components:
        uniform = torch.rand(size, generator=generator, device=device) - 0.5
        dn = dn + uniform * collect("quantisation_step_dn")
    if adc is not None:
        step = collect("quantisation_step_dn")
        codes = (((dn + adc.black_level_dn) / step).round() * step).round()
        dn = codes.clamp(0.0, adc.white_level_dn) - adc.black_level_dn
    return (dn / scale).clamp(*limits)


def _poisson(mean: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return Poisson draws as float32, for any mean.

    torch counts in integers, of 32 bits on a GPU and of 64 on the CPU. From 2^30 on the law is the normal one to 1 part
    in 30,000 (its skewness), so the draw of that mean is stretched.

    They come from a generator of their own. On a GPU a draw takes a random number for each electron, and torch sets
    aside 20: the noise that is drawn next would begin with those that the others took, and go against the electrons
    (pytorch/pytorch#136750; at 25 electrons by a correlation of -0.08).
    """
    own = torch.Generator(mean.device).manual_seed(key_from(generator))
    drawn = torch.poisson(mean.clamp(max=_LARGEST_MEAN), generator=own)
    far = mean + (mean / _LARGEST_MEAN).sqrt() * (drawn - _LARGEST_MEAN)
    return torch.where(mean > _LARGEST_MEAN, far, drawn)


def _tukey_lambda(size: torch.Size, shape: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return Tukey-lambda draws of scale 1. In float64, where u and 1 - u keep both tails."""
    u = torch.rand(size, generator=generator, dtype=torch.float64, device=shape.device) + _HALF_STEP
    u.clamp_(max=_LARGEST)
    below, above = u.log(), torch.log1p(-u)
    # Division by 0 is avoided and its result not taken: the limit at 0 is the logistic distribution.
    nonzero = torch.where(shape == 0, torch.ones_like(shape), shape)
    general = (torch.expm1(shape * below) - torch.expm1(shape * above)) / nonzero
    return torch.where(shape == 0, below - above, general).to(torch.float32)


def _row_noise(size: torch.Size, sigma: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return row noise (N, C, h, w): one draw per mosaic row."""
    images, channels, height, width = size
    sub = packed_rows(channels)[0].shape[1]
    row = torch.as_tensor(mosaic_rows(channels, height, min(width, sub)), device=sigma.device)
    rows = -(-height // sub) * packed_rows(channels)[1]
    draws = torch.randn((images, rows), generator=generator, device=sigma.device)
    noise = draws[:, row] * sigma  # (N, C, h, s): it repeats every s columns
    return noise.repeat(1, 1, 1, -(-width // sub))[..., :width] if width > sub else noise
