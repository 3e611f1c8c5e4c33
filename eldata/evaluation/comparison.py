"""The comparison of methods with the first of them, on the images or clips that all have scores of."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any, TypeAlias

from eldata.base.numbers import counted
from eldata.base.tables import Strong, block, latex_table, markdown_table, markdown_text, table, text_table, wrapped
from eldata.base.visible import in_line, shown
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation import scores as scoring
from eldata.evaluation import statistics
from eldata.evaluation.scores import PaperTable, UnitScore, factor_text, means, short_digest
from eldata.evaluation.statistics import FEWEST_SCENES, LEVEL, Difference, holm, list_clusters, over_scenes

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Mapping, Sequence

    from eldata.base.tables import Format
    from eldata.evaluation.results import EvaluationResult
    from eldata.metrics import registry
    from eldata.metrics.registry import Kind

Images: TypeAlias = "Sequence[tuple[UnitScore, ...]]"
"""Of each image the score by each method."""

Pairings: TypeAlias = tuple[tuple[UnitScore, UnitScore], ...]  # by the first method and by another

# What of the provenance decides neither which images are scored nor against what.
_NOT_DECIDING = (
    *("predictions", "protocol_digest", "included_flags", "equal_choices", "task"),
    *("eldata", "python", "libraw", "numpy", "numba", "rawpy", "imagecodecs", "scipy"),
)
# What of it chooses the images, which does not count where the same were chosen.
_CHOOSING = ("cameras", "subset", "ids", "ratios", "set_aside", "excluded_flags")
_SHOWN = 10  # biggest wins, and losses

LABELS = 3
"""How many cells at the beginning of each row of a table are labels: camera, factor, how many images."""


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
class Contest:
    """Two of the methods on all common images.

    Attributes
    ----------
    first, other
        Their names.
    gains
        How much the other is above the first, by the metric's name.
    corrected
        The p-values, corrected for the number of all tests, by metric (:func:`~statistics.holm`).
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
    results
        Of each method, by its name; the others are compared with the first.
    images
        Scores of each common image by each method, in the first's order.
    groups
        Camera by factor, each factor over all cameras, and all.
    warnings
        Why the numbers may not compare, with the fields that differ.
    contests
        Each method against each other, of three or more.
    """

    results: dict[str, EvaluationResult]
    images: tuple[tuple[UnitScore, ...], ...]
    groups: tuple[Group, ...]
    warnings: tuple[str, ...]
    contests: tuple[Contest, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The methods' names."""
        return tuple(self.results)

    @property
    def first(self) -> EvaluationResult:
        """The result of the first method."""
        return self.results[self.names[0]]

    @property
    def kind(self) -> Kind:
        """Images or clips, with the metrics that every method has."""
        return _common_kind(list(self.results.values()))

    @property
    def whole(self) -> Group:
        """The group of all common images."""
        return self.groups[-1]

    def pairings(self, index: int) -> Pairings:
        """Return the scores by the first method and by the method of this index among the others, image by image."""
        return tuple((scores[0], scores[index + 1]) for scores in self.images)

    def worst_first(self) -> list[int]:
        """Return the images' indices by how far another method falls behind the first, the farthest first.

        Where both have an infinite PSNR, they do not differ; what is not known comes last.
        """

        def worst_gain_db(index: int) -> float:
            """Find the lowest gain in PSNR of another method over the first, on one image."""
            first, *others = self.images[index]
            gains = [0.0 if score.psnr_db == first.psnr_db else score.psnr_db - first.psnr_db for score in others]
            return min((gain for gain in gains if not math.isnan(gain)), default=math.inf)

        return sorted(range(len(self.images)), key=worst_gain_db)

    def extremes(self, index: int) -> tuple[Pairings, Pairings]:
        """Return the pairings with the biggest wins of a method by PSNR, and those with its biggest losses."""
        gains = [(other.psnr_db - first.psnr_db, (first, other)) for first, other in self.pairings(index)]
        known = sorted((gain for gain in gains if math.isfinite(gain[0])), key=lambda gain: gain[0])
        wins = tuple(pairing for gain_db, pairing in known[::-1][:_SHOWN] if gain_db > 0)
        return wins, tuple(pairing for gain_db, pairing in known[:_SHOWN] if gain_db < 0)

    def __repr__(self) -> str:
        psnr = self.kind.metric("psnr_db")
        texts = [
            f"{name} {psnr.format(means[psnr.name])}" for name, means in zip(self.names, self.whole.means, strict=True)
        ]
        warned = f"; {counted(len(self.warnings), 'warning')}" if self.warnings else ""
        return f"Comparison({len(self.images)} common {self.kind.units}; PSNR {in_line(', '.join(texts))}{warned})"

    def _repr_html_(self) -> str:
        """Render the table of means for notebooks."""
        means = means_table(self)
        heading = f"{len(self.names)} methods on {len(self.images)} common {self.kind.units}"
        return block(heading, table(means.header, means.rows, means.left), notes=self.warnings)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
        values = {
            "methods": [
                {
                    "name": name,
                    "file": result.source,
                    "scored": result.scored,
                    "protocol": result.protocol.as_dict(),
                    "provenance": result.provenance,
                }
                for name, result in self.results.items()
            ],
            "warnings": list(self.warnings),
            "statistics": {
                "level": LEVEL,
                "resamples": statistics.RESAMPLES,
                "seed": statistics.SEED,
                "clusters": ["scene"] if self.first.scenes_shared else ["camera", "scene"],
            },
            "common": [scores[0].path for scores in self.images],
            "groups": [asdict(group) for group in self.groups],
            "contests": [asdict(contest) for contest in self.contests],
        }
        return scoring.json_object(values)


