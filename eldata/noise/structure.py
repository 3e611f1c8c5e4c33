"""The components of the noise model, by the names of the paper's ablation table, and the figures of C, W, T and F.

======  =====================================================  =========================
``P``   photon shot noise, Gaussian with the signal's variance  K
``P*``  photon shot noise, Poisson                              K
``G``   read noise, Gaussian                                    sigma_gauss_dn
``G*``  read noise, Tukey lambda                                tukey_lambda, sigma_tl_dn
``B``   colour bias: the read noise's mean per channel          colour_bias_dn
``R``   row noise, one Gaussian draw per mosaic row             sigma_row_dn
``U``   quantisation noise, uniform over one step of the DN     quantisation_step_dn
``D``   real dark frames, in place of G, B, R and U             gain of their ISO
``S``   dark shading of a sensor, with its colour bias          ISO
``C``   column noise, one Gaussian draw per mosaic column       sigma_column_dn
``W``   banding: rows that drift and wave, in place of R        row_spectrum
``T``   telegraph pixels, which jump between two levels         telegraph
``F``   PRNU: each pixel's own response to light                prnu
======  =====================================================  =========================

Source: K. Wei, Y. Fu, Y. Zheng and J. Yang, "Physics-based Noise Modeling for Extreme Low-light Photography", TPAMI
2021, section 3.1 and table 2. D, real frames in place of all that a model says of the dark, is the idea of
Y. Zhang, H. Qin, X. Wang and H. Li, "Rethinking Noise Synthesis and Modeling in Raw Denoising", ICCV 2021 (SFRN).

What pixels do not have each for itself, C, W, T and F, is measured by ``eldata calibrate --structure``
(:mod:`eldata.calibration.audit.structure`): a profile holds it by ISO, and the parameters that are drawn from it bring
that of the nearest gain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from eldata.base.fields import Fields, names_of
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


Shot = Literal["none", "gaussian", "poisson"]
Read = Literal["none", "gaussian", "tukey-lambda"]

PAPER_MODELS = ("G", "G+P", "G+P*", "G*+P*", "G*+P*+B", "G*+P*+B+R", "G*+P*+B+R+U")
"""The models that the ELD paper compares, in the order of its rows, from the simplest to the full one."""

_NAMES = ("P", "P*", "G", "G*", "B", "R", "U", "D", "S", "C", "W", "T", "F")
_SHOTS: dict[str, Shot] = {"P": "gaussian", "P*": "poisson"}
_READS: dict[str, Read] = {"G": "gaussian", "G*": "tukey-lambda"}
# The others, each there or not, in the order in which a spec has them.
_FLAGS = {"F": "prnu", "B": "colour_bias", "R": "row", "W": "banding", "C": "column", "T": "telegraph"} | {
    "U": "quantisation",
    "D": "dark",
    "S": "shading",
}
_EXCLUSIVE = (("P", "P*", "photon shot noise"), ("G", "G*", "read noise"), ("R", "W", "row noise"))
# What dark frames have in them.
_IN_DARK = {"G": "read noise", "G*": "read noise", "B": "colour bias", "R": "row noise", "U": "rounding"} | {
    "S": "dark shading",
    "C": "column noise",
    "W": "row noise",
    "T": "telegraph pixels",
}


@dataclass(frozen=True, slots=True)
class Components:
    """Which components a model has."""

    shot: Shot
    read: Read
    colour_bias: bool
    row: bool
    quantisation: bool
    dark: bool = False
    shading: bool = False
    column: bool = False
    banding: bool = False
    telegraph: bool = False
    prnu: bool = False

    @property
    def structured(self) -> bool:
        """Whether there is one of C, W, T and F."""
        return self.column or self.banding or self.telegraph or self.prnu

    @property
    def placed(self) -> bool:
        """Whether there is one that stays where it is on the sensor: S, T or F."""
        return self.shading or self.telegraph or self.prnu

    @property
    def spec(self) -> str:
        """The components as a spec that :func:`parse_components` reads back."""
        names = [name for name, shot in _SHOTS.items() if shot == self.shot]
        names += [name for name, read in _READS.items() if read == self.read]
        return "+".join(names + [name for name, field in _FLAGS.items() if getattr(self, field)])


def parse_components(spec: str) -> Components:
    """Read a spec such as ``"P*+G*+B+R+U"``: names joined by ``+``, in any order; ``P^*`` means ``P*``.

    Raises
    ------
    ArgumentError
        If it is not a text, a name is unknown or repeated, there are none, or two models of one noise source are asked
        for.

    Examples
    --------
    >>> from eldata.noise import parse_components
    >>> components = parse_components("P*+G*+B+R+U")
    >>> components.shot, components.read, components.row
    ('poisson', 'tukey-lambda', True)
    """
    if not isinstance(spec, str):
        raise ArgumentError(f"a noise model's spec is a text such as 'P*+G*+B+R+U'; found {spec!r:.100}")
    names = [name.strip().replace("^", "") for name in spec.split("+")]
    for name in names:
        if name not in _NAMES:
            raise ArgumentError(f"noise model {spec!r}: {name!r} is not a component; known are {', '.join(_NAMES)}")
    for name in set(names):
        if names.count(name) > 1:
            raise ArgumentError(f"noise model {spec!r}: {name} is in it twice; each source adds its noise once")
    for first, second, source in _EXCLUSIVE:
        if first in names and second in names:
            raise ArgumentError(
                f"noise model {spec!r}: {first} and {second} are two models of the same {source}; take one"
            )
    for name, source in _IN_DARK.items() if "D" in names else ():
        if name in names:
            raise ArgumentError(
                f"noise model {spec!r}: the frames of D have their own {source}, and {name} would add it again; take "
                "one, as in 'P*+D'"
            )
    if "S" in names and "B" in names:
        raise ArgumentError(
            f"noise model {spec!r}: the dark shading of S has the colour bias in it, and B would add it again; "
            "take one, as in 'P*+G*+R+U+S'"
        )
    return Components(
        shot=next((shot for name, shot in _SHOTS.items() if name in names), "none"),
        read=next((read for name, read in _READS.items() if name in names), "none"),
        **{field: name in names for name, field in _FLAGS.items()},
    )


# --- what C, W, T and F are made with ---------------------------------------------------------------------------------

Figures = TypeVar("Figures")


@dataclass(frozen=True, slots=True)
class RowWave:
    """A wave over the rows, whose phase is another one in each frame: frequency [cycles per row] and amplitude [DN]."""

    frequency_per_row: float
    amplitude_dn: float

    def __post_init__(self) -> None:
        if not 0 < self.frequency_per_row < 0.5 or not (math.isfinite(self.amplitude_dn) and self.amplitude_dn >= 0):
            raise ArgumentError(
                f"a wave has a frequency between 0 and 0.5 cycles per row and an amplitude of 0 DN or more: {self}"
            )


@dataclass(frozen=True, slots=True)
class RowSpectrum:
    """Power spectrum of the rows' offsets: steps between frequencies, and waves.

    Attributes
    ----------
    edges_per_row
        Frequencies, cycles per row, ascending to 0.5: the ends of the bands.
    power_dn2
        Of each band, one fewer than edges: white noise of variance s^2 has s^2 throughout.
    waves
        What stands out of the bands.
    """

    edges_per_row: tuple[float, ...]
    power_dn2: tuple[float, ...]
    waves: tuple[RowWave, ...] = ()

    def __post_init__(self) -> None:
        edges = (0.0, *self.edges_per_row)
        if (
            len(self.power_dn2) != len(self.edges_per_row) - 1
            or not self.power_dn2
            or any(not low < high for low, high in pairwise(edges))
            or edges[-1] != 0.5
            or not all(math.isfinite(power) and power >= 0 for power in self.power_dn2)
        ):
            raise ArgumentError(
                "a spectrum has ascending edges from above 0 to 0.5 cycles per row and between each two a power of 0 "
                f"DN^2 or more; found edges {self.edges_per_row}, powers {self.power_dn2}"
            )

    @property
    def variance_dn2(self) -> float:
        """Variance of the offsets; what lies below the first edge counts as little."""
        widths = (high - low for low, high in pairwise((0.0, *self.edges_per_row[1:])))
        of_bands = sum(2 * width * power for width, power in zip(widths, self.power_dn2, strict=True))
        return of_bands + sum(wave.amplitude_dn**2 / 2 for wave in self.waves)

    def power_at(self, frequency_per_row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the power of the bands, DN^2, at some frequencies; 0 at 0, which is the frame's own mean."""
        band = np.searchsorted(np.array(self.edges_per_row[1:-1]), frequency_per_row, side="right")
        power: NDArray[np.float64] = np.where(frequency_per_row > 0, np.array(self.power_dn2)[band], 0.0)
        return power


