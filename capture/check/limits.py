"""How far light, exposure ratios and places may be off: one derivation, in decibels of a perfect denoiser's score.

A perfect denoiser predicts the scene as the noisy frame saw it. Against its reference nothing is left but what is wrong
with the pair: light that changed by a share e leaves an error of ``e * rms``, with the rms of the normalised scene; a
frame d pixels off leaves ``d * gradient``, with the rms of the scene's slope along the shift, per pixel. Its score is
then ``-20 log10(error)``. Where that equals the score of the best published denoising, the pair measures its own fault
as much as the method: it is to be shot again. Ten decibels above that the fault takes 0.4 dB off the best method's
score (``10 log10(1 + 0.1)``): from there on somebody has to look.

Which frame the light changed in, reference or noisy one, makes no difference to the error, so there is one limit.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from capture.check.measures import MeasureKind
from eldata.base.fields import TextFile
from eldata.errors import ArgumentError
from eldata.manifest.verify import RATIO_TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Mapping

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
    "wave": (100 * 2**0.5 * LIGHT_LOOK, 100 * 2**0.5 * LIGHT_AGAIN),
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
