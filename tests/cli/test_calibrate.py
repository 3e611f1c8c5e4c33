"""`eldata calibrate`: exit codes, one-line errors, what is written and what is not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from eldata.noise import CameraProfile, DarkShading
from tests.calibration import conftest
from tests.calibration.trees import CAMERA, SIZE, FrameTree, make_tree, relative, rewritten
from tests.cases import in_one_test
from tests.cli.conftest import Cli
from tests.cli.test_usage import assert_one_line

pytestmark = pytest.mark.usefixtures("undrawn")

ISOS = (100, 400, 1600)


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> FrameTree:
    """Three ISOs, four bias frames and two pairs of flats each. Not to be changed."""
    return make_tree(tmp_path_factory.mktemp("calibrate") / "tree", isos=ISOS, bias_frames=4, flat_levels=2)


tree = conftest.tree


# --- all well -------------------------------------------------------------------------------------------------------


def test_a_profile_and_figures(eldata: Cli, pristine: FrameTree, tmp_path: Path) -> None:
    """The same to the byte whatever the number of jobs."""
    targets = ("-o", tmp_path / "p.json", "--json", tmp_path / "d.json")
    outcome = eldata("calibrate", pristine.root, "--camera", CAMERA, *targets)
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith(f"{CAMERA}: eldata ")
    assert f"look at it with eldata profile show {tmp_path / 'p.json'}" in outcome.out
    assert not list(tmp_path.glob(".*")), "no temporary file is left"

    data = json.loads((tmp_path / "d.json").read_text(encoding="utf-8"))
    profile = CameraProfile.load(tmp_path / "p.json")
    assert data["camera"] == profile.camera == CAMERA
    for iso, row in zip(data["isos"], profile.rows, strict=True):
        assert (iso["iso"], iso["gain_dn_per_e"], iso["tukey_lambda"]) == (row.iso, row.gain_dn_per_e, row.tukey_lambda)
    for remark in data["remarks"]:
        assert remark in outcome.out

    targets = ("-o", tmp_path / "p3.json", "--json", tmp_path / "d3.json")
    assert eldata("calibrate", pristine.root, "--jobs", "3", *targets).code == 0
    for name in ("p", "d"):
        assert (tmp_path / f"{name}.json").read_bytes() == (tmp_path / f"{name}3.json").read_bytes()


# --- problems -------------------------------------------------------------------------------------------------------


def test_nothing_is_written_if_no_iso_is_usable(eldata: Cli, tree: FrameTree, tmp_path: Path) -> None:
    spoilt = [tree.files("bias", 100)[1], tree.files("flat", 1600)[2]]
    spoilt[0].write_bytes(b"")
    spoilt[1].write_bytes(spoilt[1].read_bytes()[:-3000])
    CameraProfile.load("SonyA7S2").save(tmp_path / "p.json")
    older = (tmp_path / "p.json").read_bytes()
    targets = ("-o", tmp_path / "p.json", "--json", tmp_path / "d.json", "--html", tmp_path / "r.html")
    outcome = eldata("calibrate", tree.root, "--iso", "100", "--iso", "1600", *targets)
    assert (outcome.code, outcome.err) == (1, "")
    for path in spoilt:
        assert f"{relative(tree, path)}: content\n    expected  a whole raw file\n" in outcome.out
    assert outcome.out.endswith(f"{CAMERA}: 2 problems; nothing was written\n")
    assert (tmp_path / "p.json").read_bytes() == older
    assert not (tmp_path / "r.html").exists()
    data = json.loads((tmp_path / "d.json").read_text())
    assert data["camera"] == CAMERA
    assert [problem["path"] for problem in data["problems"]] == [relative(tree, path) for path in spoilt]


def test_one_bad_iso_does_not_stop_the_others(eldata: Cli, tree: FrameTree, tmp_path: Path) -> None:
    """A header tells of one, its pixels of another."""
    (tree.camera / "bias" / "ISO400" / "notes.txt").write_text("capped")
    level, size = tree.files("bias", 400)[2], tree.files("flat", 1600)[1]
    rewritten(level, mosaic=lambda mosaic: (mosaic + 100.0).astype(np.uint16))
    size.write_bytes(b"")
    targets = ("-o", tmp_path / "p.json", "--json", tmp_path / "d.json")
    outcome = eldata("calibrate", tree.root, *targets)
    assert (outcome.code, outcome.err) == (1, "")
    assert f"{CAMERA}: 2 problems; left out: ISO 400, 1600\n" in outcome.out
    assert f"{relative(tree, level)}: level\n    expected" in outcome.out
    assert f"{relative(tree, size)}: content\n    expected" in outcome.out
    assert "left alone, not raw: 1 file, such as " in outcome.out

    profile = CameraProfile.load(tmp_path / "p.json")
    assert [row.iso for row in profile.rows] == [100]
    assert any(note.startswith(f"ISO 400 was left out: {relative(tree, level)}: level") for note in profile.notes)
    data = json.loads((tmp_path / "d.json").read_text())
    assert data["failed_isos"] == [400, 1600]
    assert [problem["path"] for problem in data["problems"]] == [relative(tree, level), relative(tree, size)]
    assert [iso["iso"] for iso in data["isos"]] == [100]


def test_flats_without_a_line_cost_k_alone(eldata: Cli, tree: FrameTree, tmp_path: Path) -> None:
    """Of one ISO every second flat is far brighter; its pairs are named, its read noise is measured."""
    changed = [tree.files("flat", 400)[index] for index in (1, 3)]
    for path in changed:
        rewritten(path, mosaic=lambda mosaic: (512 + 0.5 * (mosaic - 512.0)).astype(np.uint16))
    outcome = eldata("calibrate", tree.root, "-o", tmp_path / "p.json")
    assert (outcome.code, outcome.err) == (1, "")
    assert "ISO 400: no pair of flats is usable (withheld: K)" in outcome.out
    for path in changed:
        assert f" and {relative(tree, path)} were left out: their levels over black are" in outcome.out
    rows = CameraProfile.load(tmp_path / "p.json").rows
    assert [(row.iso, row.gain_dn_per_e is None) for row in rows] == [(100, False), (400, True), (1600, False)]


def test_saturated_flats_are_counted_and_their_channel_is_named(eldata: Cli, tree: FrameTree, tmp_path: Path) -> None:
    noise = np.random.default_rng(0)
    for path in (path for iso in ISOS for path in tree.files("flat", iso)):
        rewritten(path, mosaic=lambda mosaic: noise.integers(16300, 16384, mosaic.shape, np.uint16))
    outcome = eldata("calibrate", tree.root, "--html", tmp_path / "r.html")
    assert "12 bias frames, 12 flats of which none could be used, at 3 ISOs" in outcome.out
    assert "R has 0 usable levels and a line needs two: the flats are saturated" in outcome.out
    assert "Made from 12 bias and 0 flat frames" in (tmp_path / "r.html").read_text()


# --- K that is stated, flats alone ------------------------------------------------------------------------------------


def without_flats(tree: FrameTree, *isos: int) -> None:
    for iso in isos:
        for path in tree.files("flat", iso):
            path.unlink()


def test_bias_frames_alone_with_a_stated_gain(eldata: Cli, tree: FrameTree, tmp_path: Path) -> None:
    """Without it there are figures and no profile."""
    without_flats(tree, *ISOS)
    outcome = eldata("calibrate", tree.root, "--iso", "400", "--json", tmp_path / "d.json")
    assert (outcome.code, outcome.err) == (0, "")
    assert "no profile can be made: no ISO with bias frames has two flats of the same exposure" in outcome.out
    data = json.loads((tmp_path / "d.json").read_text())
    assert data["profile"] is None
    assert data["isos"][0]["sigma_tl_dn"] > 0
    stated = [option for iso in ISOS for option in ("--gain", f"{iso}={iso / 400}")]
    outcome = eldata("calibrate", tree.root, *stated, "-o", tmp_path / "p.json", "--json", tmp_path / "d.json")
    assert (outcome.code, outcome.err) == (0, "")
    assert "12 bias and 0 flat frames at 3 ISOs, K stated at 3 of them" in outcome.out
    assert "0.25 (stated)" in outcome.out
    assert "ISO 100: K is stated, not measured: 0.25 DN/e-" in outcome.out
    assert "K is not known" not in outcome.out
    profile = CameraProfile.load(tmp_path / "p.json")
    assert [row.gain_dn_per_e for row in profile.rows] == [0.25, 1.0, 4.0]
    assert profile.source.endswith("K stated at 3 of them")
    data = json.loads((tmp_path / "d.json").read_text())
    assert [(iso["gain_error"], iso["gain_is_stated"]) for iso in data["isos"]] == [(None, True)] * 3


def test_a_gain_from_another_profile(eldata: Cli, pristine: FrameTree, tree: FrameTree, tmp_path: Path) -> None:
    """It serves where there are no flats; a single ISO's K wins over the profile's, a measured one over both."""
    assert eldata("calibrate", pristine.root, "-o", tmp_path / "known.json").code == 0
    known = CameraProfile.load(tmp_path / "known.json")
    without_flats(tree, 400, 1600)
    options = ("--gain", tmp_path / "known.json", "--gain", "1600=7.5", "-o", tmp_path / "p.json")
    outcome = eldata("calibrate", tree.root, *options)
    assert "does not count" not in outcome.out
    assert (outcome.code, outcome.err) == (0, "")
    rows = CameraProfile.load(tmp_path / "p.json").rows
    assert [row.gain_dn_per_e for row in rows] == [known.rows[0].gain_dn_per_e, known.rows[1].gain_dn_per_e, 7.5]
    outcome = eldata("calibrate", tree.root, "--iso", "100", "--gain", "100=0.5")
    assert outcome.code == 0
    assert "ISO 100: K is measured here, and the stated 0.5 DN/e- does not count" in outcome.out


def test_flats_alone_give_k(eldata: Cli, tree: FrameTree, tmp_path: Path) -> None:
    for path in tree.camera.glob("bias/*/*"):
        path.unlink()
    outcome = eldata("calibrate", tree.root, "--json", tmp_path / "d.json")
    assert (outcome.code, outcome.err) == (0, "")
    assert "K alone, from flats without bias frames" in outcome.out
    assert "no profile can be made: there are flats alone, which give K" in outcome.out
    data = json.loads((tmp_path / "d.json").read_text())
    assert (data["isos"], data["profile"]) == ([], None)
    for gain, true in zip(data["gains"], tree.truth["isos"], strict=True):
        assert gain["iso"] == true["iso"]
        assert abs(gain["gain_dn_per_e"] - true["gain_dn_per_e"]) < 5 * gain["gain_error"] < 0.1 * true["gain_dn_per_e"]
        assert "there are no bias frames, so K is all that is known" in gain["remarks"]
    lacking = eldata("calibrate", tree.root, "-o", tmp_path / "p.json", "--dark-shading", tmp_path / "s.npz")
    assert lacking.code == 1
    for name in ("p.json", "s.npz"):
        assert f"{tmp_path / name} was not written: " in lacking.out
        assert not (tmp_path / name).exists()


def test_a_light_leak_is_accepted(eldata: Cli, tree: FrameTree, tmp_path: Path) -> None:
    """Light through a corner: nothing is written, and a remark says how to have it all the same.

    Profile, page and ``profile show`` then say what was accepted.
    """
    y, x = np.ogrid[0 : 1 : SIZE[0] * 1j, 0 : 1 : SIZE[1] * 1j]
    isos = ("--iso", "100", "--iso", "1600")
    for truth in (row for row in tree.truth["isos"] if row["iso"] != 400):
        gain, generator = truth["gain_dn_per_e"], np.random.default_rng(truth["iso"])
        electrons = 1.5 * truth["sigma_gauss_dn"] ** 2 / gain**2 * np.exp(-(x**2 + y**2) / 0.05)
        for path in tree.files("bias", truth["iso"]):
            light = np.rint(gain * generator.poisson(electrons)).astype(np.uint16)
            rewritten(path, mosaic=light.__add__)
    profile = tmp_path / "p.json"
    refused = eldata("calibrate", tree.root, *isos, "-o", profile)
    assert refused.code == 1
    assert not profile.exists()
    assert refused.out.rstrip().splitlines()[-1].startswith(f"{profile} was not written: the read noise or the colour")
    assert 'to have it all the same, with a larger error: --accept "light"' in refused.out

    targets = ("-o", profile, "--html", tmp_path / "r.html")
    accepted = eldata("calibrate", tree.root, *isos, "--accept", "light", *targets)
    assert accepted.code == 0, accepted.out
    assert len(CameraProfile.load(profile).rows) == 2
    said = "light: the colour bias at ISO 100, 1600"
    assert said in CameraProfile.load(profile).accepted
    assert f"accepted {said}, with a larger error" in eldata("profile", "show", profile).out
    assert "Accepted, though a check would withhold it: light" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_a_crop(eldata: Cli, pristine: FrameTree) -> None:
    """With a minus as pages print it."""
    outcome = eldata("calibrate", pristine.root, "--iso", "100", "--crop", "0:,8:−8")
    assert (outcome.code, outcome.err) == (0, "")
    assert "rows and columns 0:,8:-8 are used, as stated" in outcome.out


# --- wrong usage ------------------------------------------------------------------------------------------------------


@in_one_test(
    "arguments, words",
    [
        (["--gain", "200=1"], "K is stated at ISO 200, of which there are no frames; there are 100, 400, 1600"),
        (["--gain", "400=x"], "expected a finite number above 0, found 'x', in '400=x'"),
        (["--mode", "none", "--mode", "400"], "--mode none says that the camera does not switch"),
        (["--accept", "coarse value"], "did you mean coarse values?"),
        (["--camera", "Sony"], f"no camera 'Sony'; there is {CAMERA}"),
        (["--root", "."], "--root says where a manifest's files lie"),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], words: str, eldata: Cli, pristine: FrameTree) -> None:
    assert_one_line(eldata("calibrate", pristine.root, *arguments), words)


# --- dark shading ---------------------------------------------------------------------------------------------------


def test_a_dark_shading(eldata: Cli, pristine: FrameTree, tmp_path: Path) -> None:
    target, data = tmp_path / "s.npz", tmp_path / "d.json"
    outcome = eldata("calibrate", pristine.root, "--mode", "none", "--dark-shading", target, "--json", data)
    assert (outcome.code, outcome.err) == (0, "")
    shading = DarkShading.load(target)
    assert f"dark shading: {target}; ISO 100, 400, 1600; " in outcome.out
    assert shading.digest in outcome.out
    assert json.loads(data.read_text(encoding="utf-8"))["dark_shading"] == json.loads(json.dumps(shading.summary()))