@dataclass(frozen=True, slots=True)
class TelegraphPixels:
    """Pixels that jump between two levels.

    Attributes
    ----------
    share
        Of all pixels, from 0 to 1; 0: none were found.
    amplitude_dn
        How far the levels lie apart, DN.
    duty
        Share of the frames in which a pixel is at its upper level.
    tukey_lambda_shift, sigma_tl_ratio, sigma_gauss_ratio
        Read noise of the other pixels: what is added to lambda of all pixels, and by what the scales of all are
        multiplied, for that of all has the jumps in it.
    """

    share: float
    amplitude_dn: float
    duty: float = 0.5
    tukey_lambda_shift: float = 0.0
    sigma_tl_ratio: float = 1.0
    sigma_gauss_ratio: float = 1.0

    def __post_init__(self) -> None:
        if not (0 <= self.share <= 1 and 0 <= self.duty <= 1 and 0 <= self.amplitude_dn < math.inf):
            raise ArgumentError(
                "telegraph pixels have a share and a duty from 0 to 1 and an amplitude of 0 DN or more, finite; found "
                f"{self}"
            )
        if not (math.isfinite(self.tukey_lambda_shift) and min(self.sigma_tl_ratio, self.sigma_gauss_ratio) >= 0):
            raise ArgumentError(f"a shift of lambda is finite, and ratios of scales are 0 or more; found {self}")

    @property
    def variance_dn2(self) -> float:
        """What they add to the variance over time, mean of all pixels."""
        return self.share * self.amplitude_dn**2 * self.duty * (1 - self.duty)


