"""Reading in forked and spawned workers and in threads.

rawpy's own development runs on OpenMP threads. Once a process has used them, a forked child waits for threads
that it does not have. Each script runs in a process of its own under a time limit, so that a hang fails its
test and leaves nothing behind.
"""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import eldata.errors
from eldata.raw import read_raw, write_dng
from tests.raw.helpers import BAYER, EXPOSURE, make_sensor, random_mosaic, xtrans_at
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from eldata.records import RawFrame

# The child reads, then develops with rawpy in the same thread: without the package's guard that never ends.
FORK_SCRIPT = """
import multiprocessing, os, sys
import rawpy
from eldata.raw import read_header, read_raw

path = sys.argv[1]
expected = read_raw(path).mosaic if sys.argv[2] == "read before" else None

with rawpy.imread(path) as raw:
    developed = raw.postprocess()

def child():
    frame = read_raw(path)
    read_header(path)
    if expected is not None and not (frame.mosaic == expected).all():
        os._exit(3)
    with rawpy.RawPy() as raw:
        raw.open_file(path)
        raw.unpack()
        same = (raw.postprocess() == developed).all()
    os._exit(0 if same else 4)

process = multiprocessing.get_context("fork").Process(target=child)
process.start()
process.join(250)
print("exit code", process.exitcode)
process.kill()
process.join()
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("raws")
    cfas = [*BAYER.values(), xtrans_at(0, 0), xtrans_at(4, 1)]
    for number, cfa in enumerate(cfas):
        write_dng(
            folder / f"{number}.dng",
            random_mosaic(240, 252, seed=number),
            make_sensor(cfa, 240, 252),
            EXPOSURE,
            compression="lossless-jpeg" if number % 2 else "none",
        )
    return sorted(folder.iterdir())


def run_script(folder: Path, script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    (folder / "script.py").write_text(script)
    package = str(Path(eldata.errors.__file__).parents[1])
    return subprocess.run(
        [sys.executable, str(folder / "script.py"), *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        # More than one OpenMP thread whatever the machine: with one there is no pool to wait for.
        env={**os.environ, "PYTHONPATH": package, "OMP_NUM_THREADS": "4"},
    )


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.parametrize("before", ["read before", "not read before"])
def test_a_forked_child_of_a_process_that_has_developed(before: str, files: list[Path], tmp_path: Path) -> None:
    done = run_script(tmp_path, FORK_SCRIPT, str(files[1]), before)
    assert done.stdout.strip() == "exit code 0", done.stderr


def test_eight_threads_read_what_one_reads(files: list[Path]) -> None:
    serial = [read_raw(path) for path in files]
    with ThreadPoolExecutor(8) as pool:
        frames: list[RawFrame] = list(pool.map(read_raw, files * 10))
    for number, frame in enumerate(frames):
        expected = serial[number % len(files)]
        assert frame.path == expected.path
        assert frame.sensor == expected.sensor
        assert frame.exposure == expected.exposure
        np.testing.assert_array_equal(frame.mosaic, expected.mosaic)
