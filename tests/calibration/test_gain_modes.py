"""The calibration of a camera that switches its conversion gain, with the figures of the A7S2 that PMN published."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from eldata.calibration.camera import join_isos
from eldata.calibration.iso_results import LIGHT, READ, IsoCalibration, MeasuredFigure
from eldata.calibration.iso_results import SHAPE as SHAPE_LOST
from eldata.calibration.joint import find_steps, fit_log_log
from eldata.errors import ArgumentError
from eldata.noise import CameraProfile, NoiseParameters
from tests.calibration.simulation import Camera
from tests.reports.calibrations import measured
from tests.shared import there

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


def test_a_step_is_remarked_until_it_is_stated(isos: list[IsoCalibration]) -> None:
    """One mode, and the remark says what to state; modes that are stated have lines of their own."""
    found = join_isos("Two modes", isos)
    assert [one.mode.iso_range for one in found.modes] == [(200, 12800)]
    (remark,) = found.remarks
    assert remark.startswith("between ISO 1600 and 3200 the read noise goes from 6.")
    assert "state the gain mode with --mode 3200 (modes=[3200]), or that there is none with --mode none" in remark
    assert join_isos("One mode", isos, modes=()).remarks == ()
    assert remark in join_isos("Elsewhere", isos, modes=(800,)).remarks
    found = join_isos("Two modes", isos, modes=(3200,))
    assert [one.mode.iso_range for one in found.modes] == [(200, 1600), (3200, 12800)]
    assert found.remarks == ()
    for one, slope, intercept in zip(found.modes, (0.74043, 0.74901), (0.86182, -0.12348), strict=True):
        line = there(one.tukey_lambda_fit)
        # The scales of one ISO are known to half a per cent; the lines of three and four of them to their errors, of
        # which those of few points are themselves uncertain.
        assert line.fit.slope == pytest.approx(slope, abs=0.02)
        assert line.fit.intercept == pytest.approx(intercept, abs=0.03)
    assert (found.tukey_lambda_fit, found.profile.tukey_lambda_fit) == (None, None)


def drawn(profile: CameraProfile, iso: float, **options: Any) -> list[NoiseParameters]:
    generator = np.random.default_rng(4)
    return [profile.sample(generator, iso=iso, row="nearest-gain", **options) for _ in range(400)]


def test_modes_that_are_stated(isos: list[IsoCalibration]) -> None:
    stated = join_isos("Stated", isos, modes=(2000,))
    assert [one.mode.iso_range for one in stated.modes] == [(200, 1600), (2000, 12800)]
    (remark,) = stated.remarks
    assert remark.startswith("the gain mode of ISO 3200 to 12800 is stated to begin at ISO 2000")
    sigma = float(np.mean([one.sigma_tl_dn for one in drawn(stated.profile, 2000)]))
    assert sigma == pytest.approx(camera_at(2000).sigma_tl, rel=0.04)
    assert sigma == pytest.approx(1.43, rel=0.05), "the 1.44 that were measured at ISO 2000"
    with pytest.raises(ArgumentError, match="ISO 1800 lies between the gain modes"):
        stated.profile.gain_at_iso(1800)
    for start, which in ((12800, "from ISO 12800 on"), (400, "below ISO 400")):
        expected = f"the gain mode {which} has K, read noise and colour bias at fewer than two"
        assert join_isos("Lone", isos, modes=(start,)).no_profile.startswith(expected)


def test_a_profile_ends_where_the_read_noise_does(isos: list[IsoCalibration]) -> None:
    """Its K is known further up; before, lines through the lower ISOs were drawn from at ISO 12800, 91 % too low."""
    quiet = SHAPE_LOST.find(0.3, 0.15, "lost", "withheld", READ)
    for lost, ends in (((3200, 6400, 12800), 1600), ((200, 12800), 6400)):
        shortened = [replace(one, findings=(quiet,)) if one.iso in lost else one for one in isos]
        profile = join_isos("Ends", shortened, modes=()).profile
        lowest = min(iso for iso in ISOS if iso not in lost)
        gains = [one.gain_dn_per_e for one in isos if one.iso in (lowest, ends)]
        assert (profile.iso_range, list(profile.gain_range_dn_per_e)) == ((lowest, ends), gains)
        with pytest.raises(ArgumentError, match=f"ISO 12800 is outside of the calibrated range {lowest} to {ends}"):
            drawn(profile, 12800)
        assert drawn(profile, 12800, extrapolate=True)


def test_lines_are_weighted_by_the_errors() -> None:
    """As numpy's weighted line; what the points scatter by beyond their errors is the camera's own, of each alike."""
    gains = np.array([0.1, 0.2, 0.4, 0.8, 1.6])
    errors = np.array([0.002, 0.002, 0.002, 0.002, 0.4])  # of ln(scale)
    exact = np.exp(0.6 * np.log(gains) + 1.0)
    off = exact * np.exp(np.array([0.0, 0.0, 0.0, 0.0, -0.8]))
    found = fit_log_log(gains.tolist(), off.tolist(), (0 * gains).tolist(), (errors * off).tolist())
    assert np.polyfit(np.log(gains), np.log(off), 1, w=1 / errors) == pytest.approx(
        [found.fit.slope, found.fit.intercept], abs=0.003
    )
    assert found.fit.scale_dn(1.6, 0.0) == pytest.approx(exact[-1], rel=0.01)
    assert fit_log_log(gains.tolist(), off.tolist()).fit.scale_dn(1.6, 0.0) < 0.75 * exact[-1], "each alike"
    for spread in (0.0, 0.002, 0.05):  # of points off the line, each by as much, against errors of 0.02 and of K 0.01
        scales = exact * np.exp(spread * np.array([1, -1, 0, -1, 1]))
        of_each = (0.01 * gains).tolist(), (0.02 * scales).tolist()
        sigma = fit_log_log(gains.tolist(), scales.tolist(), *of_each).fit.sigma
        assert sigma == pytest.approx(max(math.hypot(0.02, 0.6 * 0.01), spread * math.sqrt(4 / 3)), rel=0.03)


def test_a_stated_black_that_is_wrong(isos: list[IsoCalibration]) -> None:
    """The A7 IV's files state 512 DN where its black is 1024, from ISO 128000 on; colour biases that grow are none."""

    def moved(one: IsoCalibration, by_dn: float) -> IsoCalibration:
        return replace(one, bias=replace(one.bias, bias_dn=tuple(bias + by_dn for bias in one.bias.bias_dn)))

    for shift, black in ((512.0, "1024.0"), (-40.0, "472.0")):
        found = join_isos("Black", [*isos[:-1], moved(isos[-1], shift)], modes=())
        (said,) = [one for iso in found.isos for one in iso.findings]
        assert (said.check, said.figures, found.isos[-1].findings) == ("stated black", ("colour bias",), (said,))
        assert found.isos[-1].colour_bias is None
        assert len(found.profile.rows) == len(isos) - 1
        assert f"own black is {black} DN, the files state 512 (a colour bias of" in said.text
        assert "the stated black is probably wrong at this ISO" in said.text
    (said,) = [one for iso in join_isos("Two", [isos[0], moved(isos[1], -40.0)]).isos for one in iso.findings]
    assert "own black is 471.9 DN" in said.text
    alike = join_isos("Alike", [moved(one, 512.0) for one in isos], modes=())  # as every file of that camera is off
    assert {one.effect for iso in alike.isos for one in iso.findings} == {"remark"}
    lit = replace(moved(isos[-1], 600.0), findings=(LIGHT.find(9.0, 5.0, "light"),))
    assert "probably wrong" not in join_isos("Lit", [*isos[:-1], lit], modes=()).isos[-1].findings[-1].text
    for many in (isos, [moved(one, 3 * 2.0**place) for place, one in enumerate(isos[:4])], [moved(isos[0], 600.0)]):
        assert all(not one.findings for one in join_isos("Right", many, modes=()).isos)


