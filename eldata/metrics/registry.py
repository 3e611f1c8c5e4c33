"""The metrics: meaning, display and function of each, and the tables of the metrics of images and of clips.

A metric more is its function in a module of its own, an entry here, and its test. Tables, CSV, JSON, pages, comparisons
and help read the entry. Nothing heavy is imported here: help shows it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

from eldata.errors import check_choice

Rescaling = Literal["none", "scalar"]
PredictionClamp = Literal["both", "before", "none"]
Rounding = Literal["none", "8-bit", "8-bit-truncated"]
SsimWindow = Literal["uniform-7", "gaussian-11", "gaussian-11-volume"]
Covariance = Literal["sample", "population"]
Better = Literal["higher", "lower", "neither"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A score, such as PSNR, as every place shows it.

    Attributes
    ----------
    name
        Its column in CSV and key in JSON, such as ``psnr_db``.
    label
        Its name in tables and sentences, in plain letters, such as ``PSNR``.
    meaning
        One line that explains it.
    decimals
        Of a mean in a table.
    fine_decimals
        Of a difference of two, and of one value among many. Default: ``decimals``.
    unit
        In plain letters, such as ``dB``; empty: it has none.
    better
        Which of two values is the better one.
    computed_by
        The function that does it, ``module:name``, so that a declaration imports nothing; empty: it is not stated.
    """

    name: str
    label: str
    meaning: str
    decimals: int
    fine_decimals: int | None = None
    unit: str = ""
    better: Better = "neither"
    computed_by: str = ""

    @property
    def heading(self) -> str:
        """Its label with the unit, as the head of a column of text, Markdown and LaTeX: ``PSNR [dB]``."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    @property
    def sign(self) -> int:
        """1 if a higher value is better, -1 if a lower one is, else 0: times a difference, who is ahead."""
        return {"higher": 1, "lower": -1, "neither": 0}[self.better]

    def format(self, value: float) -> str:
        """Return a mean as tables show it: nan as ``-``, an infinite one as ``inf``."""
        return "-" if math.isnan(value) else f"{value:.{self.decimals}f}"

    def format_single(self, value: float, sign: str = "") -> str:
        """Return one value among many, such as one image's; ``sign`` ``+`` writes a plus sign, too."""
        decimals = self.decimals if self.fine_decimals is None else self.fine_decimals
        return "-" if math.isnan(value) else f"{value:{sign}.{decimals}f}"

    def format_difference(self, value: float) -> str:
        """Return a difference of two values with its sign."""
        return self.format_single(value, "+")


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


# --- tables -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Kind:
    """Images or clips: what is scored, and the columns of its tables.

    Attributes
    ----------
    unit, counted
        What one score is of, and what coverage counts: images score pairs.
    metrics
        What tables have means of.
    values
        Every number of a score.
    facts
        What the scores' CSV says before them.
    """

    unit: str
    counted: str
    metrics: tuple[Figure, ...]
    values: tuple[str, ...]
    facts: tuple[str, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the scores' CSV."""
        return (*self.facts, *self.values)

    @property
    def units(self) -> str:
        """Several of its units, which is also the scores' name in the JSON."""
        return f"{self.unit}s"

    @property
    def is_of_clips(self) -> bool:
        """Whether windows of clips are scored, with whatever further columns."""
        return self.unit == CLIPS.unit

    def having(self, metric: Figure) -> Kind:
        """Add a column: the metric of a user's own task."""
        return replace(self, metrics=(*self.metrics, metric), values=(*self.values, metric.name))

    def metric(self, name: str) -> Figure:
        """Find a column by its name.

        Raises
        ------
        ArgumentError
            If there is none; the message lists those that there are.
        """
        known = {metric.name: metric for metric in self.metrics}
        check_choice("metric", name, known)
        return known[name]

    @property
    def heads(self) -> tuple[str, ...]:
        """Columns of a table of means."""
        return self.counted, *(metric.heading for metric in self.metrics)


IMAGES: Final = Kind(
    unit="image",
    counted="pairs",
    metrics=(*OF_FRAMES.values(),),
    values=(*OF_FRAMES, RESCALE.name),
    facts=("path", "camera", "scene", "iso", "ratio"),
)
CLIPS: Final = Kind(
    unit="video",
    counted="videos",
    metrics=(*OF_FRAMES.values(), ST_RRED),
    values=(*OF_FRAMES, *OF_CLIPS, RESCALE.name),
    facts=("scene", "split", "camera", "start", "frames"),
)
