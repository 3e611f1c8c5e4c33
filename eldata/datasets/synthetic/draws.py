"""Draws of a synthetic item: its camera, noise parameters and ratio, and whose turn it is among the dark frames.

Turns: every member of a group is used once before any is used twice, in any reading order; where several have a turn
together, a round leaves out those too few for one. Which member has its turn at a place follows from the seed and the
place alone: any number of workers read in any order, and nobody keeps count.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from eldata.base.numbers import checked_number
from eldata.base.seeds import purpose_sequence
from eldata.errors import ArgumentError
from eldata.noise.parameters import NoiseDraw
from eldata.noise.profile import CameraProfile, RowChoice

Camera: TypeAlias = CameraProfile | str | Path
Cameras: TypeAlias = Camera | Sequence[Camera]
Isos: TypeAlias = float | Sequence[float] | Mapping[float, float]

_MOST_NAMED = 4  # cameras in a repr
_BLOCKS, _MEMBERS = 4, 5  # purposes of random numbers
_BLOCK = 64  # places


@dataclass(frozen=True, slots=True)
class NoiseChoice:
    """What a draw is made from.

    Attributes
    ----------
    profiles
        The cameras.
    ratio
        (lowest, highest).
    isos
        Those to draw from; ``(None,)``: the gain is drawn.
    shares
        Probability of each ISO and those before it.
    rows
        For each camera and each ISO, how the profile is sampled there.
    extrapolate
        As in :meth:`eldata.noise.CameraProfile.sample`.
    """

    profiles: tuple[CameraProfile, ...]
    ratio: tuple[float, float]
    isos: tuple[float | None, ...]
    shares: tuple[float, ...]
    rows: tuple[tuple[RowChoice, ...], ...]
    extrapolate: bool

    @classmethod
    def of(
        cls,
        profiles: Cameras,
        ratio: float | tuple[float, float],
        iso: Isos | None = None,
        row: RowChoice | None = None,
        extrapolate: bool = False,
    ) -> NoiseChoice:
        """Load profiles by name or path, and check that they can be sampled in this way.

        Raises
        ------
        ArgumentError
            If the ratio or an ISO is invalid, there is no profile, or one cannot be sampled in this way.
        ProfileError
            If a profile is unknown or malformed.
        """
        limits = tuple(ratio) if isinstance(ratio, (tuple, list)) else (ratio, ratio)
        if len(limits) != 2:
            raise ArgumentError(f"ratio must be one number, or the lowest and the highest; found {ratio!r:.100}")
        low, high = (checked_number("ratio", limit, above=0) for limit in limits)
        if low > high:
            raise ArgumentError(f"ratio must be the lowest, then the highest; found {ratio!r:.100}")
        if isinstance(iso, np.ndarray):
            iso = iso.tolist()
        is_several = isinstance(iso, (Mapping, Sequence)) and not isinstance(iso, str)
        one_iso = None if iso is None or is_several else checked_number("iso", iso, above=0)
        weights = _weigh_isos(iso) if is_several else {one_iso: 1.0}
        loaded, isos, rows = _load_profiles(profiles), tuple(weights), []
        for profile in loaded:  # of several ISOs each has a row of its own
            rows.append([row or (_choose_row(profile, value) if is_several else "any") for value in isos])
            for value, how in zip(isos, rows[-1], strict=True):  # refuses now what it would refuse in each item
                profile.sample(np.random.default_rng(0), iso=value, row=how, extrapolate=extrapolate)
        shares = tuple(total / sum(weights.values()) for total in accumulate(weights.values()))
        return cls(loaded, (low, high), isos, shares, tuple(map(tuple, rows)), extrapolate)

    def draw(
        self,
        generator: np.random.Generator,
        range_dn: float,
        turn: tuple[int, tuple[int, ...]] | None = None,
        *,
        gain_spread: float = 0.0,
    ) -> NoiseDraw:
        """Draw a profile, one of several ISOs, parameters, and a ratio, in this order.

        Dark frames that have their turn bring their ISO with them, by its place; K then lies within a share
        ``gain_spread`` of that ISO's.
        """
        number = int(generator.integers(len(self.profiles)))
        place, dark = turn or (0, ())
        if turn is None and len(self.isos) > 1:
            place = bisect_right(self.shares[:-1], generator.random())
        profile, iso = self.profiles[number], self.isos[place]
        parameters = profile.sample(generator, iso=iso, row=self.rows[number][place], extrapolate=self.extrapolate)
        if gain_spread:
            gain = parameters.gain_dn_per_e * float(generator.uniform(1 - gain_spread, 1 + gain_spread))
            parameters = replace(parameters, gain_dn_per_e=gain)
        return NoiseDraw(parameters, float(generator.uniform(*self.ratio)), range_dn, profile.camera, number, dark)

    def __str__(self) -> str:
        """Return the cameras, and the ISOs of each by how they are sampled there."""
        named = [
            profile.camera + (f" ({_describe_rows(self.isos, rows)})" if self.isos != (None,) else "")
            for profile, rows in zip(self.profiles, self.rows, strict=True)
        ]
        return ", ".join(named if len(named) <= _MOST_NAMED else [*named[:2], f"... {len(named)} in all"])


def _weigh_isos(isos: Any) -> dict[float | None, float]:
    """Return the weight of each of several ISOs, alike if none are given."""
    if not isos:
        raise ArgumentError("iso must be one ISO or several; found none")
    weights: dict[float | None, float] = {}
    for key in isos:
        iso = checked_number("iso", key, above=0)
        if iso in weights:
            raise ArgumentError(
                f"ISO {iso:g} is there twice; to draw some more often give weights, iso={{{iso:g}: 2, ...}}"
            )
        weight = isos[key] if isinstance(isos, Mapping) else 1.0
        weights[iso] = checked_number(f"the weight of ISO {iso:g}", weight, above=0)
    return weights


def _choose_row(profile: CameraProfile, iso: float | None) -> RowChoice:
    """Choose how to sample an ISO with its own row: as measured, or around the fits if not all was measured there."""
    try:
        profile.sample(np.random.default_rng(0), iso=iso, row="measured")
    except ArgumentError:
        return "nearest-gain"
    return "measured"


def _describe_rows(isos: Sequence[float | None], rows: Sequence[RowChoice]) -> str:
    """Describe each ISO's way of sampling in words: ``ISO 100, 200: nearest``."""
    by_row: dict[str, list[str]] = {}
    for iso, row in zip(isos, rows, strict=True):
        by_row.setdefault(row, []).append(f"{iso:g}")
    return "; ".join(f"ISO {', '.join(listed)}: {row}" for row, listed in by_row.items())