def test_the_published_table_of_the_a7s2() -> None:
    """25 ISOs that PMN measured: the switch stands in them, and the profile's lines are those of its rows."""
    profile = CameraProfile.load("SonyA7S2-PMN")
    rows = [row for row in profile.rows if row.iso is not None and row.iso >= 100]
    points = [(row.gain_dn_per_e or 0.0, row.sigma_tl_dn or 0.0) for row in rows]
    (step,) = find_steps([iso_with(row.iso or 0, row.gain_dn_per_e or 0, row.sigma_gauss_dn or 0) for row in rows])
    assert step[0] == 2000
    assert "between ISO 1600 and 2000 the read noise goes from" in step[1].text
    for mode in profile.modes:
        inside = [one for one in points if mode.distance(one[0]) == 0]
        fitted = fit_log_log(*zip(*inside, strict=True)).fit
        # To the last bits but a few: BLAS and numpy's logarithm choose their code by the processor.
        assert asdict(fitted) == pytest.approx(asdict(there(mode.tukey_lambda_fit)), rel=1e-12)
    for iso, sigma in ((1600, 3.23), (2000, 1.44), (12800, 7.04), (25600, 12.18)):
        assert profile.sample(np.random.default_rng(0), iso=iso, row="measured").sigma_tl_dn == pytest.approx(
            sigma, abs=0.005
        )
    whole = fit_log_log(*zip(*points, strict=True)).fit
    assert whole.scale_dn(profile.gain_at_iso(1600), 0.0) == pytest.approx(2.5, abs=0.3)


