"""From DNG files to a profile: the whole calibration, and what it says where something is missing."""

from __future__ import annotations

import math
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldata import calibrate
from eldata.calibration import Calibration, IsoCalibration
from eldata.calibration.camera import join_isos, stated_gains
from eldata.calibration.frames import IsoFrames
from eldata.calibration.one_iso import bias_remarks, flat_remarks, no_pairs, transfer_remarks
from eldata.cli.main import main
from eldata.errors import ArgumentError
from eldata.noise import CameraProfile, NoiseModel, NoiseParameters
from eldata.noise.profile import LogLogFit
from eldata.records import FrameRecord
from tests.calibration.faults import coarse, plant
from tests.calibration.in_memory import calibrated_arrays
from tests.calibration.simulation import Body, Camera
from tests.calibration.trees import CAMERA, ISOS, FrameTree, rewritten
from tests.evaluation.test_way_of_a_score import modules_called
from tests.shared import there


@pytest.fixture(scope="module")
def found(pristine: FrameTree) -> Calibration:
    return calibrate(pristine.root, workers=2)


# --- what comes out -------------------------------------------------------------------------------------------------


def test_the_profile_holds_what_was_measured(found: Calibration) -> None:
    profile = found.profile
    assert profile.camera == CAMERA
    assert "15 bias and 18 flat frames at 3 ISOs" in profile.source
    assert profile.gain_range_dn_per_e == (found.isos[0].gain_dn_per_e, found.isos[-1].gain_dn_per_e)
    assert profile.iso_range == (100.0, 1600.0)
    assert (profile.black_level_dn, profile.white_level_dn) == (512.0, 16383.0)
    for row, one in zip(profile.rows, found.isos, strict=True):
        read = there(one.read)
        assert (row.iso, row.gain_dn_per_e) == (one.iso, one.gain_dn_per_e)
        assert one.parameters == NoiseParameters(
            gain_dn_per_e=there(one.gain).value,
            tukey_lambda=read.tukey_lambda,
            sigma_tl_dn=read.sigma_tl_dn,
            sigma_gauss_dn=read.sigma_gauss_dn,
            sigma_row_dn=one.rows.rows.sigma_dn,
            colour_bias_dn=one.bias.bias_dn,  # type: ignore[arg-type] # four numbers
        )
        assert profile.measured(one.iso) == one.parameters
        assert profile.measured(one.iso).range_dn == 16383.0 - 512.0
    assert list(profile.notes) == list(found.all_remarks)
    assert sum(note.startswith("ISO 400: 5 bias frames were used") for note in profile.notes) == 1


