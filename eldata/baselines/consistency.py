"""Losses of clips: recovery, and the paper's self-consistency of two predictions of one scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eldata.base.numbers import checked_number, checked_whole
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Mapping

    import torch

PUBLISHED_WEIGHT = 0.05
"""Of the self-consistency: ``alpha`` in train.py of cchen156/Seeing-Motion-in-the-Dark."""


def consistent_error(
    first: torch.Tensor,
    second: torch.Tensor,
    first_target: torch.Tensor,
    second_target: torch.Tensor,
    *,
    weight: float = PUBLISHED_WEIGHT,
) -> torch.Tensor:
    r"""Return the recovery loss of two predictions of one scene, and how much they differ from each other.

    ``|f1 - y1| + |f2 - y2| + weight |(f1 - f2) - (y1 - y2)|``, where ``| |`` is the mean absolute value.

    Of a static scene, where y1 = y2, that is C. Chen et al. (ICCV 2019), their train.py, in raw image space as K. Wei
    et al. (TPAMI 2021, section on videography) have it: ``|f1 - y| + |f2 - y| + 0.05 |f1 - f2|``. The paper has no
    formula for moving scenes. Here what moved in the clean frames may move in the predictions, and what differs beyond
    that is flicker.

    Parameters
    ----------
    first, second
        The predictions f1 and f2, (N, C, h, w).
    first_target, second_target
        y1 and y2, of the same shape; of a static scene the same.
    weight
        Of the self-consistency, 0 or more.

    Raises
    ------
    ArgumentError
        If the weight is negative or not finite.
    """
    if checked_number("weight", weight) < 0:
        raise ArgumentError(f"weight is 0 or more; found {weight}")
    one, other = first - first_target, second - second_target
    return one.abs().mean() + other.abs().mean() + weight * (one - other).abs().mean()


def clip_error(
    network: torch.nn.Module, batch: Mapping[str, Any], *, window: int, weight: float = PUBLISHED_WEIGHT
) -> torch.Tensor:
    """Return :func:`consistent_error` of the first and the last window of each clip of a batch: a loss of ``Training``.

    Both windows go through the network at once. What a window's prediction is compared with is its middle frame's
    target.

    Parameters
    ----------
    network
        Of windows (N, T, C, h, w), or with T = 1 of frames (N, C, h, w), to (N, C, h, w).
    batch
        ``input`` (N, F, C, h, w), F > T frames of which each has noise of its own; ``target`` (N, F, C, h, w), or
        (N, C, h, w) where one still is the target of all frames. Samples of
        :class:`~eldata.datasets.synthetic.SyntheticClips` and :class:`~eldata.datasets.clips.ClipWindows` are so.
    window
        T, odd.
    weight
        As :func:`consistent_error` has it.

    Raises
    ------
    ArgumentError
        If T is even, or the batch has no two windows.
    """
    import torch

    noisy, clean = batch["input"], batch["target"]
    middle = checked_window(window) // 2
    if noisy.ndim != 5 or noisy.shape[1] <= window:
        raise ArgumentError(
            f"clips of {window + 1} frames or more, (N, F, C, h, w), make two windows of {window}; found "
            f"{tuple(noisy.shape)}"
        )
    frames = torch.cat([noisy[:, :window], noisy[:, -window:]])
    first, second = network(frames[:, 0] if window == 1 else frames).chunk(2)
    if clean.ndim == 4:
        return consistent_error(first, second, clean, clean, weight=weight)
    return consistent_error(first, second, clean[:, middle], clean[:, -1 - middle], weight=weight)


def checked_window(window: int) -> int:
    """Return a number of frames of which the middle one is predicted; raise :class:`ArgumentError` unless it is odd."""
    if checked_whole("window", window, at_least=1) % 2 == 0:
        raise ArgumentError(f"the middle frame of a window is predicted, so their number is odd; found {window}")
    return window
