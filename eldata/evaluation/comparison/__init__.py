"""Methods held against the first of them on the images or clips that all have scores of."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING, Any, TypeAlias

from eldata.base.numbers import counted
from eldata.base.tables import block, table
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.scores import UnitScore, factor_text, grouped_table, groups_of, json_object, means, short_digest
from eldata.evaluation.statistics import LEVEL, RESAMPLES, SEED, Difference, clusters_of, holm, paired_difference

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.base import numbers
    from eldata.evaluation.results import EvaluationResult
    from eldata.plots.axes import Theme
    from eldata.protocols.kinds import Kind

Images: TypeAlias = "Sequence[tuple[UnitScore, ...]]"
"""Of each image the score by each method."""

# What of the provenance decides neither which images are scored nor against what.
_NOT_DECIDING = (
    *("predictions", "protocol_digest", "included_flags", "equal_choices", "task"),
    *("eldata", "python", "libraw", "numpy", "numba", "rawpy", "imagecodecs", "scipy"),
)
# What of it chooses the images, which does not count where the same were chosen.
_CHOOSING = ("cameras", "subset", "ids", "ratios", "set_aside", "excluded_flags")
_SHOWN = 10  # biggest wins, and losses


@dataclass(frozen=True, slots=True)
class Method:
    """A method by its name in tables, and its result."""

    name: str
    result: EvaluationResult


@dataclass(frozen=True, slots=True)
class Group:
    """Common images of a camera and factor; ``None`` spans all of them.

    Attributes
    ----------
    camera, ratio, images, scenes
        Which they are, how many (of clips, too), and of how many scenes.
    means
        Of each method, by the metric's name.
    gains
        How much each method but the first is above the first, by the metric's name.
    """

    camera: str | None
    ratio: float | None
    images: int
    scenes: int
    means: tuple[dict[str, float], ...]
    gains: tuple[dict[str, Difference], ...]

    @property
    def name(self) -> str:
        """Camera and factor in words."""
        parts = ("all" if self.camera is None else self.camera, "" if self.ratio is None else factor_text(self.ratio))
        return " ".join(part for part in parts if part)


@dataclass(frozen=True, slots=True)
class Pairing:
    """Scores of one image by the first method and by another."""

    first: UnitScore
    other: UnitScore

    @property
    def gain_db(self) -> float:
        """By how much the other's PSNR is higher; nan if both are infinite."""
        return self.other.psnr_db - self.first.psnr_db

    @property
    def gain_ssim(self) -> float:
        """By how much the other's SSIM is higher."""
        return self.other.ssim - self.first.ssim

    @property
    def is_finite(self) -> bool:
        """Whether both have a finite PSNR."""
        return math.isfinite(self.first.psnr_db) and math.isfinite(self.other.psnr_db)


