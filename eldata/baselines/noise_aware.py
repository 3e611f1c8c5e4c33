"""A network that is told the noise, and so is trained once for all cameras, gains and factors."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import as_file, files
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.linalg import hadamard
from torch import nn

from eldata.base.files import sha256_of
from eldata.baselines.tiling import tiled
from eldata.baselines.unet import UNet, load_weights
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Values = NDArray[np.floating[Any]]

_WEIGHTS = "noise_aware.safetensors"
_TILE, _OVERLAP = 1024, 192  # packed pixels; a quarter of the overlap is as far as the network sees
_SOFT = 8.0  # standard deviations of noise up to which details are about linear
_REACH = 5  # of the mean that is taken off, in pixels of the halved image

# Orthonormal, so that white noise stays white: from R, G1, B, G2, brightness and three differences.
_COLOURS = (
    (0.5, 0.5, 0.5, 0.5),
    (0.5, -0.5, 0.5, -0.5),
    (0.5**0.5, 0.0, -(0.5**0.5), 0.0),
    (0.0, 0.5**0.5, 0.0, -(0.5**0.5)),
)


def stabilise(noisy: torch.Tensor, slope: torch.Tensor, offset: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the transform of images, 0 at black, and the root of the variance that it has there.

    Parameters
    ----------
    noisy
        (N, ...), negative values kept.
    slope, offset
        (N, 1, ...) of the line of each image's noise.
    """
    black = (0.375 * slope**2 + offset).sqrt()
    # The difference of two roots, as a quotient: no digits are lost where read noise rules, and the slope may be 0.
    return 2 * noisy / ((black**2 + slope * noisy.clamp(min=0)).sqrt() + black), black


def undo(values: torch.Tensor, slope: torch.Tensor, black: torch.Tensor) -> torch.Tensor:
    """Return the images whose transforms these are: of values below black a line, above it the root's square."""
    return values * black + 0.25 * slope * values.clamp(min=0) ** 2


class NoiseAwareUNet(nn.Module):
    """A U-Net from packed Bayer raw, and the line of its noise, to packed raw.

    The generalised Anscombe transformation makes of any camera's noise one of standard deviation 1. Above black it is
    that of M. Makitalo and A. Foi (2013), less what it makes of black; below black it goes on straight, since there is
    read noise alone, so that nothing of it is cut off. A :class:`~eldata.baselines.unet.UNet` at half the size sees
    2 x 2 pixels of the four colours as 16 orthonormal sums and differences, and two numbers of the noise, and returns
    what the transformed values are off by. The inverse is the algebraic one, which gives an untouched input back
    exactly. What an unbiased inverse would add, the network has learnt: its loss is in linear light, behind the
    inverse.

    Parameters
    ----------
    width, depth, seed
        As :class:`~eldata.baselines.unet.UNet` has them. At first the network returns its input.
    """

    def __init__(self, *, width: int = 46, depth: int = 2, seed: int = 0) -> None:
        super().__init__()
        self.network = UNet(16, inputs=22, width=width, depth=depth, seed=seed)
        nn.init.zeros_(self.network.last.weight)
        both = torch.kron(torch.tensor(_COLOURS), torch.from_numpy(hadamard(4, np.float32)) / 2)
        self.register_buffer("_matrix", both, persistent=False)

    @property
    def multiple(self) -> int:
        """What heights and widths are multiples of."""
        return 2 * self.network.multiple

    def forward(self, noisy: torch.Tensor, slope: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
        """Return estimates of clean images.

        Parameters
        ----------
        noisy
            (N, 4, h, w) float32, normalised and amplified, negative values kept.
        slope, offset
            (N,) of the line of each image's noise, variance = offset + slope x signal, of these units.
        """
        with torch.autocast(noisy.device.type, enabled=False):  # half precision is for the convolutions alone
            slope, offset = (one.float().reshape(-1, 1, 1, 1) for one in (slope, offset))
            values, black = stabilise(noisy, slope, offset)
            matrix: torch.Tensor = self._matrix  # type: ignore[assignment] # torch's stub
            parts = torch.einsum("ij,njhw->nihw", matrix, nn.functional.pixel_unshuffle(values, 2))
            white, _ = stabilise(torch.ones_like(slope), slope, offset)
            levels = parts[:, ::4]
            near = nn.functional.avg_pool2d(levels, _REACH, 1, _REACH // 2, count_include_pad=False)
            details = torch.cat([levels - near, parts[:, 1:4], parts[:, 5:8], parts[:, 9:12], parts[:, 13:]], dim=1)
            read = (offset / (offset + 0.1 * slope)).expand_as(levels[:, :1])
            known = torch.cat([levels / white, (white.log2() / 8).expand_as(read), read], dim=1)
            inputs = torch.cat([_SOFT * torch.asinh(details / _SOFT), known], dim=1)
        off = self.network(inputs)
        with torch.autocast(noisy.device.type, enabled=False):
            off = torch.einsum("ij,nihw->njhw", matrix, off.float())
            return undo(values - nn.functional.pixel_shuffle(off, 2), slope, black)


def remove_noise(image: Values, slope: float, offset: float, black: tuple[float, ...]) -> NDArray[np.float32]:
    """Return the estimate of the network that ships, on a GPU if torch sees one.

    Parameters
    ----------
    image
        (4, h, w), packed, normalised and amplified, negative values kept.
    slope, offset, black
        Of its noise (:class:`eldata.baselines.classical.SignalNoise`).

    Raises
    ------
    DatasetError
        If it has other channels than Bayer's four.
    FileError
        If the weights are not there or not its own: the installation is damaged.
    """
    if len(image) != len(_COLOURS):
        raise DatasetError(
            f"the network takes packed Bayer frames of 4 channels; found {len(image)}: take dct or anscombe-bm3d"
        )
    device = "cuda" if torch.cuda.is_available() else "cpu"
    network, (slopes, offsets) = _network(device), torch.tensor([[slope], [offset]], device=device)

    def run(part: NDArray[np.float32]) -> Values:
        with torch.inference_mode():
            made = network(torch.from_numpy(part)[None].to(device), slopes, offsets)
        return np.asarray(made[0].cpu().numpy())

    taken = image - np.array(black or (0.0,) * len(image))[:, None, None]
    return tiled(run, taken.astype(np.float32), tile=_TILE, overlap=_OVERLAP, multiple=network.multiple)


@lru_cache(maxsize=1)
def _network(device: str) -> NoiseAwareUNet:
    network = NoiseAwareUNet()
    load_weights(network, _WEIGHTS)
    return network.to(device).eval()


def weights_digest() -> str:
    """Return the hash of the weights that ship, which names them in ``predictions.json``."""
    with as_file(files("eldata.baselines") / _WEIGHTS) as path:
        return sha256_of(path)
