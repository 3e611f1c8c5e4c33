"""Camera profiles: what a calibration found, its file, and how parameters are drawn from it.

A profile is a JSON file, validated on load. Profiles of five cameras ship with the package (:func:`shipped_profiles`).
A gain mode is a range in which a camera keeps its conversion gain. A camera that switches it has the noise of two
cameras: its profile holds a :class:`GainMode` for each.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any, Literal

from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import write_json
from eldata.base.numbers import checked_number, counted
from eldata.base.tables import block, table
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, ProfileError, check_choice, did_you_mean
from eldata.noise.parameters import Generator, NoiseParameters, draw_numbers, shape_problem

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.plots.axes import Theme

RowChoice = Literal["any", "nearest-gain", "measured"]
Sigma = Literal["TL", "G", "row"]

SIGMAS: dict[Sigma, tuple[str, str, str]] = {
    "TL": ("tukey_lambda_fit", "sigma_tl_dn", "read noise, Tukey lambda"),
    "G": ("gauss_fit", "sigma_gauss_dn", "read noise, Gaussian"),
    "row": ("row_fit", "sigma_row_dn", "row noise"),
}
"""The scales of a profile by the index of their sigma: the line over K, the field of a row, and the title."""

GAIN_ROUNDING = 0.01
"""Of ln K: gains are printed and stated with few digits."""

_LINES = tuple(line for line, _, _ in SIGMAS.values())  # a profile with modes leaves them to these
_SCHEMA, _SCHEMA_WITH_MODES = 1, 2
_FRAMES = "a list of four numbers (R, G1, B, G2) for each bias frame"
_MEAN_DN = 0.001  # by rounding of either
_FOLDER = Path(__file__).parent / "profiles"
_ASKED = "has to be asked for (extrapolate=True, or --extrapolate where a command has it)"
_GO_ON = f"To go on with the nearer one's lines {_ASKED}"


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

    @classmethod
    def read(cls, holder: Fields, name: str) -> LogLogFit | None:
        """Read a line of a profile or a mode, which may be null."""
        if holder.data.get(name, holder) is None:
            return None
        fields = holder.inside(name)
        fields.only(names_of(cls))
        return cls(fields.number("slope"), fields.number("intercept"), fields.number("sigma", at_least=0))


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
        Its lowest and its highest ISO, if known: the ISOs of ``gain_range_dn_per_e``, where no row has them.
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
        lines = [self.tukey_lambda_fit, self.gauss_fit, self.row_fit]
        if lacking := [f"sigma_{name}" for name, line in zip(SIGMAS, lines, strict=True) if line is None]:
            raise ArgumentError(
                f"{', '.join(lacking)} was measured at too few ISOs for a line over K, so nothing can be drawn around "
                "one; take an ISO as it was measured: row='measured' and its iso (--row measured --iso ISO)"
            )
        first, second, third = (
            line.scale_dn(gain_dn_per_e, z) for line, z in zip(lines, standard_normals, strict=True) if line
        )
        return first, second, third

    @property
    def log_width(self) -> float:
        """ln(highest K / lowest K)."""
        low, high = (math.log(limit) for limit in self.gain_range_dn_per_e)
        return high - low

    def distance(self, gain_dn_per_e: float) -> float:
        """Measure how far a gain lies outside of the range, in ln K; 0 within it."""
        low, high = self.gain_range_dn_per_e
        return max(0.0, math.log(low / gain_dn_per_e), math.log(gain_dn_per_e / high))

    def __str__(self) -> str:
        """Return the ISOs, or the gains where those are not known."""
        if self.iso_range is None:
            return "K {:.4g} to {:.4g}".format(*self.gain_range_dn_per_e)
        return "ISO {:g} to {:g}".format(*self.iso_range)

    @classmethod
    def read(cls, fields: Fields) -> GainMode:
        """Read a mode of a profile's file."""
        fields.only(names_of(cls))
        tukey_lambda, gauss, row = (LogLogFit.read(fields, name) for name in _LINES)
        isos = fields.optional("iso_range", partial(_read_range, fields))
        return cls(_read_range(fields, "gain_range_dn_per_e"), tukey_lambda, gauss, row, isos)


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
        """Convert the row to noise parameters; ``None`` unless K and all scales are known."""
        gain, scale, gauss, rows = self.gain_dn_per_e, self.sigma_tl_dn, self.sigma_gauss_dn, self.sigma_row_dn
        if gain is None or scale is None or gauss is None or rows is None:
            return None
        figures = gain, self.tukey_lambda, scale, gauss, rows, self.colour_bias_dn
        return NoiseParameters(*figures, range_dn, self.iso, step_dn)

    @classmethod
    def read(cls, fields: Fields) -> ProfileRow:
        """Read a row of a profile's file."""
        fields.only(names_of(cls))
        bias = _read_bias(fields, "colour_bias_dn")
        frames = fields.each("frame_bias_dn", _read_bias, missing_ok=True, expected=_FRAMES)
        means = [fmean(of_channel) for of_channel in zip(*frames, strict=True)] or bias
        if any(abs(mean - stated) > _MEAN_DN for mean, stated in zip(means, bias, strict=True)):
            expected = f"frames whose mean is colour_bias_dn to {_MEAN_DN} DN"
            raise fields.wrong("frame_bias_dn", expected, [*map(list, frames)])
        shape = fields.number("tukey_lambda")
        if (problem := shape_problem(shape)) is not None:
            raise fields.wrong("tukey_lambda", f"a number {problem}", shape)
        known = {name: fields.optional(name, fields.number, above=0) for name in ("iso", "gain_dn_per_e")}
        known |= {field: fields.optional(field, fields.number, at_least=0) for _, field, _ in SIGMAS.values()}
        known |= {name: fields.optional(name, fields.number) for name in ("r_squared_tl", "r_squared_gauss")}
        return cls(tukey_lambda=shape, colour_bias_dn=bias, frame_bias_dn=frames, **known)


