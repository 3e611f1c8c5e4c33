"""LPIPS: how far two sRGB images lie apart in the features of AlexNet, by weights from files that the user names.

R. Zhang, P. Isola, A. A. Efros, E. Shechtman and O. Wang, "The Unreasonable Effectiveness of Deep Features as a
Perceptual Metric", CVPR 2018, version 0.1 with AlexNet, as the authors' package ``lpips`` 0.1.4 computes it. The
weights are not part of this package and nothing downloads them: docs/metrics.md says where they are and under which
terms.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from eldata.base.files import file_problem, sha256_of
from eldata.base.numbers import counted
from eldata.errors import ArgumentError, FileError
from eldata.metrics._images import pair

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import torch

    from eldata.metrics._images import Array, Image


@dataclass(frozen=True, slots=True)
class WeightFile:
    """A file of weights as its authors publish it.

    Attributes
    ----------
    name, size_bytes, sha256
        Its name, its size and ``sha256:<hex>`` of its bytes.
    what, source
        What it holds, and where it is published.
    """

    name: str
    size_bytes: int
    sha256: str
    what: str
    source: str


BACKBONE_FILE: Final = WeightFile(
    name="alexnet-owt-7be5be79.pth",
    size_bytes=244_408_911,
    sha256="sha256:7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02",
    what="torchvision's AlexNet",
    source="https://download.pytorch.org/models/alexnet-owt-7be5be79.pth",
)
LINEAR_FILE: Final = WeightFile(
    name="alex.pth",
    size_bytes=6_009,
    sha256="sha256:df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
    what="the linear layers of LPIPS 0.1 for AlexNet",
    source="lpips/weights/v0.1/alex.pth of the package lpips 0.1.4",
)


@dataclass(frozen=True, slots=True)
class _Convolution:
    """A convolution of AlexNet, after which its features are compared; ``pooled``: maximum pooling comes before."""

    key: str
    shape: tuple[int, int, int, int]
    stride: int
    padding: int
    pooled: bool


_CONVOLUTIONS = (
    _Convolution("features.0", (64, 3, 11, 11), 4, 2, pooled=False),
    _Convolution("features.3", (192, 64, 5, 5), 1, 2, pooled=True),
    _Convolution("features.6", (384, 192, 3, 3), 1, 1, pooled=True),
    _Convolution("features.8", (256, 384, 3, 3), 1, 1, pooled=False),
    _Convolution("features.10", (256, 256, 3, 3), 1, 1, pooled=False),
)
_LINEAR = tuple(f"lin{index}.model.1.weight" for index in range(len(_CONVOLUTIONS)))
_POOL, _POOL_STRIDE = 3, 2
_SMALLEST = 31  # a smaller image leaves no pixel for the third convolution
# The mean and the deviation of ImageNet's colours, for values in [-1, 1].
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
_EPSILON = 1e-10  # the length of a pixel's features may be 0


@dataclass(frozen=True, slots=True, eq=False)
class LpipsWeights:
    """The weights of LPIPS with AlexNet, float32 on the host.

    Attributes
    ----------
    convolutions
        Kernel and bias of each of the five convolutions.
    linear
        The weight of each channel of each convolution, (C,).
    """

    convolutions: tuple[tuple[torch.Tensor, torch.Tensor], ...]
    linear: tuple[torch.Tensor, ...]

    @classmethod
    def load(cls, folder: Path | str) -> LpipsWeights:
        """Load the weights from a folder that holds both files as they are published.

        Parameters
        ----------
        folder
            Holds :data:`BACKBONE_FILE` and :data:`LINEAR_FILE` under their own names. Each has to be the published file
            to the byte: the linear layers of version 0.0 have the same names and shapes, and give other numbers.

        Raises
        ------
        FileError
            If a file is missing, cannot be read, or is not the published one; nothing of it is loaded then.
        """
        backbone, linear = (_content(Path(folder), file) for file in (BACKBONE_FILE, LINEAR_FILE))
        return cls.of(backbone, linear)

    @classmethod
    def of(cls, backbone: Mapping[str, torch.Tensor], linear: Mapping[str, torch.Tensor]) -> LpipsWeights:
        """Return the weights of two state dictionaries.

        Parameters
        ----------
        backbone
            Of torchvision's AlexNet: ``features.0.weight`` and so on. What comes after the last features that are
            compared is not looked at.
        linear
            Of the linear layers: ``lin0.model.1.weight`` (1, 64, 1, 1) and so on.

        Raises
        ------
        ArgumentError
            If a tensor is missing, or is not one of finite float32 numbers of its shape.
        """
        return cls(
            convolutions=tuple(
                (
                    _tensor(backbone, f"{layer.key}.weight", layer.shape, BACKBONE_FILE.what),
                    _tensor(backbone, f"{layer.key}.bias", layer.shape[:1], BACKBONE_FILE.what),
                )
                for layer in _CONVOLUTIONS
            ),
            linear=tuple(
                _tensor(linear, key, (1, layer.shape[0], 1, 1), LINEAR_FILE.what).flatten()
                for key, layer in zip(_LINEAR, _CONVOLUTIONS, strict=True)
            ),
        )


def lpips(prediction: Image, reference: Image, weights: LpipsWeights) -> float:
    """Return the learned perceptual image patch similarity of two sRGB images; lower is better.

    For the features F of each of AlexNet's five convolutions after its ReLU, (C, h, w), divided at each pixel by their
    length, and the weights w of the channels::

        LPIPS = sum over the layers of mean over the pixels of sum_c w_c (F_c(prediction) - F_c(reference))^2

    The images enter as ``(2 x - 1 - shift) / scale`` with the published shift and scale of each colour. The arithmetic
    is float32, as published, on one thread, so that it does not depend on their number; another machine may differ by
    about 1e-6 of the value. The means over pixels are float64.

    Parameters
    ----------
    prediction, reference
        One image each, (3, h, w) in the order R, G, B, sRGB in [0, 1], of the same shape and at least 31 x 31: float16,
        bfloat16, float32 or float64, numpy array or torch tensor. Tensors on another device are copied to the host.
    weights
        Of :meth:`LpipsWeights.load`.

    Returns
    -------
    float
        0 for identical images.

    Raises
    ------
    ArgumentError
        If an image is not one RGB image of floating-point numbers in [0, 1], is too small, or the shapes differ.
    """
    images = pair(prediction, reference)
    channels, height, width = images.prediction.shape
    if channels != 3:
        raise ArgumentError(
            f"LPIPS is defined on sRGB images (3, h, w); found {counted(channels, 'channel')}: render "
            "raw images first (docs/srgb.md)"
        )
    if min(height, width) < _SMALLEST:
        raise ArgumentError(
            f"an image of {height} x {width} pixels is too small: LPIPS needs at least {_SMALLEST} x {_SMALLEST}"
        )
    for image, name in ((images.prediction, "the prediction"), (images.reference, "the reference")):
        _check_range(image, name)

    import torch
    from torch.nn.functional import conv2d, max_pool2d

    distance = 0.0
    with torch.no_grad(), _one_thread():
        ours, theirs = _scaled(images.prediction), _scaled(images.reference)
        for layer, (kernel, bias), channel_weights in zip(
            _CONVOLUTIONS, weights.convolutions, weights.linear, strict=True
        ):
            if layer.pooled:
                ours, theirs = (max_pool2d(features, _POOL, _POOL_STRIDE) for features in (ours, theirs))
            ours, theirs = (
                conv2d(features, kernel, bias, stride=layer.stride, padding=layer.padding).relu_()
                for features in (ours, theirs)
            )
            squares = _of_unit_length(ours).sub_(_of_unit_length(theirs)).square_()
            distance += (channel_weights @ squares[0].flatten(1)).mean(dtype=torch.float64).item()
    return distance


def _check_range(image: Array, name: str) -> None:
    low, high = float(image.min()), float(image.max())  # NaN comes through min and max
    if not (low >= 0.0 and high <= 1.0):
        raise ArgumentError(
            f"LPIPS is defined on sRGB images in [0, 1]; {name} holds {low:.4g} to {high:.4g}: clip or scale it"
        )


def _scaled(image: Array) -> torch.Tensor:
    """Return an image (3, h, w) as AlexNet takes it, (1, 3, h, w) float32."""
    import torch

    values = torch.from_numpy(np.array(image, np.float32, order="C"))
    shift, scale = (torch.tensor(of_colours)[:, None, None] for of_colours in (_SHIFT, _SCALE))
    return values.mul_(2.0).sub_(1.0).sub_(shift).div_(scale)[None]


def _of_unit_length(features: torch.Tensor) -> torch.Tensor:
    """Return features (1, C, h, w), divided at each pixel by their length."""
    return features / features.square().sum(dim=1, keepdim=True).sqrt_().add_(_EPSILON)


_entering = threading.Lock()
_threads_before: list[int] = []


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let torch compute on one thread; sums that several share depend on how they share them.

    torch's number of threads is the process's and, with OpenMP, each thread's own. Several threads may be in here at
    once: each sets its own, and sets what the first one found when it leaves.
    """
    import torch

    with _entering:
        # To ask comes first: a thread's first question is what makes torch set that thread's number to the process's.
        number = torch.get_num_threads()
        _threads_before.append(_threads_before[0] if _threads_before else number)
        torch.set_num_threads(1)
    try:
        yield
    finally:
        with _entering:
            torch.set_num_threads(_threads_before.pop())


