"""What protocols score, single images or windows of clips: their words and their tables of metrics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from eldata.errors import check_choice


@dataclass(frozen=True, slots=True)
class Metric:
    """A column of means.

    Attributes
    ----------
    name
        Field of a score.
    label, unit
        As printed; ``unit`` may be empty.
    places, gain_places, row_places
        Decimals that papers print of a mean, that a difference of two methods needs, and that one score is shown with.
    higher_is_better
        Whether a higher value is the better one.
    """

    name: str
    label: str
    unit: str
    places: int
    gain_places: int
    row_places: int
    higher_is_better: bool = True

    @property
    def head(self) -> str:
        """Its name as a column's head."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def text(self, value: float) -> str:
        """Return a value as papers print it."""
        return f"{value:.{self.places}f}"


@dataclass(frozen=True, slots=True)
class Kind:
    """What is scored.

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
    metrics: tuple[Metric, ...]
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

    def having(self, metric: Metric) -> Kind:
        """Return it with one more column: a task of the user's own."""
        return replace(self, metrics=(*self.metrics, metric), values=(*self.values, metric.name))

    def metric(self, name: str) -> Metric:
        """Return a column by its name.

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
        return self.counted, *(metric.head for metric in self.metrics)


def task_metric(label: str, *, higher_is_better: bool) -> Metric:
    """Return the column of a task of the user's own."""
    return Metric("task", label, "", 3, 4, 4, higher_is_better=higher_is_better)


_PSNR = Metric("psnr_db", "PSNR", "dB", 2, 2, 2)
_SSIM = Metric("ssim", "SSIM", "", 3, 4, 4)  # differences of SSIM are small
_ST_RRED = Metric("st_rred", "ST-RRED", "", 3, 3, 3, higher_is_better=False)

IMAGES: Final = Kind(
    unit="image",
    counted="pairs",
    metrics=(_PSNR, _SSIM),
    values=("psnr_db", "ssim", "rescale"),
    facts=("path", "camera", "scene", "iso", "ratio"),
)
CLIPS: Final = Kind(
    unit="video",
    counted="videos",
    metrics=(_PSNR, _SSIM, _ST_RRED),
    values=("psnr_db", "ssim", "st_rred", "spatial_rred", "temporal_rred", "rescale"),
    facts=("scene", "split", "camera", "start", "frames"),
)
