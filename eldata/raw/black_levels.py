"""The black level that a DNG states, exactly, at the sites of its visible area (DNG specification 1.7.1, chapter 5).

Black of a pixel is BlackLevel, a pattern, plus BlackLevelDeltaH of its column plus BlackLevelDeltaV of its row, all
counted from the active area's first pixel. Where that is one level for each channel of the CFA, it is the frame's.
Where the deltas lack the CFA's period, what each row and column has of its own is taken off the pixels. MaskedAreas,
which no light reaches, count where no level is stated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from math import gcd
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.numbers import counted
from eldata.errors import RawFileError, UnusableRawError
from eldata.raw.tiff import (
    ACTIVE_AREA,
    BLACK_DELTAS,
    BLACK_LEVEL,
    BLACK_REPEAT,
    MASKED_AREAS,
    RATIONAL,
    nearest_fraction,
)
from eldata.records import exact_number

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.raw.cfa import CfaRows
    from eldata.raw.tiff import Directory, Numbers

TAKING_PIXELS = (MASKED_AREAS, *BLACK_DELTAS)
"""Tags of which is remarked what takes the pixels to know."""

_NONE = (Fraction(0),)
_DELTAS = ("BlackLevelDeltaH", "BlackLevelDeltaV")
_STEP = 1 << 16  # of a level that is a mean of deltas: finer than any noise, and a RATIONAL holds it
_LEAST_APART_DN = 0.5  # between masked pixels and the stated level, to be remarked on


@dataclass(frozen=True, slots=True)
class VisibleArea:
    """The visible area: ``shape`` (H, W) from the pixel (top, left) of all stored ones on, and its CFA."""

    top: int
    left: int
    shape: tuple[int, int]
    cfa: CfaRows

    @property
    def sites(self) -> Iterator[tuple[int, int, int]]:
        """Row, column and channel of each site of one period."""
        period = range(len(self.cfa))
        return ((y, x, self.cfa[y][x]) for y, x in product(period, period))

    def of(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Return this part of all stored pixels."""
        height, width = self.shape
        return stored[self.top : self.top + height, self.left : self.left + width]


@dataclass(frozen=True, slots=True)
class BlackLevel:
    """A black level per channel in DN, and what is to be said of it.

    ``rows``, ``columns``: what each row (per channel) and each column of the visible area has above that level, in DN,
    (C, H) and (W,) float64; None if none has.
    """

    level_dn: tuple[float, ...]
    remarks: tuple[str, ...] = ()
    rows: NDArray[np.float64] | None = None
    columns: NDArray[np.float64] | None = None

    def flatten(self, mosaic: NDArray[Any], area: VisibleArea) -> NDArray[Any]:
        """Return the visible mosaic (H, W) with ``level_dn`` all over: itself, or a new one in float32."""
        if self.rows is None or self.columns is None:
            return mosaic
        flat, period = mosaic.astype(np.float32), len(area.cfa)
        for y, x, channel in area.sites:
            excess = self.rows[channel, y::period, None] + self.columns[x::period]
            flat[y::period, x::period] -= excess.astype(np.float32)
        return flat


def check_black_counts(path: Path, main: Directory) -> None:
    """Refuse a DNG that does not state as many numbers of its black level as there are sites, columns and rows.

    Raises
    ------
    UnusableRawError
        If that is so of BlackLevel or a delta.
    """
    (rows, columns), repeat = _repeat(main), main.values.get(BLACK_REPEAT, ())
    expected, found = rows * columns * main.samples, len(main.values.get(BLACK_LEVEL, ()))
    alone = 1 if rows == columns == 1 else expected  # the level of all samples
    if found not in (0, alone, expected):
        dim = (
            f"its BlackLevelRepeatDim is {' x '.join(map(str, repeat))}" if repeat else "it has no BlackLevelRepeatDim"
        )
        samples = f" and {main.samples} samples of each pixel" if main.samples > 1 else ""
        raise UnusableRawError(
            path,
            f"its BlackLevel has {counted(found, 'number')}, expected {expected}, as {dim}{samples}: which is of which "
            "pixel is not known",
            "write it again with a BlackLevelRepeatDim that fits, such as 2 2 for four levels",
        )
    top, left, bottom, right = _active(main)
    for tag, name, expected in zip(BLACK_DELTAS, _DELTAS, (right - left, bottom - top), strict=True):
        found = len(main.values.get(tag, ()))
        if found not in (0, expected):
            raise UnusableRawError(
                path,
                f"its {name} has {counted(found, 'number')}, expected {expected}, the size of its active area",
                "write it again with as many, or without",
            )


