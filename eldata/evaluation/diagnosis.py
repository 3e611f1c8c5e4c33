"""What is wrong with a prediction, as far as its reference shows: a mistake that, undone, would raise its score.

A few frames of each camera and factor are looked at (:func:`~eldata.evaluation.suspicions.chosen_frames`). On some
blocks of each, the orders of channels, shifts, flips and curves that mistakes leave behind are tried
(:func:`mistake_in`); what stands out there is undone on the whole frame and scored as the protocol does. What most
frames show alike is a suspicion (:func:`~eldata.evaluation.suspicions.suspicions_of`).

A prediction that is merely poor is not to be accused. So a mistake has to be worth at least a decibel (a shift half of
one), most frames have to show the same one, and a curve has to be the mistake's own: the mean prediction at each level
of the reference lies on it, which neither noise nor the lifted shadows of clipped inputs do.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.evaluation.inspected_frame import GAIN_DB, Blocks, LevelsTaken, inner_entries
from eldata.evaluation.mistaken_curves import LEAST_RATIO, best_curve
from eldata.evaluation.mistaken_places import best_place
from eldata.evaluation.suspicions import Mistake

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    from eldata.evaluation.inspected_frame import Circumstances

    Array: TypeAlias = NDArray[Any]


def mistake_in(prediction: Array, target: Array, psnr_db: float, now: Circumstances) -> Mistake | None:
    """Return the mistake that would explain the score of a prediction, if there is one that stands out.

    Parameters
    ----------
    prediction, target
        (C, h, w) of the whole frame; the prediction as it was loaded.
    psnr_db
        What it scored.
    now
        How it was scored.
    """
    if math.isinf(psnr_db) or math.isnan(psnr_db):
        return None
    blocks = Blocks.of(target, now.protocol.crop(target.shape))
    if blocks is None:
        return None
    p, g = blocks.cut(prediction), blocks.cut(target)
    inner = inner_entries(g)
    if float(inner.max()) - float(inner.min()) < 1e-6:  # nothing to tell by
        return None
    if float(p.max()) == float(p.min()) and float(prediction.max()) == float(prediction.min()):
        return Mistake(f"every value is {float(p.flat[0]):.4g}", psnr_db)
    if _is_of_whole_dn(p, now) and _is_input(inner_entries(p), inner, inner_entries(blocks.cut(now.amplified()))):
        return Mistake("as if the noisy input, amplified, were copied", psnr_db)
    found: list[tuple[float, Mistake]] = []
    for candidate in (best_curve(p, g, now), best_place(prediction, blocks, p, inner, now)):
        if candidate is None:
            continue
        if candidate.undo is None:
            found.append((GAIN_DB, Mistake(candidate.words, psnr_db)))
            continue
        undone = np.ascontiguousarray(candidate.undo(prediction), prediction.dtype)
        without_db = now.score(undone).psnr_db
        if without_db - psnr_db >= candidate.least_db:
            found.append((without_db - psnr_db, Mistake(candidate.words, psnr_db, without_db)))
    return max(found, key=lambda one: one[0])[1] if found else None


# --- the noisy input --------------------------------------------------------------------------------------------------

_LEAST_VALUES = 256
_OFF_WHOLE_DN = 0.1
_WHOLE_SHARE = 0.9
_SAME_ERRORS = 0.99


def _is_of_whole_dn(p: NDArray[np.float32], now: Circumstances) -> bool:
    """Return whether values, divided by the factor, are whole DN: those of the input, or a choice of them."""
    sensor, ratio = now.sensor, now.ratio
    if sensor is None or ratio is None or ratio < LEAST_RATIO:
        return False
    values = p.ravel()
    values = values[(values > 0) & (values < 1)][: 8 * _LEAST_VALUES].astype(np.float64)
    if values.size < _LEAST_VALUES:
        return False
    levels = LevelsTaken.of(sensor, now.protocol)
    for white in levels.whites:
        steps = values * ((white - levels.black) / ratio)
        steps -= np.rint(steps)
        # The black levels of channels may differ by fractions of a DN.
        if np.mean(np.abs(steps - np.median(steps)) < _OFF_WHOLE_DN) > _WHOLE_SHARE:
            return True
    return False


def _is_input(p: NDArray[np.float32], g: NDArray[np.float32], amplified: NDArray[np.float32]) -> bool:
    """Return whether a prediction errs as the input does."""
    errors = np.stack([np.clip(image, 0, 1) - g for image in (p, amplified)]).reshape(2, -1)
    return bool(np.corrcoef(errors)[0, 1] > _SAME_ERRORS)
