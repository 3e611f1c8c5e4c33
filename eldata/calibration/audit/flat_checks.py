"""What the gain K rests on, and whether it held: checks of the flats of one ISO."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core.findings import COARSE, FLATS_CORRELATED, NO_LINE, SATURATION
from eldata.calibration.core.photon_transfer import straight_line

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldata.calibration.core._frames import Counts, Values
    from eldata.calibration.core.findings import Finding
    from eldata.calibration.core.photon_transfer import FlatPairs, PhotonTransfer, PhotonTransferLine

_BY_CHANCE = 1e-4  # of one check of one ISO
# Blur of a share w gives neighbours of one colour a correlation of w, or of w / 2 if it goes along rows and columns
# both, and takes 2 w from the variance: at most four times the correlation.
_LOST_PER_CORRELATION = 4.0
_LEAST_LOSS = 0.002  # of K: below it a correlation is not worth a word
_PILE = 100  # pixels: chance moves so many by 10 %
_BELOW = slice(-34, -2)  # DN below a pile
_OVER_PILE = 0.01  # of the pile may lie above it
_SIGNIFICANT = 5.0  # standard errors
_TOGETHER, _PER_CODE = 8, 10  # neighbouring codes that show a step, and pixels of each at least
_OF_ERROR = 0.2  # of K: less is in it


def flat_findings(transfer: PhotonTransfer) -> Iterator[Finding]:
    """Yield what the checks of one ISO's flats say of K."""
    yield from _correlation(transfer)
    yield from _line(transfer)


def saturation(flats: FlatPairs) -> Iterator[Finding]:
    """Yield a finding if pixels pile up at a value below the recorded white level, as where a sensor saturates.

    The upper end of noise, whatever its light, falls towards the top: there a value is rarer than those below it.
    """
    piles = [(pile, name) for name, counts in enumerate(flats.counts) if (pile := _pile(counts, flats.limit_dn))]
    if not piles:
        return
    levels, over = [level for (level, _), _ in piles], max(over for (_, over), _ in piles)
    where = f"{levels[0]} DN" if len(set(levels)) == 1 else f"{min(levels)} to {max(levels)} DN"
    channels = "" if len(piles) == flats.channels else f" in {len(piles)} of {flats.channels} channels"
    yield SATURATION.seen(
        over,
        3.0,
        f"the flats saturate at {where}{channels}, below the recorded white level: values pile up there, {over:.0f} "
        "times as many as at the values below, and with the noise goes K; leave out the flats that reach this value",
    ).of("withheld", SATURATION.figures)


