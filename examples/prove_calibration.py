"""Twelve simulated cameras through `eldata.calibrate`: whether errors cover truths, and are reasons what was planted.

    python examples/prove_calibration.py                    # 71 cases of a camera at an ISO, under a minute of one core
    python examples/prove_calibration.py quiet twelve -v    # these cameras alone, with every figure and remark
    python examples/prove_calibration.py --seed 1 --repeat 5

The frames are made in plain numpy, from what real cameras do, and share no code with the package. A truth is what
docs/calibration.md says that the figure is: read noise is what a pixel changes by from frame to frame, before rounding;
the colour bias is the mean of all pixels, defects too, less the stated black. Where the noise is of no Tukey lambda
distribution (normal, telegraph), lambda and sigma_TL have no truth and are not counted.

Faults are reported for: a figure that lies far off or too often beyond two of its errors; a reason or remark that names
causes of which none was planted; a figure withheld that nothing planted harms; a cause that nothing names; a profile
that goes beyond the ISOs with read noise.
"""

from __future__ import annotations

import argparse
import math
import os
import re
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import binom, norm, tukeylambda

from eldata import CalibrationFrames, calibrate
from eldata.errors import ArgumentError
from eldata.records import Exposure, FrameRecord, RawFrame, RawHeader, Sensor

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

BAYER = ((0, 1), (3, 2))
XTRANS = tuple(tuple(map(int, row)) for row in ("021201", "110112", "112110", "201021", "112110", "110112"))
READ = ("lambda", "sigma_TL", "sigma_G")
FIGURES = {
    "K": ("gain", "gain"), "lambda": ("tukey_lambda", "shape"), "sigma_TL": ("sigma_tl_dn", "shape"),
    "sigma_G": ("sigma_gauss_dn", "read noise"), "sigma_row": ("sigma_row_dn", "row noise"),
    "bias": ("colour_bias", "colour bias"),
}  # fmt: skip
# What a cause may withhold, and the words with which a text names it;
CAUSES = {
    "quiet": ((*READ, "sigma_row", "bias"), r"rounding|is quiet|too quiet"),
    "rounded": ((), r"rounding|is quiet|too quiet"),
    "step": (READ, r"step by|steps of|fewer bits"),
    "clipped": ((*READ, "sigma_row", "bias"), r"clip|\bend at|subtracted black"),
    "cut tails": (READ, r"clip|\bend at"),
    "light": ((*READ, "bias"), r"light or dark|dark current|viewfinder"),
    "telegraph": (READ, r"telegraph|another family|not of this family"),
    "lossy": (tuple(FIGURES), r"lossy|with loss|compress|tone curve"),
    "smoothed": (tuple(FIGURES), r"filter|smooth|noise reduction|resampl|share noise"),
    "saturated": (("K",), r"saturat"),
    "black": (("bias",), r"stated black|black is|black jumps"),
    "columns": ((), r"columns have noise"),
    "gain step": ((), r"conversion gain|gain mode|--mode|extended ISO"),
    "movement": ((), r"moved|tripod"),  # this one and the next are in no camera
    "copies": ((), r"copies hide"),
}
TO_SAY = {*CAUSES} - {"quiet", "rounded", "cut tails", "telegraph", "movement", "copies"}  # wherever they are


@dataclass(frozen=True)
class Case:
    """One camera at one ISO. In DN, where nothing else is said."""

    gain: float = 1.0  # K, DN per photoelectron
    sigma: float = 2.0  # standard deviation of a pixel's noise
    shape: float | None = 0.0  # lambda of its Tukey lambda distribution (0: logistic); None: normal
    row: float = 0.2
    bias: tuple[float, ...] = (0.6, -0.3, 0.4, -0.5)
    cfa: tuple[tuple[int, ...], ...] = BAYER
    size: tuple[int, int] = (256, 384)
    black: float = 512.0  # as stated
    black_off: float = 0.0
    white: float = 16383.0  # as stated
    top: float = math.inf  # at which the sensor saturates
    floor: float | None = None  # least value that is written, of a camera that subtracts black
    step: int = 1  # between codes
    codes: int = 0  # of a square-root table that the values pass
    prnu: float = 0.008
    dsnu: float = 0.3
    row_pattern: float = 0.0
    column_pattern: float = 0.1
    columns: float = 0.0  # noise of columns that changes
    hot: float = 1e-4  # share of pixels
    telegraph: float = 0.0  # share of pixels, with steps of eight sigma in the mean
    leak: float = 0.0  # light in the brightest corner of bias frames
    eater: bool = False  # single bright and dark pixels are drawn to their neighbours
    gain_step: bool = False
    frames: int = 10
    pairs: int = 5
    brightest: float = 0.8  # of the flats, as a share of the range

    @property
    def planted(self) -> set[str]:
        """The causes that there are."""
        apart = 2 * math.sqrt(self.black * self.white) / self.codes if self.codes else self.step  # codes, at black
        facts = {
            "quiet": self.sigma < 0.7 * apart, "rounded": self.sigma < 1.3 * apart, "step": self.step > 1,
            "clipped": self.floor is not None, "cut tails": 0 < self.black < 10 * self.sigma, "light": self.leak > 0,
            "telegraph": self.telegraph > 0, "lossy": self.codes > 0, "smoothed": self.eater,
            "saturated": self.top < self.white, "black": self.black_off > 100, "columns": self.columns > 0,
            "gain step": self.gain_step,
        }  # fmt: skip
        return {name for name, holds in facts.items() if holds}


