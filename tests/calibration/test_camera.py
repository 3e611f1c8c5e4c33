"""From DNG files to a profile: the whole calibration, and what it says where something is missing."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata import calibrate
from eldata.calibration.camera import join_isos, stated_gains
from eldata.cli.main import main
from eldata.errors import ArgumentError
from eldata.noise import CameraProfile, NoiseParameters
from tests.calibration.in_memory import read_of
from tests.calibration.trees import CAMERA, ISOS, FrameTree, made_tree

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.calibration import Calibration, IsoCalibration


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> FrameTree:
    """Three ISOs, six bias frames and four pairs of flats each. Not to be changed."""
    return made_tree(tmp_path_factory.mktemp("camera") / "tree", flat_levels=4)


@pytest.fixture(scope="module")
def found(pristine: FrameTree) -> Calibration:
    return calibrate(pristine.root, workers=2)


@pytest.fixture
def tree(pristine: FrameTree, tmp_path: Path) -> FrameTree:
    """A copy of one's own."""
    return pristine.copy(tmp_path / "tree")


# --- what comes out -------------------------------------------------------------------------------------------------


def test_the_profile_holds_what_was_measured(found: Calibration) -> None:
    profile = found.profile
    assert profile.camera == CAMERA
    assert "15 bias and 24 flat frames at 3 ISOs" in profile.source
    assert profile.gain_range_dn_per_e == (found.isos[0].gain_dn_per_e, found.isos[-1].gain_dn_per_e)
    assert profile.iso_range == (100.0, 1600.0)
    assert (profile.black_level_dn, profile.white_level_dn) == (512.0, 16383.0)
    for row, one in zip(profile.rows, found.isos, strict=True):
        assert row.iso == one.iso
        assert row.gain_dn_per_e == one.gain_dn_per_e
        assert row.tukey_lambda == read_of(one).tukey_lambda
        assert row.colour_bias_dn == one.bias.bias_dn
        assert (row.sigma_tl_dn, row.sigma_gauss_dn) == (read_of(one).sigma_tl_dn, read_of(one).sigma_gauss_dn)
        assert row.sigma_row_dn == one.rows.rows.sigma_dn
        assert one.parameters == NoiseParameters(
            gain_dn_per_e=row.gain_dn_per_e or 0.0,
            tukey_lambda=row.tukey_lambda,
            sigma_tl_dn=row.sigma_tl_dn or 0.0,
            sigma_gauss_dn=row.sigma_gauss_dn or 0.0,
            sigma_row_dn=row.sigma_row_dn or 0.0,
            colour_bias_dn=row.colour_bias_dn,
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
    gains = [one.gain_dn_per_e for one in found.isos]
    assert [profile.gain_at_iso(iso) for iso in (50, *ISOS)] == [gain, *gains]
    assert profile.gain_range_dn_per_e == (min(gain, gains[0] or 0.0), gains[-1])
    assert profile.gain_at_iso(200) == pytest.approx(math.sqrt((gains[0] or 0.0) * (gains[1] or 0.0)), rel=1e-12)

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
        assert one.plot is not None
        assert other.plot is not None
        np.testing.assert_array_equal(one.plot.ordered_dn, other.plot.ordered_dn)
    listed = calibrate(pristine.frames(manifest=pristine.manifest, isos=[400]), "Mine", workers=3)
    assert listed.as_dict()["isos"] == of_whole[1:2]
    assert listed.profile.camera == "Mine"


# --- too little -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("isos", [(400,), (100, 1600)])
def test_fewer_than_three_isos(isos: tuple[int, ...], found: Calibration, tmp_path: Path) -> None:
    """No line: each ISO is given as it was measured, and nothing in between."""
    few = join_isos(CAMERA, [one for one in found.isos if one.iso in isos])
    assert few.tukey_lambda_fit is few.gauss_fit is few.row_fit is None
    assert "fits" not in few.tables()
    assert "fit over ln K" not in few.format_text()
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
    for gain in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ArgumentError, match="K at ISO 100 must be finite and above 0"):
            calibrate(pristine.root, gains={100: gain})
    elsewhere = replace(
        found.profile, iso_range=(25600.0, 51200.0), rows=(replace(found.profile.rows[0], iso=25600.0),)
    )
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
    said = [r for r in other.remarks if "level differs by ISO or channel" in r]
    assert ["(492, 512 DN)" in r for r in said] == ([False] if black else [True, False])
    assert said[-1].startswith("the white level differs by ISO or channel (16000, 16383 DN)")


# --- wrong usage ------------------------------------------------------------------------------------------------------


def test_wrong_arguments(pristine: FrameTree) -> None:
    with pytest.raises(ArgumentError, match="isos is for a folder"):
        calibrate(pristine.frames(), isos=[100])
    with pytest.raises(ArgumentError, match="workers must be 1 or more"):
        calibrate(pristine.root, workers=0)
