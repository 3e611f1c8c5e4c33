"""The results of verifying: problems and remarks by dataset, and their text."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, get_args

from eldata.base.numbers import counted, fraction_of
from eldata.base.visible import in_line
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

Level = Literal["quick", "metadata", "full"]
LEVELS: tuple[Level, ...] = get_args(Level)

COPY_AGAIN = "copy or download it again"


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong: where, what was expected, what was found, what to do."""

    dataset: str
    path: str
    field: str
    expected: str
    found: str
    advice: str

    def __str__(self) -> str:
        return in_line(f"{self.path}: {self.field}: expected {self.expected}, found {self.found}; {self.advice}")

    def of(self, dataset: str) -> Problem:
        """Return the problem with its dataset's name."""
        return replace(self, dataset=dataset)

    def format_text(self) -> str:
        """Return the problem as four lines."""
        return (
            f"{in_line(self.path)}: {self.field}\n    expected  {in_line(self.expected)}\n    found     "
            f"{in_line(self.found)}\n    to do     {in_line(self.advice)}"
        )


row_fault = partial(Problem, "")
"""A problem of a manifest's row, still without its dataset's name."""


@dataclass(frozen=True, slots=True)
class FileRemark:
    """A remark on some files, not a problem: its text for the first file, and their number."""

    path: str
    files: int
    text: str

    def __str__(self) -> str:
        return self.sentence("remark: ")

    def sentence(self, kind: str = "") -> str:
        """Return the remark as one line, the files first."""
        others = f" and {counted(self.files - 1, 'other')} alike" if self.files > 1 else ""
        return in_line(f"{self.path}{others}: {kind}{self.text}")


def distinct(remarks: Iterable[tuple[str, tuple[str, ...]]]) -> tuple[FileRemark, ...]:
    """Return each remark once, given every file's by path; remarks that differ only in their figures are alike."""
    alike: dict[str, list[tuple[str, str]]] = {}
    for path, texts in remarks:
        for text in texts:
            alike.setdefault(FIGURE.sub("0", text), []).append((path, text))
    return tuple(FileRemark(found[0][0], len(found), found[0][1]) for found in alike.values())


FIGURE = re.compile(r"(?<!\w)-?[0-9]+(\.[0-9]+)?(e[+-][0-9]+)?")
"""A figure in a text: texts that differ in nothing else are alike."""


def span_figures(texts: Sequence[str]) -> str:
    """Return texts that differ only in figures as one, with the lowest and highest of each figure."""
    columns = zip(*([figure[0] for figure in FIGURE.finditer(text)] for text in texts), strict=True)
    ends = [(min(column, key=float), max(column, key=float)) for column in columns]
    spans = iter(low if float(low) == float(high) else f"{low}..{high}" for low, high in ends)
    return FIGURE.sub(lambda _: next(spans), texts[0])


@dataclass(frozen=True, slots=True)
class DatasetReport:
    """The report on one dataset. ``absent``: its folder is missing, and nothing was checked."""

    dataset: str
    folder: Path
    absent: bool
    homepage: str
    files_listed: int
    files_checked: int
    files_hashed: int
    problems: tuple[Problem, ...]
    remarks: tuple[FileRemark, ...] = ()


@dataclass(frozen=True, slots=True)
class VerifyReport:
    """The result of :func:`verify`."""

    level: Level
    datasets: tuple[DatasetReport, ...]

    @property
    def problems(self) -> tuple[Problem, ...]:
        """All problems of all datasets."""
        return tuple(problem for report in self.datasets for problem in report.problems)

    @property
    def ok(self) -> bool:
        """Whether something was verified and no problem was found."""
        return not self.problems and any(report.files_checked for report in self.datasets)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain JSON types."""
        datasets = [asdict(report) | {"folder": str(report.folder)} for report in self.datasets]
        return {"level": self.level, "ok": self.ok, "datasets": datasets}

    def format_text(self) -> str:
        """Return the report as text: each problem by file, each remark once, then one line per dataset.

        Settings that are off by the same factor in many files, such as every exposure by 20 %, are one problem and a
        count; :attr:`problems` has each.
        """
        lines = _format_problems(self.problems)
        lines += [str(remark) for dataset in self.datasets for remark in dataset.remarks]
        for dataset in self.datasets:
            name, folder = dataset.dataset, dataset.folder
            if dataset.absent:
                lines.append(f"{name}: absent (no folder {folder}); where to get it: {dataset.homepage}")
                continue
            verdict = counted(len(dataset.problems), "problem") if dataset.problems else "all well"
            checked = f"{dataset.files_checked} of {dataset.files_listed} files checked ({self.level})"
            lines.append(f"{name}: {checked} in {folder}: {verdict}")
            unhashed = dataset.files_checked - dataset.files_hashed
            if self.level == "full" and unhashed:
                lines.append(
                    f"    {unhashed} files have no recorded hash and were decoded instead; eldata lock records hashes "
                    "from a copy that you trust"
                )
        if all(dataset.absent for dataset in self.datasets):
            lines.append("nothing was verified; --root names the folder that holds the datasets")
        return "\n".join(lines)


_MANY = 8  # files whose setting is off by one factor are one problem in the text; of fewer wrong sizes each is named
_SIZES = ("size_bytes", "width", "height")


def _format_problems(problems: Sequence[Problem]) -> list[str]:
    """Format problems in their order; files of wrong sizes, and many that are off by one factor, are one."""
    groups: dict[object, list[Problem]] = {}
    for problem in problems:
        percent = _percent_of_expected(problem)
        kind = FIGURE.sub("0", problem.expected) if problem.field in _SIZES else problem
        key = problem.dataset, problem.field, problem.advice, kind if percent is None else percent
        groups.setdefault(key, []).append(problem)
    texts: dict[Problem, str] = {}
    for alike in groups.values():
        texts.update((problem, problem.format_text()) for problem in alike)
        first, paths = alike[0], [problem.path for problem in alike]
        if len(alike) >= (2 if first.field in _SIZES else _MANY):
            many = f"{paths[0]} and {len(paths) - 1} others alike" if len(paths) >= _MANY else ", ".join(paths)
            spans = {name: span_figures([getattr(each, name) for each in alike]) for name in ("expected", "found")}
            if (percent := _percent_of_expected(first)) is not None:
                share = f"{first.found} there; in all {len(alike)} files {percent} % of what is expected"
                spans = {"expected": first.expected, "found": share}
            texts |= dict.fromkeys(alike, "") | {first: replace(first, path=many, **spans).format_text()}
    return [texts[problem] for problem in problems if texts[problem]]


def _percent_of_expected(problem: Problem) -> int | None:
    """Return a number in percent of the expected one; ``None`` if the problem is not about a number."""
    if problem.field not in ("iso", "exposure_s", "ratio"):
        return None
    try:
        expected, found = (fraction_of(text.split(" ")[0], above=0) for text in (problem.expected, problem.found))
    except ArgumentError:
        return None
    return round(100 * found / expected)
