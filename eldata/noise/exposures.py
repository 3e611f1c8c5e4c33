"""What an engine of the noise model is told: the components, and each image's parameters as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError
from eldata.noise.packed_rows import channel_bias_dn
from eldata.noise.parameters import tukey_lambda_variance
from eldata.noise.structure import known_structure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.noise.components import Components
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.structure import NoiseStructure


_LOWEST_SHAPE = -0.49  # lambda, whose variance ends at -1/2


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
    shading_dn
        (N, C, h, w) float32: a dark shading to be taken off, over the black level; ``None``: none is.
    scale
        (N,) float64: what is left of each image times this; goes with a shading.
    """

    dn: NDArray[np.uint16]
    black_level_dn: NDArray[np.float64]
    shading_dn: NDArray[np.float32] | None = None
    scale: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """Noisy exposures to draw of a batch of N clean packed images (N, C, h, w).

    With I = clean range / (ratio K) photoelectrons::

        D = K Poisson(I r) + read noise + bias + row noise + columns + telegraph + dark frame + dark shading
            + U(-1/2, 1/2),
        out = D ratio / range

    each term if its component is there, as is r, the pixel's response. An ``adc`` rounds D + black to an integer from 0
    to white and takes black off again; ``limits`` bound the output.

    Attributes
    ----------
    range_dn
        White level minus black level, above 0; where the images differ, (N,) float64.
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
    shading_dn
        (N, C, h, w) float32, or (1, C, h, w) for all images alike: the dark shading of component S, DN; ``None``: it is
        off.
    structure
        Of each image, the figures of C, W, T and F; empty without these components. With C or T the read noise above
        is that which a pixel has for itself.
    sensor_seed, place
        Which sensor it is, and the row and column of the first packed pixel on it.
    """

    components: Components
    range_dn: float | NDArray[np.float64]
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
    shading_dn: NDArray[np.float32] | None = None
    structure: tuple[NoiseStructure, ...] = ()
    sensor_seed: int = 0
    place: tuple[int, int] = (0, 0)

    @classmethod
    def of(
        cls,
        components: Components,
        drawn: Sequence[NoiseParameters],
        ratios: Sequence[float],
        channels: int,
        *,
        range_dn: float | Sequence[float],
        adc: Adc | None = None,
        limits: tuple[float, float] = (-math.inf, math.inf),
        dark: DarkCrops | None = None,
        dithers: bool = False,
        shading_dn: NDArray[np.float32] | None = None,
        sensor_seed: int = 0,
        place: tuple[int, int] = (0, 0),
    ) -> Exposures:
        """Take the parameters that the components need, one of each per image."""

        def array(values: list[float], on: bool = True) -> NDArray[np.float64]:
            return np.array(values, dtype=np.float64) * on

        tukey = components.read == "tukey-lambda"
        bias = [channel_bias_dn(p, channels) if components.colour_bias else (0.0,) * channels for p in drawn]
        if dark is not None:
            bias = np.negative(dark.black_level_dn).tolist()
        structure = tuple(known_structure(components, p.structure) for p in drawn) if components.structured else ()
        if components.column or components.telegraph:
            drawn = [pixels_own(components, p) for p in drawn]
        return cls(
            components=components,
            range_dn=range_dn if isinstance(range_dn, float) else array(list(range_dn)),
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
            shading_dn=shading_dn,
            structure=structure,
            sensor_seed=sensor_seed,
            place=place,
        )


def read_variance_dn2(components: Components, parameters: NoiseParameters) -> float:
    """Return the variance of the read noise that the parameters state, DN^2; 0 where a model has none."""
    if components.read == "tukey-lambda":
        return parameters.sigma_tl_dn**2 * tukey_lambda_variance(parameters.tukey_lambda)
    return parameters.sigma_gauss_dn**2 if components.read == "gaussian" else 0.0


def structured_variance_dn2(components: Components, parameters: NoiseParameters) -> float:
    """Return what columns and telegraph pixels add to the variance over pixels and frames, DN^2."""
    if not components.structured:
        return 0.0
    found = known_structure(components, parameters.structure)
    of_columns = (found.sigma_column_dn or 0.0) ** 2 if components.column else 0.0
    jumping = found.telegraph.variance_dn2 if components.telegraph and found.telegraph is not None else 0.0
    return of_columns + jumping


def pixels_own(components: Components, parameters: NoiseParameters) -> NoiseParameters:
    """Return the parameters with the read noise that a pixel has for itself, where a model has C or T.

    Measured read noise is that of all pixels, with all that they do: what a component makes of it must not be in it
    twice.
    """
    if not (components.column or components.telegraph):
        return parameters
    found = known_structure(components, parameters.structure)
    shape, scale, gauss = parameters.tukey_lambda, parameters.sigma_tl_dn, parameters.sigma_gauss_dn
    if components.telegraph and found.telegraph is not None:
        shape = min(max(shape + found.telegraph.tukey_lambda_shift, _LOWEST_SHAPE), 2.0)
        scale, gauss = scale * found.telegraph.sigma_tl_ratio, gauss * found.telegraph.sigma_gauss_ratio
    if components.column:
        of_columns = (found.sigma_column_dn or 0.0) ** 2
        scale = math.sqrt(max(scale**2 - of_columns / tukey_lambda_variance(shape), 0.0))
        gauss = math.sqrt(max(gauss**2 - of_columns, 0.0))
    return replace(parameters, tukey_lambda=shape, sigma_tl_dn=scale, sigma_gauss_dn=gauss)
