"""A worker that iterates frames of 12 megapixels stays below 500 MB, however long it goes on."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.manifest.catalogue import save_manifest
from eldata.manifest.own import sort_own_set
from eldata.raw.dng import write_dng
from eldata.records import Exposure, Sensor
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path

SIZE = (2832, 4240)
CODE = """
import sys
from eldata.datasets import PairDataset

def peak_mb():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))

dataset = PairDataset(sys.argv[1], f"{sys.argv[1]}.csv")
peaks = []
for _ in range(4):
    for index in range(len(dataset)):
        dataset[index]
    peaks.append(peak_mb())
print(len(dataset), *peaks)
"""


@pytest.mark.memory
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_of_a_worker(tmp_path: Path) -> None:
    sensor = Sensor("eldata", "Big", ((0, 1), (3, 2)), (512.0,) * 4, 16383.0, *SIZE)
    generator = np.random.default_rng(0)
    (tmp_path / "big" / "hall").mkdir(parents=True)
    for number, seconds in enumerate((Fraction(1), Fraction(1, 100), Fraction(1, 100))):
        mosaic = (2000 + 50 * generator.standard_normal(SIZE, dtype=np.float32)).astype(np.uint16)
        exposure = Exposure(Fraction(100), seconds)
        write_dng(tmp_path / "big" / "hall" / f"{number}.dng", mosaic, sensor, exposure, compression="lossless-jpeg")
    own = sort_own_set(tmp_path / "big", "big")
    save_manifest(tmp_path / "big.csv", own.card, own.records)
    command = [sys.executable, "-c", CODE, str(tmp_path / "big")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    pairs, *peaks = (float(text) for text in done.stdout.split())
    assert pairs == 2
    assert max(peaks) < 500
    assert peaks[-1] - peaks[0] < 10  # passes two to four add nothing
