"""What an evaluation found: scores, means per group, and everything that they depend on.

One record for images and for clips, computed or read back (:func:`eldata.evaluation.saved.load_result`), which is
printed, saved, compared and shown as a page.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_json, write_text
from eldata.base.numbers import counted
from eldata.base.tables import block, csv_text, latex_table, markdown_table, markdown_text, table, text_table, wrapped
from eldata.base.visible import in_line
from eldata.evaluation.scores import (
    EvaluationProblem,
    PaperTable,
    TableRow,
    UnitScore,
    csv_number,
    factor_text,
    finite_values,
    grouped_table,
    json_object,
    nothing_scored,
    problem_lines,
    short_digest,
    table_of,
)
from eldata.evaluation.tasks import stated_figure
from eldata.manifest.clips import ClipRecord
from eldata.protocols.digests import CHOOSING, OF_INPUT
from eldata.protocols.protocol import NO_SHADING
from eldata.protocols.words import comparability
from eldata.records import PairRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.base.tables import Format
    from eldata.evaluation.diagnosis import Suspicion
    from eldata.evaluation.scores import Pair
    from eldata.evaluation.statistics import Interval
    from eldata.plots.axes import Theme
    from eldata.plots.scores import Strip
    from eldata.protocols.kinds import Kind
    from eldata.protocols.protocol import Protocol, StatedProtocol

THE_INPUT = "none: the input itself"
"""In the provenance in place of the folder of predictions."""


@dataclass(frozen=True, slots=True)
class EvaluationResult:
    """The result of :func:`eldata.evaluate`.

    Attributes
    ----------
    protocol
        The protocol of every score.
    provenance
        What the numbers depend on: versions, manifest and its digest, the protocol's digest; cameras, subset, ids, and
        excluded flags with their numbers of pairs; ``equal_choices``, the values of the protocol's fields that came to
        the same on these files.
    scores
        One per image or clip, in the order of the pairs.
    table
        Means: camera by factor, each factor over all cameras, and all.
    expected
        How many pairs (or videos) the protocol and the subset name, scored or not.
    missing
        Noisy frames (or clips) without a usable prediction.
    problems
        What is wrong. With problems and without ``allow_missing`` nothing was scored.
    notes
        What a reader of the table should know.
    suspicions
        Mistakes that the predictions show (:mod:`eldata.evaluation.diagnosis`).
    units
        The pairs, or windows of clips, that were to be scored; none in a result that was read back.
    source
        Where it was read from, for messages.
    """

    protocol: Protocol | StatedProtocol
    provenance: dict[str, Any]
    scores: tuple[UnitScore, ...]
    table: tuple[TableRow, ...]
    expected: int
    missing: tuple[str, ...]
    problems: tuple[EvaluationProblem, ...]
    notes: tuple[str, ...]
    suspicions: tuple[Suspicion, ...] = ()
    units: tuple[Pair, ...] = ()
    source: str = "this evaluation"

    @classmethod
    def of(
        cls,
        protocol: Protocol,
        provenance: dict[str, Any],
        units: Sequence[Pair],
        scores: Mapping[str, UnitScore],
        problems: Iterable[EvaluationProblem] = (),
    ) -> EvaluationResult:
        """Return the result of scoring these pairs or windows; ``scores`` are by their paths."""
        found = tuple(scores[unit.path] for unit in units if unit.path in scores)
        return cls(
            protocol=protocol,
            provenance=provenance,
            scores=found,
            table=table_of(units, found, kind_of(protocol.kind, provenance), provenance["dataset"]),
            expected=len(units),
            missing=tuple(unit.name for unit in units if unit.path not in scores),
            problems=tuple(problems),
            notes=(),
            units=tuple(units),
        )

    # --- what is in it ------------------------------------------------------------------------------------------------

    @property
    def kind(self) -> Kind:
        """What was scored: images or clips, and with which numbers."""
        return kind_of(self.protocol.kind, self.provenance)

    @property
    def dataset(self) -> str:
        """The dataset's name."""
        return str(self.provenance["dataset"])

    @property
    def scenes_shared(self) -> bool:
        """Whether scenes of one name under several cameras are one scene, as the set's card says."""
        return bool(self.provenance["scenes_shared"])

    @property
    def digest(self) -> str:
        """``sha256:<hex>`` of what of the protocol decides a score, by this version's rule."""
        return self.protocol.digest

    @property
    def pairs(self) -> tuple[PairRecord, ...]:
        """The pairs that were to be scored, of a set of images."""
        return tuple(unit for unit in self.units if isinstance(unit, PairRecord))

    @property
    def windows(self) -> tuple[ClipRecord, ...]:
        """The windows that were to be scored, of a set of clips."""
        return tuple(unit for unit in self.units if isinstance(unit, ClipRecord))

    @property
    def images(self) -> tuple[UnitScore, ...]:
        """The scores, of a set of images."""
        return self.scores

    @property
    def videos(self) -> tuple[UnitScore, ...]:
        """The scores, of a set of clips."""
        return self.scores

    @property
    def scored(self) -> int:
        """How many were scored."""
        return len(self.scores)

    @property
    def whole(self) -> TableRow:
        """The means over all."""
        return self.table[-1]

    @property
    def psnr_db(self) -> float:
        """PSNR in dB, mean over all."""
        return self.whole.psnr_db

    @property
    def ssim(self) -> float:
        """SSIM, mean over all."""
        return self.whole.ssim

    @property
    def st_rred(self) -> float:
        """ST-RRED of clips, mean over all; lower is better."""
        return self.whole.st_rred

    @property
    def chosen(self) -> frozenset[str]:
        """What was to be scored: paths of noisy frames, of images; numbers of clips."""
        return frozenset((*(score.name for score in self.scores), *self.missing))

    @property
    def of_input(self) -> bool:
        """Whether the noisy input itself was scored."""
        return self.provenance.get("predictions") == THE_INPUT

    def scored_unlike(self, other: EvaluationResult | Protocol) -> list[str]:
        """Return in words how these were scored differently from another result or protocol; nothing if alike.

        That is neither the choice of pairs, nor a name, nor what came to the same on the scored files
        (``equal_choices``). The noisy input counts where it was scored itself.
        """
        results = [self] if not isinstance(other, EvaluationResult) else [self, other]
        of_input = any(result.of_input for result in results)
        second = other.protocol if isinstance(other, EvaluationResult) else other
        return comparability(
            self.protocol.as_dict(),
            second.as_dict(),
            equal=[result.provenance.get("equal_choices", {}) for result in results],
            ignored=CHOOSING if of_input else (*CHOOSING, *OF_INPUT),
        )

    @property
    def rescales(self) -> bool:
        """Whether the protocol multiplies a prediction by a factor before it is scored."""
        return bool(self.protocol.as_dict().get("rescaling", "none") != "none")

    @property
    def frame(self) -> pd.DataFrame:
        """The scores as a pandas DataFrame, one row per image or clip."""
        import pandas as pd

        return pd.DataFrame([score.row(self.kind) for score in self.scores], columns=list(self.kind.columns))

    def scores_of(self, row: TableRow) -> tuple[UnitScore, ...]:
        """Return the scores that a row of the table is the mean of."""
        return tuple(score for score in self.scores if row.holds(score))

    def interval(self, row: TableRow, name: str) -> Interval:
        """Return a mean of the table with its interval over scenes; ``name`` is the value's, such as ``psnr_db``."""
        from eldata.evaluation.statistics import interval_of_scores

        return interval_of_scores(self.scores_of(row), name, scenes_shared=self.scenes_shared)

    # --- in words -----------------------------------------------------------------------------------------------------

    @property
    def coverage(self) -> str:
        """Return how many of the dataset's pairs were scored, which were chosen, and what was taken off the input."""
        cameras, subset, ids = (self.provenance.get(name) for name in ("cameras", "subset", "ids"))
        parts = [f"{self.scored} of {self.expected} {self.kind.counted}"]
        parts += [f"only {', '.join(map(str, chosen))}" for chosen in (cameras, ids) if isinstance(chosen, list)]
        if subset is not None:
            parts.append(f"subset {subset}")
        for name, words in (("excluded_flags", "without {}"), ("included_flags", "{} included")):
            flags = self.provenance.get(name)
            if isinstance(flags, dict):
                parts += [f"{words.format(flag)} ({count})" for flag, count in flags.items()]
        shading = self.protocol.as_dict().get("dark_shading", NO_SHADING)
        if shading != NO_SHADING:
            parts.append(f"input less dark shading {short_digest(str(shading))}")
        return ", ".join(parts)

    @property
    def caption(self) -> str:
        """What a table is of: dataset, protocol with its digest, coverage and choice of pairs."""
        incomplete = "; INCOMPLETE: does not compare with others" if self.scored < self.expected else ""
        dataset = f"{self.dataset} {self.provenance.get('manifest_version', '')}".rstrip()
        return f"{dataset}, protocol {self.protocol.name} ({short_digest(self.digest)}): {self.coverage}{incomplete}."

    @property
    def paper_table(self) -> PaperTable:
        """The table as papers lay it out: each metric with the decimals that they print."""
        return self.laid_out(self.kind.heads, [row.texts(self.kind) for row in self.table])

    def laid_out(self, names: Sequence[str], texts: Sequence[Sequence[str]], times: str = "x") -> PaperTable:
        """Return texts for each row of the table laid out; ``names`` is what each states.

        A set of several cameras has a row for each camera and factor, as in the ELD paper's table; a set of one camera,
        all of which was chosen, has a column for each factor, as in those on SID; without factors it is one row, as in
        those on DRV. ``times``: as for :func:`~eldata.evaluation.scores.factor_text`.
        """
        rows = self.table
        if len(rows) == 1 and rows[0].ratio is None:
            return PaperTable(tuple(names), (tuple(texts[0]),), (0,))
        cameras = {row.camera for row in rows if row.camera is not None}
        if len(cameras) == 1 and self.provenance.get("cameras", "all") == "all":
            header = (rows[0].camera or "", *(factor_text(row.ratio, times) for row in rows))
            cells = tuple((name, *values) for name, values in zip(names, zip(*texts, strict=True), strict=True))
            return PaperTable(header, cells, (0,), transposed=True)
        return grouped_table([(row.camera, row.ratio) for row in rows], names, texts, times)

    def format(self, form: Format) -> str:
        """Return the result as plain text, or its table in Markdown or LaTeX, ready to be pasted into a document."""
        if form == "text":
            return self.format_text()
        table = self.paper_table
        if form == "latex":
            label = f"tab:{self.dataset}-{self.protocol.name}"
            return latex_table(
                table.header, table.rows, table.left, caption=self.caption, label=label, rules=table.rules
            )
        lines = [markdown_table(table.header, table.rows, table.left), "", markdown_text(self.caption)]
        lines += [f"\n{markdown_text(str(suspicion))}" for suspicion in self.suspicions]
        return "\n".join([*lines, *(f"\nNote: {markdown_text(note)}" for note in self.notes)])

    def format_table(self) -> str:
        """Return the table as aligned text, as the papers print it."""
        table = self.paper_table
        return text_table(table.header, table.rows, table.left)

    def format_text(self) -> str:
        """Return problems, the table with its protocol and coverage, and notes as text."""
        if self.problems and not self.scores:
            return "\n".join([*problem_lines(self.problems), nothing_scored(self.problems)])
        lines = problem_lines(self.problems)
        if lines:
            lines.append("")
        lines += [f"{self.dataset}, protocol {self.protocol.name}: {self.coverage}", "", self.format_table(), ""]
        if self.missing:
            lines.append(
                f"INCOMPLETE: {len(self.missing)} {self.kind.counted} are not in these means, so they do not compare "
                "with others"
            )
        for text in (*map(str, self.suspicions), *(f"note: {note}" for note in self.notes)):
            lines += wrapped(text)
        lines.append(f"{self.protocol.title} ({short_digest(self.digest)})")
        return "\n".join(lines)

    # --- to be looked at ----------------------------------------------------------------------------------------------

    def plot(self, metric: str = "psnr_db", *, ax: Axes | None = None) -> Figure:
        """Draw every score by camera and factor, with the means of the table and their intervals over scenes.

        Parameters
        ----------
        metric
            The name of a column of the table, such as ``psnr_db`` or ``ssim``.
        ax
            Axes to draw into; by default those of a new figure, which belongs to no pyplot and shows in a notebook.

        Returns
        -------
        matplotlib.figure.Figure
            That of the axes.

        Raises
        ------
        ArgumentError
            If the table has no such column, or no score is finite.
        """
        from eldata.plots.axes import drawn_into, nothing_to_draw
        from eldata.plots.scores import strips

        chosen = self.kind.metric(metric)
        values = self._strips(chosen.name)
        if not values:
            raise nothing_to_draw(
                f"{metric} of this result", "no score is finite" if self.scores else "nothing was scored"
            )

        def draw(axes: Axes, theme: Theme) -> None:
            strips(axes, values, theme)
            axes.set_ylabel(chosen.heading)

        return drawn_into(ax, f"{self.dataset}, protocol {self.protocol.name}", draw)

    def _strips(self, name: str) -> list[Strip]:
        """Return the finite scores of each row of the table, less the last where others span all cameras too."""
        from eldata.plots.scores import Strip

        by_factor = any(row.ratio is not None for row in self.table)
        drawn = []
        for row in self.table:
            values = finite_values(self.scores_of(row), name)
            if values and (row.ratio is not None or not by_factor):
                drawn.append(Strip(row.camera or "all", row.ratio, values, self.interval(row, name).ends))
        return drawn

    def __repr__(self) -> str:
        texts = zip(self.kind.heads[1:], self.whole.texts(self.kind)[1:], strict=True) if self.scores else ()
        means = ", ".join(f"{head} {text}" for head, text in texts)
        text = f"{self.dataset}, protocol {self.protocol.name} ({short_digest(self.digest)}): {self.coverage}"
        problems = f", {counted(len(self.problems), 'problem')}" if self.problems else ""
        return f"EvaluationResult({in_line(text)}{problems}; {means or 'nothing was scored'})"

    def _repr_html_(self) -> str:
        cells = self.paper_table
        parts = [table(cells.header, cells.rows, cells.left)] if self.scores else []
        notes = [*problem_lines(self.problems), *map(str, self.suspicions), *(f"note: {note}" for note in self.notes)]
        return block(self.caption, *parts, notes=[*notes, self.protocol.title])

    # --- files --------------------------------------------------------------------------------------------------------

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types; an infinite PSNR is the text ``inf``."""
        result = {
            "protocol": self.protocol.as_dict(),
            "provenance": self.provenance,
            "coverage": {self.kind.counted: self.expected, "scored": self.scored, "missing": list(self.missing)},
            self.kind.units: [score.as_dict(self.kind) for score in self.scores],
            "table": [row.as_dict(self.kind) for row in self.table],
            "problems": [asdict(problem) for problem in self.problems],
            "notes": list(self.notes),
        }
        if self.suspicions:
            result["suspicions"] = [asdict(suspicion) for suspicion in self.suspicions]
        return json_object(result)

    def write_json(self, path: Path | str) -> None:
        """Write :meth:`as_dict` as JSON, whole or not at all."""
        write_json(path, self.as_dict())

    def write_csv(self, path: Path | str) -> None:
        """Write the scores as CSV with the columns of their kind, every digit, whole or not at all."""
        rows = (score.row(self.kind) for score in self.scores)
        columns = self.kind.columns
        write_text(path, csv_text(columns, ([csv_number(row[name]) for name in columns] for row in rows)))


def kind_of(kind: Kind, provenance: Mapping[str, Any]) -> Kind:
    """Return a protocol's kind with what was asked for beyond it: a task."""
    return kind.having(stated_figure(provenance["task"])) if "task" in provenance else kind
