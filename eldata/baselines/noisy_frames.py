"""What a denoiser gets: a frame of a pair or a clip as its protocol has it, and those around it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.pixels import rgb_frame
from eldata.baselines.exported import checked_window
from eldata.errors import DatasetError
from eldata.evaluation.originals import less_shading, levels_dn, normalised_frame, rendered_frame
from eldata.evaluation.pairs import amplified_by, iso_of, reference_of
from eldata.noise.dark_shading import dark_shading_in
from eldata.raw.reading import exposure_ratio, read_header, read_raw

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from eldata.evaluation.pairs import Pair
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
        Of the input, and what is taken off it.
    """

    dataset: FrameFiles
    pair: Pair
    clip: Clip | None
    protocol: ScoringProtocol
    clip_range: ClipRange
    dark_shading: Path | None
    _read: dict[str, NoisyFrame] = field(default_factory=dict, init=False)

    def frame(self, path: str) -> NoisyFrame:
        """Return a frame as a denoiser gets it."""
        if path not in self._read:
            self._read[path] = self._taken(path)
        return self._read[path]

    def _taken(self, path: str) -> NoisyFrame:
        pair = self.pair
        near = partial(self._window, path)
        noisy = self.dataset.at(path)
        if self.protocol.pixels == "rgb" and isinstance(noisy, Path):  # amplified by its authors
            return NoisyFrame(rgb_frame(noisy), 1.0, math.nan, pair, path, None, near)
        frame = read_raw(noisy)
        ratio = amplified_by(pair, self.protocol.amplification)
        if ratio is None:
            ratio = float(exposure_ratio(read_header(self.dataset.at(reference_of(pair, path) or path)), frame))
        taken = less_shading(frame, dark_shading_in(self.dark_shading), path) if self.dark_shading else frame
        image = normalised_frame(taken, self.protocol.levels, clip=self.clip_range, gain=ratio)
        black, white = levels_dn(frame, self.protocol.levels)
        iso = iso_of(pair) or float(frame.exposure.iso or 0)
        if self.protocol.input_space == "srgb":
            image = rendered_frame(image, frame, self.protocol.curve).astype(np.float32)
            return NoisyFrame(image, ratio, math.nan, pair, path, iso or None, near)
        range_dn, is_black = white[0] - float(np.mean(black)), self.dark_shading is not None
        return NoisyFrame(image, ratio, range_dn, pair, path, iso or None, near, is_black)

    def _window(self, path: str, length: int) -> Values:
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
