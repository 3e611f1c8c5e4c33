"""The metrics as modules of torchmetrics, for validation while a network trains.

Importing this module needs torchmetrics, ``pip install 'eldata[torchmetrics]'``; nothing else of eldata does.
"""

from __future__ import annotations

import zlib
from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

import torch

from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.scores import mean
from eldata.integrations.protocol_scores import protocol_of_tensors, protocol_score
from eldata.metrics._images import check_data_range, check_threads, host_array
from eldata.metrics.image_score import psnr
from eldata.metrics.similarity import ssim

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from eldata.protocols import Protocol


class MissingTorchmetricsError(EldataError, ImportError):
    """The package torchmetrics is not installed."""


try:
    from torchmetrics import Metric
except ImportError as error:
    raise MissingTorchmetricsError(
        "eldata's metric modules need the package torchmetrics: pip install 'eldata[torchmetrics]'; the functions "
        "eldata.metrics.psnr, ssim and score work without it"
    ) from error


class _MeanOverImages(Metric):
    """What the modules share: the scores of each image are kept, and averaged as ``eldata evaluate`` does.

    A score is 8 bytes per image and column. All of them are gathered over processes, however many each has, and summed
    exactly, so neither the order of images nor how they were split over batches and processes changes a bit.
    """

    is_differentiable = False
    full_state_update = False
    columns: ClassVar[tuple[str, ...]]

    def __init__(self, definition: object, *, threads: int | None = None, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        check_threads(threads)
        self.threads = threads
        # A process without images takes part with an empty tensor of this type, which has to be that of the scores.
        self.set_dtype(torch.float64)
        for column in self.columns:
            self.add_state(column, default=[], dist_reduce_fx="cat")
        # A MetricCollection takes modules for one and the same if their states are equal after the first batch, which
        # those of two definitions may be by chance, as of perfect predictions.
        self.add_state("definition", torch.tensor(zlib.crc32(repr(definition).encode())), dist_reduce_fx="max")

    def update(self, preds: torch.Tensor, target: torch.Tensor) -> None:
        """Score images.

        Parameters
        ----------
        preds, target
            Predictions and references of one shape: a batch (B, C, h, w), or one image, (C, h, w) or (h, w). float16,
            bfloat16, float32 or float64, on any device; they are copied to the host.

        Raises
        ------
        ArgumentError
            If they are not images of floating-point numbers, are too small or differ in shape. Nothing is added then.
        """
        scores = [self._scores(prediction, reference) for prediction, reference in _pair_images(preds, target)]
        if not scores:
            return
        for column, values in zip(self.columns, zip(*scores, strict=True), strict=True):
            getattr(self, column).append(torch.tensor(values, dtype=torch.float64, device=self.device))

    @abstractmethod
    def _scores(self, prediction: torch.Tensor, reference: torch.Tensor) -> tuple[float, ...]:
        """Return the values of one image, one per column."""

    def _mean(self, column: str) -> torch.Tensor:
        """Average one column's values over all images so far, float64."""
        kept = getattr(self, column)  # one tensor once processes are joined, else a list
        parts = kept if isinstance(kept, list) else [kept]
        values = [value for part in parts for value in part.tolist()]
        return torch.tensor(mean(values), dtype=torch.float64, device=self.device)


class _OneScore(_MeanOverImages):
    """The mean of one function of two images and their data range."""

    higher_is_better = True
    measure: Callable[..., float]

    def __init__(self, *, data_range: float = 1.0, threads: int | None = None, **kwargs: Any) -> None:
        super().__init__(data_range, threads=threads, **kwargs)
        check_data_range(data_range)
        self.data_range = data_range

    def _scores(self, prediction: torch.Tensor, reference: torch.Tensor) -> tuple[float, ...]:
        """Compute the metric of one image."""
        images = host_array(prediction, "the prediction"), host_array(reference, "the reference")
        return (self.measure(*images, data_range=self.data_range, threads=self.threads),)

    def compute(self) -> torch.Tensor:
        """Return the mean, float64; nan before any image."""
        return self._mean(*self.columns)


class PSNR(_OneScore):
    """Peak signal-to-noise ratio in dB, mean over images: :func:`eldata.metrics.psnr`. Nothing is clipped.

    Parameters
    ----------
    data_range
        The difference between the largest and the smallest possible value.
    threads
        Number of threads, by default one per CPU; the result is the same for any number.
    **kwargs
        As for every ``torchmetrics.Metric``.

    Examples
    --------
    >>> import torch
    >>> from eldata.integrations.torchmetrics import PSNR
    >>> metric = PSNR()
    >>> metric.update(torch.full((2, 4, 64, 64), 0.51), torch.full((2, 4, 64, 64), 0.5))
    >>> round(float(metric.compute()), 3)
    40.0
    """

    columns = ("psnr_db",)
    measure = staticmethod(psnr)


class SSIM(_OneScore):
    """Structural similarity, mean over images: :func:`eldata.metrics.ssim`. Nothing is clipped.

    Parameters
    ----------
    data_range
        The difference between the largest and the smallest possible value.
    threads
        Number of threads, by default one per CPU; the result is the same for any number.
    **kwargs
        As for every ``torchmetrics.Metric``.
    """

    columns = ("ssim",)
    measure = staticmethod(ssim)


class ProtocolScore(_MeanOverImages):
    """PSNR and SSIM under a named protocol, means over images, as ``eldata evaluate`` prints them.

    Given the predictions and references that ``eldata evaluate`` would score, the numbers equal its own to the last
    bit. The references have to be normalised as the protocol says (its ``levels``; those of :class:`eldata.ELDDataset`
    and :class:`eldata.SIDDataset` are so for ``eld`` and ``sid``). They are clipped as it says here, and the region is
    cut out here, after the factor was found where the protocol finds it, so images are whole frames. Which images a
    number is over is the caller's choice: a paper's table has one per camera and factor.

    Parameters
    ----------
    protocol
        A name such as ``eld`` or ``sid-tpami``, the path of a TOML file, or a :class:`eldata.protocols.Protocol`.
    threads
        Number of threads, by default one per CPU; the result is the same for any number.
    **kwargs
        As for every ``torchmetrics.Metric``.

    Raises
    ------
    ArgumentError
        If no protocol has this name, or it is one of clips, or of rendered images, whose rendering a tensor does not
        carry.
    """

    higher_is_better = True
    columns = ("psnr_db", "ssim")

    def __init__(self, protocol: str | Protocol = "eld", *, threads: int | None = None, **kwargs: Any) -> None:
        chosen = protocol_of_tensors(protocol)
        super().__init__(chosen.digest, threads=threads, **kwargs)
        self.protocol = chosen

    def _scores(self, prediction: torch.Tensor, reference: torch.Tensor) -> tuple[float, ...]:
        """Compute an image's PSNR and SSIM under the protocol."""
        found = protocol_score(self.protocol, prediction, reference, threads=self.threads)
        return found.psnr_db, found.ssim

    def compute(self) -> dict[str, torch.Tensor]:
        """Return the means ``psnr_db`` and ``ssim``, float64; nan before any image."""
        return {column: self._mean(column) for column in self.columns}


def _pair_images(preds: torch.Tensor, target: torch.Tensor) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Pair the images of two batches (B, C, h, w), or two single images, of one shape."""
    for name, value in (("preds", preds), ("target", target)):
        if not isinstance(value, torch.Tensor):
            raise ArgumentError(f"{name} must be a torch tensor, not {type(value).__name__}")
    if preds.shape != target.shape:
        raise ArgumentError(f"preds and target differ in shape: {tuple(preds.shape)} against {tuple(target.shape)}")
    if preds.ndim not in {2, 3, 4}:
        raise ArgumentError(f"expected a batch (B, C, h, w) or one image (C, h, w), found shape {tuple(preds.shape)}")
    yield from zip(preds, target, strict=True) if preds.ndim == 4 else [(preds, target)]
