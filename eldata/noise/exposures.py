"""What an engine of the noise model is told: the components, and each image's parameters as arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from eldata.base.arrays import is_tensor
from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError
from eldata.noise.mosaic import channel_bias_dn
from eldata.noise.parameters import tukey_lambda_variance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.components import Components
    from eldata.noise.parameters import NoiseParameters


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

        D = K Poisson(I) + read noise + bias + row noise + dark frame + U(-q/2, q/2),
        out = D ratio / range

    each term if its component is there. An ``adc`` rounds D + black to a multiple of q, and this to an integer from 0
    to white, and takes black off again; ``limits`` bound the output.

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
            **others,
        )


def read_variance_dn2(components: Components, parameters: NoiseParameters) -> float:
    """Return the variance of the read noise that the parameters state, DN^2; 0 where a model has none."""
    if components.read == "tukey-lambda":
        return parameters.sigma_tl_dn**2 * tukey_lambda_variance(parameters.tukey_lambda)
    return parameters.sigma_gauss_dn**2 if components.read == "gaussian" else 0.0


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
