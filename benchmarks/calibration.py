"""Calibration: the read-noise fit, the naive routes, and all ISOs of a camera from files.

The first two use one core, whatever there is, and run on one core alone.
"""

from __future__ import annotations

import os
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks import calibration_naive as naive
from benchmarks.data import CALIBRATION_ISOS, SIZE
from benchmarks.harness import Row, Spread, Timings, in_turn, peak_growth_mb
from eldata.base.workers import Workers
from eldata.calibration import (
    BiasStack,
    BiasSums,
    FlatPairs,
    ResidualHistogram,
    calibrate,
    fixed_pattern,
    photon_transfer,
    read_noise,
    row_noise,
)
from eldata.datasets import CalibrationFrames
from eldata.demo.body import tukey_lambda_values
from eldata.demo.calibration_frames import DEMO_GAMMA, make_calibration_frames

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from benchmarks.data import Files
    from eldata.calibration import Calibration, FixedPattern, PhotonTransfer, ReadNoise, RowNoise
    from eldata.demo.body import KnownNoise
    from eldata.records import FrameRecord

    Mosaics = Sequence[NDArray[np.uint16]]

_ROUNDS = 2  # at most, of what takes seconds
_RESIDUALS = 12_000_000
_SHAPE, _SCALE = -0.1, 3.0  # of these residuals
_EQUAL_SHAPE, _EQUAL_SCALE = 0.001, 0.002  # what ours and scipy's may be off the truth
_GROUPS = 64  # of residuals: the standard errors need some

_ISO = 1600  # of the naive routes
_PIXELS = 100_000  # a user's sample for scipy
_DRAWS = 5  # samples whose scatter is stated
_SIDE = 512  # of the middle of a flat
# What the calibration promises (docs), asserted here.
_GAIN_PERCENT, _ROW_PERCENT, _SHAPE_OFF, _SCALE_PERCENT = 1.0, 3.0, 0.02, 1.0

_ONCE, _AS_OFTEN = "decoding each file once", "decoding as often"  # bias frames twice
_PEAK_LIMIT_MB = 800


def run(files: Files, rounds: int, cores: int) -> list[Row]:
    rows = _end_to_end(files.calibration, cores)  # first: the peak is beyond what the process begins with
    if cores == 1:
        frames = CalibrationFrames(files.calibration)
        rows = [*_fit_alone(), *_naive_routes(frames, min(rounds, _ROUNDS)), *rows]
    return rows


# --- the fit alone --------------------------------------------------------------------------------------------


def _fit_alone() -> list[Row]:
    draws = np.random.default_rng(0).random(_RESIDUALS)
    residuals = np.rint(_SCALE * tukey_lambda_values(draws, _SHAPE)).astype(np.int16)
    del draws
    read_noise(_counted(residuals[:100_000]))  # compiles
    naive.ppcc(residuals[:1000])
    ours: list[ReadNoise] = []
    theirs: list[tuple[float, float]] = []
    peaks: dict[str, list[float]] = {"eldata": [], "scipy": []}
    target = np.empty_like(residuals)

    def eldata() -> None:
        peaks["eldata"].append(peak_growth_mb(lambda: ours.append(read_noise(_counted(residuals)))))

    def scipy() -> None:
        peaks["scipy"].append(peak_growth_mb(lambda: theirs.append(naive.ppcc(residuals))))

    other = "scipy's ppcc_max, probplot"
    ways = {other: scipy, "eldata": eldata, "copy of the residuals": lambda: np.copyto(target, residuals)}
    timings = in_turn(1, ways)  # scipy takes a quarter of a minute a round, and one is for warming up
    read, (shape, scale) = ours[0], theirs[0]
    errors = read.tukey_lambda - _SHAPE, read.sigma_tl_dn / _SCALE - 1
    scipys = shape - _SHAPE, scale / _SCALE - 1
    for error_of_shape, error_of_scale in (errors, scipys):
        assert abs(error_of_shape) < _EQUAL_SHAPE
        assert abs(error_of_scale) < _EQUAL_SCALE
    values = (
        f"lambda off by {errors[0]:+.4f}, sigma by {100 * errors[1]:+.2f} %; "
        f"scipy by {scipys[0]:+.4f}, {100 * scipys[1]:+.2f} %"
    )
    case = "read noise, 12 M integers"
    peak = max(peaks["eldata"])
    return [
        timings.faster(case, "eldata", other, at_least=100, values=values),
        timings.cost(case, "eldata", "copy of the residuals"),
        Row(case, Spread.of(peaks["eldata"]), other, Spread.of(peaks["scipy"]), peak, " MB"),
    ]


def _counted(residuals: NDArray[np.int16]) -> ResidualHistogram:
    half = int(np.abs(residuals).max()) + 1
    parts = np.array_split(residuals, _GROUPS)
    counts = np.stack([np.bincount(part + half, minlength=2 * half + 1) for part in parts])
    return ResidualHistogram(counts, cell_dn=1.0, rounding_dn=0.0)


