"""What protocols score, single images or windows of clips: their words and their tables of metrics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from eldata.errors import check_choice
from eldata.metrics.registry import OF_CLIPS, OF_FRAMES, RESCALE, ST_RRED

if TYPE_CHECKING:
    from eldata.base.numbers import Figure


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
        """Return it with one more column: a task of the user's own."""
        return replace(self, metrics=(*self.metrics, metric), values=(*self.values, metric.name))

    def metric(self, name: str) -> Figure:
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
