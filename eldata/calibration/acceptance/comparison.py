"""The acceptance test of a noise model, which holds its frames against frames of the camera that were kept from it.

The model makes pairs of frames of what the camera saw: no light, or the light of its flats, smoothed. They are
digitised as the camera digitises, and measured exactly as the camera's pairs are
(:mod:`eldata.calibration.acceptance.pairs`).
Every number gets a verdict (:class:`~eldata.calibration.acceptance.results.FrameStatistic`).

Some of the model's pairs are a reference: Kolmogorov-Smirnov distances are those of one pair from the reference's
distribution, and a camera's own pattern is looked for in the reference's mean. So the model's other pairs and the
camera's stand to it alike, and one rule judges all numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from eldata.base.numbers import checked_whole, counted
from eldata.base.workers import IN_THIS_PROCESS, AnyWorkers, Workers
from eldata.calibration.acceptance.pairs import (
    HeldOutFrames,
    PairScale,
    dark_pair,
    flat_pair,
    level_names,
    mean_of,
    smoothed,
)
from eldata.calibration.acceptance.results import (
    Acceptance,
    FrameStatistic,
    IsoAcceptance,
    PairNumbers,
    curves_of,
    frame_statistics,
)
from eldata.calibration.acceptance.theory import sample_parameters
from eldata.calibration.core._frames import by_pixel, channels_of, pattern_of
from eldata.calibration.frames import FramesError, sorted_frames, work_elsewhere
from eldata.calibration.reproduction import compared_place
from eldata.datasets.calibration_frames import CalibrationFrames
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.verify_report import Problem
from eldata.noise.makers import check_noise_maker, made_exposure, maker_name
from eldata.noise.model import NoiseModel
from eldata.noise.mosaic import pack_whole, unpack_whole
from eldata.noise.profile import CameraProfile, profile_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
    from fractions import Fraction
    from pathlib import Path

    from eldata.calibration.acceptance.pairs import PairFigures
    from eldata.calibration.core._frames import Mosaic, Plane
    from eldata.calibration.frames import IsoFrames
    from eldata.datasets.calibration_frames import FlatPair
    from eldata.noise.makers import NoiseMaker
    from eldata.noise.parameters import NoiseParameters
    from eldata.records import Sensor


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
    profile_of_another_camera: bool = False,
    workers: AnyWorkers = 1,
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
    profile_of_another_camera
        Whether the profile may be of another camera than the frames; the model's name says so then.
    workers
        Number of threads that decode, and that make and measure a :class:`~eldata.noise.model.NoiseModel`'s frames (any
        other model's are made one after the other), or an executor that checks whole ISOs side by side, where the model
        can be pickled (:mod:`eldata.base.workers`). The verdicts do not depend on it.

    Raises
    ------
    ArgumentError
        If the model cannot be called, returns what is not an exposure, clips at 0, or gives other units than normalised
        ones; if the profile is of another camera, states other levels or does not know an ISO; or an option is out of
        its range.
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
    if isinstance(parameters, CameraProfile):
        profile_of(frames.camera, [parameters], another=profile_of_another_camera)
        if parameters.camera != frames.camera:
            name += f", with the profile of {parameters.camera}"
    if isinstance(model, NoiseModel) and model.components.quantisation and model.components.spec != "U":
        model = model.without_quantisation()
    workers = Workers.of(workers)
    chosen = sorted_frames(frames, Workers(workers.jobs))
    problems = [problem for one in chosen for problem in one.problems]
    problems += [_too_few(frames, one) for one in chosen if len(one.bias) < 2]
    if problems:
        raise FramesError(problems)
    if len(chosen) > 1 and not isinstance(parameters, CameraProfile):
        raise ArgumentError(
            f"parameters are of one ISO, and the frames of {len(chosen)}; give a profile, or isos=[...]"
        )
    judge = partial(check_iso_noise, model, parameters, seed=seed, pairs=pairs, whole_frames=whole_frames)
    if workers.executor is None:
        found = [judge(frames, one, workers=workers) for one in chosen]
    else:
        found = list(workers.run(work_elsewhere(judge, frames), chosen, label=f"checking {name}", unit="ISO"))
    return Acceptance(frames.camera, name, seed, pairs, tuple(found))


def _too_few(frames: CalibrationFrames, one: IsoFrames) -> Problem:
    where = f"ISO {float(one.iso):g}"
    advice = "take ten more with the lens capped, and keep them from the calibration"
    return Problem(frames.camera, where, "bias", "two held-out bias frames or more", str(len(one.bias)), advice)


# --- one ISO ------------------------------------------------------------------------------------------------------


def check_iso_noise(
    model: NoiseMaker,
    parameters: CameraProfile | NoiseParameters,
    frames: CalibrationFrames,
    chosen: IsoFrames,
    *,
    seed: int = 0,
    pairs: int = PAIRS,
    whole_frames: bool = False,
    workers: Workers = IN_THIS_PROCESS,
) -> IsoAcceptance:
    """Check a model at one ISO; arguments and errors are those of :func:`check_noise`, and ``chosen`` its frames."""
    camera = HeldOutFrames(frames, workers)
    held_out = camera.bias_pairs(chosen.bias)
    first = next(held_out, None)
    if first is None:
        camera.refuse()
        raise DatasetError(
            f"ISO {float(chosen.iso):g}: fewer than two bias frames that differ: " + camera.copies.remarks[0]
        )
    sensor, shape = camera.sensor, first[0].shape
    if min(shape) < _SMALLEST:
        raise DatasetError(f"the comparison needs {_SMALLEST} x {_SMALLEST} pixels or more; found {shape}")
    told, measured = _parameters(parameters, chosen.iso, sensor, seed)
    pattern = pattern_of(sensor.cfa)
    scale = PairScale.of_bias(*first, pattern)
    made = MadeFrames(model, told, sensor, (seed, int(chosen.iso)), whole_frames, _seconds(chosen.bias_exposure_s))
    no_light = np.zeros((sensor.height, sensor.width) if whole_frames else shape, dtype=np.float32)
    made.check(no_light, first[0], scale)

    def of_bias() -> Iterator[PairFigures]:
        yield dark_pair(*first, scale)
        for one in held_out:
            yield dark_pair(*one, scale)
        camera.refuse()

    measure = partial(dark_pair, scale=scale)
    reference, of_camera, of_model = _sides(
        made, no_light, 1, pairs, measure, workers, of_bias(), f"ISO {float(chosen.iso):g}"
    )
    statistics = frame_statistics(reference, of_camera, of_model, first[0].size)

    levels = [np.mean(of_camera.of(name)) for name in level_names(channels_of(pattern))]
    lit, used, remarks = _flats(camera, chosen, made, np.array(levels, dtype=np.float32), pairs)
    drawn = [] if measured else ["the profile has not measured this ISO, or not completely: its parameters were drawn"]
    few = [] if of_camera.fours else ["pixels of unlike noise are looked for in fours of bias frames: there are fewer"]
    return IsoAcceptance(
        iso=float(chosen.iso),
        parameters=told,
        measured=measured,
        bias_frames=2 * len(of_camera.pairs),
        flat_frames=used,
        shape=(shape[0], shape[1]),
        statistics=(*statistics, *lit),
        curves=curves_of(of_camera, of_model, scale),
        remarks=tuple(dict.fromkeys((*drawn, *few, *remarks, *camera.copies.remarks))),
    )


def _sides(
    made: MadeFrames,
    light_dn: Plane,
    stream: int,
    pairs: int,
    measure: Callable[[Mosaic, Mosaic], PairFigures],
    workers: Workers,
    held_out: Iterable[PairFigures],
    label: str,
) -> tuple[PairNumbers, PairNumbers, PairNumbers]:
    """Return the numbers of the model's reference, of the camera, and of the model, for one kind of frames.

    A model not ours may not be called by two threads at a time.
    """
    if not isinstance(made.model, NoiseModel) or made.model.dark_frames is not None:
        workers = IN_THIS_PROCESS

    def simulated(stream: int, count: int) -> Iterator[PairFigures]:
        return workers.read_ahead(lambda index: measure(*made.pair(light_dn, stream, index)), range(count))

    reference, of_camera, of_model = PairNumbers(), PairNumbers(), PairNumbers()
    total = np.zeros(1)
    for pair in simulated(stream, _REFERENCE):
        total = total + pair.mean_dn
        reference.add(pair)
    mean_dn = (total / _REFERENCE).astype(np.float32)
    for pair in held_out:
        of_camera.add(pair, mean_dn)
    for pair in tqdm(simulated(stream + 1, pairs), label, pairs, unit="pair", disable=None, leave=False):
        of_model.add(pair, mean_dn)
    return reference, of_camera, of_model


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
    camera: HeldOutFrames, chosen: IsoFrames, made: MadeFrames, dark: Plane, pairs: int
) -> tuple[list[FrameStatistic], int, list[str]]:
    """Return the statistics of flats at three exposures at most, how many frames they are of, and remarks."""
    by_time: dict[Fraction | None, list[FlatPair]] = {}
    for pair in chosen.pairs:
        by_time.setdefault(pair.first.exposure_s, []).append(pair)
    groups = [by_time[time] for time in sorted(by_time, key=lambda time: time or 0)]
    usable = [group for group in groups if not _is_saturated(camera, group[0])]
    camera.refuse()
    saturated = len(groups) - len(usable)
    remarks = [f"flats of {counted(saturated, 'exposure')} saturate and were left out"] if saturated else []
    places = sorted({round(place) for place in np.linspace(0, len(usable) - 1, min(_FLAT_LEVELS, len(usable)))})
    streams = range(3, 3 + 2 * len(places), 2)
    found = [
        _of_exposure(camera, usable[place], made, dark, pairs, stream)
        for place, stream in zip(places, streams, strict=True)
    ]
    camera.refuse()
    used = sum(2 * one[0].held_out for one in found if one)
    return list(chain.from_iterable(found)), used, remarks


def _is_saturated(camera: HeldOutFrames, pair: FlatPair) -> bool:
    flats = camera.flats(pair)
    if flats is None:
        return True
    return max(float(np.mean(camera.cut(flat) >= camera.sensor.white_level_dn)) for flat in flats) > _SATURATED


def _of_exposure(
    camera: HeldOutFrames, group: Sequence[FlatPair], made: MadeFrames, dark: Plane, pairs: int, stream: int
) -> list[FrameStatistic]:
    """Return the statistics of one exposure's flats, of whose first pair the light is taken."""
    found = (flats for one in group if (flats := camera.flats(one)) is not None)
    flats = next(found, None)
    if flats is None:
        return []
    pattern = pattern_of(made.sensor.cfa)
    first = camera.cut(flats[0]), camera.cut(flats[1])
    scale = PairScale.of_flats(*first, by_pixel(dark, pattern, first[0].shape), pattern)
    mean = mean_of(*(flats if made.whole_frames else first))
    light = np.maximum(smoothed(mean, scale.sigma_dn, pattern) - by_pixel(dark, pattern, mean.shape), 0)
    held_out = chain([first], ((camera.cut(one), camera.cut(two)) for one, two in found))
    made = replace(made, exposure_s=_seconds(group[0].first.exposure_s))
    measure = partial(flat_pair, scale=scale)
    of_flats = (measure(*one) for one in held_out)
    reference, of_camera, of_model = _sides(made, light, stream, pairs, measure, camera.workers, of_flats, "flats")
    where = light[compared_place(light.shape, len(pattern))] if made.whole_frames else light
    check = f"flats of {float(where.mean()):.0f} DN"
    return frame_statistics(reference, of_camera, of_model, where.size, check)


