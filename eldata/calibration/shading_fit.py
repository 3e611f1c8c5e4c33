"""Dark shading: a line over ISO through each pixel's mean of the bias frames, an ISO at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from eldata import __version__
from eldata.base.numbers import counted
from eldata.base.workers import AnyWorkers, Workers
from eldata.calibration.frames import sort_frames
from eldata.calibration.one_iso import bias_pattern
from eldata.calibration.sums import Counts, Mask, Plane, by_pixel, sites
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.dark_shading import DarkShading, ShadingIso

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from eldata.calibration.defects import FixedPattern
    from eldata.calibration.iso_results import IsoCalibration
    from eldata.calibration.results import Calibration
    from eldata.datasets.calibration_frames import CalibrationFrames

_REACH = 2  # periods of the CFA around a hot pixel, whose sound pixels stand for it
_ROWS = 64  # at a time
_LEAST_VARIANCE_DN2 = 1 / 12  # of rounding: quieter noise is told by it


@dataclass(slots=True, eq=False)
class _Lines:
    """The lines of one gain mode: weighted least squares, one mean frame after another.

    With all weights the same in every pixel, a frame moves slope and offset by its distance from the line so far, times
    two numbers that follow from the ISOs alone (recursive least squares). So there are two values a pixel, whatever the
    number of ISOs, and no difference of large sums.
    """

    slope: Plane
    offset: Plane
    weight: float = 0.0
    middle: float = 0.0
    lever: float = 0.0

    def add_iso(self, iso: float, weight: float) -> tuple[float, float]:
        """Take the ISO into account, and return by how much of the distance from the line slope and offset move."""
        self.weight += weight
        before = iso - self.middle
        self.middle += weight / self.weight * before
        after = iso - self.middle
        self.lever += weight * before * after
        of_slope = weight * after / self.lever if self.lever > 0 else 0.0  # of one ISO, the line is level
        return of_slope, weight / self.weight - self.middle * of_slope


class ShadingFit:
    """Fits ``k ISO + b + BLE[ISO]`` to the mean frames of one ISO after another.

    Per gain mode, k and b of a pixel are the weighted least squares line through its means over the black level;
    weights are one over the variance that noise leaves in a mean, so that what a line cannot follow lies where it is
    least seen. BLE is what the mean of a channel's sound pixels keeps from its own such line: it adds up to 0 over
    the ISOs of a mode, and has no slope, by this choice, since k and b can hold both.

    It takes eight bytes of memory a pixel and gain mode, whatever the number of ISOs and frames.

    Parameters
    ----------
    starts
        The first ISO of each gain mode but the lowest, ascending.
    """

    def __init__(self, starts: Sequence[float] = ()) -> None:
        self._starts = tuple(starts)
        self._lines: dict[int, _Lines] = {}
        self._isos: list[ShadingIso] = []
        self._pattern: Counts | None = None
        self._hot: Mask | None = None

    def add(
        self, iso: float, fixed: FixedPattern, black_level_dn: Sequence[float], standard_error_dn: Sequence[float]
    ) -> None:
        """Add an ISO.

        Parameters
        ----------
        iso
            ISO speed.
        fixed
            Its bias frames' sum and defects.
        black_level_dn
            As recorded, per CFA channel.
        standard_error_dn
            Of the channels' mean levels, from frame to frame.

        Raises
        ------
        ArgumentError
            If the frames have another size or CFA than those before.
        """
        if self._pattern is None or self._hot is None:
            self._pattern, self._hot = fixed.pattern, np.zeros_like(fixed.defects)
        if fixed.defects.shape != self._hot.shape or not np.array_equal(fixed.pattern, self._pattern):
            raise ArgumentError(
                f"ISO {iso:g}: the frames have {fixed.defects.shape} pixels, those before {self._hot.shape}, or they "
                "differ in their CFA; the frames of a dark shading are of one body and one raw format"
            )
        self._hot |= fixed.defects
        variance = max(float(np.mean(fixed.temporal_variance_dn2)), _LEAST_VARIANCE_DN2)
        shading_iso = ShadingIso(
            iso=iso,
            mode=sum(start <= iso for start in self._starts),
            frames=fixed.frames,
            sigma_dn=math.sqrt(variance),
            level_error_dn=tuple(np.subtract(fixed.level_dn, black_level_dn).tolist()),  # over black: the line is later
            standard_error_dn=tuple(map(float, standard_error_dn)),
        )
        self._isos.append(shading_iso)
        if shading_iso.mode not in self._lines:
            self._lines[shading_iso.mode] = _Lines(*np.zeros((2, *self._hot.shape), np.float32))
        lines = self._lines[shading_iso.mode]
        of_slope, of_offset = lines.add_iso(iso, shading_iso.weight)
        step = _ROWS * len(fixed.pattern)
        for top in range(0, len(fixed.total_dn), step):
            rows = slice(top, top + step)
            level, slope, offset = fixed.total_dn[rows] / fixed.frames, lines.slope[rows], lines.offset[rows]
            off = level - by_pixel(np.asarray(black_level_dn, np.float64), fixed.pattern, level.shape)
            off -= slope * iso + offset
            slope += of_slope * off
            offset += of_offset * off

    def shading(self, camera: str, source: str, notes: Sequence[str] = (), model: str = "") -> DarkShading:
        """Return the dark shading; nothing can be added then.

        Raises
        ------
        DatasetError
            If no ISO was added.
        """
        if self._pattern is None or self._hot is None:
            raise DatasetError(f"{camera}: no ISO gives a dark shading: {'; '.join(notes) or 'there are none'}")
        isos: list[ShadingIso] = []
        fields = []
        for number, mode in enumerate(sorted(self._lines)):  # a mode that no ISO lies in has no line
            isos += _subtract_line([record for record in self._isos if record.mode == mode], number)
            lines = self._lines.pop(mode)
            for values in (lines.slope, lines.offset):
                _replace_hot(values, self._hot, self._pattern)
            fields.append((lines.slope, lines.offset))
        slope, offset = (
            values[0][None] if len(values) == 1 else np.stack(values) for values in zip(*fields, strict=True)
        )
        return DarkShading(
            camera=camera,
            source=source,
            cfa=tuple(tuple(map(int, row)) for row in self._pattern),
            isos=tuple(isos),
            slope_dn=slope,
            offset_dn=offset,
            hot=self._hot,
            notes=tuple(notes),
            model=model,
        )


def _subtract_line(isos: Sequence[ShadingIso], mode: int) -> Iterator[ShadingIso]:
    """Yield the ISOs of a mode, ascending, with what their levels keep from the line through them."""
    ordered = sorted(isos, key=attrgetter("iso"))
    weights, speeds, levels = (
        np.array([getattr(record, name) for record in ordered]) for name in ("weight", "iso", "level_error_dn")
    )
    centred = speeds - weights @ speeds / weights.sum()
    rest = levels - weights @ levels / weights.sum()
    if len(ordered) > 1:
        rest -= np.outer(centred, (weights * centred) @ levels / (weights @ centred**2))
    for record, over in zip(ordered, rest, strict=True):
        yield replace(record, mode=mode, level_error_dn=tuple(over.tolist()))


def _replace_hot(values: Plane, hot: Mask, pattern: Counts) -> None:
    """Replace hot pixels by the mean of the sound ones at the same site of the CFA near them, else anywhere."""
    around = np.mgrid[-_REACH : _REACH + 1, -_REACH : _REACH + 1].reshape(2, -1, 1)
    for site, _ in sites(pattern):
        of_site, hot_here = values[site], hot[site]
        rows, columns = np.nonzero(hot_here)
        if not len(rows):
            continue
        at = np.stack([rows, columns])[:, None] + around  # (2, neighbours, hot pixels)
        inside = ((at >= 0) & (at < np.reshape(of_site.shape, (2, 1, 1)))).all(axis=0)
        beside = tuple(np.where(inside, at, 0))
        sound = inside & ~hot_here[beside]
        count = sound.sum(axis=0)
        total = of_site[beside].sum(axis=0, dtype=np.float64, where=sound)
        everywhere = float(of_site.mean(where=~hot_here, dtype=np.float64)) if not hot_here.all() else 0.0
        of_site[rows, columns] = np.where(count > 0, total / np.maximum(count, 1), everywhere)


def dark_shading(
    frames: CalibrationFrames,
    calibration: Calibration,
    *,
    modes: Sequence[float] | None = None,
    workers: AnyWorkers = 1,
) -> DarkShading:
    """Fit the dark shading of a camera body to its bias frames, each decoded once.

    Parameters
    ----------
    frames
        The frames.
    calibration
        Of these frames, by :func:`~eldata.calibration.camera.calibrate`. ISOs that it left out, or whose level it
        withheld, are left out here too, also where somebody has accepted the level.
    modes
        The first ISO of each gain mode of the camera but the lowest; by default the calibration's.
    workers
        Number of threads that decode. The result does not depend on it.

    Returns
    -------
    DarkShading
        Its notes say which ISOs were left out, and why.

    Raises
    ------
    DatasetError
        If no ISO is left, or the frames are of several models of camera.
    FramesError
        If frames can no longer be read.
    ArgumentError
        If the ISOs differ in size or CFA, or ``workers`` is not positive.

    Examples
    --------
    >>> from eldata import CalibrationFrames, calibrate
    >>> from eldata.calibration import dark_shading
    >>> frames = CalibrationFrames("data/calibration", "MyCamera")  # doctest: +SKIP
    >>> dark_shading(frames, calibrate(frames)).save("mycamera.npz")  # doctest: +SKIP
    """
    threads = Workers(Workers.of(workers).jobs)
    limits = [lines.mode.iso_range for lines in calibration.modes if lines.mode.iso_range is not None]
    starts = [low for low, _ in limits[1:]] if modes is None else list(modes)
    notes = []
    if modes is None and not calibration.modes and len(calibration.isos) > 1:
        notes.append("K is not known, so a switch of the conversion gain would not be seen: all ISOs share one line")
    usable: list[IsoCalibration] = []
    for record in calibration.isos:
        between = any(above < record.iso < start for (_, above), start in zip(limits, starts, strict=False))
        # An error that is accepted is none that a shading could have: it would hold the light itself.
        of_level = [finding for finding in record.findings if "colour bias" in finding.figures]
        why = "; ".join(finding.text for finding in of_level if finding.effect == "withheld" or finding.is_accepted)
        if not why and modes is None and between:
            why = "it lies between two gain modes, and no K tells of which it is"
        if why:
            notes.append(f"ISO {record.iso:g} was left out: {why}")
        else:
            usable.append(record)
    chosen = {float(of_iso.iso): of_iso for of_iso in sort_frames(frames, threads)}
    fit = ShadingFit(starts)
    used: list[int] = []
    models: dict[str, float] = {}
    total = sum(len(chosen[record.iso].bias) for record in usable)
    with tqdm(total=total, desc=f"dark shading {frames.camera}", unit="frame", disable=None, leave=False) as bar:
        for record in usable:
            sensor, fixed = bias_pattern(frames, chosen[record.iso], threads, done=bar.update)
            if fixed.clips_at_black:
                why = "black is clipped, so the mean of a pixel is not its level"
                notes.append(f"ISO {record.iso:g} was left out: {why}")
                continue
            fit.add(record.iso, fixed, sensor.black_level_dn, record.bias.standard_error_dn)
            models.setdefault(sensor.model, record.iso)
            used.append(fixed.frames)
    if len(models) > 1:
        listed = ", ".join(f"those of ISO {iso:g} of a {model}" for model, iso in models.items())
        raise DatasetError(f"{frames.camera}: the bias frames are of several cameras, {listed}; a shading is of one")
    source = f"eldata {__version__} calibrate: {sum(used)} bias frames at {counted(len(used), 'ISO')}"
    return fit.shading(calibration.camera, source, notes, next(iter(models), ""))
