"""Scores of images and of windows of clips, problems that prevent a score, the table of means."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from eldata.base.numbers import natural, replace_infinities
from eldata.base.visible import in_line
from eldata.manifest.catalogue import shipped_manifest, shipped_names
from eldata.manifest.clips import ClipRecord
from eldata.manifest.verify_report import FIGURE, span_figures
from eldata.records import PairRecord

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from eldata.metrics.registry import Kind


Pair: TypeAlias = PairRecord | ClipRecord
"""What is scored: an image, or a window of a clip."""


# --- scores -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class EvaluationProblem:
    """Something that kept a prediction from being scored, or that should not lie where it lies."""

    path: str
    reason: str

    def __str__(self) -> str:
        return in_line(f"{self.path}: {self.reason}")


class Valued:
    """Numbers by name, ``values``, with attributes for the usual ones."""

    __slots__ = ()
    values: Mapping[str, float]

    @property
    def psnr_db(self) -> float:
        """PSNR in dB; infinite where a prediction equals its reference."""
        return self.values["psnr_db"]

    @property
    def ssim(self) -> float:
        """Structural similarity."""
        return self.values["ssim"]

    @property
    def rescale(self) -> float:
        """The factor that the protocol multiplied a prediction by; 1 if it does not rescale."""
        return self.values["rescale"]


@dataclass(frozen=True, slots=True)
class FrameScore:
    """Scores of one frame of a clip; ``path`` is the noisy frame's, ``rescale`` the factor that it was given."""

    path: str
    psnr_db: float
    ssim: float
    rescale: float


@dataclass(frozen=True, slots=True)
class UnitScore(Valued):
    """Scores of one prediction: of an image, or of the window of a clip.

    Attributes
    ----------
    path, camera, scene
        Of the noisy frame; of a clip's first scored one.
    iso
        0 where it is not known.
    ratio
        The nominal low-light factor; ``None`` where the manifest states none.
    values
        The numbers of the protocol's kind (:attr:`eldata.metrics.registry.Kind.values`); those of a clip are means over
        its frames, and ST-RRED's. Infinite PSNR: the prediction equals the reference. nan: not known.
    split, start, frames
        Of a clip: its split, the position of the first scored frame, the scores of each.
    """

    path: str
    camera: str
    scene: str
    iso: float
    ratio: float | None
    values: dict[str, float] = field(hash=False)
    split: str = ""
    start: int = 0
    frames: tuple[FrameScore, ...] = ()

    @property
    def place(self) -> tuple[str, str]:
        """Camera and scene."""
        return self.camera, self.scene

    @property
    def name(self) -> str:
        """What a person calls it: the path of an image, the number of a clip."""
        return self.scene if self.frames else self.path

    def row(self, kind: Kind) -> dict[str, Any]:
        """Return the columns of its kind's CSV; ``frames`` is their number."""
        facts = self.values | {"frames": len(self.frames)}
        return {name: facts[name] if name in facts else getattr(self, name) for name in kind.columns}

    def as_dict(self, kind: Kind) -> dict[str, Any]:
        """Return the score as plain types, of a clip with the scores of each frame."""
        more = {"frame_scores": [asdict(frame) for frame in self.frames]} if self.frames else {}
        return self.row(kind) | more


def mean(values: Collection[float] | NDArray[np.float64]) -> float:
    """Return the mean, summed exactly; nan of nothing, and of infinities of both signs."""
    try:
        return math.fsum(values) / len(values) if len(values) else math.nan
    except ValueError:
        return math.nan


def means(scores: Sequence[UnitScore], names: Iterable[str]) -> dict[str, float]:
    """Return the mean of each value of these names."""
    return {name: mean([score.values[name] for score in scores]) for name in names}


def json_object(values: dict[str, Any]) -> dict[str, Any]:
    """Return plain types as JSON has them: nan as ``None``, infinities as text."""
    plain: dict[str, Any] = replace_infinities(values, lambda value: None if math.isnan(value) else str(value))
    return plain


