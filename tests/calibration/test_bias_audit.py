"""The audit of bias frames: faults are named, good frames are not, and what is given lies within its errors."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.calibration.audit import bias_sums as bias_audit
from eldata.calibration.audit.bias_sums import BiasAudit, BiasStatistics
from eldata.calibration.audit.neighbours import Neighbours
from eldata.errors import DatasetError
from tests.calibration.audit_study import CAMERA, Audited, audited, clean, planted
from tests.calibration.chain import stacked
from tests.calibration.faults import (
    Planted,
    blurred,
    coarse,
    corner_leak,
    dark_signal,
    digitised,
    drift,
    jumping,
    spread_of_noise,
    star_eater,
    telegraph,
    together,
    wave,
)
from tests.calibration.in_memory import calibrated_arrays
from tests.calibration.simulation import XTRANS, Body, Camera

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

# --- faults ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (corner_leak(20.0), {"light": "withheld"}),
        (dark_signal(1.5), {"dark signal": "withheld"}),
        (telegraph(0.01, 5.0), {"unlike pixels": "wider"}),
        (telegraph(0.001, 8.0), {"unlike pixels": "wider"}),
        (blurred(0.2), {"correlated noise": "withheld"}),
        (blurred(0.02), {"correlated noise": "wider"}),
        (star_eater(2.0), {"filtered outliers": "withheld", "correlated noise": "wider"}),
        (star_eater(4.0, both_sides=True), {"filtered outliers": "withheld"}),
        (coarse(2), {"coarse values": "wider"}),
        (coarse(4), {"coarse values": "withheld"}),
        (wave(2.0), {"banding": "withheld"}),
        (drift(1.0), {"slow row drift": "withheld"}),
    ],
    ids=lambda value: value.name if isinstance(value, Planted) else "",
)
def test_a_fault_is_named(fault: Planted, expected: dict[str, str]) -> None:
    """A camera of 0.4 megapixels and nine frames. Each figure that is given is within 4 of its errors of the truth."""
    found = planted(fault, seed=0)
    assert found.effects == expected
    for name, figure in found.after.items():
        assert figure is None or abs(figure.value - found.truth[name]) < 4 * figure.error, name


def test_light_that_is_faint_makes_errors_larger() -> None:
    found = planted(corner_leak(3.0), seed=0)
    assert [(one.check, one.figures, one.effect) for one in found.findings] == [
        ("light", ("read noise",), "wider"),
        ("light", ("colour bias",), "wider"),
    ]
    before, after = found.before["sigma_G"], found.after["sigma_G"]
    assert after is not None
    assert abs(before.value - found.truth["sigma_G"]) > 3 * before.error
    assert abs(after.value - found.truth["sigma_G"]) < 1.96 * after.error


def test_what_is_said_of_light() -> None:
    """K is 1 DN per electron: so is the slope of variance over level, within a tenth."""
    text = planted(corner_leak(20.0), seed=1).findings[0].text
    slope = float(text.split("(")[1].split(" DN^2")[0])
    assert slope == pytest.approx(1.0, abs=0.1)
    assert "cap the lens" in text


# --- pixels that jump, and dark current -----------------------------------------------------------------------------

EVEN = CAMERA.with_(dsnu=0.0, column_pattern=0.0, hot_share=0.0, shading=0.0)
"""A camera without any fixed pattern: what stays from frame to frame is then the pixels' jumps."""


@pytest.mark.parametrize(
    ("fault", "camera"),
    [
        (jumping(0.02, 1.5, 0.3), EVEN),
        (jumping(0.05, 5.0, 0.3), EVEN),
        (jumping(0.02, 1.5, 0.3, -1), EVEN),
        (jumping(0.05, 5.0, 0.3), CAMERA),
    ],
    ids=lambda value: value.name if isinstance(value, Planted) else "",
)
def test_pixels_that_jump_are_no_dark_current(fault: Planted, camera: Camera) -> None:
    """Nothing is withheld, no light is seen, and all figures lie within their errors.

    sigma_G of all pixels together: a share s of them has more variance by d (1 - d) of the squared jump.
    """
    found = planted(fault, 1, camera)
    assert found.effects.items() <= {"unlike pixels": "wider", "lopsided noise": "wider"}.items()
    assert "unlike pixels" in found.effects
    assert not any("colour bias" in one.figures for one in found.findings)
    for name in ("lambda", "sigma_TL", "sigma_G"):
        assert found.covered(name), name
    share, size = (0.02, 1.5) if "2.0%" in fault.name else (0.05, 5.0)
    of_all = found.truth["sigma_G"] * math.sqrt(1 + share * 0.3 * 0.7 * size**2)
    assert found.before["sigma_G"].value == pytest.approx(of_all, rel=0.03)  # less those that count as defects