@dataclass(frozen=True, slots=True)
class Contest:
    """Two of the methods on all common images.

    Attributes
    ----------
    first, other
        Their names.
    gains
        How much the other is above the first, by the metric's name.
    corrected
        The p-values, corrected for those of all contests and metrics together (:func:`~statistics.holm`).
    """

    first: str
    other: str
    gains: dict[str, Difference]
    corrected: dict[str, float]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Methods on their common images.

    Attributes
    ----------
    methods
        The first is what the others are held against.
    images
        Scores of each common image by each method, in the first's order.
    groups
        Camera by factor, each factor over all cameras, and all.
    warnings
        Why the numbers may not compare, with the fields that differ.
    contests
        Each method against each other, of three or more.
    """

    methods: tuple[Method, ...]
    images: tuple[tuple[UnitScore, ...], ...]
    groups: tuple[Group, ...]
    warnings: tuple[str, ...]
    contests: tuple[Contest, ...] = ()

    @property
    def results(self) -> tuple[EvaluationResult, ...]:
        """The result of each method."""
        return tuple(method.result for method in self.methods)

    @property
    def kind(self) -> Kind:
        """What was scored: images or clips, with the numbers that every method has; a task may be of some."""
        return _common_kind(self.methods)

    @property
    def scenes_shared(self) -> bool:
        """Whether scenes of one name under several cameras are one scene, as the first's set has it."""
        return self.methods[0].result.scenes_shared

    @property
    def whole(self) -> Group:
        """The group of all common images."""
        return self.groups[-1]

    def pairings(self, index: int) -> tuple[Pairing, ...]:
        """Return the scores of the first method and of that of this index among all but the first, image by image."""
        return tuple(Pairing(scores[0], scores[index + 1]) for scores in self.images)

    def worst_first(self) -> list[int]:
        """Return the places of the images, those first on which another method falls farthest behind the first.

        Where both have an infinite PSNR, they do not differ; what is not known comes last.
        """
        gains = [
            [0.0 if other.psnr_db == first.psnr_db else other.psnr_db - first.psnr_db for other in others]
            for first, *others in self.images
        ]
        worst = [min((gain for gain in of if not math.isnan(gain)), default=math.inf) for of in gains]
        return sorted(range(len(worst)), key=worst.__getitem__)

    def extremes(self, index: int) -> tuple[tuple[Pairing, ...], tuple[Pairing, ...]]:
        """Return the biggest wins of that method by PSNR, the biggest first, and its biggest losses."""
        known = sorted((one for one in self.pairings(index) if one.is_finite), key=lambda one: one.gain_db)
        wins = tuple(one for one in known[::-1][:_SHOWN] if one.gain_db > 0)
        return wins, tuple(one for one in known[:_SHOWN] if one.gain_db < 0)

    def plot(self, metric: str = "psnr_db", *, ax: Axes | None = None) -> Figure:
        """Draw how far each method's mean lies above the first one's, by group, with intervals over scenes.

        Parameters
        ----------
        metric
            The name of a column that all methods have, such as ``psnr_db`` or ``ssim``.
        ax
            Axes to draw into; by default those of a new figure, which belongs to no pyplot and shows in a notebook.

        Returns
        -------
        matplotlib.figure.Figure
            That of the axes.

        Raises
        ------
        ArgumentError
            If the methods have no such column, or no difference is finite.
        """
        from eldata.plots.axes import drawn_into, nothing_to_draw
        from eldata.plots.scores import mean_gains

        chosen, (first, *others) = self.kind.metric(metric), self.methods
        gains = [
            (method.name, [group.gains[index][chosen.name].interval.ends for group in self.groups])
            for index, method in enumerate(others)
        ]
        if not any(math.isfinite(mean) for _, ends in gains for mean, _, _ in ends):
            raise nothing_to_draw(f"{metric} of this comparison", "no difference is finite")

        def draw(axes: Axes, theme: Theme) -> None:
            mean_gains(axes, [group.name for group in self.groups], gains, theme)
            axes.set_xlabel(f"difference of {chosen.heading}")

        named = others[0].name if len(others) == 1 else f"{len(others)} methods"
        return drawn_into(ax, f"{named} against {first.name}", draw)

    def __repr__(self) -> str:
        psnr = self.kind.metric("psnr_db")
        texts = [
            f"{method.name} {psnr.format(means[psnr.name])}"
            for method, means in zip(self.methods, self.whole.means, strict=True)
        ]
        warned = f"; {counted(len(self.warnings), 'warning')}" if self.warnings else ""
        return f"Comparison({len(self.images)} common {self.kind.units}; PSNR {in_line(', '.join(texts))}{warned})"

    def _repr_html_(self) -> str:
        metrics = self.kind.metrics
        heads = [f"{method.name} {metric.unit or metric.label}" for method in self.methods for metric in metrics]
        texts = [
            [str(group.images), *(metric.format(means[metric.name]) for means in group.means for metric in metrics)]
            for group in self.groups
        ]
        groups = [(group.camera, group.ratio) for group in self.groups]
        cells = grouped_table(groups, (self.kind.units, *heads), texts)
        heading = f"{len(self.methods)} methods on {len(self.images)} common {self.kind.units}"
        return block(heading, table(cells.header, cells.rows, cells.left), notes=self.warnings)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
        result = {
            "methods": [
                {
                    "name": method.name,
                    "file": method.result.source,
                    "scored": method.result.scored,
                    "protocol": method.result.protocol.as_dict(),
                    "provenance": method.result.provenance,
                }
                for method in self.methods
            ],
            "warnings": list(self.warnings),
            "statistics": {
                "level": LEVEL,
                "resamples": RESAMPLES,
                "seed": SEED,
                "clusters": ["scene"] if self.scenes_shared else ["camera", "scene"],
            },
            "common": [scores[0].path for scores in self.images],
            "groups": [asdict(group) for group in self.groups],
            "contests": [asdict(contest) for contest in self.contests],
        }
        return json_object(result)


def compare(methods: Sequence[Method]) -> Comparison:
    """Compare methods with the first on their common images or clips.

    Raises
    ------
    ArgumentError
        If there are fewer than two methods, two of one name, or results of images and of clips.
    EldataError
        If no image is common to all.
    """
    if len(methods) < 2:
        raise ArgumentError(f"a comparison needs two results or more; found {len(methods)}")
    names = [method.name for method in methods]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ArgumentError(f"two results are called {twice!r}; name each with --name, in the order of the files")
    kind = _common_kind(methods)
    units = methods[0].result.kind.units
    for method in methods[1:]:
        other = method.result.kind.units
        if other != units:
            raise ArgumentError(f"{names[0]} has scores of {units}, {method.name} of {other}; these do not compare")
    scores = [{score.path: score for score in method.result.scores} for method in methods]
    common = [path for path in scores[0] if all(path in others for others in scores[1:])]
    if not common:
        kinds = ", ".join(f"{method.name}: {method.result.scored} of {method.result.dataset}" for method in methods)
        raise EldataError(f"no {kind.unit} is common to the results ({kinds}); compare results on the same dataset")
    images = tuple(tuple(of[path] for of in scores) for path in common)
    return Comparison(
        methods=tuple(methods),
        images=images,
        groups=_groups(images, kind.metrics, methods[0].result),
        warnings=_warnings(methods, images),
        contests=_contests(methods, images, kind.metrics) if len(methods) > 2 else (),
    )


