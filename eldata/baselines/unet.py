"""The paper's U-Net, from packed raw to packed raw, of frames or of clips; and the network that ships."""

from __future__ import annotations

import math
from functools import lru_cache
from importlib.resources import as_file, files
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from scipy.fft import dct
from scipy.linalg import hadamard
from torch import nn

from eldata.base.files import sha256_of
from eldata.base.seeds import checked_seed, purpose_sequence
from eldata.errors import ArgumentError, DatasetError, FileError

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Values = NDArray[np.floating[Any]]

LEAK = 0.2  # slope of the leaky ReLUs below 0
_DRAWN = 6  # keeps these random numbers apart from those of items, order, workers and turns


class UNet(nn.Module):
    """The U-Net of C. Chen et al. (CVPR 2018), which K. Wei et al. (TPAMI 2021) train from raw to raw.

    Two 3 x 3 convolutions a level, 2 x 2 maxima down, 2 x 2 transposed convolutions up, leaky ReLUs of slope 0.2, and a
    1 x 1 convolution at the end; no normalisation layers. It predicts the clean image itself. With the published width
    32 and depth 4 it has 7.8 million parameters.

    Parameters
    ----------
    channels
        Of the packed input and output: 4 for Bayer, 9 for X-Trans.
    width
        Channels of the first level; each level has twice those of the one above.
    depth
        How often the image is halved: heights and widths are multiples of 2^depth (:attr:`multiple`).
    seed
        Of the first weights.
    inputs
        Channels of the input, where it has others than the output.
    frames
        Of a clip that it takes to predict the middle one: an odd number. It sees them as channels.

    Raises
    ------
    ArgumentError
        If a number is out of its range.

    Examples
    --------
    >>> import torch
    >>> from eldata.baselines import UNet
    >>> UNet(4, width=8, depth=2, seed=0)(torch.zeros(1, 4, 32, 32)).shape
    torch.Size([1, 4, 32, 32])
    """

    def __init__(
        self, channels: int = 4, *,
        width: int = 32, depth: int = 4, seed: int = 0, inputs: int | None = None, frames: int = 1,
    ) -> None:  # fmt: skip
        super().__init__()
        taken = frames * (channels if inputs is None else inputs)
        if min(channels, width, taken) < 1 or depth < 0 or frames % 2 == 0:
            raise ArgumentError(
                "channels and width are 1 or more, depth is 0 or more, frames are odd; found "
                f"{channels}, {width}, {depth}, {frames}"
            )
        self.channels, self.width, self.depth, self.window = channels, width, depth, frames
        widths = [width << level for level in range(depth + 1)]
        self.down = nn.ModuleList(
            _make_convolutions(before, after)
            for before, after in zip([taken, *widths], widths)  # noqa: B905
        )
        self.up = nn.ModuleList(nn.ConvTranspose2d(2 * one, one, 2, stride=2) for one in widths[-2::-1])
        self.merge = nn.ModuleList(_make_convolutions(2 * one, one) for one in widths[-2::-1])
        self.last = nn.Conv2d(width, channels, 1)
        draw_weights(self, seed, last=(self.last,))

    @property
    def multiple(self) -> int:
        """Number by which height and width must be divisible."""
        return 1 << self.depth

    def forward(self, noisy: torch.Tensor) -> torch.Tensor:
        """Return an estimate of the clean images, (N, C, h, w) float32, of noisy ones or of windows (N, T, C, h, w)."""
        features, above = noisy.flatten(1, 2) if self.window > 1 else noisy, []
        for level, convolutions in enumerate(self.down):
            if level:
                features = nn.functional.max_pool2d(features, 2)
            features = convolutions(features)
            above.append(features)
        above.pop()
        for enlarge, convolutions in zip(self.up, self.merge, strict=True):
            features = convolutions(torch.cat([enlarge(features), above.pop()], dim=1))
        clean: torch.Tensor = self.last(features)
        return clean


