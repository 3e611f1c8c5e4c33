from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy

from eldata.isp.libraw import render_libraw, sixteen_to_eight_bits
from eldata.raw.dng import write_dng
from tests.raw.helpers import (
    BAYER,
    EXPOSURE,
    NONA,
    QUAD,
    XTRANS,
    Cfa,
    add_tags,
    check_refused,
    levels_of,
    make_sensor,
    random_mosaic,
)
from tests.waiting import PATIENCE_S


def written(path: Path, cfa: Cfa = BAYER["RGGB"], height: int = 60, width: int = 64, **fields: Any) -> Path:
    sensor = make_sensor(cfa, height, width, black_level_dn=(512.0,) * levels_of(cfa), **fields)
    write_dng(path, random_mosaic(height, width), sensor, EXPOSURE)
    return path


@pytest.mark.parametrize(
    ("cfa", "height", "width"), [*((cfa, 60, 64) for cfa in BAYER.values()), (XTRANS["xtrans-15"], 516, 520)]
)
def test_it_is_the_published_call(cfa: Cfa, height: int, width: int, tmp_path: Path) -> None:
    path = written(tmp_path / "frame.dng", cfa, height, width)
    with rawpy.imread(str(path)) as raw:
        theirs = raw.postprocess(use_camera_wb=True, half_size=False, no_auto_bright=True, output_bps=16)
    eight = render_libraw(str(path))
    assert (eight.shape, str(eight.dtype)) == ((height, width, 3), "uint8")
    # The published code's way to 8 bits: share of the range, times 255, to the nearest.
    np.testing.assert_array_equal(eight, np.rint(np.float32(theirs / 65535.0) * 255.0))
    assert np.unique(eight).size > 100


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_it_is_never_turned(orientation: int, tmp_path: Path) -> None:
    """A prediction is as large as the mosaic, and so is what ``sid2018`` compares it with."""
    upright = render_libraw(written(tmp_path / "frame.dng"))
    add_tags(tmp_path / "frame.dng", (274, "H", 1, orientation, True))
    with rawpy.imread(str(tmp_path / "frame.dng")) as raw:
        assert raw.sizes.flip == {3: 3, 6: 6, 8: 5}[orientation]
    np.testing.assert_array_equal(render_libraw(tmp_path / "frame.dng"), upright)


def test_eight_bits_are_the_nearest_of_every_value() -> None:
    values = np.arange(65536, dtype=np.uint16)
    np.testing.assert_array_equal(sixteen_to_eight_bits(values), np.rint(255 * values.astype(np.float64) / 65535))


@pytest.mark.parametrize(
    ("cfa", "shape", "fields", "words"),
    [
        # LibRaw would demosaic them as other patterns, without a word, but for some phases of nona-Bayer.
        (QUAD["quad-00"], (528, 540), {}, "LibRaw does not demosaic quad-Bayer; pack it"),
        (NONA["nona-00"], (528, 540), {}, "LibRaw does not demosaic nona-Bayer; pack it"),
        (XTRANS["xtrans-00"], (510, 516), {}, "510 x 516 pixels: LibRaw does not demosaic X-Trans"),
        (BAYER["RGGB"], (60, 64), {"white_balance": None}, "no as-shot white balance"),
        (BAYER["RGGB"], (60, 64), {"xyz_to_camera": None}, "no colour matrix"),
    ],
)
def test_what_libraw_would_make_up_is_refused(
    cfa: Cfa, shape: tuple[int, int], fields: dict[str, Any], words: str, tmp_path: Path
) -> None:
    check_refused(written(tmp_path / "frame.dng", cfa, *shape, **fields), words, render_libraw)


FORKED = """
import os, sys
import rawpy
from eldata.isp.libraw import render_libraw

with rawpy.imread(sys.argv[1]) as raw:
    raw.postprocess()  # on OpenMP threads, for which a forked child would wait for ever
first = render_libraw(sys.argv[1])
child = os.fork()
if child == 0:
    os._exit(0 if (render_libraw(sys.argv[1]) == first).all() else 3)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_a_forked_child_reads_and_renders_after_its_parent(tmp_path: Path) -> None:
    path = written(tmp_path / "frame.dng")
    command = [sys.executable, "-c", FORKED, str(path)]
    several = {**os.environ, "OMP_NUM_THREADS": "4"}  # with one thread there is no pool to wait for
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, env=several)
    assert (done.returncode, done.stderr) == (0, "")