@pytest.mark.parametrize(
    "fault",
    [dark_signal(1.5), together(dark_signal(2.0), jumping(0.02, 5.0, 0.3))],
    ids=lambda fault: fault.name,
)
@pytest.mark.parametrize("camera", [EVEN, CAMERA], ids=["even", "with a pattern"])
def test_dark_current_is_found_beside_pixels_that_jump(fault: Planted, camera: Camera) -> None:
    found = planted(fault, 1, camera)
    assert found.effects["dark signal"] == "withheld"
    assert found.after["sigma_G"] is None


def test_dark_current_that_hides_behind_louder_pixels_is_within_the_errors() -> None:
    """Pixels that jump around their mean are noisier at every level: what has 2 DN of dark current is not told."""
    found = planted(together(dark_signal(2.0), telegraph(0.01, 5.0)), 1)
    assert found.effects == {"unlike pixels": "wider"}
    for name in found.truth:
        assert found.covered(name), name


@pytest.mark.parametrize("fault", [dark_signal(1.5), corner_leak(20.0), blurred(0.2), coarse(4)])
def test_what_is_accepted_lies_within_its_larger_error(fault: Planted) -> None:
    (check,) = {one.check for one in planted(fault, 0).findings if one.effect == "withheld"}
    found = planted(fault, 0, accept=[check])
    assert {one.check for one in found.findings if one.is_accepted} == {check}
    assert "withheld" not in found.effects.values()
    for name, before in found.before.items():
        after = found.after[name]
        assert after is not None
        assert after.value == before.value
        assert found.covered(name), name
    assert not all(abs(one.value - found.truth[name]) < 1.96 * one.error for name, one in found.before.items())


def test_the_level_of_dark_current_follows_from_k() -> None:
    """1.5 DN of it, beside pixels whose own levels scatter by 3 DN, which say nothing of it."""
    camera = EVEN.with_(dsnu=3.0)
    (of_bias,) = (one for one in planted(dark_signal(1.5), 2, camera).findings if "colour bias" in one.figures)
    assert of_bias.allowance == pytest.approx(1.5, rel=0.3)


def test_flats_tell_dark_current_from_pixels_that_jump() -> None:
    """The camera of whose figures the audit once let none go, whole: its flats say K, and each pixel in 50 jumps.

    Its black does not drift either. Where it does, by 0.4 DN from frame to frame, that is remarked.
    """
    body = Body(EVEN, np.random.default_rng(1))
    frames = jumping(0.02, 1.5, 0.3).bias_frames(body, 10)
    found = calibrated_arrays(EVEN.sensor, frames, body.flat_pairs((800.0, 3000.0, 7000.0, 12000.0)))
    assert [(one.check, one.effect) for one in found.findings] == [("unlike pixels", "wider")]
    assert found.withheld == frozenset()
    assert found.colour_bias is not None
    assert [one.error for one in found.colour_bias] == list(found.bias.standard_error_dn)
    assert not any("black drifts" in remark for remark in found.remarks)
    drifting = [frame + np.rint(0.4 * number).astype(np.uint16) for number, frame in enumerate(frames)]
    without_flats = calibrated_arrays(EVEN.sensor, drifting, [])
    (remark,) = (remark for remark in without_flats.remarks if "black drifts" in remark)
    assert float(remark.split("uncertain by ")[1].split(" DN")[0]) == pytest.approx(0.4 * math.sqrt(7.5 / 9), rel=0.1)


def test_light_in_the_colour_bias_is_no_drift() -> None:
    found = calibrated_arrays(
        CAMERA.sensor, corner_leak(5.0).bias_frames(Body(CAMERA, np.random.default_rng(0)), 6), []
    )
    assert found.colour_bias is None or min(one.error for one in found.colour_bias) > 0.25
    assert "colour bias" in found.widened | found.withheld
    assert not any("black drifts" in remark for remark in found.remarks)


