"""What a protocol of clips is: each frame against the clip's one still, or its own; the frames as a video."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from eldata.protocols.digests import NEUTRAL
from eldata.protocols.kinds import CLIPS, Kind
from eldata.protocols.protocol import Clip, Levels, Pixels, Protocol, Rescaling

OWN_SEQUENCES = "own-sequences"
"""In place of a dataset's name: sequences of a set of your own, in which each frame has its own reference."""

# What a clip's protocol states of itself, in this order; of the rest, which is about images, what is not neutral.
_STATED = (
    *("name", "title", "source", "dataset", "pixels", "rescaling", "frames", "frame_count", "levels"),
    *("reference_clip", "reference", "region", "data_range", "st_rred_peak", "psnr", "ssim", "st_rred"),
)


@dataclass(frozen=True, slots=True, repr=False)
class ClipProtocol(Protocol):
    """Everything that the scores of a clip depend on besides the pixels.

    What it has in common with :class:`Protocol` means the same, of each frame. PSNR and SSIM are means over frames.

    Attributes
    ----------
    dataset
        Name of the manifest whose clips it scores, or :data:`OWN_SEQUENCES`.
    pixels
        ``rgb``: the preprocessed RGB frames; ``packed``: the packed mosaic.
    levels
        White level that normalises a raw reference; preprocessed frames have none.
    frames
        Which frames of a clip are scored (:func:`eldata.manifest.clips.frame_range`).
    frame_count
        Their number; 0: every frame that a clip has.
    reference
        What a frame is compared with.
    st_rred_peak
        Scale at which ST-RRED is taken (:func:`eldata.metrics.st_rred`).
    """

    kind: ClassVar[Kind] = CLIPS

    ratios: tuple[int | float, ...] = ()
    levels: Levels = "metadata"
    reference_clip: Clip = "both"
    region: str = "full"
    rescaling: Rescaling = "scalar"
    pixels: Pixels = "packed"
    frames: Literal["evaluation", "all"] = "evaluation"
    frame_count: int = 5
    reference: str = "the clip's one still, for every frame"
    st_rred_peak: float = 1.0

    @property
    def psnr(self) -> str:
        """Definition of PSNR, per clip."""
        return "10 log10(1 / mean squared error over all entries of a frame), mean over frames"

    @property
    def ssim(self) -> str:
        """Definition of SSIM, per clip."""
        return (
            "uniform 7x7 window, sample covariance, K1=0.01, K2=0.03, mean over valid region and channels, mean over "
            "frames"
        )

    @property
    def st_rred(self) -> str:
        """Definition of ST-RRED, per clip."""
        return "of the grey frames after rescaling, frames in pairs 0-1, 2-3, as scikit-video 1.1.11 has it"

    def covers(self, dataset: str) -> bool:
        """Return whether it is for a dataset of this name."""
        return self.dataset == dataset != OWN_SEQUENCES

    def as_dict(self) -> dict[str, Any]:
        """Return what it states as plain types, with the definitions of its metrics."""
        every = Protocol.as_dict(self)  # super() does not find its class in one with slots
        more = {name: value for name, value in every.items() if value != NEUTRAL.get(name, value)}
        return {name: getattr(self, name) for name in _STATED} | more
