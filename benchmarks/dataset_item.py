"""One item of a dataset: two lossless-JPEG files to input and target."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from benchmarks import published
from benchmarks.harness import Row, in_turn

if TYPE_CHECKING:
    from benchmarks.data import Files


def run(files: Files, rounds: int, _cores: int) -> list[Row]:
    dataset = files.dataset()
    noisy, reference = files.first_pair()
    sample, (amplified, target) = dataset[0], published.item(noisy, reference)
    assert np.array_equal(sample["input"].numpy(), amplified)
    assert np.array_equal(sample["target"].numpy(), target)
    timings = in_turn(
        rounds,
        {
            "LibRaw, both files": lambda: (published.decode(noisy), published.decode(reference)),
            "eldata": lambda: dataset[0],
            "published": lambda: published.item(noisy, reference),
        },
    )
    return [
        timings.faster("input and target", "eldata", "published", values="bit-identical"),
        timings.cost("input and target", "eldata", "LibRaw, both files", at_most=1.15),
    ]
