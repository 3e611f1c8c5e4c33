"""Denoisers without training: the rows that papers compare networks with.

Each takes a packed frame, normalised and amplified, negative values kept, and the line of its noise, and returns its
estimate of the signal.

The line says how the noise grows with the signal: ``variance = offset + slope * signal``. Shot noise of a gain K makes
the slope, whatever does not depend on light the offset. Both are in units of the packed, normalised and amplified
frame: with ratio r and white - black of w DN, slope ``K r / w`` and offset ``(sigma r / w)^2``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import version
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.fft import dct, dctn, idctn
from scipy.interpolate import PchipInterpolator
from scipy.stats import poisson

from eldata.baselines.tiling import tiled
from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from eldata.noise.parameters import NoiseParameters

    Values = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class SignalNoise:
    """Variance of the noise over the signal.

    Attributes
    ----------
    slope
        Variance per unit of signal, 0 or more.
    offset
        Variance without light, above 0.
    black
        Mean of each packed channel without light, which the frame's black level is off by; empty: not known. Only
        ``network`` takes it off: the published methods know of no colour bias.
    """

    slope: float
    offset: float
    black: tuple[float, ...] = ()

    def variance(self, signal: Values) -> Values:
        """Return the variance at expected signals; below 0 they count as no light."""
        return np.asarray(self.offset + self.slope * np.maximum(signal, 0.0))


def noise_of_parameters(parameters: NoiseParameters, *, ratio: float, range_dn: float) -> SignalNoise:
    """Return the line that a camera's figures make: shot noise, read and row noise, rounding.

    Parameters
    ----------
    parameters
        Such as ``CameraProfile.measured(iso)``.
    ratio
        What the frame was multiplied by.
    range_dn
        White less black level.
    """
    scale = ratio / range_dn
    gauss, row = float(parameters.sigma_gauss_dn), float(parameters.sigma_row_dn)
    rounding = parameters.quantisation_step_dn**2 / 12
    black = tuple(bias * scale for bias in parameters.colour_bias_dn)
    return SignalNoise(float(parameters.gain_dn_per_e) * scale, (gauss**2 + row**2 + rounding) * scale**2, black)


# --- stabilising ------------------------------------------------------------------------------------------------------

# The generalised Anscombe transformation, after M. Makitalo and A. Foi, "Optimal inversion of the generalized Anscombe
# transformation for Poisson-Gaussian noise", IEEE Transactions on Image Processing 22 (2013). For z = a p + n with p of
# Poisson(y / a) and n normal of standard deviation s, f(z) = 2 / a sqrt(max(a z + 3/8 a^2 + s^2, 0)) has a standard
# deviation of about 1. The exact unbiased inverse is the y whose E[f(z)] is the denoised value; inverting f itself
# would make dark parts too dark. The expectation is worked out as the definition has it, a sum over Poisson counts and
# an integral over the normal part, and beyond _LARGEST counts by the paper's closed form.

_LARGEST = 200.0  # counts
_NODES = 801
_REACH = 8.0  # standard deviations
_POINTS = 400


def apply_anscombe(image: Values, line: SignalNoise) -> Values:
    """Return the transform of an image: noise of standard deviation 1 wherever its signal is.

    Parameters
    ----------
    image
        Of any shape; negative values kept.
    line
        Of its noise.
    """
    if line.slope == 0:
        return np.asarray(image / np.sqrt(line.offset))
    counts, sigma = image / line.slope, np.sqrt(line.offset) / line.slope
    return np.asarray(2 * np.sqrt(np.maximum(counts + (3 / 8 + sigma**2), 0.0)))


def invert_anscombe(values: Values, line: SignalNoise) -> Values:
    """Return the signals whose stabilised values have these means: the exact unbiased inverse; 0 or more."""
    if line.slope == 0:
        return np.asarray(values * np.sqrt(line.offset))
    sigma = float(np.sqrt(line.offset) / line.slope)
    signals, expected = _tabulate_means(sigma)
    inside = np.clip(values, expected[0], expected[-1])
    counts = PchipInterpolator(expected, signals)(inside)
    beyond = values > expected[-1]
    if beyond.any():
        d = values[beyond].astype(np.float64)
        root = np.sqrt(3 / 2)
        counts[beyond] = d**2 / 4 + root / (4 * d) - 11 / (8 * d**2) + 5 * root / (8 * d**3) - 1 / 8 - sigma**2
    return np.asarray(counts * line.slope)


@lru_cache(maxsize=16)
def _tabulate_means(sigma: float) -> tuple[Values, Values]:
    """Tabulate expected counts, ascending from 0, and the mean of their transform, E[f], for a = 1."""
    signals = np.concatenate([[0.0], np.geomspace(1e-3, _LARGEST, _POINTS)])
    # f has a kink where it becomes 0, at which quadratures of higher order would be no better than this even grid.
    nodes = np.linspace(-_REACH, _REACH, _NODES)
    weights = np.exp(-0.5 * nodes**2)
    weights /= weights.sum()
    expected = np.empty_like(signals)
    for place, signal in enumerate(signals):
        low, high = (float(poisson.ppf(share, signal)) for share in (1e-12, 1 - 1e-12)) if signal else (0.0, 0.0)
        counts = np.arange(max(low, 0.0), high + 1)
        chance = poisson.pmf(counts, signal)
        inner = np.maximum(counts[:, None] + sigma * nodes + (3 / 8 + sigma**2), 0.0)
        expected[place] = (chance / chance.sum()) @ (2 * np.sqrt(inner) @ weights)
    return signals, expected


# --- thresholding -----------------------------------------------------------------------------------------------------

# Sliding-window DCT thresholding (G. Yu and G. Sapiro, "DCT image denoising", IPOL 2011): each channel is cut into
# overlapping 8x8 windows; DCT coefficients below a threshold go to zero, and the windows are averaged back. The
# threshold follows the noise of the window's brightness.

_SIZE = 8
_STEP = 2
_THRESHOLD = 2.7

_ROOT = 0.5**0.5
# Orthonormal, from R, G1, B, G2: brightness and three differences.
_BAYER = np.array([[0.5, 0.5, 0.5, 0.5], [0.5, -0.5, 0.5, -0.5], [_ROOT, 0, -_ROOT, 0], [0, _ROOT, 0, -_ROOT]])


def decorrelation(channels: int) -> Values:
    """Return an orthonormal matrix whose first row is brightness: white noise stays white."""
    if channels == len(_BAYER):
        return _BAYER
    return np.asarray(dct(np.eye(channels), axis=0, norm="ortho"))


def threshold_dct(image: Values, line: SignalNoise) -> NDArray[np.float32]:
    """Denoise a frame by thresholding the DCT of overlapping windows.

    Parameters
    ----------
    image
        (C, h, w), normalised and amplified, negative values kept.
    line
        Of its noise.
    """
    matrix = decorrelation(len(image))
    channels = np.tensordot(matrix, image.astype(np.float32), axes=1).astype(np.float32)
    padded = np.pad(channels, ((0, 0), (_SIZE, _SIZE), (_SIZE, _SIZE)), mode="reflect")
    # Brightness decides the noise of all channels: they are sums of the same pixels.
    brightness = _cut_windows(padded[0]).mean(axis=(-2, -1)) / np.float32(len(image) ** 0.5)
    sigma = np.sqrt(line.variance(brightness)).astype(np.float32)
    result = np.stack([_threshold_channel(channel, sigma) for channel in padded])
    result = result[:, _SIZE:-_SIZE, _SIZE:-_SIZE]
    return np.tensordot(matrix.T, result, axes=1).astype(np.float32)


def _cut_windows(channel: NDArray[np.float32]) -> NDArray[np.float32]:
    """Cut a channel (h, w) into overlapping square windows, (rows, columns, side, side)."""
    view = np.lib.stride_tricks.sliding_window_view(channel, (_SIZE, _SIZE))
    return np.ascontiguousarray(view[::_STEP, ::_STEP])


def _threshold_channel(channel: NDArray[np.float32], sigma: NDArray[np.float32]) -> NDArray[np.float32]:
    """Denoise a channel (h, w): drop the DCT coefficients of each window below a multiple of its ``sigma``."""
    coefficients = dctn(_cut_windows(channel), axes=(-2, -1), norm="ortho")
    keep = np.abs(coefficients) > _THRESHOLD * sigma[..., None, None]
    keep[..., 0, 0] = True
    coefficients *= keep
    # Windows with fewer kept coefficients are smoother, so they weigh more.
    weight = (1.0 / keep.sum(axis=(-2, -1))).astype(np.float32)
    estimate = idctn(coefficients, axes=(-2, -1), norm="ortho") * weight[..., None, None]
    total = np.zeros(channel.shape, np.float32)
    weights = np.full(channel.shape, 1e-12, np.float32)
    rows, columns = weight.shape
    for y in range(_SIZE):
        for x in range(_SIZE):
            place = (slice(y, y + _STEP * rows, _STEP), slice(x, x + _STEP * columns, _STEP))
            total[place] += estimate[..., y, x]
            weights[place] += weight
    return total / weights


# --- the baselines ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Baseline:
    """A denoiser without training.

    Attributes
    ----------
    title
        What it does, in a line.
    function
        (C, h, w) and the line of its noise to (C, h, w).
    uses_noise
        Whether it looks at the noise at all.
    needs_bm3d
        Whether it needs the package ``bm3d``.
    has_weights
        Whether it was trained: then the hash of its weights is part of what decides its predictions.
    tile, overlap, multiple
        As :func:`eldata.baselines.tiling.tiled` has them, in packed pixels.
    """

    title: str
    function: Callable[[Values, Any], Values]
    uses_noise: bool = True
    needs_bm3d: bool = False
    has_weights: bool = False
    tile: int = 0
    overlap: int = 0
    multiple: int = 1

    @property
    def sides(self) -> dict[str, int]:
        """Tile, overlap and multiple."""
        return {"tile": self.tile, "overlap": self.overlap, "multiple": self.multiple}

    def denoise(self, image: Values, line: SignalNoise | None) -> Values:
        """Denoise a frame (C, h, w).

        Raises
        ------
        ArgumentError
            If it needs the line of the noise and there is none.
        """
        if self.uses_noise and line is None:
            raise ArgumentError("this baseline needs the line of the frame's noise")
        return tiled(lambda part: self.function(part, line), image, **self.sides)

    def versions(self) -> dict[str, str]:
        """List the versions that decide its predictions: of the package that it needs, or the hash of its weights.

        Raises
        ------
        EldataError
            If the package is not there; the message names the extra to install.
        """
        if self.needs_bm3d:
            _import_bm3d()
            return {"bm3d": version("bm3d")}
        if self.has_weights:
            from eldata.baselines.unet import weights_digest

            return {"weights_sha256": weights_digest()}
        return {}


def _import_bm3d() -> Any:
    """Import BM3D, or refuse with the command that installs it."""
    try:
        return import_module("bm3d")
    except ImportError as error:
        raise EldataError(
            "BM3D is not installed: pip install 'eldata[bm3d]'. Its authors allow it for non-commercial use only"
        ) from error


def _run_bm3d(image: Values, line: SignalNoise) -> Values:
    """Denoise with one standard deviation for the whole frame, the root of its mean variance, as the method assumes."""
    deviation = float(np.sqrt(np.mean(line.variance(image))))
    return _run_bm3d_on_white(image / deviation) * deviation


def _anscombe_bm3d(image: Values, line: SignalNoise) -> Values:
    """Denoise by BM3D after a variance-stabilising transform."""
    return invert_anscombe(_run_bm3d_on_white(apply_anscombe(image, line)), line)


def _run_bm3d_on_white(image: Values) -> Values:
    """Denoise brightness and differences of colour, in which white noise stays white."""
    bm3d, matrix = _import_bm3d(), decorrelation(len(image))
    last = np.ascontiguousarray(np.moveaxis(np.tensordot(matrix, image, axes=1), 0, -1), dtype=np.float64)
    profile = bm3d.BM3DProfile()
    profile.num_threads = 1  # frames run side by side
    denoised = np.moveaxis(np.asarray(bm3d.bm3d(last, 1.0, profile)), -1, 0)
    return np.asarray(np.tensordot(matrix.T, denoised, axes=1))


def _run_network(image: Values, line: SignalNoise) -> Values:
    """Denoise a tile by the network that ships."""
    from eldata.baselines.unet import remove_noise

    return remove_noise(image, line.slope, line.offset, line.black)


BASELINES: Mapping[str, Baseline] = MappingProxyType(
    {
        "input": Baseline("the noisy input, amplified, nothing else", lambda image, _: image, uses_noise=False),
        # A quarter of the overlaps is as far as they see.
        "dct": Baseline("sliding-window DCT thresholding", threshold_dct, tile=1024, overlap=64, multiple=2),
        "bm3d": Baseline("BM3D with one noise level for the frame", _run_bm3d, needs_bm3d=True),
        "anscombe-bm3d": Baseline(
            "BM3D of stabilised values, exact unbiased inverse (A-BM3D)", _anscombe_bm3d, needs_bm3d=True
        ),
        "network": Baseline(
            "the network that ships, told the noise", _run_network, has_weights=True, tile=1024, overlap=272, multiple=8
        ),
    }
)
"""The denoisers that need no training of yours, by the names that ``eldata baseline`` and ``--baseline`` take."""
