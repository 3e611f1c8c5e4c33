"""The straightforward ways, as published code goes about it with rawpy, exifread, torch and scikit-image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import exifread
import numpy as np
import rawpy
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float32]

_WHITE_LEVEL_DN = 16383


def decode(path: Path) -> NDArray[np.uint16]:
    """Return LibRaw's visible mosaic, copied: also the floor of whatever reads the file."""
    with rawpy.imread(str(path)) as raw:
        mosaic: NDArray[np.uint16] = raw.raw_image_visible.copy()
    return mosaic


def exposure(path: Path) -> tuple[float, float]:
    """Return ISO and exposure time in seconds."""
    with path.open("rb") as file:
        tags = exifread.process_file(file, details=False)
    return float(tags["EXIF ISOSpeedRatings"].values[0]), float(tags["EXIF ExposureTime"].values[0])


def pack(mosaic: NDArray[np.uint16], pattern: NDArray[Any], black_level_dn: NDArray[np.float32]) -> Array:
    """Return the mosaic packed and normalised, in float32 throughout."""
    image = mosaic.astype(np.float32)
    planes = []
    for channel in range(4):
        rows, columns = np.where(pattern == channel)
        planes.append(image[rows[0] :: 2, columns[0] :: 2])
    packed = np.stack(planes)
    black = black_level_dn[:, None, None]
    normalised: Array = np.clip((packed - black) / (_WHITE_LEVEL_DN - black), 0, 1)
    return normalised


def read_packed(path: Path) -> Array:
    """Decode and pack one file."""
    with rawpy.imread(str(path)) as raw:
        black = np.array(raw.black_level_per_channel, dtype=np.float32)
        return pack(raw.raw_image_visible, np.array(raw.raw_pattern), black)


def item(noisy: Path, reference: Path) -> tuple[Array, Array]:
    """Return input and target of a pair."""
    noisy_iso, noisy_s = exposure(noisy)
    reference_iso, reference_s = exposure(reference)
    ratio = reference_iso * reference_s / (noisy_iso * noisy_s)
    amplified = read_packed(noisy) * ratio
    target = read_packed(reference)
    amplified = np.maximum(np.minimum(amplified, 1.0), 0.0)
    return np.ascontiguousarray(amplified), np.ascontiguousarray(target)


def scores(prediction: torch.Tensor, reference: torch.Tensor) -> tuple[float, float]:
    """Return PSNR in dB and SSIM of a prediction brought to its reference's brightness, in float32."""
    prediction = torch.clamp(prediction, 0, 1)
    unsaturated = reference != 1
    p, g = prediction[unsaturated], reference[unsaturated]
    corrected = prediction * (torch.dot(p, g) / torch.dot(p, p))
    shown, truth = _as_image(corrected), _as_image(reference)
    psnr = peak_signal_noise_ratio(truth, shown, data_range=255)  # type: ignore[no-untyped-call]
    ssim = structural_similarity(truth, shown, channel_axis=-1, data_range=255)  # type: ignore[no-untyped-call]
    return float(psnr), float(ssim)


def _as_image(packed: torch.Tensor) -> Array:
    """Return (h, w, C) of 0 to 255, not rounded."""
    image: Array = np.clip(np.transpose(packed.numpy(), (1, 2, 0)) * 255, 0, 255)
    return image
