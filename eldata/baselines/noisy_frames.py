"""What a denoiser gets: a frame of a pair or a clip as its protocol has it, and those around it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.baselines.classical import SignalNoise, noise_of_parameters
from eldata.baselines.exported import checked_window
from eldata.errors import ArgumentError, DatasetError
from eldata.isp.rendering import render_to_8_bits
from eldata.noise.dark_shading import dark_shading_in
from eldata.noise.parameters import NoiseParameters
from eldata.noise.profile import CameraProfile, rows_nearest, rows_of
from eldata.sources.frames import Files
from eldata.sources.pairs import PairOpener

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation.scores import Pair
    from eldata.manifest.catalogue import FrameFiles
    from eldata.manifest.clips import Clip
    from eldata.protocols.protocol import Protocol as ScoringProtocol
    from eldata.raw.levels import Clip as ClipRange

    Values = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class NoisyFrame:
    """What a denoiser gets.

    Attributes
    ----------
    image
        (C, h, w) float32, packed, normalised with the protocol's levels, times the ratio; where the protocol has inputs
        in sRGB, (3, h, w), that rendered in 8 bits with its file's colours; of preprocessed RGB frames R, G, B as they
        are.
    ratio
        That it was multiplied by.
    range_dn
        White less black level; nan of sRGB and RGB.
    pair
        Of the manifest: a pair of frames, or a window of a clip.
    path
        The frame itself, as in the manifest.
    iso
        ISO speed, if it is known.
    has_own_black
        Whether a dark shading was taken off, and the camera's colour bias with it.
    window
        Of a frame of a clip: ``frame.window(5)`` is (5, C, h, w) float32, the frame in the middle of those around it.
        At the clip's ends those inside are mirrored (:func:`mirrored_window`). :class:`DatasetError` if there is no
        such window.
    """

    image: NDArray[np.float32]
    ratio: float
    range_dn: float
    pair: Pair
    path: str
    iso: float | None
    window: Callable[[int], NDArray[np.float32]]
    has_own_black: bool = False


@dataclass(slots=True, eq=False)
class NoisyFrames:
    """The frames of a pair or of a clip, each read once for all windows that it is in.

    Attributes
    ----------
    dataset
        Its files.
    pair, clip
        Of the manifest.
    protocol
        Which decides levels and amplification.
    clip_range, dark_shading
        Of the input, and what is subtracted from it.
    """

    dataset: FrameFiles
    pair: Pair
    clip: Clip | None
    protocol: ScoringProtocol
    clip_range: ClipRange
    dark_shading: Path | None
    _read: dict[str, NoisyFrame] = field(default_factory=dict, init=False)

    def frame(self, path: str) -> NoisyFrame:
        """Read a frame as a denoiser gets it."""
        if path not in self._read:
            self._read[path] = self._read_frame(path)
        return self._read[path]

    def _read_frame(self, path: str) -> NoisyFrame:
        """Read a noisy frame, normalised and amplified as its protocol states."""
        pair, protocol, source = self.pair, self.protocol, Files(self.dataset)
        shading = None if self.dark_shading is None else dark_shading_in(self.dark_shading)
        opener = PairOpener(source, protocol.levels, protocol.amplification, shading)
        noisy = source.frame(path)
        reference = pair.reference_of(path) if noisy.sensor is not None else None
        target = source.outline(reference, noisy, protocol.levels) if reference else None
        opened = opener.open_pair(pair, target, path, noisy)
        image, near = opened.input.normalise(self.clip_range, opened.gain), partial(self._read_window, path)
        iso = float(pair.iso or noisy.exposure.iso or 0) or None
        if noisy.sensor is not None and protocol.input_space == "srgb":
            image = (render_to_8_bits(image, noisy.sensor, response=protocol.curve) / 255.0).astype(np.float32)
            return NoisyFrame(image, opened.gain, math.nan, pair, path, iso, near)
        if noisy.sensor is None:  # amplified by its authors
            return NoisyFrame(image, 1.0, math.nan, pair, path, None, near)
        return NoisyFrame(image, opened.gain, opened.input.range_dn, pair, path, iso, near, shading is not None)

    def _read_window(self, path: str, length: int) -> Values:
        """Read the ``length`` frames around one of a clip, (length, C, h, w)."""
        if self.clip is None:
            raise DatasetError(f"{path}: is a photograph alone; a window of {length} frames needs a clip")
        frames = [self.frame(name).image for name in mirrored_window(self.clip, path, length)]
        unlike = {frame.shape for frame in frames}
        if len(unlike) > 1:
            raise DatasetError(f"clip {self.clip.scene}: its frames have sizes {sorted(unlike)}; are they of one clip?")
        return np.stack(frames)


def mirrored_window(clip: Clip, path: str, length: int) -> tuple[str, ...]:
    """Return the frames around one of a clip, that one in the middle; at the clip's ends those inside are mirrored.

    Of frames 0, 1, 2 ... the window of five around 0 is 2, 1, 0, 1, 2, as in the published code of FastDVDnet.

    Raises
    ------
    ArgumentError
        If the length is even.
    DatasetError
        If the clip is too short to be mirrored, or a number is missing between the frames.
    """
    half, last = checked_window(length) // 2, len(clip.frames) - 1
    place = clip.frames.index(path)
    if half > last:
        raise DatasetError(
            f"clip {clip.scene}: has {last + 1} frames; a window of {length} needs {half + 1}, mirrored at its ends"
        )
    if not clip.continuous(max(place - half, 0), min(place + half, last) + 1):
        raise DatasetError(f"clip {clip.scene}: a number is missing near {path}; eldata verify finds gaps")
    around = (abs(step) for step in range(place - half, place + half + 1))
    return tuple(clip.frames[last - abs(last - step)] for step in around)


# --- what a denoiser is told of a frame's noise: by its camera's profile, or by the frame itself ----------------------


def estimate_line(image: Values | Iterable[Values]) -> SignalNoise:
    """Estimate the noise line from a frame itself (:func:`eldata.baselines.noise_line.noise_line`), without row noise.

    Parameters
    ----------
    image
        (C, h, w), negative values kept, or its bands as there.

    Raises
    ------
    DatasetError
        If the frame does not tell its noise: too small, textured all over, smoothed, or without noise.
    """
    from eldata.baselines.noise_line import noise_line

    try:
        line = noise_line(image)
    except DatasetError as error:
        raise DatasetError(
            f"{error}. With the camera's noise given (--profile, profiles=...) the frame need not tell it"
        ) from error
    # A line fitted to bright parts alone may cross 0 before black.
    return SignalNoise(max(line.slope, 0.0), max(line.offset, line.least_variance / 4))


def line_of_profile(
    profile: CameraProfile, path: str, iso: float | None, *, ratio: float, range_dn: float
) -> SignalNoise:
    """Return the line of shot and read noise that a profile states for a frame.

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
    return noise_of_parameters(find_parameters(profile, iso), ratio=ratio, range_dn=range_dn)


def find_parameters(profile: CameraProfile, iso: float) -> NoiseParameters:
    """Return a profile's figures at an ISO: as measured there, else on its lines.

    Raises
    ------
    ArgumentError
        If the ISO lies beyond the calibrated ones, between two gain modes, or has no lines.
    """
    try:
        return profile.measured(iso)
    except ArgumentError:
        gain = profile.gain_at_iso(iso)
    mode = profile.mode_at(gain)
    rows = rows_of(mode, profile.rows, profile.modes)
    nearest = (rows_nearest(gain, rows) or rows)[0]  # lambda goes with the gain
    scales, step = mode.scales_dn(gain, (0.0, 0.0, 0.0)), profile.quantisation_step_dn
    return NoiseParameters(gain, nearest.tukey_lambda, *scales, quantisation_step_dn=step)
