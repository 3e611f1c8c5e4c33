"""Colour bias mu_c: by how much the mean of a bias frame differs from the recorded black level, per channel."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core._frames import FrameSums, checked_black_level, sums_by_line, sums_by_row
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.raw.cfa import Cfa


@dataclass(frozen=True, slots=True, eq=False)
class ColourBias:
    """Colour bias per CFA channel, DN: R, G1, B, G2 for Bayer, R, G, B for X-Trans.

    Attributes
    ----------
    bias_dn
        Mean of all frames minus black level.
    standard_error_dn
        From the scatter of the frames' means, with n - 1 degrees of freedom; nan for one frame. It holds drift from
        frame to frame, which the next one cannot see.
    row_error_dn
        From the scatter of row means inside the frames; it also holds a fixed row pattern.
    frame_bias_dn
        (frames, channels): each frame's own.
    frames
        Number of frames.
    """

    bias_dn: tuple[float, ...]
    standard_error_dn: tuple[float, ...]
    row_error_dn: tuple[float, ...]
    frame_bias_dn: NDArray[np.float64] = field(repr=False)
    frames: int

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the CFA's channels."""
        return ("R", "G1", "B", "G2") if len(self.bias_dn) == 4 else ("R", "G", "B")


class ChannelMeans(FrameSums):
    """Accumulates the channel and row means of bias frames for :func:`colour_bias`.

    Parameters
    ----------
    cfa
        The CFA of pixel (0, 0).
    defects
        (H, W) True where a pixel is not to be used; without it, hot pixels raise the means.
    """

    def __init__(self, cfa: Cfa, *, defects: NDArray[np.bool_] | None = None) -> None:
        super().__init__(cfa, defects)
        self.means_dn: list[NDArray[np.float64]] = []
        """Mean of each channel, one entry per frame."""
        self.row_variances_dn2: list[NDArray[np.float64]] = []
        """Variance of each channel's mean by the scatter of its row means, one entry per frame."""

    def add(self, mosaic: NDArray[np.uint16]) -> None:
        """Add a bias frame."""
        defects = self._check(mosaic)
        if self.frames == 1:
            self._pixels = sums_by_row(~defects, self.pattern)
        sums, _ = sums_by_line(mosaic, defects, self.pattern)
        pixels = self._pixels.sum(axis=0)
        if not np.all(pixels > 0):
            raise DatasetError("a channel has no sound pixel: the mask of defects covers it; raise its threshold")
        mean = sums.sum(axis=0) / pixels
        # Cluster-robust variance of a ratio: rows are the clusters.
        deviations = sums - self._pixels * mean
        rows = np.count_nonzero(self._pixels, axis=0)
        variance = (deviations**2).sum(axis=0) / pixels**2 * rows / np.maximum(rows - 1, 1)
        self.means_dn.append(mean)
        self.row_variances_dn2.append(variance)


def colour_bias(means: ChannelMeans, black_level_dn: Sequence[float]) -> ColourBias:
    """Return mu_c: the mean of each channel over all frames minus its recorded black level.

    The standard error of the pooled mean is the frames' standard deviation over sqrt(n).

    Raises
    ------
    ArgumentError
        If there is not one black level per channel.
    DatasetError
        If no frame was added.
    """
    if not means.means_dn:
        raise DatasetError("no bias frames were given: take ten or more with the lens capped, at the shortest exposure")
    table = np.array(means.means_dn)
    frames, channels = table.shape
    bias = table - checked_black_level(black_level_dn, channels)
    scatter = bias.std(axis=0, ddof=1) / math.sqrt(frames) if frames > 1 else np.full(channels, math.nan)
    by_rows = np.sqrt(np.array(means.row_variances_dn2).sum(axis=0)) / frames
    return ColourBias(
        bias_dn=tuple(bias.mean(axis=0).tolist()),
        standard_error_dn=tuple(scatter.tolist()),
        row_error_dn=tuple(by_rows.tolist()),
        frame_bias_dn=bias,
        frames=frames,
    )
