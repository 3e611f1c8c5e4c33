"""What is drawn for a synthetic item: its camera, noise and ratio; and whose turn it is, where turns are taken.

Taking turns is to have each member of a group once before any of it twice, whatever is asked for first. Which member
has its turn at a place of the sequence follows from the seed and the place alone: items are read in any order by any
number of workers, and nobody keeps count.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

import numpy as np
import torch

from eldata.base.numbers import checked_number
from eldata.base.seeds import purpose_sequence
from eldata.errors import ArgumentError
from eldata.noise.profile import CameraProfile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import RowChoice

Camera: TypeAlias = CameraProfile | str | Path
Cameras: TypeAlias = Camera | Sequence[Camera]
Isos: TypeAlias = float | Sequence[float] | Mapping[float, float]

_BLOCKS, _MEMBERS, _SPLIT = 4, 5, 7  # purposes of random numbers
_BLOCK = 64  # places
_MOST_NAMED = 4  # cameras in a repr


class NoiseFacts(TypedDict):
    """The parameters that an item's noise was made with (:class:`eldata.noise.NoiseParameters`) and its exposure ratio.

    ``colour_bias_dn`` is (4,) float64. ``iso`` is the ISO that was given or drawn, 0 where the gain was drawn;
    ``camera_id`` the place of the camera among those of the dataset. ``dark_frame`` says where the dark frame of
    component D comes from, of a clip those of its frames in order; empty: there is none.
    """

    ratio: float
    camera: str
    camera_id: int
    iso: float
    gain_dn_per_e: float
    tukey_lambda: float
    sigma_tl_dn: float
    sigma_gauss_dn: float
    sigma_row_dn: float
    colour_bias_dn: torch.Tensor
    dark_frame: str


@dataclass(frozen=True, slots=True)
class NoiseDraw:
    """One draw: camera and its number, ISO if known, noise parameters, exposure ratio, and numbers of dark frames."""

    camera: str
    camera_id: int
    iso: float | None
    parameters: NoiseParameters
    ratio: float
    dark: tuple[int, ...] = ()

    def facts(self) -> dict[str, Any]:
        """Return the draw as fields of a sample: a :class:`NoiseFacts`."""
        return {
            "ratio": self.ratio,
            "camera": self.camera,
            "camera_id": self.camera_id,
            "iso": self.iso or 0.0,
            **self.parameters.as_dict(),
            # By numpy: torch.tensor takes three times as long.
            "colour_bias_dn": torch.from_numpy(np.array(self.parameters.colour_bias_dn, np.float64)),
        }


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
        loaded = _loaded(profiles)
        isos: tuple[float | None, ...] = (None,)
        weights: tuple[float, ...] = (1.0,)
        usual: RowChoice | None = "any"
        if isinstance(iso, np.ndarray):
            iso = iso.tolist()
        if isinstance(iso, Mapping) or (isinstance(iso, Sequence) and not isinstance(iso, str)):
            isos, weights = _weighted(iso)
            usual = None  # each ISO has a row of its own
        elif iso is not None:
            isos = (checked_number("iso", iso, above=0),)
        rows = tuple(tuple(row or usual or _own_row(profile, one) for one in isos) for profile in loaded)
        for profile, row_each in zip(loaded, rows, strict=True):  # refuses now what it would refuse in each item
            for one, how in zip(isos, row_each, strict=True):
                profile.sample(np.random.default_rng(0), iso=one, row=how, extrapolate=extrapolate)
        shares = tuple(total / sum(weights) for total in accumulate(weights))
        return cls(loaded, (low, high), isos, shares, rows, extrapolate)

    def draw(
        self,
        generator: np.random.Generator,
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
        return NoiseDraw(profile.camera, number, iso, parameters, float(generator.uniform(*self.ratio)), dark)

    def __str__(self) -> str:
        """Return the cameras, and the ISOs of each by how they are sampled there."""
        named = [
            profile.camera + (f" ({_listed(self.isos, rows)})" if self.isos != (None,) else "")
            for profile, rows in zip(self.profiles, self.rows, strict=True)
        ]
        return ", ".join(named if len(named) <= _MOST_NAMED else [*named[:2], f"... {len(named)} in all"])


def draw_splits(seed: int, shares: tuple[float, float] | None, count: int) -> list[str]:
    """Draw the split of each of so many scenes or clips, ``train`` or ``test``, by their shares; ``None``: no splits.

    Raises
    ------
    ArgumentError
        If a share is not above 0, or one of the splits would be empty.
    """
    if shares is None:
        return [""] * count
    train, test = (checked_number("split", share, above=0) for share in shares)
    held = round(count * test / (train + test))
    if not 0 < held < count:
        raise ArgumentError(
            f"split {train:g}:{test:g} of {count} scenes or clips leaves {held} to test on; give more, or other shares"
        )
    chosen = set(np.random.default_rng(purpose_sequence(seed, 0, _SPLIT)).permutation(count)[:held].tolist())
    return ["test" if number in chosen else "train" for number in range(count)]


def _weighted(isos: Sequence[float] | Mapping[float, float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return ISOs, each once, and their weights, alike if none are given."""
    given = tuple(checked_number("iso", iso, above=0) for iso in isos)
    weights = tuple(isos.values()) if isinstance(isos, Mapping) else (1.0,) * len(given)
    weights = tuple(
        checked_number(f"the weight of ISO {iso:g}", w, above=0) for iso, w in zip(given, weights, strict=True)
    )
    if not given:
        raise ArgumentError("iso must be one ISO or several; found none")
    for iso in given:
        if given.count(iso) > 1:
            raise ArgumentError(
                f"ISO {iso:g} is there twice; to draw some more often give weights, iso={{{iso:g}: 2, ...}}"
            )
    return given, weights


