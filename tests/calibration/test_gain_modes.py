"""The calibration of a camera that switches its conversion gain, with the figures of the A7S2 that PMN published."""

from __future__ import annotations

import math
import re
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.calibration import calibrate
from eldata.calibration.camera import joined
from eldata.calibration.joint import fit_log_log, gain_steps
from eldata.errors import ArgumentError
from eldata.noise import CameraProfile
from eldata.reports.calibration_joint import joint_plots
from tests.calibration.simulation import Camera
from tests.calibration.trees import made_tree
from tests.reports.calibrations import measured

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.calibration.iso_results import IsoCalibration
    from eldata.calibration.results import Calibration
    from eldata.noise import NoiseParameters

ISOS = (200, 400, 800, 1600, 3200, 6400, 12800)
SHAPE = -0.026


def camera_at(iso: float, *, switches: bool = True) -> Camera:
    """PMN's lines of ln(scale) over ln K below and above ISO 1600: sigma_TL 3.24 at ISO 1600, 2.04 at ISO 3200."""
    gain = 0.0009563 * iso
    lines = (
        ((0.74901, -0.12348), (0.62945, -1.5104))
        if switches and iso > 1600
        else ((0.74043, 0.86182), (0.78782, -0.34227))
    )
    sigma_tl, sigma_row = (math.exp(slope * math.log(gain) + intercept) for slope, intercept in lines)
    return Camera(shape=(264, 384), gain=gain, sigma_tl=sigma_tl, sigma_row=sigma_row, tukey_lambda=SHAPE)


@pytest.fixture(scope="module")
def isos() -> list[IsoCalibration]:
    return [measured(iso, camera_at(iso), frames=4) for iso in ISOS]


@pytest.fixture(scope="module")
def found(isos: list[IsoCalibration]) -> Calibration:
    return joined("Two modes", isos)


def test_the_step_is_found_and_the_profile_has_a_mode_on_either_side(found: Calibration) -> None:
    assert [one.mode.iso_range for one in found.modes] == [(200, 1600), (3200, 12800)]
    (remark,) = found.remarks
    assert remark.startswith("between ISO 1600 and 3200 there is a step over K of sigma_TL (-6")
    assert "the profile has a gain mode on either side" in remark
    for one, slope, intercept in zip(found.modes, (0.74043, 0.74901), (0.86182, -0.12348), strict=True):
        line = one.tukey_lambda_fit
        assert line is not None
        # The scales of one ISO are known to half a per cent; the lines of three and four of them to their errors, of
        # which those of few points are themselves uncertain.
        assert line.fit.slope == pytest.approx(slope, abs=0.02)
        assert line.fit.intercept == pytest.approx(intercept, abs=0.03)
    assert (found.tukey_lambda_fit, found.profile.tukey_lambda_fit) == (None, None)


def drawn(profile: CameraProfile, iso: float, **options: Any) -> list[NoiseParameters]:
    generator = np.random.default_rng(4)
    return [profile.sample(generator, iso=iso, row="nearest-gain", **options) for _ in range(400)]


def test_samples_of_the_profile_are_the_cameras_figures(found: Calibration, isos: list[IsoCalibration]) -> None:
    """Each scale to 4 %; by one line through both modes it is 40 % off where they meet."""
    for iso in ISOS:
        true, draws = camera_at(iso), drawn(found.profile, iso)
        assert np.exp(np.mean([math.log(one.sigma_tl_dn) for one in draws])) == pytest.approx(true.sigma_tl, rel=0.04)
        assert np.exp(np.mean([math.log(one.sigma_row_dn) for one in draws])) == pytest.approx(true.sigma_row, rel=0.12)
        assert abs(draws[0].tukey_lambda - SHAPE) < 0.02
        assert np.std([math.log(one.sigma_tl_dn) for one in draws]) < 0.02, "little spread around a mode's own line"
    one_line = joined("One line", isos, modes=())
    (remark,) = one_line.remarks
    assert "state the modes (--mode ISO)" in remark
    assert one_line.tukey_lambda_fit is not None
    assert one_line.tukey_lambda_fit.fit.sigma > 0.2
    for iso in (1600, 3200):
        off = one_line.tukey_lambda_fit.fit.scale_dn(0.0009563 * iso, 0.0) / camera_at(iso).sigma_tl
        assert abs(off - 1) > 0.25


