"""What an engine of the noise model is told: the components, and each image's parameters as arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from eldata.base.arguments import is_tensor
from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError
from eldata.noise.mosaic import channel_bias_dn, first_place, pack_whole, whole_shape
from eldata.noise.parameters import tukey_lambda_variance
from eldata.noise.structure import known_structure

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.dark_shading import DarkShading
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.structure import Components, NoiseStructure


_LOWEST_SHAPE = -0.49  # lambda, whose variance ends at -1/2


@dataclass(frozen=True, slots=True)
class Adc:
    """A real analogue-to-digital converter: rounds to whole DN and saturates at 0 and at the white level.

    Where parameters state another ``quantisation_step_dn`` it rounds to multiples of that, and these to whole DN.
    """

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


class DarkSource(Protocol):
    """Where component D of a noise model has its frames from; :class:`eldata.datasets.DarkFrames` is one."""

    @property
    def dither(self) -> bool:
        """Whether they are dithered, by U over one step of the values."""

    def draw(self, iso: float, count: int, shape: tuple[int, int, int], generator: np.random.Generator) -> DarkCrops:
        """Return crops (count, C, h, w) of as many frames of an ISO, from one place of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """Noisy exposures to draw of a batch of N clean packed images (N, C, h, w).

    With I = clean range / (ratio K) photoelectrons::

        D = K Poisson(I r) + read noise + bias + row noise + columns + telegraph + dark frame + dark shading
            + U(-q/2, q/2),
        out = D ratio / range

    each term if its component is there, as is r, the pixel's response. An ``adc`` rounds D + black to a multiple of q,
    and this to an integer from 0 to white, and takes black off again; ``limits`` bound the output.

    Attributes
    ----------
    range_dn
        White level minus black level, above 0; where the images differ, (N,) float64.
    gain_dn_per_e, ratio
        (N,) float64: K in DN per photoelectron, and the exposure ratio, above 0.
    tukey_lambda, sigma_read_dn, sigma_row_dn
        (N,) float64: shape of the read noise, its scale, and the row noise; 0 where the component is off.
    step_dn
        (N,) float64: the quantisation step q, above 0.
    bias_dn
        (N, C) float64: colour bias, 0 where it is off; with dark frames, what is taken off them, the black level.
    dark
        Crops of dark frames; ``None``: the component is off.
    dithers
        Whether they are dithered: by U(-q/2, q/2), before any rounding.
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
    step_dn: NDArray[np.float64]
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
        dark: DarkCrops | None = None,
        **others: Any,
    ) -> Exposures:
        """Take the parameters that the components need, one of each per image, and the other fields as they are."""

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
            step_dn=array([p.quantisation_step_dn for p in drawn]),
            bias_dn=np.array(bias, dtype=np.float64).reshape(len(drawn), channels),
            dark=dark,
            structure=structure,
            **others,
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


# --- what a call gives, one of each per image ----------------------------------------------------------------------


def check_normalised(clean: Any, name: str = "clean") -> None:
    """Refuse what cannot be normalised data.

    Raises
    ------
    ArgumentError
        If it is neither an array nor a tensor, or of anything but floating numbers.
    """
    if is_tensor(clean):
        is_float, is_whole = clean.is_floating_point(), not clean.is_complex()
    elif isinstance(clean, np.ndarray):
        is_float, is_whole = clean.dtype.kind == "f", clean.dtype.kind in "iu"
    else:
        raise ArgumentError(f"{name} must be a numpy array or a torch tensor, not {type(clean).__name__}")
    if is_float:
        return
    if is_whole:
        raise ArgumentError(
            f"{name} is {clean.dtype}, whole numbers as a file has them, and expected is normalised data, where 0 is "
            "black and 1 is white; give (clean - black) / (white - black) in float32, as eldata.raw.normalise makes it "
            "of packed DN and eldata.raw.pack_normalised of a mosaic"
        )
    raise ArgumentError(f"{name} is {clean.dtype}; expected floating numbers, such as float32, where 1 is white")


def one_each(value: Any, images: int, name: str) -> list[Any]:
    """Return one value for each image, of one for all or of one for each; of others raise :class:`ArgumentError`."""
    if isinstance(value, np.ndarray) or is_tensor(value):
        value = value.tolist()
    if isinstance(value, str) or not isinstance(value, Sequence):
        return [value] * images
    if len(value) != images:
        raise ArgumentError(f"{name}: expected one, or one for each of {images} images; found {len(value)}")
    return list(value)


def common_range_dn(drawn: Sequence[NoiseParameters]) -> float:
    """Return the range from black to white that the parameters bring with them."""
    known = {item.range_dn for item in drawn}
    if len(known) == 1 and (range_dn := known.pop()) is not None:
        return range_dn
    found = "differ in it" if len(known) > 1 else "do not know it (their profile states no levels)"
    raise ArgumentError(f"give range_dn, the white level minus the black level in DN: the parameters {found}")


def drawn_dark(
    source: DarkSource,
    drawn: Sequence[NoiseParameters],
    is_clip: bool,
    packed: tuple[int, int, int],
    generator: np.random.Generator,
) -> DarkCrops:
    """Return a dark crop for each image."""

    def of(parameters: NoiseParameters, count: int) -> DarkCrops:
        if parameters.iso is None:
            raise ArgumentError(
                "component D takes dark frames of the parameters' ISO, and they do not state it; draw them at one, as "
                "profile.sample(generator, iso=800) does"
            )
        return source.draw(parameters.iso, count, packed, generator)

    if is_clip or len(drawn) == 1:
        return of(drawn[0], len(drawn))
    each = [of(parameters, 1) for parameters in drawn]
    fields = [[getattr(one, name) for one in each] for name in DarkCrops.__slots__]
    joined: list[Any] = [None if of_each[0] is None else np.concatenate(of_each) for of_each in fields]
    return DarkCrops(*joined)


def shading_of_each(
    shading: DarkShading,
    drawn: Sequence[NoiseParameters],
    packed: tuple[int, int, int],
    place: tuple[int, int],
    times: Sequence[float | None],
) -> NDArray[np.float32]:
    """Return the dark shading of the ISO and time of each image (N, C, h, w), or once if all have one.

    Raises
    ------
    ArgumentError
        If a draw states no ISO, or the shading is of other channels than ``packed`` (C, h, w).
    """
    isos = [one.iso for one in drawn if one.iso is not None]
    if len(isos) < len(drawn):
        raise ArgumentError(
            "component S adds the dark shading of the parameters' ISO, and they do not state it; draw them at one, "
            "as profile.sample(generator, iso=800) does"
        )
    each = list(zip(isos, [None] * len(isos) if shading.current is None else times, strict=True))
    is_whole = packed == whole_shape(shading.hot.shape, shading.cfa) and place == first_place(shading.cfa)
    if is_whole:  # as on_mosaic packs
        of_one = {one: pack_whole(shading.at(one[0], exposure_s=one[1]), shading.cfa) for one in set(each)}
    else:
        region = (*place, *packed[1:])
        of_one = {one: shading.packed(one[0], region, exposure_s=one[1]) for one in set(each)}
    found = of_one[each[0]][None] if len(of_one) == 1 else np.stack([of_one[one] for one in each])
    if found.shape[1:] != packed:
        raise ArgumentError(f"the dark shading of {shading.camera} has {found.shape[1]} channels, not {packed[0]}")
    return found
