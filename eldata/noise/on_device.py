"""The noise model in torch's own operations, for tensors on a GPU or any other device."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from eldata.noise.mosaic import packed_rows
from eldata.noise.parameters import key_from

if TYPE_CHECKING:
    from collections.abc import Callable

    from eldata.noise.exposures import DarkCrops, Exposures

# Uniforms are float64 multiples of 2^-53 from 0 on: half a step keeps them off 0; the largest must not round to 1.
_HALF_STEP = 2.0**-54
_LARGEST = 1 - 2.0**-53

_LARGEST_MEAN = 2.0**30


def expose_on_device(clean: torch.Tensor, exposures: Exposures, generator: torch.Generator) -> torch.Tensor:
    """Return noisy exposures of ``clean`` (N, C, h, w) float32 on its device."""
    device, components, adc = clean.device, exposures.components, exposures.adc

    def per_image(array: object) -> torch.Tensor:
        values = torch.as_tensor(array, dtype=torch.float32, device=device)
        return values[(...,) + (None,) * (4 - values.ndim)]

    gain, range_dn = per_image(exposures.gain_dn_per_e), exposures.range_dn
    scale = (range_dn if isinstance(range_dn, float) else per_image(range_dn)) / per_image(exposures.ratio)
    # DN above black: K I. An infinite clean value stays the largest number, which the clip then takes.
    signal = clean.clamp(0.0, torch.finfo(torch.float32).max) * scale
    if components.shot == "poisson":
        dn = torch.where(signal.isnan(), signal, _poisson(torch.nan_to_num(signal / gain, nan=0.0), generator) * gain)
    elif components.shot == "gaussian":
        normal = torch.randn(clean.shape, generator=generator, device=device)
        dn = signal + (gain * signal).sqrt() * normal
    else:
        dn = signal
    if components.read == "tukey-lambda":
        shape = torch.as_tensor(exposures.tukey_lambda, dtype=torch.float64, device=device)[:, None, None, None]
        dn = dn + per_image(exposures.sigma_read_dn) * _tukey_lambda(clean.shape, shape, generator)
    elif components.read == "gaussian":
        dn = dn + per_image(exposures.sigma_read_dn) * torch.randn(clean.shape, generator=generator, device=device)
    if components.colour_bias or components.dark:
        dn = dn + per_image(exposures.bias_dn)
    if components.row:
        dn = dn + _row_noise(clean.shape, per_image(exposures.sigma_row_dn), generator)
    if exposures.dark is not None:
        dn = dn + _dark_frames(exposures.dark, per_image)
    if components.quantisation or exposures.dithers:
        dn = dn + (torch.rand(clean.shape, generator=generator, device=device) - 0.5) * per_image(exposures.step_dn)
    if adc is not None:
        step = per_image(exposures.step_dn)
        codes = (((dn + adc.black_level_dn) / step).round() * step).round()
        dn = codes.clamp(0.0, adc.white_level_dn) - adc.black_level_dn
    return (dn / scale).clamp(*exposures.limits)


def _dark_frames(dark: DarkCrops, per_image: Callable[[object], torch.Tensor]) -> torch.Tensor:
    """Return dark frames as what is added where their black level was taken off before."""
    frames = per_image(dark.dn.astype(np.float32))
    if dark.shading_dn is not None:
        frames = frames - per_image(dark.shading_dn)
    if dark.scale is not None:
        black = per_image(np.negative(dark.black_level_dn))
        frames = (frames + black) * per_image(dark.scale) - black
    return frames


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
    under = packed_rows(channels)
    rows = -(-height // under.sub) * under.period
    draws = torch.randn((images, rows), generator=generator, device=sigma.device)
    table = torch.as_tensor(under.table, device=sigma.device)
    y = torch.arange(height, device=sigma.device)[:, None]
    x = torch.arange(min(width, under.sub), device=sigma.device)[None, :]
    row = (y // under.sub) * under.period + table[:, y % under.sub, x % under.sub]
    noise = draws[:, row] * sigma  # (N, C, h, s): it repeats every s columns
    return noise.repeat(1, 1, 1, -(-width // under.sub))[..., :width] if width > under.sub else noise[..., :width]