def cameras() -> dict[str, dict[int, Case]]:
    """Return the twelve, by ISO."""

    def by_iso(
        sigmas: Sequence[float], gain: float, lists: Mapping[str, Sequence[Any]], **of_all: Any
    ) -> dict[int, Case]:
        ladder = ({"sigma": sigma, "gain": gain * 2**n, "row": 0.15 * sigma} for n, sigma in enumerate(sigmas))
        own = ({**rung, **{name: values[n] for name, values in lists.items()}} for n, rung in enumerate(ladder))
        return {100 * 2**n: Case(**of_all, **changes) for n, changes in enumerate(own)}

    even = {"dsnu": 0.02, "column_pattern": 0.0, "prnu": 0.004}
    silent = {"dsnu": 0.0, "column_pattern": 0.0, "hot": 0.0, "shape": None, "frames": 6, "pairs": 4}
    two = {"shape": 0.05, "dsnu": 0.8, "hot": 1e-3, "white": 15303.0, "black": 2048.0, "frames": 6, "size": (320, 480)}
    fuji = {"cfa": XTRANS, "size": (300, 420), "bias": (1.2, -0.8, 2.0), "row_pattern": 0.5, "column_pattern": 0.4}
    phone = {"black": 64.0, "white": 1023.0, "shape": -0.2, "frames": 4, "pairs": 3, "bias": (0.1, 0.2, -0.1, 0.15)}
    ends = {"floor": (0, 0, 0, 1, 1, 1), "black": (0, 0, 0, 1, 0, 1)}
    late = {"eater": (0, 0, 0, 1, 1, 1), "top": (13583, 13583, *4 * (math.inf,))}
    shapes = {"shape": (0.14, 0.08, 0.0, -0.08, -0.14), "black_off": (0, 0, 8, 0, 512)}
    return {
        "plain": by_iso((0.9, 1.3, 2.2, 4, 8, 16, 32), 0.1, {"shape": (-0.2, -0.1, -0.05, 0.0, 0.1, 0.2, 0.3)}),
        "quiet": by_iso((0.2, 0.4, 0.4, 0.5, 0.8, 1.6), 0.05, {"shape": (-0.05, -0.05, 0.1, *3 * (-0.05,))}, **even),
        "silent": by_iso((0, 0.05, 0.3, 1, 2, 4), 0.04, {}, **silent),
        "twelve": by_iso((0.8, 3, 6, 9, 14, 25), 0.25, {}, step=4, shape=-0.1, bias=(2.0, 1.0, -1.5, 1.0)),
        "twogains": by_iso((2.5, 4.6, 9, 5, 9.7, 19), 0.2, {}, gain_step=True, **two),
        "telegraph": by_iso((1.2, 2.2, 4.2, 8.2, 16), 0.15, {}, telegraph=0.01, hot=1e-3, shape=None),
        "clipped": by_iso((0.05, 0.6, 4, 1.5, 4, 9), 0.3, ends, bias=(0.3, 0.1, 0.2, -0.1)),
        "rooted": by_iso((1.5, 3, 6, 12, 20), 0.12, {"codes": (2047, 2047, 2047, 1023, 1023)}, frames=6),
        "xtrans": by_iso((1.1, 1.9, 3.6, 7, 13), 0.11, shapes, frames=6, **fuji),
        "phone": by_iso((0.45, 0.7, 1.2, 2.3, 4.4, 8, 8), 0.1, {"columns": (*6 * (0,), 2)}, **phone),
        "leaking": by_iso((1, 1.8, 3.4, 6.6, 13, 26), 0.5, {"leak": (0, 1, 3, 10, 0, 60)}, shape=0.1),
        "smoothed": by_iso((1, 1.9, 3.7, 7.3, 14, 28), 0.12, late, brightest=0.95),
    }


