"""Tasks of the user's own: a function of predictions and their references, scored on the same pairs as PSNR."""

from __future__ import annotations

import inspect
import math
import pickle
import sys
import traceback
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from eldata.base.fields import named_object
from eldata.base.files import sha256_of
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, FileError, check_choice
from eldata.evaluation.scores import short_digest
from eldata.metrics.registry import Figure

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    Image = NDArray[np.float32]
    TaskFunction = Callable[[Image, Image], float]
    Shown = tuple[NDArray[Any], NDArray[Any]]  # a frame's prediction and its reference

TaskImages = Literal["compared", "packed", "srgb"]

_LONGEST_LABEL = 40  # it heads a column


@dataclass(frozen=True, slots=True)
class Task:
    """A function of a prediction and its reference, scored along with PSNR and SSIM.

    It is called as ``function(prediction, reference)`` with arrays (C, h, w) float32 of the region that the protocol
    scores, which it may write to, the prediction clamped and rescaled as the protocol has it. It returns a finite
    number, always the same for the same images. For worker processes it stands at the top level of a module.

    Attributes
    ----------
    function
        The function, or an object with ``__call__``.
    images
        ``"srgb"``: renderings (3, h, w) in R, G, B, of 256 levels in [0, 1], as protocol sid-srgb makes them of packed
        raw. ``"packed"``: packed raw (C, h, w), 1.0 the white level. ``"compared"``: what the protocol compares, which
        is either of these, or (3, h, w) of preprocessed RGB.
    higher_is_better
        Whether a higher value is the better one.
    label
        The head of its column; by default the function's name.
    version
        What decides its values beside its source, such as the digest of a detector's weights; it is recorded.
    """

    function: TaskFunction
    images: TaskImages = "compared"
    higher_is_better: bool = True
    label: str = ""
    version: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.function, type) or not callable(self.function):
            raise ArgumentError(
                f"a task is a function of (prediction, reference), or a Task of one; {self.function!r:.100} is neither"
            )
        check_choice("images", self.images, get_args(TaskImages))
        if not self.label:
            object.__setattr__(self, "label", self.place.rpartition(":")[2].rpartition(".")[2])
        if len(self.label) > _LONGEST_LABEL or in_line(self.label) != self.label:
            raise ArgumentError(f"a task's label is one line of at most {_LONGEST_LABEL} characters: {self.label!r}")

    @classmethod
    def of(cls, given: Task | TaskFunction | str) -> Task:
        """Resolve the argument ``task``: a task, a function with the defaults, or the name of either.

        Raises
        ------
        ArgumentError
            If what ``package.module:name`` names cannot be imported, or is not a function of two images.
        """
        task = named_object(given) if isinstance(given, str) else given
        return task if isinstance(task, Task) else cls(task)

    @property
    def place(self) -> str:
        """``module:name`` of the function, or of the class of an object."""
        source = self._source
        return f"{getattr(source, '__module__', None)}:{source.__qualname__}"

    @property
    def _source(self) -> Any:
        """The function; of a callable object its class, which has a name and a source file."""
        function: Any = inspect.unwrap(self.function.func if isinstance(self.function, partial) else self.function)
        return function if hasattr(function, "__qualname__") else type(function)

    @property
    def provenance(self) -> dict[str, Any]:
        """All that decides its values, as plain types; ``None`` where it is not known."""
        module = sys.modules.get(self._source.__module__)
        file = getattr(module, "__file__", None)
        stated: str | None = self.version or None
        with suppress(PackageNotFoundError):
            stated = stated or version(self.place.partition(":")[0].partition(".")[0])
        return {
            "callable": self.place,
            "source_sha256": None if file is None else sha256_of(Path(file)),
            "version": stated,
            "label": self.label,
            "images": self.images,
            "higher_is_better": self.higher_is_better,
        }

    def check_transportable(self) -> None:
        """Raise :class:`ArgumentError` if worker processes cannot have it."""
        try:
            pickle.dumps(self)
        except Exception as error:  # pickling raises whatever the object's own methods do
            raise ArgumentError(
                f"the task {self.place} cannot be sent to worker processes ({in_line(str(error))}): define it at the "
                "top level of a module, or work in one process (--jobs 1, workers=1)"
            ) from error

    def score(self, shown: Shown, path: str) -> float:
        """Return its value for a frame; ``path`` is its name in messages.

        Raises
        ------
        FileError
            Of the frame, if the function raises, or returns what is not a finite number.
        """
        try:
            made: Any = self.function(*(np.array(image, np.float32) for image in shown))
            value = math.nan if isinstance(made, str) else float(made)
        except Exception as error:  # whatever a function of somebody's own raises is this frame's problem
            place = traceback.extract_tb(error.__traceback__)[-1]
            said = in_line(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
            where = f"{Path(place.filename).name}, line {place.lineno}"
            raise FileError(path, f"the task {self.place} raised {said} ({where})") from error
        if not math.isfinite(value):
            raise FileError(path, f"the task {self.place} returned {in_line(repr(made))}; expected a finite number")
        return value


def stated_figure(stated: Mapping[str, Any]) -> Figure:
    """Describe a task's column by what a result's provenance states of the task."""
    return Figure(
        name="task",
        label=stated["label"],
        meaning=f"the value of {stated['callable']}",
        decimals=3,
        fine_decimals=4,
        better="higher" if stated["higher_is_better"] else "lower",
        computed_by=stated["callable"],
    )


def task_note(task: Mapping[str, Any]) -> str:
    """Describe the values of a task's column in a line."""
    source = f" ({short_digest(task['source_sha256'])})" if task["source_sha256"] else ""
    images = {"compared": "what the protocol compares", "packed": "packed raw", "srgb": "renderings in sRGB"}
    better = "higher" if task["higher_is_better"] else "lower"
    return f"{task['label']}: {task['callable']}{source}, of {images[task['images']]}; {better} is better"
