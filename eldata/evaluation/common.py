"""What evaluations of images and of clips share: versions, problems of prediction files, means, JSON."""

from __future__ import annotations

import math
import platform
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from eldata import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.evaluation.predictions import FoundPredictions


@dataclass(frozen=True, slots=True)
class EvaluationProblem:
    """Something that kept a prediction from being scored, or that should not lie where it lies."""

    path: str
    reason: str

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


def file_problems(found: FoundPredictions, *, allow_missing: bool) -> list[EvaluationProblem]:
    """Return what is wrong with the files of a folder of predictions."""
    problems = [
        EvaluationProblem(path, f"expected one prediction, found {len(names)}: {', '.join(names)}; keep one")
        for path, names in found.ambiguous.items()
    ]
    problems += [
        EvaluationProblem(name, "is the prediction of no noisy frame in the manifest; rename it or move it away")
        for name in found.extra
    ]
    if not allow_missing:
        problems += [
            EvaluationProblem(path, "has no prediction; add it, or score the rest with --allow-missing")
            for path in found.missing
        ]
    return problems


def software() -> dict[str, str]:
    """Return the versions that a score may depend on."""
    import rawpy

    return {
        "eldata": __version__,
        "python": platform.python_version(),
        "libraw": ".".join(map(str, rawpy.libraw_version)),
        **{name: version(name) for name in ("numpy", "numba", "rawpy", "exifread")},
    }


def mean(values: Sequence[float]) -> float:
    """Return the mean, summed exactly; nan of nothing."""
    return math.fsum(values) / len(values) if values else math.nan


def json_safe(value: Any) -> Any:
    """Return plain types as JSON has them: nan as ``None``, infinities as text."""
    if isinstance(value, dict):
        return {key: json_safe(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_safe(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def csv_number(value: object) -> object:
    """Return a value as a CSV cell: 800, not 800.0; repr of any other float reads back the same."""
    return int(value) if isinstance(value, float) and value.is_integer() else value