def compare(results: Mapping[str, EvaluationResult]) -> Comparison:
    """Compare methods with the first on their common images or clips.

    Parameters
    ----------
    results
        Of each method, by its name, as :func:`~eldata.evaluation.evaluate_methods` returns them.

    Raises
    ------
    ArgumentError
        If there are fewer than two methods, or results of images and of clips.
    EldataError
        If no image is common to all.
    """
    if len(results) < 2:
        raise ArgumentError(f"a comparison needs two results or more; found {len(results)}")
    (name, first), *others = results.items()
    units = first.kind.units
    for other, result in others:
        if (theirs := result.kind.units) != units:
            raise ArgumentError(f"{name} has scores of {units}, {other} of {theirs}; these do not compare")
    kind = _common_kind(list(results.values()))
    scores = [{score.path: score for score in result.scores} for result in results.values()]
    common = [path for path in scores[0] if all(path in of for of in scores)]
    if not common:
        counts = ", ".join(f"{name}: {result.scored} of {result.dataset}" for name, result in results.items())
        raise EldataError(f"no {kind.unit} is common to the results ({counts}); compare results on the same dataset")
    images = tuple(tuple(of[path] for of in scores) for path in common)
    return Comparison(
        results=dict(results),
        images=images,
        groups=_compare_groups(images, kind.metrics, first),
        warnings=_write_warnings(results, len(images)),
        contests=_compare_all(results, images, kind.metrics) if len(results) > 2 else (),
    )


def _common_kind(results: Sequence[EvaluationResult]) -> Kind:
    """Keep the columns that all results have; tasks of different label or direction are different columns."""
    first, *others = (result.kind for result in results)
    return replace(first, metrics=tuple(m for m in first.metrics if all(m in other.metrics for other in others)))


def _compare_groups(images: Images, metrics: Sequence[registry.Figure], result: EvaluationResult) -> tuple[Group, ...]:
    """Average scores and differences to the first method in each group of camera and ratio."""
    names = [metric.name for metric in metrics]
    groups = []
    keys = [(scores[0].camera, scores[0].ratio) for scores in images]
    for camera, ratio in scoring.list_groups(keys, result.dataset):
        members = [
            scores for scores in images if camera in (None, scores[0].camera) and ratio in (None, scores[0].ratio)
        ]
        places = list_clusters((scores[0] for scores in members), scenes_shared=result.scenes_shared)
        first, *others = zip(*members, strict=True)
        averages = tuple(means(scores, names) for scores in (first, *others))
        gains = tuple(_subtract(first, other, names, places) for other in others)
        groups.append(Group(camera, ratio, len(members), len(set(places)), averages, gains))
    return tuple(groups)


def _compare_all(
    results: Mapping[str, EvaluationResult], images: Images, metrics: Sequence[registry.Figure]
) -> tuple[Contest, ...]:
    """Compare each method with each other, with p-values corrected for the number of comparisons."""
    names = [metric.name for metric in metrics]
    shared = next(iter(results.values())).scenes_shared
    places = list_clusters((scores[0] for scores in images), scenes_shared=shared)
    pairs = list(combinations(zip(results, zip(*images, strict=True), strict=True), 2))
    gains = [_subtract(first, other, names, places) for (_, first), (_, other) in pairs]
    corrected = iter(holm([difference.p_value for of in gains for difference in of.values()]))
    return tuple(
        Contest(first, other, of, {name: next(corrected) for name in of})
        for ((first, _), (other, _)), of in zip(pairs, gains, strict=True)
    )