def test_joint_cumulants_of_level_and_variance_are_plain_numpys() -> None:
    """Of the whole frames in 4 pairs; the kernel's steps of a sixteenth of the spread move them by some percent."""
    frames = together(dark_signal(10.0), jumping(0.02, 3.0, 0.3)).bias_frames(Body(EVEN, np.random.default_rng(3)), 8)
    found, fixed = statistics(frames, EVEN), stacked(EVEN, frames)
    values = np.stack(frames)[:, : 48 * 10].astype(np.float64)
    channel, sound = EVEN.channel[: 48 * 10], ~fixed.defects[: 48 * 10]
    sigma = np.sqrt(np.array(fixed.temporal_variance_dn2))[channel]
    score, bend, lower = np.zeros(3)
    for first in range(0, 8, 2):
        level = (values.sum(axis=0) - values[first] - values[first + 1]) / 6 / found.spread_dn
        variance = (np.clip((values[first] - values[first + 1]) / sigma / math.sqrt(2), -4, 4)) ** 2
        for of_channel in range(4):
            chosen = sound & (channel == of_channel)
            level[chosen] -= level[chosen].mean()
        level, variance = np.clip(level[sound], -4, 4), variance[sound]
        own, below = variance - variance.mean(), level < 0
        score += (level * own).sum()
        bend += ((level - level.mean()) ** 2 * own).sum()
        lower += ((level[below] - level[below].mean()) * variance[below]).sum()
    assert found.level_score.sum() == pytest.approx(score, rel=0.05)
    assert found.lower_score.sum() == pytest.approx(lower, rel=0.1)
    of_noise = 4 * found.unlikeness.mean() * 4 * sound.sum() * float(np.mean(sigma**2)) / 6 / found.spread_dn**2
    assert found.bend_score.sum() == pytest.approx(bend - of_noise, rel=0.1)
    assert found.pixels.sum() == np.count_nonzero(sound)


# --- good frames ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_said_of_good_frames(seed: int) -> None:
    """Random cameras: Bayer and X-Trans, heavy and light tails, shading, hot pixels and fixed patterns."""
    assert clean(seed) == ()


def test_shading_without_light_is_none() -> None:
    """30 DN of it, with 2 DN of a pattern of pixels and of columns: nothing of that has noise of its own."""
    camera = CAMERA.with_(shading=30.0, dsnu=2.0, column_pattern=2.0, hot_share=3e-3)
    assert audited(camera, Body(camera, np.random.default_rng(3)).bias_frames(6)).findings == ()


def test_columns_with_noise_are_not_neighbours_that_share_it() -> None:
    body = Body(CAMERA, np.random.default_rng(4))
    frames = [body.fixed + body.noise() + body.generator.normal(0, 0.5, (1, CAMERA.shape[1])) for _ in range(9)]
    assert audited(CAMERA, digitised(frames)).findings == ()


def test_xtrans() -> None:
    """Light, and a filter over direct neighbours: the classes of X-Trans' sites do not hide either."""
    camera = CAMERA.with_(shape=(516, 768), cfa=XTRANS, bias=(0.0, 0.5, -0.5))
    lit = planted(corner_leak(20.0), 5, camera)
    assert lit.effects == {"light": "withheld"}
    body = Body(camera, np.random.default_rng(6))
    frames = [body.fixed + body.noise() for _ in range(9)]
    mixed = [0.98 * frame + 0.02 * np.roll(frame, (0, 1), axis=(0, 1)) for frame in frames]
    assert audited(camera, digitised(mixed)).effects == {"correlated noise": "wider"}


def test_noise_that_is_lopsided() -> None:
    """One in a hundred values is a little brighter, wherever it falls: no pixel is unlike the others."""
    body = Body(CAMERA, np.random.default_rng(7))
    frames = [body.fixed + body.noise() + 12.0 * (body.generator.random(CAMERA.shape) < 0.01) for _ in range(9)]
    (found,) = audited(CAMERA, digitised(frames)).findings
    assert found.check == "lopsided noise"
    assert "further above" in found.text


def statistics(frames: Sequence[NDArray[np.uint16]], camera: Camera = CAMERA) -> BiasStatistics:
    audit = BiasAudit(stacked(camera, frames))
    for frame in frames:
        audit.add(frame)
    return audit.statistics()


def test_correlations_are_plain_numpys() -> None:
    """Of two bands; the controls are means of products of pixels far apart. What row means took is put back."""
    bands = np.random.default_rng(9).integers(-40, 40, (2, 48, 240)).astype(np.int16)
    bands[:, 1:] += bands[:, :-1] // 8
    near = Neighbours(np.array(CAMERA.cfa))
    for band in bands:
        near.add_difference(band)
    found = near.statistics()
    wide = bands.astype(np.float64)

    def correlation(down: int, across: int) -> float:
        here = wide[:, : 48 - down, max(0, -across) : 240 - max(0, across)]
        there = wide[:, down:, max(0, across) : 240 + min(0, across)]
        own = 2 / 240 if (down, across % 2) == (0, 0) else 0.0
        return float((here * there).mean() / (wide**2).mean()) + own

    in_row, in_column = [(0, 36), (0, 48)], [(12, 0), (18, 0)]
    elsewhere = [(1, 36), (2, 36), (1, -36), (2, -36)]
    for (down, across), value in zip(found.lags.tolist(), found.correlation, strict=True):
        far = in_row if down == 0 else in_column if across == 0 else elsewhere
        expected = correlation(down, across) - float(np.mean([correlation(*lag) for lag in far]))
        assert value == pytest.approx(expected, abs=1e-12)
    assert found.correlation[(found.lags == (1, 0)).all(axis=1)][0] == pytest.approx(1 / 8, abs=0.05)


