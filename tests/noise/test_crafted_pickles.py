"""Parameter files made to crash, stall or fill the memory of whoever unpickles them are refused by name."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.errors import ProfileError
from eldata.noise import profiles_from_published, read_published
from tests.noise.crafted_pickles import CRAFTED, file_of, good_file
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path

HARMLESS = {
    "array-state-of-another-version",
    "frame-of-gigabytes",
    "keys-of-one-hash",
    "memo-index-negative",
    "memo-index-of-gigabytes",
    "the-same-text-encoded-many-times",
}
"""What unpicklers reserve or waste is of no consequence here, and the content is plain."""
MOST_KIB = 300 << 10


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What became of each, in a process of its own."""
    folder = tmp_path_factory.mktemp("crafted")
    for name, pickled in CRAFTED.items():
        (folder / f"{name}.npy").write_bytes(file_of(pickled))
    command = [sys.executable, "-m", "tests.noise.crafted_pickles", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr[-2000:]
    outcomes: dict[str, Any] = json.loads(done.stdout)
    return outcomes


def test_each_is_refused_or_harmless(found: dict[str, Any]) -> None:
    outcomes = found["outcomes"]
    assert outcomes.keys() == CRAFTED.keys()
    assert len(CRAFTED) > 90
    for name, outcome in outcomes.items():
        if name in HARMLESS:
            assert outcome.startswith("read ['"), f"{name}: {outcome}"
        else:
            assert outcome.startswith("ProfileError: "), f"{name}: {outcome}"
            assert f"{name}.npy: is not a published parameter file (" in outcome
            assert outcome.endswith("; none of it was run")
            assert outcome.isprintable()
            assert len(outcome) < 500


def test_none_takes_memory_to_speak_of(found: dict[str, Any]) -> None:
    assert found["peak_kib"] < MOST_KIB  # the libraries take a third of it


@pytest.mark.parametrize("protocol", [0, 2, 5])
def test_a_changed_file_is_read_or_an_error(protocol: int, tmp_path: Path) -> None:
    """500 trials each with up to four changed bytes; what is read still makes profiles or an error."""
    generator = np.random.default_rng(protocol)
    good = good_file(protocol)
    path = tmp_path / "Camera_params.npy"
    outcomes = {"read": 0, "refused": 0}
    for _ in range(500):
        content = bytearray(good)
        for place in generator.integers(100, len(content), generator.integers(1, 5)):
            content[place] = generator.integers(0, 256)
        path.write_bytes(content)
        try:
            profiles_from_published("Camera", read_published(path))
            outcomes["read"] += 1
        except ProfileError as error:
            outcomes["refused"] += str(error).isprintable()
    assert sum(outcomes.values()) == 500
    assert min(outcomes.values()) > 5


def test_an_endless_file_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "Camera_params.npy"
    with path.open("wb") as file:
        file.write(file_of(b"\x80\x04"))
        file.truncate(1 << 40)  # without taking room on the disk
    with pytest.raises(ProfileError, match="it has more than 1048576 bytes"):
        read_published(path)


def test_a_named_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "Camera_params.npy")
    with pytest.raises(ProfileError, match=r"Camera_params\.npy: is a named pipe, not a file"):
        read_published(tmp_path / "Camera_params.npy")


def test_more_rows_than_isos_are_an_error() -> None:
    data = {"Kmin": 1.0, "Kmax": 64.0, "G_shape": [0.1] * 3000, "color_bias": [[0.0] * 4] * 3000, "Profile-1": {}}
    with pytest.raises(ProfileError, match="is not a published parameter dictionary"):
        profiles_from_published("Camera", data)


PYTHON_2 = (
    b"cnumpy.core.multiarray\n_reconstruct\np0\n(cnumpy\nndarray\np1\n(I0\ntp2\nS'b'\np3\ntp4\nRp5\n(I1\n(tcnumpy\n"
    b"dtype\np6\n(S'O8'\np7\nI0\nI1\ntp8\nRp9\n(I3\nS'|'\np10\nNNNI-1\nI-1\nI63\ntp11\nbI00\n(lp12\n(dp13\n"
    b"S'yes'\np14\nI01\nsS'Kmin'\np15\ncnumpy.core.multiarray\nscalar\np16\n(g6\n(S'f8'\np17\nI0\nI1\ntp18\nRp19\n"
    b"(I3\nS'<'\np20\nNNNI-1\nI-1\nI0\ntp21\nbS'\\x00\\x00\\x00\\x00\\x00\\x00\\xd0?'\np22\ntp23\nRp24\nsS'long'\np25\n"
    b"I1099511627776\nsatp26\nb."
)


def test_what_numpy_wrote_on_python_2(tmp_path: Path) -> None:
    """Protocol 0, in which bytes are quoted text, as numpy 1.16 pickles it on Python 2.7."""
    path = tmp_path / "Camera_params.npy"
    path.write_bytes(file_of(PYTHON_2))
    assert read_published(path) == {"Kmin": 0.25, "yes": True, "long": 2**40}
