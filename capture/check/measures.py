"""What a check finds: one measured value, its standard error, its limits and where they come from.

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
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from eldata.base.fields import TextFile
from eldata.base.tables import with_error
from eldata.base.visible import in_line
from eldata.errors import ArgumentError
from eldata.manifest.pair_checks import RATIO_TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Mapping

Verdict = Literal["keep", "look", "shoot again"]
"""What is to be done with a scene: kept, looked at by a person, or photographed again."""
VERDICTS: Final[tuple[Verdict, ...]] = get_args(Verdict)

SIGMAS: Final = 5.0
"""Standard errors below which a deviation may be chance: 6e-7 for one normal value."""


@dataclass(frozen=True, slots=True)
class MeasureKind:
    """A kind of measure: what is expected, at which distance to look and to shoot again, and what to do then.

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


def _error_at(score_db: float) -> float:
    return float(10 ** (-score_db / 20))


LIGHT_LOOK: Final = _error_at(LOOK_DB) / RMS_OF_SCENE
LIGHT_AGAIN: Final = _error_at(BEST_PSNR_DB) / RMS_OF_SCENE
LIGHT_SOURCE: Final = (
    f"light off by that share leaves a perfect denoiser {LOOK_DB} dB, at an rms of {RMS_OF_SCENE} of full scale; to "
    f"shoot again: {BEST_PSNR_DB} dB, the best published denoising (ELD x100)"
)

SHIFT_LOOK_PX: Final = _error_at(LOOK_DB) / RMS_GRADIENT
SHIFT_AGAIN_PX: Final = _error_at(BEST_PSNR_DB) / RMS_GRADIENT
SHIFT_SOURCE: Final = (
    f"a shift of that length leaves a perfect denoiser {LOOK_DB} dB, at an rms slope of {RMS_GRADIENT} of full scale a "
    f"pixel; to shoot again: {BEST_PSNR_DB} dB, the best published denoising (ELD x100)"
)

# The nominal ratio only names a frame: by it frames are grouped, and swapped ones are found.
RATIO_LOOK: Final = float(RATIO_TOLERANCE)
RATIO_AGAIN: Final = 1 - 2 ** (-1 / 3)

_LIMITS: Final = {
    "light": (100 * LIGHT_LOOK, 100 * LIGHT_AGAIN),
    "shift": (SHIFT_LOOK_PX, SHIFT_AGAIN_PX),
    "verify": (100 * RATIO_LOOK, float("inf")),
}
_NO_LIMITS: Final = (float("inf"), float("inf"))


@cache
def _kinds() -> Mapping[str, Any]:
    return TextFile(Path(__file__).with_name("kinds.toml"), ArgumentError).toml().data


@cache
def find_kind(name: str) -> MeasureKind:
    """Return what ``kinds.toml`` says of a kind of measure; a limit that depends on the frames is infinite there."""
    said: dict[str, Any] = {"name": name} | _kinds()[name]
    limits = said.pop("limits", "")
    look, again = _LIMITS.get(limits, _NO_LIMITS)
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
        """The kind's."""
        return self.kind.name

    @property
    def deviation(self) -> float:
        """Distance from what is expected, in the unit of the value."""
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
        found = with_error(self.value, self.standard_error)
        return (
            f"{in_line(self.path)}: {self.name}: {self.text}: {found}{unit} ({', '.join(limits)}); {self.kind.advice}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the measure as plain JSON types."""
        return {
            "name": self.name,
            "path": self.path,
            "value": _finite(self.value),
            "standard_error": _finite(self.standard_error),
            "expected": self.kind.expected,
            "unit": self.kind.unit,
            "look_from": _finite(self.kind.look),
            "shoot_again_from": _finite(self.kind.again),
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
        """Return it in percent, as the distance from ``off``."""
        return Estimate(100 * (self.value - off), 100 * self.standard_error)


@dataclass(frozen=True, slots=True)
class Remark:
    """What cannot be expressed as a measure: a file that cannot be read, a missing reference."""

    path: str
    text: str
    verdict: Verdict

    def __str__(self) -> str:
        return in_line(f"{self.path}: {self.text}")

    def as_dict(self) -> dict[str, Any]:
        """Return the remark as plain JSON types."""
        return {"path": self.path, "text": self.text, "verdict": self.verdict}


def worst(verdicts: list[Verdict]) -> Verdict:
    """Return the most severe verdict; ``"keep"`` of none."""
    return max(verdicts, key=VERDICTS.index, default="keep")


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
