"""`capture check` of each pair: its ratio, and the row that says so."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest

from capture.check import check
from capture.check.frames import empty_share
from capture.check.result import (
    BEST_PSNR_DB,
    LIGHT_AGAIN,
    LIGHT_LOOK,
    LOOK_DB,
    SHIFT_AGAIN_PX,
    SHIFT_LOOK_PX,
)
from capture.cli import main
from eldata.records import Exposure
from tests.capture.planted_faults import twelve_bits
from tests.capture.simulated_scenes import Shot, write_scenes

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from capture.check import CheckedGroup
    from tests.capture.planted_faults import Digital

FEW = (1, 2, 4, 6, 14, 15, 16)  # references, and noisy frames at x1 and x100 of ISO 800, x100 and x200 of ISO 3200


def group_of(folder: Path, mishaps: dict[int, Callable[[Shot], Shot]], digital: Digital | None = None) -> CheckedGroup:
    """Check scene 2; ``digital`` is what the camera does to the raw values of all but its references."""
    named = {(2, number): mishap for number, mishap in mishaps.items()}
    references = (1, 6, 11, 16)
    manifest = write_scenes(
        folder,
        named,
        scenes=(2,),
        ids=FEW,
        digital=lambda _, number, dn: dn if digital is None or number in references else digital(dn),
    )
    (group,) = check(manifest, folder / "data").groups
    return group


def pair(group: CheckedGroup, number: int) -> str:
    (found,) = (path for path in group.pairs if path.endswith(f"{number:04d}.dng"))
    return found


def perfect_score_db(*, light: float = 0.0, shift_px: float = 0.0) -> float:
    """PSNR of a perfect denoiser, as docs/capture.md derives it: an rms of 0.3 and a slope of 0.01 per pixel."""
    error = (light * 0.3) ** 2 + (shift_px * 0.01) ** 2
    return -10 * math.log10(error) if error > 0 else math.inf


def test_the_limits_are_those_of_a_perfect_denoiser() -> None:
    """Light and shift cost the same at their limits; a fault ten decibels below the best takes 0.4 dB off it."""
    assert perfect_score_db(light=LIGHT_AGAIN) == pytest.approx(BEST_PSNR_DB)
    assert perfect_score_db(shift_px=SHIFT_AGAIN_PX) == pytest.approx(BEST_PSNR_DB)
    assert perfect_score_db(light=LIGHT_LOOK) == pytest.approx(LOOK_DB)
    assert perfect_score_db(shift_px=SHIFT_LOOK_PX) == pytest.approx(LOOK_DB)
    both = perfect_score_db(light=LIGHT_AGAIN, shift_px=SHIFT_AGAIN_PX)
    assert both == pytest.approx(BEST_PSNR_DB - 10 * math.log10(2))
    assert perfect_score_db() == math.inf


@pytest.mark.parametrize(
    ("light", "verdict"),
    [(1.01, "look"), (2 ** (-1 / 6), "shoot again")],
)
def test_light_in_a_noisy_frame_alone_counts_as_it_does_between_references(
    tmp_path: Path, light: float, verdict: str
) -> None:
    group = group_of(tmp_path, {2: lambda shot: shot.lit(light)})
    assert group.verdict_of(pair(group, 2)) == verdict
    assert group.row(pair(group, 2))["ratio"].value == pytest.approx(1 / light, rel=0.002)


def as_dialled(shot: Shot) -> Shot:
    """EXIF has the names of a shutter's times, 30 s and 1/25 s, which are 32 s and 2^(-14/3) s; 4 s stand for 32 s."""
    if shot.iso == 100:
        return replace(shot, exif=Exposure(Fraction(100), Fraction(30)))
    given_s = Fraction(2 ** (-14 / 3) * 4 / 32).limit_denominator(10**6)
    return replace(shot, exif=Exposure(Fraction(shot.iso), Fraction(1, 25)), exposure_s=given_s)


def test_a_ratio_that_exif_rounds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """EXIF's 93.75 where the pixels show 101.59: somebody has to look."""
    write_scenes(tmp_path, {(2, n): as_dialled for n in (1, 4, 6, 16)}, scenes=(2,), ids=(1, 4, 6, 16))
    csv, out, sheet = tmp_path / "manifests" / "my.csv", tmp_path / "check.json", tmp_path / "sheet.html"
    arguments = ["check", str(csv), "--root", str(tmp_path / "data"), "--json", str(out)]
    assert main([*arguments, "--sheet", str(sheet)]) == 1
    assert "EXIF has the rounded names of the shutter's times" in capsys.readouterr().out
    assert "1 pairs" in sheet.read_text()
    (row,) = json.loads(out.read_text())["groups"][0]["pairs"]
    assert row["verdict"] == "look"
    found = row["measured"]["EXIF ratio"]
    assert found["value"] == pytest.approx(101.59, abs=5 * found["standard_error"])
    assert found["standard_error"] < 0.5


def test_a_camera_that_leaves_bits_out(tmp_path: Path) -> None:
    """12 bits in a file of 14."""
    group = group_of(tmp_path, {}, twelve_bits)
    for one in group.pairs:
        found = group.row(one)["gaps"]
        assert found.verdict == "shoot again"
        assert found.deviation > 70
        assert {measure.name for measure in group.row(one).values() if measure.verdict != "keep"} == {"gaps"}


def test_gaps_of_values_by_their_share() -> None:
    """White noise of 8 DN, of 200,000 pixels: no gap as it is, a half of the values without the lowest bit."""
    mosaic = np.rint(np.random.default_rng(5).normal(512, 8, (400, 500))).astype(np.uint16)
    assert empty_share(mosaic) == 0
    assert empty_share(mosaic // 2 * 2) == pytest.approx(0.5, abs=0.05)
    assert empty_share(np.full((8, 8), 512, np.uint16)) == 0
    # Nine tenths at one value, the others far apart below it: what does not occur between them is no gap.
    mosaic = np.random.default_rng(6).integers(600, 12_000, (400, 500)).astype(np.uint16)
    mosaic[:, :450] = 16383
    assert empty_share(mosaic) == 0