@dataclass(frozen=True, slots=True)
class NoiseStructure:
    """The figures of one ISO; ``None`` was not measured, 0 was looked for and not told from nothing.

    Attributes
    ----------
    gain_dn_per_e
        System gain K of the ISO, above 0.
    iso
        The ISO, if known.
    sigma_column_dn
        Component C: standard deviation of one offset for each mosaic column and frame, DN.
    row_spectrum
        Component W: spectrum of the offsets of the mosaic rows.
    telegraph
        Component T: pixels that jump between two levels.
    prnu
        Component F: standard deviation of the pixels' response to light, as a share of their mean. It belongs to the
        sensor: all ISOs have the same.

    Raises
    ------
    ArgumentError
        If a figure is out of its range.
    """

    gain_dn_per_e: float
    iso: float | None = None
    sigma_column_dn: float | None = None
    row_spectrum: RowSpectrum | None = None
    telegraph: TelegraphPixels | None = None
    prnu: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.gain_dn_per_e) and self.gain_dn_per_e > 0):
            raise ArgumentError(f"gain_dn_per_e must be finite and above 0; found {self.gain_dn_per_e}")
        for name in ("sigma_column_dn", "prnu"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise ArgumentError(f"{name} must be finite and not negative; found {value}")


NO_STRUCTURE = NoiseStructure(1.0)
# Of a component: its flag, the figure that it takes, and what it makes.
_FIGURES = {
    "C": ("column", "sigma_column_dn", "column noise"),
    "W": ("banding", "row_spectrum", "banding"),
    "T": ("telegraph", "telegraph", "telegraph pixels"),
    "F": ("prnu", "prnu", "PRNU"),
}


def known_structure(components: Components, structure: NoiseStructure | None) -> NoiseStructure:
    """Return the figures that a model's components take.

    Raises
    ------
    ArgumentError
        If one is not known.
    """
    found = structure or NO_STRUCTURE
    for name, (flag, figure, made) in _FIGURES.items():
        if getattr(components, flag) and getattr(found, figure) is None:
            frames = "pairs of flats" if name == "F" else "bias frames, ten or more"
            raise ArgumentError(
                f"noise model {components.spec!r}: {name} makes {made}, and the parameters have no "
                f"structure.{figure}: their profile does not state it. eldata calibrate --structure measures "
                f"it from {frames}; or leave {name} out"
            )
    return found


# --- files ------------------------------------------------------------------------------------------------------------


def read_structure(row: Fields) -> NoiseStructure:
    """Read one ISO's figures of a profile's file."""
    row.only(names_of(NoiseStructure))

    def spectrum(name: str) -> RowSpectrum:
        found = row.inside(name)
        found.only(names_of(RowSpectrum))
        waves = found.objects("waves", missing_ok=True)
        for wave in waves:
            wave.only(names_of(RowWave))
        return _checked(
            found,
            "power_dn2",
            lambda: RowSpectrum(
                found.each("edges_per_row", Fields.number),
                found.each("power_dn2", Fields.number),
                tuple(RowWave(wave.number("frequency_per_row"), wave.number("amplitude_dn")) for wave in waves),
            ),
        )

    def telegraph(name: str) -> TelegraphPixels:
        found = row.inside(name)
        found.only(names_of(TelegraphPixels))
        numbers = {one: found.number(one) for one in names_of(TelegraphPixels)}
        return _checked(found, "share", lambda: TelegraphPixels(**numbers))

    return NoiseStructure(
        gain_dn_per_e=row.number("gain_dn_per_e", above=0),
        iso=row.optional("iso", row.number, above=0),
        sigma_column_dn=row.optional("sigma_column_dn", row.number, at_least=0),
        row_spectrum=row.optional("row_spectrum", spectrum),
        telegraph=row.optional("telegraph", telegraph),
        prnu=row.optional("prnu", row.number, at_least=0),
    )


def _checked(fields: Fields, name: str, make: Callable[[], Figures]) -> Figures:
    try:
        return make()
    except ArgumentError as error:
        raise fields.problem(name, str(error)) from None
