"""What an engine of the noise model is told: the components, and each image's parameters as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError
from eldata.noise.packed_rows import channel_bias_dn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.noise.components import Components
    from eldata.noise.parameters import NoiseParameters


@dataclass(frozen=True, slots=True)
class Adc:
    """A real analogue-to-digital converter: rounds to whole DN and saturates at 0 and at the white level."""

    black_level_dn: float
    white_level_dn: float

    def __post_init__(self) -> None:
        black = checked_number("black_level_dn", self.black_level_dn)
        if not 0 <= black < checked_number("white_level_dn", self.white_level_dn):
            raise ArgumentError(f"expected 0 <= black level < white level; found {self}")


@dataclass(frozen=True, slots=True, eq=False)
class DarkCrops:
    """Crops of dark frames.

    Attributes
    ----------
    dn
        (N, C, h, w) uint16: DN as the files have them, packed.
    black_level_dn
        (N, C) float64: the black level of each packed channel.
    """

    dn: NDArray[np.uint16]
    black_level_dn: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """Noisy exposures to draw of a batch of N clean packed images (N, C, h, w).

    With I = clean range / (ratio K) photoelectrons::

        D = K Poisson(I) + read noise + bias + row noise + dark frame + U(-1/2, 1/2),    out = D ratio / range

    each term if its component is there. An ``adc`` rounds D + black to an integer from 0 to white and takes black off
    again; ``limits`` bound the output.

    Attributes
    ----------
    range_dn
        White level minus black level, above 0.
    gain_dn_per_e, ratio
        (N,) float64: K in DN per photoelectron, and the exposure ratio, above 0.
    tukey_lambda, sigma_read_dn, sigma_row_dn
        (N,) float64: shape of the read noise, its scale, and the row noise; 0 where the component is off.
    bias_dn
        (N, C) float64: colour bias, 0 where it is off; with dark frames, what is taken off them, the black level.
    dark
        Crops of dark frames; ``None``: the component is off.
    dithers
        Whether they are dithered: by U(-1/2, 1/2), before any rounding.
    """

    components: Components
    range_dn: float
    gain_dn_per_e: NDArray[np.float64]
    ratio: NDArray[np.float64]
    tukey_lambda: NDArray[np.float64]
    sigma_read_dn: NDArray[np.float64]
    sigma_row_dn: NDArray[np.float64]
    bias_dn: NDArray[np.float64]
    adc: Adc | None = None
    limits: tuple[float, float] = (-math.inf, math.inf)
    dark: DarkCrops | None = None
    dithers: bool = False

    @classmethod
    def of(
        cls,
        components: Components,
        drawn: Sequence[NoiseParameters],
        ratios: Sequence[float],
        channels: int,
        *,
        range_dn: float,
        adc: Adc | None = None,
        limits: tuple[float, float] = (-math.inf, math.inf),
        dark: DarkCrops | None = None,
        dithers: bool = False,
    ) -> Exposures:
        """Take the parameters that the components need, one of each per image."""

        def array(values: list[float], on: bool = True) -> NDArray[np.float64]:
            return np.array(values, dtype=np.float64) * on

        tukey = components.read == "tukey-lambda"
        bias = [channel_bias_dn(p, channels) if components.colour_bias else (0.0,) * channels for p in drawn]
        if dark is not None:
            bias = np.negative(dark.black_level_dn).tolist()
        return cls(
            components=components,
            range_dn=range_dn,
            gain_dn_per_e=array([p.gain_dn_per_e for p in drawn]),
            ratio=array(list(ratios)),
            tukey_lambda=array([p.tukey_lambda for p in drawn], tukey),
            sigma_read_dn=array(
                [p.sigma_tl_dn if tukey else p.sigma_gauss_dn for p in drawn], components.read != "none"
            ),
            sigma_row_dn=array([p.sigma_row_dn for p in drawn], components.row),
            bias_dn=np.array(bias, dtype=np.float64).reshape(len(drawn), channels),
            adc=adc,
            limits=limits,
            dark=dark,
            dithers=dithers,
        )
