"""What a check gives back: one verdict per scene (or set of calibration frames), with its measures and pictures."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, Any

from capture.check.measures import (
    VERDICTS,
    Estimate,
    Measure,
    MeasureKind,
    Remark,
    Verdict,
    find_kind,
    worst,
)
from capture.checklist_content import TEMPLATES
from eldata.base.files import write_text
from eldata.base.tables import with_error
from eldata.base.visible import in_line
from eldata.errors import ArgumentError
from eldata.manifest.verify_report import distinct

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class SheetPicture:
    """A small picture for the contact sheet: what it shows, and a JPEG."""

    caption: str
    path: str
    jpeg: bytes


@dataclass(frozen=True, slots=True)
class CheckedPair:
    """A noisy frame and its reference: their files, as in the manifest."""

    path: str
    reference: str


@dataclass(slots=True)
class CheckedGroup:
    """The result for one scene, or for the bias frames or flats of one ISO; it grows while the frames pass.

    Attributes
    ----------
    name
        ``"SonyA7S2 scene-1"``, ``"SonyA7S2 bias ISO 800"``.
    files
        Number of files looked at.
    measures, remarks
        Everything measured, good values too; and what could not be measured.
    pictures
        For the contact sheet.
    pairs
        One for each noisy frame that could be read.
    """

    name: str
    files: int
    measures: list[Measure] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)
    pictures: list[SheetPicture] = field(default_factory=list)
    pairs: list[CheckedPair] = field(default_factory=list)

    def measure(self, kind: MeasureKind | str, path: str, found: Estimate, **words: str) -> Measure:
        """Add a measure of a kind, or of that of a name, with the words of its text; return it."""
        kind = find_kind(kind) if isinstance(kind, str) else kind
        self.measures.append(Measure(kind, path, kind.text.format(**words), found.value, found.standard_error))
        return self.measures[-1]

    def remark(self, path: str, text: str, verdict: Verdict = "look") -> None:
        """Add a remark."""
        self.remarks.append(Remark(path, text, verdict))

    @property
    def findings(self) -> list[Measure | Remark]:
        """Remarks and measures, all of them."""
        return [*self.remarks, *self.measures]

    @property
    def verdict(self) -> Verdict:
        """The most severe verdict of its measures and remarks."""
        return worst([one.verdict for one in self.findings])

    @property
    def reasons(self) -> tuple[Measure | Remark, ...]:
        """What made the verdict, and what else to look at; the worst first."""
        found = [one for one in self.findings if one.verdict != "keep"]
        return tuple(sorted(found, key=lambda one: -VERDICTS.index(one.verdict)))

    def verdict_of(self, path: str) -> Verdict:
        """Return the most severe verdict about one file."""
        return worst([one.verdict for one in self.findings if one.path == path])

    def columns(self) -> tuple[str, ...]:
        """Return the names of what was measured of pairs, in the order in which it first occurs."""
        paths = {pair.path for pair in self.pairs}
        return tuple(dict.fromkeys(one.name for one in self.measures if one.path in paths))

    def row(self, pair: CheckedPair) -> dict[str, Measure]:
        """Return the measures of a pair by name."""
        return {one.name: one for one in self.measures if one.path == pair.path}

    def _pair_dict(self, pair: CheckedPair) -> dict[str, Any]:
        fields = ("value", "standard_error", "unit", "verdict")
        measured = {name: one.as_dict() for name, one in self.row(pair).items()}
        return {
            "path": pair.path,
            "reference": pair.reference,
            "verdict": self.verdict_of(pair.path),
            "measured": {name: {field: one[field] for field in fields} for name, one in measured.items()},
        }

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain JSON types, without pictures."""
        return {
            "name": self.name,
            "verdict": self.verdict,
            "files": self.files,
            "reasons": [str(one) for one in self.reasons],
            "measures": [one.as_dict() for one in self.measures],
            "remarks": [one.as_dict() for one in self.remarks],
            "pairs": list(map(self._pair_dict, self.pairs)),
        }

    def format_text(self, told: Collection[Measure] = ()) -> str:
        """Return the verdict and its reasons, but those ``told`` below."""
        lines = [f"{self.name}: {self.verdict}"]
        left = [one for one in self.reasons if one not in told]
        lines += [f"    {one.verdict}: {one}" for one in left]
        if len(left) < len(self.reasons):
            lines.append(f"    {len(self.reasons) - len(left)} measures that are off alike in many files: see below")
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class CheckReport:
    """The result of :func:`capture.check.check`."""

    dataset: str
    groups: tuple[CheckedGroup, ...]

    @property
    def ok(self) -> bool:
        """Whether everything can be kept."""
        return all(group.verdict == "keep" for group in self.groups)

    @property
    def counts(self) -> dict[Verdict, int]:
        """How many groups have each verdict, of those that occur."""
        counts = {verdict: sum(group.verdict == verdict for group in self.groups) for verdict in VERDICTS}
        return {verdict: count for verdict, count in counts.items() if count}

    @property
    def alike(self) -> tuple[str, ...]:
        """Ratios that are off alike in many files, as if every exposure had been 20 % too short: a sentence each."""
        return tuple(map(_in_one, _alike(self.groups)))

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain JSON types, without pictures."""
        return {"dataset": self.dataset, "ok": self.ok, "groups": [group.as_dict() for group in self.groups]}

    def format_text(self) -> str:
        """Return the report as text: what is not to be kept and why, what is :attr:`alike`, and how many are what."""
        told = {one for many in _alike(self.groups) for one in many}
        total = ", ".join(f"{count} {verdict}" for verdict, count in self.counts.items())
        said = distinct(
            (one.path, (one.text,)) for group in self.groups for one in group.remarks if one.verdict == "keep"
        )
        groups = [group.format_text(told) for group in self.groups if group.verdict != "keep"]
        return "\n".join([*groups, *self.alike, *map(str, said), f"{self.dataset}: {total}"])


# So many files that are off alike are one finding. What is alike: within 3 % of the nominal ratio, some times what the
# noise of a dark frame leaves of its measured ratio, and a tenth of a third of a stop.
_MANY = 5
_ALIKE = 0.03


def _alike(groups: Iterable[CheckedGroup]) -> list[list[Measure]]:
    """Return the measured ratios that are off by about the same factor, for the same reason, in many files."""
    found: dict[tuple[str, Verdict, str], list[Measure]] = defaultdict(list)
    for one in (one for group in groups for one in group.measures if not one.kind.unit and one.kind.expected):
        if one.verdict != "keep":
            found[one.name, one.verdict, one.kind.advice].append(one)
    alike = []
    for many in found.values():
        middle = median(map(_relative, many))
        close = [one for one in many if abs(_relative(one) - middle) <= _ALIKE]
        alike += [close] if len(close) >= _MANY else []
    return alike


def _relative(measure: Measure) -> float:
    return measure.value / measure.kind.expected


def _in_one(many: Sequence[Measure]) -> str:
    first, shares = many[0], [100 * _relative(one) for one in many]
    return (
        f"{first.verdict}: {len(many)} files alike, such as {in_line(first.path)}: {first.name}: by the pixels it is "
        f"{median(shares):.0f} % of what it should be ({min(shares):.1f} to {max(shares):.1f} %); {first.kind.advice}"
    )


# --- the contact sheet: one HTML page that needs no network -----------------------------------------------------------


def write_sheet(path: Path | str, report: CheckReport) -> None:
    """Write the contact sheet of a report, whole or not at all.

    Raises
    ------
    ArgumentError
        If the name does not end in .html.
    """
    from eldata.reports.html import rendered

    check_sheet_name(path)
    write_text(path, rendered("sheet.html", TEMPLATES, report=report, with_error=with_error))


def check_sheet_name(path: Path | str) -> None:
    """Raise :class:`ArgumentError` unless a contact sheet can have this name."""
    if not str(path).endswith((".html", ".htm")):
        raise ArgumentError(f"--sheet {path}: the contact sheet is an HTML page: end its name in .html")
