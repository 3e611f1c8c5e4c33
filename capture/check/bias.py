"""Bias frames of one ISO against each other: level, light leaks, clipped black.

Each frame becomes a grid of 8 x 8 patches: the median of its cells, which forgives hot pixels, averaged over the
channels. From each the median over the *other* frames is taken off, so that what belongs to the sensor drops out and
what differs stays. The standard error of a patch comes from the scatter of its rows of cells, row noise included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.drift import OF_MEDIAN, TO_SIGMA
from capture.check.frames import Unit, file_name, reduced_frames
from capture.check.measures import MeasureKind
from capture.check.pictures import map_picture
from capture.check.result import CheckedGroup

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.check.cells import Cells

PATCHES: Final = 8  # along each side
# Chance exceeds six standard errors once in 500 million patches: of ten frames of 64 patches, never.
_PATCH_SIGMAS: Final = 6.0
_PICTURES: Final = 4  # of frames without a finding
_SHOWN_DN: Final = 2.0  # the strongest colour of a map
_BLACK = MeasureKind(
    "black",
    "%",
    0.1,
    1.0,
    "from 1 % on eldata calibrate refuses the frames: clipped black shows neither mean nor noise",
    "use raw files that keep their black level",
)


@dataclass(frozen=True, slots=True, eq=False)
class PatchLevels:
    """A bias frame in 8 x 8 levels over black, the standard error of each, and the noise per pixel; all in DN."""

    path: str
    level_dn: NDArray[np.float64]
    error_dn: float
    noise_dn: float


def patch_levels(path: str, cells: Cells) -> PatchLevels:
    """Reduce a bias frame to patches."""
    levels, errors = np.zeros((PATCHES, PATCHES)), np.zeros((PATCHES, PATCHES))
    for i, rows in enumerate(np.array_split(cells.mean_dn.astype(np.float64), PATCHES, axis=1)):
        for j, patch in enumerate(np.array_split(rows, PATCHES, axis=2)):
            levels[i, j] = np.median(patch, axis=(1, 2)).mean()
            of_each_row = np.median(patch, axis=2).mean(axis=0)
            spread = TO_SIGMA * np.median(np.abs(of_each_row - np.median(of_each_row)))
            errors[i, j] = OF_MEDIAN * max(spread, of_each_row.std() / 2) / len(of_each_row) ** 0.5
    # Patches of one row share its noise, and few rows tell their scatter badly: one error for all, from all.
    return PatchLevels(path, levels, float(np.sqrt(np.mean(errors**2))), cells.spread_dn)


def check_bias(unit: Unit) -> CheckedGroup:
    """Check the bias frames of one ISO."""
    group = CheckedGroup(unit.name, len(unit.records))
    patches: list[PatchLevels] = []
    for frame in reduced_frames(unit, group):
        path = frame.record.path
        if min(frame.cells.mean_dn.shape[1:]) < 2 * PATCHES:
            group.remark(path, "is too small to look for light leaks in")
            continue
        group.measure(_BLACK, path, "pixels at 0 DN", 100 * frame.cells.zero_share)
        patches.append(patch_levels(path, frame.cells))
    if len(patches) == 1:
        text = "is the only bias frame of this ISO: a light leak cannot be told from the sensor's own pattern"
        group.remark(patches[0].path, text)
    elif patches:
        noise = float(np.median([levels.noise_dn for levels in patches]))
        _compare_together(patches, noise, group)
        for own in patches:
            _compare(own, [other for other in patches if other is not own], noise, group)
    return group


def _compare_together(patches: Sequence[PatchLevels], noise_dn: float, group: CheckedGroup) -> None:
    """Measure how uneven all frames are together."""
    middle = _middle(patches)
    group.pictures.append(map_picture("all frames: level, ±2 DN", patches[0].path, middle - middle.mean(), _SHOWN_DN))
    error = 2**0.5 * float(np.mean([levels.error_dn for levels in patches])) * OF_MEDIAN / len(patches) ** 0.5
    kind = MeasureKind(
        "shading",
        "DN",
        max(2.0, noise_dn),
        float("inf"),
        "the noise of a pixel, or 2 DN: more than the dark shading of usual sensors at a short exposure",
        "a light leak in all of them, or the sensor's own shading: take one in full darkness and compare",
        sigmas=_PATCH_SIGMAS,
    )
    text = "difference between the brightest and the darkest part, in all bias frames of this ISO"
    folder = patches[0].path.rpartition("/")[0] or "."
    group.measure(kind, folder, text, float(middle.max() - middle.min()), error)


def _compare(own: PatchLevels, others: Sequence[PatchLevels], noise_dn: float, group: CheckedGroup) -> None:
    """Measure one bias frame against the others; show the map of its difference if something is found."""
    change = own.level_dn - _middle(others)
    of_others = OF_MEDIAN * np.mean([other.error_dn for other in others]) / len(others) ** 0.5
    error = float(np.hypot(own.error_dn, of_others))
    level = float(change.mean())
    # Patches beside each other share their rows' noise, so that only as many as there are above each other count.
    level_error = error / PATCHES**0.5
    uneven = change - level
    place = np.unravel_index(int(np.argmax(np.abs(uneven))), uneven.shape)
    where = f"{_third(place[0], ('top', 'middle', 'bottom'))} {_third(place[1], ('left', 'centre', 'right'))}"
    leaking = f"unlike the other bias frames at the {where}, by"
    group.measure(_level(noise_dn), own.path, "mean, less that of the other bias frames", level, level_error)
    group.measure(_leak(noise_dn), own.path, leaking, float(uneven[place]), error)
    if len(others) < _PICTURES or any(one.verdict != "keep" for one in group.measures[-2:]):
        group.pictures.append(map_picture(f"{file_name(own.path)} less the others, ±2 DN", own.path, change, _SHOWN_DN))


def _middle(patches: Sequence[PatchLevels]) -> NDArray[np.float64]:
    middle: NDArray[np.float64] = np.median([levels.level_dn for levels in patches], axis=0)
    return middle


def _level(noise_dn: float) -> MeasureKind:
    return MeasureKind(
        "level",
        "DN",
        max(0.25, 0.1 * noise_dn),
        max(1.0, 0.5 * noise_dn),
        "a tenth of the noise of a pixel, or 0.25 DN; to shoot again: half of the noise, or 1 DN, as eldata calibrate",
        "is it a bias frame of this ISO, with the lens capped, and was the camera as warm?",
    )


def _leak(noise_dn: float) -> MeasureKind:
    advice = "light came in: cap the lens, cover the viewfinder, darken the room"
    return replace(_level(noise_dn), name="leak", advice=advice, sigmas=_PATCH_SIGMAS)


def _third(place: np.intp, names: tuple[str, str, str]) -> str:
    return names[min(2, 3 * int(place) // PATCHES)]
