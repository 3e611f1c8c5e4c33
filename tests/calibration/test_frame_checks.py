"""Frames that cannot be calibrated from are found and named, each by its file; good frames are left in peace."""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata import calibrate
from eldata.base.workers import Workers
from eldata.calibration import FramesError, IsoCalibration
from eldata.calibration.checks import code_step, mean_step
from eldata.calibration.frames import odd_bias_frames, odd_sensors, sort_frames
from eldata.calibration.one_iso import decodings
from eldata.errors import DatasetError
from eldata.manifest.table import load_records, save_records
from eldata.manifest.verify_report import Problem
from eldata.records import FrameRecord, Role, Sensor
from tests.calibration.simulation import BAYER, Body, Camera
from tests.calibration.trees import FrameTree, calibrated_iso, make_tree, problems_of, relative, rewritten
from tests.cases import in_one_test
from tests.shared import there


def assert_said(problems: Sequence[Problem], field: str, words: list[str]) -> None:
    """One of them is of the field, and says all of it."""
    (problem,) = (problem for problem in problems if problem.field == field)
    assert [word for word in words if word not in str(problem)] == []


# --- good frames ----------------------------------------------------------------------------------------------------


def test_good_frames_have_no_problem_and_few_remarks(pristine: FrameTree) -> None:
    """What is said of these frames is true."""
    assert problems_of(pristine.frames(manifest=pristine.manifest)) == []
    said = calibrated_iso(pristine.frames(), 100).remarks
    assert tuple(remark for remark in said if " defects make " not in remark) == (
        "5 bias frames were used; 10 or more are advised",
        "K comes from 3 pairs of flats; 4 levels or more are advised",
    )


def test_good_frames_are_sorted_out(pristine: FrameTree) -> None:
    """Against the manifest, which the simulator wrote."""
    rows = load_records(pristine.manifest)
    for one in sort_frames(pristine.frames(), Workers(1)):
        bias = [row for row in rows if row.role == "bias" and row.iso == one.iso]
        flats = [row for row in rows if row.role == "flat" and row.iso == one.iso]
        assert [record.path for record in one.bias] == [row.path for row in bias]
        assert one.bias_exposure_s == bias[0].exposure_s == Fraction(1, 8000)
        assert one.single == ()
        assert [record.path for pair in one.pairs for record in (pair.first, pair.second)] == [r.path for r in flats]
        assert [pair.first.exposure_s for pair in one.pairs] == [row.exposure_s for row in flats[::2]]
        assert decodings(one) == 2 * 5 + 1 + 6


# --- headers ----------------------------------------------------------------------------------------------------------


def leading_outside(path: Path) -> None:
    outside = path.parents[5] / "outside.dng"
    path.rename(outside)
    path.symlink_to(outside)


HEADERS: dict[str, tuple[Callable[[Path], object], str, list[str]]] = {
    "not raw": (lambda path: path.write_bytes(b"a text\n" * 100), "content", ["a whole raw file"]),
    "other model": (partial(rewritten, model="Another"), "camera", ["Demo Gamma", "Another", "its own camera"]),
    "other ISO": (partial(rewritten, iso=Fraction(200)), "iso", ["200", "folder"]),
    "no exposure time": (partial(rewritten, exposure_s=None), "exposure", ["no exposure time", "lost its EXIF"]),
    "other time": (
        partial(rewritten, exposure_s=Fraction(1, 4)),
        "exposure_s",
        ["1/8000 s like the other bias frames of ISO 1600", "1/4 s"],
    ),
    "link": (leading_outside, "content", ["leads outside"]),
}


def test_headers(tree: FrameTree) -> None:
    """All at once, of both ISOs and roles."""
    files = [
        *(path for iso in (100, 1600) for path in tree.files("flat", iso)[1:3]),
        tree.files("bias", 100)[0],
        tree.files("bias", 1600)[4],
    ]
    spoilt = dict(zip(files, sorted(HEADERS, key="other time".__eq__), strict=True))
    expected = {relative(tree, path): HEADERS[name] for path, name in spoilt.items()}
    for path, name in spoilt.items():
        HEADERS[name][0](path)
    with pytest.raises(FramesError) as raised:
        calibrate(tree.root, isos=[100, 1600], workers=2)
    problems = raised.value.problems
    assert [problem.path for problem in problems] == sorted(expected)
    for problem in problems:
        assert problem.dataset == "DemoGamma"
        assert_said([problem], *expected[problem.path][1:])
    assert str(raised.value) == f"{problems[0]} (and {len(files) - 1} more problems)"
    assert pickle.loads(pickle.dumps(raised.value)).problems == problems


