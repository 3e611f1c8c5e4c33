"""Named, frozen evaluation protocols. A score means nothing without the name of its protocol."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any, Literal

from eldata.errors import ArgumentError


@dataclass(frozen=True, slots=True)
class Protocol:
    """Everything that a score depends on besides the pixels.

    Attributes
    ----------
    name, title, source
        Short name, what it is, and where it was published.
    dataset
        The dataset whose pairs it names.
    ratios
        Low-light factors of the pairs that are scored.
    levels
        White level that normalises the reference (:mod:`eldata.raw.levels`).
    reference_clip
        Clip of the normalised reference.
    region
        The scored part of the frame: ``full`` is the whole packed frame.
    rescaling
        ``scalar``: the prediction is multiplied by the one factor that minimises its squared error over the entries
        where the reference is not 1; ``none``: it is scored as it is. Either way it is clamped to [0, 1] before and
        after.
    data_range, rounding
        Range of PSNR and SSIM; whether values are rounded to integers before scoring.
    psnr, ssim
        Definition of the metrics, per packed image; a table's entries are means over images.
    """

    name: str
    title: str
    source: str
    dataset: str
    ratios: tuple[int, ...]
    levels: Literal["metadata", "published"]
    reference_clip: Literal["both", "upper", "none"]
    region: Literal["full"]
    rescaling: Literal["none", "scalar"]
    data_range: float = 1.0
    rounding: Literal["none"] = "none"
    psnr: str = "10 log10(1 / mean squared error over all packed entries)"
    ssim: str = "uniform 7x7 window, sample covariance, K1=0.01, K2=0.03, mean over valid region and packed channels"

    @property
    def digest(self) -> str:
        """``sha256:<hex>`` of all that decides a score: every field but title and source."""
        fields = {key: value for key, value in self.as_dict().items() if key not in ("title", "source")}
        return f"sha256:{hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()}"

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as plain types."""
        return asdict(self) | {"ratios": list(self.ratios)}


_ELD_SOURCE = (
    "K. Wei et al., Physics-based Noise Modeling for Extreme Low-light Photography, TPAMI 2021, results on the ELD "
    "dataset; ELD repository, commit 53d5408, test_ELD.py, models/ELD_model.py, util/index.py"
)

PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol(
            name="eld",
            title="ELD as published: packed raw, full frame, white level 16383, one scalar per image",
            source=_ELD_SOURCE,
            dataset="eld",
            ratios=(100, 200),
            levels="published",
            reference_clip="both",
            region="full",
            rescaling="scalar",
        ),
        Protocol(
            name="eld-uncorrected",
            title="ELD without the scalar: the prediction's own brightness counts",
            source=_ELD_SOURCE + "; without the illuminance correction",
            dataset="eld",
            ratios=(100, 200),
            levels="published",
            reference_clip="both",
            region="full",
            rescaling="none",
        ),
    )
}


def get_protocol(name: str) -> Protocol:
    """Return a protocol by name.

    Raises
    ------
    ArgumentError
        If there is none of that name; the message lists those that there are.
    """
    if name not in PROTOCOLS:
        raise ArgumentError(f"no protocol is called {name!r}; known are {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]
