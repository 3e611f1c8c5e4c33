"""Calibration frames of one ISO: bias frames against each other, flats in pairs.

A bias frame becomes a grid of 8 x 8 patches: the median of its cells, which forgives hot pixels, averaged over the
channels. From each the median over the *other* frames is taken off, so that what belongs to the sensor drops out and
what differs stays. The standard error of a patch comes from the scatter of its rows of cells, row noise included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.frames import ReducedFrame, Unit, file_name, map_picture, reduced_frames, scene_picture
from capture.check.ratio import BLOCK, OF_MEDIAN, TO_SIGMA, brightness_ratios
from capture.check.result import CheckedGroup, Estimate, find_kind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.check.frames import Cells

PATCHES: Final = 8  # along each side
_PICTURES: Final = 4  # of frames without a finding
_SHOWN_DN: Final = 2.0  # the strongest colour of a map


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
        group.measure("black", path, Estimate(frame.cells.zero_share).in_percent())
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
    kind = replace(find_kind("shading"), look=max(2.0, noise_dn))
    folder = patches[0].path.rpartition("/")[0] or "."
    group.measure(kind, folder, Estimate(float(middle.max() - middle.min()), error))


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
    of_level, of_leak = (
        replace(find_kind(name), look=max(0.25, 0.1 * noise_dn), again=max(1.0, 0.5 * noise_dn))
        for name in ("level", "leak")
    )
    group.measure(of_level, own.path, Estimate(level, level_error))
    group.measure(of_leak, own.path, Estimate(float(uneven[place]), error), where=where)
    if len(others) < _PICTURES or any(one.verdict != "keep" for one in group.measures[-2:]):
        group.pictures.append(map_picture(f"{file_name(own.path)} less the others, ±2 DN", own.path, change, _SHOWN_DN))


def _middle(patches: Sequence[PatchLevels]) -> NDArray[np.float64]:
    middle: NDArray[np.float64] = np.median([levels.level_dn for levels in patches], axis=0)
    return middle


def _third(place: np.intp, names: tuple[str, str, str]) -> str:
    return names[min(2, 3 * int(place) // PATCHES)]


# --- flats ------------------------------------------------------------------------------------------------------------


def unevenness(cells: Cells) -> float:
    """Return the distance of the 5th and the 95th percentile of the blocks over their median, of the worst channel."""
    mean, _ = cells.pooled(BLOCK, BLOCK)
    low, middle, high = np.quantile(mean.reshape(len(mean), -1), (0.05, 0.5, 0.95), axis=1)
    return float(np.max((high - low) / np.maximum(middle, 1e-6)))


def check_flats(unit: Unit) -> CheckedGroup:
    """Check the flats of one ISO; two in succession with the same exposure time are a pair."""
    group = CheckedGroup(unit.name, len(unit.records))
    waiting: ReducedFrame | None = None
    for frame in reduced_frames(unit, group):
        path = frame.record.path
        if min(frame.cells.mean_dn.shape[1:]) < BLOCK:
            group.remark(path, "is too small to check")
            continue
        group.measure("saturation", path, Estimate(frame.cells.clipped_share).in_percent())
        group.measure("evenness", path, Estimate(unevenness(frame.cells)).in_percent())
        if waiting is None or waiting.header.exposure.exposure_s != frame.header.exposure.exposure_s:
            _leave_single(waiting, group)
            waiting = frame
            continue
        _compare_pair(waiting, frame, group)
        mean, _ = waiting.cells.pooled(BLOCK, BLOCK)
        light = mean[1] / max(float(np.median(mean[1])), 1e-6) - 1
        caption = f"{file_name(waiting.record.path)}: light over its median, ±50 %"
        group.pictures += [scene_picture(waiting, 1.0), map_picture(caption, waiting.record.path, light, 0.5)]
        waiting = None
    _leave_single(waiting, group)
    return group


def _leave_single(frame: ReducedFrame | None, group: CheckedGroup) -> None:
    if frame is not None:
        group.remark(frame.record.path, "has no partner of the same exposure time beside it: take flats in pairs")


def _compare_pair(first: ReducedFrame, second: ReducedFrame, group: CheckedGroup) -> None:
    path = second.record.path
    known = [one for one in brightness_ratios(first.cells, second.cells) if one is not None]
    if not known:
        group.remark(path, "too dark, or too much of it saturated, to compare it with its partner")
        return
    ratio = max(known, key=lambda one: abs(one.value - 1))
    group.measure("pair", path, ratio.in_percent(1), against=file_name(first.record.path))
