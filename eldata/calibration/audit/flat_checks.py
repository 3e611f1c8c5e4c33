"""What the gain K rests on, and whether it held: checks of the photon transfer and of the joint fits over K."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core.findings import BENT, CHANNELS_GAINS, EDGES, FLATS_CORRELATED, SATURATION
from eldata.calibration.core.photon_transfer import straight_line

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.photon_transfer import PhotonTransfer, PhotonTransferLine
    from eldata.calibration.core.saturation import Saturation

_BY_CHANCE = 1e-4  # of one check of one ISO
# Blur of a share w gives neighbours of one colour a correlation of w, or of w / 2 if it goes along rows and columns
# both, and takes 2 w from the variance: at most four times the correlation.
_LOST_PER_CORRELATION = 4.0
_LEAST_LOSS = 0.002  # of K: below it a correlation is not worth a word
# Share of the measurements. Patches of 1000 pixels, six to a row of 24 megapixels, have edges in a tenth of its pieces.
# A wall has one in 100,000 by chance, and none for light that falls off smoothly.
_MOST_EDGES = 0.1


def flat_findings(transfer: PhotonTransfer) -> tuple[Finding, ...]:
    """Return what the checks of one ISO's flats say."""
    saturation = saturation_findings(transfer.saturation, transfer.left_out)
    return (*saturation, *_correlation(transfer), *_curvature(transfer), *_agreement(transfer))


def edge_findings(transfer: PhotonTransfer) -> Iterator[Finding]:
    """Yield a remark if the flats show a scene with edges: the variance within a frame is then the scene's own."""
    if transfer.edges > _MOST_EDGES:
        yield EDGES.seen(
            transfer.edges,
            _MOST_EDGES,
            f"{transfer.edges:.0%} of the flats' area have edges in or near them, as on a colour chart, and were left "
            "out of K; the published method, which takes a frame's variance for noise, says nothing of such frames and "
            "is not given beside it",
        )


def saturation_findings(saturation: Sequence[Saturation | None], left_out: float) -> Iterator[Finding]:
    """Yield a remark if channels saturate below the recorded white level.

    Parameters
    ----------
    saturation
        Where each channel does.
    left_out
        The share of the flats' area that was left out for it.
    """
    found = [one for one in saturation if one is not None]
    if not found:
        return
    levels = sorted(one.level_dn for one in found)
    where = f"{levels[0]:.0f} DN" if levels[-1] - levels[0] < 1 else f"{levels[0]:.0f} to {levels[-1]:.0f} DN"
    channels = "" if len(found) == len(saturation) else f" in {len(found)} of {len(saturation)} channels"
    how = "values pile up there" if all(one.is_sharp for one in found) else "their variance falls from there on"
    worst = max(found, key=lambda one: one.statistic / one.threshold)
    yield SATURATION.seen(
        worst.statistic,
        worst.threshold,
        f"the flats saturate at {where}{channels}, below the recorded white level: {how}. What lies near it and above "
        f"was left out ({left_out:.0%} of the flats' area); give this level as white_level_dn where you use "
        "this camera's frames",
    )


def _correlation(transfer: PhotonTransfer) -> Iterator[Finding]:
    from scipy.special import ndtri

    found, error = transfer.correlation, transfer.correlation_error
    threshold = float(-ndtri(_BY_CHANCE / 2)) * error + _LEAST_LOSS / _LOST_PER_CORRELATION
    if not abs(found) > threshold:
        return
    allowance = _LOST_PER_CORRELATION * abs(found)
    if found > 0:
        why = "the frames were smoothed or resampled, or the picture moved between the two of a pair"
    else:
        why = "the frames were sharpened"
    yield from FLATS_CORRELATED.judged(
        abs(found),
        threshold,
        f"in the differences of flats, neighbours of one colour are correlated by {found:+.3f} (a raw file: 0): {why}; "
        "shoot on a tripod, with noise reduction and lens corrections off",
        {"gain": (allowance, 0.0)},
    )


def _curvature(transfer: PhotonTransfer) -> Iterator[Finding]:
    """Compare K with the slope at no light of a parabola through the same points.

    Two tests, that share the chance: of all channels' bends together, as a sensor that is not linear bends them alike;
    and of each by itself, by the sum of the squares of bend over error.
    """
    bends = np.array([_bend(line) for line in transfer.channels])
    weights = bends[:, 1] ** -2
    if not weights.all():
        return
    bend = float(weights @ bends[:, 0] / weights.sum())
    tests = (
        (float(weights @ bends[:, 0] ** 2), _chi2_quantile(_BY_CHANCE / 2, len(bends))),
        (float(bend**2 * weights.sum()), _chi2_quantile(_BY_CHANCE / 2, 1)),
    )
    statistic, threshold = max(tests, key=lambda test: test[0] / test[1])
    allowance = abs(bend)
    if not (statistic > threshold and allowance > transfer.gain_error / transfer.gain_dn_per_e):
        return
    if bend > 0:
        why = "slower than the signal, as where a sensor is not linear or a file was compressed with loss"
    else:
        why = "faster than the signal, as where something moved between the two frames of a pair"
    yield from BENT.judged(
        statistic,
        threshold,
        f"the variance of the flats grows {why}: without light its slope is {bend:+.1%} off K",
        {"gain": (allowance, 0.0)},
    )


def _bend(line: PhotonTransferLine) -> tuple[float, float]:
    """Return how far the slope at no light of a parabola lies above K, as a share of K, and its standard error."""
    if len(line.signal_dn) < 4:
        return 0.0, math.inf
    x, error = line.signal_dn, line.variance_error_dn2
    powers = np.stack([x**2, x, np.ones_like(x)], axis=1) / error[:, None]
    # Of v = a + b x + q x^2, b is the slope at no light; the line takes `tilt` q of the square for slope.
    of_square = np.linalg.pinv(powers / np.abs(powers).max(axis=0))[0] / np.abs(powers[:, 0]).max()
    tilt, _, _ = straight_line(x, x**2, error**-2, error**2)
    q, q_error = float(of_square @ (line.variance_dn2 / error)), float(np.linalg.norm(of_square))
    return -q * tilt / line.gain_dn_per_e, abs(tilt) * q_error / line.gain_dn_per_e


def _agreement(transfer: PhotonTransfer) -> Iterator[Finding]:
    lines = transfer.channels
    statistic = transfer.agreement_chi2_per_dof * (len(lines) - 1)
    threshold = _chi2_quantile(_BY_CHANCE, len(lines) - 1)
    gains = np.array([line.gain_dn_per_e for line in lines])
    allowance = float(gains.std(ddof=1)) / transfer.gain_dn_per_e
    if not (statistic > threshold and allowance > transfer.gain_error / transfer.gain_dn_per_e):
        return
    listed = ", ".join(f"{gain:.4g}" for gain in gains)
    yield from CHANNELS_GAINS.judged(
        statistic,
        threshold,
        f"K differs between the channels: {listed} DN/e-; does the camera scale colours in its raw files?",
        {"gain": (allowance, 0.0)},
    )


def _chi2_quantile(chance: float, freedom: int) -> float:
    from scipy.special import chdtri

    return float(chdtri(freedom, chance))
