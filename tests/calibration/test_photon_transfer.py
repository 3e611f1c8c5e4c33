"""System gain from flats."""

from __future__ import annotations

import numpy as np
import pytest

from eldata.calibration import FlatPairs, photon_transfer
from eldata.errors import ArgumentError, DatasetError
from tests.calibration.simulation import BAYER, Body, Camera

BLACK = [512.0] * 4


def test_prnu_misleads_the_published_method_and_not_the_pairs() -> None:
    """1 % PRNU to 6000 DN at K = 0.2, even light: the published method is off by a multiple."""
    camera = Camera(shape=(512, 768), gain=0.2, sigma_tl=1.0)
    body = Body(camera, np.random.default_rng(0))
    pairs = FlatPairs(BAYER, BLACK, 16383, defects=body.hot)
    medians, variances = [], []
    for first, second in body.flat_pairs([500, 2000, 4000, 6000], shaded=False):
        pairs.add(first, second)
        medians.append(np.median(first[::2, ::2]))
        variances.append(first[::2, ::2].var())
    found = photon_transfer(pairs)
    assert abs(found.gain_dn_per_e - 0.2) < 4 * found.gain_error < 0.01 * 0.2
    assert np.polyfit(medians, variances, 1)[0] > 2 * 0.2


def test_a_channel_that_is_hardly_known_hardly_counts() -> None:
    """Four pairs; K = 1, but 1.3 in B, with a thirtieth of the light on a sixteenth of the pixels: plain mean 1.075."""
    generator, shape = np.random.default_rng(7), (256, 384)
    channel = np.array(BAYER)[np.arange(shape[0])[:, None] % 2, np.arange(shape[1]) % 2]
    blue = channel == 2
    gain = np.where(blue, 1.3, 1.0)
    defects = blue & (np.arange(shape[0]) >= shape[0] // 16)[:, None]
    flats = FlatPairs(BAYER, BLACK, 16383, defects=defects)
    for level in (500, 3000, 6000, 9000):
        electrons = level * np.where(blue, 1 / 30, 1.0) / gain
        flats.add(
            *(
                np.rint(512 + gain * generator.poisson(electrons) + generator.normal(0, 10, shape)).astype(np.uint16)
                for _ in range(2)
            )
        )
    found = photon_transfer(flats)
    gains = np.array([line.gain_dn_per_e for line in found.channels])
    weights = np.array([line.gain_error for line in found.channels]) ** -2.0
    assert weights.argmin() == 2
    assert weights[2] < weights.sum() / 100
    # Its 1.3 moves K by less than a hundredth of 0.3.
    assert abs(found.gain_dn_per_e - 1) < 4 * found.gain_error + 0.003 < 0.03
    assert gains.mean() - 1 > 4 * found.gain_error + 0.003
    assert found.gain_dn_per_e == pytest.approx(np.average(gains, weights=weights), rel=1e-12)
    assert found.gain_error == pytest.approx(weights.sum() ** -0.5, rel=1e-12)


def test_one_channel_against_plain_numpy() -> None:
    """Segments of one row: temporal variance and mean as numpy computes them."""
    body = Body(Camera(shape=(12, 96), hot_share=0.0), np.random.default_rng(6))
    first, second = body.flat_frame(3000, shaded=False), body.flat_frame(3300, shaded=False)
    flats = FlatPairs(BAYER, BLACK, 16383)
    flats.add(first, second)
    signal, variance, freedom = flats.points(1)
    a, b = first[::2, 1::2] - 512.0, second[::2, 1::2] - 512.0
    ratio = (a.mean(axis=1) / b.mean(axis=1))[:, None]
    scale = 1 + ratio[:, 0] ** 2
    assert freedom.sum() == 6 * 47
    assert variance @ freedom / freedom.sum() == pytest.approx(((a - ratio * b).var(axis=1, ddof=1) / scale).mean())
    assert signal @ freedom / freedom.sum() == pytest.approx(((a + ratio**2 * b).mean(axis=1) / scale).mean())


def test_unusable_frames() -> None:
    frame = np.full((128, 192), 1000, dtype=np.uint16)
    flats, noise = FlatPairs(BAYER, BLACK, 16383), np.random.default_rng(0)
    with pytest.raises(DatasetError, match="no flat frames"):
        photon_transfer(flats)
    with pytest.raises(ArgumentError, match="uint16"):
        flats.add(frame.astype(np.float32), frame.astype(np.float32))
    with pytest.raises(ArgumentError, match="one orientation"):
        flats.add(frame, frame.T.copy())
    with pytest.raises(ArgumentError, match="96 pixels wide"):
        FlatPairs(BAYER, BLACK, 16383).add(frame[:, :64], frame[:, :64])
    for pairs, word in (
        ([(1000, 0)], "^R has 1 usable level "),
        ([(2000, 30), (9000, 10)], "variance of R does not grow"),
    ):
        flats = FlatPairs(BAYER, BLACK, 16383)
        for level, sigma in pairs:
            flats.add(*(np.rint(noise.normal(level, sigma, frame.shape)).astype(np.uint16) for _ in range(2)))
        with pytest.raises(DatasetError, match=word):
            photon_transfer(flats)


@pytest.mark.parametrize(("deviations", "left_out"), [(3.27, 0.5), (4.3, 0.0)])
def test_a_level_of_which_a_twentieth_saturates_is_left_out(deviations: float, left_out: float) -> None:
    """A pixel of q = 5e-4 or 9e-6 saturates, so that 1 - (1 - q)^96 = 5 % or 0.1 % of the segments of two frames do."""
    generator, flats = np.random.default_rng(11), FlatPairs(BAYER, BLACK, 16383)
    brightest = flats.limit_dn - 512 - deviations * np.sqrt(15400)
    for level in (2000, brightest):
        first, second = (512 + generator.poisson(level, (2, 256, 384))).astype(np.uint16)
        flats.add(first, second)
    assert flats.left_out == pytest.approx(left_out, abs=0.03)