class Specimen:
    """One sensor at one ISO: what stays from frame to frame is drawn once."""

    def __init__(self, case: Case, rng: np.random.Generator) -> None:
        self.case, self.rng = case, rng
        height, width = shape = case.size
        self.channel = np.tile(case.cfa, (height // 2, width // 2))[:height, :width]
        self.offset = case.black + case.black_off + np.array(case.bias)[self.channel]
        self.offset += case.dsnu * rng.standard_normal(shape) + case.column_pattern * rng.standard_normal(width)
        self.offset += case.row_pattern * rng.standard_normal((height, 1))
        self.offset += (rng.random(shape) < case.hot) * rng.exponential(60.0, shape)
        self.response = 1 + case.prnu * rng.standard_normal(shape)
        self.jump = (rng.random(shape) < case.telegraph) * rng.exponential(8 * case.sigma + 1e-9, shape)
        self.filled = rng.uniform(0.1, 0.9, shape)
        y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
        self.family = norm() if case.shape is None else tukeylambda(case.shape)
        self.scale = case.sigma / float(self.family.std())
        self.falloff, self.corner = 1 - 0.1 * (x**2 + y**2), np.exp(-3 * ((1 - x) ** 2 + (1 - y) ** 2))

    def noise(self, u: np.ndarray) -> np.ndarray:
        """Return the quantiles of a pixel's noise."""
        return np.asarray(self.scale * self.family.ppf(u))

    def frame(self, light: float = 0.0) -> np.ndarray:
        """Return a bias frame, or a flat under so much light (DN)."""
        case, rng, (height, width) = self.case, self.rng, self.case.size
        values = self.offset + self.noise(rng.random((height, width))) + case.row * rng.standard_normal((height, 1))
        values += case.columns * rng.standard_normal(width) + self.jump * (rng.random((height, width)) < self.filled)
        expected = light * self.falloff * self.response if light else case.leak * self.corner
        values += case.gain * rng.poisson(np.maximum(expected, 0) / case.gain)
        written = self.digitise(values, case.floor or 0)
        if case.eater:
            away = [(y, x) for y in (-2, 0, 2) for x in (-2, 0, 2) if (y, x) != (0, 0)]
            around = np.stack([np.roll(written, move, axis=(0, 1)) for move in away])
            written = np.clip(written, around.min(axis=0), around.max(axis=0))
        return written.astype(np.uint16)

    def digitise(self, values: np.ndarray, least: float) -> np.ndarray:
        """Return what the camera writes of values."""
        case = self.case
        written: np.ndarray = np.clip(case.step * np.rint(values / case.step), least, min(case.top, case.white))
        if case.codes:
            table = np.rint((np.arange(case.codes + 1) / case.codes) ** 2 * case.white)
            written = table[np.rint(np.sqrt(written / case.white) * case.codes).astype(int)]
        return written

    def truths(self) -> dict[str, tuple[float, ...]]:
        """Return the figures' truths; those that there are."""
        case = self.case
        rows = math.hypot(case.row, case.columns) * norm.ppf((np.arange(16) + 0.5) / 16)
        draws = self.noise((np.arange(512) + 0.5) / 512)[:, None] + rows  # a sample of the noise without chance
        levels = np.arange(case.black - 20 * case.step, case.black + 20 * case.step, case.step / 32)
        means = np.array([self.digitise(level + draws, -math.inf).mean() for level in levels])

        def written(level: np.ndarray) -> np.ndarray:
            return np.asarray(level + np.interp(level, levels, means - levels, left=0, right=0))

        mean = (1 - self.filled) * written(self.offset) + self.filled * written(self.offset + self.jump)
        between = float(np.mean(self.jump**2 * self.filled * (1 - self.filled)))
        bias = tuple(float(mean[self.channel == c].mean()) - case.black for c in range(len(case.bias)))
        found = {"K": (case.gain,), "sigma_G": (math.hypot(case.sigma, math.sqrt(between), case.columns),)}
        of_family = {} if case.shape is None or case.columns else {"lambda": (case.shape,), "sigma_TL": (self.scale,)}
        return {**found, **of_family, "sigma_row": (case.row,), "bias": bias}


class Frames(CalibrationFrames):
    """A camera's frames in memory, as :func:`eldata.calibrate` takes them."""

    def __init__(self, camera: str, cases: dict[int, Case], seed: int) -> None:
        self.root, self.camera, self.skipped, self.cases = Path(camera), camera, (), cases
        self.truths: dict[int, dict[str, tuple[float, ...]]] = {}
        self.made: dict[str, np.ndarray] = {}
        records = []
        for iso, case in cases.items():
            specimen = Specimen(case, np.random.default_rng((seed, iso, *camera.encode())))
            lights = np.linspace(0.08, case.brightest, case.pairs).repeat(2) * (case.white - case.black)
            for n, light in enumerate((*case.frames * (0.0,), *lights)):
                record = FrameRecord(f"{iso}/{n:02}", "flat" if light else "bias", camera, iso=Fraction(iso))
                self.made[record.path] = specimen.frame(light)
                records.append(record)
            self.truths[iso] = specimen.truths()
        self.records = tuple(records)

    def header(self, record: FrameRecord) -> RawHeader:
        """Return what its file would state: the two flats of a pair have a time of their own."""
        number = int(record.path[-2:]) - self.cases[int(record.iso or 0)].frames
        seconds = Fraction(1, 8000) if number < 0 else Fraction(1 + number // 2, 100)
        return RawHeader(Path(record.path), "eldata", self.camera, Exposure(record.iso, seconds, Fraction(8)))

    def path(self, record: FrameRecord) -> Path:  # noqa: ARG002 # of all alike
        """Return a file that says nothing of compression."""
        return Path(os.devnull)

    def read(self, record: FrameRecord) -> RawFrame:
        """Return a frame."""
        case = self.cases[int(record.iso or 0)]
        sensor = Sensor("eldata", self.camera, case.cfa, (case.black,) * len(case.bias), case.white, *case.size)
        return RawFrame(Path(record.path), self.made[record.path], sensor, self.header(record).exposure)


@dataclass
class Tally:
    """What became of the figures."""

    deviations: dict[str, list[tuple[float, str]]] = field(default_factory=lambda: defaultdict(list))  # in errors
    drawn: list[tuple[float, str]] = field(default_factory=list)
    withheld: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    details: list[str] = field(default_factory=list)
    cases: int = 0

    def add(self, camera: str, cases: dict[int, Case], seed: int) -> None:
        """Calibrate a camera and take down what came out."""
        frames = Frames(camera, cases, seed)
        found = calibrate(frames)
        self.cases += len(cases)
        records = {int(one.iso): one for one in (*found.isos, *found.gains)}
        failed = {int(one.iso): one.remark for one in found.failed}
        for iso, case in cases.items():
            where, texts = f"{camera} {iso}", () if iso in failed else records[iso].all_remarks
            if iso in failed:
                self._withhold(where, case, tuple(FIGURES), [failed[iso]])
            else:
                self._take(where, case, records[iso], frames.truths[iso])
            self._judge(where, case.planted, texts)
            said = {cause for text in (*texts, *found.remarks) for cause in blames(text)}
            self.faults += [f"NOT SAID, {where}: {cause}" for cause in sorted(case.planted & TO_SAY - said)]
        every: set[str] = set().union(*(case.planted for case in cases.values()))
        self._judge(camera, every, [text for text in found.remarks if text not in failed.values()])
        if found.made_profile is not None:
            self._draw(camera, found, frames)

    def _take(self, where: str, case: Case, one: Any, truths: dict[str, tuple[float, ...]]) -> None:
        missing = defaultdict(list)
        for name, (attribute, kind) in FIGURES.items():
            figure = getattr(one, attribute, None) or ()  # of flats alone there is K
            values: tuple[Any, ...] = figure if isinstance(figure, tuple) else (figure,)
            if not values:
                of_it = [finding for finding in one.findings if finding.effect == "withheld"]
                texts = tuple(finding.text for finding in of_it if kind in finding.figures)
                missing[texts or one.remarks].append(name)
            for value, truth in zip(values, truths.get(name, (math.nan,) * len(values)), strict=False):
                line = f"{where}: {value.value:.5g} +- {value.error:.2g} for {truth:.5g}"
                self.details.append(f"  {name} of {line}")
                if not math.isnan(truth):
                    self.deviations[name].append(((value.value - truth) / value.error, line))
        for texts, names in missing.items():
            self._withhold(where, case, names, texts)

    def _withhold(self, where: str, case: Case, names: Sequence[str], texts: Collection[str]) -> None:
        line = f"{where} ({', '.join(sorted(case.planted))}): {', '.join(names)}: {' | '.join(texts)}"
        self.withheld.append(line)
        needless = {*names}.difference(*(CAUSES[cause][0] for cause in case.planted))
        self.faults += [f"NEEDLESS, {', '.join(sorted(needless))} of {line}"] if needless else []
        if not texts or any(blames(text) and not blames(text) & case.planted for text in texts):
            self.faults.append(f"FALSE REASON, {line}")

    def _judge(self, where: str, planted: set[str], texts: Collection[str]) -> None:
        self.details += [f"  {where} says: {text}" for text in texts]
        false = [text for text in texts if blames(text) and not blames(text) & planted and "withheld:" not in text]
        self.faults += [f"FALSE REMARK, {where} ({', '.join(sorted(planted))}): {text}" for text in false]

    def _draw(self, camera: str, found: Any, frames: Frames) -> None:
        """Hold the profile's range against the ISOs that have read noise, and its draws against the truth."""
        low, high = found.profile.iso_range
        known = [one.iso for one in found.isos if one.sigma_tl_dn is not None and one.gain is not None]
        if not min(known) <= low <= high <= max(known):
            self.faults.append(f"RANGE, {camera}: ISO {low:g} to {high:g}, read noise of {known}")
        for iso, truths in frames.truths.items():
            other = frames.cases[iso].planted & {"smoothed", "gain step"}
            with suppress(ArgumentError):  # too few ISOs for a line
                if low <= iso <= high and "sigma_TL" in truths and not other:
                    rng = np.random.default_rng(0)
                    drawn = [found.profile.sample(rng, iso=iso, row="nearest-gain").sigma_tl_dn for _ in range(99)]
                    logs = np.log(drawn) - math.log(truths["sigma_TL"][0])
                    self.drawn.append((float(logs.mean()), f"{camera} {iso} ({logs.std():.0%})"))


def blames(text: str) -> set[str]:
    """Return the causes that a text names, if only as possible."""
    return {cause for cause, (_, words) in CAUSES.items() if re.search(words, text)}


def report(tally: Tally) -> Iterator[str]:
    """Yield the lines of the report."""
    yield f"{tally.cases} cases of a camera at an ISO"
    yield f"{'figure':10}{'given':>6}{'within 2':>9}{'share':>8}{'99 % of such':>17}   furthest"
    for name in FIGURES:
        values = sorted(tally.deviations[name], key=lambda one: -abs(one[0]))
        # Channels share the noise of their rows: as good as half as many.
        number = len(values) // 2 if name == "bias" else len(values)
        if not number:
            continue
        held = sum(abs(off) <= 2 for off, _ in values)
        low, high = (bound / number for bound in binom.interval(0.99, number, math.erf(math.sqrt(2))))
        if not low <= held / len(values):
            tally.faults.append(f"COVERAGE of {name}")
        far = [(off, line) for off, line in values if abs(off) > 4]
        tally.faults += [f"FAR OFF, {name}, {off:+.1f} errors: {line}" for off, line in far]
        known = f"{name:10}{len(values):6}{held:9}{held / len(values):8.1%}{low:9.1%} to {high:.1%}"
        yield f"{known}   {values[0][0]:+.1f} errors, {values[0][1]}"
    drawn = sorted(tally.drawn, key=lambda one: -abs(one[0]))
    listed = ", ".join(f"{math.expm1(off):+.0%} at {where}" for off, where in drawn[:6])
    yield f"sigma_TL as profiles draw it, furthest off, with its spread: {listed}"
    yield f"{len(tally.withheld)} times withheld, with a reason:"
    yield from tally.withheld
    yield f"{len(tally.faults)} faults:"
    yield from tally.faults


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cameras and print the report; 1 if there is a fault."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cameras", nargs="*", help=f"of {', '.join(cameras())}")
    parser.add_argument("--isos", type=int, nargs="+", help="these alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeat", type=int, default=1, help="how many specimens of each")
    parser.add_argument("-v", "--verbose", action="store_true")
    options = parser.parse_args(arguments)
    tally = Tally()
    for name, cases in cameras().items():
        chosen = {iso: case for iso, case in cases.items() if not options.isos or iso in options.isos}
        if chosen and (not options.cameras or name in options.cameras):
            for seed in range(options.seed, options.seed + options.repeat):
                tally.add(name, chosen, seed)
    print(*(tally.details if options.verbose else ()), *report(tally), sep="\n")
    return int(bool(tally.faults))


if __name__ == "__main__":
    raise SystemExit(main())