# --- the naive routes -----------------------------------------------------------------------------------------


def _naive_routes(frames: CalibrationFrames, rounds: int) -> list[Row]:
    """Frames in memory, 12 megapixels with PRNU, vignetting, hot pixels and a fixed pattern; 10 bias and 10 flats."""
    truth = DEMO_GAMMA.noise_at(_ISO)
    bias, flats = ([frames.read(record).mosaic for record in frames.of(role, _ISO)] for role in ("bias", "flat"))
    sensor = frames.read(frames.of("bias", _ISO)[0]).sensor
    black = sensor.black_level_dn[0]

    def fixed() -> FixedPattern:
        stack = BiasStack(sensor.cfa)
        for frame in bias:
            stack.add(frame)
        return fixed_pattern(stack)

    def gain(known: FixedPattern) -> PhotonTransfer:
        pairs = FlatPairs(sensor.cfa, known.level_dn, sensor.white_level_dn, defects=known.defects)
        for first, second in zip(flats[::2], flats[1::2], strict=True):
            pairs.add(first, second)
        return photon_transfer(pairs)

    def second_pass() -> BiasSums:
        sums = BiasSums(fixed())
        for frame in bias:
            sums.add(frame)
        return sums

    def rows() -> RowNoise:
        return row_noise(second_pass())

    def read() -> ReadNoise:
        return read_noise(second_pass().residuals())

    known = fixed()
    target = np.empty_like(bias[0])
    generator = np.random.default_rng(0)
    every = {
        "K": lambda: gain(known),
        "spatial variance": lambda: naive.spatial_gain(flats, black),
        "sigma_row": rows,
        "std of row means": lambda: naive.row_sigma(bias),
        "lambda": read,
        "scipy on a frame less the mean": lambda: naive.tukey_lambda(bias, _PIXELS, generator),
        "scipy on a frame": lambda: naive.tukey_lambda_of_one(bias[0], _PIXELS, generator),
        "copy of ten frames": lambda: [target.__setitem__(..., frame) for frame in bias],
    }
    timings = in_turn(rounds, every)
    return [
        *_gain_rows(timings, truth, gain(known).gain_dn_per_e, flats, black),
        *_row_rows(timings, truth, rows().rows.sigma_dn, bias),
        *_read_rows(timings, truth, read(), bias, generator),
    ]


def _gain_rows(timings: Timings, truth: KnownNoise, found: float, flats: Mosaics, black: float) -> list[Row]:
    error, whole, middle = (
        _percent(value, truth.gain_dn_per_e)
        for value in (found, naive.spatial_gain(flats, black), naive.spatial_gain(flats, black, _SIDE))
    )
    assert abs(error) < _GAIN_PERCENT
    values = f"K off by {error:+.2f} %; spatial by {whole:+.0f} %, in the middle {_SIDE} x {_SIDE} by {middle:+.0f} %"
    case = "K, 10 flats"
    return [
        timings.faster(case, "K", "spatial variance", values=values),
        timings.cost(case, "K", "copy of ten frames"),
    ]


def _row_rows(timings: Timings, truth: KnownNoise, found: float, bias: Mosaics) -> list[Row]:
    error, plain = (_percent(value, truth.sigma_row_dn) for value in (found, naive.row_sigma(bias)))
    assert abs(error) < _ROW_PERCENT
    values = f"sigma_row off by {error:+.2f} %; std by {plain:+.1f} %"
    case = "sigma_row, 10 bias frames"
    return [
        timings.faster(case, "sigma_row", "std of row means", values=values),
        timings.cost(case, "sigma_row", "copy of ten frames"),
    ]


def _read_rows(
    timings: Timings, truth: KnownNoise, found: ReadNoise, bias: Mosaics, generator: np.random.Generator
) -> list[Row]:
    shape, scale = found.tukey_lambda - truth.tukey_lambda, _percent(found.sigma_tl_dn, truth.sigma_tl_dn)
    assert abs(shape) < _SHAPE_OFF
    assert abs(scale) < _SCALE_PERCENT
    less_mean = [naive.tukey_lambda(bias, _PIXELS, generator) for _ in range(_DRAWS)]
    of_one = [naive.tukey_lambda_of_one(bias[0], _PIXELS, generator) for _ in range(_DRAWS)]
    ours = f"lambda off by {shape:+.4f}, sigma_TL by {scale:+.2f} %; scipy by "
    case = "lambda, sigma_TL, 10 bias frames"
    return [
        timings.faster(case, "lambda", "scipy on a frame less the mean", values=ours + _scatter(less_mean, truth)),
        timings.faster(case, "lambda", "scipy on a frame", values=ours + _scatter(of_one, truth)),
        timings.cost(case, "lambda", "copy of ten frames"),
    ]