def _repeat(main: Directory) -> tuple[int, int]:
    repeat = main.values.get(BLACK_REPEAT, ())
    return (int(repeat[0]), int(repeat[1])) if len(repeat) == 2 else (1, 1)  # some write one number, beside one level


def _active(main: Directory) -> tuple[int, int, int, int]:
    """Return top, left, bottom and right of the active area, where all that is stated of black begins."""
    top, left, bottom, right = map(int, main.values.get(ACTIVE_AREA, (0, 0, *main.shape)))
    return top, left, bottom, right


def dng_black_level(path: Path, main: Directory, area: VisibleArea, stored: NDArray[Any]) -> BlackLevel | None:
    """Return the black level of a mosaic that a DNG states; None if it states none.

    Parameters
    ----------
    path
        The file, for messages.
    main
        The directory whose pixels are read, which has passed :func:`check_black_counts`.
    area
        Which of them are visible.
    stored
        (H, W) in DN: all of them, in order.

    Raises
    ------
    UnusableRawError
        If BlackLevel has several levels for sites of one channel.
    RawFileError
        If it has no deltas for a part of the visible area.
    """
    stated, masked = _stated(path, main, area), _masked(main, area, stored)
    if masked is None:
        return stated
    mean = float(np.mean(masked))
    if stated is None:
        return BlackLevel(masked, (f"it states no BlackLevel: the mean of its masked pixels is taken, {mean:.1f} DN",))
    level = float(np.mean(stated.level_dn))
    if abs(mean - level) < _LEAST_APART_DN:
        return stated
    remark = (
        f"its masked pixels (MaskedAreas) have a mean of {mean:.1f} DN, but its BlackLevel says {level:.1f} DN, which "
        "is taken, as the DNG specification has it"
    )
    return replace(stated, remarks=(*stated.remarks, remark))


def _stated(path: Path, main: Directory, area: VisibleArea) -> BlackLevel | None:
    if not any(main.values.get(tag) for tag in (BLACK_LEVEL, *BLACK_DELTAS)):
        return None
    # LibRaw's visible area may start a pixel off the active one.
    top, left, _, _ = _active(main)
    top, left = area.top - top, area.left - left
    period, (height, width) = len(area.cfa), area.shape
    base = _pattern(path, main, area.cfa, top, left)
    across, down = (main.values.get(tag) for tag in BLACK_DELTAS)
    columns = across[max(left, 0) : left + width] if across else _NONE * period
    rows = down[max(top, 0) : top + height] if down else _NONE * period
    if (across and len(columns) != width) or (down and len(rows) != height):
        raise RawFileError(path, f"damaged: its visible area, {height} x {width} pixels, is not all in its active area")
    levels: dict[int, set[Fraction]] = {}
    for y, x, channel in area.sites:
        levels.setdefault(channel, set()).add(base[channel] + rows[y] + columns[x])
    periodic = all(one == values[i % period] for values in (rows, columns) for i, one in enumerate(values))
    if periodic and all(len(found) == 1 for found in levels.values()):
        return BlackLevel(tuple(exact_number(levels[channel].pop()) for channel in sorted(levels)))
    return _uneven(area, base, rows, columns)