def _subtract(
    first: Sequence[UnitScore], other: Sequence[UnitScore], names: Iterable[str], places: Sequence[Hashable]
) -> dict[str, Difference]:
    """Return the differences, the other's scores minus the first's, by the name of the value."""
    return {
        name: statistics.paired_difference(
            [score.values[name] for score in first], [score.values[name] for score in other], places
        )
        for name in names
    }


# --- warnings -----------------------------------------------------------------------------------------------------


def _write_warnings(results: Mapping[str, EvaluationResult], common: int) -> tuple[str, ...]:
    """Warn of settings that differ between methods, and of images that some methods lack."""
    (name, first), *others = results.items()
    warnings = []
    for other, result in others:
        differences = [f"protocol: {words}" for words in first.scored_unlike(result)]
        a, b = first.provenance, result.provenance
        differences += _list_differences(a, b, (*_NOT_DECIDING, *(_CHOOSING if first.chosen == result.chosen else ())))
        if a.get("task") is not None and b.get("task") is not None:
            differences += [f"task {words}" for words in _list_differences(a["task"], b["task"])]
        warnings += [f"{name} and {other} may not compare: {words}" for words in differences]
    for name, result in results.items():
        scored, expected, kind = result.scored, result.expected, result.kind
        if scored > common:
            warnings.append(
                f"{name} has scores of {scored} {kind.units}, of which {common} are common to all and count"
            )
        if scored < expected:
            warnings.append(f"{name} is incomplete: {scored} of {expected} {kind.counted} were scored")
    return tuple(warnings)


def _list_differences(first: Mapping[str, Any], second: Mapping[str, Any], ignored: Sequence[str] = ()) -> list[str]:
    """List the fields that differ, each in words with both values."""
    return [
        f"{name.replace('_', ' ')}: {_format_value(first, name)} against {_format_value(second, name)}"
        for name in dict.fromkeys((*first, *second))
        if name not in ignored and ((name in first) != (name in second) or first.get(name) != second.get(name))
    ]


def _format_value(fields: Mapping[str, Any], name: str) -> str:
    """Format a field of a result's settings; a digest is shortened."""
    if name not in fields:
        return "not stated"
    value = fields[name]
    is_digest = isinstance(value, str) and value.startswith("sha256:")
    return short_digest(value) if is_digest else shown(value)


# --- tables -----------------------------------------------------------------------------------------------------------


def means_table(comparison: Comparison, times: str = "x") -> PaperTable:
    """Return the means of each method by group; what prints like the best of its row is :class:`Strong`."""
    kind = comparison.kind
    heads = [f"{name} {metric.unit or metric.label}" for name in comparison.names for metric in kind.metrics]
    return _lay_out(comparison, heads, [_mean_texts(group, kind) for group in comparison.groups], times)


def gains_table(comparison: Comparison, index: int, times: str = "x") -> PaperTable:
    """Return differences to the first method by group, of the method of this index among the others."""
    kind = comparison.kind
    heads = ["scenes", *(head for metric in kind.metrics for head in (metric.heading, f"{LEVEL:.0%} interval", "p"))]
    texts = [[str(group.scenes), *_gain_texts(group.gains[index], kind)] for group in comparison.groups]
    return _lay_out(comparison, heads, texts, times)


def contests_table(comparison: Comparison) -> PaperTable:
    """Return each method against each other on all common images, with p-values corrected for their number."""
    kind = comparison.kind
    heads = (head for metric in kind.metrics for head in (metric.heading, f"{LEVEL:.0%} interval", "p", "p (Holm)"))
    rows = (
        (contest.other, contest.first, *_gain_texts(contest.gains, kind, contest.corrected))
        for contest in comparison.contests
    )
    return PaperTable(("method", "minus", *heads), tuple(rows), (0, 1))


def contests_note(comparison: Comparison) -> str:
    """Explain the corrected p-values in a sentence."""
    count = len(comparison.contests) * len(comparison.kind.metrics)
    return (
        f"p (Holm) is corrected for the {count} tests of this table together: of differences with p (Holm) below 0.05, "
        "the chance that even one is none is 5% at most. The other tables are not corrected."
    )


def _lay_out(comparison: Comparison, heads: Sequence[str], texts: Sequence[Sequence[str]], times: str) -> PaperTable:
    """Lay out texts as a table, a row for each group of camera and ratio, with its number of images."""
    counted = [(str(group.images), *cells) for group, cells in zip(comparison.groups, texts, strict=True)]
    groups = [(group.camera, group.ratio) for group in comparison.groups]
    return scoring.grouped_table(groups, (comparison.kind.units, *heads), counted, times)