def _scatter(found: Sequence[tuple[float, float]], truth: KnownNoise) -> str:
    """Return mean and standard deviation of the errors over several samples of pixels."""
    shapes = [shape - truth.tukey_lambda for shape, _ in found]
    scales = [_percent(scale, truth.sigma_tl_dn) for _, scale in found]
    return (
        f"{np.mean(shapes):+.3f} ± {np.std(shapes, ddof=1):.3f}, "
        f"{np.mean(scales):+.1f} ± {np.std(scales, ddof=1):.1f} % ({_PIXELS:,} pixels)"
    )


def _percent(found: float, truth: float) -> float:
    return 100 * (found / truth - 1)


# --- all ISOs from files --------------------------------------------------------------------------------------


def _end_to_end(root: Path, cores: int) -> list[Row]:
    """Measure ``calibrate`` with a thread a core: the peak over all ISOs, the time of some in turn with decoding them.

    An ISO is the same work as any other, and of one nothing but its figures is kept when the next begins. So one core,
    to save minutes, gets the two ISOs of the least and the most noise in place of nine.
    """
    _warm_up()
    every = CalibrationFrames(root)
    isos = [int(iso) for iso in every.isos]
    if cores == 1:
        isos = [isos[0], isos[-1]]
    found: list[Calibration] = []
    begin, start = _resident_mb(), time.perf_counter()
    peak = peak_growth_mb(lambda: found.append(calibrate(CalibrationFrames(root, isos=isos), workers=cores)))
    elapsed = time.perf_counter() - start
    ways: dict[str, list[float]] = {"eldata": [], _ONCE: [], _AS_OFTEN: []}
    for number, iso in enumerate(isos[:: len(isos) // 2]):
        frames = CalibrationFrames(root, isos=[iso])
        again = frames.of("bias", iso)[:-1]  # the last one is held out and read once
        decode = partial(_decode, frames, threads=cores)
        turn: dict[str, Callable[[], object]] = {
            "eldata": partial(calibrate, frames, workers=cores),
            _ONCE: partial(decode, frames.records),
            _AS_OFTEN: partial(decode, (*frames.records, *again)),
        }
        for way in turn if number % 2 else reversed(turn):
            before = time.perf_counter()
            turn[way]()
            ways[way].append(1000 * (time.perf_counter() - before))
    timings = Timings(ways)
    case = f"calibrate, an ISO of 20 files, jobs={cores}"
    count = 20 * len(isos)
    ahead = (1 if cores == 1 else cores + 1) * 2 * SIZE[0] * SIZE[1] / 1e6
    per_pixel = f"{1e6 * peak / (SIZE[0] * SIZE[1]):.0f} bytes per pixel"
    values = f"{count} files at once: {elapsed:.0f} s, {begin:.0f} MB before, {per_pixel}; {_worst(found[0])}"
    return [
        timings.cost(case, "eldata", _AS_OFTEN, at_most=2),
        timings.cost(case, "eldata", _ONCE),
        Row(
            f"calibrate, {len(isos)} ISOs, jobs={cores}",
            Spread.of([peak]),
            "frames read ahead",
            Spread.of([ahead]),
            peak,
            " MB",
            _PEAK_LIMIT_MB,
            values,
        ),
    ]


def _warm_up() -> None:
    """Compile and import: neither is part of time and peak."""
    with tempfile.TemporaryDirectory(prefix="eldata-benchmarks-") as folder:
        make_calibration_frames(Path(folder), isos=(_ISO,), size=(256, 384))
        calibrate(Path(folder) / "data" / "calibration")


def _decode(frames: CalibrationFrames, records: Sequence[FrameRecord], threads: int) -> None:
    for frame in Workers(threads).read_ahead(frames.read, records):
        del frame


def _worst(found: Calibration) -> str:
    """Return the largest errors of any ISO, held against what the calibration promises."""
    known = {other: iso for iso, others in CALIBRATION_ISOS.items() for other in (iso, *others)}
    gain = row = shape = scale = 0.0
    for one in found.isos:
        truth = DEMO_GAMMA.noise_at(known[int(one.iso)])
        gain = max(gain, abs(_percent(one.gain_dn_per_e or 0.0, truth.gain_dn_per_e)))
        row = max(row, abs(_percent(one.rows.rows.sigma_dn, truth.sigma_row_dn)))
        if one.tukey_lambda is not None and one.sigma_tl_dn is not None:
            shape = max(shape, abs(one.tukey_lambda.value - truth.tukey_lambda))
            scale = max(scale, abs(_percent(one.sigma_tl_dn.value, truth.sigma_tl_dn)))
    assert gain < _GAIN_PERCENT
    assert row < _ROW_PERCENT
    assert shape < _SHAPE_OFF
    assert scale < _SCALE_PERCENT
    return f"off by up to {gain:.2f} % (K), {row:.1f} % (sigma_row), {shape:.4f} (lambda), {scale:.2f} % (sigma_TL)"


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
