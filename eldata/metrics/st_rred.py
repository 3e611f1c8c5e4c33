"""ST-RRED: how much spatial and temporal information of a clip is lost or added.

Soundararajan and Bovik, "Video quality assessment by reduced reference spatio-temporal entropic differencing",
IEEE Transactions on Circuits and Systems for Video Technology 23 (2013). Where the paper leaves a choice, or the
authors' MATLAB release and its port ``skvideo.measure.strred`` (scikit-video 1.1.11) differ from it, this module
does as the port does, because published numbers, the ELD paper's among them, were made with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from eldata.base.arrays import is_tensor
from eldata.base.compiled import in_threads, kernel
from eldata.base.numbers import counted
from eldata.errors import ArgumentError
from eldata.metrics._images import Array, Image, check_data_range, check_threads, host_array

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch


Clip: TypeAlias = "Array | torch.Tensor"
Plane: TypeAlias = npt.NDArray[np.float64]

PEAK_8_BIT = 255.0
"""The scale of 8-bit video, for which the noise variance was chosen."""

PEAK_ELD = 1.0
"""The scale at which the released code of the ELD paper calls its implementation."""

_NOISE_VARIANCE = 0.1  # of the neural noise, at the scale that ``peak`` sets
_BLOCK = 3
_SMALLEST = 41  # an eighth of it, 6, gives more windows than a block has pixels
# Smaller eigenvalues are rounding: a band of a flat image keeps about 1e-15 of the image's size instead of nothing,
# and the eigenvalues of a matrix are known to about 1e-15 of its largest.
_LEAST_AMPLITUDE = 1e-12
_LEAST_EIGENVALUE = 1e-14

# The weights of scikit-video's rgb2gray. They add up to 0.9999.
_RGB_WEIGHTS = (0.2989, 0.5870, 0.1140)


@dataclass(frozen=True, slots=True)
class StRred:
    """The scores of every pair of frames, and the clip's, which are their means.

    All are zero for equal clips, and lower is better. An entry of each tuple belongs to one pair of frames:
    (0, 1), (2, 3) and so on.

    Attributes
    ----------
    spatial_pairs
        Mean over the blocks of the absolute difference of scaled entropies of the pair's first frame.
    temporal_pairs
        The same of the pair's frame difference.
    """

    spatial_pairs: tuple[float, ...]
    temporal_pairs: tuple[float, ...]

    @property
    def spatial(self) -> float:
        """SRRED: the mean of ``spatial_pairs``."""
        return fmean(self.spatial_pairs)

    @property
    def temporal(self) -> float:
        """TRRED: the mean of ``temporal_pairs``."""
        return fmean(self.temporal_pairs)

    @property
    def st_rred(self) -> float:
        """``spatial * temporal``, the score that papers print."""
        return self.spatial * self.temporal


def st_rred(
    prediction: Clip,
    reference: Clip,
    *,
    data_range: float = 1.0,
    peak: float = PEAK_8_BIT,
    threads: int | None = None,
) -> StRred:
    """Compute the spatio-temporal entropic differences of two clips.

    Let y be the band of the first frame of a pair that :func:`coarse_band` gives, and
    d the difference of the bands of both frames, each cut into blocks of 3 x 3. For the blocks b of either, with
    the eigenvalues L_k of the blocks' covariance K::

        s_b = b' K^-1 b / 9                                          local scale
        h_b = sum over k of (log2(s_b L_k + 0.1) + ln(2 pi e))       entropy of the block with neural noise
        spatial_b  = h_b(y) log2(1 + s_b(y))
        temporal_b = h_b(d) log2(1 + s_b(y)) log2(1 + s_b(d))

    A pair's scores are the means over the blocks of ``|spatial_b(prediction) - spatial_b(reference)|`` and of the
    same for ``temporal_b``. The score of a clip is the product of their means over the pairs. It is symmetric in
    its arguments.

    Choices of the widely used implementation, kept to the digit:

    - Frames are used in pairs, 0 with 1, 2 with 3: the step from 1 to 2 does not count, nor does the last frame of
      an odd number. It is not looked at.
    - The spatial part is of each pair's first frame alone. If those are equal, the product is zero whatever
      happened to the second: look at ``temporal`` too.
    - One band of the pyramid counts, at an eighth of the size, with mirrored edges.
    - K is the covariance over all overlapping windows of the band, divided by their number. The band is first
      cut to whole blocks at its right and lower edge. The mean is subtracted for K, not from the blocks in s_b.
    - The constant of the entropy is a natural logarithm beside base-2 ones, so entropies have no unit.
    - K is estimated for each frame and each difference, so s_b does not change when the frame or the difference
      is multiplied by a number. A difference of almost nothing, such as the rounding of a format, still has a
      scale of about 1 and does count; a difference of exactly nothing gives 0.

    One choice differs: where K is singular but not zero (a frame that is flat or changes in one direction alone),
    the implementation fails or divides by rounding errors. Here eigenvalues that are not above rounding,
    1e-14 of the largest or the square of 1e-12 of the largest pixel, count as zero and take no part, neither in
    K^-1 nor in the entropy.

    Parameters
    ----------
    prediction, reference
        One clip each, of the same shape: (T, H, W) grey or (T, C, h, w) with the channels that
        :func:`raw_to_grey` takes; T at least 2, each side at least 41. float16, bfloat16, float32 or float64,
        numpy array or torch tensor. Tensors on another device are copied to the host frame by frame. Nothing is
        clipped. All arithmetic is float64.
    data_range
        The difference between the largest and the smallest possible value.
    peak
        The scale at which the clips are compared: they are multiplied by ``peak / data_range``. The variance of
        the neural noise, 0.1, is fixed on this scale, so the score depends on it strongly:
        :data:`PEAK_8_BIT`, 255, is used by the paper and for 8-bit video; :data:`PEAK_ELD`, 1, is what the code
        released with the ELD paper does for raw clips. Scores at two scales do not compare.
    threads
        Number of threads, by default one per CPU; the result is the same to the bit for any number.

    Returns
    -------
    StRred
        The scores of every pair and of the clip.

    Raises
    ------
    ArgumentError
        If a clip is not one of floating-point numbers, the shapes differ, there are fewer than 2 frames, they are
        too small, a frame that counts holds NaN or infinity, or ``data_range`` or ``peak`` is not positive.
    """
    check_threads(threads)
    check_data_range(data_range)
    if not (peak > 0 and math.isfinite(peak)):
        raise ArgumentError(f"peak must be positive and finite, not {peak}")
    clips = ((prediction, "the prediction"), (reference, "the reference"))
    for clip, name in clips:
        _check_clip(clip, name)
    if tuple(prediction.shape) != tuple(reference.shape):
        raise ArgumentError(
            "the prediction and the reference differ in shape: "
            f"{tuple(prediction.shape)} against {tuple(reference.shape)}"
        )
    pairs = range(0, len(prediction) - 1, 2)

    def work(where: tuple[int, int]) -> _Band:
        clip, frame = where
        return _compute_band(clips[clip][0][frame], f"frame {frame} of {clips[clip][1]}", peak / data_range)

    # Of every frame only its band is kept, a 64th of its values.
    wanted = [(clip, frame) for first in pairs for clip in (0, 1) for frame in (first, first + 1)]
    bands = dict(zip(wanted, in_threads(work, wanted, threads), strict=True))
    scores = [
        _compare(*(_compute_information(bands[clip, first], bands[clip, first + 1]) for clip in (0, 1)))
        for first in pairs
    ]
    return StRred(*zip(*scores, strict=True))


def raw_to_grey(image: Image) -> Plane:
    """Reduce a raw frame to grey, as the released code of the ELD paper does for ST-RRED.

    ``0.2989 R + 0.5870 G + 0.1140 B``, the luma weights of 8-bit video as scikit-video rounds them (they add up to
    0.9999), on linear values without white balance; in packed Bayer G is the mean of G1 and G2. That is not the
    luminance of any camera, but the numbers in the paper were made with it.

    Parameters
    ----------
    image
        (C, h, w): packed Bayer R, G1, B, G2 (C = 4), linear RGB such as DRV's preprocessed frames (C = 3), or
        grey (C = 1); (h, w) is grey too. Any range.

    Returns
    -------
    Plane
        (h, w) float64, in units of the image.

    Raises
    ------
    ArgumentError
        If it is not one image of floating-point numbers, or for another number of channels: nobody has published
        a reduction of packed X-Trans.
    """
    array = host_array(image, "the image")
    if array.ndim == 2:
        array = array[np.newaxis]
    channels: list[Plane] = [channel.astype(np.float64) for channel in array]
    if len(channels) == 1:
        return channels[0]
    if len(channels) == 4:
        red, green_1, blue, green_2 = channels
        channels = [red, (green_1 + green_2) / 2, blue]
    if len(channels) != 3:
        raise ArgumentError(_describe_channels(f"the image of shape {array.shape}", len(channels)))
    grey = np.zeros_like(channels[0])
    for weight, channel in zip(_RGB_WEIGHTS, channels, strict=True):
        grey += weight * channel
    return grey


# The band of a frame or of a difference, and the size of the values it was made of, both at ``peak``.
_Band: TypeAlias = tuple[Plane, float]


def _compute_band(frame: Image, name: str, scale: float) -> _Band:
    """Compute a frame's band and largest absolute value, both times ``scale``; refuse NaN and infinity."""
    grey = raw_to_grey(frame)
    size = max(abs(float(grey.min())), abs(float(grey.max())))  # NaN comes through min and max
    if not math.isfinite(size):
        raise ArgumentError(f"{name} holds NaN or infinity")
    return coarse_band(grey) * scale, size * scale


