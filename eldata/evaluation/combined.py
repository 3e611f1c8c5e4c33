"""The same predictions under several protocols: how far the choice of a protocol moves the numbers."""

from __future__ import annotations

import csv
import io
import json
import textwrap
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_text
from eldata.base.tables import text_table
from eldata.evaluation.common import csv_number, json_safe, mean
from eldata.evaluation.results import CSV_COLUMNS, choice_text, problem_lines
from eldata.protocols.comparability import comparability

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.evaluation.common import EvaluationProblem
    from eldata.evaluation.results import EvaluationResult, TableRow

# What of a protocol's differences from the first chooses pairs or concerns the input: the table shows the pairs.
_NOT_SCORING = ("dataset:", "subset:", "factors:", "cameras:", "scenes:", "input's clip:", "input amplified:")


@dataclass(frozen=True, slots=True)
class NotScored:
    """A protocol that is for the dataset and was not scored, and why."""

    protocol: str
    reason: str


@dataclass(frozen=True, slots=True)
class CombinedResult:
    """The results of :func:`eldata.evaluation.evaluate_all`: one a protocol, the dataset's default first."""

    results: tuple[EvaluationResult, ...]
    not_scored: tuple[NotScored, ...]

    @property
    def scored(self) -> int:
        """How many images were scored, under any protocol."""
        return len({image.path for result in self.results for image in result.images})

    @property
    def problems(self) -> tuple[EvaluationProblem, ...]:
        """The problems of all results, each once."""
        return tuple(dict.fromkeys(problem for result in self.results for problem in result.problems))

    def shift(self, result: EvaluationResult, name: str) -> tuple[float, int]:
        """Return by how much a result's mean lies above the first result's, over the pairs that both scored.

        So the rules of scoring are compared, not the choice of pairs. ``name`` is ``psnr_db`` or ``ssim``. The second
        number is that of the pairs; two infinite values differ by 0.
        """
        first = {image.path: float(getattr(image, name)) for image in self.results[0].images}
        shared = [(float(getattr(image, name)), first[image.path]) for image in result.images if image.path in first]
        return mean([0.0 if one == other else one - other for one, other in shared]), len(shared)

    def spans(self) -> dict[str, float]:
        """Return how far apart the protocols' PSNR (``psnr_db``) and SSIM lie, over the pairs that each shares."""
        found = {}
        for name in ("psnr_db", "ssim"):
            shifts = [shift for shift, shared in (self.shift(result, name) for result in self.results) if shared]
            found[name] = max(shifts) - min(shifts) if shifts else 0.0
        return found

    def format_table(self) -> str:
        """Return two tables, PSNR and SSIM: a row a protocol, a column a factor, over all cameras."""
        ratios = sorted({row.ratio for result in self.results for row in result.table if row.ratio is not None})
        parts = []
        for title, name, places in (("PSNR [dB]", "psnr_db", 2), ("SSIM", "ssim", 3)):
            header = (
                title,
                "pairs",
                *(f"x{ratio:g}" for ratio in ratios),
                "all",
                f"against {self.results[0].protocol.name}",
            )
            rows = [self._row(result, ratios, name, places) for result in self.results]
            parts.append(text_table(header, rows))
        return "\n\n".join(parts)

    def _row(self, result: EvaluationResult, ratios: list[float], name: str, places: int) -> tuple[str, ...]:
        rows = {row.ratio: row for row in overall(result)}
        cells = [
            f"{getattr(rows[ratio], name):.{places}f}" if ratio in rows and rows[ratio].scored else "-"
            for ratio in (*ratios, None)
        ]
        total = rows[None]
        pairs = str(total.pairs) if total.scored == total.pairs else f"{total.scored} of {total.pairs}"
        if result is self.results[0]:
            against = ""
        else:
            difference, shared = self.shift(result, name)
            against = f"{round(difference, places) + 0.0:+.{places}f}" if shared else "-"
            if 0 < shared < len(result.images):
                against += f" ({shared} pairs)"
        return (result.protocol.name, pairs, *cells, against)

    def _differences(self) -> list[str]:
        """Return in words in what each protocol scores otherwise than the first."""
        first = self.results[0].protocol
        lines = []
        for result in self.results[1:]:
            found = comparability(first.as_dict(), result.protocol.as_dict())
            scoring = [text.replace(" against ", " -> ", 1) for text in found if not text.startswith(_NOT_SCORING)]
            text = "; ".join(scoring) or "scored alike, the pairs differ"
            lines += textwrap.wrap(f"{result.protocol.name}: {text}", 112, subsequent_indent="    ")
        return lines

    def format_text(self) -> str:
        """Return problems, the tables with what distinguishes the protocols, and notes as text."""
        lines = problem_lines(self.problems)
        if self.problems and not self.scored:
            lines.append(f"nothing was scored: {len(self.problems)} problem{'s' if len(self.problems) > 1 else ''}")
            return "\n".join(lines)
        if lines:
            lines.append("")
        first = self.results[0]
        count = len(self.results)
        cameras = first.provenance["cameras"]
        excluded = "".join(f", without {flag}" for flag in first.provenance["excluded_flags"])
        only = "" if cameras == "all" else f", only {', '.join(cameras)}"
        lines += [f"{first.provenance['dataset']}, {count} protocol{'s' if count > 1 else ''}{only}{excluded}", ""]
        lines += [self.format_table(), ""]
        for result in self.results:
            if result.missing:
                lines.append(
                    f"INCOMPLETE: {len(result.missing)} pairs are not in the means of {result.protocol.name}, so they "
                    "do not compare with others"
                )
        differences = self._differences()
        if differences:
            spans = self.spans()
            apart = f"{spans['psnr_db']:.2f} dB and {spans['ssim']:.3f} in SSIM"
            lines += [
                f"By the protocol alone, on shared pairs, the same predictions lie up to {apart} apart.",
                "",
                f"Scored otherwise than under {first.protocol.name}:",
                *(f"  {text}" for text in differences),
                "",
            ]
        choices: dict[str, list[str]] = {}
        for result in self.results:
            choices.setdefault(choice_text(result), []).append(result.protocol.name)
        lines += [f"{text}: {', '.join(names)}" for text, names in choices.items()]
        notes: dict[str, list[str]] = {}
        for result in self.results:
            for note in result.notes:
                notes.setdefault(note, []).append(result.protocol.name)
        lines += [
            f"note: {note}" + ("" if len(names) == count else f" ({', '.join(names)})") for note, names in notes.items()
        ]
        lines += [f"not scored: {one.protocol}: {one.reason}" for one in self.not_scored]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types: ``results`` as of single protocols, and ``not_scored``."""
        result = {
            "results": [result.as_dict() for result in self.results],
            "not_scored": [asdict(one) for one in self.not_scored],
        }
        return json_safe(result)  # type: ignore[no-any-return] # a dict stays a dict

    def write_json(self, path: Path | str) -> None:
        """Write :meth:`as_dict` as JSON, whole or not at all."""
        write_text(path, json.dumps(self.as_dict(), indent=2, allow_nan=False) + "\n")

    def write_csv(self, path: Path | str) -> None:
        """Write the scores as CSV, ``protocol`` before the columns of a single one, whole or not at all."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(("protocol", *CSV_COLUMNS))
        for result in self.results:
            for image in result.images:
                values = [csv_number(getattr(image, column)) for column in CSV_COLUMNS]
                writer.writerow((result.protocol.name, *values))
        write_text(path, text.getvalue())


def overall(result: EvaluationResult) -> list[TableRow]:
    """Return the rows of a table that span all cameras: one a factor, and all."""
    cameras = {row.camera for row in result.table if row.camera is not None}
    return [row for row in result.table if row.ratio is None or row.camera is None or len(cameras) == 1]
