"""Whether two samples, batches or sources are the same: names, types, and values to the bit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from eldata.datasets import CleanSource


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


def same_bits(tensor: torch.Tensor, expected: NDArray[np.float32]) -> None:
    """Both are float32, of one shape, and equal to the bit, the sign of a zero included."""
    assert tensor.dtype == torch.float32
    assert expected.dtype == np.float32
    np.testing.assert_array_equal(tensor.numpy().view(np.uint32), expected.view(np.uint32), strict=True)


def same_frames(first: CleanSource, second: CleanSource) -> None:
    assert len(first) == len(second) > 0
    for number in range(len(first)):
        ours, theirs = first.frame(number), second.frame(number)
        assert (ours.cfa, ours.black_level_dn, ours.white_level_dn, ours.sensor) == (
            *(theirs.cfa, theirs.black_level_dn, theirs.white_level_dn, theirs.sensor),
        )
        np.testing.assert_array_equal(ours.whole(), theirs.whole(), strict=True)