def _load_profiles(cameras: Any) -> tuple[CameraProfile, ...]:
    """Load one profile or several, each given by name, by path or itself."""
    if isinstance(cameras, (str, Path, CameraProfile)):
        cameras = [cameras]
    if not isinstance(cameras, Sequence) or not all(
        isinstance(camera, (str, Path, CameraProfile)) for camera in cameras
    ):
        raise ArgumentError(
            f"expected a camera profile or several: each a shipped one's name, a path or a CameraProfile; found "
            f"{cameras!r:.100}"
        )
    if not cameras:
        raise ArgumentError("give at least one camera profile")
    return tuple(camera if isinstance(camera, CameraProfile) else CameraProfile.load(camera) for camera in cameras)


# --- turns ------------------------------------------------------------------------------------------------------------


class Turns:
    """An endless sequence of turns, of groups by their weights and of their members one by one.

    In each block of 64 places a group has its turn as often as its weight asks for, to one more or less, in an order
    that is drawn for the block. Its members come in rounds, each round in an order of its own.

    Parameters
    ----------
    seed
        As of a dataset.
    weights
        Of each group, above 0.
    sizes
        Members of each group.
    each
        Members that have a turn together, all different; those too few for one at a round's end sit it out.
    """

    def __init__(self, seed: int, weights: Sequence[float], sizes: Sequence[int], each: int = 1) -> None:
        self.seed, self.sizes, self.each = seed, tuple(sizes), each
        left = [sum(map(Fraction, weights[first:])) for first in range(len(weights))]
        # Of what the groups before it leave, a group takes this share. So each group's count never falls from place to
        # place, as it could if shares of the whole were rounded.
        self._shares = [Fraction(weight) / rest for weight, rest in zip(weights, left, strict=True)]

    def at(self, place: int) -> tuple[int, tuple[int, ...]]:
        """Return the group whose turn it is, and which members of it."""
        block, within = divmod(place, _BLOCK)
        before, after = self._counts(block * _BLOCK), self._counts((block + 1) * _BLOCK)
        groups = np.repeat(np.arange(len(before)), np.subtract(after, before))
        if len(before) > 1:
            np.random.default_rng(purpose_sequence(self.seed, 0, _BLOCKS, block)).shuffle(groups)
        group = int(groups[within])
        turn = before[group] + int((groups[:within] == group).sum())
        turn_round, number = divmod(turn, self.sizes[group] // self.each)
        sequence = purpose_sequence(self.seed, 0, _MEMBERS, group, turn_round)
        order = np.random.default_rng(sequence).permutation(self.sizes[group])
        return group, tuple(order[number * self.each : (number + 1) * self.each].tolist())

    def _counts(self, places: int) -> list[int]:
        """Count the turns of each group in the first places."""
        counts = []
        for share in self._shares:
            counts.append(int(places * share))
            places -= counts[-1]
        return counts