def csv_number(value: object) -> object:
    """Return a value as a CSV cell: 800, not 800.0; repr of any other float reads back the same."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def finite_values(scores: Iterable[UnitScore], name: str) -> tuple[float, ...]:
    """List a value, such as ``psnr_db``, of the scores in which it is finite."""
    return tuple(score.values[name] for score in scores if math.isfinite(score.values[name]))


# --- the table --------------------------------------------------------------------------------------------------------


# A set whose pairs nearly all have factors of their own (LRD: 27 among 60) is not laid out by them.
_MOST_FACTORS = 12


@dataclass(frozen=True, slots=True)
class TableRow(Valued):
    """Means over a group. ``camera`` or ``ratio`` is ``None`` where the group spans all of them."""

    camera: str | None
    ratio: float | None
    pairs: int
    scored: int
    values: dict[str, float]

    def holds(self, score: UnitScore) -> bool:
        """Check whether a score belongs to this group."""
        return self.camera in (None, score.camera) and self.ratio in (None, score.ratio)

    @property
    def coverage(self) -> str:
        """How many were scored, as printed."""
        return str(self.pairs) if self.scored == self.pairs else f"{self.scored} of {self.pairs}"

    def texts(self, kind: Kind) -> tuple[str, ...]:
        """Return coverage and means as printed; ``-`` where nothing was scored."""
        return self.coverage, *(m.format(self.values[m.name]) if self.scored else "-" for m in kind.metrics)

    def as_dict(self, kind: Kind) -> dict[str, Any]:
        """Return the row as plain types."""
        return {"camera": self.camera, "ratio": self.ratio, kind.counted: self.pairs, "scored": self.scored} | (
            self.values
        )


def list_groups(items: Sequence[tuple[str, float | None]], dataset: str = "") -> list[tuple[str | None, float | None]]:
    """Return the groups of a table over cameras and factors: camera by factor, each factor over all, and all.

    A set without factors, or with more than twelve, has each camera, if there are several, and all. Cameras come in the
    order of the set of this name (:func:`cameras_in_order`).
    """
    cameras = cameras_in_order((camera for camera, _ in items), dataset)
    ratios = sorted({ratio for _, ratio in items if ratio is not None})
    if len(ratios) > _MOST_FACTORS:
        ratios = []
    found = set(items)
    groups: list[tuple[str | None, float | None]] = [
        (camera, ratio) for camera in cameras for ratio in ratios if (camera, ratio) in found
    ]
    if len(cameras) > 1:
        groups += [(None, ratio) for ratio in ratios] if ratios else [(camera, None) for camera in cameras]
    return [*groups, (None, None)]


def table_of(pairs: Sequence[Pair], scores: Sequence[UnitScore], kind: Kind, dataset: str = "") -> tuple[TableRow, ...]:
    """Return the means over the groups of these pairs, of the dataset of this name."""
    keys = [(pair.camera, pair.nominal_ratio) for pair in pairs]
    rows = []
    for camera, ratio in list_groups(keys, dataset):
        empty = TableRow(camera, ratio, 0, 0, {})
        members = [score for score in scores if empty.holds(score)]
        count = sum(camera in (None, key[0]) and ratio in (None, key[1]) for key in keys)
        names = [metric.name for metric in kind.metrics]
        rows.append(TableRow(camera, ratio, count, len(members), means(members, names)))
    return tuple(row for row in rows if row.pairs)


@dataclass(frozen=True, slots=True)
class PaperTable:
    """Cells of a table, as papers lay it out.

    Attributes
    ----------
    header, rows
        Texts.
    left
        Columns that stand to the left.
    rules
        Rows with a line above.
    transposed
        Whether the means of a row of the result stand in a column.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[int, ...]
    rules: tuple[int, ...] = ()
    transposed: bool = False


def grouped_table(
    groups: Sequence[tuple[str | None, float | None]],
    names: Sequence[str],
    texts: Sequence[Sequence[str]],
    times: str = "x",
) -> PaperTable:
    """Return a row of texts for each group of camera and factor, with the camera's name once."""
    cameras = ["all" if camera is None else camera for camera, _ in groups]
    starts = [index for index, camera in enumerate(cameras) if not index or camera != cameras[index - 1]]
    cells = tuple(
        (cameras[index] if index in starts else "", factor_text(ratio, times), *texts[index])
        for index, (_, ratio) in enumerate(groups)
    )
    return PaperTable(("camera", "factor", *names), cells, (0,), tuple(starts[1:]))


def factor_text(ratio: float | None, times: str = "x") -> str:
    """Return a factor as printed, ``x100``, or ``all``; ``times`` is the sign of multiplication."""
    return "all" if ratio is None else f"{times}{ratio:g}"


def short_digest(digest: str) -> str:
    """Return the beginning of a digest that tells it from others: ``sha256:`` and eight digits."""
    return digest[:15]


# --- the order in which people read -----------------------------------------------------------------------------------


def cameras_in_order(cameras: Iterable[str], dataset: str) -> list[str]:
    """Return names of cameras once each: in the order of the card, and of its paper, of a set that comes with eldata.

    Others, and those of a set of the user's own, follow by their names.
    """
    known = list(shipped_manifest(dataset).card.cameras) if dataset in shipped_names() else []
    found = set(cameras)
    return [name for name in known if name in found] + sorted(found.difference(known), key=natural)


# --- problems in words ------------------------------------------------------------------------------------------------


_LINES_SHOWN, _NAMES_SHOWN = 20, 6


def problem_lines(problems: Sequence[EvaluationProblem]) -> list[str]:
    """Return problems as lines of text, the first of many; those that differ only in figures stand together."""
    alike: dict[str, list[EvaluationProblem]] = {}
    for problem in problems:
        alike.setdefault(FIGURE.sub("0", problem.reason), []).append(problem)
    lines: list[str] = []
    shown = 0
    for members in alike.values():
        paths, reason = [problem.path for problem in members], span_figures([problem.reason for problem in members])
        if len(lines) >= _LINES_SHOWN:
            return [*lines, f"... and {len(problems) - shown} more (--json FILE lists all)"]
        if len(paths) == 1:
            lines.append(in_line(f"{paths[0]}: {reason}"))
        else:
            more = f" and {len(paths) - _NAMES_SHOWN} more" if len(paths) > _NAMES_SHOWN else ""
            names = in_line(f"  {', '.join(paths[:_NAMES_SHOWN])}{more}")
            lines += [in_line(f"{len(paths)} alike: {reason}"), names]
        shown += len(paths)
    return lines
