"""Camera profiles: what a calibration found, and how parameters are drawn from it.

A profile is a JSON file, validated on load. Profiles of five cameras ship with the package (:func:`shipped_profiles`).
A camera that switches its conversion gain has the noise of two cameras: its profile holds a :class:`GainMode` for each.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from eldata.base.fields import names_of
from eldata.base.files import write_json
from eldata.base.numbers import checked_number, counted
from eldata.base.tables import block, table
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, ProfileError, check_choice
from eldata.noise.gain_modes import (
    GAIN_ROUNDING,
    OF_ONE_MODE,
    SIGMA_TITLES,
    SIGMAS,
    GainMode,
    LogLogFit,
    ProfileRow,
    Sigma,
    cells_of,
    gain_at_share,
    gain_between,
    gains_by_iso,
    iso_between,
    modes_problem,
    rows_nearest,
    rows_of,
)
from eldata.noise.parameters import Generator, NoiseParameters, draw_numbers
from eldata.noise.profile_files import profile_path, read_profile, schema_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.plots.axes import Theme

RowChoice = Literal["any", "nearest-gain", "measured"]

_ASKED = "has to be asked for (extrapolate=True, or --extrapolate where a command has it)"
_GO_ON = f"To go on with the nearer one's lines {_ASKED}"


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
        Fits of sigma_TL, of the Gaussian sigma and of sigma_row over K; ``None`` if there are ``modes``, and where it
        was measured at too few ISOs for a line: such a profile gives the ISOs as they were measured, and no others.
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
    accepted
        Figures that a check of the calibration would withhold and somebody has accepted, with check and ISOs.
    quantisation_step_dn
        The step by which the files' values go, DN, above 0 (:class:`~eldata.noise.parameters.NoiseParameters`).

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
    accepted: tuple[str, ...] = ()
    quantisation_step_dn: float = 1.0

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
        if not self.modes:
            return None
        if (self.tukey_lambda_fit, self.gauss_fit, self.row_fit) != (None, None, None):
            return "tukey_lambda_fit, gauss_fit and row_fit are those of the modes; leave them None"
        found = modes_problem(self.modes, self.gain_range_dn_per_e, self.iso_range)
        lacking = [mode for mode in self.modes if not rows_of(mode, self.rows, self.modes)]
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
        return cls(**read_profile(profile_path(name), names_of(cls)))

    def save(self, path: Path | str) -> None:
        """Write the profile as JSON, whole or not at all."""
        write_json(path, {"schema": schema_of(self.modes)} | self.as_dict(), indent=1)

    def as_dict(self) -> dict[str, Any]:
        """Return the profile as its file holds it, as plain types: with modes, or with fits of its own."""
        usual = {"accepted": (), "quantisation_step_dn": 1}
        left_out = {*(OF_ONE_MODE if self.modes else ("modes",)), *(n for n in usual if getattr(self, n) == usual[n])}
        found = {name: value for name, value in asdict(self).items() if name not in left_out}
        return found | {"rows": tuple(row.as_dict() for row in self.rows)}

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
            lines = ((getattr(mode, line), *mode.gain_range_dn_per_e) for mode in self.gain_modes)
            scale_over_gain(axes, name, [one for one in lines if one[0] is not None], self._measured(field), theme)

        if sigma is not None:
            check_choice("sigma", sigma, SIGMAS)
            return drawn_into(ax, self.camera, partial(panel, sigma))
        if ax is not None:
            raise ArgumentError(f"one axes has room for one sigma; give sigma, one of {', '.join(SIGMAS)}")
        return drawn_grid(self.camera, [(SIGMA_TITLES[name], partial(panel, name)) for name in SIGMAS])

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
        names, rows = cells_of(self.rows)
        notes = (self.source, *self.notes)
        return block(f"Camera profile of {self.camera}", table(names, rows, left=()), notes=notes)

    @property
    def gain_modes(self) -> tuple[GainMode, ...]:
        """The modes; the profile's own range and fits, where it has no other."""
        lines = self.tukey_lambda_fit, self.gauss_fit, self.row_fit
        return self.modes or (GainMode(self.gain_range_dn_per_e, *lines, self.iso_range),)

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
        gains = gains_by_iso(self.rows, self.gain_modes)
        if not gains:
            raise ArgumentError(f"the profile of {self.camera} does not say which ISO its gains belong to; give a gain")
        low, high = self.iso_range or (min(gains), max(gains))
        if not (low <= iso <= high or extrapolate):
            raise ArgumentError(
                f"ISO {iso:g} is outside of the calibrated range {low:g} to {high:g} of {self.camera}; extrapolating "
                f"beyond it {_ASKED}"
            )
        found = gain_between(gains, self.gain_modes, iso)
        if found is not None:
            return found
        around = [*[one for one in gains if one < iso][-1:], *[one for one in gains if one > iso][:1]]
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
        gains = gains_by_iso(self.rows, self.gain_modes)
        found = iso_between(gains, self.gain_modes, gain_dn_per_e)
        if found is not None:
            return found
        nearest = min(gains, key=lambda iso: abs(math.log(gains[iso] / gain_dn_per_e)), default=None)
        return None if nearest is None else nearest * gain_dn_per_e / gains[nearest]

    def measured(self, iso: float) -> NoiseParameters:
        """Return the figures that were measured at an ISO, without the spread of the fits; the first of several.

        Raises
        ------
        ArgumentError
            If this ISO was not measured, or not all of its figures are known; the message lists those that were.
        """
        complete: dict[float, NoiseParameters] = {}
        for row in self.rows:
            found = row.parameters(self.range_dn, self.quantisation_step_dn)
            if row.iso is not None and found is not None:
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
        """Draw parameters jointly (equation 12 of the paper).

        ln K is uniform between the camera's own limits; ln sigma is normal around its line given ln K; lambda and
        colour bias come from one and the same calibration row, the bias from one of its frames if it has them. Section
        3.2.2 of the paper takes both from their empirical distribution and leaves open whether together. Of several
        gain modes, ln K is uniform over their ranges together; lines and rows are those of the mode in which K lies.

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
            as K may, of the gain modes, no row has a gain to be near to, the ISO was not measured, or a scale has no
            line.
        """
        # Always five numbers, whatever is fixed: fixing one parameter leaves the others' draws as they were.
        (u_gain, u_row), (z_tl, z_gauss, z_row) = draw_numbers(generator)
        if iso is not None and gain_dn_per_e is not None:
            raise ArgumentError("give iso or gain_dn_per_e, not both")
        if row == "measured":
            if iso is None:
                raise ArgumentError("row='measured' gives the figures of one ISO; give iso")
            return self.measured(iso)
        if iso is not None:
            gain = self.gain_at_iso(iso, extrapolate=extrapolate)
        elif gain_dn_per_e is not None:
            gain = checked_number("gain_dn_per_e", gain_dn_per_e, above=0)
        else:
            gain = gain_at_share(self.gain_modes, u_gain)
        mode = self.mode_at(gain, extrapolate=extrapolate)
        rows = rows_of(mode, self.rows, self.modes)
        if row == "nearest-gain":
            rows = rows_nearest(gain, rows)
            if not rows:
                raise ArgumentError(f"no row of {self.camera}'s profile has a gain; row='nearest-gain' needs one")
        elif row != "any":
            raise ArgumentError(f"row must be 'any', 'nearest-gain' or 'measured'; found {row!r}")
        # What u_row says beyond the row is uniform too: it chooses the frame, and no other draw moves.
        place = u_row * len(rows)
        chosen = rows[min(int(place), len(rows) - 1)]
        sigma_tl, sigma_gauss, sigma_row = mode.scales_dn(gain, (z_tl, z_gauss, z_row))
        return NoiseParameters(
            gain_dn_per_e=gain,
            tukey_lambda=chosen.tukey_lambda,
            sigma_tl_dn=sigma_tl,
            sigma_gauss_dn=sigma_gauss,
            sigma_row_dn=sigma_row,
            colour_bias_dn=chosen.bias_at_share(place % 1),
            range_dn=self.range_dn,
            iso=iso,
            quantisation_step_dn=self.quantisation_step_dn,
        )


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
