"""Every protocol's arithmetic once more, in plain float64 numpy with rawpy, scikit-image and scipy.

It shares no code with the package, on purpose: nothing of ``eldata`` may be imported here, and each protocol's choices
are written down anew, from the repositories that it follows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import rawpy
from scipy.ndimage import correlate1d
from skimage.metrics import structural_similarity

from tests.evaluation.oracle import pack

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.float64]

ssim_of: Any = structural_similarity  # scikit-image has annotations in part only


@dataclass(frozen=True)
class Way:
    """One way to score packed raw values."""

    white: Literal["16383", "file", "channels"] = "16383"
    crop: int = 0  # side of the centre
    border: int = 0
    factor: bool = True
    clamp_after: bool = True
    offset: float = 0.0
    gaussian: bool = False


LED = Way(white="channels", border=2, clamp_after=False, offset=1e-8, gaussian=True)
LRD = Way(white="file", factor=False)
WAYS = {
    "eld": Way(),
    "eld-uncorrected": Way(factor=False),
    "sid": Way(),
    "sid-uncorrected": Way(factor=False),
    "eld-cvpr20": Way(crop=512),
    "sid-tpami": Way(crop=512),
    "pmn-sid": Way(),
    "pmn-eld": Way(),
    "led-sid": LED,
    "led-eld": LED,
    "lrd-sid": LRD,
    "lrd-eld": LRD,
}


def reference(path: Path, white: str) -> Floats:
    """Packed R, G1, B, G2, normalised per channel in float32, as the published loaders do; clipped to [0, 1]."""
    with rawpy.imread(str(path)) as raw:
        assert raw.raw_pattern is not None
        packed = pack(raw.raw_image_visible.astype(np.float64), raw.raw_pattern.astype(np.int64)).astype(np.float32)
        black = np.array(raw.black_level_per_channel, np.float32)[:, None, None]
        channels = raw.camera_white_level_per_channel
        level: Any = np.float32(16383)
        if white == "file" or (white == "channels" and channels is None):
            level = np.float32(raw.white_level)
        elif white == "channels":
            level = np.array(channels, np.float32)[:, None, None]
    normalised: Floats = np.clip((packed - black) / (level - black), 0, 1).astype(np.float64)
    return normalised


def score(prediction: NDArray[Any], path: Path, way: Way) -> tuple[float, float, float]:
    """PSNR, SSIM and factor of a packed prediction against a reference's file."""
    g = reference(path, way.white)
    p = prediction.astype(np.float64)
    if way.crop:
        top, left = g.shape[1] // 2 - way.crop // 2, g.shape[2] // 2 - way.crop // 2
        g, p = (x[:, top : top + way.crop, left : left + way.crop] for x in (g, p))
    if way.border:
        g, p = (x[:, way.border : -way.border, way.border : -way.border] for x in (g, p))
    p = np.clip(p, 0, 1)
    alpha = float((p * g)[g != 1].sum() / (p * p)[g != 1].sum()) if way.factor else 1.0
    p = alpha * p
    if way.clamp_after:
        p = np.clip(p, 0, 1)
    window = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False} if way.gaussian else {}
    similarity = float(ssim_of(g, p, data_range=1.0, channel_axis=0, **window))
    return 10 * math.log10(1 / (float(np.mean((p - g) ** 2)) + way.offset)), similarity, alpha


# --- sRGB -------------------------------------------------------------------------------------------------------------


def libraw_8_bits(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3), as the SID code renders and saves its references."""
    with rawpy.imread(str(path)) as raw:
        wide = raw.postprocess(use_camera_wb=True, half_size=False, no_auto_bright=True, output_bps=16)
    return np.floor(wide / 65535.0 * 255.0 + 0.5).astype(np.uint8)


def matlab_ssim(x: Floats, y: Floats) -> float:
    """MATLAB's ssim(A, ref) on (H, W, 3) of range 255: a Gaussian over all three axes, edges replicated."""
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    taps /= taps.sum()

    def smooth(values: Floats) -> Floats:
        for axis in range(3):
            values = correlate1d(values, taps, axis=axis, mode="nearest")
        return values

    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    ux, uy = smooth(x), smooth(y)
    vx, vy, vxy = smooth(x * x) - ux**2, smooth(y * y) - uy**2, smooth(x * y) - ux * uy
    return float(np.mean((2 * ux * uy + c1) * (2 * vxy + c2) / ((ux**2 + uy**2 + c1) * (vx + vy + c2))))


def score_sid2018(prediction: NDArray[np.uint8], path: Path) -> tuple[float, float]:
    x, y = prediction.astype(np.float64), libraw_8_bits(path).astype(np.float64)
    return 10 * math.log10(255**2 / float(np.mean((x - y) ** 2))), matlab_ssim(x, y)


def score_srgb(
    prediction: NDArray[Any], path: Path, white_balance: tuple[float, ...], xyz_to_camera: Any, crop: int
) -> tuple[float, float, float]:
    """The ELD code's sRGB mode: corrected in raw, rendered with gamma 2.2, truncated to 8 bits."""
    g = reference(path, "16383")
    top, left = g.shape[1] // 2 - crop // 2, g.shape[2] // 2 - crop // 2
    g, p = (x[:, top : top + crop, left : left + crop] for x in (g, np.clip(prediction.astype(np.float64), 0, 1)))
    alpha = float((p * g)[g != 1].sum() / (p * p)[g != 1].sum())
    srgb_to_xyz = np.array(  # IEC 61966-2-1, seven decimals, as LibRaw has it
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    )
    camera_from_srgb = np.array(xyz_to_camera) @ srgb_to_xyz
    matrix = np.linalg.inv(camera_from_srgb / camera_from_srgb.sum(1, keepdims=True))

    def render(packed: Floats) -> Floats:
        balanced = np.clip(packed * np.array(white_balance)[:, None, None], 0, 1)
        rgb = np.stack([balanced[0], (balanced[1] + balanced[3]) / 2, balanced[2]])
        linear = np.clip(np.einsum("ij,jhw->ihw", matrix, rgb), 0, 1)
        shown = (np.maximum(linear, 1e-8) ** (1 / 2.2)).astype(np.float32)  # the code multiplies in float32
        codes: Floats = np.floor(shown * np.float32(255)).astype(np.float64)
        return codes

    x, y = render(alpha * p), render(g)
    similarity = float(ssim_of(y, x, data_range=255.0, channel_axis=0))
    return 10 * math.log10(255**2 / float(np.mean((x - y) ** 2))), similarity, alpha
