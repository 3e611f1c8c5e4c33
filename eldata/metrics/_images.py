"""What the metrics accept: one image as a numpy array or a torch tensor, cut into bands for the kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from eldata.base.arrays import is_tensor
from eldata.base.compiled import in_threads
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import torch

Array: TypeAlias = npt.NDArray[np.floating[Any]]
Image: TypeAlias = "Array | torch.Tensor"
Block: TypeAlias = npt.NDArray[np.float32] | npt.NDArray[np.float64]

Result = TypeVar("Result")

_FLOATS = ("float16", "bfloat16", "float32", "float64")
_BAND_ROWS = 256  # a smaller band repeats more of the margin, a larger one leaves threads idle
# Images of fewer values are done sooner than threads are started.
_LEAST_FOR_THREADS = 1 << 22  # for one plain pass, which memory bounds
_LEAST_FOR_THREADS_WINDOWED = 1 << 18


def host_array(image: Image, name: str) -> Array:
    """Convert an image to a numpy array; a tensor is detached, and copied only from another device.

    bfloat16, which numpy does not know, becomes float32.
    """
    if is_tensor(image):
        tensor: torch.Tensor = image  # type: ignore[assignment]
        if str(tensor.dtype) == "torch.bfloat16":
            tensor = tensor.detach().float()
        array: npt.NDArray[Any] = tensor.numpy(force=True)
    elif isinstance(image, np.ndarray):
        array = image
    else:
        raise ArgumentError(f"{name} must be a numpy array or a torch tensor, not {type(image).__name__}")
    _check_image(name, array.dtype.name, array.shape)
    return array


def _check_image(name: str, values: str, shape: tuple[int, ...], most_axes: int = 3) -> None:
    """Refuse what is not one image of floating-point numbers, or with a fourth axis a batch of them."""
    if "int" in values:
        raise ArgumentError(
            f"{name} holds integers ({values}): normalise it to floating point in [0, 1] first, "
            "for uint16 by dividing by 65535"
        )
    if values not in _FLOATS:
        raise ArgumentError(f"{name} must be {', '.join(_FLOATS[:-1])} or {_FLOATS[-1]}, not {values}")
    if len(shape) == 4 > most_axes:
        raise ArgumentError(
            f"{name} is a batch of shape {shape}: metrics take one image per call, so loop over the batch or index it"
        )
    if not 2 <= len(shape) <= most_axes:
        raise ArgumentError(f"{name} must be one image (C, h, w) or (h, w), not of shape {shape}")
    if 0 in shape:
        raise ArgumentError(f"{name} is empty: its shape is {shape}")


@dataclass(frozen=True, slots=True)
class Band:
    """Rows ``start`` to ``stop`` of one channel; the rows beyond ``owned`` belong to the next band too."""

    channel: int
    start: int
    stop: int
    owned: int


@dataclass(frozen=True, slots=True)
class Pair:
    """A prediction and its reference, both (C, h, w), not copied."""

    prediction: Array
    reference: Array
    dtype: type[np.float32 | np.float64]

    def bands(self, window: int = 1) -> list[Band]:
        """Cut the image into bands that together hold each ``window`` of rows once.

        The cut depends on the shape alone, and so do the sums, whatever the number of threads.
        """
        channels, height, _ = self.prediction.shape
        margin = window - 1
        windows = height - margin
        return [
            Band(channel, start, stop + margin, stop - start + (margin if stop == windows else 0))
            for channel in range(channels)
            for start, stop in _row_bands(windows)
        ]

    def over_bands(self, work: Callable[[Band], Result], threads: int | None, window: int = 1) -> list[Result]:
        """Compute ``work(band)`` of every band, in order."""
        least = _LEAST_FOR_THREADS if window == 1 else _LEAST_FOR_THREADS_WINDOWED
        return in_threads(work, self.bands(window), 1 if self.prediction.size < least else threads)

    def over_row_bands(self, work: Callable[[tuple[int, int]], Result], threads: int | None) -> list[Result]:
        """Compute ``work((start, stop))`` of bands of rows of all channels, in order."""
        bands = _row_bands(self.prediction.shape[1])
        return in_threads(work, bands, 1 if self.prediction.size < _LEAST_FOR_THREADS_WINDOWED else threads)

    def blocks(self, band: Band) -> tuple[Block, Block]:
        """Take the band's rows of both images, C-contiguous; they are copied only where they must be."""
        return self._take_rows(self.prediction, band), self._take_rows(self.reference, band)

    def _take_rows(self, image: Array, band: Band) -> Block:
        """Take a band's rows of one image, C-contiguous and read-only."""
        block = np.require(image[band.channel, band.start : band.stop], self.dtype, ("C", "A", "E"))
        block.flags.writeable = False  # always, so that numba compiles each kernel once per dtype
        return block