def modes_problem(
    modes: Sequence[GainMode], gain_range_dn_per_e: tuple[float, float], iso_range: tuple[float, float] | None
) -> str | None:
    """Describe a contradiction between modes, or with the ranges of their camera; ``None`` if there is none."""
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
        The lowest and the highest calibrated ISO, if known: the ISOs of ``gain_range_dn_per_e``, where no row has them.
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
        lines = self.tukey_lambda_fit, self.gauss_fit, self.row_fit
        problem = modes_problem(self.modes, self.gain_range_dn_per_e, self.iso_range) if self.modes else None
        if self.modes and lines != (None, None, None):
            problem = f"{', '.join(_LINES)} are those of the modes; leave them None"
        for mode in self.modes:
            if problem is None and not rows_of(mode, self.rows, self.modes):
                problem = f"no row has a K in the mode of {mode}: lambda and colour bias are not known there"
        if problem is not None:
            raise ProfileError(f"the profile of {self.camera}: {problem}")

    @classmethod
    def load(cls, name: str | Path) -> CameraProfile:
        """Load a shipped profile by its name, or any by its path.

        Raises
        ------
        ProfileError
            If the profile is unknown or malformed; the message names file, field, expected and found.
        """
        top = TextFile(_profile_path(name), ProfileError).json()
        has_modes = top.schema(_SCHEMA, also=(_SCHEMA_WITH_MODES,)) == _SCHEMA_WITH_MODES
        top.only(("schema", *(field for field in names_of(cls) if field not in (_LINES if has_modes else ("modes",)))))
        modes = top.objects("modes", fewest=2, expected="a list of two modes or more") if has_modes else ()
        lines: dict[str, Any] = {line: None if has_modes else LogLogFit.read(top, line) for line in _LINES}
        return cls(
            **lines,
            camera=top.text("camera"),
            source=top.text("source"),
            gain_range_dn_per_e=_read_range(top, "gain_range_dn_per_e"),
            rows=tuple(map(ProfileRow.read, top.objects("rows", fewest=1, expected="a list of at least one row"))),
            iso_range=top.optional("iso_range", partial(_read_range, top)),
            black_level_dn=top.optional("black_level_dn", top.number),
            white_level_dn=top.optional("white_level_dn", top.number),
            notes=top.texts("notes", missing_ok=True, empty=True),
            modes=tuple(map(GainMode.read, modes)),
            accepted=top.texts("accepted", missing_ok=True, empty=True),
            quantisation_step_dn=top.optional("quantisation_step_dn", top.number, 1.0, above=0),
        )

    def save(self, path: Path | str) -> None:
        """Write the profile as JSON, whole or not at all."""
        schema = _SCHEMA_WITH_MODES if self.modes else _SCHEMA
        write_json(path, {"schema": schema} | self.as_dict(), indent=1)

    def as_dict(self) -> dict[str, Any]:
        """Return the profile as its file holds it, as plain types: with modes, or with fits of its own."""
        usual = {"accepted": (), "quantisation_step_dn": 1}
        left_out = {*(_LINES if self.modes else ("modes",)), *(n for n in usual if getattr(self, n) == usual[n])}
        fields = {name: value for name, value in asdict(self).items() if name not in left_out}
        return fields | {"rows": tuple(row.as_dict() for row in self.rows)}

    def plot(self, sigma: Sigma | None = None, *, ax: Axes | None = None) -> Figure:
        """Draw the lines of ln sigma over ln K with bands of one and two residual deviations, and the measured rows.

        Parameters
        ----------
        sigma
            ``"TL"`` or ``"G"``, the read noise by either model; ``"row"``. By default all three, an axes each.
        ax
            Axes to draw one into; by default in a new figure, which belongs to no pyplot and shows in a notebook.

        Returns
        -------
        matplotlib.figure.Figure
            That of the axes.

        Raises
        ------
        ArgumentError
            If there is no such sigma, or ``ax`` is given without one.
        """
        from eldata.plots.axes import drawn_grid, drawn_into, scale_over_gain

        def draw_scale(name: Sigma, axes: Axes, theme: Theme) -> None:
            """Draw a scale over K: the lines of the gain modes, and the measured rows as points."""
            line, field, _ = SIGMAS[name]
            fits = [(getattr(mode, line), mode.gain_range_dn_per_e) for mode in self.gain_modes]
            drawn = [(fit.scale_dn, *ends) for fit, ends in fits if fit is not None]
            known = [(row.gain_dn_per_e, getattr(row, field)) for row in self.rows]
            points = [(gain, scale, math.nan) for gain, scale in known if gain is not None and scale]  # no errors
            scale_over_gain(axes, name, drawn, points, theme)

        if sigma is not None:
            check_choice("sigma", sigma, SIGMAS)
            return drawn_into(ax, self.camera, partial(draw_scale, sigma))
        if ax is not None:
            raise ArgumentError(f"one axes has room for one sigma; give sigma, one of {', '.join(SIGMAS)}")
        return drawn_grid(self.camera, [(title, partial(draw_scale, name)) for name, (_, _, title) in SIGMAS.items()])

    def __repr__(self) -> str:
        low, high = self.gain_range_dn_per_e
        modes = f", {len(self.modes)} gain modes" if self.modes else ""
        text = f"{counted(len(self.rows), 'row')}, K {low:.4g} to {high:.4g} DN/e-{modes}"
        return f"CameraProfile({in_line(self.camera)!r}, {text})"

    def _repr_html_(self) -> str:
        """Render the rows as a table for notebooks."""
        titles = ["ISO", "K [DN/e⁻]", "λ", *(f"σ {name} [DN]" for name in SIGMAS)]
        titles += [f"bias {name} [DN]" for name in ("R", "G1", "B", "G2")]
        cells: list[list[str]] = []
        for row in self.rows:
            figures = row.gain_dn_per_e, row.tukey_lambda, row.sigma_tl_dn, row.sigma_gauss_dn, row.sigma_row_dn
            texts = ["" if value is None else f"{value:.4g}" for value in (*figures, *row.colour_bias_dn)]
            cells.append(["" if row.iso is None else f"{row.iso:g}", *texts])
        known = [place for place, column in enumerate(zip(*cells, strict=True)) if any(column)]
        rows = [tuple(row[place] or "-" for place in known) for row in cells]
        notes = (self.source, *self.notes)
        return block(
            f"Camera profile of {self.camera}", table([titles[place] for place in known], rows, left=()), notes=notes
        )

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
        around = [*[known for known in gains if known < iso][-1:], *[known for known in gains if known > iso][:1]]
        if len(around) == 2 and self._share_a_mode(*(gains[known] for known in around)):
            below, above = around
            share = math.log(iso / below) / math.log(above / below)
            return gains[below] * math.pow(gains[above] / gains[below], share)
        if not extrapolate:
            raise ArgumentError(
                f"ISO {iso:g} lies between the gain modes of {self.camera}, {' and '.join(map(str, self.modes))}: "
                f"which of them the camera has between ISO {' and '.join(f'{known:g}' for known in around)} was not "
                f"measured. {_GO_ON}"
            )
        nearest = min(around, key=lambda known: abs(math.log(known / iso)))
        return gains[nearest] * iso / nearest

    def iso_at_gain(self, gain_dn_per_e: float) -> float | None:
        """Return the ISO at which :meth:`gain_at_iso` is K, the lowest of several; ``None`` if no ISO is known.

        Beyond the measured gains, and between two gain modes, it is in proportion to the nearest measured gain.
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
        gains: dict[float, list[float]] = {}
        for row in self.rows:
            if row.iso is not None and row.gain_dn_per_e is not None:
                gains.setdefault(row.iso, []).append(row.gain_dn_per_e)
        for mode in self.gain_modes:
            for iso, gain in zip(mode.iso_range or (), mode.gain_range_dn_per_e, strict=False):
                gains.setdefault(iso, [gain])
        return {iso: sum(gains[iso]) / len(gains[iso]) for iso in sorted(gains)}

    def _share_a_mode(self, *gains: float) -> bool:
        """Check whether one gain mode contains all of these gains, or nearly."""
        modes = self.gain_modes
        return len(modes) == 1 or any(max(map(mode.distance, gains)) <= GAIN_ROUNDING for mode in modes)

    def measured(self, iso: float) -> NoiseParameters:
        """Return the figures that were measured at an ISO, without the spread of the fits; the first of several.

        Raises
        ------
        ArgumentError
            If this ISO was not measured, or not all of its figures are known; the message lists those that were.
        """
        drawn = [(row.iso, row.parameters(self.range_dn, self.quantisation_step_dn)) for row in reversed(self.rows)]
        complete = {known: figures for known, figures in drawn if known is not None and figures is not None}
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
            Fix the ISO, or K itself, instead of drawing K.
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
            gain = self._gain_at_share(u_gain)
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
        scales = mode.scales_dn(gain, (z_tl, z_gauss, z_row))
        bias = chosen.bias_at_share(place % 1)
        return NoiseParameters(gain, chosen.tukey_lambda, *scales, bias, self.range_dn, iso, self.quantisation_step_dn)

    def _gain_at_share(self, share: float) -> float:
        """Return the gain below which a share of all ranges of ln K lies."""
        *others, mode = self.gain_modes
        left = share * sum(every.log_width for every in self.gain_modes)
        for other in others:
            if left <= other.log_width:
                mode = other
                break
            left -= other.log_width
        return math.exp(math.log(mode.gain_range_dn_per_e[0]) + left)


_ASKED_FOR = "one profile with --profile-of-another-camera (profile_of_another_camera=True)"


def profile_of(
    camera: str, profiles: Sequence[CameraProfile], *, another: bool = False, otherwise: str = _ASKED_FOR
) -> CameraProfile:
    """Find a camera's profile among several: the one rule wherever frames of a named camera get noise.

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