# --- an extended ISO --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.999, 1.001])
def test_an_extended_iso_of_the_base_isos_gain(
    found: Calibration, share: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its K by chance is the smaller one or the larger; a third of such profiles refused their own lowest ISO."""
    base = found.isos[0]
    assert base.transfer is not None
    gain = share * base.transfer.gain_dn_per_e
    extended = replace(base, iso=50.0, transfer=replace(base.transfer, gain_dn_per_e=gain))
    wider = join_isos(CAMERA, [extended, *found.isos])
    wider.profile.save(tmp_path / "wider.json")
    profile = CameraProfile.load(tmp_path / "wider.json")
    assert profile.iso_range == (50.0, 1600.0)
    gains = [there(one.gain).value for one in found.isos]
    assert [profile.gain_at_iso(iso) for iso in (50, *ISOS)] == [gain, *gains]
    assert profile.gain_range_dn_per_e == (min(gain, gains[0]), gains[-1])
    assert profile.gain_at_iso(200) == pytest.approx(math.sqrt(gains[0] * gains[1]), rel=1e-12)

    (remark,) = (note for note in profile.notes if note.startswith("K / ISO is usually"))
    assert re.search(r"but not at ISO 50 \((1\.9|2\.0)\d of it\): an extended ISO", remark)
    assert main(["profile", "show", str(tmp_path / "wider.json")]) == 0
    assert f" note {remark} " in " ".join(capsys.readouterr().out.split())


# --- the same figures -------------------------------------------------------------------------------------------------


def test_any_way_to_the_frames_gives_the_same(found: Calibration, pristine: FrameTree) -> None:
    """One thread and not two, one ISO without the others, by the manifest: the profile may have another name."""
    of_whole = found.as_dict()["isos"]
    serial = calibrate(pristine.root, isos=[100, 400])
    assert serial.as_dict()["isos"] == of_whole[:2]
    for one, other in zip(serial.isos, found.isos, strict=False):
        np.testing.assert_array_equal(one.spectrum_dn2, other.spectrum_dn2)
        np.testing.assert_array_equal(there(one.plot).ordered_dn, there(other.plot).ordered_dn)
    listed = calibrate(pristine.frames(manifest=pristine.manifest, isos=[400]), "Mine", workers=3)
    assert listed.as_dict()["isos"] == of_whole[1:2]
    assert listed.profile.camera == "Mine"


def test_an_executor_gives_the_same(found: Calibration, tree: FrameTree) -> None:
    """And the problems that its workers find."""
    rewritten(tree.files("bias", 400)[2], mosaic=lambda dn: dn + np.uint16(300))
    with ThreadPoolExecutor(1) as executor:
        other = calibrate(tree.frames(isos=[100, 400]), workers=executor)
    assert other.as_dict()["isos"] == found.as_dict()["isos"][:1]
    assert [problem.field for problem in other.problems] == ["level"]


def test_what_is_remarked_of_one_iso(found: Calibration) -> None:
    base, flat = found.isos[1], FrameRecord("flat.dng", "flat", CAMERA)
    rows, columns, kept = base.rows.rows, base.rows.columns, there(base.reproduction)
    chosen = IsoFrames(Fraction(400), (), (), (flat,) * 4, Fraction(1, 10))
    usual = bias_remarks(base, chosen, "loss")
    assert any("exposed for 0.1 s" in remark for remark in usual)
    for changed, words in (
        ({"rows": replace(base.rows, rows=replace(rows, sigma_dn=0.0))}, "no row noise was seen"),
        ({"rows": replace(base.rows, rows=replace(rows, shapiro_p=1e-4, excess_kurtosis=1.0))}, "is not normal"),
        ({"rows": replace(base.rows, columns=replace(columns, variance_dn2=9.0, sigma_dn=3.0))}, "columns have noise"),
        ({"pattern": replace(base.pattern, defects=base.pattern.pixels // 10)}, "10.0% of the pixels were left out"),
        ({"reproduction": replace(kept, histogram_distance=0.5)}, "differs from simulated ones by 50.0%"),
    ):
        assert any(words in remark for remark in bias_remarks(replace(base, **changed), chosen, None)), words
        assert not any(words in remark for remark in usual)
    assert "flat.dng, flat.dng, flat.dng and 1 more" in flat_remarks(chosen)[0]
    assert no_pairs(chosen).startswith("4 flat frames and no two of one exposure, so K is not known")
    dim = replace(base.sensor, white_level_dn=65535.0)
    transfer = replace(there(base.transfer), left_out=0.6)
    saturated, faint = transfer_remarks(replace(base, transfer=transfer, sensor=dim))
    assert saturated.startswith("60% of the flats' area is saturated")
    assert "brightest usable flat reaches" in faint


# --- too little -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("isos", [(400,), (100, 1600)])
def test_fewer_than_three_isos(isos: tuple[int, ...], found: Calibration, tmp_path: Path) -> None:
    """No line: each ISO is given as it was measured, and nothing in between."""
    few = join_isos(CAMERA, [one for one in found.isos if one.iso in isos])
    assert few.tukey_lambda_fit is few.gauss_fit is few.row_fit is None
    assert "fits" not in few.tables()
    for name in ("sigma_TL", "sigma_G", "sigma_row"):
        assert any(note.startswith(f"{name} is known at {len(isos)} ISO") for note in few.profile.notes)
    few.profile.save(tmp_path / "few.json")
    profile = CameraProfile.load(tmp_path / "few.json")
    assert profile == few.profile
    assert {mode.tukey_lambda_fit for mode in profile.gain_modes} == {None}
    for one in few.isos:
        sampled = profile.sample(np.random.default_rng(3), iso=one.iso, row="measured")
        assert sampled == profile.measured(one.iso) == one.parameters
        with pytest.raises(ArgumentError, match="sigma_TL, sigma_G, sigma_row was measured at too few ISOs"):
            profile.sample(np.random.default_rng(3), iso=one.iso, row="nearest-gain")
    assert len(profile.plot().axes) == 3


def test_wrong_gains(pristine: FrameTree, found: Calibration) -> None:
    shipped = CameraProfile.load("SonyA7S2")
    with pytest.raises(ArgumentError, match=r"camera DemoGamma .*, only of SonyA7S2, .*--gain ISO=K"):
        calibrate(pristine.root, gains=shipped)
    other = replace(shipped, camera="DemoGamma")
    assert stated_gains(pristine.frames(), other)[1600] == other.gain_at_iso(1600)
    elsewhere = replace(found.profile, iso_range=(25600, 51200), rows=(replace(found.profile.rows[0], iso=25600),))
    with pytest.raises(ArgumentError, match=r"knows K at none of the frames' ISOs \(100, 400, 1600\)"):
        calibrate(pristine.root, gains=elsewhere)


# --- special cameras --------------------------------------------------------------------------------------------------


def quiet_rows(one: IsoCalibration) -> IsoCalibration:
    lines = replace(one.rows.rows, sigma_dn=0.0, variance_dn2=-1e-6)
    return replace(one, rows=replace(one.rows, rows=lines))


def test_no_row_noise(found: Calibration, tmp_path: Path) -> None:
    silent = join_isos(CAMERA, [quiet_rows(one) for one in found.isos])
    assert silent.row_fit is None
    assert "sigma_row was 0 at every ISO; the profile has none" in silent.remarks
    assert silent.tukey_lambda_fit == found.tukey_lambda_fit
    partly = join_isos(CAMERA, [quiet_rows(found.isos[0]), *found.isos[1:]])
    assert "sigma_row was 0 at 1 ISO, which its fit leaves out" in partly.remarks
    assert partly.row_fit is None
    silent.profile.save(tmp_path / "silent.json")
    sampled = CameraProfile.load(tmp_path / "silent.json").sample(np.random.default_rng(0))
    assert sampled.sigma_row_dn == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize(("blue", "black"), [(509.0, 512.0), (492.0, None)])
def test_levels_that_differ_are_left_open(blue: float, black: float | None, found: Calibration) -> None:
    """A thousandth of the range is none: cameras record black levels that differ by a DN."""
    one = found.isos[1]
    sensor = replace(one.sensor, black_level_dn=(512.0, 512.0, blue, 512.0), white_level_dn=16000.0)
    other = join_isos(CAMERA, [found.isos[0], replace(one, sensor=sensor), found.isos[2]])
    assert (other.profile.black_level_dn, other.profile.white_level_dn) == (black, None)
    said = [remark for remark in other.remarks if "level differs by ISO or channel" in remark]
    assert ["(492, 512 DN)" in remark for remark in said] == ([False] if black else [True, False])
    assert said[-1].startswith("the white level differs by ISO or channel (16000, 16383 DN)")


# --- wrong usage ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"isos": [100]}, "isos is for a folder"),
        ({"workers": 0}, "workers must be 1 or more"),
        ({"modes": (100,)}, "modes must be finite and above 100; found 100"),
        ({"modes": (2000,)}, "above ISO 100 and up to 1600, those of the frames; found 2000"),
        ({"modes": (400, 400)}, "ascending"),
        *(({"crop": crop}, "two slices without a step") for crop in [(slice(1),), np.s_[::2, :], (0, 9)]),
        *(({"gains": {100: gain}}, "K at ISO 100 must be finite and above 0") for gain in (0.0, -1.0, math.nan)),
    ],
)
def test_wrong_arguments(options: dict[str, Any], words: str, pristine: FrameTree) -> None:
    with pytest.raises(ArgumentError, match=words):
        calibrate(pristine.frames(), **options)


def test_a_calibration_passes_few_modules(pristine: FrameTree) -> None:
    """From files to a profile: half of them decode the files, and simulate the frame that is kept out."""
    frames = pristine.frames(isos=[400])
    passed, _ = modules_called(lambda: calibrate(frames))
    assert len([name for name in passed if name.startswith("eldata.calibration.")]) <= 14, sorted(passed)
    assert len(passed) <= 39, sorted(passed)


FRAMES, DRAWS = 60, 4000
SHARED_DN, OWN_DN = 1.5, 0.75  # standard deviations over the frames: of all channels together, and of each


def test_the_spread_of_the_bias_comes_back_by_sampling(tmp_path: Path) -> None:
    """59 frames (one is kept out), 4000 draws.

    A standard deviation of n normal numbers scatters by 1 / sqrt(2 (n - 1)); that of the pixels and rows in a frame's
    own mean, 0.05 DN, adds a thousandth. The correlation r of two channels scatters by (1 - r^2) / sqrt(n - 1). Four of
    these errors.
    """
    camera, generator = Camera(shape=(264, 384)), np.random.default_rng(5)
    body = Body(camera, generator)
    shift = SHARED_DN * generator.standard_normal((FRAMES, 1))
    shift = shift + OWN_DN * generator.standard_normal((FRAMES, len(camera.bias)))
    frames = [np.rint(body.fixed + body.noise() + one[camera.channel]).clip(0).astype(np.uint16) for one in shift]
    biases_dn = np.array(camera.bias) + shift
    record = replace(calibrated_arrays(camera.sensor, frames, []), stated_gain_dn_per_e=camera.gain)
    join_isos("Simulated", [record]).profile.save(tmp_path / "p.json")
    profile = CameraProfile.load(tmp_path / "p.json")
    (row,) = profile.rows
    assert len(row.frame_bias_dn) == FRAMES - 1
    # Of each frame itself: the pattern of this specimen is in all frames alike.
    of_pattern = np.array(row.frame_bias_dn).mean(axis=0) - biases_dn[:-1].mean(axis=0)
    np.testing.assert_allclose(row.frame_bias_dn, biases_dn[:-1] + of_pattern, atol=0.3)
    generator, line = np.random.default_rng(0), LogLogFit(0.5, 0.0, 0.1)
    profile = replace(profile, tukey_lambda_fit=line, gauss_fit=line, row_fit=line)  # of one ISO there are none
    drawn = np.array([profile.sample(generator, row="any").colour_bias_dn for _ in range(DRAWS)])
    error = math.hypot(1 / math.sqrt(2 * (FRAMES - 2)), 1 / math.sqrt(2 * DRAWS))
    assert drawn.std(axis=0, ddof=1) == pytest.approx(math.hypot(SHARED_DN, OWN_DN), rel=4 * error)
    correlation = 1 / (1 + (OWN_DN / SHARED_DN) ** 2)
    pairs = np.corrcoef(drawn.T)[np.triu_indices(4, 1)]
    assert pairs == pytest.approx(correlation, abs=4 * (1 - correlation**2) / math.sqrt(FRAMES - 2))
    # Of the frames' own mean, as the errors of 4000 draws allow.
    mean_error = math.hypot(SHARED_DN, OWN_DN) / math.sqrt(DRAWS)
    assert drawn.mean(axis=0) == pytest.approx(row.colour_bias_dn, abs=4 * mean_error)


# --- the step of the values -------------------------------------------------------------------------------------------


def stepping(iso: float, step: int, camera: Camera) -> IsoCalibration:
    """Of ten bias frames whose values step by so many DN; K is stated."""
    body = Body(camera, np.random.default_rng(int(iso)))
    frames = plant(coarse(step), body, 10)
    return replace(calibrated_arrays(camera.sensor, frames, []), iso=iso, stated_gain_dn_per_e=camera.gain)


COARSE_CAMERA = Camera(shape=(512, 768))


@pytest.fixture(scope="module")
def in_steps() -> list[IsoCalibration]:
    return [stepping(iso, 4, COARSE_CAMERA.with_(gain=iso / 400, sigma_tl=sigma)) for iso, sigma in LOUDER.items()]


LOUDER = {400.0: 2.0, 800.0: 2.8, 1600.0: 4.0}  # sigma_TL by ISO


def test_a_step_that_all_isos_have_is_the_profiles(in_steps: list[IsoCalibration], tmp_path: Path) -> None:
    """sigma_TL and lambda come back beside a rounding of 4 DN, within four of their errors, which hold the misfit.

    Before, at ISO 400, whose noise is of 0.98 steps, they were withheld. sigma_G is within a half of a per cent.
    """
    found = join_isos("Coarse", in_steps)
    found.profile.save(tmp_path / "p.json")
    profile = CameraProfile.load(tmp_path / "p.json")
    assert profile.quantisation_step_dn == 4
    assert "read noise" in in_steps[0].withheld
    assert [row.iso for row in profile.rows] == list(LOUDER)
    assert any("quantisation_step_dn" in note for note in profile.notes)
    for one in found.isos:
        true = COARSE_CAMERA.with_(sigma_tl=LOUDER[one.iso]).noise
        shape, scale, gauss = there(one.tukey_lambda), there(one.sigma_tl_dn), there(one.sigma_gauss_dn)
        assert abs(shape.value - true.tukey_lambda) < min(4 * shape.error, 0.01)
        assert abs(scale.value - true.sigma_tl_dn) < min(4 * scale.error, 0.02 * scale.value)
        assert gauss.value == pytest.approx(true.sigma_gauss_dn, rel=0.005)
        # What the model then makes has the variance that frames have, of 131072 pixels: five errors.
        drawn = profile.measured(one.iso)
        dark = NoiseModel("G*+U")(
            np.zeros((4, 128, 256), np.float32), parameters=drawn, ratio=1.0, generator=np.random.default_rng(1)
        )
        expected = true.sigma_gauss_dn**2 + 16 / 12
        assert float(dark.var()) * (profile.range_dn or 0.0) ** 2 == pytest.approx(expected, rel=0.01 + 5 * 0.005)
        compared = there(one.reproduction)
        assert compared.histogram_distance < max(2 * compared.histogram_distance_by_chance, 0.01)


def test_the_step_is_of_bias_frames_and_flats() -> None:
    camera = Camera(shape=(264, 384), sigma_tl=4.0)
    body = Body(camera, np.random.default_rng(1))
    found = calibrated_arrays(camera.sensor, plant(coarse(4), body, 5), body.flat_pairs((800.0, 3000.0)))
    assert (found.step_dn, found.stepped) == (1, None)


def test_steps_that_are_not_one_are_said(in_steps: list[IsoCalibration]) -> None:
    plain = stepping(3200.0, 1, COARSE_CAMERA.with_(gain=8.0, sigma_tl=5.6))
    found = join_isos("Coarse", [*in_steps, plain])
    assert found.profile.quantisation_step_dn == 1
    assert found.isos[0].read is in_steps[0].read
    assert any("4 at ISO 400, 4 at ISO 800, 4 at ISO 1600, 1 at ISO 3200" in remark for remark in found.remarks)
    quiet = stepping(100.0, 4, COARSE_CAMERA.with_(gain=0.25, sigma_tl=1.0))
    assert quiet.stepped is None  # its noise is lost in the steps: half of one
    # It costs the others nothing: the step is of the files' codes.
    both = join_isos("Coarse", [quiet, *in_steps])
    assert both.profile.quantisation_step_dn == 4
    assert both.profile.rows == join_isos("Coarse", in_steps).profile.rows
    assert "read noise" in both.isos[0].withheld
    assert join_isos("Coarse", [replace(quiet, step_dn=0), *in_steps]).profile.quantisation_step_dn == 4, "not known"
