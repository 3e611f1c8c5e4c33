"""How many modules a reader passes on the way of a calibration, by a profile hook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata import calibrate
from tests.calibration.trees import made_tree
from tests.evaluation.test_way_of_a_score import modules_called

if TYPE_CHECKING:
    from pathlib import Path


def test_a_calibration_passes_few_modules(tmp_path: Path) -> None:
    """From files to a profile: half of them decode the files, and simulate the frame that is kept out."""
    frames = made_tree(tmp_path / "tree", isos=(400,)).frames()
    passed, _ = modules_called(lambda: calibrate(frames))
    assert len([name for name in passed if name.startswith("eldata.calibration.")]) <= 16, sorted(passed)
    assert len(passed) <= 41, sorted(passed)
