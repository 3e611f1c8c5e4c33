"""Named, frozen evaluation protocols. A score means nothing without the name of its protocol."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any, Literal

from eldata.errors import ArgumentError


def fields_digest(fields: dict[str, Any]) -> str:
    """Return ``sha256:<hex>`` of a protocol's fields; ``title`` and ``source``, which decide no score, do not count."""
    deciding = {key: value for key, value in fields.items() if key not in ("title", "source")}
    return f"sha256:{hashlib.sha256(json.dumps(deciding, sort_keys=True).encode()).hexdigest()}"


@dataclass(frozen=True, slots=True)
class Protocol:
    """Everything that a score depends on besides the pixels.

    Attributes
    ----------
    name, title, source
        Short name, what it is, and where it was published.
    dataset
        The dataset whose pairs it scores, or what the names of several begin with: ``sid`` is for ``sid-sony`` and
        ``sid-fuji`` (:meth:`covers`).
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
        return fields_digest(self.as_dict())

    def covers(self, dataset: str) -> bool:
        """Return whether it is for a dataset of this name."""
        return dataset == self.dataset or dataset.startswith(f"{self.dataset}-")

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as plain types."""
        return asdict(self) | {"ratios": list(self.ratios)}


_ELD_SOURCE = (
    "K. Wei et al., Physics-based Noise Modeling for Extreme Low-light Photography, TPAMI 2021, results on the ELD "
    "dataset; ELD repository, commit 53d5408, test_ELD.py, models/ELD_model.py, util/index.py"
)
_SID_SOURCE = (
    "K. Wei et al., Physics-based Noise Modeling for Extreme Low-light Photography, TPAMI 2021, results on SID; ELD "
    "repository, commit 53d5408, test_SID.py, models/ELD_model.py, util/index.py; on the whole frame, as the PMN "
    "repository reports it (commit d207d3e, README), where the ELD paper has the centre 512 x 512"
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
        Protocol(
            name="sid",
            title="SID scored as ELD is: packed raw, full frame, white level 16383, one scalar per image",
            source=_SID_SOURCE,
            dataset="sid",
            ratios=(100, 250, 300),
            levels="published",
            reference_clip="both",
            region="full",
            rescaling="scalar",
        ),
        Protocol(
            name="sid-uncorrected",
            title="SID without the scalar: the prediction's own brightness counts",
            source=_SID_SOURCE + "; without the illuminance correction",
            dataset="sid",
            ratios=(100, 250, 300),
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


def default_protocol(dataset: str) -> Protocol:
    """Return the protocol that scores a dataset unless another is named; for a set of your own that is ``eld``."""
    return next((protocol for protocol in PROTOCOLS.values() if protocol.covers(dataset)), PROTOCOLS["eld"])
