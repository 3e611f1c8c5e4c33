"""What a camera's profile is made of: rows by ISO, gain modes with the noise's lines over K, and K over ISO.

A gain mode is a range in which a camera keeps its conversion gain.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

from eldata.errors import ArgumentError
from eldata.noise.parameters import NoiseParameters

if TYPE_CHECKING:
    from collections.abc import Sequence


Sigma = Literal["TL", "G", "row"]
SIGMAS: dict[Sigma, tuple[str, str]] = {
    "TL": ("tukey_lambda_fit", "sigma_tl_dn"),
    "G": ("gauss_fit", "sigma_gauss_dn"),
    "row": ("row_fit", "sigma_row_dn"),
}
"""The scales of a profile: its line over K, and the field of a row, by the index of its sigma."""
SIGMA_TITLES: dict[Sigma, str] = {"TL": "read noise, Tukey lambda", "G": "read noise, Gaussian", "row": "row noise"}

OF_ONE_MODE = ("tukey_lambda_fit", "gauss_fit", "row_fit")
"""The lines of a profile, which one with gain modes leaves to them."""

GAIN_ROUNDING = 0.01
"""Of ln K: gains are printed and stated with few digits."""


@dataclass(frozen=True, slots=True)
class LogLogFit:
    """The line of ln(scale in DN) over ln(K in DN/e-), and the standard deviation of its residuals."""

    slope: float
    intercept: float
    sigma: float

    def scale_dn(self, gain_dn_per_e: float, standard_normal: float) -> float:
        """Return the scale at a gain, ``standard_normal`` residual deviations off the line."""
        mean = self.slope * math.log(gain_dn_per_e) + self.intercept
        return math.exp(mean + self.sigma * standard_normal)


@dataclass(frozen=True, slots=True)
class GainMode:
    """One of the conversion gains of a camera: where it is used, and the fits over K that hold there.

    Attributes
    ----------
    gain_range_dn_per_e
        Its lowest and its highest system gain K.
    tukey_lambda_fit, gauss_fit, row_fit
        Fits of sigma_TL, of the Gaussian sigma and of sigma_row over K; ``None`` where too few ISOs make a line.
    iso_range
        Its lowest and its highest ISO, if known: those of ``gain_range_dn_per_e``, where no row has them.
    """

    gain_range_dn_per_e: tuple[float, float]
    tukey_lambda_fit: LogLogFit | None
    gauss_fit: LogLogFit | None
    row_fit: LogLogFit | None
    iso_range: tuple[float, float] | None = None

    def scales_dn(self, gain_dn_per_e: float, standard_normals: Sequence[float]) -> tuple[float, float, float]:
        """Return sigma_TL, sigma_G and sigma_row at a gain, each so many residual deviations off its line.

        Raises
        ------
        ArgumentError
            If one of them has no line.
        """
        lines = {"sigma_TL": self.tukey_lambda_fit, "sigma_G": self.gauss_fit, "sigma_row": self.row_fit}
        if lacking := [name for name, line in lines.items() if line is None]:
            raise ArgumentError(
                f"{', '.join(lacking)} was measured at too few ISOs for a line over K, so nothing can be drawn around "
                "one; take an ISO as it was measured: row='measured' and its iso (--row measured --iso ISO)"
            )
        first, second, third = (
            line.scale_dn(gain_dn_per_e, z) for line, z in zip(lines.values(), standard_normals, strict=True) if line
        )
        return first, second, third

    @property
    def log_width(self) -> float:
        """ln(highest K / lowest K)."""
        low, high = (math.log(limit) for limit in self.gain_range_dn_per_e)
        return high - low

    def distance(self, gain_dn_per_e: float) -> float:
        """Return how far a gain lies from the range, as the absolute difference of logarithms; 0 within it."""
        low, high = self.gain_range_dn_per_e
        return max(0.0, math.log(low / gain_dn_per_e), math.log(gain_dn_per_e / high))

    def __str__(self) -> str:
        """Return the ISOs, or the gains where those are not known."""
        if self.iso_range is None:
            return "K {:.4g} to {:.4g}".format(*self.gain_range_dn_per_e)
        return "ISO {:g} to {:g}".format(*self.iso_range)


@dataclass(frozen=True, slots=True)
class ProfileRow:
    """What was measured at one ISO; ``None`` is not known.

    ``tukey_lambda`` and ``colour_bias_dn`` (R, G1, B, G2) belong together; ``r_squared_tl`` and ``r_squared_gauss`` are
    the probability plots' coefficients of determination. ``frame_bias_dn`` has each bias frame's own colour bias, whose
    mean is ``colour_bias_dn``: the empirical distribution of section 3.2.1 of the paper; empty where it is not known.
    """

    tukey_lambda: float
    colour_bias_dn: tuple[float, float, float, float]
    iso: float | None = None
    gain_dn_per_e: float | None = None
    sigma_tl_dn: float | None = None
    sigma_gauss_dn: float | None = None
    sigma_row_dn: float | None = None
    r_squared_tl: float | None = None
    r_squared_gauss: float | None = None
    frame_bias_dn: tuple[tuple[float, float, float, float], ...] = ()

    def bias_at_share(self, share: float) -> tuple[float, float, float, float]:
        """Return the colour bias of the frame below which a share of them lies; where none is known, their mean."""
        if not self.frame_bias_dn:
            return self.colour_bias_dn
        return self.frame_bias_dn[int(share * len(self.frame_bias_dn))]

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as plain types, without frames where none is known."""
        return {name: value for name, value in asdict(self).items() if value or name != "frame_bias_dn"}

    def parameters(self, range_dn: float | None, step_dn: float = 1.0) -> NoiseParameters | None:
        """Return the figures as a draw, ``None`` unless K and all scales are known."""
        gain, scale, gauss, rows = self.gain_dn_per_e, self.sigma_tl_dn, self.sigma_gauss_dn, self.sigma_row_dn
        if gain is None or scale is None or gauss is None or rows is None:
            return None
        figures = gain, self.tukey_lambda, scale, gauss, rows, self.colour_bias_dn
        return NoiseParameters(*figures, range_dn, self.iso, step_dn)


