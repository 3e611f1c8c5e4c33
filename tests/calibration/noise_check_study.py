"""How often the acceptance test of a noise model is wrong, and what it finds. Run it by hand, with a word:

python -m tests.calibration.noise_check_study false-alarms [trials]   the camera's own further frames as the model
python -m tests.calibration.noise_check_study table                   models by checks, on the same frames
"""

from __future__ import annotations

import sys
from collections import Counter

from eldata.base.tables import markdown_table
from eldata.noise.model import NoiseModel
from tests.calibration.faults import NONE, Planted, drift, telegraph
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


def table(camera: Camera = Camera(shape=(384, 576))) -> None:  # noqa: B008 # is frozen
    """Print which checks each model misses."""
    rows = []
    for fault in FAULTS:
        specimen = Specimen(camera, fault)
        for name, model in (
            ("P-G", NoiseModel("P+G")),
            ("the paper's", NoiseModel()),
            ("its own further frames", specimen),
        ):
            found = judged(model, specimen, bias=8, flats=(60.0, 3000.0))
            rows.append((_words(fault), name, "; ".join(f"{one.check}: {one.symbol}" for one in found.off) or "none"))
    print(markdown_table(("camera", "model", "misses"), rows, left=(0, 1, 2)))


def _words(fault: Planted) -> str:
    return "as simulated" if fault is NONE else fault.name


if __name__ == "__main__":
    if sys.argv[1] == "table":
        table()
    else:
        false_alarms(int(sys.argv[2]) if len(sys.argv) > 2 else 100)
