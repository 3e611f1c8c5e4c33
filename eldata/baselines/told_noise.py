"""What a denoiser is told of a frame's noise: by its camera's profile, or by the frame itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.numbers import checked_number
from eldata.baselines.classical import BASELINES, SignalNoise, noise_of_image, noise_of_parameters
from eldata.errors import ArgumentError, DatasetError
from eldata.evaluation.originals import levels_dn
from eldata.noise.gain_modes import rows_nearest, rows_of
from eldata.noise.parameters import NoiseParameters
from eldata.raw.levels import packed_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.profile import CameraProfile
    from eldata.raw.levels import FrameLevels
    from eldata.records import RawFrame

    Values = NDArray[np.floating[Any]]


def estimate_line(image: Values) -> SignalNoise:
    """Return what a frame tells of its own noise (:func:`eldata.baselines.classical.noise_of_image`).

    Raises
    ------
    DatasetError
        If it tells nothing.
    """
    try:
        return noise_of_image(image)
    except DatasetError as error:
        raise DatasetError(
            f"{error}. With the camera's noise given (--profile, profiles=...) the frame need not tell it"
        ) from error


def line_of_profile(
    profile: CameraProfile, path: str, iso: float | None, *, ratio: float, range_dn: float
) -> SignalNoise:
    """Return what a profile says of a frame.

    Parameters
    ----------
    profile
        Of its camera.
    path, iso
        The frame's; ``None``: it states no ISO.
    ratio, range_dn
        What it was multiplied by, and its white less black level.

    Raises
    ------
    ArgumentError
        If the profile does not know the ISO.
    DatasetError
        If the frame has no ISO, or no DN.
    """
    if iso is None:
        raise DatasetError(f"{path}: its ISO is not known, so the profile does not tell its noise")
    if range_dn <= 1:
        raise DatasetError(
            f"{path}: its white level is 1, so it holds shares of white and no DN, and the profile is in DN; "
            "leave the profile out"
        )
    return noise_of_parameters(typical(profile, iso), ratio=ratio, range_dn=range_dn)


def typical(profile: CameraProfile, iso: float) -> NoiseParameters:
    """Return a profile's figures at an ISO: as measured there, else on its lines.

    Raises
    ------
    ArgumentError
        If the ISO lies beyond the calibrated ones, or between two gain modes.
    """
    try:
        return profile.measured(iso)
    except ArgumentError:
        gain = profile.gain_at_iso(iso)
    mode = profile.mode_at(gain)
    rows = rows_of(mode, profile.rows, profile.modes)
    nearest = (rows_nearest(gain, rows) or rows)[0]  # lambda goes with the gain
    scale, gauss, row = (fit.scale_dn(gain, 0.0) for fit in (mode.tukey_lambda_fit, mode.gauss_fit, mode.row_fit))
    step = profile.quantisation_step_dn
    return NoiseParameters(gain, nearest.tukey_lambda, scale, gauss, row, quantisation_step_dn=step)


def denoise(
    frame: RawFrame, profile: CameraProfile | None = None, *, ratio: float = 1.0, levels: FrameLevels = "metadata"
) -> NDArray[np.float32]:
    """Return a raw frame without its noise, as the network that ships makes it (docs/baselines.md has its card).

    Parameters
    ----------
    frame
        Of a Bayer camera, as :func:`eldata.raw.read_raw` returns it.
    profile
        Of its camera; what it says of the frame's ISO is what the network is told, and the colour bias is taken off.
        ``None``: the noise is estimated from the frame, as ``eldata profile estimate`` does.
    ratio
        What it is amplified by, above 0.
    levels
        As :func:`eldata.evaluate`'s protocols have them: the file's own, or the published constant.

    Returns
    -------
    ndarray
        (4, h, w) float32, packed, black at 0 and white at 1, times the ratio; not clipped.

    Raises
    ------
    DatasetError
        If the frame is not of Bayer's four channels, states no ISO that the profile could be asked for, or without a
        profile does not tell its noise.
    ArgumentError
        If the profile does not know the ISO, or the ratio is not above 0.

    Examples
    --------
    >>> from eldata.baselines import denoise
    >>> from eldata.noise import CameraProfile
    >>> from eldata.raw import read_raw
    >>> noisy = read_raw("eldata-demo/data/ELD-demo/DemoAlpha/scene-1/IMG_0012.dng")
    >>> denoise(noisy, CameraProfile.load("SonyA7S2"), ratio=100.0).shape  # one's own camera's
    (4, 256, 384)
    """
    image = packed_frame(frame, levels=levels, clip="none", gain=checked_number("ratio", ratio, above=0))
    if profile is None:
        line = estimate_line(image)
    else:
        black, white = levels_dn(frame, levels)
        range_dn, iso = white[0] - float(np.mean(black)), float(frame.exposure.iso or 0) or None
        line = line_of_profile(profile, str(frame.path), iso, ratio=ratio, range_dn=range_dn)
    return np.asarray(BASELINES["network"].denoise(image, line), dtype=np.float32)