def test_the_manifests_exposure(tree: FrameTree) -> None:
    """A tenth off is a rounded name (1/13 for 1/12.5), more is another frame."""
    rows = load_records(tree.manifest)
    chosen = next(index for index, row in enumerate(rows) if row.role == "flat")
    for factor, found in ((Fraction(15, 14), []), (Fraction(2), [rows[chosen].path])):
        time = rows[chosen].exposure_s
        assert time is not None
        save_records(
            tree.manifest, [*rows[:chosen], replace(rows[chosen], exposure_s=time * factor), *rows[chosen + 1 :]]
        )
        frames = tree.frames(manifest=tree.manifest, isos=[100])
        problems = [problem for one in sort_frames(frames) for problem in one.problems]
        assert [problem.path for problem in problems] == found
        assert {problem.field for problem in problems} <= {"exposure_s"}


# --- pixels -----------------------------------------------------------------------------------------------------------


def noisier(mosaic: NDArray[np.uint16]) -> NDArray[np.uint16]:
    level = mosaic.mean()
    return np.asarray(np.rint(level + 3 * (mosaic - level)), dtype=np.uint16)


PIXELS: dict[str, tuple[Callable[[Path], None], str, list[str]]] = {
    "light": (partial(rewritten, mosaic=lambda dn: dn + np.uint16(300)), "level", ["lens without its cap"]),
    "noise of another ISO": (partial(rewritten, mosaic=noisier), "noise", ["DN as in the others"]),
    "size": (partial(rewritten, mosaic=lambda dn: dn[:-2]), "height", ["256 as in DemoGamma/bias/ISO100/", "254"]),
    "CFA phase": (partial(rewritten, cfa=((1, 0), (2, 3))), "cfa", ["((0, 1), (3, 2))", "((1, 0), (2, 3))"]),
    "black level": (partial(rewritten, black_level_dn=(500.0,) * 4), "black_level_dn", ["512", "500"]),
}


@pytest.mark.parametrize(("name", "place"), list(zip(PIXELS, (0, 3, 5, 0, 3), strict=True)))
def test_bias_frames(name: str, place: int, tree: FrameTree) -> None:
    """The odd one is named: the first one, one in the middle, or the one that is kept out."""
    path = tree.files("bias", 100)[place]
    PIXELS[name][0](path)
    problems = problems_of(tree.frames(isos=[100]))
    assert {problem.path for problem in problems} == {relative(tree, path)}
    assert_said(problems, *PIXELS[name][1:])


def copied(tree: FrameTree, role: Role, source: int, copy: int, gone: slice) -> tuple[IsoCalibration, IsoCalibration]:
    """Calibrate with a copy of one frame in the place of another, and without some; the copy is named."""
    files = tree.files(role, 100)
    shutil.copy(files[source], files[copy])
    found = calibrated_iso(tree.frames(isos=[100]), 100)
    text = f"{relative(tree, files[copy])} has the same pixels as {relative(tree, files[source])} and was left out"
    assert any(remark.startswith(text) for remark in found.all_remarks)
    for path in files[gone]:
        path.unlink()
    return found, calibrated_iso(tree.frames(isos=[100]), 100)


@pytest.mark.parametrize(("index", "used", "compared"), [(1, 4, True), (5, 5, False)], ids=["one", "last"])
def test_copies_of_bias_frames_are_left_out(index: int, used: int, compared: bool, tree: FrameTree) -> None:
    """The last of six is kept out to compare with, unless it is a copy; then all that are left are used."""
    found, without = copied(tree, "bias", 0, index, slice(index, index + 1))
    assert found.findings == ()
    assert found.bias_frames == used
    assert (found.reproduction is not None) == compared
    if not compared:
        assert there(found.read).tukey_lambda == there(without.read).tukey_lambda
        assert found.rows.rows.sigma_dn == without.rows.rows.sigma_dn


def test_a_copy_of_a_flat_leaves_its_pair_out(tree: FrameTree) -> None:
    found, without = copied(tree, "flat", 2, 3, slice(2, 4))
    assert found.gain == without.gain
    assert there(found.transfer).frames == 4


# --- by itself --------------------------------------------------------------------------------------------------------


RECORD = FrameRecord(path="C/bias/ISO100/1.dng", role="bias", camera="C")
SENSOR = Sensor("Make", "Model", BAYER, (512.0,) * 4, 16383.0, 256, 384)


def test_most_frames_are_right() -> None:
    records = [replace(RECORD, path=f"{number}.dng") for number in range(5)]
    small = replace(SENSOR, height=254)
    for odd in range(5):
        sensors = {record: small if index == odd else SENSOR for index, record in enumerate(records)}
        assert [problem.path for problem in odd_sensors(sensors)] == [f"{odd}.dng"]
    sensors = dict(zip(records, (small, SENSOR, small, SENSOR, small), strict=True))
    assert [(problem.path, problem.found) for problem in odd_sensors(sensors)] == [("1.dng", "256"), ("3.dng", "256")]
    assert odd_sensors(dict.fromkeys(records, SENSOR)) == odd_sensors({}) == []


def figures(*levels: float, spread: float = 5.0) -> dict[FrameRecord, tuple[float, float]]:
    return {replace(RECORD, path=str(index)): (level, spread) for index, level in enumerate(levels)}


