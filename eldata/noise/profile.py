"""Camera profiles: what a calibration found, and how parameters are drawn from it.

A profile is a JSON file, validated on load. Five cameras ship with the package (:func:`shipped_profiles`).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import write_json
from eldata.errors import ArgumentError, ProfileError
from eldata.noise.parameters import NoiseParameters, shape_problem
from eldata.noise.randomness import Generator, standard_normals, uniforms

if TYPE_CHECKING:
    from collections.abc import Sequence

SCHEMA = 1
RowChoice = Literal["any", "nearest-gain", "measured"]


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
class ProfileRow:
    """What was measured at one ISO; ``None`` is not known.

    ``tukey_lambda`` and ``colour_bias_dn`` (R, G1, B, G2) belong together; ``r_squared_tl`` and ``r_squared_gauss`` are
    the probability plots' coefficients of determination.
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


@dataclass(frozen=True, slots=True)
class CameraProfile:
    """The noise of one camera, as calibrated.

    Attributes
    ----------
    camera, source
        The camera's name, and where the figures come from.
    gain_range_dn_per_e
        System gain K at the lowest and the highest calibrated ISO.
    tukey_lambda_fit, gauss_fit, row_fit
        Fits of sigma_TL, of the Gaussian sigma and of sigma_row over K.
    rows
        Measurements by ISO.
    iso_range
        The ISOs of ``gain_range_dn_per_e``, if known.
    black_level_dn, white_level_dn
        Levels of the calibrated frames, if known.
    notes
        What a user should know, such as which figures are inferred.
    """

    camera: str
    source: str
    gain_range_dn_per_e: tuple[float, float]
    tukey_lambda_fit: LogLogFit
    gauss_fit: LogLogFit
    row_fit: LogLogFit
    rows: tuple[ProfileRow, ...]
    iso_range: tuple[float, float] | None = None
    black_level_dn: float | None = None
    white_level_dn: float | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.rows:
            raise ProfileError(f"the profile of {self.camera} has no row")
        if self.range_dn is not None and not self.range_dn > 0:
            raise ProfileError(
                f"the profile of {self.camera}: the white level, {self.white_level_dn:g} DN, must lie above the black "
                f"level, {self.black_level_dn:g} DN"
            )

    @classmethod
    def load(cls, name: str | Path) -> CameraProfile:
        """Load a shipped profile by its name, or any by its path.

        Raises
        ------
        ProfileError
            If the profile is unknown or malformed; the message names file, field, expected and found.
        """
        if isinstance(name, str) and "/" not in name and not name.endswith(".json"):
            if name not in shipped_profiles():
                raise ProfileError(
                    f"no camera profile is called {name!r}; known are {', '.join(shipped_profiles())}, or give a path"
                )
            return _read(_FOLDER / f"{name}.json")
        return _read(Path(name))

    def save(self, path: Path | str) -> None:
        """Write the profile as JSON, whole or not at all."""
        write_json(path, {"schema": SCHEMA} | asdict(self), indent=1)

    @property
    def range_dn(self) -> float | None:
        """White level minus black level, DN; ``None`` if the profile does not state both."""
        if self.black_level_dn is None or self.white_level_dn is None:
            return None
        return self.white_level_dn - self.black_level_dn

    def gain_at_iso(self, iso: float, *, extrapolate: bool = False) -> float:
        """Return K at an ISO: the row's where one was measured, else in proportion between the known limits.

        Parameters
        ----------
        iso
            ISO speed, within ``iso_range`` if the profile has one.
        extrapolate
            Allow ISOs beyond it: at a row's K where one has it, else in proportion. The fits hold there only if the
            camera goes on as it was measured; its extended ISOs often do not.

        Raises
        ------
        ArgumentError
            If the profile does not know its ISOs, or this one lies outside.
        """
        if not (math.isfinite(iso) and iso > 0):
            raise ArgumentError(f"an ISO is finite and above 0; found {iso:g}")
        measured = [row.gain_dn_per_e for row in self.rows if row.iso == iso and row.gain_dn_per_e is not None]
        if self.iso_range is not None and not self.iso_range[0] <= iso <= self.iso_range[1] and not extrapolate:
            low, high = self.iso_range
            raise ArgumentError(
                f"ISO {iso:g} is outside of the calibrated range {low:g} to {high:g} of {self.camera}; extrapolating "
                "beyond it has to be asked for (extrapolate=True, --extrapolate)"
            )
        if measured:
            return sum(measured) / len(measured)
        if self.iso_range is None:
            raise ArgumentError(f"the profile of {self.camera} does not say which ISO its gains belong to; give a gain")
        (low, high), (first, last) = self.iso_range, self.gain_range_dn_per_e
        if low == high:
            return first * iso / low
        share = math.log(iso / low) / math.log(high / low)
        return math.exp(math.log(first) + share * math.log(last / first))

    def measured(self, iso: float) -> NoiseParameters:
        """Return the figures that were measured at an ISO, without the spread of the fits; the first of several.

        Raises
        ------
        ArgumentError
            If this ISO was not measured, or not all of its figures are known; the message lists those that were.
        """
        complete: dict[float, NoiseParameters] = {}
        for row in self.rows:
            gain, scale, gauss, rows = row.gain_dn_per_e, row.sigma_tl_dn, row.sigma_gauss_dn, row.sigma_row_dn
            if row.iso is None or gain is None or scale is None or gauss is None or rows is None:
                continue
            found = NoiseParameters(
                gain, row.tukey_lambda, scale, gauss, rows, row.colour_bias_dn, self.range_dn, row.iso
            )
            complete.setdefault(row.iso, found)
        if iso in complete:
            return complete[iso]
        if not complete:
            raise ArgumentError(
                f"no row of {self.camera}'s profile has K and all scales of its ISO, so none can be given as it was "
                "measured; sample(iso=..., row='nearest-gain') draws the scales from their fits"
            )
        listed = ", ".join(f"{known:g}" for known in sorted(complete))
        raise ArgumentError(
            f"ISO {iso:g} of {self.camera} was not measured, or not completely; ISO {listed} were. "
            "sample(iso=..., row='nearest-gain') draws what is likely between them"
        )

    def sample(
        self,
        generator: Generator,
        *,
        iso: float | None = None,
        gain_dn_per_e: float | None = None,
        row: RowChoice = "any",
        extrapolate: bool = False,
    ) -> NoiseParameters:
        """Draw parameters jointly (equation "sampling" of the paper).

        ln K is uniform between the camera's own limits; ln sigma is normal around its line given ln K; lambda and
        colour bias come from one and the same calibration row.

        Parameters
        ----------
        generator
            A :class:`numpy.random.Generator` or a :class:`torch.Generator`; the same state gives the same draw.
        iso, gain_dn_per_e
            Fix the ISO, or K itself, in place of drawing K.
        row
            ``"any"``: every row alike, as in the paper. ``"nearest-gain"``: the row measured at the gain nearest to K
            (one of them at random if several are). To simulate one ISO take the latter: with lambda of another row, a
            scale makes another variance. ``"measured"``: nothing is drawn, the figures are those of :meth:`measured`
            at ``iso``.
        extrapolate
            Allow an ISO beyond the calibrated range (:meth:`gain_at_iso`).

        Raises
        ------
        ArgumentError
            If both ``iso`` and ``gain_dn_per_e`` are given, the ISO is unknown or outside of the calibrated range, no
            row has a gain to be near to, or the ISO was not measured.
        """
        # Always five numbers, whatever is fixed: fixing one parameter leaves the others' draws as they were.
        u_gain, u_row = uniforms(generator, 2)
        z_tl, z_gauss, z_row = standard_normals(generator, 3)
        if iso is not None and gain_dn_per_e is not None:
            raise ArgumentError("give iso or gain_dn_per_e, not both")
        if row == "measured":
            if iso is None:
                raise ArgumentError("row='measured' gives the figures of one ISO; give iso")
            return self.measured(iso)
        if iso is not None:
            gain = self.gain_at_iso(iso, extrapolate=extrapolate)
        elif gain_dn_per_e is not None:
            gain = float(gain_dn_per_e)
            if not (math.isfinite(gain) and gain > 0):
                raise ArgumentError(f"gain_dn_per_e must be finite and above 0; found {gain_dn_per_e}")
        else:
            low, high = (math.log(limit) for limit in self.gain_range_dn_per_e)
            gain = math.exp(low + u_gain * (high - low))
        rows = self._rows_for(gain, row)
        chosen = rows[min(int(u_row * len(rows)), len(rows) - 1)]
        return NoiseParameters(
            gain_dn_per_e=gain,
            tukey_lambda=chosen.tukey_lambda,
            sigma_tl_dn=self.tukey_lambda_fit.scale_dn(gain, z_tl),
            sigma_gauss_dn=self.gauss_fit.scale_dn(gain, z_gauss),
            sigma_row_dn=self.row_fit.scale_dn(gain, z_row),
            colour_bias_dn=chosen.colour_bias_dn,
            range_dn=self.range_dn,
            iso=iso,
        )

    def _rows_for(self, gain: float, row: RowChoice) -> Sequence[ProfileRow]:
        if row == "any":
            return self.rows
        if row != "nearest-gain":
            raise ArgumentError(f"row must be 'any', 'nearest-gain' or 'measured'; found {row!r}")
        distances = [
            abs(math.log(candidate.gain_dn_per_e / gain)) if candidate.gain_dn_per_e is not None else math.inf
            for candidate in self.rows
        ]
        nearest = min(distances)
        if math.isinf(nearest):
            raise ArgumentError(f"no row of {self.camera}'s profile has a gain; row='nearest-gain' needs one")
        return [
            candidate for candidate, distance in zip(self.rows, distances, strict=True) if distance <= nearest + 1e-9
        ]


