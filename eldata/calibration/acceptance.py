"""The acceptance test of a noise model, which holds its frames against frames of the camera that were kept from it.

The model makes pairs of frames of what the camera saw: no light, or the light of its flats, smoothed. They are
digitised as the camera digitises, and measured exactly as the camera's pairs are
(:mod:`eldata.calibration.pair_statistics`).
Every number gets a verdict (:class:`~eldata.calibration.acceptance_results.FrameStatistic`).

Some of the model's pairs are a reference: Kolmogorov-Smirnov distances are those of one pair from the reference's
distribution, and a camera's own pattern is looked for in the reference's mean. So the model's other pairs and the
camera's stand to it alike, and one rule judges all numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from eldata.base.numbers import checked_whole
from eldata.calibration._frames import channels_of, pattern_of
from eldata.calibration.acceptance_results import Acceptance, FrameStatistic, IsoAcceptance
from eldata.calibration.acceptance_statistics import PairNumbers, curves_of, dark_statistics, flat_statistics
from eldata.calibration.frame_checks import (
    Copies,
    FrameFigures,
    FramesError,
    clipped_black,
    odd_bias_frames,
    sorted_frames,
    unlike,
    unlike_most,
    unreadable,
)
from eldata.calibration.made_frames import MadeFrames
from eldata.calibration.pair_statistics import (
    FlatScale,
    FrameScale,
    dark_pair,
    flat_pair,
    mean_of,
    smoothed,
)
from eldata.calibration.reproduction import compared_place
from eldata.datasets.calibration_frames import CalibrationFrames
from eldata.errors import ArgumentError, DatasetError, RawFileError
from eldata.noise.diagnostics import sample_parameters
from eldata.noise.makers import check_noise_maker, maker_name
from eldata.noise.model import NoiseModel
from eldata.noise.profile import CameraProfile

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from fractions import Fraction
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.calibration.frame_checks import IsoFrames
    from eldata.datasets.calibration_frames import FlatPair
    from eldata.manifest.verify import Problem
    from eldata.noise.makers import NoiseMaker
    from eldata.noise.parameters import NoiseParameters
    from eldata.records import FrameRecord, Sensor

    Mosaic = NDArray[np.uint16]
    Plane = NDArray[np.float32]

PAIRS = 32
_FEWEST_PAIRS = 16
_REFERENCE = 8  # pairs of the model that the others, and the camera's, are held against
_FLAT_LEVELS = 3
_SMALLEST = 128  # pixels a side
_SATURATED = 1e-4  # share of pixels from which on a flat is left out


def check_noise(
    model: NoiseMaker,
    frames: CalibrationFrames | Path | str,
    parameters: CameraProfile | NoiseParameters,
    *,
    isos: Collection[int] | None = None,
    seed: int = 0,
    pairs: int = PAIRS,
    whole_frames: bool = False,
) -> Acceptance:
    """Hold the frames that a noise model makes against frames of the camera that it has not seen.

    Parameters
    ----------
    model
        A :class:`~eldata.noise.model.NoiseModel`, or any callable with the interface of
        :class:`~eldata.noise.makers.NoiseMaker`: a flow, a network, recorded dark frames. It is called with one packed
        image at a time, of no light or of the flats' light, at ratio 1. What it returns is scaled to DN, rounded and
        kept between 0 and white, as the camera's converter does; a NoiseModel's U, which stands for that, is left out.
    frames
        Bias frames, and flats in pairs where there are any, that were not used to make the model, or their folder
        (:class:`~eldata.datasets.calibration_frames.CalibrationFrames`). Two bias frames of each ISO at least; ten
        make the verdicts sharp.
    parameters
        The camera's profile, whose measured row of each ISO is handed to the model (or, where it has none, a draw at
        that ISO), or the parameters themselves, for frames of one ISO.
    isos
        Only these ISOs, if a folder is given.
    seed
        Of the model's frames.
    pairs
        How many pairs of frames the model makes for each comparison, 16 or more; 8 more are its reference.
    whole_frames
        Hand the model frames of the sensor's size and compare the middle, for a model that knows the sensor's places;
        otherwise it makes that piece alone, 1024 x 1024 pixels at most.

    Raises
    ------
    ArgumentError
        If the model cannot be called, returns what is no exposure, clips at 0, or gives other units than normalised
        ones; if the profile states other levels or does not know an ISO; or an option is out of its range.
    FramesError
        If frames are missing or unfit: every problem is in it.
    DatasetError
        If there are no frames.
    """
    check_noise_maker(model)
    checked_whole("pairs", pairs, at_least=_FEWEST_PAIRS)
    checked_whole("seed", seed, at_least=0)
    if not isinstance(frames, CalibrationFrames):
        frames = CalibrationFrames(frames, isos=isos)
    elif isos is not None:
        raise ArgumentError("isos is for a folder; choose them with CalibrationFrames(..., isos=...)")
    name = maker_name(model)
    if isinstance(model, NoiseModel) and model.components.quantisation and model.components.spec != "U":
        model = NoiseModel(model.components.spec.removesuffix("+U"), clip=model.clip)
    chosen = sorted_frames(frames)
    problems = [problem for one in chosen for problem in one.problems]
    problems += [_too_few(frames, one) for one in chosen if len(one.bias) < 2]
    if problems:
        raise FramesError(problems)
    if len(chosen) > 1 and not isinstance(parameters, CameraProfile):
        raise ArgumentError(
            f"parameters are of one ISO, and the frames of {len(chosen)}; give a profile, or isos=[...]"
        )
    found = [
        check_iso_noise(model, frames, one, parameters, seed=seed, pairs=pairs, whole_frames=whole_frames)
        for one in chosen
    ]
    return Acceptance(frames.camera, name, seed, pairs, tuple(found))


def _too_few(frames: CalibrationFrames, one: IsoFrames) -> Problem:
    from eldata.manifest.verify import Problem

    where = f"ISO {float(one.iso):g}"
    advice = "take ten more with the lens capped, and keep them from the calibration"
    return Problem(frames.camera, where, "bias", "two held-out bias frames or more", str(len(one.bias)), advice)


# --- the camera's frames ------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Camera:
    """Reads the frames of one ISO, a pair at a time, and collects what is wrong with them."""

    frames: CalibrationFrames
    sensor: Sensor | None = None
    example: str = ""
    sensors: dict[FrameRecord, Sensor] = field(default_factory=dict)
    figures: list[FrameFigures] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    copies: Copies = field(default_factory=Copies)

    def read(self, record: FrameRecord) -> Mosaic | None:
        """Return a frame that is like the first one, and no copy."""
        try:
            raw = self.frames.read(record)
        except RawFileError as error:
            self.problems.append(unreadable(record, error))
            return None
        if self.sensor is None:
            self.sensor, self.example = raw.sensor, record.path
        self.sensors[record] = raw.sensor
        if unlike(record, raw.sensor, self.sensor, self.example) or self.copies.original(record, raw.mosaic):
            return None
        return raw.mosaic

    def bias_pairs(self, records: Sequence[FrameRecord]) -> Iterator[tuple[Mosaic, Mosaic]]:
        """Yield pairs of pieces of bias frames that share no frame."""
        first: Mosaic | None = None
        for record in records:
            mosaic = self.read(record)
            if mosaic is None:
                continue
            self.problems += clipped_black(record, mosaic)
            self.figures.append(FrameFigures.of(record, mosaic))
            piece = self.cut(mosaic)
            if first is None:
                first = piece
            else:
                yield first, piece
                first = None

    def flats(self, pair: FlatPair) -> tuple[Mosaic, Mosaic] | None:
        """Return a pair of whole flats."""
        first, second = self.read(pair.first), self.read(pair.second)
        return None if first is None or second is None else (first, second)

    def known(self) -> Sensor:
        """Return the sensor of the frames.

        Raises
        ------
        FramesError
            If none could be read.
        """
        if self.sensor is None:
            raise FramesError(self.problems)
        return self.sensor

    def cut(self, mosaic: NDArray[np.generic]) -> Mosaic:
        return mosaic[compared_place(mosaic.shape, len(self.known().cfa))].copy()  # type: ignore[return-value]

    def refuse(self) -> None:
        """Raise what is wrong with the frames so far, if anything is."""
        problems = [*self.problems, *unlike_most(self.sensors), *odd_bias_frames(self.figures)]
        if problems:
            raise FramesError(sorted(problems, key=lambda problem: problem.path))


# --- one ISO ------------------------------------------------------------------------------------------------------


def check_iso_noise(
    model: NoiseMaker,
    frames: CalibrationFrames,
    chosen: IsoFrames,
    profile: CameraProfile | NoiseParameters,
    *,
    seed: int = 0,
    pairs: int = PAIRS,
    whole_frames: bool = False,
) -> IsoAcceptance:
    """Check a model at one ISO; arguments and errors are those of :func:`check_noise`, and ``chosen`` its frames."""
    camera = _Camera(frames)
    held_out = camera.bias_pairs(chosen.bias)
    first = next(held_out, None)
    if first is None:
        camera.refuse()
        raise DatasetError(
            f"ISO {float(chosen.iso):g}: fewer than two bias frames that differ: " + camera.copies.remarks[0]
        )
    sensor = camera.known()
    if min(first[0].shape) < _SMALLEST:
        raise DatasetError(f"the comparison needs {_SMALLEST} x {_SMALLEST} pixels or more; found {first[0].shape}")
    parameters, measured = _parameters(profile, chosen.iso, sensor, seed)
    pattern = pattern_of(sensor.cfa)
    scale = FrameScale.of(*first, pattern)
    made = MadeFrames(model, parameters, sensor, (seed, int(chosen.iso)), whole_frames)
    size = (sensor.height, sensor.width) if whole_frames else first[0].shape
    no_light = np.zeros(size, dtype=np.float32)
    made.check(no_light, first[0], scale)

    reference, of_camera, of_model = PairNumbers(), PairNumbers(), PairNumbers()
    total = np.zeros(first[0].shape, dtype=np.float64)
    for index in range(_REFERENCE):
        pair = dark_pair(*made.pair(no_light, 1, index), scale)
        reference.add(pair)
        total += pair.mean_dn
    mean_dn = (total / _REFERENCE).astype(np.float32)
    of_camera.add(dark_pair(*first, scale), mean_dn)
    for one in held_out:
        of_camera.add(dark_pair(*one, scale), mean_dn)
    camera.refuse()
    for index in tqdm(range(pairs), desc=f"ISO {float(chosen.iso):g}", unit="pair", disable=None, leave=False):
        of_model.add(dark_pair(*made.pair(no_light, 2, index), scale), mean_dn)
    statistics = dark_statistics(reference, of_camera, of_model, 2 * first[0].size)

    levels = [float(np.mean(of_camera.of(f"level {index}"))) for index in range(channels_of(pattern))]
    lit, used, remarks = _flats(camera, chosen, made, levels, pairs)
    drawn = [] if measured else ["the profile has not measured this ISO, or not completely: its parameters were drawn"]
    few = [] if of_camera.fours else ["pixels of unlike noise are looked for in fours of bias frames: there are fewer"]
    return IsoAcceptance(
        iso=float(chosen.iso),
        parameters=parameters,
        measured=measured,
        bias_frames=2 * len(of_camera.units),
        flat_frames=used,
        shape=(first[0].shape[0], first[0].shape[1]),
        statistics=(*statistics, *lit),
        curves=curves_of(of_camera, of_model, scale),
        remarks=tuple(dict.fromkeys((*drawn, *few, *remarks, *camera.copies.remarks))),
    )


def _parameters(
    profile: CameraProfile | NoiseParameters, iso: Fraction, sensor: Sensor, seed: int
) -> tuple[NoiseParameters, bool]:
    """Return what the model is told, and whether it was measured at this ISO."""
    black, white = float(np.mean(sensor.black_level_dn)), sensor.white_level_dn
    advice = "the profile, or the raw mode, is another camera's; figures in DN hold at their own levels alone"
    if not isinstance(profile, CameraProfile):
        stated = profile.range_dn
        if stated is not None and abs(stated - (white - black)) > 0.01 * stated:
            raise ArgumentError(
                f"the parameters are of a range of {stated:g} DN, the frames of {white - black:g}: {advice}"
            )
        return profile, True
    for name, expected, found, apart in (
        ("black", profile.black_level_dn, black, 1.0),
        ("white", profile.white_level_dn, white, 0.01 * white),
    ):
        if expected is not None and abs(expected - found) > apart:
            raise ArgumentError(
                f"the profile of {profile.camera} states a {name} level of {expected:g} DN, and the held-out frames of "
                f"ISO {float(iso):g} {found:g} DN: {advice}"
            )
    try:
        return profile.measured(float(iso)), True
    except ArgumentError:  # not measured, or not completely
        return sample_parameters(profile, seed, iso=float(iso)), False


# --- flats --------------------------------------------------------------------------------------------------------


def _flats(
    camera: _Camera, chosen: IsoFrames, made: MadeFrames, levels: Sequence[float], pairs: int
) -> tuple[list[FrameStatistic], int, list[str]]:
    """Return the statistics of flats at three exposures at most, how many frames they are of, and remarks."""
    by_time: dict[Fraction | None, list[FlatPair]] = {}
    for pair in chosen.pairs:
        by_time.setdefault(pair.first.exposure_s, []).append(pair)
    groups = [by_time[time] for time in sorted(by_time, key=lambda time: time or 0)]
    usable = [group for group in groups if not _is_saturated(camera, group[0])]
    camera.refuse()
    remarks = [f"{len(groups) - len(usable)} exposure(s) of flats saturate and were left out"] * (
        len(usable) < len(groups)
    )
    places = sorted({round(place) for place in np.linspace(0, len(usable) - 1, min(_FLAT_LEVELS, len(usable)))})
    dark = np.array(levels, dtype=np.float32)
    statistics, used = [], 0
    for number, place in enumerate(places):
        found, frames = _of_exposure(camera, usable[place], made, dark, pairs, 3 + 2 * number)
        statistics += found
        used += frames
    camera.refuse()
    return statistics, used, remarks


def _is_saturated(camera: _Camera, pair: FlatPair) -> bool:
    flats = camera.flats(pair)
    if flats is None:
        return True
    white = camera.known().white_level_dn
    return max(float(np.mean(camera.cut(flat) >= white)) for flat in flats) > _SATURATED


def _of_exposure(
    camera: _Camera, group: Sequence[FlatPair], made: MadeFrames, dark: Plane, pairs: int, stream: int
) -> tuple[list[FrameStatistic], int]:
    sensor = made.sensor
    pattern = pattern_of(sensor.cfa)
    light: Plane | None = None
    scale: FlatScale | None = None
    reference, of_camera, of_model = PairNumbers(), PairNumbers(), PairNumbers()
    for one in group:
        flats = camera.flats(one)
        if flats is None:
            continue
        first, second = (camera.cut(flat) for flat in flats)
        if scale is None:
            of_piece = _tiled(dark, pattern, first.shape)
            scale = FlatScale.of(first, second, of_piece, pattern)
            seen = flats if made.whole_frames else (first, second)
            mean = mean_of(*seen)
            light = np.maximum(smoothed(mean, scale.sigma_dn, pattern) - _tiled(dark, pattern, mean.shape), 0)
        of_camera.add(flat_pair(first, second, scale))
    if scale is None or light is None:
        return [], 0
    for index in range(_REFERENCE):
        reference.add(flat_pair(*made.pair(light, stream, index), scale))
    for index in tqdm(range(pairs), desc="flats", unit="pair", disable=None, leave=False):
        of_model.add(flat_pair(*made.pair(light, stream + 1, index), scale))
    where = light[compared_place(light.shape, len(pattern))] if made.whole_frames else light
    check = f"flats of {float(where.mean()):.0f} DN"
    statistics = flat_statistics(check, reference, of_camera, of_model, where.size)
    return statistics, 2 * len(of_camera.units)


def _tiled(dark: Plane, pattern: NDArray[np.int64], shape: tuple[int, ...]) -> Plane:
    repeats = -(-shape[0] // len(pattern)), -(-shape[1] // len(pattern))
    tiled: Plane = np.tile(dark[pattern], repeats)[: shape[0], : shape[1]]
    return tiled