def _seconds(exposure_s: Fraction | None) -> float | None:
    return None if exposure_s is None else float(exposure_s)


# --- the model's frames ---------------------------------------------------------------------------------------------

_UNITS_APART = 64.0  # a model whose noise is so many times too strong or weak is taken to be in other units
_CLIPPED = 0.01  # of the values


@dataclass(frozen=True, slots=True)
class MadeFrames:
    """Makes the model's frames of one ISO, as the camera's converter gives them."""

    model: NoiseMaker
    parameters: NoiseParameters
    sensor: Sensor
    seed: tuple[int, ...]
    whole_frames: bool
    exposure_s: float | None = None

    @property
    def range_dn(self) -> float:
        """White level minus black level, DN."""
        return self.sensor.white_level_dn - float(np.mean(self.sensor.black_level_dn))

    def values_dn(self, light_dn: Plane, *stream: int) -> Plane:
        """Return an exposure of light (H, W), DN over black, of the piece that is compared, before it is digitised."""
        generator = np.random.default_rng([*self.seed, *stream])
        options: dict[str, Any] = {}
        if isinstance(self.model, NoiseModel) and self.model.dark_shading is not None:
            options["exposure_s"] = self.exposure_s
        made = made_exposure(
            self.model,
            pack_whole(light_dn / np.float32(self.range_dn), self.sensor.cfa),
            parameters=self.parameters,
            ratio=1.0,
            range_dn=self.range_dn,
            generator=generator,
            **options,
        )
        values = unpack_whole(made, self.sensor.cfa, light_dn.shape)
        if self.whole_frames:
            values = values[compared_place(values.shape, len(self.sensor.cfa))]
        if not np.isfinite(values).all():
            raise ArgumentError(
                f"{maker_name(self.model)} returned values that are not finite numbers (NaN or infinite)"
            )
        result: Plane = values * np.float32(self.range_dn)
        return result

    def frame(self, light_dn: Plane, *stream: int) -> Mosaic:
        """Return a DN of each pixel, rounded as in the camera's files."""
        values = self.values_dn(light_dn, *stream)
        black = np.asarray(self.sensor.black_level_dn, dtype=np.float32)
        values += by_pixel(black, pattern_of(self.sensor.cfa), values.shape)
        codes: Mosaic = np.clip(self.parameters.rounded(values), 0, self.sensor.white_level_dn).astype(np.uint16)
        return codes

    def pair(self, light_dn: Plane, stream: int, index: int) -> tuple[Mosaic, Mosaic]:
        """Return two frames; stream and index number the pair."""
        return self.frame(light_dn, stream, index, 0), self.frame(light_dn, stream, index, 1)

    def check(self, dark_dn: Plane, frame: Mosaic, scale: PairScale) -> None:
        """Refuse a model that clips at 0, or whose values are in other units than the frames'."""
        values, name = self.values_dn(dark_dn, 0), maker_name(self.model)
        low, middle, high = (float(value) for value in np.quantile(values, (0.159, 0.5, 0.841)))
        ratio = (high - low) / 2 / scale.sigma_dn
        if ratio > _UNITS_APART:
            as_dn = (high - low) / 2 / self.range_dn
            raise ArgumentError(
                f"{name} makes dark frames whose noise is {ratio:.0f} times that of the held-out frames "
                f"({scale.sigma_dn:.2f} DN). If its values are DN (they are about {middle / self.range_dn:.5g}, with a "
                f"spread of {as_dn:.3g}), divide them: expected is normalised data, (value - black) / (white - black), "
                f"here over {self.range_dn:g} DN"
            )
        if 0 < ratio < 1 / _UNITS_APART:
            raise ArgumentError(
                f"{name} makes dark frames whose noise is {1 / ratio:.0f} times weaker than the held-out frames' "
                f"({scale.sigma_dn:.2f} DN). Are its values divided by the range ({self.range_dn:g} DN) twice? "
                "expected is (value - black) / (white - black)"
            )
        at_zero = float(np.mean(values == 0))
        black = np.asarray(self.sensor.black_level_dn)[pattern_of(self.sensor.cfa)].min()
        below = float(np.mean(frame < black))
        if high > low and values.min() >= 0 and at_zero > _CLIPPED and below > _CLIPPED:
            raise ArgumentError(
                f"{name} clips at black: {at_zero:.0%} of its values in the dark are exactly 0 and none is below, "
                f"while {below:.0%} of the held-out frames' are below black. Let the model keep negative values "
                "(clip='none' of a NoiseModel); a dataset clips afterwards, the frames and the model alike"
            )
