"""The calibration demo, end to end with small frames, its table of errors; and the frames themselves."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eldata.demo.calibration
from eldata.base.workers import Workers
from eldata.calibration import Calibration
from eldata.cli.main import main
from eldata.demo.body import Body
from eldata.demo.calibration import compare_with_truth, run_calibration_demo
from eldata.demo.calibration_frames import DEMO_FEATURES, DEMO_GAMMA, CalibrationCamera, make_calibration_frames
from eldata.errors import ArgumentError
from eldata.manifest import verify
from eldata.manifest.catalogue import Manifest, load_manifest
from eldata.noise import CameraProfile
from eldata.raw.reading import read_raw
from eldata.records import Sensor
from tests.baselines.travelling import Travelling
from tests.calibration.draws import drawn_noise
from tests.calibration.simulation import XTRANS
from tests.shared import there

ISOS = (100, 400, 1600)
SMALL = partial(make_calibration_frames, isos=ISOS, bias_frames=6, flat_levels=4, size=(256, 384))


def page(found: Calibration) -> str:
    """In place of the real page, which takes seconds and has its own tests."""
    return f'<!DOCTYPE html><meta name="generator" content="eldata calibration">{found.camera}\n{found.format_text()}'


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(eldata.demo.calibration, "make_calibration_frames", SMALL)
        patch.setattr(eldata.demo.calibration, "calibration_page", page)
        patch.setattr("eldata.reports.calibration.calibration_page", page)
        yield


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Calibration, str]:
    """Folder, result, and what was printed; over an earlier demo of another kind."""
    folder = tmp_path_factory.mktemp("demo")
    (folder / ".eldata-demo").write_text("x")
    (folder / "data" / "ELD-demo").mkdir(parents=True)
    with pytest.MonkeyPatch.context() as patch:
        lines: list[str] = []
        patch.setattr("builtins.print", lambda *words, **_: lines.append(" ".join(map(str, words))))
        found = run_calibration_demo(folder)
    return folder, found, "\n".join(lines)


def test_what_it_leaves(demo: tuple[Path, Calibration, str]) -> None:
    folder, found, _ = demo
    assert len(list((folder / "data").rglob("*.dng"))) == 3 * (6 + 8)
    assert CameraProfile.load(folder / "DemoGamma.json") == found.profile
    assert (folder / "calibration.html").read_text(encoding="utf-8") == page(found)
    assert not list(folder.rglob("*.part"))
    assert [path.name for path in (folder / "data").iterdir()] == ["calibration"], "nothing is left of the earlier one"


def test_what_it_prints(demo: tuple[Path, Calibration, str]) -> None:
    folder, found, out = demo
    for words in (
        "42 raw files (DNG), bias and flat-field frames of DemoGamma",
        f"$ eldata calibrate {folder / 'data' / 'calibration'} --camera DemoGamma -o {folder / 'DemoGamma.json'}",
        found.format_text(),
        compare_with_truth(found, json.loads((folder / "truth.json").read_text())),
        str(folder / "calibration.html"),
    ):
        assert words in out


def test_the_command_that_it_names_gives_the_same(demo: tuple[Path, Calibration, str], tmp_path: Path) -> None:
    """Its own line, with another target."""
    folder, found, out = demo
    line = there(re.search(r"^\$ eldata (.*)$", out, re.MULTILINE))
    arguments = line[1].replace(str(folder / "DemoGamma.json"), str(tmp_path / "p.json")).split()
    arguments[arguments.index("--html") + 1] = str(tmp_path / "r.html")
    assert main(arguments) == 0
    assert CameraProfile.load(tmp_path / "p.json") == found.profile
    assert (tmp_path / "r.html").read_bytes() == (folder / "calibration.html").read_bytes()


def test_the_table_of_errors_is_found_less_true(demo: tuple[Path, Calibration, str]) -> None:
    folder, found, _ = demo
    truth = json.loads((folder / "truth.json").read_text())
    header, _, *rows = (re.split(r"  +", line.strip()) for line in compare_with_truth(found, truth).splitlines())
    assert header == ["ISO", "K [%]", "lambda", "sigma_TL [%]", "sigma_G [%]", "sigma_row [%]", "colour bias [DN]"]
    assert len(rows) == 3
    for row, one, true in zip(rows, found.isos, truth["isos"], strict=True):
        assert one.transfer is not None
        read, lines = one.read, one.rows.rows
        assert read is not None
        assert row[0] == f"{true['iso']}"
        for cell, value, known, error in (
            (row[1], one.transfer.gain_dn_per_e, true["gain_dn_per_e"], one.transfer.gain_error),
            (row[3], read.sigma_tl_dn, true["sigma_tl_dn"], read.sigma_tl_error_dn),
            (row[4], read.sigma_gauss_dn, true["sigma_gauss_dn"], read.sigma_gauss_error_dn),
            (row[5], lines.sigma_dn, true["sigma_row_dn"], lines.sigma_error_dn),
        ):
            percent, errors = map(float, re.fullmatch(r"(\S+) \((\S+)\)", cell).groups())  # type: ignore[union-attr] # it is one
            assert percent == pytest.approx(100 * (value - known) / known, abs=0.006)
            assert errors == pytest.approx((value - known) / error, abs=0.06)
            assert abs(errors) < 5
        shape, errors = map(float, re.fullmatch(r"(\S+) \((\S+)\)", row[2]).groups())  # type: ignore[union-attr] # it is one
        assert shape == pytest.approx(read.tukey_lambda - true["tukey_lambda"], abs=6e-5)
        assert errors == pytest.approx((read.tukey_lambda - true["tukey_lambda"]) / read.tukey_lambda_error, abs=0.06)
        offsets = zip(one.bias.bias_dn, true["colour_bias_with_pattern_dn"], strict=True)
        largest = max((value - known for value, known in offsets), key=abs)
        assert float(row[6]) == pytest.approx(largest, abs=6e-4)


# --- the frames, and the truth beside them ----------------------------------------------------------------------------

SIZE = (64, 96)
TWO_ISOS = (100, 800)
FEW: dict[str, Any] = {"isos": TWO_ISOS, "bias_frames": 3, "flat_levels": 3, "size": SIZE}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Manifest]:
    folder = tmp_path_factory.mktemp("calibration") / "new"
    return folder, make_calibration_frames(folder, **FEW, workers=Workers(executor=Travelling()))


@pytest.fixture(scope="module")
def truth(simulated: tuple[Path, Manifest]) -> dict[str, Any]:
    read: dict[str, Any] = json.loads((simulated[0] / "truth.json").read_text())
    return read


# --- files ----------------------------------------------------------------------------------------------------------


def test_the_manifest(simulated: tuple[Path, Manifest]) -> None:
    folder, manifest = simulated
    assert load_manifest(folder / "manifests" / "calibration-demo.csv") == manifest
    report = verify([manifest], folder / "data", level="full")
    assert report.ok
    assert report.datasets[0].files_checked == 18
    assert manifest.name == "calibration-demo"
    assert manifest.folder(folder / "data") == folder / "data" / "calibration"
    assert manifest.card.counts == {"bias": 6, "flat": 12}
    assert manifest.card.cfa == "bayer"
    for record in manifest.records:
        assert record.path.startswith(f"DemoGamma/{record.role}/ISO{record.iso}/")
        assert (record.height, record.width) == SIZE


def test_each_frame_has_its_own_seed(simulated: tuple[Path, Manifest], truth: dict[str, Any]) -> None:
    """The specimen is [seed, 0]; the frames of the ISO at index i are [seed, 1 + i, 0, 1, ...], bias then flats."""
    folder = simulated[0] / "data" / "calibration" / "DemoGamma"
    sensor = replace(DEMO_GAMMA.sensor, height=SIZE[0], width=SIZE[1])
    body, noise = Body(sensor, DEMO_FEATURES, np.random.default_rng([0, 0])), DEMO_GAMMA.noise_at(800)
    level = truth["isos"][1]["flats"][2]["mean_level_dn"] / truth["mean_light"]
    for path, frame in (
        ("bias/ISO800/IMG_0005.dng", body.bias_frame(noise, np.random.default_rng([0, 2, 1]))),
        ("flat/ISO800/IMG_0018.dng", body.flat_frame(noise, level, np.random.default_rng([0, 2, 8]))),
    ):
        np.testing.assert_array_equal(read_raw(folder / path).mosaic, frame)


# --- exposures ------------------------------------------------------------------------------------------------------


def exposures(manifest: Manifest, role: str, iso: int) -> list[Fraction]:
    chosen = [record for record in manifest.records if record.role == role and record.iso == iso]
    return [record.exposure_s for record in chosen if record.exposure_s is not None]


@pytest.mark.parametrize("levels", [2, 13])
def test_levels_from_5_to_80_percent_under_one_lamp(levels: int, tmp_path: Path) -> None:
    """At every ISO that the camera knows; time x K in proportion to the level."""
    isos = tuple(noise.iso for noise in DEMO_GAMMA.noise)
    options = {**FEW, "isos": isos, "bias_frames": 1, "flat_levels": levels, "size": (32, 48)}
    make_calibration_frames(tmp_path, **options)
    truth = json.loads((tmp_path / "truth.json").read_text())
    span = 16383 - 512
    lamp = truth["lamp_e_per_s"] * truth["mean_light"]
    for entry in truth["isos"]:
        shares = [flat["mean_level_dn"] / span for flat in entry["flats"]]
        assert len(shares) == levels
        assert shares == sorted(set(shares))
        assert shares[0] == pytest.approx(0.05, rel=0.05)
        assert shares[-1] == pytest.approx(0.8, rel=0.03)
        for flat in entry["flats"]:
            light = lamp * float(Fraction(flat["exposure_s"])) * entry["gain_dn_per_e"]
            assert flat["mean_level_dn"] == pytest.approx(light)


# --- other cameras ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cfa", "black", "white"),
    [(((3, 2), (0, 1)), (1022.0, 1023.0, 1024.0, 1022.0), 15303.0), (XTRANS, (2048.0,) * 3, 16383.0)],
)
def test_drawn_cameras(cfa: Any, black: tuple[float, ...], white: float, tmp_path: Path) -> None:
    sensor = Sensor("eldata", "Drawn", cfa, black, white, 1026, 1536)
    camera = CalibrationCamera("Drawn", sensor, drawn_noise(np.random.default_rng(3), (200, 3200), len(black)))
    options = {**FEW, "isos": (200, 3200), "bias_frames": 1, "size": (66, 96)}
    manifest = make_calibration_frames(tmp_path, camera=camera, **options)
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert manifest.card.cfa == ("xtrans" if len(camera.sensor.cfa) == 6 else "bayer")
    assert verify([manifest], tmp_path / "data", level="full").ok
    path = manifest.folder(tmp_path / "data") / manifest.records[0].path
    sensor = read_raw(path).sensor
    assert (sensor.cfa, sensor.white_level_dn) == (camera.sensor.cfa, camera.sensor.white_level_dn)
    assert sensor.black_level_dn == camera.sensor.black_level_dn
    span = camera.sensor.white_level_dn - max(camera.sensor.black_level_dn)
    for entry in truth["isos"]:
        assert 0.6 < entry["flats"][-1]["mean_level_dn"] / span < 0.83


# --- arguments --------------------------------------------------------------------------------------------------------


def test_gains_too_far_apart_for_the_shutter(tmp_path: Path) -> None:
    far = replace(DEMO_GAMMA.noise_at(800), iso=409600, gain_dn_per_e=0.095 * 4096)
    camera = replace(DEMO_GAMMA, noise=(*DEMO_GAMMA.noise, far))
    with pytest.raises(ArgumentError, match="ISO 409600 would need exposures below 1/8000 s"):
        make_calibration_frames(tmp_path, **{**FEW, "isos": (409600,)}, camera=camera)