def _common_kind(methods: Sequence[Method]) -> Kind:
    """Return the kind of the first with the columns that all have; a task of another label or direction is another."""
    first, *others = (method.result.kind for method in methods)
    shared = tuple(metric for metric in first.metrics if all(metric in other.metrics for other in others))
    left_out = {metric.name for metric in first.metrics if metric not in shared}
    return replace(first, metrics=shared, values=tuple(name for name in first.values if name not in left_out))


def _groups(images: Images, metrics: Sequence[numbers.Figure], result: EvaluationResult) -> tuple[Group, ...]:
    names = [metric.name for metric in metrics]
    groups = []
    for camera, ratio in groups_of([(scores[0].camera, scores[0].ratio) for scores in images], result.dataset):
        members = [
            scores for scores in images if camera in (None, scores[0].camera) and ratio in (None, scores[0].ratio)
        ]
        places = clusters_of((scores[0] for scores in members), scenes_shared=result.scenes_shared)
        first, *others = zip(*members, strict=True)
        groups.append(
            Group(
                camera,
                ratio,
                images=len(members),
                scenes=len(set(places)),
                means=tuple(means(scores, names) for scores in (first, *others)),
                gains=tuple(_differences(first, other, names, places) for other in others),
            )
        )
    return tuple(groups)


def _contests(methods: Sequence[Method], images: Images, metrics: Sequence[numbers.Figure]) -> tuple[Contest, ...]:
    names = [metric.name for metric in metrics]
    places = clusters_of((scores[0] for scores in images), scenes_shared=methods[0].result.scenes_shared)
    pairs = list(combinations(zip((method.name for method in methods), zip(*images, strict=True), strict=True), 2))
    gains = [_differences(first, other, names, places) for (_, first), (_, other) in pairs]
    corrected = iter(holm([difference.p_value for of in gains for difference in of.values()]))
    return tuple(
        Contest(first, other, of, {name: next(corrected) for name in of})
        for ((first, _), (other, _)), of in zip(pairs, gains, strict=True)
    )


def _differences(
    first: Sequence[UnitScore], other: Sequence[UnitScore], names: Iterable[str], places: Sequence[Hashable]
) -> dict[str, Difference]:
    """Return how much the other's scores are above the first's, by the name of the value."""
    return {
        name: paired_difference(
            [score.values[name] for score in first], [score.values[name] for score in other], places
        )
        for name in names
    }


# --- warnings -----------------------------------------------------------------------------------------------------


def _warnings(methods: Sequence[Method], images: Images) -> tuple[str, ...]:
    first, *others = methods
    kind, common = first.result.kind, len(images)
    found = []
    for other in others:
        a, b = first.result.provenance, other.result.provenance
        fields = [f"protocol: {words}" for words in first.result.scored_unlike(other.result)]
        fields += _differing(a, b, ignored=_CHOOSING if first.result.chosen == other.result.chosen else ())
        if a.get("task") is not None and b.get("task") is not None:
            fields += [f"task {words}" for words in _differing(a["task"], b["task"])]
        found += [f"{first.name} and {other.name} may not compare: {field}" for field in fields]
    # The same image may be said to be another: of another manifest.
    for (index, other), field in product(enumerate(others, start=1), ("camera", "scene", "iso", "ratio")):
        off = [scores for scores in images if getattr(scores[0], field) != getattr(scores[index], field)]
        if off:
            was, now = (getattr(off[0][which], field) for which in (0, index))
            found.append(
                f"{first.name} and {other.name} may not compare: {field} of {len(off)} {kind.units} differs, such "
                f"as {off[0][0].path}: {was} and {now}; the groups below are the first's"
            )
    found += [
        f"{method.name} has scores of {method.result.scored} {kind.units}, of which {common} are common to all "
        "and count"
        for method in methods
        if method.result.scored > common
    ]
    found += [
        f"{method.name} is incomplete: {method.result.scored} of {method.result.expected} {kind.counted} were scored"
        for method in methods
        if method.result.scored < method.result.expected
    ]
    return tuple(found)


def _differing(first: Mapping[str, Any], second: Mapping[str, Any], ignored: Sequence[str] = ()) -> list[str]:
    return [
        f"{name.replace('_', ' ')}: {_value(first, name)} against {_value(second, name)}"
        for name in dict.fromkeys((*first, *second))
        if name not in (*_NOT_DECIDING, *ignored)
        and ((name in first) != (name in second) or first.get(name) != second.get(name))
    ]


def _value(fields: Mapping[str, Any], name: str) -> str:
    if name not in fields:
        return "not stated"
    value = fields[name]
    if isinstance(value, str) and value.startswith("sha256:"):
        return short_digest(value)
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."
