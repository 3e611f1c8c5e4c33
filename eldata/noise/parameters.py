"""Draws of the noise model: the parameters of an exposure, and the random numbers that draws take."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field, fields
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError
from eldata.raw.levels import packed_layouts

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

Generator: TypeAlias = "np.random.Generator | torch.Generator"

# The Tukey-lambda family has finite variance for lambda > -1/2 only; beyond 2 its shape repeats.
_LAMBDA_RANGE = (-0.5, 2.0)


def shape_problem(tukey_lambda: float) -> str | None:
    """Describe the range that a Tukey-lambda shape lies outside of; ``None`` if it lies inside."""
    low, high = _LAMBDA_RANGE
    return None if low < tukey_lambda <= high else f"above {low:g} and not above {high:g}"


@dataclass(frozen=True, slots=True)
class NoiseParameters:
    """Parameters of one exposure (or clip) of one camera.

    Attributes
    ----------
    gain_dn_per_e
        Overall system gain K, DN per photoelectron, above 0.
    tukey_lambda
        Shape of the read noise, above -0.5 (finite variance) and at most 2; 0 is the logistic distribution.
    sigma_tl_dn, sigma_gauss_dn
        Scale of the Tukey-lambda read noise (not its standard deviation), and the standard deviation of the Gaussian
        one, DN.
    sigma_row_dn
        Standard deviation of the row noise, DN.
    colour_bias_dn
        Mean of the read noise in R, G1, B, G2, DN: four numbers, kept as a tuple.
    range_dn
        White level minus black level of the camera that they are of, DN, where its profile states it: what the noise
        model takes if it is not told another. Not a parameter of the noise: draws that differ in it alone are equal.
    iso
        Their ISO, where one was given or drawn; component D takes dark frames of it. Not a parameter of the noise.
    quantisation_step_dn
        The step q by which the camera's values go, DN, above 0 (section 3.1.3 of the paper): component U is uniform
        from -q / 2 to q / 2, and a converter rounds to it. 1 unless files hold fewer values than they have room for. It
        is of the camera, and not drawn: draws do not differ in it.

    Raises
    ------
    ArgumentError
        If a value is not a finite number or out of its range; the message names it.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.noise import NoiseModel, NoiseParameters
    >>> parameters = NoiseParameters(
    ...     gain_dn_per_e=1.5, tukey_lambda=0.0, sigma_tl_dn=2.5, sigma_gauss_dn=5.0, sigma_row_dn=0.5, range_dn=15871.0
    ... )
    >>> dark = np.zeros((4, 256, 256), np.float32)
    >>> noisy = NoiseModel("G")(dark, parameters=parameters, ratio=1.0, generator=np.random.default_rng(0))
    >>> round(float(noisy.std()) * 15871)
    5
    """

    gain_dn_per_e: float
    tukey_lambda: float
    sigma_tl_dn: float
    sigma_gauss_dn: float
    sigma_row_dn: float
    colour_bias_dn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    range_dn: float | None = field(default=None, compare=False)
    iso: float | None = field(default=None, compare=False)
    quantisation_step_dn: float = field(default=1.0, compare=False)

    def __post_init__(self) -> None:
        above = dict.fromkeys(("gain_dn_per_e", "range_dn", "iso", "quantisation_step_dn"), 0.0)
        for name in self.__slots__:
            value = getattr(self, name)
            if name != "colour_bias_dn" and (value is not None or name in _noise_fields()):
                checked_number(name, value, above=above.get(name, -math.inf))
            if name.startswith("sigma") and value < 0:
                raise ArgumentError(f"{name} must not be negative; found {value}")
        if (problem := shape_problem(self.tukey_lambda)) is not None:
            raise ArgumentError(f"tukey_lambda must lie {problem}; found {self.tukey_lambda}")
        # Lists, and the arrays and tensors that samples have, become a tuple: a draw can be compared and is a key.
        bias: Any = self.colour_bias_dn
        values = bias.tolist() if hasattr(bias, "tolist") else bias
        if not isinstance(values, (tuple, list)) or len(values) != 4:
            raise ArgumentError(f"colour_bias_dn has four values, for R, G1, B and G2; found {bias!r:.100}")
        for value in values:
            checked_number("colour_bias_dn", value)
        object.__setattr__(self, "colour_bias_dn", tuple(values))

    def channel_bias_dn(self, channels: int) -> tuple[float, ...]:
        """Return the colour bias of each packed channel. X-Trans has one green: the mean of G1's and G2's."""
        sites = packed_layouts()[channels]
        if sites.colours == (0, 1, 2, 3):  # Bayer, asked for each item of a batch: as it is
            return self.colour_bias_dn
        red, green, blue, second_green = self.colour_bias_dn
        of_colour = (red, (green + second_green) / 2, blue) if sites.levels == 3 else self.colour_bias_dn
        return tuple(of_colour[colour] for colour in sites.colours)

    def as_dict(self) -> dict[str, Any]:
        """Return the parameters of the noise by name."""
        return {name: getattr(self, name) for name in _noise_fields()}

    def rounded(self, dn: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Round DN, black level included, to the camera's steps and to whole numbers, as its files hold them."""
        return np.asarray(np.rint(np.rint(dn / self.quantisation_step_dn) * self.quantisation_step_dn))


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


