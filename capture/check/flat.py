"""Flat-field frames of one ISO: saturation, evenness, and the two of each pair against each other."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from capture.check.drift import BLOCK, brightness_ratios
from capture.check.flicker import flicker_between
from capture.check.frames import ReducedFrame, Unit, file_name, reduced_frames
from capture.check.kinds import FLICKER
from capture.check.measures import MeasureKind
from capture.check.pictures import map_picture, scene_picture
from capture.check.result import CheckedGroup

if TYPE_CHECKING:
    from capture.check.cells import Cells

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
    "a stop between middle and corners, as with a lens that is wide open; the gain itself bears it",
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
    """Check the flats of one ISO; two in succession with the same exposure time are a pair."""
    group = CheckedGroup(unit.name, len(unit.records))
    waiting: ReducedFrame | None = None
    for frame in reduced_frames(unit, group):
        path = frame.record.path
        if min(frame.cells.mean_dn.shape[1:]) < BLOCK:
            group.remark(path, "is too small to check")
            continue
        group.measure(_SATURATED, path, "saturated pixels", 100 * frame.cells.clipped_share)
        text = "difference between bright and dark parts (95th and 5th percentile) over the median"
        group.measure(_UNEVEN, path, text, 100 * unevenness(frame.cells))
        if waiting is None or waiting.header.exposure.exposure_s != frame.header.exposure.exposure_s:
            _leave_single(waiting, group)
            waiting = frame
            continue
        _compare(waiting, frame, group)
        mean, _ = waiting.cells.pooled(BLOCK, BLOCK)
        light = mean[1] / max(float(np.median(mean[1])), 1e-6) - 1
        caption = f"{file_name(waiting.record.path)}: light over its median, ±50 %"
        group.pictures += [
            scene_picture(waiting, 1.0),
            map_picture(caption, waiting.record.path, light, 0.5),
        ]
        waiting = None
    _leave_single(waiting, group)
    return group


def _leave_single(frame: ReducedFrame | None, group: CheckedGroup) -> None:
    if frame is not None:
        group.remark(frame.record.path, "has no partner of the same exposure time beside it: take flats in pairs")


def _compare(first: ReducedFrame, second: ReducedFrame, group: CheckedGroup) -> None:
    path, against = second.record.path, file_name(first.record.path)
    ratios = brightness_ratios(first.cells, second.cells)
    known = [one for one in ratios if one is not None]
    if not known:
        group.remark(path, "too dark, or too much of it saturated, to compare it with its partner")
        return
    ratio = max(known, key=lambda one: abs(one.value - 1))
    text = f"change of brightness since {against}, of the same exposure"
    group.measure(_PAIR, path, text, 100 * (ratio.value - 1), 100 * ratio.standard_error)
    flicker = flicker_between(first.cells, second.cells, ratios)
    if flicker is not None:
        text = f"bands that {against} does not have, {flicker.cycles:g} per frame, amplitude"
        group.measures.append(flicker.measure(_FLICKER, path, text))
