"""Denoisers without training: the rows that papers compare networks with.

Each takes a packed frame, normalised and amplified, negative values kept, and the line of its noise
(:mod:`eldata.baselines.signal_noise`), and returns its estimate of the signal.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import version
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.baselines.anscombe import stabilised, unstabilised
from eldata.baselines.dct import dct_thresholded, decorrelation
from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from eldata.baselines.signal_noise import SignalNoise

    Values = NDArray[np.floating[Any]]

_GAUSSIAN_PX = 2.0


@dataclass(frozen=True, slots=True)
class Baseline:
    """A denoiser without training.

    Attributes
    ----------
    title
        What it does, in a line.
    denoise
        (C, h, w) and the line of its noise to (C, h, w).
    uses_noise
        Whether it looks at the noise at all.
    needs
        The packages that it needs beyond those of eldata, by the modules that it imports.
    """

    title: str
    denoise: Callable[[Values, SignalNoise | None], Values]
    uses_noise: bool = True
    needs: Mapping[str, str] = field(default_factory=dict)

    def versions(self) -> dict[str, str]:
        """Return the versions of the packages that it needs.

        Raises
        ------
        EldataError
            If one of them is not there; the message names the extra to install.
        """
        for module in self.needs:
            _imported(module)
        return {package: version(package) for package in self.needs.values()}


_WAVELET = {"pywt": "PyWavelets", "skimage.restoration": "scikit-image"}  # which asks for the first only at work
_BM3D = {"bm3d": "bm3d"}
_EXTRAS = {
    **dict.fromkeys(_WAVELET, "wavelet needs scikit-image and PyWavelets: pip install 'eldata[baselines]'"),
    "bm3d": "BM3D is not installed: pip install 'eldata[bm3d]'. Its authors allow it for non-commercial use only",
}


def _imported(module: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        raise EldataError(_EXTRAS[module]) from error


def _known(line: SignalNoise | None) -> SignalNoise:
    if line is None:
        raise ArgumentError("this baseline needs the line of the frame's noise")
    return line


def _input(image: Values, _: SignalNoise | None) -> Values:
    return image


def _gaussian(image: Values, _: SignalNoise | None) -> Values:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(image, (0.0, _GAUSSIAN_PX, _GAUSSIAN_PX)))


def _dct(image: Values, line: SignalNoise | None) -> Values:
    return dct_thresholded(image, _known(line))


def _wavelet(image: Values, line: SignalNoise | None) -> Values:
    line = _known(line)
    return unstabilised(_in_brightness(stabilised(image, line), _wavelet_of_white), line)


def _wavelet_of_white(image: Values) -> Values:
    _imported("pywt")
    denoise = _imported("skimage.restoration").denoise_wavelet
    shrunk = [denoise(channel, sigma=1.0, wavelet="sym4", method="BayesShrink") for channel in image]
    return np.stack(shrunk)


def _bm3d(image: Values, line: SignalNoise | None) -> Values:
    """One standard deviation for the whole frame, the root of its mean variance, as the method assumes."""
    signal = np.maximum(image, 0.0)
    deviation = float(np.sqrt(np.mean(_known(line).variance(signal))))
    return _in_brightness(image / deviation, _bm3d_of_white) * deviation


def _anscombe_bm3d(image: Values, line: SignalNoise | None) -> Values:
    line = _known(line)
    return unstabilised(_in_brightness(stabilised(image, line), _bm3d_of_white), line)


def _bm3d_of_white(image: Values) -> Values:
    bm3d = _imported("bm3d")
    last = np.ascontiguousarray(np.moveaxis(image, 0, -1), dtype=np.float64)
    profile = bm3d.BM3DProfile()
    profile.num_threads = 1  # frames run side by side
    return np.moveaxis(np.asarray(bm3d.bm3d(last, 1.0, profile)), -1, 0)


def _in_brightness(image: Values, denoise: Callable[[Values], Values]) -> Values:
    """Denoise brightness and differences of colour, in which white noise stays white."""
    matrix = decorrelation(len(image))
    return np.asarray(np.tensordot(matrix.T, denoise(np.tensordot(matrix, image, axes=1)), axes=1))


BASELINES: Mapping[str, Baseline] = MappingProxyType(
    {
        "input": Baseline("the noisy input, amplified, nothing else", _input, uses_noise=False),
        "gaussian": Baseline(f"a Gaussian filter of {_GAUSSIAN_PX:g} packed pixels", _gaussian, uses_noise=False),
        "wavelet": Baseline("BayesShrink of stabilised values (scikit-image)", _wavelet, needs=_WAVELET),
        "dct": Baseline("sliding-window DCT thresholding", _dct),
        "bm3d": Baseline("BM3D with one noise level for the frame", _bm3d, needs=_BM3D),
        "anscombe-bm3d": Baseline(
            "BM3D of stabilised values, exact unbiased inverse (A-BM3D)", _anscombe_bm3d, needs=_BM3D
        ),
    }
)
"""The denoisers without training, by the names that ``eldata baseline`` and ``--baseline`` take."""
