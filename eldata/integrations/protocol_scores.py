"""The score of one image held in tensors, under a named protocol: what the metrics of every framework call."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.errors import ArgumentError
from eldata.metrics.image_score import Score, factor_by, score_by
from eldata.metrics.registry import IMAGES
from eldata.raw.levels import CLIP_RANGES

if TYPE_CHECKING:
    import torch

    from eldata.protocols import Protocol


def protocol_of_tensors(protocol: str | Protocol) -> Protocol:
    """Return a protocol that tensors of raw images, or of both sides in sRGB, can be scored by.

    Parameters
    ----------
    protocol
        A name such as ``eld`` or ``sid-tpami``, the path of a TOML file, or a protocol.

    Raises
    ------
    ArgumentError
        If no protocol has this name, or it is one of clips, or of SSIM of mosaics, or one that renders, which a tensor
        cannot be: predictions in sRGB and references as :func:`eldata.datasets.rgb.raw2rgb` renders them are compared
        as they are.
    """
    from eldata.protocols import get_protocol

    chosen = get_protocol(protocol) if isinstance(protocol, str) else protocol
    if (chosen.space != "raw" and not (chosen.pixels == "srgb" and chosen.is_of_packed)) or chosen.kind is not IMAGES:
        what = "renderings" if chosen.kind is IMAGES else "clips"
        raise ArgumentError(f"protocol {chosen.name!r} is of {what}, which these tensors are not; use eldata evaluate")
    if chosen.ssim_planes == "mosaic":
        raise ArgumentError(
            f"protocol {chosen.name!r} has SSIM of mosaics, and packed tensors do not say where their values lie in "
            "one; use eldata evaluate"
        )
    return chosen


def protocol_score(
    protocol: Protocol, prediction: torch.Tensor, reference: torch.Tensor, *, threads: int | None = None
) -> Score:
    """Return the score of one image, (C, h, w) or (h, w): the protocol's clip of the reference, factor, region, rules.

    The region is cut out here, after the factor was found where the protocol finds it: both are whole frames.
    """
    reference = reference.clamp(*CLIP_RANGES[protocol.reference_clip])
    shape, rules = tuple(reference.shape), protocol.rules
    region, part = (crop[-reference.ndim :] for crop in (protocol.crop(shape), protocol.factor_crop(shape)))
    factor = factor_by(prediction[part], reference[part], rules, threads=threads)
    return score_by(prediction[region], reference[region], rules, factor=factor, threads=threads)