# --- steps over the ISOs ----------------------------------------------------------------------------------------------


def iso_with(iso: float, gain: float, sigma: float, error: float = 0.002) -> IsoCalibration:
    """What is looked at of an ISO; both figures have this relative error."""
    figures = {"gain": gain, "sigma_gauss_dn": sigma}
    known = {name: MeasuredFigure(name, name, value, error * value) for name, value in figures.items()}
    return cast("IsoCalibration", SimpleNamespace(iso=iso, gain_dn_per_e=gain, **known))


def places(isos: list[IsoCalibration]) -> list[float]:
    return [iso for iso, _ in find_steps(isos)]


@pytest.mark.parametrize("per_stop", [1, 3])
@pytest.mark.parametrize("factor", [0.35, 0.45])
def test_a_step_of_the_read_noise_is_found_where_it_is(factor: float, per_stop: int) -> None:
    """Noise before and after the amplifier, of every size against each other, less of it from some ISO on.

    Ten by three cameras, 2 % of scatter between ISOs: a step of 55 % is four of its standard deviations above 30 %,
    where a word is said, less what a bend may hide. Between the lowest two ISOs and the highest two it is not told.
    """
    generator = np.random.default_rng(21)
    isos = [100 * 2 ** (number / per_stop) for number in range(6 * per_stop + 1)]
    for elbow in (50.0, 400.0, 3000.0):
        for _ in range(10):
            start = float(generator.choice(isos[2:-1]))
            scales = [
                math.hypot(1.0, iso / elbow) * (factor if iso >= start else 1) * math.exp(0.02 * generator.normal())
                for iso in isos
            ]
            found = [iso_with(iso, iso / 400, scale) for iso, scale in zip(isos, scales, strict=True)]
            assert places(found) == [start], (elbow, start)


def test_what_is_no_step() -> None:
    """Of 300 cameras without one, scattered by 3 % between ISOs: 30 % are four standard deviations of a step."""
    generator = np.random.default_rng(22)
    isos = [100 * 2.0**stop for stop in range(8)]
    for _ in range(300):
        elbow = math.exp(generator.uniform(math.log(30), math.log(20_000)))
        found = [
            iso_with(iso, iso / 400, math.hypot(1.0, iso / elbow) * math.exp(0.03 * generator.normal())) for iso in isos
        ]
        assert places(found) == []
    extended = [iso_with(100, 0.25, 1.0), iso_with(200, 0.5, 1.5), iso_with(400, 1.0, 2.4)]
    assert places(extended) == []
    assert places([iso_with(100, 0.25, 1.0)]) == []


def test_a_step_of_k_over_the_iso_is_found() -> None:
    """From ISO 640 on 17 % less than in proportion, as an ISO's name may be off; of 6 % no word is lost."""
    for factor, expected in ((0.83, [640.0]), (0.94, []), (1.3, [640.0])):
        isos = [160.0, 320.0, 640.0, 1280.0]
        gains = [iso / 400 * (factor if iso >= 640 else 1) for iso in isos]
        found = find_steps([iso_with(iso, gain, 2 * gain**0.5) for iso, gain in zip(isos, gains, strict=True)])
        assert [iso for iso, _ in found] == expected
    assert "K over the ISO changes by +30%" in found[0][1].text
    noisy = [iso_with(iso, gain, 2.0, 0.05) for iso, gain in ((160, 0.4), (320, 0.9))]
    assert places(noisy) == [], "12 % of a K that is known to 5 %"
