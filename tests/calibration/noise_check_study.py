"""How often the acceptance test of a noise model is wrong: ``python -m tests.calibration.noise_check_study [trials]``.

The camera's own further frames are the model; docs/noise.md states what came of it.
"""

from __future__ import annotations

import sys
from collections import Counter

from tests.calibration.faults import NONE, drift, telegraph
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


if __name__ == "__main__":
    false_alarms(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