# --- files ------------------------------------------------------------------------------------------------------------


def shipped_profiles() -> tuple[str, ...]:
    """Return the names of the shipped profiles.

    Examples
    --------
    >>> from eldata.noise import shipped_profiles
    >>> shipped_profiles()
    ('CanonEOS5D4', 'CanonEOS700D', 'CanonEOS70D', 'NikonD850', 'NikonD850-2', 'SonyA7S2', 'SonyA7S2-PMN')
    """
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.json")))


def _profile_path(name: str | Path) -> Path:
    """Find the file of a shipped profile by its name, or of any by its path."""
    if not isinstance(name, str) or "/" in name or name.endswith(".json"):
        return Path(name)
    known = shipped_profiles()
    if name not in known:
        raise ProfileError(
            f"no camera profile is called {name!r}; known are {', '.join(known)}, or give the path of a .json "
            f"file{did_you_mean(name, known)}"
        )
    return _FOLDER / f"{name}.json"


def _read_range(top: Fields, name: str) -> tuple[float, float]:
    """Read two positive numbers, the lower first."""
    low, high = top.each(name, Fields.number, count=2, expected="two numbers")
    if not 0 < low <= high:
        raise top.wrong(name, "two positive numbers, the lower first", [low, high])
    return low, high


def _read_bias(holder: Fields, name: str) -> tuple[float, float, float, float]:
    """Read the colour bias of R, G1, B and G2, in DN."""
    red, green, blue, second_green = holder.each(name, Fields.number, count=4, expected="four numbers (R, G1, B, G2)")
    return red, green, blue, second_green