def _mean_texts(group: Group, kind: Kind) -> list[str]:
    """Return the means of each method as printed."""
    columns = []
    for metric in kind.metrics:
        values = [means[metric.name] for means in group.means]
        texts = [metric.format(value) for value in values]
        known = [value for value in values if not math.isnan(value)]
        best = metric.format((max if metric.sign > 0 else min)(known)) if known else ""
        columns.append([Strong(text) if text == best else text for text in texts])
    return [text for each in zip(*columns, strict=True) for text in each]


def _gain_texts(gains: Mapping[str, Difference], kind: Kind, corrected: Mapping[str, float] | None = None) -> list[str]:
    """Return difference, interval, p-value and, if there is one, corrected p-value of each metric as printed."""
    cells = []
    for metric in kind.metrics:
        difference, interval = gains[metric.name], gains[metric.name].interval
        reach = f"{metric.format_difference(interval.low)} to {metric.format_difference(interval.high)}"
        cells += [metric.format_difference(interval.mean), reach if interval.is_known else "-"]
        cells += [_p_text(difference.p_value), *([_p_text(corrected[metric.name])] if corrected else [])]
    return cells


def signed_text(value: float, decimals: int) -> str:
    """Return a difference with its sign; ``-`` for one that is not known."""
    return f"{value:+.{decimals}f}" if not math.isnan(value) else "-"


def _p_text(p_value: float) -> str:
    """Return a p-value as printed: three decimals, ``<0.001`` below."""
    if math.isnan(p_value):
        return "-"
    return f"{p_value:.3f}" if p_value >= 0.0005 else "<0.001"


def format_comparison(comparison: Comparison, form: Format) -> str:
    """Return the tables: means of every method, each method's differences to the first, and each against each."""
    first, *others = comparison.names
    summary, note = summary_of(comparison), statistics_note(comparison)
    # What a label of LaTeX ends with, title, cells and note of each.
    tables = [("methods", "Means", means_table(comparison), "PSNR in dB.")]
    for index, other in enumerate(others):
        tables.append((other, f"{other} minus {first}", gains_table(comparison, index), note))
    notes = [note]
    if comparison.contests:
        notes.append(contests_note(comparison))
        tables.append(("contests", "Each against each", contests_table(comparison), " ".join(notes)))
    if form == "latex":
        label = f"tab:{comparison.first.dataset}-{comparison.first.protocol.name}"
        return "\n\n".join(
            latex_table(
                cells.header,
                cells.rows,
                caption=f"{title}: {summary}. {remark}",
                label=f"{label}-{name}",
                rules=cells.rules,
            )
            for name, title, cells, remark in tables
        )
    if form == "markdown":
        blocks = [markdown_text(summary)]
        for _, title, cells, _ in tables:
            blocks += [markdown_text(f"{title}:"), markdown_table(cells.header, cells.rows)]
        remarks = [*notes, *(f"Warning: {text}" for text in comparison.warnings)]
        return "\n\n".join([*blocks, *map(markdown_text, remarks)])
    lines = [summary, ""]
    for name, title, cells, _ in tables:
        plain = LABELS if name == "methods" else len(cells.header)
        header, *rows = ((*row[:plain], *map(_mark_best, row[plain:])) for row in (cells.header, *cells.rows))
        lines += [title, "", text_table(header, rows), ""]
    return "\n".join([*lines, "* best of its row", *(line for text in notes for line in wrapped(text, ""))])


def _mark_best(cell: str) -> str:
    """Return a cell with a star where it is the best of its row, and room for one where it is not."""
    return f"{cell}{'*' if isinstance(cell, Strong) else ' '}"


def summary_of(comparison: Comparison) -> str:
    """Summarise the comparison in a line: methods, images, dataset, protocol."""
    result, kind = comparison.first, comparison.kind
    count, scenes = len(comparison.images), comparison.whole.scenes
    return (
        f"{len(comparison.names)} methods on {count} common {kind.unit if count == 1 else kind.units} of "
        f"{counted(scenes, 'scene')}: {result.dataset}, protocol {result.protocol.name} "
        f"({short_digest(result.digest)})"
    )


def statistics_note(comparison: Comparison) -> str:
    """Explain interval and p-value in a sentence."""
    return (
        f"Interval: {LEVEL:.0%}, Student's t over {over_scenes(shared=comparison.first.scenes_shared)}; p: signs of "
        f"whole scenes flipped, two-sided. An interval needs {FEWEST_SCENES} scenes."
    )