def modes_problem(
    modes: Sequence[GainMode], gain_range_dn_per_e: tuple[float, float], iso_range: tuple[float, float] | None
) -> str | None:
    """Return why modes do not go together with each other and with the ranges of their camera; ``None`` if they do."""
    if len(modes) < 2:
        return "one mode alone is the profile's own range and fits; there must be none, or two and more"
    ranges = [("gain_range_dn_per_e", gain_range_dn_per_e, [mode.gain_range_dn_per_e for mode in modes])]
    isos = [mode.iso_range for mode in modes if mode.iso_range is not None]
    if len(isos) != (0 if iso_range is None else len(modes)):
        return "all modes and the profile state an iso_range, or none of them does"
    if iso_range is not None:
        ranges.append(("iso_range", iso_range, isos))
    for name, whole, each in ranges:
        ends = [end for limits in each for end in limits]
        if any(low >= high for low, high in pairwise(ends)):
            listed = ", ".join("{:g} to {:g}".format(*limits) for limits in each)
            return f"each mode's {name} must be wider than nothing and end below the next one's; found {listed}"
        if whole != (ends[0], ends[-1]):
            return f"{name} must go from the first mode's to the last one's, {ends[0]:g} to {ends[-1]:g}"
    return None


def rows_of(mode: GainMode, rows: Sequence[ProfileRow], modes: Sequence[GainMode]) -> Sequence[ProfileRow]:
    """Return the rows that were measured in a mode; every row, if there are no ``modes``."""
    if not modes:
        return rows
    known = [(row, row.gain_dn_per_e) for row in rows]
    return [row for row, gain in known if gain is not None and mode.distance(gain) <= GAIN_ROUNDING]