def _row_bands(rows: int) -> list[tuple[int, int]]:
    """Cut rows into bands of about the same height: their starts and stops."""
    count = -(-rows // _BAND_ROWS)
    return list(pairwise(rows * index // count for index in range(count + 1)))


def check_pair(prediction: Image, reference: Image, *, smallest: int = 1, data_range: float = math.inf) -> Pair:
    """Check both images and return them as a :class:`Pair`.

    Parameters
    ----------
    prediction, reference
        One image each, (C, h, w) or (h, w), of the same shape.
    smallest
        The least height and width that will do.
    data_range
        What values may differ by.

    Raises
    ------
    ArgumentError
        If an image is not one image of floating-point numbers, the shapes differ, or they are too small; or if the
        reference reaches beyond twice the data range, and so is on another scale.
    """
    p = host_array(prediction, "the prediction")
    g = host_array(reference, "the reference")
    _check_alike(p.shape, g.shape, smallest, float(g.max()), data_range)
    wide = max(p.dtype.itemsize, g.dtype.itemsize) > 4
    if p.ndim == 2:
        p, g = p[np.newaxis], g[np.newaxis]
    return Pair(p, g, np.float64 if wide else np.float32)


def check_tensors(
    prediction: Any, reference: Any, *, smallest: int = 1, data_range: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Check tensors as :func:`check_pair` does images, of which they may be batches, (N, C, h, w); return them as such.

    They are float64, on the device of the prediction; gradients flow through.
    """
    if not is_tensor(reference):
        raise ArgumentError(f"the prediction is a tensor, the reference {type(reference).__name__}: give both as such")
    for name, image in (("the prediction", prediction), ("the reference", reference)):
        _check_image(name, str(image.dtype).removeprefix("torch."), tuple(image.shape), most_axes=4)
    most = float(reference.detach().max())
    _check_alike(tuple(prediction.shape), tuple(reference.shape), smallest, most, data_range)
    p, g = prediction.double(), reference.double().to(prediction.device)
    return (p, g) if p.ndim > 2 else (p[None], g[None])


def _check_alike(p: tuple[int, ...], g: tuple[int, ...], smallest: int, most: float, data_range: float) -> None:
    """Refuse a prediction and a reference of unlike or small shapes, or on a scale that the reference leaves."""
    if p != g:
        raise ArgumentError(f"the prediction and the reference differ in shape: {p} against {g}")
    if min(p[-2:]) < smallest:
        raise ArgumentError(
            f"an image of shape {p} is too small: SSIM's window needs at least {smallest} x {smallest} pixels"
        )
    if 2 * data_range < most < math.inf:
        raise ArgumentError(
            f"the reference reaches {most:g}, and data_range is {data_range:g}: divide both images by their largest "
            "possible value, or give it as data_range"
        )


def check_threads(threads: int | None) -> None:
    """Raise :class:`ArgumentError` unless ``threads`` is None or at least 1."""
    if threads is not None and threads < 1:
        raise ArgumentError(f"threads must be at least 1, or None for every CPU, not {threads}")


def check_data_range(data_range: float) -> None:
    """Raise :class:`ArgumentError` unless ``data_range`` is positive and finite."""
    if not (data_range > 0 and math.isfinite(data_range)):
        raise ArgumentError(f"data_range must be positive and finite, not {data_range}")


def total(parts: Iterable[float]) -> float:
    """Add the bands' sums in their order; infinities and NaN pass through without a warning."""
    result = 0.0
    for part in parts:
        result += part
    return result


def totals(parts: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Add the first and the second sums, each by :func:`total`."""
    first, second = zip(*parts, strict=True)
    return total(first), total(second)
