"""examples/train_from_store.py, from a store and from shards, in one process and under torchrun."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import PATIENCE_S

EXAMPLE = Path(__file__).parents[3] / "examples" / "train_from_store.py"
OPTIONS = ["--crop", "16", "--batch-size", "2", "--epochs", "3", "--workers", "2"]


def errors_of(*command: str) -> list[float]:
    done = subprocess.run(
        [sys.executable, *command, *OPTIONS],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert "training: " in done.stdout
    return [float(text) for text in re.findall(r"epoch \d: mean absolute error (\S+)", done.stdout)]


@pytest.mark.study
@pytest.mark.parametrize("which", ["store", "shards"])
def test_it_learns(which: str, eld: Path, tiles: Path) -> None:
    errors = errors_of(str(EXAMPLE), str(eld if which == "store" else tiles))
    assert len(errors) == 3
    assert errors[2] < errors[0]


@pytest.mark.study
def test_under_torchrun(tiles: Path) -> None:
    """Two ranks: it ends, so both had as many batches."""
    launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    errors = errors_of(*launch, str(EXAMPLE), str(tiles))
    assert len(errors) == 3
    assert errors[2] < errors[0]