def _uneven(area: VisibleArea, base: Sequence[Fraction], rows: Numbers, columns: Numbers) -> BlackLevel:
    """Return the level of each channel's mean delta, and what rows and columns have above it."""
    period, (height, width) = len(area.cfa), area.shape
    of_rows, of_columns = np.resize(_floats(rows), height), np.resize(_floats(columns), width)
    means: dict[int, list[float]] = {}
    for y, x, channel in area.sites:
        means.setdefault(channel, []).append(of_rows[y::period].mean() + of_columns[x::period].mean())
    levels = [
        Fraction(round((float(base[channel]) + float(np.mean(means[channel]))) * _STEP), _STEP)
        for channel in sorted(means)
    ]
    above = np.array([float(one - level) for one, level in zip(base, levels, strict=True)])
    ranges = (
        f"{name} ({min(values):.4g} to {max(values):.4g} DN)"
        for name, values in zip(_DELTAS, (_floats(columns), _floats(rows)), strict=True)
        if values.any()
    )
    remark = (
        f"by its {' and '.join(ranges)} black varies by row or column: what each has above its channel's mean was "
        "taken off the pixels, which are floating-point numbers"
    )
    return BlackLevel(tuple(map(exact_number, levels)), (remark,), above[:, None] + of_rows, of_columns)


def _floats(values: Numbers) -> NDArray[np.float64]:
    return np.array([float(value) for value in values])


def _pattern(path: Path, main: Directory, cfa: CfaRows, top: int, left: int) -> list[Fraction]:
    """Return BlackLevel of each channel; the visible area begins at (top, left) of the active one."""
    rows, columns = _repeat(main)
    numbers = main.values.get(BLACK_LEVEL) or _NONE * rows * columns * main.samples
    pattern = numbers[:: main.samples]  # those of the samples in turn
    period = len(cfa)
    # A site of the CFA meets each place of the pattern that it can be brought to in steps of these: all sites that
    # start alike meet the same places.
    down, right = gcd(period, rows), gcd(period, columns)
    met: dict[tuple[int, int], set[Fraction]] = {}
    levels: dict[int, set[Fraction]] = {}
    for y, x in product(range(period), repeat=2):
        first = (y + top) % down, (x + left) % right
        if first not in met:
            at = (row * columns for row in range(first[0], rows, down))
            met[first] = set().union(*(pattern[row + first[1] : row + columns : right] for row in at))
        levels.setdefault(cfa[y][x], set()).update(met[first])
        if len(levels[cfa[y][x]]) > 1:
            raise UnusableRawError(
                path,
                "its BlackLevel differs between sites of one colour",
                "one level per channel is needed",
            )
    return [levels[channel].pop() for channel in sorted(levels)]


def _masked(main: Directory, area: VisibleArea, stored: NDArray[Any]) -> tuple[float, ...] | None:
    """Return the mean of the masked pixels per channel, of all of them where a channel has none; None without any."""
    areas = main.values.get(MASKED_AREAS, ())
    sums, counts = [Fraction()] * (max(map(max, area.cfa)) + 1), [0] * (max(map(max, area.cfa)) + 1)
    period = len(area.cfa)
    for first in range(0, len(areas), 4):
        top, left, bottom, right = map(int, areas[first : first + 4])
        for y, x, channel in area.sites:
            # From the first of such sites on.
            down, across = (y + area.top - top) % period, (x + area.left - left) % period
            sites = stored[top + down : bottom : period, left + across : right : period]
            sums[channel] += Fraction(float(sites.sum(dtype=np.float64)))  # exact: below 2**53
            counts[channel] += sites.size
    if not any(counts):
        return None
    overall = sum(sums, Fraction()) / sum(counts)
    means = (total / count if count else overall for total, count in zip(sums, counts, strict=True))
    return tuple(exact_number(nearest_fraction(mean, RATIONAL)) for mean in means)
