"""Camera profiles: what a calibration found, and how parameters are drawn from it.

A profile is a JSON file, validated on load. Profiles of five cameras ship with the package (:func:`shipped_profiles`).

A camera that switches its conversion gain has the noise of two cameras: its profile holds a :class:`GainMode` for each.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import write_json
from eldata.base.notebook import block, table
from eldata.base.numbers import counted
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, ProfileError, check_choice, did_you_mean
from eldata.noise.gain_modes import GAIN_ROUNDING, GainMode, LogLogFit, modes_problem
from eldata.noise.parameters import NoiseParameters, shape_problem
from eldata.noise.randomness import Generator, standard_normals, uniforms
from eldata.noise.structure import NoiseStructure, read_structure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.plots.axes import Theme

SCHEMA = 1
SCHEMA_WITH_MODES = 2
SCHEMA_WITH_STRUCTURE = 3  # with modes or without
RowChoice = Literal["any", "nearest-gain", "measured"]

_OF_ONE_MODE = ("tukey_lambda_fit", "gauss_fit", "row_fit")  # fields that a profile with modes leaves to them
_ASKED = "has to be asked for (extrapolate=True, or --extrapolate where a command has it)"
_GO_ON = f"To go on with the nearer one's lines {_ASKED}"


Sigma = Literal["TL", "G", "row"]
SIGMAS: dict[Sigma, tuple[str, str]] = {
    "TL": ("tukey_lambda_fit", "sigma_tl_dn"),
    "G": ("gauss_fit", "sigma_gauss_dn"),
    "row": ("row_fit", "sigma_row_dn"),
}
"""The scales of a profile: its line over K, and the field of a row, by the index of its sigma."""
_TITLES: dict[Sigma, str] = {"TL": "read noise, Tukey lambda", "G": "read noise, Gaussian", "row": "row noise"}


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
        The lowest and the highest system gain K that was calibrated.
    tukey_lambda_fit, gauss_fit, row_fit
        Fits of sigma_TL, of the Gaussian sigma and of sigma_row over K; ``None`` if there are ``modes``.
    rows
        Measurements by ISO.
    iso_range
        The lowest and the highest calibrated ISO, if known: those of ``gain_range_dn_per_e``, where no row has them.
    black_level_dn, white_level_dn
        Levels of the calibrated frames, if known.
    notes
        What a user should know, such as which figures are inferred.
    modes
        Two or more where the camera switches its conversion gain, ascending, each with a range and fits of its own.
        Between their ranges nothing is known. Empty: the camera has one, whose range and fits are the profile's.
    structure
        Figures of components C, W, T and F by ISO; empty if they were not measured.
    accepted
        Figures that a check of the calibration would withhold and somebody has accepted, with check and ISOs.

    Raises
    ------
    ProfileError
        If the parts do not go together; the message says which.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.noise import CameraProfile
    >>> profile = CameraProfile.load("SonyA7S2")
    >>> parameters = profile.sample(np.random.default_rng(0), iso=1600)
    >>> round(parameters.gain_dn_per_e, 3), round(parameters.sigma_row_dn, 3)
    (1.503, 0.586)
    """

    camera: str
    source: str
    gain_range_dn_per_e: tuple[float, float]
    tukey_lambda_fit: LogLogFit | None
    gauss_fit: LogLogFit | None
    row_fit: LogLogFit | None
    rows: tuple[ProfileRow, ...]
    iso_range: tuple[float, float] | None = None
    black_level_dn: float | None = None
    white_level_dn: float | None = None
    notes: tuple[str, ...] = ()
    modes: tuple[GainMode, ...] = ()
    structure: tuple[NoiseStructure, ...] = ()
    accepted: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.rows:
            raise ProfileError(f"the profile of {self.camera} has no row")
        if self.range_dn is not None and not self.range_dn > 0:
            raise ProfileError(
                f"the profile of {self.camera}: the white level, {self.white_level_dn:g} DN, must lie above the black "
                f"level, {self.black_level_dn:g} DN"
            )
        if (problem := self._problem_of_fits()) is not None:
            raise ProfileError(f"the profile of {self.camera}: {problem}")

    def _problem_of_fits(self) -> str | None:
        fits = (self.tukey_lambda_fit, self.gauss_fit, self.row_fit)
        if not self.modes:
            return (
                "tukey_lambda_fit, gauss_fit and row_fit are needed where there are no modes" if None in fits else None
            )
        if fits != (None, None, None):
            return "tukey_lambda_fit, gauss_fit and row_fit are those of the modes; leave them None"
        found = modes_problem(self.modes, self.gain_range_dn_per_e, self.iso_range)
        lacking = [mode for mode in self.modes if not self._rows_of(mode)]
        if lacking and found is None:
            return f"no row has a K in the mode of {lacking[0]}: lambda and colour bias are not known there"
        return found

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
                known = shipped_profiles()
                raise ProfileError(
                    f"no camera profile is called {name!r}; known are {', '.join(known)}, or give the path of a .json "
                    f"file{did_you_mean(name, known)}"
                )
            return _read(_FOLDER / f"{name}.json")
        return _read(Path(name))

    def save(self, path: Path | str) -> None:
        """Write the profile as JSON, whole or not at all."""
        schema = SCHEMA_WITH_STRUCTURE if self.structure else SCHEMA_WITH_MODES if self.modes else SCHEMA
        write_json(path, {"schema": schema} | self.as_dict(), indent=1)

    def as_dict(self) -> dict[str, Any]:
        """Return the profile as its file holds it, as plain types: with modes, or with fits of its own."""
        empty = (name for name in ("structure", "accepted") if not getattr(self, name))
        left_out = (*(_OF_ONE_MODE if self.modes else ("modes",)), *empty)
        return {name: value for name, value in asdict(self).items() if name not in left_out}

    def plot(self, sigma: Sigma | None = None, *, ax: Axes | None = None) -> Figure:
        """Draw the lines of ln sigma over ln K with bands of one and two residual deviations, and the measured rows.

        Parameters
        ----------
        sigma
            ``"TL"`` or ``"G"``, the read noise by either model; ``"row"``. By default all three, an axes each.
        ax
            Axes to draw one into; by default those of a new figure, which belongs to no pyplot and shows in a notebook.

        Returns
        -------
        matplotlib.figure.Figure
            That of the axes.

        Raises
        ------
        ArgumentError
            If there is no such sigma, or ``ax`` is given without one.
        """
        from eldata.plots.axes import drawn_grid, drawn_into
        from eldata.plots.gains import scale_over_gain

        def panel(name: Sigma, axes: Axes, theme: Theme) -> None:
            line, field = SIGMAS[name]
            lines = [(getattr(mode, line), *mode.gain_range_dn_per_e) for mode in self.gain_modes]
            scale_over_gain(axes, name, lines, self._measured(field), theme)

        if sigma is not None:
            check_choice("sigma", sigma, SIGMAS)
            return drawn_into(ax, self.camera, partial(panel, sigma))
        if ax is not None:
            raise ArgumentError(f"one axes has room for one sigma; give sigma, one of {', '.join(SIGMAS)}")
        return drawn_grid(self.camera, [(_TITLES[name], partial(panel, name)) for name in SIGMAS])

    def _measured(self, field: str) -> list[tuple[float, float, float]]:
        """Return K, sigma and its error, which a profile does not state, of the rows that have both."""
        pairs = ((row.gain_dn_per_e, getattr(row, field)) for row in self.rows)
        return [
            (gain, scale, math.nan) for gain, scale in pairs if gain is not None and scale is not None and scale > 0
        ]

    def __repr__(self) -> str:
        low, high = self.gain_range_dn_per_e
        modes = f", {len(self.modes)} gain modes" if self.modes else ""
        text = f"{counted(len(self.rows), 'row')}, K {low:.4g} to {high:.4g} DN/e-{modes}"
        return f"CameraProfile({in_line(self.camera)!r}, {text})"

    def _repr_html_(self) -> str:
        columns = {
            "ISO": [None if row.iso is None else f"{row.iso:g}" for row in self.rows],
            "K [DN/e⁻]": [_digits(row.gain_dn_per_e) for row in self.rows],
            "λ": [_digits(row.tukey_lambda) for row in self.rows],
            "σ TL [DN]": [_digits(row.sigma_tl_dn) for row in self.rows],
            "σ G [DN]": [_digits(row.sigma_gauss_dn) for row in self.rows],
            "σ row [DN]": [_digits(row.sigma_row_dn) for row in self.rows],
        }
        columns |= {
            f"bias {name} [DN]": [_digits(row.colour_bias_dn[index]) for row in self.rows]
            for index, name in enumerate(("R", "G1", "B", "G2"))
        }
        known = {name: cells for name, cells in columns.items() if any(cells)}
        rows = [tuple(cell or "-" for cell in row) for row in zip(*known.values(), strict=True)]
        notes = (self.source, *self.notes)
        return block(f"Camera profile of {self.camera}", table(tuple(known), rows, left=()), notes=notes)

    @property
    def gain_modes(self) -> tuple[GainMode, ...]:
        """The modes; the profile's own range and fits, where it has no other."""
        if self.tukey_lambda_fit is None or self.gauss_fit is None or self.row_fit is None:
            return self.modes
        lines = self.tukey_lambda_fit, self.gauss_fit, self.row_fit
        return (GainMode(self.gain_range_dn_per_e, *lines, self.iso_range),)

    def mode_at(self, gain_dn_per_e: float, *, extrapolate: bool = False) -> GainMode:
        """Return the gain mode in whose range a gain lies, to 1 %: gains are printed with fewer digits.

        The only mode of a camera holds for every gain.

        Parameters
        ----------
        gain_dn_per_e
            K, above 0.
        extrapolate
            Allow gains outside of all ranges: the mode whose range is nearest, in ln K, goes on there.

        Raises
        ------
        ArgumentError
            If the gain lies outside of all ranges.
        """
        modes = self.gain_modes
        if len(modes) == 1:
            return modes[0]
        nearest = min(modes, key=lambda mode: mode.distance(gain_dn_per_e))
        if extrapolate or nearest.distance(gain_dn_per_e) <= GAIN_ROUNDING:
            return nearest
        raise ArgumentError(
            f"K {gain_dn_per_e:.4g} DN/e- lies outside of the gain modes of {self.camera}, "
            f"{' and '.join('{:.4g} to {:.4g}'.format(*mode.gain_range_dn_per_e) for mode in modes)} DN/e-. {_GO_ON}"
        )

    def _rows_of(self, mode: GainMode) -> Sequence[ProfileRow]:
        """Return the rows that were measured in a mode; every row, if it is the only one."""
        if not self.modes:
            return self.rows
        return [
            row
            for row in self.rows
            if row.gain_dn_per_e is not None and mode.distance(row.gain_dn_per_e) <= GAIN_ROUNDING
        ]

    @property
    def range_dn(self) -> float | None:
        """White level minus black level, DN; ``None`` if the profile does not state both."""
        if self.black_level_dn is None or self.white_level_dn is None:
            return None
        return self.white_level_dn - self.black_level_dn

    def gain_at_iso(self, iso: float, *, extrapolate: bool = False) -> float:
        """Return K at an ISO: as measured there, else between the two measured ISOs next to it, in one gain mode.

        ln K is straight over ln ISO from each measured ISO to the next one, which may have the same K, as extended ISOs
        do. The ends of the ranges count as measured where no row has their ISO.

        Parameters
        ----------
        iso
            ISO speed, within ``iso_range``; within the ISOs of the rows where that is not known.
        extrapolate
            Allow ISOs beyond it and between two gain modes: at a row's K where one has it; else, unless it lies between
            two rows of one mode, in proportion to the ISO from the nearest measured one on. The fits hold there only
            if the camera goes on as it was measured; its extended ISOs often do not.

        Raises
        ------
        ArgumentError
            If the profile does not know its ISOs, or this one lies outside of them or between two gain modes.
        """
        if not (math.isfinite(iso) and iso > 0):
            raise ArgumentError(f"an ISO is finite and above 0; found {iso:g}")
        gains = self._gains_by_iso()
        if not gains:
            raise ArgumentError(f"the profile of {self.camera} does not say which ISO its gains belong to; give a gain")
        low, high = self.iso_range or (min(gains), max(gains))
        if not (low <= iso <= high or extrapolate):
            raise ArgumentError(
                f"ISO {iso:g} is outside of the calibrated range {low:g} to {high:g} of {self.camera}; extrapolating "
                f"beyond it {_ASKED}"
            )
        if iso in gains:
            return gains[iso]
        around = [*[one for one in gains if one < iso][-1:], *[one for one in gains if one > iso][:1]]
        if len(around) == 2 and self._share_a_mode(*(gains[one] for one in around)):
            below, above = around
            share = math.log(iso / below) / math.log(above / below)
            return gains[below] * math.pow(gains[above] / gains[below], share)
        if not extrapolate:
            raise ArgumentError(
                f"ISO {iso:g} lies between the gain modes of {self.camera}, {' and '.join(map(str, self.modes))}: "
                f"which of them the camera has between ISO {' and '.join(f'{one:g}' for one in around)} was not "
                f"measured. {_GO_ON}"
            )
        nearest = min(around, key=lambda one: abs(math.log(one / iso)))
        return gains[nearest] * iso / nearest

    def iso_at_gain(self, gain_dn_per_e: float) -> float | None:
        """Return the ISO at which :meth:`gain_at_iso` is K, the lowest of several; ``None`` if no ISO is known.

        Beyond the measured gains, and between those of two gain modes, it is in proportion to the nearest one's.
        """
        gains = self._gains_by_iso()
        for (below, first), (above, last) in pairwise(gains.items()):
            if min(first, last) <= gain_dn_per_e <= max(first, last) and self._share_a_mode(first, last):
                share = 0.0 if first == last else math.log(gain_dn_per_e / first) / math.log(last / first)
                return below * math.pow(above / below, share)
        nearest = min(gains, key=lambda iso: abs(math.log(gains[iso] / gain_dn_per_e)), default=None)
        return None if nearest is None else nearest * gain_dn_per_e / gains[nearest]

    def _gains_by_iso(self) -> dict[float, float]:
        """Return K by ISO, ascending: the rows' mean, and the ends of the ranges where no row has their ISO."""
        found: dict[float, list[float]] = {}
        for row in self.rows:
            if row.iso is not None and row.gain_dn_per_e is not None:
                found.setdefault(row.iso, []).append(row.gain_dn_per_e)
        for mode in self.gain_modes:
            for iso, gain in zip(mode.iso_range or (), mode.gain_range_dn_per_e, strict=False):
                found.setdefault(iso, [gain])
        return {iso: sum(found[iso]) / len(found[iso]) for iso in sorted(found)}

    def _share_a_mode(self, *gains: float) -> bool:
        """Return whether gains are of one gain mode."""
        modes = self.gain_modes
        return len(modes) == 1 or any(max(map(mode.distance, gains)) <= GAIN_ROUNDING for mode in modes)

    def measured(self, iso: float) -> NoiseParameters:
        """Return the figures that were measured at an ISO, without the spread of the fits; the first of several.

        Where sigma_row is withheld, for rows that are not white, it is the standard deviation of their spectrum.

        Raises
        ------
        ArgumentError
            If this ISO was not measured, or not all of its figures are known; the message lists those that were.
        """
        complete: dict[float, NoiseParameters] = {}
        for row in self.rows:
            gain, scale, gauss, rows = row.gain_dn_per_e, row.sigma_tl_dn, row.sigma_gauss_dn, row.sigma_row_dn
            structure = None if gain is None else self._structure_at(gain)
            if rows is None and structure is not None and structure.row_spectrum is not None:
                rows = math.sqrt(structure.row_spectrum.variance_dn2)  # withheld for nothing but the bands
            if row.iso is None or gain is None or scale is None or gauss is None or rows is None:
                continue
            found = NoiseParameters(
                *(gain, row.tukey_lambda, scale, gauss, rows, row.colour_bias_dn, self.range_dn, row.iso, structure)
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
        colour bias come from one and the same calibration row. Of several gain modes, ln K is uniform over their ranges
        together, and lines and rows are those of the mode in which K lies.

        Parameters
        ----------
        generator
            A :class:`numpy.random.Generator` or a :class:`torch.Generator`; the same state gives the same draw.
        iso, gain_dn_per_e
            Fix the ISO, or K itself, in place of drawing K.
        row
            ``"any"``: every row (of the mode) alike, as in the paper. ``"nearest-gain"``: the row measured at the gain
            nearest to K (one of them at random if several are). To simulate one ISO take the latter: with lambda of
            another row, a scale makes another variance. ``"measured"``: nothing is drawn, the figures are those of
            :meth:`measured` at ``iso``.
        extrapolate
            Allow an ISO beyond the calibrated range or between two modes (:meth:`gain_at_iso`, :meth:`mode_at`).

        Raises
        ------
        ArgumentError
            If both ``iso`` and ``gain_dn_per_e`` are given, the ISO is unknown or outside of the calibrated range or,
            as K may, of the gain modes, no row has a gain to be near to, or the ISO was not measured.
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
            gain = self._gain_at(u_gain)
        mode = self.mode_at(gain, extrapolate=extrapolate)
        rows = self._rows_for(mode, gain, row)
        chosen = rows[min(int(u_row * len(rows)), len(rows) - 1)]
        return NoiseParameters(
            gain_dn_per_e=gain,
            tukey_lambda=chosen.tukey_lambda,
            sigma_tl_dn=mode.tukey_lambda_fit.scale_dn(gain, z_tl),
            sigma_gauss_dn=mode.gauss_fit.scale_dn(gain, z_gauss),
            sigma_row_dn=mode.row_fit.scale_dn(gain, z_row),
            colour_bias_dn=chosen.colour_bias_dn,
            range_dn=self.range_dn,
            iso=iso,
            structure=self._structure_at(gain),
        )

    def _structure_at(self, gain: float) -> NoiseStructure | None:
        """Return the figures of C, W, T and F at the gain nearest to one, if there are any."""
        return min(self.structure, key=lambda one: abs(math.log(one.gain_dn_per_e / gain)), default=None)

    def _gain_at(self, share: float) -> float:
        """Return the gain below which a share of all ranges of ln K lies."""
        *others, mode = self.gain_modes
        left = share * sum(one.log_width for one in (*others, mode))
        for one in others:
            if left <= one.log_width:
                mode = one
                break
            left -= one.log_width
        return math.exp(math.log(mode.gain_range_dn_per_e[0]) + left)

    def _rows_for(self, mode: GainMode, gain: float, row: RowChoice) -> Sequence[ProfileRow]:
        rows = self._rows_of(mode)
        if row == "any":
            return rows
        if row != "nearest-gain":
            raise ArgumentError(f"row must be 'any', 'nearest-gain' or 'measured'; found {row!r}")
        distances = [
            abs(math.log(candidate.gain_dn_per_e / gain)) if candidate.gain_dn_per_e is not None else math.inf
            for candidate in rows
        ]
        nearest = min(distances)
        if math.isinf(nearest):
            raise ArgumentError(f"no row of {self.camera}'s profile has a gain; row='nearest-gain' needs one")
        return [candidate for candidate, distance in zip(rows, distances, strict=True) if distance <= nearest + 1e-9]


_ASKED_FOR = "one profile with --profile-of-another-camera (profile_of_another_camera=True)"


def profile_of(
    camera: str, profiles: Sequence[CameraProfile], *, another: bool = False, otherwise: str = _ASKED_FOR
) -> CameraProfile:
    """Return the profile of a camera: the one rule wherever a profile is to tell the noise of a named camera's frames.

    Raises
    ------
    ArgumentError
        If none is of it, unless there is only one, and one of ``another`` camera is asked for. ``otherwise`` is what to
        give else.
    """
    for profile in profiles:
        if profile.camera == camera:
            return profile
    if another and len(profiles) == 1:
        return profiles[0]
    known = ", ".join(profile.camera for profile in profiles)
    raise ArgumentError(
        f"no profile of the camera {camera} was given, only of {known}, whose noise is another; give its own, or "
        f"{otherwise}"
    )


# --- files ----------------------------------------------------------------------------------------------------

_FOLDER = Path(__file__).parent / "profiles"


def shipped_profiles() -> tuple[str, ...]:
    """Return the names of the shipped profiles.

    Examples
    --------
    >>> from eldata.noise import shipped_profiles
    >>> shipped_profiles()
    ('CanonEOS5D4', 'CanonEOS700D', 'CanonEOS70D', 'NikonD850', 'NikonD850-2', 'SonyA7S2', 'SonyA7S2-PMN')
    """
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.json")))


def _digits(value: float | None) -> str | None:
    return None if value is None else f"{value:.4g}"


def _read(path: Path) -> CameraProfile:
    top = TextFile(path, ProfileError).json()
    schema = top.schema(SCHEMA, also=(SCHEMA_WITH_MODES, SCHEMA_WITH_STRUCTURE))
    has_structure = schema == SCHEMA_WITH_STRUCTURE
    has_modes = schema == SCHEMA_WITH_MODES or (has_structure and "modes" in top.data)
    absent = (*(_OF_ONE_MODE if has_modes else ("modes",)), *(() if has_structure else ("structure",)))
    top.only(("schema", *(name for name in names_of(CameraProfile) if name not in absent)))
    lines = (None, None, None) if has_modes else _lines(top)
    return CameraProfile(
        camera=top.text("camera"),
        source=top.text("source"),
        gain_range_dn_per_e=_range(top, "gain_range_dn_per_e"),
        tukey_lambda_fit=lines[0],
        gauss_fit=lines[1],
        row_fit=lines[2],
        rows=tuple(map(_row, top.objects("rows", fewest=1, expected="a list of at least one row"))),
        iso_range=top.optional("iso_range", partial(_range, top)),
        black_level_dn=top.optional("black_level_dn", top.number),
        white_level_dn=top.optional("white_level_dn", top.number),
        notes=top.texts("notes", missing_ok=True, empty=True),
        modes=tuple(map(_mode, top.objects("modes", fewest=2, expected="a list of two modes or more")))
        if has_modes
        else (),
        structure=tuple(map(read_structure, top.objects("structure", fewest=1))) if has_structure else (),
        accepted=top.texts("accepted", missing_ok=True, empty=True),
    )


def _mode(mode: Fields) -> GainMode:
    mode.only(names_of(GainMode))
    return GainMode(
        _range(mode, "gain_range_dn_per_e"), *_lines(mode), mode.optional("iso_range", partial(_range, mode))
    )


def _lines(holder: Fields) -> tuple[LogLogFit, LogLogFit, LogLogFit]:
    return (
        _fit(holder.inside("tukey_lambda_fit")), _fit(holder.inside("gauss_fit")), _fit(holder.inside("row_fit"))
    )  # fmt: skip


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
