"""What of a protocol decides a score, as one canonical list without prose, and its digest.

The list has a version, :data:`VERSION`, which stands for what no field says: the definitions of PSNR, SSIM and ST-RRED,
the order of the steps. A field with its neutral value is not in the list. So a field that is added later, whose neutral
value means what was done before there was the field, changes no digest; neither does rewording a sentence.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

VERSION: Final = 1

SCORED: Final = "scored"
"""Value of ``rescaling_region``: the region that is scored."""

NEUTRAL: Final[Mapping[str, Any]] = {
    "ratios": [],
    "subset": None,
    "cameras": [],
    "scenes": [],
    "input_clip": "both",
    "amplification": "metadata",
    "dark_shading": "none",
    "space": "raw",
    "rendering": "none",
    "input_space": "raw",
    "prediction_space": "raw",
    "response": "gamma-2.2",
    "rescaling_mask": "unsaturated",
    "rescaling_region": SCORED,
    "prediction_clamp": "both",
    "rounding": "none",
    "data_range": 1.0,
    "mse_offset": 0.0,
    "ssim_window": "uniform-7",
    "ssim_covariance": "sample",
    "quantisation": "none",
    "ssim_planes": "packed",
}
"""What a protocol means that does not state a field. These values stay as they are for ever: digests depend on them."""

_PROSE: Final = ("name", "title", "source", "family", "psnr", "ssim", "st_rred", "reference")

CHOOSING: Final = ("dataset", "ratios", "subset", "cameras", "scenes")
"""What chooses the pairs."""

OF_INPUT: Final = ("input_clip", "amplification", "dark_shading", "input_space")
"""What describes the noisy input: it decides the score of the input itself, and of a prediction through its method."""

OF_THE_FACTOR: Final = ("rescaling_mask", "rescaling_region")
"""How the factor is found: without effect where there is none."""

_LARGEST_WHOLE: Final = 2**53  # that a float holds


def canonical(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return what decides a score of a protocol's fields: no prose, nothing that is neutral, nothing without effect.

    Parameters
    ----------
    fields
        As :meth:`eldata.protocols.Protocol.as_dict` or a result's JSON has them. What they do not state is neutral.

    Returns
    -------
    dict
        Plain types: numbers are floats, lists are sorted. ``version`` is :data:`VERSION`.
    """
    found = {name: _plain(value) for name, value in fields.items() if name not in _PROSE}
    if found.get("rescaling") == "none":
        found = {name: value for name, value in found.items() if name not in OF_THE_FACTOR}
    elif found.get("rescaling_region") == found.get("region"):
        found.pop("rescaling_region", None)
    if found.get("rendering") == "libraw":  # which says it already
        found.pop("prediction_space", None)
    deciding = {name: value for name, value in found.items() if name not in NEUTRAL or value != NEUTRAL[name]}
    return {"version": VERSION, **deciding}


def scoring(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return what of :func:`canonical` decides the score of a given prediction: neither pairs nor input."""
    return {name: value for name, value in canonical(fields).items() if name not in (*CHOOSING, *OF_INPUT)}


def fields_digest(fields: Mapping[str, Any]) -> str:
    """Return ``sha256:<hex>`` of what decides a score (:func:`canonical`), as JSON with sorted names."""
    return f"sha256:{hashlib.sha256(json.dumps(canonical(fields), sort_keys=True).encode()).hexdigest()}"


def _plain(value: Any) -> Any:
    """Return 100 as 100.0, and a list in an order that does not depend on how it was written."""
    if isinstance(value, (list, tuple)):
        return sorted((_plain(item) for item in value), key=json.dumps)
    exact = type(value) is int and abs(value) <= _LARGEST_WHOLE
    return float(value) if exact else value
