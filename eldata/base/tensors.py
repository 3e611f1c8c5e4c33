"""Telling torch tensors apart without importing torch."""

from __future__ import annotations

import sys


def is_tensor(value: object) -> bool:
    """Tell whether ``value`` is a torch tensor, without importing torch where it is not used."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)
