"""Named, frozen protocols for clips; see :mod:`eldata.protocols`, which has those for single images."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from eldata.errors import ArgumentError
from eldata.protocols import fields_digest


@dataclass(frozen=True, slots=True)
class VideoProtocol:
    """Everything that the scores of a clip depend on besides the pixels.

    Attributes
    ----------
    name, title, source
        Short name, what it is, and where it was published.
    dataset
        Name of the manifest whose clips it scores.
    pixels
        ``rgb``: the preprocessed RGB frames; ``packed``: the packed mosaic.
    frames
        Which frames of a clip are scored (:func:`eldata.manifest.clips.frame_range`).
    frame_count
        Their number.
    levels
        White level that normalises a raw reference; preprocessed frames have none.
    reference_clip
        Clip of the normalised reference.
    reference
        What a frame is compared with.
    region
        The scored part of the frame: ``full`` is the whole one.
    rescaling
        ``scalar``: each frame is multiplied by the one factor that minimises its squared error over the entries where
        the reference is not 1; ``none``: it is scored as it is. Either way it is clamped to [0, 1] before and after.
    data_range, st_rred_peak
        Range of PSNR and SSIM; scale at which ST-RRED is taken (:func:`eldata.metrics.st_rred`).
    psnr, ssim, st_rred
        Definition of the metrics.
    """

    name: str
    title: str
    source: str
    dataset: str
    pixels: Literal["rgb", "packed"]
    rescaling: Literal["none", "scalar"]
    frames: Literal["evaluation"] = "evaluation"
    frame_count: int = 5
    levels: Literal["metadata", "published"] = "metadata"
    reference_clip: Literal["both", "upper", "none"] = "both"
    reference: Literal["the clip's one still, for every frame"] = "the clip's one still, for every frame"
    region: Literal["full"] = "full"
    data_range: float = 1.0
    st_rred_peak: float = 1.0
    psnr: str = "10 log10(1 / mean squared error over all entries of a frame), mean over frames"
    ssim: str = (
        "uniform 7x7 window, sample covariance, K1=0.01, K2=0.03, mean over valid region and channels, mean over frames"
    )
    st_rred: str = "of the grey frames after rescaling, frames in pairs 0-1, 2-3, as scikit-video 1.1.11 has it"

    @property
    def digest(self) -> str:
        """``sha256:<hex>`` of all that decides a score: every field but title and source."""
        return fields_digest(self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as plain types."""
        return asdict(self)


_PAPER = (
    "K. Wei et al., Physics-based Noise Modeling for Extreme Low-light Photography, TPAMI 2021, results on DRV: "
    "averages over five continuous frames a video; which five, and which black and white level, is not said; ELD "
    "repository, commit 53d5408, util/index.py (metrics), models/ELD_model.py (correction); no code for video is public"
)

VIDEO_PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        VideoProtocol(
            name="drv-rgb",
            title="DRV as preprocessed by its authors: RGB, frames 5 to 9 of each clip, one scalar per frame",
            source=f"{_PAPER}; on the preprocessed RGB frames, where the paper has raw ones",
            dataset="drv",
            pixels="rgb",
            rescaling="scalar",
        ),
        VideoProtocol(
            name="drv-rgb-uncorrected",
            title="DRV as preprocessed by its authors, without the scalar: the prediction's own brightness counts",
            source=f"{_PAPER}; on the preprocessed RGB frames; without the illuminance correction",
            dataset="drv",
            pixels="rgb",
            rescaling="none",
        ),
        VideoProtocol(
            name="drv-raw",
            title="DRV raw as in the ELD paper: packed raw, frames 5 to 9 of each clip, one scalar per frame",
            source=_PAPER,
            dataset="drv-raw",
            pixels="packed",
            rescaling="scalar",
        ),
        VideoProtocol(
            name="drv-raw-uncorrected",
            title="DRV raw without the scalar: the prediction's own brightness counts",
            source=f"{_PAPER}; without the illuminance correction",
            dataset="drv-raw",
            pixels="packed",
            rescaling="none",
        ),
    )
}


def get_video_protocol(name: str) -> VideoProtocol:
    """Return a protocol by name.

    Raises
    ------
    ArgumentError
        If there is none of that name; the message lists those that there are.
    """
    if name not in VIDEO_PROTOCOLS:
        raise ArgumentError(f"no protocol for clips is called {name!r}; known are {', '.join(VIDEO_PROTOCOLS)}")
    return VIDEO_PROTOCOLS[name]


def default_video_protocol(dataset: str) -> VideoProtocol | None:
    """Return the protocol that scores a dataset of clips unless another is named, or ``None`` for one of images."""
    return next((protocol for protocol in VIDEO_PROTOCOLS.values() if protocol.dataset == dataset), None)
