"""Whether two samples, batches or sources are the same: names, types, and values to the bit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rawpy
import torch
from numpy.typing import NDArray

from eldata.datasets import CleanSource
from tests.raw.helpers import reference_pack


def same(first: Mapping[str, Any], second: Mapping[str, Any]) -> None:
    assert set(first) == set(second)
    for key, value in first.items():
        other = second[key]
        assert type(value) is type(other), key
        if isinstance(value, torch.Tensor):
            assert (value.dtype, value.shape) == (other.dtype, other.shape), key
            assert value.numpy().tobytes() == other.numpy().tobytes(), key
        else:
            assert value == other or (value != value and other != other), key  # or both NaN


def same_bits(found: NDArray[np.float32] | torch.Tensor, expected: NDArray[np.float32]) -> None:
    """Both are float32, of one shape, and equal to the bit, the sign of a zero included."""
    found = np.asarray(found)
    assert found.dtype == expected.dtype == np.float32
    np.testing.assert_array_equal(found.view(np.uint32), expected.view(np.uint32), strict=True)


def same_frames(first: CleanSource, second: CleanSource) -> None:
    assert len(first) == len(second) > 0
    for number in range(len(first)):
        ours, theirs = first.frame(number), second.frame(number)
        assert (ours.cfa, ours.black_level_dn, ours.white_level_dn, ours.sensor) == (
            *(theirs.cfa, theirs.black_level_dn, theirs.white_level_dn, theirs.sensor),
        )
        np.testing.assert_array_equal(ours.whole(), theirs.whole(), strict=True)


def pack_plainly(path: Path, white: float, black: float | None = None) -> NDArray[np.float32]:
    """Pack and normalise as the published codes do, in numpy on rawpy's pixels, without any clip."""
    period = 6 if path.suffix == ".RAF" else 2
    with rawpy.imread(str(path)) as raw:
        colours, dn = raw.raw_colors_visible.copy(), raw.raw_image_visible.astype(np.float32)
        own = np.array(raw.black_level_per_channel, np.float32)[colours]
    cfa = tuple(tuple(row) for row in colours[:period, :period].tolist())
    level = reference_pack(own, cfa) if black is None else np.float32(black)
    packed: NDArray[np.float32] = (reference_pack(dn, cfa) - level) / (np.float32(white) - level)
    return packed