@dataclass(frozen=True, slots=True)
class NoiseDraw:
    """All that is drawn for one noisy exposure, or one clip, but the random numbers of its pixels.

    Datasets draw it, :meth:`eldata.noise.NoiseModel.apply` adds its noise: again, to other data, by another model.

    Attributes
    ----------
    parameters
        Of the noise.
    ratio
        Exposure ratio, above 0.
    range_dn
        White level minus black level of the clean data, DN, above 0.
    camera, camera_id
        The camera, and its place among those of the dataset.
    dark
        Numbers of the dark frames of component D, one for each frame.

    Raises
    ------
    ArgumentError
        If a number is out of its range.
    """

    parameters: NoiseParameters
    ratio: float
    range_dn: float
    camera: str = ""
    camera_id: int = 0
    dark: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in ("ratio", "range_dn"):
            object.__setattr__(self, name, checked_number(name, getattr(self, name), above=0))

    @property
    def iso(self) -> float | None:
        """The ISO that was given or drawn; ``None`` where the gain was drawn."""
        return self.parameters.iso


@cache
def _noise_fields() -> tuple[str, ...]:
    """List the fields that describe the noise, without range, ISO and step."""
    return tuple(field.name for field in fields(NoiseParameters) if field.compare)


def tukey_lambda_variance(tukey_lambda: float) -> float:
    """Return the variance of the Tukey-lambda distribution of scale 1, for a shape l above -0.5.

    ``2 / l^2 (1 / (2 l + 1) - B(l + 1, l + 1))`` with the beta function B, which is ``-2 expm1(g) / (l^2 (2 l + 1))``
    with ``g = 2 ln Gamma(1 + l) - ln Gamma(1 + 2 l)``; pi^2 / 3 at l = 0. Near 0, g comes from its power series, which
    does not cancel.

    Examples
    --------
    >>> from eldata.noise import tukey_lambda_variance
    >>> round(tukey_lambda_variance(0.14), 2), round(tukey_lambda_variance(1.0), 6)
    (2.11, 0.333333)
    """
    shape = tukey_lambda
    if abs(shape) < 1e-12:  # the variance changes by a factor of about 1 + 2 l; the square of less may underflow
        return math.pi**2 / 3
    if abs(shape) < 0.125:
        from scipy.special import zeta

        # ln Gamma(1 + x) = -gamma x + sum over k >= 2 of zeta(k) (-x)^k / k
        g = sum(float(zeta(k)) * (-shape) ** k * (2 - 2**k) / k for k in range(2, 40))
    else:
        g = 2 * math.lgamma(1 + shape) - math.lgamma(1 + 2 * shape)
    return -2 * math.expm1(g) / (shape**2 * (2 * shape + 1))


# --- random numbers -------------------------------------------------------------------------------------------------


def _check_generator(generator: Generator) -> None:
    """Refuse anything but a random generator from numpy or torch."""
    torch = sys.modules.get("torch")
    kinds = (np.random.Generator,) if torch is None else (np.random.Generator, torch.Generator)
    if not isinstance(generator, kinds):
        raise ArgumentError(
            f"generator must be a numpy.random.Generator or a torch.Generator, not {type(generator).__name__}; "
            "for example numpy.random.default_rng(0)"
        )


def draw_numbers(generator: Generator) -> tuple[list[float], list[float]]:
    """Draw two numbers from [0, 1) and three standard normal ones, float64: all that one draw of parameters takes."""
    _check_generator(generator)
    if isinstance(generator, np.random.Generator):
        return generator.random(2).tolist(), generator.standard_normal(3).tolist()
    import torch

    uniform, normal = (
        draw(count, generator=generator, dtype=torch.float64, device=generator.device)
        for draw, count in ((torch.rand, 2), (torch.randn, 3))
    )
    return uniform.tolist(), normal.tolist()


def key_from(generator: Generator) -> int:
    """Return a 63-bit key for a counter-based generator."""
    _check_generator(generator)
    if isinstance(generator, np.random.Generator):
        return int(generator.integers(2**63 - 1))
    import torch

    return int(torch.randint(2**63 - 1, (1,), generator=generator, device=generator.device).item())
