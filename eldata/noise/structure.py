"""Figures of the noise that pixels do not have each for itself: what components C, W, T and F of a model are made with.

``eldata calibrate --structure`` measures them (:mod:`eldata.calibration.audit.structure`), a profile holds them by ISO,
and the parameters that are drawn from it bring those of the nearest gain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from eldata.base.fields import Fields, names_of
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from eldata.noise.components import Components

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
