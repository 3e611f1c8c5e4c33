"""The same predictions under several protocols: how far the choice of a protocol moves the numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_json
from eldata.base.numbers import counted
from eldata.base.tables import block, table, text_table, wrapped
from eldata.base.visible import in_line
from eldata.evaluation.results import write_scores
from eldata.evaluation.scores import json_object, mean, nothing_scored, problem_lines
from eldata.protocols.digests import CHOOSING, OF_INPUT
from eldata.protocols.words import comparability

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eldata.base.numbers import Figure
    from eldata.base.tables import Format
    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.scores import EvaluationProblem, TableRow


@dataclass(frozen=True, slots=True)
class NotScored:
    """A protocol that is for the dataset and was not scored, and why."""

    protocol: str
    reason: str


@dataclass(frozen=True, slots=True)
class CombinedResult:
    """The results of :func:`eldata.evaluation.evaluate_all`: one per protocol, the dataset's default first."""

    results: tuple[EvaluationResult, ...]
    not_scored: tuple[NotScored, ...] = ()

    @property
    def scored(self) -> int:
        """How many images or clips were scored, under any protocol."""
        return len({score.path for result in self.results for score in result.scores})

    @property
    def groups(self) -> tuple[tuple[EvaluationResult, ...], ...]:
        """The results, those together that share every score: the same pairs, scored in the same way on these files."""
        groups: list[list[EvaluationResult]] = []
        for result in self.results:
            for group in groups:
                if result.chosen == group[0].chosen and not result.scored_unlike(group[0]):
                    group.append(result)
                    break
            else:
                groups.append([result])
        return tuple(map(tuple, groups))

    @property
    def problems(self) -> tuple[EvaluationProblem, ...]:
        """The problems of all results, each once."""
        return tuple(dict.fromkeys(problem for result in self.results for problem in result.problems))

    def shift(self, result: EvaluationResult, name: str) -> tuple[float, int]:
        """Return by how much a result's mean lies above the first result's, over the pairs that both scored.

        So the rules of scoring are compared, not the choice of pairs. ``name`` is the value's, such as ``psnr_db``. The
        second number is that of the pairs; two infinite values differ by 0.
        """
        first = {score.path: score.values[name] for score in self.results[0].scores}
        shared = [(score.values[name], first[score.path]) for score in result.scores if score.path in first]
        return mean([0.0 if one == other else one - other for one, other in shared]), len(shared)

    def is_suspect(self, result: EvaluationResult) -> bool:
        """Return whether the predictions look wrong under a protocol, and not under the first one.

        They were made for other levels, say: its scores then differ from the first's by more than the rules of scoring.
        """
        known = {(one.words, one.where) for one in self.results[0].suspicions}
        return any((one.words, one.where) not in known for one in result.suspicions)

    def is_of_another_space(self, result: EvaluationResult) -> bool:
        """Return whether a protocol compares renderings and the first one raw values: its dB are of other images."""
        return _space(result) != _space(self.results[0])

    def spans(self) -> dict[str, float]:
        """Return how far apart the protocols' means of each metric lie, over the pairs that each shares.

        Protocols under which the predictions are suspect, and those of another space than the first's, are left out.
        """
        sound = [one for one in self.results if not (self.is_suspect(one) or self.is_of_another_space(one))]
        found = {}
        for metric in self.results[0].kind.metrics:
            shifts = [shift for shift, shared in (self.shift(one, metric.name) for one in sound) if shared]
            found[metric.name] = max(shifts) - min(shifts) if shifts else 0.0
        return found

    def format_table(self) -> str:
        """Return a table for each metric: a row per protocol, or for those that share every score, a column per factor.

        Means are over all cameras.
        """
        first = self.results[0]
        ratios = sorted({row.ratio for result in self.results for row in result.table if row.ratio is not None})
        factors = (*(f"x{ratio:g}" for ratio in ratios), "all")
        parts = []
        for metric in first.kind.metrics:
            header = (metric.heading, first.kind.counted, *factors, f"against {first.protocol.name}")
            rows = [self._row(group, ratios, metric) for group in self.groups]
            parts.append(text_table(header, rows, columns=80))
        return "\n\n".join(parts)

    def _row(self, group: tuple[EvaluationResult, ...], ratios: list[float], metric: Figure) -> tuple[str, ...]:
        result = group[0]
        rows = {row.ratio: row for row in overall(result)}
        cells = [
            metric.format(rows[ratio].values[metric.name]) if ratio in rows and rows[ratio].scored else "-"
            for ratio in (*ratios, None)
        ]
        against = ""
        if self.is_suspect(result):
            against = "suspect"
        elif self.is_of_another_space(result):
            against = "in raw" if _space(result) == "raw" else "in sRGB"
        elif result is not self.results[0]:
            difference, shared = self.shift(result, metric.name)
            places = metric.decimals
            against = f"{round(difference, places) + 0.0:+.{places}f}" if shared else "-"
            if 0 < shared < result.scored:
                against += f" ({shared} {result.kind.counted})"
        return (_names(group), result.whole.coverage, *cells, against)

    def _differences(self) -> list[str]:
        """Return in words in what each protocol scores differently from the first."""
        first, *others = self.groups
        lines = []
        for group in others:
            found = [text.replace(" against ", " -> ", 1) for text in first[0].scored_unlike(group[0])]
            text = f"  {_names(group)}: {'; '.join(found) or 'scored alike, the pairs differ'}"
            lines += wrapped(text, " " * 6)
        return lines

    def _shared(self) -> list[str]:
        """Return which protocols share every score, and in words what came to the same on these files."""
        lines = []
        ignored = CHOOSING if self.results[0].of_input else (*CHOOSING, *OF_INPUT)
        for first, *others in (group for group in self.groups if len(group) > 1):
            stated = [one.protocol.as_dict() for one in (first, *others)]
            words = [
                text.replace(" against ", " and ", 1)
                for other in stated[1:]
                for text in comparability(stated[0], other, ignored=ignored)
            ]
            same = f" ({'; '.join(dict.fromkeys(words))} came to the same)" if words else ""
            text = f"the same scores, computed once: {_names((first, *others))}{same}"
            lines += wrapped(text)
        return lines

    def _apart(self) -> str:
        """Return how far apart the protocols' means lie, in words."""
        spans = self.spans()
        sizes = [
            f"{metric.format(spans[metric.name])} {metric.unit or f'in {metric.label}'}"
            for metric in self.results[0].kind.metrics
        ]
        return f"the same predictions lie up to {', '.join(sizes[:-1])} and {sizes[-1]} apart"

    def format(self, form: Format) -> str:
        """Return the results as plain text, or their tables in Markdown or LaTeX, one after the other."""
        return self.format_text() if form == "text" else "\n\n".join(result.format(form) for result in self.results)

    def format_text(self) -> str:
        """Return problems, the tables with what distinguishes the protocols, and notes as text."""
        lines = problem_lines(self.problems)
        if self.problems and not self.scored:
            return "\n".join([*lines, nothing_scored(self.problems)])
        if lines:
            lines.append("")
        first, count = self.results[0], len(self.results)
        cameras = first.provenance["cameras"]
        excluded = "".join(f", without {flag}" for flag in first.provenance["excluded_flags"])
        only = "" if cameras == "all" else f", only {', '.join(cameras)}"
        lines += [f"{first.dataset}, {counted(count, 'protocol')}{only}{excluded}", ""]
        lines += [self.format_table(), ""]
        lines += [
            f"INCOMPLETE: {len(result.missing)} {result.kind.counted} are not in the means of {result.protocol.name}, "
            "so they do not compare with others"
            for result in self.results
            if result.missing
        ]
        shared = self._shared()
        lines += [*shared, ""] if shared else []
        differences = self._differences()
        if differences:
            lines += [
                *wrapped(f"By the protocol alone, on shared {first.kind.counted}, {self._apart()}.", ""),
                "",
                f"Scored differently from {first.protocol.name}:",
                *differences,
                "",
            ]
        suspects: dict[tuple[str, str], str] = {}  # numbers are those of the first that shows it
        for result in self.results:
            for suspicion in result.suspicions:
                suspects.setdefault((suspicion.words, suspicion.where), f"{suspicion} ({result.protocol.name})")
        lines += [line for text in suspects.values() for line in wrapped(text)]
        choices: dict[str, list[str]] = {}
        notes: dict[str, list[str]] = {}
        for result in self.results:
            choices.setdefault(result.coverage, []).append(result.protocol.name)
            for note in result.notes:
                notes.setdefault(note, []).append(result.protocol.name)
        lines += [f"{text}: {', '.join(names)}" for text, names in choices.items()]
        for note, names in notes.items():
            lines += wrapped(f"note: {note}" + ("" if len(names) == count else f" ({', '.join(names)})"))
        lines += [line for one in self.not_scored for line in wrapped(f"not scored: {one.protocol}: {one.reason}")]
        return "\n".join(lines)

    def __repr__(self) -> str:
        names = ", ".join(result.protocol.name for result in self.results)
        return f"CombinedResult({in_line(self.results[0].dataset)}, {self.scored} scored; protocols {in_line(names)})"

    def _repr_html_(self) -> str:
        first = self.results[0]
        heads = ("protocol", *first.kind.heads)
        rows = [(result.protocol.name, *result.whole.texts(first.kind)) for result in self.results]
        notes = [
            *problem_lines(self.problems),
            *(f"not scored: {one.protocol}: {one.reason}" for one in self.not_scored),
        ]
        return block(f"{first.dataset}, {counted(len(self.results), 'protocol')}", table(heads, rows), notes=notes)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types.

        ``results`` as of single protocols, ``not_scored``, and ``same_scores``: names of those that share every score.
        """
        result = {
            "results": [result.as_dict() for result in self.results],
            "not_scored": [asdict(one) for one in self.not_scored],
            "same_scores": [[one.protocol.name for one in group] for group in self.groups if len(group) > 1],
        }
        return json_object(result)

    def write_json(self, path: Path | str) -> None:
        """Write :meth:`as_dict` as JSON, whole or not at all."""
        write_json(path, self.as_dict())

    def write_csv(self, path: Path | str) -> None:
        """Write the scores as CSV, ``protocol`` before the columns of a single one, whole or not at all."""
        write_scores(self.results, path, named=True)


def _space(result: EvaluationResult) -> str:
    return str(result.protocol.as_dict().get("space", "raw"))


def _names(group: Sequence[EvaluationResult]) -> str:
    return ", ".join(result.protocol.name for result in group)


def overall(result: EvaluationResult) -> list[TableRow]:
    """Return the rows of a table that span all cameras: one per factor, and all."""
    cameras = {row.camera for row in result.table if row.camera is not None}
    return [row for row in result.table if row.ratio is None or row.camera is None or len(cameras) == 1]
