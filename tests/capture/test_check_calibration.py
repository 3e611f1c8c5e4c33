"""`capture check` on bias frames and flats: leaks, saturation, unevenness and unequal pairs are found, no more."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.check import CheckedGroup, check
from capture.cli import main
from eldata.demo.calibration_frames import make_calibration_frames
from eldata.manifest import load_manifest
from eldata.raw import read_raw, write_dng
from tests.capture.test_check import named

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.manifest import Manifest

SIZE = (256, 384)


@dataclass(frozen=True, slots=True)
class Set:
    """Calibration frames of ISO 1600: six bias frames, IMG_0001 to 0006, and three pairs of flats, to 0012."""

    folder: Path
    manifest: Manifest

    def change(self, number: int, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        role = "bias" if number <= 6 else "flat"
        path = self.folder / "data" / "calibration" / "DemoGamma" / role / "ISO1600" / f"IMG_{number:04d}.dng"
        frame = read_raw(path)
        mosaic = np.clip(np.rint(change(frame.mosaic.astype(np.float64))), 0, frame.sensor.white_level_dn)
        write_dng(path, mosaic.astype(np.uint16), frame.sensor, frame.exposure, compression="none")

    def check(self) -> tuple[CheckedGroup, CheckedGroup]:
        bias, flat = check(self.manifest, self.folder / "data").groups
        assert (bias.name, flat.name) == ("DemoGamma bias ISO 1600", "DemoGamma flat ISO 1600")
        return bias, flat


def made(folder: Path, seed: int = 4, isos: tuple[int, ...] = (1600,)) -> Manifest:
    return make_calibration_frames(folder, isos=isos, bias_frames=6, flat_levels=3, size=SIZE, seed=seed)


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("frames")
    made(folder)
    return folder


@pytest.fixture
def frames(pristine: Path, tmp_path: Path) -> Set:
    shutil.copytree(pristine, tmp_path, dirs_exist_ok=True)
    return Set(tmp_path, load_manifest(tmp_path / "manifests" / "calibration-demo.csv"))


@pytest.mark.study
def test_nothing_is_found_on_clean_frames(tmp_path: Path) -> None:
    """Fixed pattern, hot pixels, shading and vignetting of the demo's camera included; five ISOs."""
    manifest = made(tmp_path, seed=0, isos=(100, 400, 1600, 6400, 25600))
    report = check(manifest, tmp_path / "data")
    assert [str(reason) for group in report.groups for reason in group.reasons] == []
    assert [group.verdict for group in report.groups] == ["keep"] * 10
    assert main(["check", str(manifest.path), "--root", str(tmp_path / "data"), "--jobs", "1"]) == 0


def test_a_light_leak_in_one_corner(frames: Set) -> None:
    down, right = np.ogrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    frames.change(3, lambda dn: dn + 3 * np.exp(-((down + 1) ** 2 + (right - 1) ** 2) / 0.5))
    bias, flat = frames.check()
    assert ("leak", 3) in named(bias)
    assert {number for _, number in named(bias)} == {3}
    assert bias.verdict == "shoot again"
    assert "top right" in bias.format_text()
    assert flat.verdict == "keep"


@pytest.mark.parametrize(
    ("numbers", "change", "name", "verdict"),
    [
        pytest.param(range(1, 7), lambda dn: np.maximum(dn - 512, 0), "black", "shoot again", id="clipped black"),
        pytest.param(
            range(1, 7), lambda dn: dn + 12 * np.linspace(0, 1, SIZE[0])[:, None], "shading", "look", id="a leak in all"
        ),
        pytest.param((5,), lambda dn: dn + 4, "level", "shoot again", id="a leak over the whole frame"),
        pytest.param((11, 12), lambda dn: dn * 1.6, "saturation", "shoot again", id="saturated flats"),
        pytest.param(
            range(7, 13), lambda dn: 512 + (dn - 512) * np.linspace(0.3, 1, SIZE[1]), "evenness", "look", id="uneven"
        ),
        pytest.param((10,), lambda dn: 512 + (dn - 512) * 1.08, "pair", "shoot again", id="an unequal pair"),
    ],
)
def test_what_is_found(
    frames: Set,
    numbers: Sequence[int],
    change: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    name: str,
    verdict: str,
) -> None:
    """It, and nothing else, in the frames that have it."""
    for number in numbers:
        frames.change(number, change)
    group = frames.check()[numbers[0] > 6]
    assert named(group) == {(name, 0 if name == "shading" else number) for number in numbers}
    assert group.verdict == verdict
    for pair in (one for one in group.measures if one.name == name == "pair" and one.path.endswith("0010.dng")):
        assert pair.value == pytest.approx(8, abs=0.5)


def test_a_flat_without_a_partner(frames: Set) -> None:
    path = "data/calibration/DemoGamma/flat/ISO1600/IMG_0012.dng"
    frame = read_raw(frames.folder / path)
    exposure = type(frame.exposure)(frame.exposure.iso, Fraction(3), frame.exposure.f_number)
    write_dng(frames.folder / path, frame.mosaic, frame.sensor, exposure, compression="none")
    _, flat = frames.check()
    assert flat.verdict == "look"
    assert flat.format_text().count("has no partner") == 2


def test_what_cannot_be_compared(frames: Set) -> None:
    """One bias frame alone, and a pair of flats without light."""
    for number in (11, 12):
        frames.change(number, lambda dn: 512 + (dn - 512) / 1000)
    few = [record for record in frames.manifest.records if record.path.endswith(("01.dng", "11.dng", "12.dng"))]
    bias, flat = check(replace(frames.manifest, records=tuple(few)), frames.folder / "data").groups
    assert "IMG_0001.dng: is the only bias frame of this ISO" in bias.format_text()
    assert "IMG_0012.dng: too dark, or too much of it saturated, to compare it with its partner" in flat.format_text()
    assert bias.verdict == flat.verdict == "look"
