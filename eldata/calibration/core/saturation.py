"""Where flats saturate below the recorded white level: a value at which pixels pile up, or a variance that falls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core._frames import Counts, Mask, Values


MARGIN = 0.02  # of the range from black to white: pixels so near to white count as saturated
_PILE = 100  # pixels: chance moves so many by 10 %
_PILE_OVER = 3.0  # times the highest count of the bins below: the upper end of noise falls towards the top
_BELOW = 34  # bins
_OVER_PILE = 0.01  # of the pile may lie above it
_BINS = 2048  # of the range: the width in which a pile may be spread

# A pixel loses its variance as its value clips: of normal noise, 1e-4 is gone 4 standard deviations below that.
_ROOM = 4.0

_GROUP = 2000.0  # degrees of freedom: a variance within 3 %
_WIDEST = 16  # levels of a group
_SIGNIFICANT = 5.0  # standard errors
_DEFICIT = 0.9  # of the variance that the levels below foretell
_COLLAPSED = 0.5
# A deficit that shows (1 % to 10 %) begins 1.6 to 2.3 standard deviations below saturation; from there it is as much
# again to where 1e-4 is gone.
_ROOM_BELOW_ONSET = 2.5


@dataclass(frozen=True, slots=True)
class Saturation:
    """Where a channel saturates.

    Attributes
    ----------
    level_dn
        The value at which it does, DN.
    limit_dn
        Levels are usable whose signal (DN over black) and ``room`` standard deviations of single pixels stay below.
    room
        As said.
    is_sharp
        Whether pixels pile up at one value; else the variance falls by degrees.
    statistic, threshold
        Sharp: the pile over the counts below it. Else: by how many standard errors the variance falls.
    """

    level_dn: float
    limit_dn: float
    room: float
    is_sharp: bool
    statistic: float
    threshold: float

    def is_below(self, signal_dn: Values, spread_dn2: Values) -> Mask:
        """Return which levels it leaves alone."""
        below: Mask = signal_dn + self.room * np.sqrt(spread_dn2) <= self.limit_dn
        return below


def saturation(
    counts: Counts,
    black_dn: float,
    limit_dn: float,
    signal_dn: Values,
    variance_dn2: Values,
    freedom: Values,
    spread_dn2: Values,
) -> Saturation | None:
    """Return where a channel saturates below the recorded white level, or ``None`` where nothing shows.

    Parameters
    ----------
    counts
        (65536,) pixels by value, DN.
    black_dn, limit_dn
        The channel's black level, and from where the recorded white level takes pixels for saturated, DN.
    signal_dn, variance_dn2, freedom, spread_dn2
        By level, ascending: mean over black, temporal variance, its degrees of freedom, variance within single frames.
    """
    return _piled_up(counts, black_dn, limit_dn) or _falling(black_dn, signal_dn, variance_dn2, freedom, spread_dn2)


def _piled_up(counts: Counts, black_dn: float, limit_dn: float) -> Saturation | None:
    """Return where values end in a pile: at one value, or within some.

    The upper end of noise, whatever its light, falls towards the top: there a bin holds less than those below it.
    """
    for width in (1, max(2, round((limit_dn - black_dn) / _BINS))):
        bins = np.add.reduceat(counts, np.arange(0, len(counts), width))
        above = np.cumsum(bins[::-1])[::-1] - bins
        piles = bins + np.concatenate([[0], bins[:-1]])  # a pile may fall on the edge between two bins
        places = np.flatnonzero((piles >= _PILE) & (above <= _OVER_PILE * piles))
        for place in places[(places >= _BELOW) & (places * width < limit_dn)][::-1]:
            over = int(piles[place]) / max(1, 2 * int(bins[place - _BELOW : place - 2].max()))
            if over > _PILE_OVER:
                begin = (int(place) - 1) * width
                level = float(begin + np.argmax(counts[begin : begin + 2 * width]))
                limit = level - black_dn
                return Saturation(level, limit - MARGIN * limit, _ROOM, True, over, _PILE_OVER)
    return None


def _falling(
    black_dn: float, signal_dn: Values, variance_dn2: Values, freedom: Values, spread_dn2: Values
) -> Saturation | None:
    """Return from where the variance falls: below what the levels before foretell, for good, and in itself.

    Each pixel has a full well of its own, so the variance goes by degrees. A sensor that is merely not linear bends the
    line and does not turn it down.
    """
    groups = _grouped(freedom)
    if len(groups) < 2:
        return None
    weight = np.array([freedom[group].sum() for group in groups])
    x = np.array([np.average(signal_dn[group], weights=freedom[group]) for group in groups])
    y = np.array([np.average(variance_dn2[group], weights=freedom[group]) for group in groups])
    for j in range(1, len(groups)):
        foretold, error = _foretold(x[:j], y[:j], weight[:j], x[j:])
        low = y[j:] < _DEFICIT * foretold
        deviation = (foretold[0] - y[j]) / math.hypot(error[0], foretold[0] * math.sqrt(2 / weight[j]))
        if not (low.all() and deviation > _SIGNIFICANT):
            continue
        top, least = int(np.argmax(y[:j])), j + int(np.argmin(y[j:]))
        fall = (y[top] - y[least]) / math.sqrt(2 * y[top] ** 2 / weight[top] + 2 * y[least] ** 2 / weight[least])
        if fall <= _SIGNIFICANT:
            continue
        onset = float(signal_dn[groups[j][0]])
        collapsed = y[j:] < _COLLAPSED * foretold
        level = float(np.average(x[j:][collapsed], weights=weight[j:][collapsed])) if collapsed.any() else onset
        from_here = np.concatenate(groups[j - 1 :])
        room = _ROOM_BELOW_ONSET * math.sqrt(float(spread_dn2[from_here].max()))
        return Saturation(level + black_dn, onset - room, 0.0, False, fall, _SIGNIFICANT)
    return None


def _grouped(freedom: Values) -> list[NDArray[np.intp]]:
    """Return neighbouring levels by groups that know their variance well."""
    groups: list[NDArray[np.intp]] = []
    begin = 0
    for end in range(1, len(freedom) + 1):
        if float(freedom[begin:end].sum()) >= _GROUP or end - begin == _WIDEST:
            groups.append(np.arange(begin, end))
            begin = end
    if begin < len(freedom):
        groups.append(np.arange(begin, len(freedom)))
    return groups


def _foretold(x: Values, y: Values, freedom: Values, at: Values) -> tuple[Values, Values]:
    """Return the line through some levels at others, and its standard error there; of one level: that it rises."""
    if len(x) == 1:
        return np.full(len(at), y[0]), np.full(len(at), y[0] * math.sqrt(2 / freedom[0]))
    weight = freedom / (2 * np.maximum(y, 1e-12) ** 2)
    centre = float(np.average(x, weights=weight))
    lever = float((weight * (x - centre) ** 2).sum())
    slope = float((weight * (x - centre) * y).sum()) / lever
    value = float(np.average(y, weights=weight)) + slope * (at - centre)
    return value, np.sqrt(1 / weight.sum() + (at - centre) ** 2 / lever)
