"""Mistakes in predictions that references show: undone, they would raise the scores.

A few frames of each camera and factor are looked at (:func:`choose_frames`). On some blocks of each, the orders of
channels, shifts and curves that mistakes leave behind are tried (:func:`find_mistake`); what stands out there is
undone on the whole frame and scored as the protocol does. What most frames show alike is a suspicion
(:func:`find_suspicions`).

A prediction that is merely poor is not to be accused. So a mistake has to be worth at least a decibel (a shift half of
one), most frames have to show the same one, and a curve has to be the mistake's own: the mean prediction at each level
of the reference lies on it, which neither noise nor the lifted shadows of clipped inputs do.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from eldata.evaluation.mistakes import GAIN_DB, Blocks, cut_margin, find_curve, find_place, is_copied_input
from eldata.raw.levels import BAYER_CHANNELS, packing_sites, unpack

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.mistakes import Circumstances, Undoing

    Array: TypeAlias = NDArray[Any]

EACH, MOST_FACTORS = 3, 4
"""How many frames of a camera and factor are looked at, and as many times of a camera with more factors."""

_SHARE = 2 / 3  # of the frames looked at that have to show the same mistake


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake that would explain the score of one prediction.

    Attributes
    ----------
    words
        What it is: ``as if packed R, G1, G2, B``.
    without_db
        The score with the mistake undone; ``None`` if it cannot be, or the score does not show it.
    """

    words: str
    without_db: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """A frame whose prediction was looked at.

    Attributes
    ----------
    path, camera, ratio
        Of its pair.
    psnr_db
        What it scored.
    mistake
        What it shows by itself, if anything.
    prediction, reference
        Both in a few hundred values (:func:`sketch`): a prediction of another frame shows among the others.
    """

    path: str
    camera: str
    ratio: float | None
    psnr_db: float
    mistake: Mistake | None
    prediction: NDArray[np.float32]
    reference: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A mistake that most of the predictions looked at show.

    Attributes
    ----------
    words
        What it is.
    where
        The camera, or camera and factor, that it is limited to; empty: all.
    shown, looked
        How many predictions show it, of how many looked at there.
    psnr_db, without_db
        Means over those that show it: the score, and that with the mistake undone, if known.
    example
        The noisy frame of one of them.
    """

    words: str
    where: str
    shown: int
    looked: int
    psnr_db: float
    without_db: float | None
    example: str

    def __str__(self) -> str:
        where = f"{self.where}: " if self.where else ""
        score = f"{self.psnr_db:.2f} dB"
        if self.without_db is not None:
            score += f" becomes {self.without_db:.2f}"
        return f"SUSPECT: {where}{self.words}: {score} in {self.shown} of {self.looked} looked at"


# --- one frame -------------------------------------------------------------------------------------------------------


def find_mistake(prediction: Array, target: Array, psnr_db: float, now: Circumstances) -> Mistake | None:
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
    blocks = Blocks.of(target, now.protocol.crop(target.shape)) if math.isfinite(psnr_db) else None
    if blocks is None:
        return None
    p, g = blocks.cut(prediction), blocks.cut(target)
    inner = cut_margin(g)
    if float(inner.max()) - float(inner.min()) < 1e-6:  # nothing to tell by
        return None
    if float(p.max()) == float(p.min()) and float(prediction.max()) == float(prediction.min()):
        return Mistake(f"every value is {float(p.flat[0]):.4g}")
    if is_copied_input(p, inner, blocks, now):
        return Mistake("as if the noisy input, amplified, were copied")
    explanations: list[tuple[float, Mistake]] = []
    whole = _find_quadrants(prediction, target, now)
    for undoing in filter(None, (whole, find_curve(p, g, now), find_place(p, inner, now))):
        words, undo, least_db = undoing
        if undo is None:
            explanations.append((GAIN_DB, Mistake(words)))
            continue
        without_db = now.score(np.ascontiguousarray(undo(prediction), prediction.dtype)).psnr_db
        if without_db - psnr_db >= least_db:
            explanations.append((without_db - psnr_db, Mistake(words, without_db)))
    if explanations:
        return max(explanations, key=lambda explanation: explanation[0])[1]
    restored = _restore_clipped(prediction, target)
    if restored is None or now.score(restored).psnr_db - psnr_db < GAIN_DB:
        return None
    return Mistake(f"as if clipped at {float(prediction.max()):.3g}")


def _find_quadrants(prediction: Array, target: Array, now: Circumstances) -> Undoing | None:
    """Recognise a mosaic whose quadrants are the four planes: each of its channels shows them in small."""
    from scipy.optimize import linear_sum_assignment

    if now.sensor is None or len(prediction) != len(BAYER_CHANNELS):
        return None
    cfa = packing_sites(now.sensor.cfa).cfa  # as the packed area has it
    likeness = float(sketch(_cut_quadrants(prediction[0])) @ sketch(target))
    if likeness < max(_LIKE, float(sketch(prediction) @ sketch(target)) + _LIKER):
        return None

    def undo(image: Array) -> Array:
        """Put the planes into the order of the reference's channels."""
        planes = _cut_quadrants(unpack(image, cfa))
        agreement = planes.reshape(len(planes), -1) @ target.reshape(len(target), -1).T
        return planes[np.argsort(linear_sum_assignment(agreement, maximize=True)[1])]

    return "as if the four planes were the quadrants of one mosaic", undo, GAIN_DB