def test_levels_may_drift() -> None:
    """As a sensor warms up: by a DN, by half the noise, or as the others do."""
    assert odd_bias_frames(figures(512, 512.2, 512.4, 512.6, 513)) == []
    assert odd_bias_frames(figures(512, 512, 512, 512, 514.4)) == []
    assert odd_bias_frames(figures(512, 515, 518, 521, 524, 527)) == []
    assert [problem.path for problem in odd_bias_frames(figures(512, 512, 512, 512, 514.6))] == ["4"]
    assert [problem.path for problem in odd_bias_frames(figures(506, 512, 512.1, 512, 512.3, 530))] == ["0", "5"]
    assert odd_bias_frames({}) == []
    spread = figures(512, 512, 512, 512)
    spread[list(spread)[2]] = 512, 6.5
    assert [problem.field for problem in odd_bias_frames(spread)] == ["noise"]


# --- gaps -------------------------------------------------------------------------------------------------------------


def step_of(frame: NDArray[np.uint16]) -> float:
    """The mean step of a Bayer frame's values."""
    sites = [frame[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    return mean_step(np.stack([np.bincount(site.ravel(), minlength=65536) for site in sites]))


def sony_curve(values: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Steps of 1, 2, 4, 8 DN in four parts of the range: the shape of Sony's 11-bit curve."""
    codes = np.concatenate([[0], np.cumsum(np.repeat([1, 2, 4, 8], [2000, 1000, 1000, 1024]))])
    return np.asarray(codes[np.searchsorted(codes, np.minimum(values, codes[-1]), side="right") - 1], dtype=np.uint16)


@in_one_test("step, sigma", [(1, 0.5), (2, 1.0), (3, 0.5), (4, 6.0), (16, 1.0)])
def test_the_step_of_the_values(step: int, sigma: float) -> None:
    """Hot pixels do not hide it, nor one that the camera has made up; one channel may have another offset."""
    camera = Camera(shape=(258, 384), sigma_tl=max(sigma, step / 4), hot_share=1e-3, column_pattern=2.0)
    frame = Body(camera, np.random.default_rng(6)).bias_frame()
    coarse = (np.rint(frame / step) * step).astype(np.uint16)
    coarse[4, 5] += 1  # made up by the camera
    codes = np.stack([np.bincount(rows.ravel(), minlength=65536) for rows in (coarse[::2], coarse[1::2] + 1)])
    assert code_step(codes) == step
    assert code_step(np.bincount(np.full(10**6, 512), minlength=65536)[None]) == 0, "not known"


def test_a_curve_leaves_gaps_where_it_is_steep() -> None:
    body = Body(Camera(shape=(1024, 1536), gain=0.2), np.random.default_rng(4))
    assert step_of(sony_curve(body.bias_frame())) == 1
    for level, step in ((3000.0, 2), (5200.0, 4), (9000.0, 8)):
        assert step_of(sony_curve(body.flat_frame(level, shaded=False))) == pytest.approx(step, rel=0.1)


def test_lossy_compression_is_remarked_on(tree: FrameTree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eldata.calibration.one_iso.lossy_compression", lambda path: f"loss in {path.name}")
    remarks = calibrated_iso(tree.frames(isos=[100]), 100).remarks
    first = tree.files("bias", 100)[0].name
    assert f"the files have loss in {first}, which changes noise: no figure here is the sensor's own" in remarks


# --- borders without picture ----------------------------------------------------------------------------------------


def test_a_border_is_left_out_and_named_once(tmp_path: Path) -> None:
    """13 columns at the left and 9 rows at the bottom: the figures are to the bit those of the frames without them."""
    tree, inner = make_tree(tmp_path / "tree", isos=(1600,), size=(272, 400)), np.s_[:-9, 13:]
    expected = calibrate(tree.frames(), crop=inner)
    for value in (0, 512):

        def bordered(dn: NDArray[np.uint16], value: int = value) -> NDArray[np.uint16]:
            return np.pad(dn[inner], ((0, 9), (13, 0)), constant_values=value)

        for path in tree.camera.rglob("*.dng"):
            rewritten(path, mosaic=bordered)
        found = calibrate(tree.frames())
        assert (found.isos[0].sensor.height, found.isos[0].sensor.width) == (263, 387)
        assert found.isos[0].as_dict() == expected.isos[0].as_dict()
        said = "rows and columns :-9,13: are used, around them there is no picture (--crop states another area)"
        assert [remark for remark in found.all_remarks if "picture" in remark] == [said]
    rewritten(tree.files("bias", 1600)[2], mosaic=lambda mosaic: np.vstack([mosaic[:8], mosaic]))
    with pytest.raises(FramesError, match=r"height: expected 263 as in .*, found 271"):  # not cut to one size
        calibrate(tree.frames())
    with pytest.raises(DatasetError, match=r"crop 900:,: leaves nothing of \(272, 400\)"):
        calibrate(tree.frames(), crop=np.s_[900:, :])
