"""What a check finds: measures, each one value with its error and limits, and one verdict per scene or set of frames.

A value counts as beyond a limit if it is further from what is expected than the limit *and* than ``sigmas`` standard
errors: the limit says what would matter, the standard errors what cannot be chance.

How far light, exposure ratios and places may be off has one derivation, in decibels of a perfect denoiser's score.
A perfect denoiser predicts the scene as the noisy frame saw it. Against its reference nothing is left but what is wrong
with the pair: light that changed by a share e leaves an error of ``e * rms``, with the rms of the normalised scene; a
frame d pixels off leaves ``d * gradient``, with the rms of the scene's slope along the shift, per pixel. Its score is
then ``-20 log10(error)``. Where that equals the score of the best published denoising, the pair measures its own fault
as much as the method: it is to be shot again. Ten decibels above that the fault takes 0.4 dB off the best method's
score (``10 log10(1 + 0.1)``): from there on somebody has to look.

Which frame the light changed in, reference or noisy one, makes no difference to the error, so there is one limit.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from capture.checklist import TEMPLATES
from eldata.base.fields import shipped_toml
from eldata.base.files import write_text
from eldata.base.tables import with_error
from eldata.base.visible import in_line
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.manifest.verify_report import distinct

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

Verdict = Literal["keep", "look", "shoot again"]
"""What is to be done with a scene: kept, looked at by a person, or photographed again."""
VERDICTS: Final[tuple[Verdict, ...]] = get_args(Verdict)

SIGMAS: Final = 5.0
"""Standard errors below which a deviation may be chance: 6e-7 for one normal value."""


@dataclass(frozen=True, slots=True)
class MeasureKind:
    """A kind of measure: the expected value, the distances from which to look and to shoot again, and advice.

    Attributes
    ----------
    name
        Such as ``"drift"``.
    unit
        ``"%"``, ``"px"`` (of the mosaic), ``"DN"`` or ``""``.
    look, again
        Distances from ``expected`` in ``unit``; infinite if a value alone never leads to that verdict.
    source
        Where these limits come from, in words.
    advice
        What to do if a value is beyond them.
    expected
        The value of a good frame.
    sigmas
        Standard errors that the distance must exceed.
    text
        What a value is of, with ``{words}`` to fill in.
    """

    name: str
    unit: str
    look: float
    again: float
    source: str
    advice: str
    expected: float = 0.0
    sigmas: float = SIGMAS
    text: str = ""


# --- kinds and their limits ---

BEST_PSNR_DB: Final = 46.5
"""The best published denoising of ELD, at x100."""
LOOK_DB: Final = BEST_PSNR_DB + 10
"""The score of a perfect denoiser below which a pair is looked at; below :data:`BEST_PSNR_DB` it is shot again."""
RMS_OF_SCENE: Final = 0.3
"""Of full scale."""
RMS_GRADIENT: Final = 0.01
"""Of full scale, per pixel of the mosaic: of a scene with detail, normalised."""


def _error_from_psnr(score_db: float) -> float:
    """Convert a PSNR in dB to an RMS error, a share of full scale."""
    return float(10 ** (-score_db / 20))


LIGHT_LOOK: Final = _error_from_psnr(LOOK_DB) / RMS_OF_SCENE
LIGHT_AGAIN: Final = _error_from_psnr(BEST_PSNR_DB) / RMS_OF_SCENE
SHIFT_LOOK_PX: Final = _error_from_psnr(LOOK_DB) / RMS_GRADIENT
SHIFT_AGAIN_PX: Final = _error_from_psnr(BEST_PSNR_DB) / RMS_GRADIENT
_SOURCE: Final = (
    f"{{}} leaves a perfect denoiser {LOOK_DB} dB, at an {{}}; to shoot again: {BEST_PSNR_DB} dB, the best published "
    "denoising (ELD x100)"
)
LIGHT_SOURCE: Final = _SOURCE.format("light off by that share", f"rms of {RMS_OF_SCENE} of full scale")
SHIFT_SOURCE: Final = _SOURCE.format("a shift of that length", f"rms slope of {RMS_GRADIENT} of full scale a pixel")

# The nominal ratio only names a frame: by it frames are grouped, and swapped ones are found.
RATIO_LOOK: Final = float(RATIO_TOLERANCE)
RATIO_AGAIN: Final = 1 - 2 ** (-1 / 3)

_LIMITS: Final = {
    "light": (100 * LIGHT_LOOK, 100 * LIGHT_AGAIN),
    "shift": (SHIFT_LOOK_PX, SHIFT_AGAIN_PX),
    "verify": (100 * RATIO_LOOK, math.inf),
}


@cache
def find_kind(name: str) -> MeasureKind:
    """Read a kind of measure from ``kinds.toml``; a limit that depends on the frames is infinite there."""
    said: dict[str, Any] = {"name": name} | shipped_toml(Path(__file__).with_name("kinds.toml"))[name]
    limits = said.pop("limits", "")
    look, again = _LIMITS.get(limits, (math.inf, math.inf))
    said["source"] = said.get("source", f"{{{limits}}}").format(light=LIGHT_SOURCE, shift=SHIFT_SOURCE)
    return MeasureKind(**{"look": look, "again": again} | said)


@dataclass(frozen=True, slots=True)
class Measure:
    """One measured value of a frame, of two, or of a scene.

    Attributes
    ----------
    kind
        What is measured, and what is expected of it.
    path
        The file concerned, as in the manifest; of two, the later one.
    text
        What it says, as a clause that the value can follow: ``"brightness of R against IMG_0001.dng"``.
    value, standard_error
        In the kind's unit; the standard error is 0 for a count.
    """

    kind: MeasureKind
    path: str
    text: str
    value: float
    standard_error: float = 0.0

    @property
    def name(self) -> str:
        """Name of its kind."""
        return self.kind.name

    @property
    def deviation(self) -> float:
        """Distance from the expected value, in its unit."""
        return abs(self.value - self.kind.expected)

    @property
    def verdict(self) -> Verdict:
        """The verdict from the value alone."""
        if self.deviation <= self.kind.sigmas * self.standard_error:
            return "keep"
        if self.deviation > self.kind.again:
            return "shoot again"
        return "look" if self.deviation > self.kind.look else "keep"

    def __str__(self) -> str:
        unit = f" {self.kind.unit}" if self.kind.unit else ""
        limits = [f"expected {self.kind.expected:.4g}{unit}"] if self.kind.expected else []
        off = " off" if self.kind.expected else ""
        limits.append(f"look from {self.kind.look:.3g}{unit}{off}")
        if math.isfinite(self.kind.again):
            limits.append(f"shoot again from {self.kind.again:.3g}{unit}{off}")
        value = with_error(self.value, self.standard_error)
        return (
            f"{in_line(self.path)}: {self.name}: {self.text}: {value}{unit} ({', '.join(limits)}); {self.kind.advice}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the measure as plain JSON types."""
        return {
            "name": self.name,
            "path": self.path,
            "value": _drop_infinite(self.value),
            "standard_error": _drop_infinite(self.standard_error),
            "expected": self.kind.expected,
            "unit": self.kind.unit,
            "look_from": _drop_infinite(self.kind.look),
            "shoot_again_from": _drop_infinite(self.kind.again),
            "limits_from": self.kind.source,
            "least_standard_errors": self.kind.sigmas,
            "verdict": self.verdict,
            "text": self.text,
            "advice": self.kind.advice,
        }


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and its standard error."""

    value: float
    standard_error: float = 0.0

    def in_percent(self, off: float = 0.0) -> Estimate:
        """Express the distance from ``off`` in percent."""
        return Estimate(100 * (self.value - off), 100 * self.standard_error)


@dataclass(frozen=True, slots=True)
class Remark:
    """What cannot be expressed as a measure: a file that cannot be read, a missing reference."""

    path: str
    text: str
    verdict: Verdict

    def __str__(self) -> str:
        return in_line(f"{self.path}: {self.text}")


def worst(verdicts: list[Verdict]) -> Verdict:
    """Return the most severe verdict; ``"keep"`` of none."""
    return max(verdicts, key=VERDICTS.index, default="keep")


def _drop_infinite(value: float) -> float | None:
    """Replace an infinite number by ``None``, for JSON."""
    return value if math.isfinite(value) else None


# --- one scene, or the calibration frames of one ISO -----------------------------------------------------------------


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
    pairs
        The path of the reference, by the path of each noisy frame that could be read.
    """

    name: str
    files: int
    measures: list[Measure] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)
    pictures: list[SheetPicture] = field(default_factory=list)
    pairs: dict[str, str] = field(default_factory=dict)

    def measure(self, kind: MeasureKind | str, path: str, estimate: Estimate, **words: str) -> Measure:
        """Add a measure of a kind, or of a kind's name, with the words of its text; return it."""
        kind = find_kind(kind) if isinstance(kind, str) else kind
        self.measures.append(Measure(kind, path, kind.text.format(**words), estimate.value, estimate.standard_error))
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
        return worst([finding.verdict for finding in self.findings])

    @property
    def reasons(self) -> tuple[Measure | Remark, ...]:
        """Remarks and measures behind the verdict, and others worth a look; the worst first."""
        findings = [finding for finding in self.findings if finding.verdict != "keep"]
        return tuple(sorted(findings, key=lambda finding: -VERDICTS.index(finding.verdict)))

    def verdict_of(self, path: str) -> Verdict:
        """Return the most severe verdict about one file."""
        return worst([finding.verdict for finding in self.findings if finding.path == path])

    def columns(self) -> tuple[str, ...]:
        """List the names of the pairs' measures, in order of first occurrence."""
        return tuple(dict.fromkeys(measure.name for measure in self.measures if measure.path in self.pairs))

    def row(self, path: str) -> dict[str, Measure]:
        """Return the measures of a pair by name; ``path`` is its noisy frame's."""
        return {measure.name: measure for measure in self.measures if measure.path == path}

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain JSON types, without pictures."""
        fields = ("value", "standard_error", "unit", "verdict")
        rows = {path: [measure.as_dict() for measure in self.row(path).values()] for path in self.pairs}
        return {
            "name": self.name,
            "verdict": self.verdict,
            "files": self.files,
            "reasons": [str(reason) for reason in self.reasons],
            "measures": [measure.as_dict() for measure in self.measures],
            "remarks": [asdict(remark) for remark in self.remarks],
            "pairs": [
                {
                    "path": path,
                    "reference": reference,
                    "verdict": self.verdict_of(path),
                    "measured": {row["name"]: {field: row[field] for field in fields} for row in rows[path]},
                }
                for path, reference in self.pairs.items()
            ],
        }

    def format_text(self, alike: Collection[Measure] = ()) -> str:
        """Format the verdict and its reasons; of measures that are off alike in many files, their number."""
        own = [reason for reason in self.reasons if reason not in alike]
        lines = [f"{self.name}: {self.verdict}", *(f"    {reason.verdict}: {reason}" for reason in own)]
        if len(own) < len(self.reasons):
            lines.append(f"    {len(self.reasons) - len(own)} measures that are off alike in many files: see below")
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
        return tuple(map(_join_alike, _find_alike(self.groups)))

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain JSON types, without pictures."""
        return {"dataset": self.dataset, "ok": self.ok, "groups": [group.as_dict() for group in self.groups]}

    def format_text(self) -> str:
        """Format the scenes not to be kept and why, the measures that are :attr:`alike`, and the verdicts' counts."""
        alike = {measure for many in _find_alike(self.groups) for measure in many}
        total = ", ".join(f"{count} {verdict}" for verdict, count in self.counts.items())
        remarks = [remark for group in self.groups for remark in group.remarks if remark.verdict == "keep"]
        distinct_remarks = distinct((remark.path, (remark.text,)) for remark in remarks)
        groups = [group.format_text(alike) for group in self.groups if group.verdict != "keep"]
        return "\n".join([*groups, *self.alike, *map(str, distinct_remarks), f"{self.dataset}: {total}"])