def draw_weights(network: nn.Module, seed: int, *, last: Collection[nn.Module] = ()) -> None:
    """Draw the first weights: He's, so that features keep their size from layer to layer; ``last`` have no ReLU."""
    numbers = purpose_sequence(checked_seed(seed), 0, _DRAWN).generate_state(1, "uint64")
    generator = torch.Generator().manual_seed(int(numbers[0] >> 1))
    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            # What adds up in one output value: of a transposed convolution, whose steps do not overlap, one tap.
            taps = layer.in_channels * (math.prod(layer.kernel_size) if isinstance(layer, nn.Conv2d) else 1)
            gain = 1.0 if layer in last or isinstance(layer, nn.ConvTranspose2d) else 2 / (1 + LEAK**2)
            with torch.no_grad():
                layer.weight.normal_(0.0, math.sqrt(gain / taps), generator=generator)
                if layer.bias is not None:
                    layer.bias.zero_()


def _make_convolutions(before: int, after: int) -> nn.Sequential:
    """Make two 3 x 3 convolutions, each with a leaky ReLU."""
    return nn.Sequential(
        nn.Conv2d(before, after, 3, padding=1),
        nn.LeakyReLU(LEAK),
        nn.Conv2d(after, after, 3, padding=1),
        nn.LeakyReLU(LEAK),
    )


# --- weights that ship ------------------------------------------------------------------------------------------------


def load_weights(network: nn.Module, name: str) -> None:
    """Give a network the weights of a file that ships.

    Raises
    ------
    FileError
        If they are not there or not its own: the installation is damaged.
    """
    with as_file(files("eldata.baselines") / name) as path:
        try:
            network.load_state_dict(load_file(path))
        except Exception as error:  # safetensors and torch raise what their parts raise
            raise FileError(path, f"is not what was shipped; install eldata again ({type(error).__name__})") from error


def save_weights(network: nn.Module, path: Path) -> None:
    """Write a network's weights in half precision, as they ship: half of the size, and rounded by 5e-4 of each."""
    save_file({name: value.half().contiguous() for name, value in network.state_dict().items()}, path)


# --- a network that is told the noise, and so is trained once for all cameras, gains and factors ----------------------

_NOISE_AWARE = "noise_aware.safetensors"
_ROOT = 0.5**0.5
# Orthonormal, so that white noise stays white: from R, G1, B, G2, brightness and three differences.
_COLOURS = ((0.5, 0.5, 0.5, 0.5), (0.5, -0.5, 0.5, -0.5), (_ROOT, 0.0, -_ROOT, 0.0), (0.0, _ROOT, 0.0, -_ROOT))
_SOFT = 8.0  # standard deviations of noise up to which details are about linear
_REACH = 5  # of the mean that is taken off, in pixels of the halved image
_WINDOW, _THRESHOLD = 8, 2.7  # of the DCT, as the baseline of this name has them
_TOGETHER = 16_384  # windows whose coefficients stay in a processor's cache


