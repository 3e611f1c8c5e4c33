"""Kernels without a place to keep them: a package and a HOME that cannot be written, as in containers and services."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import eldata
from eldata.base import compiled
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Iterator

# What computes: each step in one process, since all kernels are compiled again.
SCRIPT = """
import sys
from pathlib import Path
from eldata import ELDDataset, SyntheticPairs
from eldata.cli.main import main
from eldata.datasets import CleanFrames
from eldata.demo.calibration_frames import make_calibration_frames

top = Path(sys.argv[1])
table, data = top / "demo" / "manifests" / "eld-demo.csv", top / "demo" / "data"
make_calibration_frames(top, isos=(1600,), bias_frames=4, flat_levels=3, size=(64, 96))
own = ["--manifest", table, "--root", data, "--jobs", 1]
for command in (
    ["demo", top / "demo", "--scenes", 1, "--jobs", 1],
    ["verify", table, "--root", data, "--level", "full", "--jobs", 1],
    ["evaluate", top / "demo" / "predictions" / "dct", *own, "--html", top / "page.html"],
    ["calibrate", top / "data" / "calibration", "-o", top / "camera.json", "--html", top / "camera.html", "--jobs", 1],
):
    assert main(list(map(str, command))) <= (command[0] == "calibrate"), command  # which has findings of so few frames
pairs = ELDDataset(data / "ELD-demo", manifest=table)
assert pairs[0]["input"].shape == (4, 256, 384)
references = [data / "ELD-demo" / pairs.records[0].reference]
assert SyntheticPairs(CleanFrames(references), "SonyA7S2", crop=16)[0]["input"].shape == (4, 16, 16)
"""


def test_a_kernel_that_cannot_be_kept_is_compiled(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As numba finds no folder for code of no file; it is said once."""
    monkeypatch.setenv(compiled._REPORTED, "")
    monkeypatch.delenv(compiled._REPORTED)
    names: dict[str, Any] = {}
    exec(compile("def add(a, b): return a + b\ndef less(a, b): return a - b", "<nowhere>", "exec"), names)  # noqa: S102
    assert (compiled.kernel(names["add"])(2, 1), compiled.kernel(names["less"])(2, 1)) == (3, 1)
    (said,) = caplog.messages
    assert "NUMBA_CACHE_DIR" in said


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user may write to, and reach: pytest's own is for one user."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o777)
        yield Path(name)
        for path in Path(name).rglob("*/"):
            path.chmod(0o755)  # or only root could remove it


def as_another_user() -> list[str]:
    """What begins a command that root gives, which may write everywhere; it keeps the right to read an interpreter."""
    if os.geteuid() != 0:
        return []
    right = "+dac_read_search"
    other = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", f"--inh-caps={right}"]
    other.append(f"--ambient-caps={right}")
    if shutil.which("setpriv") is None or subprocess.run([*other, "true"], check=False).returncode:
        pytest.skip("root may not become another user here")
    return other


@pytest.mark.study
@pytest.mark.skipif(sys.platform != "linux", reason="changes the user as Linux does")
def test_all_that_computes_runs_where_nothing_can_be_kept(open_folder: Path) -> None:
    """By another user, over a copy that is read-only, without a HOME."""
    copied, out = open_folder / "copy", open_folder / "out"
    for name in ("eldata", "manifests"):
        shutil.copytree(Path(eldata.__file__).parents[1] / name, copied / name, ignore=shutil.ignore_patterns("__pyc*"))
    for path in (copied, *copied.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    out.mkdir()
    out.chmod(0o777)
    command = [*as_another_user(), sys.executable, "-c", SCRIPT, str(out)]
    environment = {"PATH": os.environ["PATH"], "HOME": "/nonexistent", "PYTHONPATH": str(copied)}
    ran = subprocess.run(
        command, cwd=out, env=environment, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr.count("NUMBA_CACHE_DIR") == 1
