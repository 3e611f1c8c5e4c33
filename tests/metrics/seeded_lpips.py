"""Seeded weights of LPIPS, in memory and as files that are taken for the published ones."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from eldata.base.files import sha256_of
from eldata.metrics import LpipsWeights
from eldata.metrics.lpips import BACKBONE_FILE, LINEAR_FILE
from tests.metrics.golden.lpips_images import backbone_state, linear_state

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

State = dict[str, torch.Tensor]


def seeded_states() -> tuple[State, State]:
    """Of AlexNet's convolutions and of the linear layers."""
    backbone, linear = (
        {name: torch.from_numpy(values) for name, values in state.items()}
        for state in (backbone_state(), linear_state())
    )
    return backbone, linear


def publish(folder: Path, states: tuple[State, State], patch: pytest.MonkeyPatch) -> Path:
    """Write weights into a new folder, have them taken for the published files, and return the folder."""
    folder.mkdir()
    module = sys.modules[LpipsWeights.__module__]  # the package's attribute of this name is the function
    for constant, file, state in (("BACKBONE_FILE", BACKBONE_FILE, states[0]), ("LINEAR_FILE", LINEAR_FILE, states[1])):
        path = folder / file.name
        torch.save(state, path)
        patch.setattr(module, constant, replace(file, size_bytes=path.stat().st_size, sha256=sha256_of(path)))
    return folder
