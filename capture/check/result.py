"""What a check gives back: one verdict per scene (or set of calibration frames), with its measures and pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from capture.check.measures import VERDICTS, Measure, MeasureKind, Remark, Verdict, worst
from eldata.base.tables import with_error


@dataclass(frozen=True, slots=True)
class SheetPicture:
    """A small picture for the contact sheet: what it shows, and a JPEG."""

    caption: str
    path: str
    jpeg: bytes


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
    """

    name: str
    files: int
    measures: list[Measure] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)
    pictures: list[SheetPicture] = field(default_factory=list)

    def measure(self, kind: MeasureKind, path: str, text: str, value: float, error: float = 0.0) -> Measure:
        """Add a measure, and return it."""
        self.measures.append(Measure(kind, path, text, value, error))
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

    @property
    def extremes(self) -> tuple[Measure, ...]:
        """The measure of each name that comes nearest to its limit, or exceeds it most."""
        found: dict[str, Measure] = {}
        for one in self.measures:
            if one.name not in found or _closeness(one) > _closeness(found[one.name]):
                found[one.name] = one
        return tuple(found.values())

    def verdict_of(self, path: str) -> Verdict:
        """Return the most severe verdict about one file."""
        return worst([one.verdict for one in self.findings if one.path == path])

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain JSON types, without pictures."""
        return {
            "name": self.name,
            "verdict": self.verdict,
            "files": self.files,
            "reasons": [str(one) for one in self.reasons],
            "measures": [one.as_dict() for one in self.measures],
            "remarks": [one.as_dict() for one in self.remarks],
        }

    def format_text(self) -> str:
        """Return the verdict and its reasons; for a group to keep, its most critical values."""
        lines = [f"{self.name}: {self.verdict}"]
        lines += [f"    {one.verdict}: {one}" for one in self.reasons]
        if self.verdict == "keep":
            lines[0] += (
                f" ({self.files} files; {', '.join(measure_summary(one) for one in self.extremes if one.deviation)})"
            )
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

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain JSON types, without pictures."""
        return {"dataset": self.dataset, "ok": self.ok, "groups": [group.as_dict() for group in self.groups]}

    def format_text(self) -> str:
        """Return the report as text: each verdict with its reasons, then how many of each there are."""
        counts = [(sum(group.verdict == verdict for group in self.groups), verdict) for verdict in VERDICTS]
        total = ", ".join(f"{count} {verdict}" for count, verdict in counts if count)
        return "\n".join([*(group.format_text() for group in self.groups), f"{self.dataset}: {total}"])


def measure_summary(measure: Measure) -> str:
    """Return a measure's name and value, such as ``shift 0.02 ± 0.01 px``; a ratio as its distance from the nominal."""
    if not measure.kind.unit:
        off, error = (100 * value / measure.kind.expected for value in (measure.value, measure.standard_error))
        return f"{measure.name} {with_error(off - 100, max(error, _FINEST))} % off"
    if not measure.standard_error:
        return f"{measure.name} {measure.value:.3g} {measure.kind.unit}"
    return f"{measure.name} {with_error(measure.value, max(measure.standard_error, _FINEST))} {measure.kind.unit}"


_FINEST = 0.01  # of the digits in a summary: %, px or DN


def _closeness(measure: Measure) -> tuple[int, float, float]:
    # Of values that are well, one that may be chance is less close to its limit than its distance says.
    beyond_chance = max(0.0, measure.deviation - measure.kind.sigmas * measure.standard_error)
    limit = min(measure.kind.look, measure.kind.again)
    return VERDICTS.index(measure.verdict), beyond_chance / limit, measure.deviation / limit