# --- files of weights -------------------------------------------------------------------------------------------------


def _content(folder: Path, file: WeightFile) -> dict[str, torch.Tensor]:
    """Return what a file holds, once its bytes are found to be the published ones."""
    import torch

    path = folder / file.name
    problem = file_problem(path)
    if problem is not None:
        raise FileError(path, f"{problem}; expected {file.what}, from {file.source}")
    advice = f"copy it again from {file.source}"
    size_bytes = path.stat().st_size
    if size_bytes != file.size_bytes:
        raise FileError(path, f"expected {file.what}, {file.size_bytes} bytes; found {size_bytes} bytes: {advice}")
    digest = sha256_of(path)
    if digest != file.sha256:
        raise FileError(path, f"expected {file.what}, {file.sha256}; found {digest}: {advice}")
    content: dict[str, torch.Tensor] = torch.load(path, map_location="cpu", weights_only=True)
    return content


def _tensor(state: Mapping[str, Any], key: str, shape: tuple[int, ...], what: str) -> torch.Tensor:
    import torch

    if key not in state:
        raise ArgumentError(f"the state dictionary of {what} lacks {key!r}; it has {', '.join(list(state)[:4])}, ...")
    tensor = state[key]
    if not isinstance(tensor, torch.Tensor) or tensor.dtype != torch.float32 or tuple(tensor.shape) != shape:
        found = f"{tensor.dtype} {tuple(tensor.shape)}" if isinstance(tensor, torch.Tensor) else type(tensor).__name__
        raise ArgumentError(f"{key} of {what}: expected float32 of shape {shape}, found {found}")
    if not tensor.isfinite().all():
        raise ArgumentError(f"{key} of {what} holds NaN or infinities")
    return tensor.detach().cpu()