def test_differences_are_standardised() -> None:
    """The variance counts as 1, less what clipping takes: of blocks of 2,304 pixels in four pairs."""
    frames = Body(CAMERA, np.random.default_rng(10)).bias_frames(8)
    found = statistics(frames)
    assert found.pairs == 4
    assert found.variance.shape == found.level_dn.shape == (10, 16)
    assert 0.96 < found.variance.mean() < 1
    assert found.variance.std() < 2 * math.sqrt(3 / (4 * 48 * 48))
    assert found.totals.sum() == 480 * 768 - np.count_nonzero(stacked(CAMERA, frames).defects[:480])
    assert found.sizes.sum() == 4 * found.totals.sum()
    shading = found.level_dn - found.level_dn.mean()
    assert np.abs(shading).max() == pytest.approx(1.5, abs=0.6)  # of y + x^2


def test_unlikeness_is_the_variation_of_the_noise() -> None:
    """Log-normal of s = 0.2: exp(s^2) - 1 = 0.041; a little less, as rounding and row noise are the same for all."""
    body = Body(CAMERA, np.random.default_rng(11))
    found = statistics(spread_of_noise(0.2).bias_frames(body, 8))
    assert float(found.unlikeness.mean()) == pytest.approx(0.038, abs=0.004)
    assert abs(float(statistics(body.bias_frames(8)).unlikeness.mean())) < 0.003


def test_large_frames_are_looked_at_in_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = corner_leak(20.0).bias_frames(Body(CAMERA, np.random.default_rng(12)), 6)
    whole = statistics(frames)
    monkeypatch.setattr(bias_audit, "_MOST_PIXELS", CAMERA.shape[0] * CAMERA.shape[1] // 3)
    part = statistics(frames)
    np.testing.assert_array_equal(part.level_dn, whole.level_dn[::3])
    np.testing.assert_array_equal(part.variance, whole.variance[::3])
    assert audited(CAMERA, frames).effects == {"light": "withheld"}


def test_many_frames_fit_a_byte() -> None:
    """130 frames, of which 126 are looked at: 63 pairs whose sizes end at eight standard deviations."""
    camera = Camera(shape=(256, 288), hot_share=0.0, shading=0.0)
    frames = Body(camera, np.random.default_rng(13)).bias_frames(130)
    for frame in frames[:126:2]:
        frame[10, 11] = 1500
    found = statistics(frames, camera)
    assert found.pairs == 63
    step = math.ceil((bias_audit._LIMIT + 1) / (255 // 63 + 1))
    assert found.sizes.size == bias_audit._LIMIT // step + 1
    assert found.totals[63 * (bias_audit._LIMIT // step)] <= 1
    assert found.totals.sum() == found.sizes.sum() / 63


def test_unusable_frames() -> None:
    small = replace(CAMERA, shape=(128, 192))
    with pytest.raises(DatasetError, match="256 x 256 pixels or more; found 128 x 192"):
        BiasAudit(stacked(small, Body(small, np.random.default_rng(0)).bias_frames(4)))


# --- studies ----------------------------------------------------------------------------------------------------------


@pytest.mark.study
@pytest.mark.parametrize(
    "fault",
    [
        *(corner_leak(2.0), telegraph(0.01, 5.0), telegraph(0.001, 5.0)),
        *(blurred(0.01), coarse(3), wave(0.4), drift(0.35)),
    ],
    ids=lambda fault: fault.name,
)
def test_what_is_given_of_faulty_frames_is_covered(fault: Planted) -> None:
    """Ten cameras each: a figure that is given is within 1.96 of its errors in at least 7 of them.

    If that is so in 95 of 100 cases, fewer than 7 of 10 have a chance of 1e-3, and the seeds are fixed.
    """
    runs: list[Audited] = [planted(fault, seed) for seed in range(10)]
    for name in runs[0].truth:
        given = [covered for run in runs if (covered := run.covered(name)) is not None]
        assert sum(given) >= len(given) - 3, (name, given)
