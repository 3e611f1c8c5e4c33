"""Strangers' predictions: each that asks for too much is refused by name, and costs neither memory nor other files."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import zlib
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldata.base.arrays import NpyError, decode_png, read_npy_header
from tests.evaluation import hostile_predictions as hostile
from tests.evaluation.prediction_files import LARGE, SMALL, write_awkward
from tests.waiting import PATIENCE_S

MOST_KIB = 32 << 10
"""More than a frame of 25 kB and what libraries allocate once, far less than the 64 MiB that each bomb expands to."""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What became of each prediction, in a process of its own."""
    folder = tmp_path_factory.mktemp("hostile")
    names = hostile.write_all(folder)
    command = [sys.executable, "-m", "tests.evaluation.hostile_predictions", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr[-2000:]  # the last name is the file that it ended with
    found: dict[str, Any] = json.loads(done.stdout)
    assert sorted(found["outcomes"]) == names
    return found


def test_every_one_is_refused_in_one_line(outcomes: dict[str, Any]) -> None:
    assert len(outcomes["outcomes"]) > 70
    for name, outcome in outcomes["outcomes"].items():
        assert outcome.startswith("refused: "), f"{name}: {outcome}"
        assert outcome.isprintable(), name
        assert 25 < len(outcome) < 300, outcome


def test_none_takes_memory_to_speak_of(outcomes: dict[str, Any]) -> None:
    assert outcomes["peak_kib"] - outcomes["before_kib"] < MOST_KIB


def test_no_other_file_is_shown(outcomes: dict[str, Any]) -> None:
    assert hostile.ELSEWHERE not in json.dumps(outcomes)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("shape-of-terabytes.npy", ["(4, 32, 48) (packed) or (64, 96) (mosaic)", "found (4, 1000000, 1000000)"]),
        ("type-of-records.npy", ["not a .npy file of numbers", "write it again"]),
        ("right-shape-and-one-byte-less.npy", ["declares 24576 bytes of values and has 24575", "write it again"]),
        ("named-pipe.npy", ["is a pipe, device or socket, not a file"]),
        ("link-to-a-device.h5", ["is a pipe, device or socket, not a file"]),
        ("folder.tif", ["is a folder, not a file"]),
        ("bomb-after-the-array.npz", ["declares 24576 bytes of values and has 67108864: were bytes inserted?"]),
        ("fill-values-of-gigabytes.h5", ["found (4, 30000, 30000)", "whole frame"]),
        ("right-shape-half-written.h5", ["2 of its 4 chunks were written"]),
        ("external-link.h5", ["expected one array, or one called 'prediction'; found none"]),
        ("external-storage.h5", ["lie in other files"]),
        ("virtual.h5", ["lie in other files"]),
        ("checksum.h5", ["filter returned failure"]),
        ("30000-by-30000.png", ["found (30000, 30000)"]),
        ("30000-by-30000.tif", ["found (30000, 30000)"]),
        ("strips-missing.tif", ["strips or tiles are missing"]),
        ("no-pages.tif", ["holds no image"]),
    ],
)
def test_what_is_wrong_is_said(name: str, words: list[str], outcomes: dict[str, Any]) -> None:
    for word in words:
        assert word in outcomes["outcomes"][name]


# --- what is odd and good ---------------------------------------------------------------------------------------------


def test_what_is_not_pixels_is_passed_over(tmp_path: Path) -> None:
    """Compressed text that libpng would expand, and a gamma and a profile, which change no sample."""
    text = hostile.chunk(b"zTXt", b"Comment\0\0" + zlib.compress(bytes(7 << 20), 9))
    gamma = hostile.chunk(b"gAMA", (45455).to_bytes(4, "big"))
    path = tmp_path / "x.png"
    path.write_bytes(hostile.png(hostile.header(), gamma, *[text] * 50, hostile.PIXELS))
    assert np.array_equal(decode_png(path.read_bytes()), hostile.grey())


# --- headers ----------------------------------------------------------------------------------------------------------


def test_headers_that_numpy_writes(tmp_path: Path) -> None:
    kinds = ("<f4", ">f8", "<u2", "|b1", "|u1", "<c16")
    for kind, shape, order in product(kinds, [(), (0,), (5,), (4, 32, 48), (1,) * 12], "CF"):
        array = np.zeros(shape, kind, order=order)  # type: ignore[call-overload] # of either order
        np.save(tmp_path / "x.npy", array)
        with (tmp_path / "x.npy").open("rb") as file:
            header = read_npy_header(file)
            assert (header.shape, header.values) == (shape, array.dtype.name)
            assert file.tell() == (tmp_path / "x.npy").stat().st_size - array.nbytes


def test_a_changed_header_is_an_error_or_a_header() -> None:
    """5,000 trials with up to three changed bytes."""
    generator = np.random.default_rng(9)
    whole = hostile.npy(hostile.described(str(hostile.PACKED)))
    read = 0
    for _ in range(5000):
        content = bytearray(whole)
        for place in generator.integers(0, len(content), generator.integers(1, 4)):
            content[place] = generator.integers(0, 256)
        with suppress(NpyError):
            read_npy_header(io.BytesIO(content))
            read += 1
    assert 0 < read < 4000


# --- memory -----------------------------------------------------------------------------------------------------------


@pytest.mark.memory
@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak of a process is not told here")
def test_a_prediction_takes_less_than_three_times_its_array(tmp_path: Path) -> None:
    """The array as it is loaded; a mosaic is packed into another, so twice is the least."""
    for name, size in (("small", SMALL), ("large", LARGE)):
        write_awkward(tmp_path / name, size)
    command = [sys.executable, "-m", "tests.evaluation.prediction_files", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr[-2000:]
    for name, times in json.loads(done.stdout).items():
        assert 1.9 < times < 3, name
