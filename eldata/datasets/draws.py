"""What is drawn for a synthetic item: its camera, noise and ratio."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

import numpy as np
import torch

from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError
from eldata.noise.profile import CameraProfile

if TYPE_CHECKING:
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import RowChoice

Camera: TypeAlias = CameraProfile | str | Path
Cameras: TypeAlias = Camera | Sequence[Camera]


class NoiseFacts(TypedDict):
    """The parameters that an item's noise was made with (:class:`eldata.noise.NoiseParameters`) and its exposure ratio.

    ``colour_bias_dn`` is (4,) float64.
    """

    ratio: float
    camera: str
    gain_dn_per_e: float
    tukey_lambda: float
    sigma_tl_dn: float
    sigma_gauss_dn: float
    sigma_row_dn: float
    colour_bias_dn: torch.Tensor


@dataclass(frozen=True, slots=True)
class NoiseDraw:
    """One draw: camera, noise parameters, exposure ratio."""

    camera: str
    parameters: NoiseParameters
    ratio: float

    def facts(self) -> dict[str, Any]:
        """Return the draw as fields of a sample: a :class:`NoiseFacts`."""
        facts = {"ratio": self.ratio, "camera": self.camera, **self.parameters.as_dict()}
        return facts | {"colour_bias_dn": torch.tensor(self.parameters.colour_bias_dn, dtype=torch.float64)}


@dataclass(frozen=True, slots=True)
class NoiseChoice:
    """What a draw is made from: profiles, (lowest, highest) ratio, and how a profile is sampled."""

    profiles: tuple[CameraProfile, ...]
    ratio: tuple[float, float]
    iso: float | None
    row: RowChoice
    extrapolate: bool

    @classmethod
    def of(
        cls,
        profiles: Cameras,
        ratio: float | tuple[float, float],
        iso: float | None,
        row: RowChoice,
        extrapolate: bool = False,
    ) -> NoiseChoice:
        """Load profiles by name or path and check the ratio.

        Raises
        ------
        ArgumentError
            If the ratio is invalid, there is no profile, or one cannot be sampled in this way.
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
        if iso is not None:
            checked_number("iso", iso, above=0)
        for profile in loaded:  # refuses now what it would refuse in each item
            profile.sample(np.random.default_rng(0), iso=iso, row=row, extrapolate=extrapolate)
        return cls(loaded, (low, high), iso, row, extrapolate)

    def draw(self, generator: np.random.Generator) -> NoiseDraw:
        """Draw a profile, parameters from it, and a ratio, in this order."""
        profile = self.profiles[int(generator.integers(len(self.profiles)))]
        parameters = profile.sample(generator, iso=self.iso, row=self.row, extrapolate=self.extrapolate)
        return NoiseDraw(profile.camera, parameters, float(generator.uniform(*self.ratio)))


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