# So many files that are off alike are one finding. What is alike: within 3 % of the nominal ratio, some times what the
# noise of a dark frame leaves of its measured ratio, and a tenth of a third of a stop.
_MANY = 5
_ALIKE = 0.03


def _find_alike(groups: Iterable[CheckedGroup]) -> list[list[Measure]]:
    """Return the measured ratios that are off by about the same factor, for the same reason, in many files."""
    groups_alike: dict[tuple[str, Verdict, str], list[Measure]] = defaultdict(list)
    for measure in (measure for group in groups for measure in group.measures):
        if measure.kind.expected and not measure.kind.unit and measure.verdict != "keep":
            groups_alike[measure.name, measure.verdict, measure.kind.advice].append(measure)
    alike = []
    for many in groups_alike.values():
        middle = median(map(_compute_share, many))
        close = [measure for measure in many if abs(_compute_share(measure) - middle) <= _ALIKE]
        alike += [close] if len(close) >= _MANY else []
    return alike


def _compute_share(measure: Measure) -> float:
    """Divide a measured ratio by its expected one."""
    return measure.value / measure.kind.expected


def _join_alike(many: Sequence[Measure]) -> str:
    """Describe ratios of many files that are off by about one factor, in a sentence."""
    first, shares = many[0], [100 * _compute_share(measure) for measure in many]
    return (
        f"{first.verdict}: {len(many)} files alike, such as {in_line(first.path)}: {first.name}: by the pixels it is "
        f"{median(shares):.0f} % of what it should be ({min(shares):.1f} to {max(shares):.1f} %); {first.kind.advice}"
    )


# --- the contact sheet: one HTML page that needs no network -----------------------------------------------------------


def write_sheet(path: Path | str, report: CheckReport) -> None:
    """Write the contact sheet of a report, whole or not at all."""
    from eldata.reports.html import render_page

    write_text(path, render_page("sheet.html", TEMPLATES, report=report, with_error=with_error))
