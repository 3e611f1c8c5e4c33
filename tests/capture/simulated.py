"""A photographer who follows a plan, or nearly: small DNG files with arbitrary names and a running clock."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from capture.camera import EXAMPLE, CameraDescription, Shutter
from capture.cli import main
from capture.plan import Plan, make_plan
from capture.protocol import RELEASED
from capture.shots import Shot, plan_calibration
from eldata.manifest import verify
from eldata.raw.dng import write_dng
from eldata.records import Exposure, Sensor

SENSOR = Sensor(
    make="Acme",
    model="Nocturne 1",
    cfa=((0, 1), (3, 2)),
    black_level_dn=(512.0,) * 4,
    white_level_dn=16383.0,
    height=24,
    width=32,
)
CAMERA = CameraDescription(
    name="AcmeNocturne",
    models=("Nocturne 1",),
    raw_extension=".dng",
    isos=(100, 200, 400, 800, 1600, 3200, 6400),
    base_iso=100,
    shutter=Shutter.between("1/8000", "30", Fraction(1, 3)),
)
HOSTILE = (
    '</script><script>alert("x")</script>\'&<img src=https://evil.example/x.png onerror=alert(1)> | *_`\x1b[31m\u202e'
)
START = datetime(2026, 11, 21, 23, 50, 0)  # noqa: DTZ001 # a camera's clock; the shooting runs over midnight


@dataclass(frozen=True)
class Taken:
    """One press of the release: settings, when after the one before, which camera, and what the lens says."""

    iso: int
    exposure_s: Fraction
    pause_s: float = 3.0
    model: str = "Nocturne 1"
    f_number: Fraction | None = None


def plan_of(*metered: str, isos: Sequence[int] = (800, 1600, 3200), factors: Sequence[int] = (1, 10, 100, 200)) -> Plan:
    """A plan of scene-1, scene-2 ... with these metered times."""
    protocol = replace(RELEASED, noisy_isos=tuple(isos), low_light_factors=tuple(factors))
    return make_plan(CAMERA, protocol, {f"scene-{n}": Fraction(time) for n, time in enumerate(metered, 1)})


def hostile_plan() -> Plan:
    """Two scenes with notes that mean ill, and calibration frames."""
    calibration = plan_calibration(EXAMPLE, 100, (100, 800), Fraction(1, 2), bias_frames=4)
    plan = make_plan(EXAMPLE, RELEASED, {"scene-1": Fraction(2), "scene-2": Fraction(4)}, calibration)
    return plan.add_note("scene-1", "Bookshelf").add_note("scene-1", HOSTILE)


def as_planned(shots: Iterable[Shot]) -> list[Taken]:
    return [Taken(shot.iso, shot.setting.nominal_s) for shot in shots]


def whole_plan(plan: Plan) -> list[Taken]:
    """Every scene as planned, with pauses between scenes."""
    result: list[Taken] = []
    for scene in plan.scenes:
        first, *rest = as_planned(scene.shots)
        result += [replace(first, pause_s=240.0), *rest]
    return result + as_planned(() if plan.calibration is None else plan.calibration.shots)


@cache
def _mosaic(seed: int) -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    return np.random.default_rng(seed).integers(600, 15000, (SENSOR.height, SENSOR.width), dtype=np.uint16)


def shoot(
    folder: Path, taken: Iterable[Taken], *, times: bool = True, shuffle: int | None = None, day: int = 0
) -> list[Path]:
    """Write a file a press; return the files in order. Names count up, or say nothing at all (``shuffle``).

    The pixels of one day are on no card of another.
    """
    folder.mkdir(parents=True, exist_ok=True)
    presses = list(taken)
    numbers = np.arange(9989, 9989 + len(presses)) % 9999 + 1  # the counter turns over, from 9999 to 1
    if shuffle is not None:
        numbers = np.random.default_rng(shuffle).permutation(len(presses))
    now = START + timedelta(days=day)
    files = []
    for index, (press, number) in enumerate(zip(presses, numbers, strict=True)):
        now += timedelta(seconds=press.pause_s)
        path = folder / f"DSC{number:04d}.dng" if times else folder / f"DSC{index + 1}.dng"
        sensor = replace(SENSOR, model=press.model)
        exposure = Exposure(Fraction(press.iso), press.exposure_s, press.f_number)
        write_dng(path, _mosaic(1000 * day + index), sensor, exposure, taken=now if times else None)
        files.append(path)
    return files


def run_capture(*arguments: object, code: int = 0) -> str:
    """Run `capture` in this process, with this exit code; return what it printed."""
    printed = io.StringIO()
    with redirect_stdout(printed), redirect_stderr(printed):
        assert main([str(argument) for argument in arguments]) == code, printed.getvalue()
    return printed.getvalue()


class Nights:
    """A set that grows in a folder, and how each card is put into it by `capture manifest`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.data, self.csv = folder / "data" / "mine", folder / "manifests" / "mine.csv"

    def add(self, plan: Plan, *cards: Path, options: tuple[str, ...] = ("--append",), code: int = 0) -> str:
        plan.save(self.folder / "plan.json")
        command = ("manifest", self.folder / "plan.json", *cards, "-o", self.csv, "--copy-to", self.data)
        return run_capture(*command, "--jobs", "1", *options, code=code)

    def problems(self) -> list[str]:
        report = verify(self.csv, self.folder / "data", level="full")
        return [str(problem) for problem in report.problems]
