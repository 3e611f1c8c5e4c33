"""Random numbers from the generator that the caller gives: numpy's or torch's. Never a global one."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from eldata.errors import ArgumentError

if TYPE_CHECKING:
    import torch

Generator: TypeAlias = "np.random.Generator | torch.Generator"


def _is_torch(generator: Generator) -> bool:
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(generator, torch.Generator)


def _checked(generator: Generator) -> None:
    if not isinstance(generator, np.random.Generator) and not _is_torch(generator):
        raise ArgumentError(
            f"generator must be a numpy.random.Generator or a torch.Generator, not {type(generator).__name__}; "
            "for example numpy.random.default_rng(0)"
        )


def uniforms(generator: Generator, count: int) -> list[float]:
    """Return ``count`` draws from [0, 1), float64."""
    _checked(generator)
    if isinstance(generator, np.random.Generator):
        return list(generator.random(count).tolist())
    import torch

    return list(torch.rand(count, generator=generator, dtype=torch.float64, device=generator.device).tolist())


def standard_normals(generator: Generator, count: int) -> list[float]:
    """Return ``count`` standard normal draws, float64."""
    _checked(generator)
    if isinstance(generator, np.random.Generator):
        return list(generator.standard_normal(count).tolist())
    import torch

    return list(torch.randn(count, generator=generator, dtype=torch.float64, device=generator.device).tolist())


def key_from(generator: Generator) -> int:
    """Return a 63-bit key for a counter-based generator."""
    _checked(generator)
    if isinstance(generator, np.random.Generator):
        return int(generator.integers(2**63 - 1))
    import torch

    return int(torch.randint(2**63 - 1, (1,), generator=generator, device=generator.device).item())
