"""LRD under its own protocol: which pairs it scores, and a table without its many factors.

The arithmetic is held against the published code in ``test_every_protocol``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.evaluation import evaluate, save_prediction
from eldata.evaluation.scores import groups_of
from eldata.manifest.catalogue import shipped_manifest
from tests.lrd_tree import SENSOR, write_frames

if TYPE_CHECKING:
    from pathlib import Path


def test_the_first_subset_is_scored_in_one_group(tmp_path: Path) -> None:
    """That of the published code's default; nearly every pair has a factor of its own, which make no groups."""
    records = [record for record in shipped_manifest("lrd").records if record.split == "test"]
    write_frames(tmp_path / "LRD", records)
    generator = np.random.default_rng(3)
    shape = 4, SENSOR.height // 2, SENSOR.width // 2
    for record in (record for record in records if record.role == "noisy"):
        save_prediction(tmp_path / "preds", record.path, generator.random(shape, np.float32))
    result = evaluate(tmp_path / "preds", "lrd", root=tmp_path)
    assert (result.protocol.name, len(result.scores), result.problems) == ("lrd-lrd", 60, ())
    assert {pair.path.split("_")[1] for pair in result.units} == {"03"}
    assert len({pair.ratio for pair in result.units}) == 27  # datalist/LRD_test_list.txt, -3EV
    (row,) = result.table
    assert (row.camera, row.ratio, row.pairs) == (None, None, 60)
    mean = math.fsum(image.psnr_db for image in result.scores) / 60
    assert row.values["psnr_db"] == pytest.approx(mean, rel=1e-12)


def test_up_to_twelve_factors_are_groups() -> None:
    twelve = [("A", float(ratio)) for ratio in range(1, 13)]
    assert groups_of(twelve) == [*twelve, (None, None)]
    assert groups_of([*twelve, ("A", 13.0)]) == [(None, None)]
    assert groups_of([*twelve, ("B", 13.0)]) == [("A", None), ("B", None), (None, None)]