def rows_nearest(gain_dn_per_e: float, rows: Sequence[ProfileRow]) -> Sequence[ProfileRow]:
    """Return the rows whose K is nearest to a gain, several if they share it; none if no row has a K."""
    known = [(row, row.gain_dn_per_e) for row in rows]
    distances = [(row, abs(math.log(gain / gain_dn_per_e))) for row, gain in known if gain is not None]
    nearest = min((distance for _, distance in distances), default=0.0)
    return [row for row, distance in distances if distance <= nearest + 1e-9]


def gain_at_share(modes: Sequence[GainMode], share: float) -> float:
    """Return the gain below which a share of all ranges of ln K lies."""
    *others, mode = modes
    left = share * sum(one.log_width for one in (*others, mode))
    for one in others:
        if left <= one.log_width:
            mode = one
            break
        left -= one.log_width
    return math.exp(math.log(mode.gain_range_dn_per_e[0]) + left)


def cells_of(rows: Sequence[ProfileRow]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the titles of the columns in which some row has a figure, and each row's cells."""
    titles = ["K [DN/e⁻]", "λ", "σ TL [DN]", "σ G [DN]", "σ row [DN]"]
    titles += [f"bias {name} [DN]" for name in ("R", "G1", "B", "G2")]
    fields = [
        (
            row.gain_dn_per_e,
            row.tukey_lambda,
            row.sigma_tl_dn,
            row.sigma_gauss_dn,
            row.sigma_row_dn,
            *row.colour_bias_dn,
        )
        for row in rows
    ]
    columns = {"ISO": [None if row.iso is None else f"{row.iso:g}" for row in rows]} | {
        title: [None if value is None else f"{value:.4g}" for value in values]
        for title, values in zip(titles, zip(*fields, strict=True), strict=True)
    }
    known = {title: cells for title, cells in columns.items() if any(cells)}
    return tuple(known), [tuple(cell or "-" for cell in row) for row in zip(*known.values(), strict=True)]


# --- K over ISO -------------------------------------------------------------------------------------------------------


def gains_by_iso(rows: Sequence[ProfileRow], modes: Sequence[GainMode]) -> dict[float, float]:
    """Return K by ISO, ascending: the rows' mean, and the ends of the ranges where no row has their ISO."""
    found: dict[float, list[float]] = {}
    for row in rows:
        if row.iso is not None and row.gain_dn_per_e is not None:
            found.setdefault(row.iso, []).append(row.gain_dn_per_e)
    for mode in modes:
        for iso, gain in zip(mode.iso_range or (), mode.gain_range_dn_per_e, strict=False):
            found.setdefault(iso, [gain])
    return {iso: sum(found[iso]) / len(found[iso]) for iso in sorted(found)}


def gain_between(gains: dict[float, float], modes: Sequence[GainMode], iso: float) -> float | None:
    """Return K at an ISO, its logarithm straight over ln ISO; ``None`` unless measured or between two of one mode."""
    if iso in gains:
        return gains[iso]
    below = max((one for one in gains if one < iso), default=None)
    above = min((one for one in gains if one > iso), default=None)
    if below is None or above is None or not share_a_mode(modes, gains[below], gains[above]):
        return None
    share = math.log(iso / below) / math.log(above / below)
    return gains[below] * math.pow(gains[above] / gains[below], share)


def iso_between(gains: dict[float, float], modes: Sequence[GainMode], gain_dn_per_e: float) -> float | None:
    """Return the lowest ISO at which :func:`gain_between` is K; ``None`` if there is none."""
    for (below, first), (above, last) in pairwise(gains.items()):
        if min(first, last) <= gain_dn_per_e <= max(first, last) and share_a_mode(modes, first, last):
            share = 0.0 if first == last else math.log(gain_dn_per_e / first) / math.log(last / first)
            return below * math.pow(above / below, share)
    return None


def share_a_mode(modes: Sequence[GainMode], *gains: float) -> bool:
    """Return whether gains are of one gain mode."""
    return len(modes) == 1 or any(max(map(mode.distance, gains)) <= GAIN_ROUNDING for mode in modes)
