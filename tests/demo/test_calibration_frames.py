from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.base.workers import Workers
from eldata.demo.body import Body, FixedFeatures
from eldata.demo.calibration_frames import DEMO_FEATURES, DEMO_GAMMA, make_calibration_frames
from eldata.errors import ArgumentError
from eldata.manifest import verify
from eldata.manifest.catalogue import load_manifest
from eldata.raw.reading import read_raw
from tests.baselines.travelling import Travelling
from tests.calibration import draws

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.demo.calibration_frames import CalibrationCamera
    from eldata.manifest.catalogue import Manifest

SIZE = (64, 96)
ISOS = (100, 800)
SMALL: dict[str, Any] = {"isos": ISOS, "bias_frames": 3, "flat_levels": 3, "size": SIZE}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Manifest]:
    folder = tmp_path_factory.mktemp("calibration") / "new"
    return folder, make_calibration_frames(folder, **SMALL, workers=Workers(executor=Travelling()))


@pytest.fixture(scope="module")
def truth(made: tuple[Path, Manifest]) -> dict[str, Any]:
    read: dict[str, Any] = json.loads((made[0] / "truth.json").read_text())
    return read


# --- files ----------------------------------------------------------------------------------------------------------


def test_the_manifest(made: tuple[Path, Manifest]) -> None:
    folder, manifest = made
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


def test_each_frame_has_its_own_seed(made: tuple[Path, Manifest], truth: dict[str, Any]) -> None:
    """The specimen is [seed, 0]; the frames of the ISO at index i are [seed, 1 + i, 0, 1, ...], bias then flats."""
    folder = made[0] / "data" / "calibration" / "DemoGamma"
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
    options = {**SMALL, "isos": isos, "bias_frames": 1, "flat_levels": levels, "size": (32, 48)}
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


# --- truth ----------------------------------------------------------------------------------------------------------


def test_the_truth_is_complete(truth: dict[str, Any]) -> None:
    assert (truth["camera"], truth["seed"], truth["bias_frames"]) == ("DemoGamma", 0, 3)
    assert (truth["height"], truth["width"]) == SIZE
    assert truth["cfa"] == [[0, 1], [3, 2]]
    assert (truth["black_level_dn"], truth["white_level_dn"]) == ([512.0] * 4, 16383.0)
    assert FixedFeatures(**truth["features"]) == DEMO_FEATURES
    assert truth["bias_exposure_s"] == "0.000125"
    assert [entry["iso"] for entry in truth["isos"]] == list(ISOS)
    sensor = replace(DEMO_GAMMA.sensor, height=SIZE[0], width=SIZE[1])
    body = Body(sensor, DEMO_FEATURES, np.random.default_rng([0, 0]))
    assert truth["hot_pixels"] == body.hot.sum()
    for entry in truth["isos"]:
        noise = DEMO_GAMMA.noise_at(entry["iso"])
        stated = {**asdict(noise), "colour_bias_dn": list(noise.colour_bias_dn)}
        assert {key: entry[key] for key in stated} == stated
        assert entry["sigma_gauss_dn"] == noise.sigma_gauss_dn
        assert entry["pattern_scale"] == math.sqrt(noise.gain_dn_per_e)
        assert entry["colour_bias_with_pattern_dn"] == list(body.colour_bias_dn(noise))


# --- other cameras ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", [draws.drawn_bayer, draws.drawn_xtrans])
def test_drawn_cameras(draw: Any, tmp_path: Path) -> None:
    camera: CalibrationCamera = draw(np.random.default_rng(3), (200, 3200))
    options = {**SMALL, "isos": (200, 3200), "bias_frames": 1, "size": (66, 96)}
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
        make_calibration_frames(tmp_path, **{**SMALL, "isos": (409600,)}, camera=camera)
