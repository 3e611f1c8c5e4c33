"""What is drawn for a synthetic item: its camera, noise and ratio."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict

import torch

from eldata.errors import ArgumentError
from eldata.noise.profile import CameraProfile

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import RowChoice


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
        profiles: CameraProfile | str | Sequence[CameraProfile | str],
        ratio: float | tuple[float, float],
        iso: float | None,
        row: RowChoice,
        extrapolate: bool = False,
    ) -> NoiseChoice:
        """Load profiles by name or path and check the ratio.

        Raises
        ------
        ArgumentError
            If the ratio is invalid, or there is no profile.
        ProfileError
            If a profile is unknown or malformed.
        """
        low, high = ratio if isinstance(ratio, tuple) else (ratio, ratio)
        if not 0 < low <= high < math.inf:
            raise ArgumentError(f"ratio must be finite and above 0, the lower first; found {ratio}")
        given = [profiles] if isinstance(profiles, (str, CameraProfile)) else list(profiles)
        if not given:
            raise ArgumentError("give at least one camera profile")
        loaded = tuple(CameraProfile.load(item) if isinstance(item, str) else item for item in given)
        return cls(loaded, (float(low), float(high)), iso, row, extrapolate)

    def draw(self, generator: np.random.Generator) -> NoiseDraw:
        """Draw a profile, parameters from it, and a ratio, in this order."""
        profile = self.profiles[int(generator.integers(len(self.profiles)))]
        parameters = profile.sample(generator, iso=self.iso, row=self.row, extrapolate=self.extrapolate)
        return NoiseDraw(profile.camera, parameters, float(generator.uniform(*self.ratio)))