def _compute_information(first: _Band, second: _Band) -> tuple[Plane, Plane]:
    """Compute the scaled entropies of each block of a pair of frames: spatial, temporal."""
    scale, entropy = _scale_and_entropy(*first)
    scale_of_difference, entropy_of_difference = _scale_and_entropy(first[0] - second[0], max(first[1], second[1]))
    weight = np.log2(1.0 + scale)
    return entropy * weight, entropy_of_difference * weight * np.log2(1.0 + scale_of_difference)


def _scale_and_entropy(values: Plane, size: float) -> tuple[Plane, Plane]:
    """Compute s and h of :func:`st_rred` for each block of a band."""
    rows, columns = (side // _BLOCK for side in values.shape)
    cut = values[: rows * _BLOCK, : columns * _BLOCK]
    windows = np.lib.stride_tricks.sliding_window_view(cut, (_BLOCK, _BLOCK)).reshape(-1, _BLOCK**2)
    blocks = cut.reshape(rows, _BLOCK, columns, _BLOCK).swapaxes(1, 2).reshape(-1, _BLOCK**2)
    centred = windows - windows.mean(axis=0)
    # einsum and not @: BLAS may split the sum by its own number of threads.
    eigenvalues, vectors = np.linalg.eigh(np.einsum("ni,nj->ij", centred, centred) / len(windows))
    counts = eigenvalues > max((_LEAST_AMPLITUDE * size) ** 2, _LEAST_EIGENVALUE * eigenvalues[-1])
    eigenvalues, vectors = eigenvalues[counts], vectors[:, counts]
    scale = np.sum(np.einsum("ni,ik->nk", blocks, vectors) ** 2 / eigenvalues, axis=1) / _BLOCK**2
    entropies = np.log2(scale[:, np.newaxis] * eigenvalues + _NOISE_VARIANCE) + math.log(2.0 * math.pi * math.e)
    return scale, entropies.sum(axis=1)


def _compare(prediction: tuple[Plane, Plane], reference: tuple[Plane, Plane]) -> tuple[float, float]:
    """Compute a pair's scores in the order of :class:`StRred`."""
    spatial, temporal = (float(np.mean(np.abs(p - g))) for p, g in zip(prediction, reference, strict=True))
    return spatial, temporal


def _check_clip(clip: Clip, name: str) -> None:
    """Refuse anything but a clip (T, H, W) or (T, C, h, w) of two or more frames that are large enough."""
    if not (is_tensor(clip) or isinstance(clip, np.ndarray)):
        raise ArgumentError(f"{name} must be a numpy array or a torch tensor, not {type(clip).__name__}")
    shape = tuple(clip.shape)
    if len(shape) not in {3, 4}:
        raise ArgumentError(f"{name} must be one clip (T, H, W) or (T, C, h, w), not of shape {shape}")
    if shape[0] < 2:
        raise ArgumentError(
            f"{name} has {counted(shape[0], 'frame')}, of shape {shape}: ST-RRED compares frames in pairs"
        )
    if len(shape) == 4 and shape[1] not in {1, 3, 4}:
        raise ArgumentError(_describe_channels(f"{name} of shape {shape}", shape[1]))
    if min(shape[-2:]) < _SMALLEST:
        raise ArgumentError(
            f"{name} of shape {shape} is too small: ST-RRED works at an eighth of the size and needs at least "
            f"{_SMALLEST} x {_SMALLEST} pixels"
        )
    host_array(clip[0], name)  # speaks of the clip, where a frame's own check would speak of an image


def _describe_channels(what: str, channels: int) -> str:
    """Say which numbers of channels can be reduced to grey, for an error."""
    return (
        f"{what} has {channels} channels: reduced to grey are packed Bayer R, G1, B, G2 (4), RGB (3) and grey (1); "
        "for others pass a grey clip (T, H, W) of your own making"
    )


# --- one band of the steerable pyramid --------------------------------------------------------------------------------

# The pyramid of Simoncelli and Freeman ("The steerable pyramid", ICIP 1995) with the six-orientation filters that
# Karasaridis and Simoncelli designed ("A filter design technique for steerable pyramid image transforms",
# ICASSP 1996). The taps are data published with matlabPyrTools as ``sp5Filters``. A whole pyramid has six bands at
# each of its levels; ST-RRED reads one, so only what leads there is computed.
#
# A whole-sample mirrored image stays so under a filter that is symmetric itself, so the first two filters, both at
# full resolution, are applied as one. The halvings must stay apart: an even number of rows is no longer mirrored
# about its last row once every other row is gone.

_HALVINGS = 3  # how often the image is halved before the band is taken


def _complete_filter(quadrant: Sequence[Sequence[float]]) -> Plane:
    """Complete a filter from its lower right quadrant, the centre included."""
    taps = np.asarray(quadrant)
    radius = len(taps) - 1
    return np.pad(taps, ((radius, 0), (radius, 0)), "reflect")


_FIRST_LOW_PASS = _complete_filter(
    [
        [0.40304148, 0.15925570, -0.03848215],
        [0.15925570, 0.05586982, -0.01551246],
        [-0.03848215, -0.01551246, 0.00341614],
    ]
)
# Twice the taps of a low pass that keeps the mean: each halving doubles the signal, as the published filter does.
_LOW_PASS = 2.0 * _complete_filter(
    [
        [0.10096540, 0.08169618, 0.03981393, 0.01002988, -0.00962054],
        [0.08169618, 0.06426333, 0.03277038, 0.00410600, -0.00944432],
        [0.03981393, 0.03277038, 0.01396746, -0.00661117, -0.00387812],
        [0.01002988, 0.00410600, -0.00661117, -0.00523281, -0.00244917],
        [-0.00962054, -0.00944432, -0.00387812, -0.00244917, 0.00085404],
    ]
)
_BOTH_LOW_PASSES = ndimage.convolve(np.pad(_LOW_PASS, len(_FIRST_LOW_PASS) // 2), _FIRST_LOW_PASS, mode="constant")
_LOWER_BAND = np.pad(  # odd down the rows, even along the columns
    [
        [-0.11732297, -0.08226445, -0.03075356, -0.01021852],
        [0.02755155, 0.01189859, -0.00893064, -0.00986904],
        [0.01455399, 0.01026699, 0.00496194, 0.00277643],
    ],
    ((0, 0), (3, 0)),
    "reflect",
)
_BAND = np.concatenate([-_LOWER_BAND[::-1], np.zeros((1, 7)), _LOWER_BAND])


def coarse_band(image: Plane) -> Plane:
    """Compute the band of the fourth level that answers to what changes down the rows, at an eighth of the size.

    It is the fourth of the six orientations in matlabPyrTools and pyrtools, and the first in scikit-video, which
    reads the same taps in transposed order.

    Parameters
    ----------
    image
        (H, W), at least 41 x 41; any range. Other sizes than multiples of 8 are halved to the larger half.

    Returns
    -------
    Plane
        (h, w) with h = ceil(H / 8) and w = ceil(W / 8), in units of the image. Level 0 is the high-pass
        residue and level 1 the oriented bands at full size, each later level half of the one before. Edges are
        mirrored without repeating the edge pixel.
    """
    plane = _halve(image, _BOTH_LOW_PASSES)
    for _ in range(_HALVINGS - 1):
        plane = _halve(plane, _LOW_PASS)
    return ndimage.correlate(plane, _BAND, mode="mirror")


def _halve(image: Plane, taps: Plane) -> Plane:
    """Filter, then keep every other row and column, from the first."""
    radius = len(taps) // 2
    padded = np.pad(image, radius, "reflect")
    # Apart, the columns that meet one tap lie side by side, which SIMD needs.
    even = np.ascontiguousarray(padded[:, 0::2])
    odd = np.ascontiguousarray(padded[:, 1::2])
    rows, columns = image.shape
    out = np.zeros(((rows + 1) // 2, (columns + 1) // 2))
    _filter_every_other(even, odd, taps, out)
    return out


@kernel
def _filter_every_other(even: Plane, odd: Plane, taps: Plane, out: Plane) -> None:
    """Add to ``out`` the filtered image at every other row and column.

    ``even`` and ``odd`` hold the columns of the padded image. Symmetric taps share their product, first between
    two rows, then between two columns.
    """
    size = taps.shape[0]
    radius = size // 2
    rows, columns = out.shape
    folded = np.empty((2, even.shape[1]))
    for row in range(rows):
        total = out[row]
        for a in range(radius + 1):
            for parity in range(2):
                source = odd if parity else even
                fold = folded[parity]
                upper = source[2 * row + a]
                lower = source[2 * row + size - 1 - a]
                if a < radius:
                    for j in range(upper.size):
                        fold[j] = upper[j] + lower[j]
                else:
                    for j in range(upper.size):
                        fold[j] = upper[j]
            for b in range(radius):
                fold = folded[b % 2]
                left = fold[b // 2 : b // 2 + columns]
                right = fold[(size - 1 - b) // 2 : (size - 1 - b) // 2 + columns]
                tap = taps[a, b]
                for j in range(columns):
                    total[j] += tap * (left[j] + right[j])
            middle = folded[radius % 2][radius // 2 : radius // 2 + columns]
            tap = taps[a, radius]
            for j in range(columns):
                total[j] += tap * middle[j]