def _cut_quadrants(plane: Array) -> Array:
    """Cut (H, W) into (4, H/2, W/2)."""
    height, width = (size // 2 for size in plane.shape)
    return np.stack([plane[y : y + height, x : x + width] for y in (0, height) for x in (0, width)])


_CLIPPED_SHARE, _BEYOND = 1e-3, 1.2  # of values at a prediction's highest; by how much the reference exceeds that


def _restore_clipped(prediction: Array, target: Array) -> Array | None:
    """Put the reference, on the prediction's scale, where the prediction is cut off; ``None`` if it is not."""
    top = prediction.max()
    clipped = prediction == top
    kept_sum, light = (float(image[~clipped].sum(dtype=np.float64)) for image in (prediction, target))
    if clipped.mean() < _CLIPPED_SHARE or min(kept_sum, light) <= 0:
        return None
    scale = light / kept_sum
    if target[clipped].mean(dtype=np.float64) < _BEYOND * scale * top:
        return None
    return np.where(clipped, target / scale, prediction).astype(prediction.dtype)


# --- which frames, and what they say together -------------------------------------------------------------------------

_GOLDEN = (math.sqrt(5) - 1) / 2


def choose_frames(frames: Iterable[tuple[str, str, float | None, float]]) -> frozenset[str]:
    """Return the paths of the frames to look at: up to :data:`EACH` of each camera and factor, spread over ISOs.

    Of a camera with more than :data:`MOST_FACTORS` factors they are spread over these too, and as many as of so many.

    Parameters
    ----------
    frames
        Path, camera, factor and ISO of each.
    """
    cameras: dict[str, dict[float, list[tuple[float, str]]]] = defaultdict(lambda: defaultdict(list))
    for path, camera, ratio, iso in frames:
        cameras[camera][ratio or 0.0].append((iso, path))
    parts: list[tuple[list[tuple[float, str]], int]] = []
    for camera in sorted(cameras):
        groups = [sorted(cameras[camera][ratio]) for ratio in sorted(cameras[camera])]
        if len(groups) <= MOST_FACTORS:
            parts += [(members, EACH) for members in groups]
        else:
            parts.append(([member for members in groups for member in members], EACH * MOST_FACTORS))
    return frozenset(path for turn, (members, most) in enumerate(parts) for path in _spread_choice(members, most, turn))


def _spread_choice(members: Sequence[tuple[float, str]], most: int, turn: int) -> Iterator[str]:
    """Yield paths spread over a list, others each turn, at unequal distances, since scenes repeat at equal ones."""
    count = min(most, len(members))
    for index in range(count):
        part = (turn + index + 0.5) * _GOLDEN % 1
        yield members[int((index + part) / count * len(members))][1]


# Of what frames a mistake may be: of all, else of a camera, else of a camera and factor.
_PLACES: tuple[Callable[[Inspection], str], ...] = (
    lambda _: "",
    lambda frame: frame.camera,
    lambda frame: frame.camera if frame.ratio is None else f"{frame.camera} x{frame.ratio:g}",
)


def find_suspicions(inspections: Sequence[Inspection]) -> tuple[Suspicion, ...]:
    """Return the mistakes that most frames show alike: of all, else of a camera, else of a camera and factor.

    A prediction of another frame is a mistake wherever it occurs.
    """
    exchanged = _find_exchanged(inspections)
    shared = _find_shared_mistakes(inspections, min(2, len(inspections)))
    return (*exchanged, *shared) or tuple(_find_exchanged_cameras(inspections))


def _find_shared_mistakes(inspections: Sequence[Inspection], fewest: int, depth: int = 0) -> list[Suspicion]:
    """Find the mistakes of whole groups: all frames, else a camera's, else a camera and factor's."""
    suspicions = []
    for where, members in _group_by(inspections, _PLACES[depth]).items():
        if (shared := _find_shared_mistake(members, where, fewest)) is not None:
            suspicions.append(shared)
        elif depth + 1 < len(_PLACES):
            suspicions += _find_shared_mistakes(members, fewest, depth + 1)
    return suspicions


def sketch(image: Array) -> NDArray[np.float32]:
    """Return the means over channels at the points of a grid, clipped to [0, 1], with mean 0 and length 1.

    Parameters
    ----------
    image
        (C, h, w).
    """
    rows, columns = (
        np.linspace(0, size - 1, count).astype(int) for size, count in zip(image.shape[1:], _SKETCH, strict=True)
    )
    points = np.clip(image[:, rows[:, None], columns], 0, 1)
    values: NDArray[np.float32] = points.mean(axis=0, dtype=np.float32).ravel()
    values -= values.mean()
    length = np.float32(np.linalg.norm(values))
    if length > 0:
        values /= length
    return values


_SKETCH = (24, 36)
_LIKE, _LIKER = 0.7, 0.3  # the correlation with another reference, at least, and by how much it is the higher one


def _find_exchanged(inspections: Sequence[Inspection]) -> list[Suspicion]:
    """Suspect predictions of belonging to other frames if some are like another frame's reference."""
    references = np.stack([inspection.reference for inspection in inspections]) if inspections else np.empty((0, 0))
    exchanged = []
    for inspection in inspections:
        likeness = references @ inspection.prediction
        other = int(likeness.argmax())
        if likeness[other] >= max(_LIKE, float(inspection.reference @ inspection.prediction) + _LIKER):
            exchanged.append((inspection, inspections[other]))
    if not exchanged:
        return []
    first, its = exchanged[0]
    words = f"as if of another frame: that of {first.path} is like the reference of {its.path}"
    score = fmean([inspection.psnr_db for inspection, _ in exchanged])
    return [Suspicion(words, "", len(exchanged), len(inspections), score, None, first.path)]


_SURE = 2.0  # standard errors by which a camera's predictions fit another's references better


def _find_exchanged_cameras(inspections: Sequence[Inspection]) -> list[Suspicion]:
    """Suspect two cameras' predictions if those of either fit the other's references better than their own."""
    cameras, suspicions = _group_by(inspections, lambda inspection: inspection.camera), []
    for first, second in combinations(cameras, 2):
        gains = []
        for camera, other in ((first, second), (second, first)):
            references = np.stack([inspection.reference for inspection in cameras[other]])
            fits = [(references @ own.prediction).max() - own.reference @ own.prediction for own in cameras[camera]]
            gains.append([float(fit) for fit in fits])
        if all(len(of) >= EACH and fmean(of) > _SURE * stdev(of) / math.sqrt(len(of)) for of in gains):
            members = [*cameras[first], *cameras[second]]
            score = fmean([inspection.psnr_db for inspection in members])
            words = f"as if the predictions of {first} and {second} were exchanged"
            suspicions.append(Suspicion(words, "", len(members), len(inspections), score, None, members[0].path))
    return suspicions


def _group_by(inspections: Sequence[Inspection], key: Callable[[Inspection], Any]) -> dict[Any, list[Inspection]]:
    """Group inspections by a key."""
    groups: dict[Any, list[Inspection]] = defaultdict(list)
    for inspection in inspections:
        groups[key(inspection)].append(inspection)
    return groups


def _find_shared_mistake(inspections: Sequence[Inspection], where: str, fewest: int) -> Suspicion | None:
    """Return the mistake that most of these frames show, if there is one."""
    showing = _group_by(inspections, lambda inspection: inspection.mistake and inspection.mistake.words)
    showing.pop(None, None)
    words, most = max(showing.items(), key=lambda item: len(item[1]), default=("", []))
    if not most or len(most) < max(_SHARE * len(inspections), fewest):
        return None
    mistakes = [inspection.mistake for inspection in most if inspection.mistake]
    without = [mistake.without_db for mistake in mistakes if mistake.without_db is not None]
    psnr_db = fmean([inspection.psnr_db for inspection in most])
    without_db = fmean(without) if len(without) == len(most) else None
    return Suspicion(words, where, len(most), len(inspections), psnr_db, without_db, most[0].path)
