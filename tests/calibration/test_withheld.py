"""What a calibration withholds where it cannot correct: noise below 0, and noise that rounding hides; K is given."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from eldata.calibration.iso_results import Finding, IsoCalibration
from tests.calibration.in_memory import calibrated, calibrated_arrays, figures_of, measured_arrays, stacked
from tests.calibration.simulation import XTRANS, Body, Camera
from tests.shared import there

# --- values that end at 0 ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("camera", "zeros"),
    [
        (Camera(black=0.0, bias=(1.5, 0.2, 0.9, -0.5), gain=2.0), (0.3, 0.6)),
        (Camera(black=0.0, bias=(9.0, 8.0, 7.0, 9.5), sigma_tl=1.7), (1e-3, 0.05)),
        (Camera(black=0.0, bias=(0.6, 0.6, 0.6), cfa=XTRANS, sigma_tl=0.5), (0.2, 0.6)),
        (Camera(black=0.0, bias=(40.0,) * 4, sigma_tl=14.0, tukey_lambda=-0.2), (0.02, 0.2)),
    ],
    ids=["half", "a tail", "X-Trans", "loud"],
)
def test_noise_below_0_is_withheld_and_k_is_not(camera: Camera, zeros: tuple[float, float]) -> None:
    """Eight bias frames and four pairs of 258 x 384 pixels; K within five of its errors."""
    camera = camera.with_(shape=(258, 384))
    body = Body(camera, np.random.default_rng(9))
    flats = body.flat_pairs((1500.0, 5000.0, 9000.0, 12000.0), shaded=False)
    found = calibrated_arrays(camera.sensor, body.bias_frames(8), flats)
    (said,) = found.findings
    assert (said.check, said.effect) == ("clipped black", "withheld")
    assert found.withheld == {"shape", "read noise", "row noise", "colour bias"}
    assert zeros[0] < said.statistic < zeros[1]
    assert f"values end at 0 DN, where {100 * said.statistic:.2g} % of the bias frames' values lie" in said.text
    assert (found.read, found.plot, found.parameters, found.reproduction) == (None,) * 4
    assert (found.tukey_lambda, found.sigma_tl_dn, found.sigma_gauss_dn, found.sigma_row_dn) == (None,) * 4
    assert found.colour_bias is None
    assert abs(there(found.gain).value - camera.gain) < 5 * there(found.gain).error < 0.1 * camera.gain


@pytest.mark.parametrize("floor", [1, 505, 508, 512])
def test_noise_that_ends_at_any_value_is_withheld(floor: int) -> None:
    """Recorded values end at 1 DN, or near black, which before gave a colour bias that was off by up to 250 errors."""
    below = 512.0 if floor > 1 else 1.0
    camera = Camera(shape=(258, 384), black=below, bias=(0.05,) * 4, sigma_tl=2.0)
    body = Body(camera, np.random.default_rng(9))
    bias = [np.maximum(frame, floor) for frame in body.bias_frames(8)]
    flats = [tuple(np.maximum(flat, floor) for flat in pair) for pair in body.flat_pairs((1500.0, 5000.0, 9000.0))]
    bias[3][5, 7] = 0  # a broken pixel
    found = calibrated_arrays(camera.sensor, bias, flats)  # type: ignore[arg-type] # pairs
    (said,) = found.findings
    assert (said.check, found.colour_bias) == ("clipped black", None)
    assert f"values end at {floor} DN" in said.text
    assert abs(there(found.gain).value - 1) < 5 * there(found.gain).error < 0.1


@pytest.mark.parametrize("deviation", [0.25, 0.4, 3.0])
@pytest.mark.parametrize("level", [0.0, 0.3, 0.5])
def test_narrow_noise_is_no_clip(deviation: float, level: float) -> None:
    """Of pixels of one level, in steps of a DN and of four: its two ends are alike."""
    camera = quiet(deviation, 0.0, dsnu=0.0, column_pattern=0.0, bias=(level,) * 4)
    for step in (1, 4):
        frames = Body(camera, np.random.default_rng(3)).bias_frames(6)
        assert stacked(camera, [step * frame for frame in frames]).floor_dn is None


def test_bias_frames_without_noise_cost_an_iso_its_k_no_more() -> None:
    """All 0, or one value: before, the flats went with them."""
    camera = Camera(shape=(258, 384), dsnu=0.0)
    flats = Body(camera, np.random.default_rng(9)).flat_pairs((1500.0, 5000.0, 9000.0))
    for value in (0, 512):
        bias = np.full((6, *camera.shape), value, dtype=np.uint16)
        bias[1::2, :1, :400] += 1  # not copies
        found = measured_arrays(camera.sensor, list(bias), flats)
        assert not isinstance(found, IsoCalibration)
        assert abs(there(found.gain).value - 1) < 5 * there(found.gain).error
        assert found.withheld == {"shape", "read noise", "row noise", "colour bias"}
        assert "have one value in every frame" in found.why("shape")


@pytest.mark.parametrize("above", [4.5, 6.0])
def test_black_near_0_that_is_not_reached_is_no_clip(above: float) -> None:
    """Four frames whose noise, nearly Gaussian, ends above 0: so many standard deviations; two million residuals."""
    camera = Camera(shape=(512, 768), tukey_lambda=0.14, sigma_tl=2.0, sigma_row=0.2, dsnu=0.1, column_pattern=0.0)
    camera = camera.with_(black=above * camera.noise.sigma_gauss_dn, bias=(0.0,) * 4, hot_share=0.0)
    read = there(calibrated(camera, Body(camera, np.random.default_rng(3)).bias_frames(4)).read)
    assert abs(read.tukey_lambda - 0.14) < 5 * read.tukey_lambda_error < 0.05
    assert abs(read.sigma_tl_dn - 2.0) < 5 * read.sigma_tl_error_dn < 0.1


# --- rounding of quiet noise ------------------------------------------------------------------------------------------

QUIET = Camera(shape=(384, 576), hot_share=0.0, sigma_row=0.05)


def quiet(deviation: float, shape: float, **changes: object) -> Camera:
    scale = deviation / float(stats.tukeylambda(shape).std())
    return QUIET.with_(tukey_lambda=shape, sigma_tl=scale, **changes)


def of(findings: tuple[Finding, ...], check: str, figure: str) -> list[Finding]:
    return [one for one in findings if one.check == check and figure in one.figures]


@pytest.mark.parametrize(("deviation", "shape"), [(0.1, -0.1), (0.22, -0.1), (0.28, 0.1), (0.37, 0.0)])
def test_below_0_4_dn_rounding_decides(deviation: float, shape: float) -> None:
    """Levels lie everywhere between whole DN: lambda and sigma_TL go, and what is left is right within five errors."""
    camera = quiet(deviation, shape, dsnu=0.9)
    found = calibrated(camera, Body(camera, np.random.default_rng(2)).bias_frames(10))
    said = of(found.findings, "rounding", "shape")[0]
    assert said.effect == "withheld"
    assert said.statistic == there(found.read).sigma_gauss_dn < said.threshold == 0.4
    assert f"the read noise is {said.statistic:.2g} DN, below 0.4 DN" in said.text
    for name, (one, true) in figures_of(found, camera).items():
        assert (one is None) >= (name in ("lambda", "sigma_TL"))
        assert one is None or abs(one.value - true) < 5 * one.error < 1.25 * true, name
    assert deviation < 0.3 or found.sigma_gauss_dn is not None


@pytest.mark.parametrize("level", [0.0, 0.35, 0.5])
@pytest.mark.parametrize(
    ("deviation", "shape", "dsnu"),
    [(0.33, 0.05, 0.0), (0.45, -0.15, 0.1), (0.55, 0.1, 0.0), (0.7, -0.1, 0.15), (0.9, -0.2, 0)],
)
def test_levels_that_share_a_fraction(deviation: float, shape: float, dsnu: float, level: float) -> None:
    """A body without a fixed pattern, or nearly: what is given lies within 2.5 errors, however rounding moves it.

    These are bounds of a shift that the frames do not show, not standard deviations of chance, which at 900,000
    residuals is a tenth of them or less; they are at most 15 % of lambda and sigma_TL and 16 % of sigma_G.
    """
    camera = quiet(deviation, shape, dsnu=dsnu, column_pattern=0.0, bias=(level,) * 4)
    found = calibrated(camera, Body(camera, np.random.default_rng(12)).bias_frames(10))
    assert of(found.findings, "fit of the read noise", "shape") == [], "steps of a DN are no other family"
    for name, (one, true) in figures_of(found, camera).items():
        if one is not None:
            assert abs(one.value - true) < 2.5 * one.error, (name, one, true)
            assert one.error < (0.16 if name != "sigma_row" else 0.4) * (1 if name == "lambda" else true)
    assert all(abs(channel.value - level) < max(2.5 * channel.error, 0.01) for channel in found.colour_bias or ())
    if deviation < 0.5 and dsnu == 0:
        assert any(one.effect == "withheld" for one in of(found.findings, "rounding", "shape"))
