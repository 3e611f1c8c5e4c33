"""How often the acceptance test of a noise model is wrong, and what it finds. Run it by hand, with a word:

python -m tests.calibration.noise_check_study false-alarms [trials]   the camera's own further frames as the model
python -m tests.calibration.noise_check_study table                   models by checks, on the same frames
"""

from __future__ import annotations

import sys
from collections import Counter
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from eldata.base.tables import markdown_table
from eldata.calibration import BiasStack, ShadingFit, fixed_pattern
from eldata.datasets.synthetic.dark_frames import DarkFrames
from eldata.noise.model import NoiseModel
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.calibration.faults import NONE, Planted, drift, telegraph
from tests.calibration.in_memory import ISO
from tests.calibration.judged import Specimen, judged
from tests.calibration.simulation import Camera

SMALL = Camera(shape=(192, 288))
FAULTS = (NONE, drift(1.0), telegraph(0.01, 5.0))


def false_alarms(trials: int) -> None:
    """Print which statistics were off, in how many trials, and the largest share of one."""
    off: Counter[tuple[str, str]] = Counter()
    judgements = checks = alarmed = 0
    for trial in range(trials):
        fault = FAULTS[trial % len(FAULTS)]
        specimen = Specimen(SMALL, fault, seed=trial)
        found = judged(specimen, specimen, bias=8, flats=(60.0, 3000.0), seed=1000 + trial)
        # Flats are named by their level and tails by their threshold, which differ from trial to trial.
        off.update((one.check.split(" of ")[0], one.symbol.rstrip(" 0123456789DN-")) for one in found.off)
        judgements += len(found.statistics)
        checks += 1
        alarmed += bool(found.off)
    print(f"{sum(off.values())} of {judgements} verdicts off; {alarmed} of {checks} checks with any")
    for (check, symbol), times in off.most_common():
        print(f"{times:4} {check}: {symbol}")


def dark_frames(specimen: Specimen) -> NoiseModel:
    """Return the model that adds one of 40 other bias frames of the same body, from their DNG files."""
    with TemporaryDirectory() as folder:
        for number in range(40):
            mosaic = specimen.frame(0.0, np.random.default_rng([specimen.seed, 4, number]))
            path = Path(folder) / "Judged" / "bias" / f"ISO{ISO}" / f"IMG_{number:04d}.dng"
            path.parent.mkdir(parents=True, exist_ok=True)
            exposure = Exposure(Fraction(ISO), Fraction(1, 8000))
            write_dng(path, mosaic, specimen.camera.sensor, exposure)
        # Held frames are whole DN, as the camera's are; without a dither theirs is not added to them.
        frames = DarkFrames(folder, dither=False, keep=40)
        frames.crops(ISO, range(40), (0, 0, 2, 2))  # decodes all before the folder goes
    return NoiseModel("P*+D", dark_frames=frames)


def dark_shading(specimen: Specimen) -> NoiseModel:
    """Return the paper's model with the dark shading of 400 other bias frames of the same body."""
    stack = BiasStack(specimen.camera.cfa)
    for number in range(400):
        stack.add(specimen.frame(0.0, np.random.default_rng([specimen.seed, 5, number])))
    fit = ShadingFit()
    fit.add(ISO, fixed_pattern(stack), specimen.camera.sensor.black_level_dn, (0.0,) * 4)
    return NoiseModel("P*+G*+R+U+S", dark_shading=fit.shading("Judged", "400 bias frames"))


MODELS = (
    ("P-G", lambda _: NoiseModel("P+G")),
    ("the paper's", lambda _: NoiseModel()),
    ("dark frames, P*+D", dark_frames),
    ("shading + paper, P*+G*+R+U+S", dark_shading),
    ("its own further frames", lambda specimen: specimen),
)
"""Names and how each model is made for a specimen; add a line to have another one in the table."""


def table(camera: Camera = Camera(shape=(384, 576))) -> None:  # noqa: B008 # is frozen
    """Print how many statistics of each check each model misses, and then which."""
    rows, lists = [], []
    checks: dict[str, None] = {}
    for fault in FAULTS:
        specimen = Specimen(camera, fault)
        for name, made in MODELS:
            found = judged(made(specimen), specimen, bias=8, flats=(60.0, 3000.0))
            total = Counter(_check(one.check) for one in found.statistics)
            off = Counter(_check(one.check) for one in found.off)
            checks |= dict.fromkeys(total)
            rows.append((_words(fault), name, *(f"{off[check]} of {total[check]}" for check in checks)))
            lists.append(f"{_words(fault)}, {name}: " + "; ".join(f"{one.check}: {one.symbol}" for one in found.off))
    print(markdown_table(("camera", "model", *checks), rows, left=(0, 1)))
    print("\n".join(lists))


def _check(name: str) -> str:
    return "flats" if name.startswith("flats") else name


def _words(fault: Planted) -> str:
    return "as simulated" if fault is NONE else fault.name


if __name__ == "__main__":
    if sys.argv[1] == "table":
        table()
    else:
        false_alarms(int(sys.argv[2]) if len(sys.argv) > 2 else 100)