def stabilise(noisy: torch.Tensor, slope: torch.Tensor, offset: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Transform images to noise of standard deviation 1, 0 at black; return also the root of the variance there.

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
    """Transform stabilised values back: a line below black, a square above it."""
    return values * black + 0.25 * slope * values.clamp(min=0) ** 2


class NoiseAwareUNet(nn.Module):
    """A U-Net from packed Bayer raw, and the line of its noise, to packed raw.

    The generalised Anscombe transformation makes of any camera's noise one of standard deviation 1. Above black it is
    that of M. Makitalo and A. Foi (2013), less what it makes of black; below black it goes on straight, since there is
    read noise alone, so that nothing of it is cut off. A U-Net of residual blocks (as K. Zhang et al., TPAMI 2021, have
    it) sees at half the size 2 x 2 pixels of the four colours as 16 orthonormal sums and differences, beside them what
    thresholding the DCT takes off (:func:`threshold`), and two numbers of the noise. It returns what the transformed
    values are off by, and for each of the 16 how much of the DCT's estimate stands instead of its own: the less noise,
    the more. The inverse is the algebraic one, which gives an untouched input back exactly. What an unbiased inverse
    would add is learnt: the loss is in linear light, behind the inverse.

    Parameters
    ----------
    widths
        Channels of its levels, each of half the size of the one above.
    blocks
        Residual blocks of each level, and again on the way up.
    seed
        Of the first weights, with which it takes off half of what the DCT does.
    """

    def __init__(
        self, *, widths: Sequence[int] = (64, 96, 104), blocks: Sequence[int] = (2, 1, 1), seed: int = 0
    ) -> None:
        super().__init__()
        self.multiple = 2 ** len(widths)
        self.first = nn.Conv2d(38, widths[0], 3, padding=1)
        self.blocks = nn.ModuleList(_make_blocks(width, count) for width, count in zip(widths, blocks, strict=True))
        self.halved = nn.ModuleList(nn.Conv2d(wide, deep, 2, stride=2) for wide, deep in pairwise(widths))
        self.doubled = nn.ModuleList(nn.ConvTranspose2d(deep, wide, 2, stride=2) for wide, deep in pairwise(widths))
        self.blocks_up = nn.ModuleList(
            _make_blocks(width, count) for width, count in zip(widths[:-1], blocks[:-1], strict=True)
        )
        self.last = nn.Conv2d(widths[0], 32, 3, padding=1)
        draw_weights(self, seed)
        for last in (self.last, *(block.second for block in self.modules() if isinstance(block, _Block))):
            nn.init.zeros_(last.weight)
        halves = torch.kron(torch.eye(4), torch.from_numpy(hadamard(4, np.float32)) / 2)
        self.register_buffer("_colours", torch.tensor(_COLOURS), persistent=False)
        self.register_buffer("_halves", halves, persistent=False)

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
            planes = torch.einsum("ij,njhw->nihw", self._colours, values)
            parts, beyond = map(self._halve, (planes, planes - threshold(planes)))
            white, _ = stabilise(torch.ones_like(slope), slope, offset)
            levels = parts[:, ::4]
            near = nn.functional.avg_pool2d(levels, _REACH, 1, _REACH // 2, count_include_pad=False)
            details = torch.cat([levels - near, parts[:, 1:4], parts[:, 5:8], parts[:, 9:12], parts[:, 13:]], dim=1)
            read = (offset / (offset + 0.1 * slope)).expand_as(levels[:, :1])
            known = torch.cat([levels / white, (white.log2() / 8).expand_as(read), read], dim=1)
            inputs = torch.cat([_SOFT * torch.asinh(details / _SOFT), known, beyond], dim=1)
        off, share = self._estimate_noise(inputs).float().chunk(2, dim=1)
        with torch.autocast(noisy.device.type, enabled=False):
            off = torch.einsum("ij,njhw->nihw", self._halves, off.lerp(beyond, share.sigmoid()))
            planes = planes - nn.functional.pixel_shuffle(off, 2)
            return undo(torch.einsum("ij,nihw->njhw", self._colours, planes), slope, black)

    def _halve(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the sums and differences of 2 x 2 pixels of planes (N, 4, h, w), (N, 16, h / 2, w / 2)."""
        return torch.einsum("ij,njhw->nihw", self._halves, nn.functional.pixel_unshuffle(planes, 2))

    def _estimate_noise(self, inputs: torch.Tensor) -> torch.Tensor:
        """Estimate the noise as sums and differences, and the DCT's share before its sigmoid, (N, 32, h, w)."""
        x, above = self.first(inputs), []
        for blocks, halve in zip(self.blocks, self.halved, strict=False):
            above.append(blocks(x))
            x = halve(above[-1])
        x = self.blocks[-1](x)
        for blocks, double in zip(reversed(self.blocks_up), reversed(self.doubled), strict=True):
            x = blocks(above.pop() + double(x))
        off: torch.Tensor = self.last(x)
        return off


def threshold(planes: torch.Tensor) -> torch.Tensor:
    """Denoise planes whose noise has standard deviation 1 by the DCT of all 8 x 8 windows (G. Yu and G. Sapiro, 2011).

    Coefficients of up to 2.7 but the mean go to zero; windows of which fewer are left weigh more.

    Parameters
    ----------
    planes
        (N, C, h, w), of 8 pixels a side or more.
    """
    waves = torch.from_numpy(dct(np.eye(_WINDOW, dtype=np.float32), axis=0, norm="ortho")).to(planes.device)
    down, across = waves[:, None, :, None], waves[:, None, None, :].repeat(_WINDOW, 1, 1, 1)
    total, weights = (planes.new_zeros(planes.shape) for _ in range(2))
    height, width = planes.shape[2:]
    rows, border = max(1, _TOGETHER // width), (_WINDOW - 1,) * 4
    for plane, estimate, weighed in zip(*(each.flatten(0, 1) for each in (planes, total, weights)), strict=True):
        for top in range(0, height - _WINDOW + 1, rows):
            here = slice(top, top + rows + _WINDOW - 1)
            windows = nn.functional.conv2d(nn.functional.conv2d(plane[None, None, here], down), across, groups=_WINDOW)
            kept = nn.functional.hardshrink(windows, _THRESHOLD)
            kept[:, 0] = windows[:, 0]
            weight = 1 / (kept != 0).sum(dim=1, keepdim=True).clamp(min=1)
            lines = nn.functional.conv_transpose2d(kept.mul_(weight), across, groups=_WINDOW)
            estimate[here] += nn.functional.conv_transpose2d(lines, down)[0, 0]
            weighed[here] += nn.functional.avg_pool2d(nn.functional.pad(weight, border), _WINDOW, 1)[0, 0]
    return total / (weights * _WINDOW**2)


class _Block(nn.Module):
    """What two convolutions make, added to their input; at first nothing."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = (nn.Conv2d(width, width, 3, padding=1) for _ in range(2))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Add the output of two convolutions to features (N, C, h, w)."""
        added: torch.Tensor = x + self.second(nn.functional.leaky_relu(self.first(x), LEAK))
        return added


def _make_blocks(width: int, count: int) -> nn.Sequential:
    """Make a sequence of residual blocks."""
    return nn.Sequential(*(_Block(width) for _ in range(count)))


def remove_noise(tile: Values, slope: float, offset: float, black: tuple[float, ...]) -> NDArray[np.float32]:
    """Denoise a tile by the network that ships, on a GPU if torch sees one.

    Parameters
    ----------
    tile
        (4, h, w), packed, normalised and amplified, negative values kept; sides are multiples of 8.
    slope, offset, black
        Of its noise (:class:`eldata.baselines.classical.SignalNoise`).

    Raises
    ------
    DatasetError
        If it has other channels than Bayer's four.
    FileError
        If the weights are not there or not its own: the installation is damaged.
    """
    if len(tile) != 4:
        raise DatasetError(
            f"the network takes packed Bayer frames of 4 channels; found {len(tile)}: take dct or anscombe-bm3d"
        )
    device = "cuda" if torch.cuda.is_available() else "cpu"
    taken = torch.from_numpy((tile - np.array(black or (0.0,) * len(tile))[:, None, None]).astype(np.float32))
    with torch.inference_mode():
        made = _load_network(device)(taken[None].to(device), *torch.tensor([[slope], [offset]], device=device))
    return np.asarray(made[0].cpu().numpy())


@lru_cache(maxsize=1)
def _load_network(device: str) -> NoiseAwareUNet:
    """Load the noise-aware network that ships onto a device."""
    network = NoiseAwareUNet()
    load_weights(network, _NOISE_AWARE)
    # A third faster on a CPU.
    arranged: NoiseAwareUNet = network.to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return arranged.eval()  # torch's: batch statistics stand still


def weights_digest() -> str:
    """Return the hash of the weights that ship, which names them in ``predictions.json``."""
    with as_file(files("eldata.baselines") / _NOISE_AWARE) as path:
        return sha256_of(path)