def _own_row(profile: CameraProfile, iso: float | None) -> RowChoice:
    """Return how to sample an ISO with its own row: as measured, or around the fits if not all was measured there."""
    try:
        profile.sample(np.random.default_rng(0), iso=iso, row="measured")
    except ArgumentError:
        return "nearest-gain"
    return "measured"


def _listed(isos: Sequence[float | None], rows: Sequence[RowChoice]) -> str:
    by_row: dict[str, list[str]] = {}
    for iso, row in zip(isos, rows, strict=True):
        by_row.setdefault(row, []).append(f"{iso:g}")
    return "; ".join(f"ISO {', '.join(listed)}: {row}" for row, listed in by_row.items())


def _loaded(cameras: Any) -> tuple[CameraProfile, ...]:
    """Return profiles that were given by name, path or themselves, one or several."""
    if isinstance(cameras, (str, Path, CameraProfile)):
        cameras = [cameras]
    if not isinstance(cameras, Sequence) or not all(isinstance(one, (str, Path, CameraProfile)) for one in cameras):
        raise ArgumentError(
            f"expected a camera profile or several: each a shipped one's name, a path or a CameraProfile; found "
            f"{cameras!r:.100}"
        )
    if not cameras:
        raise ArgumentError("give at least one camera profile")
    return tuple(one if isinstance(one, CameraProfile) else CameraProfile.load(one) for one in cameras)


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
        Members that have a turn together, all different: for that a group must have :func:`fewest_members`.
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
        return group, tuple(self._member(group, turn * self.each + more) for more in range(self.each))

    def _counts(self, places: int) -> list[int]:
        """Return how often each group had its turn in the first places."""
        counts = []
        for share in self._shares:
            counts.append(int(places * share))
            places -= counts[-1]
        return counts

    def _member(self, group: int, number: int) -> int:
        turn_round, place = divmod(number, self.sizes[group])
        return int(self._order(group, turn_round)[place])

    def _order(self, group: int, turn_round: int) -> NDArray[np.int64]:
        """Return the members in the order of one round.

        The first ``each - 1`` may stand in one turn with the last ones of the round before. Those that do occur there
        change places with others from the middle, so that a round's end is what was drawn, and no round depends on more
        than the one before.
        """
        order = self._drawn(group, turn_round)
        edge = self.each - 1
        if edge == 0 or turn_round == 0:
            return order
        last = set(self._drawn(group, turn_round - 1)[-edge:].tolist())
        others = (place for place in range(edge, len(order) - edge) if order[place] not in last)
        for place in range(edge):
            if order[place] in last:
                other = next(others)
                order[place], order[other] = order[other], order[place]
        return order

    def _drawn(self, group: int, turn_round: int) -> NDArray[np.int64]:
        sequence = purpose_sequence(self.seed, 0, _MEMBERS, group, turn_round)
        return np.random.default_rng(sequence).permutation(self.sizes[group])


def fewest_members(each: int) -> int:
    """Return how many members a group needs for turns of several that are all different.

    Let e be ``each - 1``. Of n members, n - 2 e stand in the middle of a round. If h of the e last ones of the round
    before stand at its head, h places in the middle must hold none of them, and e - h at most do: n - 2 e - (e - h)
    must be h or more.
    """
    return max(1, each, 3 * (each - 1))
