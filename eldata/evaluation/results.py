"""The result of an evaluation: scores, means per group, and everything that they depend on.

One record for images and for clips, computed or read back (:func:`load_result`), which is printed, saved, compared and
shown as a page.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar

from eldata import __version__
from eldata.base.fields import Fields, TextFile
from eldata.base.files import write_json, write_text
from eldata.base.numbers import counted
from eldata.base.tables import block, csv_text, latex_table, markdown_table, markdown_text, table, text_table, wrapped
from eldata.base.visible import in_line, shown
from eldata.errors import ArgumentError, FileError
from eldata.evaluation.diagnosis import Suspicion
from eldata.evaluation.scores import (
    EvaluationProblem,
    FrameScore,
    PaperTable,
    TableRow,
    UnitScore,
    csv_number,
    factor_text,
    finite_values,
    grouped_table,
    json_object,
    problem_lines,
    short_digest,
)
from eldata.evaluation.tasks import stated_figure
from eldata.metrics.registry import CLIPS, IMAGES, Kind
from eldata.protocols.protocol import CHOOSING, NO_SHADING, OF_INPUT, Protocol, StatedProtocol
from eldata.protocols.words import comparability

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.base.tables import Format
    from eldata.evaluation.scores import Pair
    from eldata.evaluation.statistics import Interval
    from eldata.plots.axes import Theme
    from eldata.plots.scores import Strip

Record = TypeVar("Record", EvaluationProblem, FrameScore, Suspicion)

THE_INPUT = "none: the input itself"
"""Stands in the provenance instead of the folder of predictions."""


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

    # --- what is in it ------------------------------------------------------------------------------------------------

    @property
    def kind(self) -> Kind:
        """Images or clips, and the numbers of their scores."""
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
    def scored(self) -> int:
        """The number of scored images or clips."""
        return len(self.scores)

    @property
    def whole(self) -> TableRow:
        """The table's row of means over all."""
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
    def chosen(self) -> frozenset[str]:
        """Names of all units to score: paths of noisy frames, numbers of clips."""
        return frozenset((*(score.name for score in self.scores), *self.missing))

    @property
    def of_input(self) -> bool:
        """Whether the noisy input itself was scored."""
        return self.provenance.get("predictions") == THE_INPUT

    def scored_unlike(self, other: EvaluationResult | Protocol) -> list[str]:
        """Describe the differences in scoring of another result or protocol; nothing if alike.

        Not counted are the choice of pairs, names, and what came to the same on the scored files (``equal_choices``).
        The noisy input counts where it was scored itself.
        """
        results = [self, other] if isinstance(other, EvaluationResult) else [self]
        of_input = any(result.of_input for result in results)
        return comparability(
            self.protocol.as_dict(),
            (other.protocol if isinstance(other, EvaluationResult) else other).as_dict(),
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
        """Coverage in words: pairs scored of all, their choice, and the dark shading taken off the input."""
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
        """The table's caption: dataset, protocol with its digest, coverage and choice of pairs."""
        incomplete = "; INCOMPLETE: does not compare with others" if self.scored < self.expected else ""
        dataset = f"{self.dataset} {self.provenance.get('manifest_version', '')}".rstrip()
        return f"{dataset}, protocol {self.protocol.name} ({short_digest(self.digest)}): {self.coverage}{incomplete}."

    @property
    def paper_table(self) -> PaperTable:
        """The table as papers lay it out: each metric with the decimals that they print."""
        return self.lay_out(self.kind.heads, [row.texts(self.kind) for row in self.table])

    def lay_out(self, names: Sequence[str], texts: Sequence[Sequence[str]], times: str = "x") -> PaperTable:
        """Lay out texts for each row of the table; ``names`` is what each states.

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

    def format_text(self) -> str:
        """Return problems, the table with its protocol and coverage, and notes as text."""
        lines = problem_lines(self.problems)
        if lines and not self.scores:
            return "\n".join([*lines, f"nothing was scored: {counted(len(self.problems), 'problem')}"])
        table = self.paper_table
        lines += [""] * bool(lines)
        lines += [f"{self.dataset}, protocol {self.protocol.name}: {self.coverage}", ""]
        lines += [text_table(table.header, table.rows, table.left), ""]
        if self.missing:
            lines.append(
                f"INCOMPLETE: {len(self.missing)} {self.kind.counted} are not in these means, so they do not compare "
                "with others"
            )
        for text in self._remark_lines:
            lines += wrapped(text)
        return "\n".join([*lines, f"{self.protocol.title} ({short_digest(self.digest)})"])

    @property
    def _remark_lines(self) -> list[str]:
        """Suspicions and notes as lines of text."""
        return [*map(str, self.suspicions), *(f"note: {note}" for note in self.notes)]

    # --- to be looked at ----------------------------------------------------------------------------------------------

    def plot(self, metric: str = "psnr_db", *, ax: Axes | None = None) -> Figure:
        """Draw every score by camera and factor, with the means of the table and their intervals over scenes.

        Parameters
        ----------
        metric
            The name of a column of the table, such as ``psnr_db`` or ``ssim``.
        ax
            Axes to draw into; by default new ones, in a figure that belongs to no pyplot and shows in a notebook.

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

        rows = [row for row in self.table if row.ratio is not None] or self.table
        return [
            Strip(row.camera or "all", row.ratio, values, self.interval(row, name).ends)
            for row in rows
            if (values := finite_values(self.scores_of(row), name))
        ]

    def __repr__(self) -> str:
        texts = zip(self.kind.heads[1:], self.whole.texts(self.kind)[1:], strict=True) if self.scores else ()
        means = ", ".join(f"{head} {text}" for head, text in texts)
        text = f"{self.dataset}, protocol {self.protocol.name} ({short_digest(self.digest)}): {self.coverage}"
        problems = f", {counted(len(self.problems), 'problem')}" if self.problems else ""
        return f"EvaluationResult({in_line(text)}{problems}; {means or 'nothing was scored'})"

    def _repr_html_(self) -> str:
        """Render the table of means for notebooks."""
        cells = self.paper_table
        parts = [table(cells.header, cells.rows, cells.left)] if self.scores else []
        notes = [*problem_lines(self.problems), *self._remark_lines, self.protocol.title]
        return block(self.caption, *parts, notes=notes)

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


# --- results that are read back ---------------------------------------------------------------------------------------

_AGAIN: Final = "write it again with eldata evaluate --json"


def load_result(path: Path | str) -> EvaluationResult:
    """Read what ``eldata evaluate --json`` wrote.

    Raises
    ------
    FileError
        If the file cannot be read, is not whole, is something else, or was written by a newer version; the message
        names the field.
    """
    return _read_result(TextFile(path, FileError, advice=_AGAIN).json())


def saved_result(data: object, source: Path | str) -> EvaluationResult:
    """Read a result from what :meth:`EvaluationResult.as_dict` returned; ``source`` names it in messages.

    Raises
    ------
    FileError
        Like :func:`load_result`.
    """
    return _read_result(TextFile(source, FileError, advice=_AGAIN).fields(data))


def _read_result(top: Fields) -> EvaluationResult:
    """Read a result; refuse scores that occur twice or are not as many as stated."""
    if "provenance" not in top.data:
        raise top.problem("provenance", "is missing: this is not a result of eldata evaluate, or not a whole one")
    provenance, coverage = top.inside("provenance"), top.inside("coverage")
    protocol = StatedProtocol(CLIPS if CLIPS.units in top.data else IMAGES, dict(top.inside("protocol").data))
    top.inside("protocol").text("name")
    _check_provenance(provenance, protocol)
    kind = kind_of(protocol.kind, provenance.data)
    scores = tuple(_read_score(score, kind) for score in top.objects(kind.units))
    last = {score.path: index for index, score in enumerate(scores)}
    for index, score in enumerate(scores):
        if last[score.path] != index:
            field = f"{kind.units}[{last[score.path]}].path"
            raise top.wrong(field, f"another {kind.unit} than those before it", score.path)
    if coverage.whole("scored") != len(scores):
        raise coverage.wrong("scored", f"the number of {kind.units}, {len(scores)}", coverage.data["scored"])
    return EvaluationResult(
        protocol=protocol,
        provenance=dict(provenance.data),
        scores=scores,
        table=tuple(_read_row(row, kind) for row in top.objects("table", fewest=1)),
        expected=coverage.whole(kind.counted, at_least=len(scores)),
        missing=coverage.texts("missing"),
        problems=tuple(_read_record(EvaluationProblem, problem) for problem in top.objects("problems")),
        notes=top.texts("notes"),
        suspicions=tuple(_read_record(Suspicion, mistake) for mistake in top.objects("suspicions", missing_ok=True)),
        source=str(top.file.name),
    )


def _check_provenance(provenance: Fields, protocol: StatedProtocol) -> None:
    """Check what of a provenance the result's methods and comparisons rely on."""
    written = provenance.text("eldata")
    if _release(written) > _release(__version__):
        raise provenance.wrong("eldata", f"{__version__} or older (update eldata, or it may be misread)", written)
    for name in ("dataset", "manifest_sha256"):
        provenance.text(name)
    if provenance.text("protocol_digest") != protocol.digest:
        expected = f"the digest of the fields in protocol, {protocol.digest} (was one of them edited?)"
        raise provenance.wrong("protocol_digest", expected, provenance.data["protocol_digest"])
    provenance.flag("scenes_shared")
    if "task" in provenance.data:
        task = provenance.inside("task")
        for name in ("label", "callable", "images"):
            task.text(name)
        task.flag("higher_is_better")


def _read_score(fields: Fields, kind: Kind) -> UnitScore:
    """Read the score of an image, or of a clip with its frames."""
    camera, scene = fields.text("camera"), fields.text("scene")
    numbers = {name: fields.parsed(name, _number) for name in kind.values}  # noqa: PD011 (names of a score's numbers)
    if not kind.is_of_clips:
        iso, ratio = fields.number("iso", at_least=0), fields.number("ratio", at_least=0)
        return UnitScore(fields.text("path"), camera, scene, iso, ratio, numbers)
    frames = tuple(_read_record(FrameScore, frame) for frame in fields.objects("frame_scores", fewest=1))
    split, start = fields.text("split"), fields.whole("start")
    return UnitScore(frames[0].path, camera, scene, 0.0, None, numbers, split=split, start=start, frames=frames)


def _read_row(row: Fields, kind: Kind) -> TableRow:
    """Read a row of the table of means."""
    return TableRow(
        camera=row.optional("camera", row.text),
        ratio=row.optional("ratio", row.number, at_least=0),
        pairs=row.whole(kind.counted),
        scored=row.whole("scored"),
        values={metric.name: row.parsed(metric.name, _number) for metric in kind.metrics},
    )


def _read_record(kind: type[Record], fields: Fields) -> Record:
    """Read a record whose fields are written by their names; a path may have characters that do not show."""
    readers: dict[Any, Any] = {
        "str": lambda name: fields.text(name, empty=True, unseen=True),
        "int": fields.whole,
        "float": lambda name: fields.parsed(name, _number),
        "float | None": lambda name: fields.optional(name, fields.number),
    }
    return kind(**{field.name: readers[field.type](field.name) for field in dataclasses.fields(kind)})


def _number(value: Any) -> float:
    """Return a number, an infinity that is written as text, or nan for null."""
    if value is None:
        return math.nan
    if value in ("inf", "-inf") or (type(value) in (int, float) and abs(value) <= 1e300):
        return float(value)
    raise ArgumentError(f'expected a finite number, the text "inf" or null, found {shown(value)}')


def _release(version: str) -> tuple[int, ...]:
    """Parse major and minor version; (0,) of other text."""
    parts = version.split(".")[:2]
    return tuple(int(part) for part in parts) if all(part.isdecimal() for part in parts) else (0,)