# --- files ----------------------------------------------------------------------------------------------------

_FOLDER = Path(__file__).parent / "profiles"


def shipped_profiles() -> tuple[str, ...]:
    """Return the names of the shipped profiles."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.json")))


def _read(path: Path) -> CameraProfile:
    top = TextFile(path, ProfileError).json()
    top.only(("schema", *names_of(CameraProfile)))
    top.schema(SCHEMA)
    return CameraProfile(
        camera=top.text("camera"),
        source=top.text("source"),
        gain_range_dn_per_e=_range(top, "gain_range_dn_per_e"),
        tukey_lambda_fit=_fit(top.inside("tukey_lambda_fit")),
        gauss_fit=_fit(top.inside("gauss_fit")),
        row_fit=_fit(top.inside("row_fit")),
        rows=tuple(map(_row, top.objects("rows", fewest=1, expected="a list of at least one row"))),
        iso_range=top.optional("iso_range", partial(_range, top)),
        black_level_dn=top.optional("black_level_dn", top.number),
        white_level_dn=top.optional("white_level_dn", top.number),
        notes=top.texts("notes", missing_ok=True, empty=True),
    )


def _range(top: Fields, name: str) -> tuple[float, float]:
    low, high = top.each(name, Fields.number, count=2, expected="two numbers")
    if not 0 < low <= high:
        raise top.wrong(name, "two positive numbers, the lower first", [low, high])
    return low, high


def _fit(fit: Fields) -> LogLogFit:
    fit.only(names_of(LogLogFit))
    return LogLogFit(fit.number("slope"), fit.number("intercept"), fit.number("sigma", at_least=0))


def _row(row: Fields) -> ProfileRow:
    row.only(names_of(ProfileRow))
    red, green, blue, second_green = row.each(
        "colour_bias_dn", Fields.number, count=4, expected="four numbers (R, G1, B, G2)"
    )
    shape = row.number("tukey_lambda")
    problem = shape_problem(shape)
    if problem is not None:
        raise row.wrong("tukey_lambda", f"a number {problem}", shape)
    return ProfileRow(
        tukey_lambda=shape,
        colour_bias_dn=(red, green, blue, second_green),
        **{name: row.optional(name, row.number, above=0) for name in ("iso", "gain_dn_per_e")},
        **{
            name: row.optional(name, row.number, at_least=0)
            for name in ("sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")
        },
        **{name: row.optional(name, row.number) for name in ("r_squared_tl", "r_squared_gauss")},
    )