def uneven_steps(flats: FlatPairs, transfer: PhotonTransfer) -> Iterator[Finding]:
    """Yield a finding if the values step by more DN the brighter they are, as of files compressed by a curve.

    Rounding to steps of s DN adds s^2 / 12 to the variance; its slope over the light is in K.
    """
    added, largest = [], 1.0
    for channel, line in enumerate(transfer.channels):
        counts = flats.counts[channel, : math.ceil(flats.limit_dn)]
        codes = np.flatnonzero(counts)
        pixels = np.convolve(counts[codes], np.ones(_TOGETHER + 1), "valid")
        known = pixels >= _PER_CODE * (_TOGETHER + 1)
        if not known.any():
            return
        # The median: between flats of two levels there may be nothing.
        steps = np.median(np.lib.stride_tricks.sliding_window_view(np.diff(codes), _TOGETHER), axis=1)[known]
        places = codes[_TOGETHER // 2 : -_TOGETHER // 2][known] - flats.black[channel]
        rounding, errors = np.interp(line.signal_dn, places, steps**2 / 12), line.variance_error_dn2
        added.append(straight_line(line.signal_dn, rounding, errors**-2, errors**2)[0])
        largest = max(largest, float(steps.max()))
    share, error = float(np.mean(added)) / transfer.gain_dn_per_e, transfer.gain_error / transfer.gain_dn_per_e
    if abs(share) > _OF_ERROR * error:
        text = (
            f"the flats' values step by up to {largest:.0f} DN, unevenly, as compression by a curve leaves them: "
            f"rounding to these steps makes {share:+.1%} of K; use uncompressed raw"
        )
        yield from COARSE.judged(abs(share), _OF_ERROR * error, text, {"gain": (abs(share), _OF_ERROR * error)})


def _pile(counts: Counts, limit_dn: float) -> tuple[int, float] | None:
    """Return the value at which pixels end in a pile, and how many times the counts below it; ``None`` if none do."""
    above = np.cumsum(counts[::-1])[::-1] - counts
    places = np.flatnonzero((counts >= _PILE) & (above <= _OVER_PILE * counts))
    for place in places[(places >= -_BELOW.start) & (places < limit_dn)][::-1].tolist():
        over = float(counts[place]) / max(1, int(counts[place + _BELOW.start : place + _BELOW.stop].max()))
        if over > 3.0:
            return place, over
    return None


def _correlation(transfer: PhotonTransfer) -> Iterator[Finding]:
    from scipy.special import ndtri

    found, error = transfer.correlation, transfer.correlation_error
    threshold = float(-ndtri(_BY_CHANCE / 2)) * error + _LEAST_LOSS / _LOST_PER_CORRELATION
    if not abs(found) > threshold:
        return
    if found > 0:
        why = "the frames were smoothed or resampled, or the picture moved between the two of a pair"
    else:
        why = "the frames were sharpened"
    yield from FLATS_CORRELATED.judged(
        abs(found),
        threshold,
        f"in the differences of flats, neighbours of one colour are correlated by {found:+.3f} (a raw file: 0): {why}; "
        "shoot on a tripod, with noise reduction and lens corrections off",
        {"gain": (_LOST_PER_CORRELATION * abs(found), 0.0)},
    )


def _line(transfer: PhotonTransfer) -> Iterator[Finding]:
    """Yield a finding if medians of the pairs' segments have no line of variance over signal, or another one than K.

    Edges that move between the two frames of a pair are in the mean and, up to a half of the segments, not in the
    median; a response that is not linear, or that saturates by degrees, bends the line of both.
    """
    lines = [
        _of_medians(line, *medians)
        for line, medians in zip(transfer.channels, transfer.medians, strict=True)
        if medians.shape[1] >= 3 and np.ptp(medians[0]) > 0
    ]
    if not lines:
        return
    gain = transfer.gain_dn_per_e
    slopes, errors, bends, bend_errors = np.array(lines).T
    tests = []
    for off, error in ((slopes / gain - 1, errors / gain), (bends, bend_errors)):
        weights = error**-2.0
        if weights.any():
            mean, its_error = float(weights @ off / weights.sum()), float(weights.sum() ** -0.5)
            tests.append((abs(mean), math.hypot(its_error, transfer.gain_error / gain)))
    share, error = max(tests, key=lambda test: test[0] / test[1])
    if not share > _SIGNIFICANT * error:
        return
    text = (
        f"the flats' noise does not follow one line over their light: medians over the frame give a K that is off by "
        f"{slopes.mean() / gain - 1:+.1%}, and a line that bends by {bends.mean():+.1%} to where there is no light. "
        "Edges that moved within a pair (a chart without a tripod), saturation by degrees, a filter or a sensor that "
        "is not linear do this: shoot an even wall, from a tenth to a half of the range"
    )
    yield from NO_LINE.judged(share / error, _SIGNIFICANT, text, {"gain": (max(test[0] for test in tests), 0.0)})


def _of_medians(
    line: PhotonTransferLine, x: Values, v: Values, relative_error: Values
) -> tuple[float, float, float, float]:
    """Return slope and error of the line through points, and how far a parabola's slope at no light is off it."""
    error = relative_error * np.maximum(line.variance_at(x), 1e-9)  # of a variance's own: high ones would weigh less
    slope, _, (of_slope, _) = straight_line(x, v, error**-2, error**2)
    if len(x) < 4:
        return slope, math.sqrt(of_slope), 0.0, math.inf
    powers = np.stack([x**2, x, np.ones_like(x)], axis=1) / error[:, None]
    # Of v = a + b x + q x^2, b is the slope at no light; the line takes `tilt` q of the square for slope.
    of_square = np.linalg.pinv(powers / np.abs(powers).max(axis=0))[0] / np.abs(powers[:, 0]).max()
    tilt, _, _ = straight_line(x, x**2, error**-2, error**2)
    q, q_error = float(of_square @ (v / error)), float(np.linalg.norm(of_square))
    return slope, math.sqrt(of_slope), -q * tilt / slope, abs(tilt * q_error / slope)