def test_modes_that_are_stated(isos: list[IsoCalibration]) -> None:
    stated = joined("Stated", isos, modes=(2000,))
    assert [one.mode.iso_range for one in stated.modes] == [(200, 1600), (2000, 12800)]
    (remark,) = stated.remarks
    assert remark.startswith("the gain mode of ISO 3200 to 12800 is stated to begin at ISO 2000")
    sigma = float(np.mean([one.sigma_tl_dn for one in drawn(stated.profile, 2000)]))
    assert sigma == pytest.approx(camera_at(2000).sigma_tl, rel=0.04)
    assert sigma == pytest.approx(1.43, rel=0.05), "the 1.44 that were measured at ISO 2000"
    with pytest.raises(ArgumentError, match="ISO 1800 lies between the gain modes"):
        stated.profile.gain_at_iso(1800)
    lone = joined("Lone", isos, modes=(12800,))
    assert lone.no_profile.startswith(
        "the gain mode from ISO 12800 on has K, read noise and colour bias at fewer than two"
    )
    assert "below ISO 400 has" in joined("Lone", isos, modes=(400,)).no_profile


def test_text_plots_and_file(found: Calibration, tmp_path: Path) -> None:
    assert [row[0] for row in found.fit_table()] == [
        f"{name}, {where}"
        for where in ("ISO 200 to 1600", "ISO 3200 to 12800")
        for name in ("sigma_TL", "sigma_G", "sigma_row")
    ]
    data = found.as_dict()
    assert [one["mode"]["iso_range"] for one in data["modes"]] == [(200, 1600), (3200, 12800)]
    assert len(data["profile"]["modes"]) == 2
    (alt,) = [plot.alt for plot in joint_plots(found) if plot.name == "sigma-tl"]
    assert re.search("the fitted line of ISO 200 to 1600 of slope .*, and the fitted line of ISO 3200 to 12800", alt)
    found.profile.save(tmp_path / "two.json")
    assert CameraProfile.load(tmp_path / "two.json") == found.profile


@pytest.mark.parametrize(("modes", "text"), [((100,), "above 100"), ((800,), "up to 400"), ((400, 400), "ascending")])
def test_stated_modes_lie_among_the_isos(modes: tuple[float, ...], text: str, tmp_path: Path) -> None:
    frames = made_tree(tmp_path / "tree", isos=(100, 400), bias_frames=2, flat_levels=2).frames()
    with pytest.raises(ArgumentError, match=text):
        calibrate(frames, modes=modes)


def test_the_published_table_of_the_a7s2() -> None:
    """25 ISOs that PMN measured: the switch stands in them, and the profile's lines are those of its rows."""
    profile = CameraProfile.load("SonyA7S2-PMN")
    rows = [row for row in profile.rows if row.iso is not None and row.iso >= 100]
    points = {
        name: [(row.gain_dn_per_e or 0.0, getattr(row, field) or 0.0) for row in rows]
        for name, field in (("sigma_TL", "sigma_tl_dn"), ("sigma_G", "sigma_gauss_dn"), ("sigma_row", "sigma_row_dn"))
    }
    (step,) = gain_steps(points)
    assert [one.name for one in step.steps] == list(points)
    low, high = profile.modes
    assert (step.below_dn_per_e, step.above_dn_per_e) == (low.gain_range_dn_per_e[1], high.gain_range_dn_per_e[0])
    for mode in (low, high):
        inside = [one for one in points["sigma_TL"] if mode.distance(one[0]) == 0]
        found, stated = fit_log_log(*zip(*inside, strict=True)).fit, mode.tukey_lambda_fit
        assert stated is not None
        # To the last bits but a few: BLAS and numpy's logarithm choose their code by the processor.
        assert asdict(found) == pytest.approx(asdict(stated), rel=1e-12)
    for iso, sigma in ((1600, 3.23), (2000, 1.44), (12800, 7.04), (25600, 12.18)):
        assert profile.sample(np.random.default_rng(0), iso=iso, row="measured").sigma_tl_dn == pytest.approx(
            sigma, abs=0.005
        )
    whole = fit_log_log(*zip(*points["sigma_TL"], strict=True)).fit
    assert whole.scale_dn(profile.gain_at_iso(1600), 0.0) == pytest.approx(2.5, abs=0.3)
