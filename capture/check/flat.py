"""Flat-field frames of one ISO: saturation, evenness, and the two of each pair against each other."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from capture.check.drift import BLOCK, brightness_ratios
from capture.check.flicker import flicker_of_level
from capture.check.frames import ReducedFrame, file_name, other_kind, reduced_frames
from capture.check.measures import Measure, MeasureKind, Remark
from capture.check.pictures import map_picture, scene_picture
from capture.check.ratio import residuals_between
from capture.check.result import CheckedGroup, SheetPicture, sorted_by_path
from capture.check.scene import FLICKER

if TYPE_CHECKING:
    from capture.check.cells import Cells
    from capture.check.frames import Unit
    from eldata.records import FrameRecord

_SATURATED = MeasureKind(
    "saturation",
    "%",
    0.1,
    1.0,
    "hot pixels saturate too, some in ten thousand; from 1 % on the mean no longer follows the light",
    "expose the brightest flats less",
)
_UNEVEN = MeasureKind(
    "evenness",
    "%",
    50.0,
    float("inf"),
    "a stop between middle and corners, as of a lens that is wide open; the gain itself bears it",
    "light the surface more evenly, focus on infinity, leave nothing else in the picture",
)
_PAIR = MeasureKind(
    "pair",
    "%",
    1.0,
    5.0,
    "from 5 % on eldata calibrate leaves the pair out; a lamp of constant light stays within 1 %",
    "the light changed between the two: use a constant lamp or daylight, and a longer time",
)
_FLICKER = replace(FLICKER, advice="the lamp flickers: use another, or longer times")


def unevenness(cells: Cells) -> float:
    """Return the distance of the 5th and the 95th percentile of the blocks over their median, of the worst channel."""
    mean, _ = cells.pooled(BLOCK, BLOCK)
    low, middle, high = np.quantile(mean.reshape(len(mean), -1), (0.05, 0.5, 0.95), axis=1)
    return float(np.max((high - low) / np.maximum(middle, 1e-6)))


def check_flats(unit: Unit) -> CheckedGroup:
    """Check the flats of one ISO; two after each other with the same exposure time are a pair."""
    records = sorted_by_path(unit.records, "flat")
    first: ReducedFrame | None = None
    waiting: ReducedFrame | None = None
    remarks: list[Remark] = []
    measures: list[Measure] = []
    pictures: list[SheetPicture] = []
    for record, frame in reduced_frames(unit, records):
        remark = frame if isinstance(frame, Remark) else None if first is None else other_kind(first, frame)
        if remark is not None or isinstance(frame, Remark):
            remarks += [] if remark is None else [remark]
            continue
        first = first or frame
        measures += _alone(record, frame.cells)
        if waiting is None or not _same_exposure(waiting, frame):
            remarks += [] if waiting is None else [_single(waiting)]
            waiting = frame
            continue
        measures += _pair(waiting, frame, remarks)
        pictures.append(scene_picture(waiting, 1.0))
        mean, _ = waiting.cells.pooled(BLOCK, BLOCK)
        pictures.append(
            map_picture(
                f"{file_name(waiting.record.path)}: light over its median, ±50 %",
                waiting.record.path,
                mean[1] / max(float(np.median(mean[1])), 1e-6) - 1,
                0.5,
            )
        )
        waiting = None
    remarks += [] if waiting is None else [_single(waiting)]
    return CheckedGroup(unit.name, len(records), tuple(measures), tuple(remarks), tuple(pictures))


def _same_exposure(first: ReducedFrame, second: ReducedFrame) -> bool:
    return first.header.exposure.exposure_s == second.header.exposure.exposure_s


def _single(frame: ReducedFrame) -> Remark:
    return Remark(frame.record.path, "has no partner of the same exposure time beside it: take flats in pairs", "look")


def _alone(record: FrameRecord, cells: Cells) -> list[Measure]:
    text = "difference between bright and dark parts (95th and 5th percentile) over the median"
    return [
        Measure(_SATURATED, record.path, "saturated pixels", 100 * cells.clipped_share),
        Measure(_UNEVEN, record.path, text, 100 * unevenness(cells)),
    ]


def _pair(first: ReducedFrame, second: ReducedFrame, remarks: list[Remark]) -> list[Measure]:
    path, against = second.record.path, file_name(first.record.path)
    ratios = brightness_ratios(first.cells, second.cells)
    known = [one for one in ratios if one is not None]
    if not known:
        remarks.append(Remark(path, "too dark, or too much of it saturated, to compare it with its partner", "look"))
        return []
    ratio = max(known, key=lambda one: abs(one.value - 1))
    text = f"change of brightness since {against}, of the same exposure"
    measures = [Measure(_PAIR, path, text, 100 * (ratio.value - 1), 100 * ratio.standard_error)]
    if len(known) < len(ratios):
        return measures
    residuals = residuals_between(first.cells, second.cells, [one.value for one in known])
    flicker = None if residuals is None else flicker_of_level(residuals)
    if flicker is not None:
        text = f"bands that {against} has not, {flicker.cycles:g} a frame, amplitude"
        measures.append(flicker.measure(_FLICKER, path, text))
    return measures
