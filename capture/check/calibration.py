"""Calibration frames of one ISO: bias frames against each other, flats in pairs.

A bias frame becomes a grid of 8 x 8 patches: the median of its cells, which forgives hot pixels, averaged over the
channels. From each the median over the *other* frames is taken off, so that what belongs to the sensor drops out and
what differs stays. The standard error of a patch comes from the scatter of its rows of cells, row noise included.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.frames import Cells, ReducedFrame, Unit, draw_map, draw_scene, file_name, reduce_frames
from capture.check.ratio import BLOCK, OF_MEDIAN, TO_SIGMA, measure_brightness
from capture.check.result import CheckedGroup, Estimate, find_kind

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from numpy.typing import NDArray

    Levels = NDArray[np.float64]

PATCHES: Final = 8  # along each side
_PICTURES: Final = 4  # of frames without a finding
_SHOWN_DN: Final = 2.0  # the strongest colour of a map


def measure_patches(cells: Cells) -> tuple[Levels, float]:
    """Reduce a bias frame to patches: their levels over black, (8, 8), and the standard error of one; DN."""
    levels, errors = np.zeros((PATCHES, PATCHES)), np.zeros((PATCHES, PATCHES))
    for i, rows in enumerate(np.array_split(cells.mean_dn.astype(np.float64), PATCHES, axis=1)):
        for j, patch in enumerate(np.array_split(rows, PATCHES, axis=2)):
            levels[i, j] = np.median(patch, axis=(1, 2)).mean()
            of_each_row = np.median(patch, axis=2).mean(axis=0)
            spread = TO_SIGMA * np.median(np.abs(of_each_row - np.median(of_each_row)))
            errors[i, j] = OF_MEDIAN * max(spread, of_each_row.std() / 2) / len(of_each_row) ** 0.5
    # Patches of one row share its noise, and few rows tell their scatter badly: one error for all, from all.
    return levels, float(np.sqrt(np.mean(errors**2)))


def check_bias(unit: Unit) -> CheckedGroup:
    """Check the bias frames of one ISO."""
    group = CheckedGroup(unit.name, len(unit.records))
    patches: dict[str, tuple[Levels, float]] = {}
    noises_dn: list[float] = []
    for frame in reduce_frames(unit, group):
        path = frame.record.path
        if min(frame.cells.mean_dn.shape[1:]) < 2 * PATCHES:
            group.remark(path, "is too small to look for light leaks in")
            continue
        group.measure("black", path, Estimate(frame.cells.zero_share).in_percent())
        patches[path] = measure_patches(frame.cells)
        noises_dn.append(frame.cells.spread_dn)
    if len(patches) == 1:
        text = "is the only bias frame of this ISO: a light leak cannot be told from the sensor's own pattern"
        group.remark(next(iter(patches)), text)
    elif patches:
        noise_dn = float(np.median(noises_dn))
        _measure_shading(patches, noise_dn, group)
        for path in patches:
            _compare_with_others(path, patches, noise_dn, group)
    return group


def _measure_shading(patches: Mapping[str, tuple[Levels, float]], noise_dn: float, group: CheckedGroup) -> None:
    """Measure how uneven all frames are together."""
    first, (middle, error) = next(iter(patches)), _take_medians(patches.values())
    group.pictures.append(draw_map("all frames: level, ±2 DN", first, middle - middle.mean(), _SHOWN_DN))
    kind = replace(find_kind("shading"), look=max(2.0, noise_dn))
    group.measure(kind, first.rpartition("/")[0] or ".", Estimate(float(np.ptp(middle)), 2**0.5 * error))


def _compare_with_others(
    path: str, patches: Mapping[str, tuple[Levels, float]], noise_dn: float, group: CheckedGroup
) -> None:
    """Measure one bias frame against the others; show the map of its difference if something is found."""
    others = [levels for other, levels in patches.items() if other != path]
    middle, error_of_others = _take_medians(others)
    change = patches[path][0] - middle
    error = float(np.hypot(patches[path][1], error_of_others))
    level = float(change.mean())
    # Patches beside each other share their rows' noise, so that only as many as there are above each other count.
    level_error = error / PATCHES**0.5
    uneven = change - level
    place = np.unravel_index(int(np.argmax(np.abs(uneven))), uneven.shape)
    thirds = (("top", "middle", "bottom"), ("left", "centre", "right"))
    where = " ".join(names[min(2, 3 * int(at) // PATCHES)] for names, at in zip(thirds, place, strict=True))
    look, again = max(0.25, 0.1 * noise_dn), max(1.0, 0.5 * noise_dn)
    of_level, of_leak = (replace(find_kind(name), look=look, again=again) for name in ("level", "leak"))
    measures = (
        group.measure(of_level, path, Estimate(level, level_error)),
        group.measure(of_leak, path, Estimate(float(uneven[place]), error), where=where),
    )
    if len(others) < _PICTURES or any(measure.verdict != "keep" for measure in measures):
        group.pictures.append(draw_map(f"{file_name(path)} less the others, ±2 DN", path, change, _SHOWN_DN))


def _take_medians(patches: Collection[tuple[Levels, float]]) -> tuple[Levels, float]:
    """Return the median level of each patch over frames, and its standard error."""
    error = OF_MEDIAN * float(np.mean([error for _, error in patches])) / len(patches) ** 0.5
    return np.median([levels for levels, _ in patches], axis=0), error


# --- flats ------------------------------------------------------------------------------------------------------------


def measure_unevenness(cells: Cells) -> float:
    """Return the distance of the 5th and the 95th percentile of the blocks over their median, of the worst channel."""
    mean, _ = cells.pooled(BLOCK, BLOCK)
    low, middle, high = np.quantile(mean.reshape(len(mean), -1), (0.05, 0.5, 0.95), axis=1)
    return float(np.max((high - low) / np.maximum(middle, 1e-6)))


def check_flats(unit: Unit) -> CheckedGroup:
    """Check the flats of one ISO; two in succession with the same exposure time are a pair."""
    group = CheckedGroup(unit.name, len(unit.records))
    waiting: ReducedFrame | None = None
    for frame in reduce_frames(unit, group):
        path = frame.record.path
        if min(frame.cells.mean_dn.shape[1:]) < BLOCK:
            group.remark(path, "is too small to check")
            continue
        group.measure("saturation", path, Estimate(frame.cells.clipped_share).in_percent())
        group.measure("evenness", path, Estimate(measure_unevenness(frame.cells)).in_percent())
        if waiting is None or waiting.exposure.exposure_s != frame.exposure.exposure_s:
            _remark_on_single(waiting, group)
            waiting = frame
            continue
        _compare_pair(waiting, frame, group)
        mean, _ = waiting.cells.pooled(BLOCK, BLOCK)
        light = mean[1] / max(float(np.median(mean[1])), 1e-6) - 1
        caption = f"{file_name(waiting.record.path)}: light over its median, ±50 %"
        group.pictures += [draw_scene(waiting, 1.0), draw_map(caption, waiting.record.path, light, 0.5)]
        waiting = None
    _remark_on_single(waiting, group)
    return group


def _remark_on_single(frame: ReducedFrame | None, group: CheckedGroup) -> None:
    """Remark on a flat without a partner of the same exposure time."""
    if frame is not None:
        group.remark(frame.record.path, "has no partner of the same exposure time beside it: take flats in pairs")


def _compare_pair(first: ReducedFrame, second: ReducedFrame, group: CheckedGroup) -> None:
    """Measure a flat's brightness over its partner's, in the channel that differs most."""
    path = second.record.path
    known = [ratio for ratio in measure_brightness(first.cells, second.cells) if ratio is not None]
    if not known:
        group.remark(path, "too dark, or too much of it saturated, to compare it with its partner")
        return
    ratio = max(known, key=lambda ratio: abs(ratio.value - 1))
    group.measure("pair", path, ratio.in_percent(1), against=file_name(first.record.path))
