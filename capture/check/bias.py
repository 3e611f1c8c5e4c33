"""Bias frames of one ISO against each other: level, light leaks, clipped black.

Each frame becomes a grid of 8 x 8 patches: the median of its cells, which forgives hot pixels, averaged over the
channels. From each the median over the *other* frames is taken off, so that what belongs to the sensor drops out and
what differs stays. The standard error of a patch comes from the scatter of its rows of cells, row noise included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.frames import ReducedFrame, file_name, other_kind, reduced_frames
from capture.check.measures import Measure, MeasureKind, Remark
from capture.check.pictures import map_picture
from capture.check.result import CheckedGroup, SheetPicture, sorted_by_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.check.cells import Cells
    from capture.check.frames import Unit
    from eldata.records import FrameRecord

PATCHES: Final = 8  # a side
# Chance exceeds six standard errors once in 500 million patches: of ten frames of 64 patches, never.
_PATCH_SIGMAS: Final = 6.0
_OF_MEDIAN: Final = 1.2533
_BLACK = MeasureKind(
    "black",
    "%",
    0.1,
    1.0,
    "from 1 % on eldata calibrate refuses the frames: neither mean nor noise can be told of clipped black",
    "use raw files that keep their black level",
)


@dataclass(frozen=True, slots=True, eq=False)
class PatchLevels:
    """A bias frame in 8 x 8 levels over black with their standard errors, (8, 8), DN, and its noise a pixel, DN."""

    level_dn: NDArray[np.float64]
    error_dn: NDArray[np.float64]
    noise_dn: float


def patch_levels(cells: Cells) -> PatchLevels:
    """Reduce a bias frame to patches."""
    values = cells.mean_dn.astype(np.float64)
    levels, errors = np.zeros((PATCHES, PATCHES)), np.zeros((PATCHES, PATCHES))
    rows = np.array_split(np.arange(values.shape[1]), PATCHES)
    columns = np.array_split(np.arange(values.shape[2]), PATCHES)
    for i, of_rows in enumerate(rows):
        for j, of_columns in enumerate(columns):
            patch = values[:, of_rows[0] : of_rows[-1] + 1, of_columns[0] : of_columns[-1] + 1]
            levels[i, j] = np.median(patch, axis=(1, 2)).mean()
            of_each_row = np.median(patch, axis=2).mean(axis=0)
            spread = 1.4826 * np.median(np.abs(of_each_row - np.median(of_each_row)))
            errors[i, j] = _OF_MEDIAN * max(spread, of_each_row.std() / 2) / len(of_rows) ** 0.5
    # Patches of one row share its noise, and few rows tell their scatter badly: one error for all, from all.
    errors[:] = np.sqrt(np.mean(errors**2))
    return PatchLevels(levels, errors, cells.spread_dn)


def check_bias(unit: Unit) -> CheckedGroup:
    """Check the bias frames of one ISO."""
    records = sorted_by_path(unit.records, "bias")
    first: ReducedFrame | None = None
    remarks: list[Remark] = []
    measures: list[Measure] = []
    patches: list[tuple[FrameRecord, PatchLevels]] = []
    for record, frame in reduced_frames(unit, records):
        if isinstance(frame, Remark):
            remarks.append(frame)
            continue
        remark = None if first is None else other_kind(first, frame)
        if remark is not None:
            remarks.append(remark)
            continue
        first = first or frame
        if min(frame.cells.mean_dn.shape[1:]) < 2 * PATCHES:
            remarks.append(Remark(record.path, "is too small to look for light leaks in", "look"))
            continue
        measures.append(Measure(_BLACK, record.path, "pixels at 0 DN", 100 * frame.cells.zero_share))
        patches.append((record, patch_levels(frame.cells)))
    pictures: list[SheetPicture] = []
    if len(patches) == 1:
        text = "the only bias frame of this ISO: a light leak cannot be told from the sensor's own pattern"
        remarks.append(Remark(patches[0][0].path, text, "look"))
    elif patches:
        measures.append(_shading(patches))
        pictures.append(map_picture("all frames: level, ±2 DN", patches[0][0].path, _about_mean(_middle(patches)), 2.0))
        for index, (record, _) in enumerate(patches):
            of_frame, change = compare_bias(patches, index)
            measures += of_frame
            if any(one.verdict != "keep" for one in of_frame) or len(patches) <= _PICTURES:
                caption = f"{file_name(record.path)} less the others, ±2 DN"
                pictures.append(map_picture(caption, record.path, change, 2.0))
    return CheckedGroup(unit.name, len(records), tuple(measures), tuple(remarks), tuple(pictures))


_PICTURES: Final = 4  # of frames without a finding


def _middle(patches: list[tuple[FrameRecord, PatchLevels]]) -> NDArray[np.float64]:
    middle: NDArray[np.float64] = np.median([levels.level_dn for _, levels in patches], axis=0)
    return middle


def _about_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    about: NDArray[np.float64] = values - values.mean()
    return about


def compare_bias(
    patches: list[tuple[FrameRecord, PatchLevels]], index: int
) -> tuple[list[Measure], NDArray[np.float64]]:
    """Return the measures of one bias frame against the others, and the map of its difference, DN."""
    record, own = patches[index]
    others = patches[:index] + patches[index + 1 :]
    change = own.level_dn - _middle(others)
    error = float(
        np.hypot(own.error_dn[0, 0], _OF_MEDIAN * np.mean([o.error_dn[0, 0] for _, o in others]) / len(others) ** 0.5)
    )
    level = float(change.mean())
    # Patches beside each other share their rows' noise, so that only as many as there are above each other count.
    level_error = error / PATCHES**0.5
    uneven = change - level
    place = np.unravel_index(int(np.argmax(np.abs(uneven))), uneven.shape)
    noise = float(np.median([levels.noise_dn for _, levels in patches]))
    where = f"{_third(place[0], ('top', 'middle', 'bottom'))} {_third(place[1], ('left', 'centre', 'right'))}"
    leaking = f"unlike the other bias frames at the {where}, by"
    return [
        Measure(_level(noise), record.path, "mean, less that of the other bias frames", level, level_error),
        Measure(_leak(noise), record.path, leaking, float(uneven[place]), error),
    ], change


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


def _shading(patches: list[tuple[FrameRecord, PatchLevels]]) -> Measure:
    """Return how uneven all frames are together."""
    middle = _middle(patches)
    noise = float(np.median([levels.noise_dn for _, levels in patches]))
    error = 2**0.5 * float(np.mean([levels.error_dn[0, 0] for _, levels in patches])) * _OF_MEDIAN / len(patches) ** 0.5
    kind = MeasureKind(
        "shading",
        "DN",
        max(2.0, noise),
        float("inf"),
        "the noise of a pixel, or 2 DN: more than the dark shading of usual sensors at a short exposure",
        "a light leak in all of them, or the sensor's own shading: take one in full darkness and compare",
        sigmas=_PATCH_SIGMAS,
    )
    text = "difference between the brightest and the darkest part, in all bias frames of this ISO"
    return Measure(kind, patches[0][0].path.rpartition("/")[0] or ".", text, float(middle.max() - middle.min()), error)
