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
    for file, state in zip((BACKBONE_FILE, LINEAR_FILE), states, strict=True):
        torch.save(state, folder / file.name)
    take_as_published(folder, patch)
    return folder


def take_as_published(folder: Path, patch: pytest.MonkeyPatch | None = None) -> None:
    """Have a folder's weights taken for the published files; without ``patch`` as long as the process lives."""
    module = sys.modules[LpipsWeights.__module__]  # the package's attribute of this name is the function
    setting = setattr if patch is None else patch.setattr
    for constant, file in (("BACKBONE_FILE", BACKBONE_FILE), ("LINEAR_FILE", LINEAR_FILE)):
        path = folder / file.name
        setting(module, constant, replace(file, size_bytes=path.stat().st_size, sha256=sha256_of(path)))
