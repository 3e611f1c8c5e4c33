"""A worker that iterates frames of 12 megapixels stays below 500 MB, however long it goes on."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.manifest.card import CameraCard, Card, save_card
from eldata.manifest.table import save_records
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord, Sensor
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

dataset = PairDataset(sys.argv[1], f"{sys.argv[1]}/big.csv")
peaks = []
for _ in range(4):
    for index in range(len(dataset)):
        dataset[index]
    peaks.append(peak_mb())
print(*peaks)
"""


@pytest.mark.memory
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_of_a_worker(tmp_path: Path) -> None:
    sensor = Sensor("eldata", "Big", ((0, 1), (3, 2)), (512.0,) * 4, 16383.0, *SIZE)
    generator = np.random.default_rng(0)
    records = []
    (tmp_path / "Big").mkdir()
    for number, seconds in enumerate((Fraction(1), Fraction(1, 100), Fraction(1, 100))):
        mosaic = (2000 + 50 * generator.standard_normal(SIZE, dtype=np.float32)).astype(np.uint16)
        path = f"{number}.dng"
        exposure = Exposure(Fraction(100), seconds, None)
        write_dng(tmp_path / "Big" / path, mosaic, sensor, exposure, compression="lossless-jpeg")
        noisy = number > 0
        records.append(
            FrameRecord(
                path=f"Big/{path}",
                role="noisy" if noisy else "reference",
                camera="Big",
                scene="scene-1",
                ratio=Fraction(100) if noisy else None,
                reference="Big/0.dng" if noisy else None,
            )
        )
    save_records(tmp_path / "big.csv", records)
    card = Card(
        name="big",
        title="Big frames",
        version="1",
        folder="big",
        citation="none",
        licence="CC0",
        homepage="none",
        cfa="bayer",
        cameras={"Big": CameraCard(("Big",))},
        counts={"reference": 1, "noisy": 2},
    )
    save_card(tmp_path / "big.json", card)
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(tmp_path)], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    peaks = [float(text) for text in done.stdout.split()]
    assert max(peaks) < 500
    assert peaks[-1] - peaks[0] < 10  # passes two to four add nothing
