"""TensorBoard takes what docs/plots.md gives it: read back by its own reader."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.tensorboard import SummaryWriter

from eldata.datasets import Arrays, SyntheticPairs
from tests.reports.evaluations import result

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray


def pixels_of(figure: Figure) -> NDArray[np.uint8]:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return np.asarray(Image.open(buffer).convert("RGB"))


def test_tensorboard_takes_scores_and_figures(tmp_path: Path) -> None:
    scored = result(scenes=2)
    pairs = SyntheticPairs(
        Arrays(np.full((1, 4, 16, 24), 0.4, np.float32), range_dn=15871.0), "SonyA7S2", crop=None, augment=False
    )
    with SummaryWriter(str(tmp_path)) as writer:
        for row in scored.table:
            writer.add_scalar(f"ELD/PSNR {row.camera or 'all'} x{row.ratio or 0:g}", row.psnr_db, 7)
        writer.add_figure("ELD/scores", scored.plot(), 7)
        writer.add_figure("ELD/first pair", pairs.plot(0), 7)
    events = EventAccumulator(str(tmp_path), size_guidance={"images": 0}).Reload()
    assert sorted(events.Tags()["images"]) == ["ELD/first pair", "ELD/scores"]
    found = {tag: events.Scalars(tag)[0] for tag in events.Tags()["scalars"]}
    assert len(found) == len(scored.table)
    for row in scored.table:
        scalar = found[f"ELD/PSNR {row.camera or 'all'} x{row.ratio or 0:g}"]
        assert (scalar.step, scalar.value) == (7, pytest.approx(row.psnr_db, rel=2**-23))  # events hold float32
    for tag, figure in (("ELD/scores", scored.plot()), ("ELD/first pair", pairs.plot(0))):
        (image,) = events.Images(tag)
        shown = np.asarray(Image.open(io.BytesIO(image.encoded_image_string)).convert("RGB"))
        assert image.step == 7
        np.testing.assert_array_equal(shown, pixels_of(figure))
