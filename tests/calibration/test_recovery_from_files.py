"""The truth comes back from DNG files, through the whole chain: decoding, checks, estimators, profile.

Tolerances are those of issue 4 (K 1 %, sigma_row 3 %, colour bias 0.05 DN, lambda 0.02 and sigma_TL 1 % from 1 DN on),
or five of the standard errors that the calibration reports where these are larger, which says what is attainable.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata import calibrate
from eldata.base.workers import Workers
from eldata.demo.body import FixedFeatures, KnownNoise
from eldata.demo.calibration_frames import DEMO_FEATURES, DEMO_GAMMA, CalibrationCamera
from eldata.noise import CameraProfile
from tests.calibration import draws
from tests.calibration.trees import made_tree

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eldata.calibration import IsoCalibration
    from tests.calibration.trees import FrameTree

ERRORS = 5


def bias_error_dn(one: IsoCalibration, true: dict[str, Any]) -> float:
    """Standard error of a channel's mean over all frames, from the truth: its rows' offsets, its pixels' noise.

    Bayer: each channel is in half of the rows and a quarter of the pixels; of X-Trans, blue and red in two thirds of
    the rows. The fixed pattern adds nothing: the truth is that of the specimen.
    """
    rows, pixels = one.sensor.height / 2, one.pattern.pixels / 5
    variance = true["sigma_row_dn"] ** 2 / rows + (true["sigma_gauss_dn"] ** 2 + 1 / 12) / pixels
    return math.sqrt(variance / one.bias_frames)


def assert_recovered(tree: FrameTree, isos: Sequence[IsoCalibration]) -> None:
    truth = tree.truth["isos"]
    assert [one.iso for one in isos] == [true["iso"] for true in truth]
    for one, true in zip(isos, truth, strict=True):
        assert one.transfer is not None
        read, rows = one.read, one.rows.rows
        gain = true["gain_dn_per_e"]
        assert one.transfer.gain_dn_per_e == pytest.approx(gain, rel=0.01)
        assert abs(one.transfer.gain_dn_per_e - gain) < ERRORS * one.transfer.gain_error

        row = true["sigma_row_dn"]
        assert abs(rows.sigma_dn - row) < max(0.03 * row, ERRORS * rows.sigma_error_dn)
        assert abs(rows.sigma_dn - row) < ERRORS * rows.sigma_error_dn

        offsets = true["colour_bias_with_pattern_dn"]
        for found, offset in zip(one.bias.bias_dn, offsets, strict=True):
            assert abs(found - offset) < max(0.05, ERRORS * bias_error_dn(one, true))

        lambda_error, scale = abs(read.tukey_lambda - true["tukey_lambda"]), true["sigma_tl_dn"]
        sigma_error = abs(read.sigma_tl_dn - scale)
        assert lambda_error < ERRORS * read.tukey_lambda_error
        assert sigma_error < ERRORS * read.sigma_tl_error_dn
        assert lambda_error < 0.02
        assert sigma_error < 0.01 * scale
        # sigma_gauss is that of what was recorded: noise that reaches 0 is cut off there.
        if min(one.sensor.black_level_dn) > 15 * true["sigma_gauss_dn"]:
            assert abs(read.sigma_gauss_dn - true["sigma_gauss_dn"]) < 6 * read.sigma_gauss_error_dn


# --- six megapixels ---------------------------------------------------------------------------------------------------

# Over the shipped ranges: K 0.09 to 29 DN/e-, lambda -0.24 to 0.2, sigma_TL 0.6 to 35 DN, sigma_row 0.1 to 4.2 DN,
# colour bias -2.9 to 6.1 DN (tests.calibration.draws). At ISO 100, sigma_TL is below 1 DN.
SPAN = CalibrationCamera(
    name="Span",
    sensor=replace(DEMO_GAMMA.sensor, model="Span", black_level_dn=(2047.0, 2048.0, 2049.0, 2048.0)),
    noise=(
        KnownNoise(100, 0.09, 0.12, 0.65, 0.12, (1.4, 1.2, 1.6, 1.3)),
        KnownNoise(800, 0.75, 0.2, 1.6, 0.3, (-2.9, -2.1, -2.6, -2.3)),
        KnownNoise(6400, 5.8, -0.1, 6.0, 0.85, (2.5, 3.1, 6.1, 2.9)),
        KnownNoise(25600, 27.0, -0.24, 33.0, 4.0, (0.5, -1.9, 1.4, -0.6)),
    ),
)


@pytest.mark.study
def test_six_megapixels(tmp_path: Path) -> None:
    """2 ISOs x 10 bias + 10 flats of 2048 x 3072 pixels, with shading, hot pixels and every fixed pattern.

    Nine bias frames are used, one is kept out. Standard errors by calculation: sigma_row 0.55 % of itself at best
    (16,368 degrees of freedom) and 0.67 % here, so 3 % is four of them and more. Colour bias: 1024 rows a channel, so
    sigma_row / sqrt(9216), 0.01 sigma_row: 0.05 DN is five of them up to a sigma_row of 1 DN; above, five count.
    """
    isos = (SPAN.noise[0].iso, SPAN.noise[-1].iso)
    tree = made_tree(
        tmp_path / "x", camera=SPAN, isos=isos, bias_frames=10, flat_levels=5, size=(2048, 3072), workers=Workers(2)
    )
    found = calibrate(tree.root, workers=2)
    assert_recovered(tree, found.isos)
    truth = tree.truth["isos"]
    for one, true in zip(found.isos, truth, strict=True):
        assert one.transfer is not None
        assert one.transfer.gain_error < 0.001 * true["gain_dn_per_e"]
        assert one.rows.rows.sigma_error_dn < 0.03 / 4 * true["sigma_row_dn"]
        assert one.read.tukey_lambda_error < 0.0005
        assert one.read.sigma_tl_error_dn < 0.0005 * true["sigma_tl_dn"]
        if true["sigma_row_dn"] < 1:
            for bias, offset in zip(one.bias.bias_dn, true["colour_bias_with_pattern_dn"], strict=True):
                assert abs(bias - offset) < 0.05
        assert one.pattern.defects == pytest.approx(tree.truth["hot_pixels"], rel=0.35)
        assert one.reproduction is not None
        assert one.reproduction.histogram_distance < 2.5 * one.reproduction.histogram_distance_by_chance
        assert one.remarks == ()
    found.profile.save(tmp_path / "p.json")
    assert len(CameraProfile.load(tmp_path / "p.json").rows) == 2


# --- cameras at random ------------------------------------------------------------------------------------------------

EVERYTHING = replace(DEMO_FEATURES, hot_share=5e-4)
FEATURES = {
    "everything": EVERYTHING,
    "nothing": FixedFeatures(),
    "shading alone": FixedFeatures(bias_shading_dn=1.0, vignetting=0.5),
    "without shading": replace(EVERYTHING, bias_shading_dn=0.0, vignetting=0.0),
    "without hot pixels": replace(EVERYTHING, hot_share=0.0),
    "without fixed pattern": replace(EVERYTHING, prnu=0.0, dsnu_dn=0.0, column_pattern_dn=0.0),
}


@pytest.mark.study
@pytest.mark.parametrize(
    ("kind", "features"),
    [*(("bayer", features) for features in FEATURES), ("xtrans", "everything"), ("xtrans", "nothing")],
)
def test_random_cameras(kind: str, features: str, tmp_path: Path) -> None:
    """Three ISOs x 10 bias + 8 flats of 0.3 megapixels; every case is another camera."""
    seed = 10 * list(FEATURES).index(features) + len(kind)
    generator = np.random.default_rng(seed)
    isos = tuple(sorted(generator.choice([100, 200, 400, 800, 1600, 3200, 6400, 12800], 3, replace=False).tolist()))
    camera = (draws.drawn_bayer if kind == "bayer" else draws.drawn_xtrans)(generator, isos)
    tree = made_tree(
        tmp_path / "x",
        camera=camera,
        isos=isos,
        bias_frames=10,
        flat_levels=4,
        size=(450, 660),
        seed=seed,
        features=FEATURES[features],
    )
    found = calibrate(tree.root, workers=2)
    assert_recovered(tree, found.isos)
    assert len(found.profile.rows) == 3


def test_below_what_rounding_lets_through(tmp_path: Path) -> None:
    """sigma_TL of 0.15 DN, 0.27 DN of noise: the reported errors say how much of the shape is left."""
    noise = KnownNoise(100, 0.1, 0.0, 0.15, 0.05, (1.3, 1.2, 1.4, 1.1))
    camera = replace(DEMO_GAMMA, noise=(noise,))
    features = FixedFeatures(dsnu_dn=1.0)  # 0.3 DN at this gain
    tree = made_tree(tmp_path / "x", camera=camera, isos=(100,), bias_frames=10, size=(512, 768), features=features)
    found = calibrate(tree.root, workers=2)
    (one,) = found.isos
    read = one.read
    assert one.tukey_lambda is not None
    assert one.sigma_tl_dn is not None
    assert abs(read.tukey_lambda) < 3 * one.tukey_lambda.error
    assert abs(read.sigma_tl_dn - 0.15) < 3 * one.sigma_tl_dn.error
    assert read.sigma_gauss_dn == pytest.approx(0.15 * math.pi / math.sqrt(3), rel=0.02)
    assert one.gain_dn_per_e == pytest.approx(0.1, rel=0.01), "the gain does not suffer"
    assert abs(one.rows.rows.sigma_dn - 0.05) < ERRORS * one.rows.rows.sigma_error_dn
