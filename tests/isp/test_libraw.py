from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rawpy

from eldata.errors import RawFileError
from eldata.isp.libraw import render_libraw, sixteen_to_eight_bits
from eldata.raw.dng import write_dng
from tests.raw.helpers import BAYER, EXPOSURE, NONA, QUAD, XTRANS, add_tags, levels_of, make_sensor, random_mosaic
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from tests.raw.helpers import Cfa


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


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "frame.dng")
    path.write_bytes(path.read_bytes()[:-3000])
    with pytest.raises(RawFileError, match=r"frame\.dng: .*truncated"):
        render_libraw(path)


@pytest.mark.parametrize("cfa", [QUAD["quad-00"], NONA["nona-00"]], ids=["quad-Bayer", "nona-Bayer"])
def test_blocks_of_one_colour_are_refused(cfa: Cfa, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """LibRaw would demosaic them as other patterns, without a word, but for some phases of nona-Bayer."""
    path = written(tmp_path / "frame.dng", cfa, 528, 540)
    with rawpy.imread(str(path)) as raw:
        assert raw.postprocess(use_camera_wb=True).shape == (528, 540, 3)  # the trap is set
    with pytest.raises(
        RawFileError, match=rf"frame\.dng: LibRaw does not demosaic {request.node.callspec.id}; pack it"
    ):
        render_libraw(path)


@pytest.mark.parametrize(
    ("field", "words"), [("white_balance", "no as-shot white balance"), ("xyz_to_camera", "no colour matrix")]
)
def test_a_file_without_colour_is_refused(field: str, words: str, tmp_path: Path) -> None:
    fields: dict[str, Any] = {field: None}
    path = written(tmp_path / "frame.dng", **fields)
    with pytest.raises(RawFileError, match=words):
        render_libraw(path)


def test_x_trans_that_libraw_cannot_demosaic_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "small.dng", XTRANS["xtrans-00"], 510, 516)
    with pytest.raises(RawFileError, match="510 x 516 pixels: LibRaw does not demosaic X-Trans"):
        render_libraw(path)


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
