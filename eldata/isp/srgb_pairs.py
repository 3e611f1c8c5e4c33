"""Packed predictions and references in sRGB, as the ELD code scores them there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import ArgumentError
from eldata.isp.rendering import PAPER_GAMMA, Rendering
from eldata.isp.steps import truncate_to_8_bits

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.isp.rendering import Response
    from eldata.records import Sensor


def render_pair_for_scoring(
    prediction: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    sensor: Sensor,
    *,
    response: Response = PAPER_GAMMA,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Render a packed prediction and its reference to 8-bit sRGB as the ELD code does before it scores them.

    Both are rendered by :class:`~eldata.isp.rendering.Rendering` with the reference file's white balance and matrix
    (the paper's "oracle white balance") and truncated, not rounded, to 8 bits (ELD repository, models/ELD_model.py and
    util/process.py, stage_eval = srgb). A prediction that is rescaled is rescaled first, in raw. There the sums are
    float32; here they are float64 up to the 8 bits, so that the codes do not depend on the machine.

    Parameters
    ----------
    prediction, target
        Packed and normalised, (C, h, w), of the same shape. Values outside [0, 1] are clipped after white
        balance. The ELD code has this for Bayer alone.
    sensor
        The reference's.
    response
        Gamma 2.2, the code's default, or a measured curve, which the paper's tables were made with.

    Returns
    -------
    (ndarray, ndarray)
        (3, h, w) uint8 each, R, G, B. Score them as floating point on data range 255.

    Raises
    ------
    ArgumentError
        If the shapes do not fit or differ, a value is NaN or infinite, or the sensor lacks white balance or matrix.
    """
    import torch

    if prediction.shape != target.shape or target.ndim != 3:
        raise ArgumentError(
            f"expected a prediction and a reference (C, h, w) of one shape; found {prediction.shape} and {target.shape}"
        )
    rendering = Rendering.of(sensor, response)

    def eight_bits(packed: NDArray[np.floating[Any]], name: str) -> NDArray[np.uint8]:
        if not np.isfinite(packed).all():  # before the clips, which infinities pass
            raise ArgumentError(f"the {name} holds NaN or infinities")
        wide = np.ascontiguousarray(packed, dtype=np.float64)
        codes: NDArray[np.uint8] = truncate_to_8_bits(rendering(torch.from_numpy(wide))).numpy()
        return codes

    with torch.no_grad():
        return eight_bits(prediction, "prediction"), eight_bits(target, "reference")
