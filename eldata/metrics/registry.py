"""The metrics: what each is, how it is shown, and what computes it.

A metric more is its function in a module of its own, an entry here, and its test. Tables, CSV, JSON, pages, comparisons
and help read the entry. Nothing heavy is imported here: help shows it.
"""

from __future__ import annotations

from typing import Final, Literal

from eldata.base.numbers import Figure

Rescaling = Literal["none", "scalar"]
RescalingMask = Literal["unsaturated", "all"]
PredictionClamp = Literal["both", "before", "none"]
Rounding = Literal["none", "8-bit", "8-bit-truncated"]
SsimWindow = Literal["uniform-7", "gaussian-11", "gaussian-11-volume"]
Covariance = Literal["sample", "population"]

OF_FRAMES: Final = {
    figure.name: figure
    for figure in (
        Figure(
            name="psnr_db",
            label="PSNR",
            unit="dB",
            meaning="peak signal-to-noise ratio over all channels together; infinite of equal images",
            decimals=2,
            better="higher",
            computed_by="eldata.metrics.image_score:psnr",
        ),
        Figure(
            name="ssim",
            label="SSIM",
            meaning="mean structural similarity",
            decimals=3,
            fine_decimals=4,  # differences of SSIM are small
            better="higher",
            computed_by="eldata.metrics.similarity:ssim",
        ),
    )
}
"""Of a prediction and its reference, (C, h, w) as the protocol compares them; of clips the mean over frames.

PSNR and SSIM are found in one pass (:func:`eldata.metrics.score_by`), each other one by ``computed_by``, a function of
the two images.
"""

ST_RRED: Final = Figure(
    name="st_rred",
    label="ST-RRED",
    meaning="how much spatial and temporal information of a clip is lost or added",
    decimals=3,
    better="lower",
    computed_by="eldata.metrics.st_rred:st_rred",
)

OF_CLIPS: Final = {
    figure.name: figure
    for figure in (
        ST_RRED,
        Figure(name="spatial_rred", label="SRRED", meaning="the spatial part of ST-RRED", decimals=3, better="lower"),
        Figure(name="temporal_rred", label="TRRED", meaning="the temporal part of ST-RRED", decimals=3, better="lower"),
    )
}
"""Of a whole clip; tables have the first."""

RESCALE: Final = Figure(
    name="rescale",
    label="rescaled by",
    meaning="the factor that the protocol multiplied a prediction by; 1 if it does not rescale",
    decimals=3,
    computed_by="eldata.metrics.image_score:rescale_factor",
)
