"""What a calibration found: one record for each figure, of each ISO, and of the camera.

A figure is declared once, where its ISO makes its record (:attr:`IsoCalibration.figures`); profile, tables, JSON, page
and plots read that record.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.numbers import counted
from eldata.base.tables import block, table, text_table, with_error
from eldata.base.visible import in_line
from eldata.calibration.findings import SYMBOLS, list_symbols, usual_gain_per_iso
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

    from eldata.calibration.findings import Effect, Finding, Quantity
    from eldata.calibration.fixed_pattern import PatternSummary
    from eldata.calibration.joint import FittedMode, LogLogEstimate
    from eldata.calibration.photon_transfer import PhotonTransfer
    from eldata.calibration.read_noise import ProbabilityPlot, ReadNoise
    from eldata.calibration.reproduction import Reproduction
    from eldata.calibration.row_noise import ColourBias, RowNoise
    from eldata.calibration.sums import Plane
    from eldata.manifest.verify_report import Problem
    from eldata.noise.gain_modes import GainMode, ProfileRow
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import CameraProfile
    from eldata.plots.axes import Drawing, Theme
    from eldata.plots.gains import Point
    from eldata.records import Sensor

    Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

_FRAME_DECIMALS = 4  # of a DN: a mean of three million pixels of 1 DN is not known better than to 0.0006


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure at one ISO.

    Attributes
    ----------
    name, label, unit
        Its key in JSON, such as ``sigma_tl_dn``; what tables call it, such as ``sigma_TL``; ``"DN"``, or none.
    value, error
        The figure and its standard error with all allowances; nan: withheld, or not known.
    decimals
        Of a figure that has no error.
    why_withheld
        Which assumption did not hold; empty if the figure is given.
    is_stated
        Whether it was not measured: somebody has said so.
    """

    name: str
    label: str
    value: float
    error: float = math.nan
    unit: str = ""
    decimals: int | None = None
    why_withheld: str = ""
    is_stated: bool = False

    @property
    def heading(self) -> str:
        """Its label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    @property
    def text(self) -> str:
        """The figure with its error in as many digits as they bear; a stated one says that it is."""
        if math.isnan(self.value):
            return "withheld"
        if self.decimals is not None:
            return f"{self.value:.{self.decimals}f}"
        return with_error(self.value, self.error) + (" (stated)" if self.is_stated else "")

    def as_dict(self) -> dict[str, float]:
        """Return the figure by its name, and its error: ``sigma_tl_dn`` and ``sigma_tl_error_dn``."""
        values = {self.name: self.value}
        if self.decimals is None:
            stem = self.name.removesuffix("_dn")
            values[f"{stem}_error{self.name.removeprefix(stem)}"] = self.error
        return values


# --- one ISO ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IsoGain:
    """What the flats of one ISO give; all that there is without bias frames.

    ``transfer`` and ``spatial`` are what the estimators found, whatever the frames are like. What of it is given, and
    with which error, are ``gain``, ``channel_gains`` and ``spatial_gain``.

    Attributes
    ----------
    iso
        ISO speed.
    sensor
        As the frames state it: CFA, size, black and white levels.
    flat_frames
        How many went into the estimates.
    transfer
        Photon transfer from pairs of flats; ``None`` without flats of this ISO, or where no line can be found.
    spatial
        The published single-frame method on the same flats, for comparison; ``None`` where it is not available.
    remarks
        What else a person should know before believing these figures.
    findings
        Which assumptions the frames do not keep, and what becomes of the figures that rest on them.
    stated_gain_dn_per_e
        K, where somebody states it; it counts only where none is measured.
    step_dn
        By how many DN the values of the frames step; 0 if they do not show it.
    """

    iso: float
    sensor: Sensor
    flat_frames: int = 0
    transfer: PhotonTransfer | None = None
    spatial: PhotonTransfer | None = None
    remarks: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    stated_gain_dn_per_e: float | None = None
    step_dn: int = 1

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the CFA's channels."""
        return ("R", "G1", "B", "G2") if len(self.sensor.black_level_dn) == 4 else ("R", "G", "B")

    @property
    def withheld(self) -> frozenset[Quantity]:
        """What is not given, since an assumption that it rests on does not hold."""
        return self._touched("withheld")

    @property
    def widened(self) -> frozenset[Quantity]:
        """What is given with an error made larger, since an assumption holds only nearly."""
        return self._touched("wider") - self.withheld

    def _touched(self, effect: Effect) -> frozenset[Quantity]:
        return frozenset(quantity for one in self.findings if one.effect == effect for quantity in one.figures)

    def why(self, *quantities: Quantity, effect: Effect = "withheld") -> str:
        """Return in words why figures are not given, or have a larger error; empty if it is not so."""
        findings = (one for one in self.findings if one.effect == effect and {*quantities} & {*one.figures})
        return "; ".join(dict.fromkeys(one.text for one in findings))

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """Every remark, those of the findings first."""
        return (*(one.remark for one in self.findings), *self.remarks)

    def judge(self, quantity: Quantity, figure: Figure, scale: float | None = None) -> Figure:
        """Return a figure with what findings add to its error, each a share of ``scale``, or without a value.

        Parameters
        ----------
        quantity
            What the figure is withheld with.
        figure
            As it was measured.
        scale
            The figure itself by default.
        """
        if why := self.why(quantity):
            return replace(figure, value=math.nan, error=math.nan, why_withheld=why)
        scale = figure.value if scale is None else scale
        shares = (one.allowance for one in self.findings if quantity in one.figures and one.effect == "wider")
        return replace(figure, error=math.hypot(figure.error, *(share * scale for share in shares)))

    def _gain_of(self, measured: Any) -> Figure | None:
        """Return K [DN/e-] of what an estimator measured, if anything; ``None`` if it is withheld."""
        if measured is None:
            return None
        return _known(self.judge("gain", Figure(*_GAIN, measured.gain_dn_per_e, measured.gain_error, "DN/e-")))

    @property
    def gain(self) -> Figure | None:
        """System gain K [DN/e-], measured or else stated; ``None`` if it is not known, or withheld.

        Wei et al., TPAMI 2021, section 3.2.1, equation 11; EMVA 1288 release 4.0, section 6.6.
        """
        measured = self._gain_of(self.transfer)
        if measured is None and self.stated_gain_dn_per_e is not None:
            return Figure(*_GAIN, self.stated_gain_dn_per_e, unit="DN/e-", is_stated=True)
        return measured

    @property
    def gain_dn_per_e(self) -> float | None:
        """System gain K; ``None`` if it is not known, or withheld."""
        return None if self.gain is None else self.gain.value

    @property
    def channel_gains(self) -> tuple[Figure, ...] | None:
        """K by CFA channel [DN/e-]."""
        gains = map(self._gain_of, () if self.transfer is None else self.transfer.channels)
        return tuple(gain for gain in gains if gain is not None) or None

    @property
    def spatial_gain(self) -> Figure | None:
        """K by the published single-frame method [DN/e-], for comparison."""
        return self._gain_of(self.spatial)

    @property
    def gain_text(self) -> str:
        """K with its error as tables show it: "-" if it was never measured, "withheld" if that is not given."""
        if self.gain is None:
            return "withheld" if "gain" in self.withheld else "-"
        return self.gain.text

    def as_dict(self) -> dict[str, Any]:
        """Return every figure with its standard error as JSON types; ``None``: withheld, or not finite."""
        gain, channel_gains, spatial = self.gain, self.channel_gains, self.spatial_gain
        data = {
            "iso": self.iso,
            "black_level_dn": self.sensor.black_level_dn,
            "white_level_dn": self.sensor.white_level_dn,
            "flat_frames": self.flat_frames,
            "gain_dn_per_e": None if gain is None else gain.value,
            "gain_error": None if gain is None else gain.error,
            "gain_is_stated": gain is not None and gain.is_stated,
            "gain_by_channel": None if channel_gains is None else [channel.value for channel in channel_gains],
            "gain_spatial_dn_per_e": None if spatial is None else spatial.value,
            "withheld": {quantity: self.why(quantity) for quantity in SYMBOLS if quantity in self.withheld},
            "findings": [asdict(finding) for finding in self.findings],
            "remarks": list(self.all_remarks),
        }
        return {name: _without_infinities(value) for name, value in data.items()}


_GAIN = ("gain_dn_per_e", "K")


def _known(figure: Figure) -> Figure | None:
    return None if math.isnan(figure.value) else figure


def _without_infinities(value: Any) -> Any:
    """Return dictionaries and lists with ``None`` for numbers that are not finite."""
    if isinstance(value, dict):
        return {name: _without_infinities(item) for name, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_without_infinities(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IsoCalibration(IsoGain):
    """All that was measured at one ISO.

    ``bias``, ``rows`` and ``read``, like ``transfer``, are what the estimators found. What of it is given are
    ``figures`` and ``colour_bias``.

    Attributes
    ----------
    bias_frames
        How many went into the estimates.
    bias, rows
        Colour bias, row (and column) noise.
    read, plot
        Read noise, and quantiles of the residuals for the probability plots; ``None`` where values end at a floor.
    pattern
        What stays from frame to frame.
    single_frame
        R^2 as the paper takes it, against Tukey lambda and normal, and lambda; ``None`` if it was not.
    spectrum_dn2
        (256, 256) power spectrum of a bias frame less its channels' means, zero frequency in the centre, averaged over
        tiles of 256 x 256 pixels; white noise of variance s^2 gives s^2 throughout.
    reproduction
        The noise model with these parameters against a bias frame that no estimator saw; ``None`` if there were too
        few frames to hold one out, or one of the parameters is withheld.
    stepped
        The read noise that is left beside rounding to ``step_dn``; ``None`` at 1 DN, or where the one is not told from
        the other.
    quantisation_step_dn
        The rounding that ``read`` is left beside: to 1 DN, or to ``step_dn``.
    """

    bias_frames: int
    bias: ColourBias
    rows: RowNoise
    read: ReadNoise | None
    plot: ProbabilityPlot | None
    pattern: PatternSummary
    spectrum_dn2: Plane = field(repr=False)
    reproduction: Reproduction | None = None
    single_frame: tuple[float, float, float] | None = None
    stepped: ReadNoise | None = None
    quantisation_step_dn: float = 1.0

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of the dark by name, in the order of JSON; one that is withheld says why.

        Of the read noise (Wei et al., TPAMI 2021, section 3.2.1, figure 7), as published beside it, and of the row
        noise (figures 5 and 6). Where values end at a floor, there is no read noise.
        """
        read, rows, columns, single = self.read, self.rows.rows, self.rows.columns, self.single_frame

        def of_read(name: str) -> float:
            return math.nan if read is None else float(getattr(read, name))

        shape = Figure("tukey_lambda", "lambda", of_read("tukey_lambda"), of_read("tukey_lambda_error"))
        scale = Figure("sigma_tl_dn", "sigma_TL", of_read("sigma_tl_dn"), of_read("sigma_tl_error_dn"), "DN")
        gauss = Figure("sigma_gauss_dn", "sigma_G", of_read("sigma_gauss_dn"), of_read("sigma_gauss_error_dn"), "DN")
        row = Figure("sigma_row_dn", "sigma_row", rows.sigma_dn, rows.sigma_error_dn, "DN")
        column = Figure("sigma_column_dn", "sigma_column", columns.sigma_dn, columns.sigma_error_dn, "DN")
        ppcc = Figure("ppcc_lambda", "lambda, PPCC", of_read("ppcc_lambda"), decimals=5)
        ppcc_scale = Figure("ppcc_sigma_tl_dn", "sigma_TL, PPCC", of_read("ppcc_sigma_tl_dn"), unit="DN", decimals=5)
        of_frame, of_normal = (math.nan, math.nan) if single is None else single[:2]
        figures = (
            self.judge("shape", shape, 1.0),
            self.judge("shape", scale),
            self.judge("read noise", gauss),
            self.judge("shape", ppcc),
            self.judge("shape", ppcc_scale),
            Figure("r_squared_tl", "R2 TL", of_read("r_squared_tl"), decimals=5),
            Figure("r_squared_gauss", "R2 G", of_read("r_squared_gauss"), decimals=5),
            Figure("single_frame_r_squared_tl", "R2 TL as published", of_frame, decimals=5),
            Figure("single_frame_r_squared_gauss", "R2 G as published", of_normal, decimals=5),
            Figure("read_chi2_per_dof", "chi2", of_read("chi2_per_dof"), decimals=5),
            self.judge("row noise", row),
            Figure("row_shapiro_p", "Shapiro-Wilk p", rows.shapiro_p, decimals=5),
            self.judge("row noise", column),
        )
        return {figure.name: figure for figure in figures}

    def given(self, name: str) -> Figure | None:
        """Return a figure of the dark; ``None`` if it is withheld."""
        return _known(self.figures[name])

    @property
    def tukey_lambda(self) -> Figure | None:
        """Shape of the read noise."""
        return self.given("tukey_lambda")

    @property
    def sigma_tl_dn(self) -> Figure | None:
        """Scale of the read noise [DN]."""
        return self.given("sigma_tl_dn")

    @property
    def sigma_gauss_dn(self) -> Figure | None:
        """Standard deviation of the read noise [DN]."""
        return self.given("sigma_gauss_dn")

    @property
    def sigma_row_dn(self) -> Figure | None:
        """Standard deviation of the row noise [DN]."""
        return self.given("sigma_row_dn")

    @property
    def sigma_column_dn(self) -> Figure | None:
        """Standard deviation of what columns have of their own [DN]; withheld with the row noise."""
        return self.given("sigma_column_dn")

    @property
    def colour_bias(self) -> tuple[Figure, ...] | None:
        """Colour bias by CFA channel [DN], section 3.2.1, figure 4; ``None`` if it is withheld."""
        pairs = zip(self.bias.bias_dn, self.bias.standard_error_dn, strict=True)
        channels = (Figure("colour_bias_dn", "colour bias", value, error, "DN") for value, error in pairs)
        figures = map(_known, (self.judge("colour bias", channel, 1.0) for channel in channels))
        return tuple(figure for figure in figures if figure is not None) or None

    @property
    def colour_bias_dn(self) -> tuple[float, float, float, float] | None:
        """Colour bias of R, G1, B, G2; X-Trans has one green, which stands for both. ``None`` if it is withheld."""
        if self.colour_bias is None:
            return None
        red, green, blue, *second = (channel.value for channel in self.colour_bias)
        return (red, green, blue, *(second or [green]))[:4]  # type: ignore[return-value] # of three or four channels

    @property
    def spectrum_lines(self) -> tuple[float, float, float]:
        """The spectrum's ground, DN^2, and the means of the rows' and of the columns' line.

        Without the frequencies next to 0, which are shading and drift in both directions.
        """
        spectrum = np.asarray(self.spectrum_dn2, dtype=np.float64)
        rows, columns = (length // 2 for length in spectrum.shape)
        far = np.abs(np.arange(len(spectrum)) - rows) > 4
        return float(np.median(spectrum)), float(spectrum[far, columns].mean()), float(spectrum[rows, far].mean())

    @property
    def parameters(self) -> NoiseParameters | None:
        """The measured parameters as the noise model takes them; ``None`` if one of those in the dark is withheld.

        A gain of 1 stands for one that is not known.
        """
        row = self.profile_row
        if row is None:
            return None
        gain = self.gain_dn_per_e or 1.0
        return replace(row, iso=None, gain_dn_per_e=gain).parameters(None, self.quantisation_step_dn)

    @property
    def profile_row(self) -> ProfileRow | None:
        """The row of a profile; ``None`` if lambda or the colour bias, which every row has, is withheld."""
        from eldata.noise.gain_modes import ProfileRow

        values = {name: figure.value for name, figure in self.figures.items() if not math.isnan(figure.value)}
        colour_bias = self.colour_bias_dn
        if colour_bias is None or not {"tukey_lambda", "sigma_tl_dn", "sigma_gauss_dn"} <= values.keys():
            return None
        frames = [(*of_one, of_one[1])[:4] for of_one in self.bias.frame_bias_dn.round(_FRAME_DECIMALS).tolist()]
        names = "sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn", "r_squared_tl", "r_squared_gauss"
        return ProfileRow(
            tukey_lambda=values["tukey_lambda"],
            colour_bias_dn=colour_bias,
            iso=self.iso,
            gain_dn_per_e=self.gain_dn_per_e,
            frame_bias_dn=tuple(frames),
            **{name: values.get(name) for name in names},
        )

    def as_dict(self) -> dict[str, Any]:
        """Return every figure with its standard error as JSON types; ``None``: withheld, or not finite."""
        bias = self.colour_bias
        data = {**IsoGain.as_dict(self), "bias_frames": self.bias_frames}
        for figure in self.figures.values():
            data |= figure.as_dict()
        data |= {
            "colour_bias_dn": None if bias is None else [channel.value for channel in bias],
            "colour_bias_error_dn": None if bias is None else [channel.error for channel in bias],
            "dsnu_dn": self.pattern.dsnu_dn,
            "defects": self.pattern.defects,
            "reproduction": None if self.reproduction is None else self.reproduction.as_dict(),
        }
        return {name: _without_infinities(value) for name, value in data.items()}


@dataclass(frozen=True, slots=True)
class FailedIso:
    """An ISO that is left out of a calibration, and all that is wrong with its frames."""

    iso: float
    problems: tuple[Problem, ...]

    @property
    def remark(self) -> str:
        """What the calibration says of it."""
        more = f" (and {len(self.problems) - 1} more problems)" if len(self.problems) > 1 else ""
        return f"ISO {self.iso:g} was left out: {self.problems[0]}{more}"


# --- a camera ---------------------------------------------------------------------------------------------------------

SCALES = {"sigma_tl_dn": "sigma_TL", "sigma_gauss_dn": "sigma_G", "sigma_row_dn": "sigma_row"}
"""Figures that have a line over K, with their labels."""

_COLUMNS = ("tukey_lambda", *SCALES, "r_squared_tl", "r_squared_gauss")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The result of :func:`~eldata.calibration.camera.calibrate`.

    Attributes
    ----------
    camera
        The camera's name.
    isos
        One record per ISO that has bias frames, ascending.
    gains
        One record per ISO that has flats alone, ascending: K, and nothing else.
    failed
        The ISOs whose frames cannot be used, which nothing else contains.
    source
        What the figures come from, in words.
    modes
        The lines over K with their uncertainty: one set, or one for each gain mode of the camera. None if no ISO has K.
    remarks
        About the calibration as a whole.
    made_profile
        The camera's profile; ``None`` if the figures do not make one.
    no_profile
        Why they do not; empty if they do.
    """

    camera: str
    isos: tuple[IsoCalibration, ...]
    source: str
    modes: tuple[FittedMode, ...]
    remarks: tuple[str, ...]
    made_profile: CameraProfile | None
    no_profile: str = ""
    gains: tuple[IsoGain, ...] = ()
    failed: tuple[FailedIso, ...] = ()

    @property
    def tukey_lambda_fit(self) -> LogLogEstimate | None:
        """The line of sigma_TL over K; ``None`` if fewer than three ISOs can be fitted, or there are several modes.

        With too few ISOs, the profile says in a note what it holds instead.
        """
        return self._fit("sigma_tl_dn")

    @property
    def gauss_fit(self) -> LogLogEstimate | None:
        """The line of sigma_G over K; ``None`` as for ``tukey_lambda_fit``."""
        return self._fit("sigma_gauss_dn")

    @property
    def row_fit(self) -> LogLogEstimate | None:
        """The line of sigma_row over K; ``None`` as for ``tukey_lambda_fit``."""
        return self._fit("sigma_row_dn")

    def _fit(self, scale: str) -> LogLogEstimate | None:
        return self.modes[0].estimates[scale] if len(self.modes) == 1 else None

    @property
    def all_isos(self) -> tuple[IsoGain, ...]:
        """The ISOs that have bias frames and those that have flats alone, ascending."""
        return tuple(sorted((*self.isos, *self.gains), key=lambda one: one.iso))

    @property
    def accepted(self) -> tuple[str, ...]:
        """The figures that a check would withhold and somebody has accepted, by check, with their ISOs."""
        isos: dict[str, list[str]] = {}
        for one in self.all_isos:
            for finding in one.findings:
                if finding.is_accepted:
                    isos.setdefault(f"{finding.check}: {list_symbols(finding.figures)}", []).append(f"{one.iso:g}")
        return tuple(f"{what} at ISO {', '.join(places)}" for what, places in isos.items())

    @property
    def problems(self) -> tuple[Problem, ...]:
        """What is wrong with the frames of the ISOs that are left out."""
        return tuple(problem for one in self.failed for problem in one.problems)

    @property
    def profile(self) -> CameraProfile:
        """The camera's profile, for :class:`~eldata.noise.model.NoiseModel`.

        Raises
        ------
        DatasetError
            If the figures do not make one: no ISO has both K and read noise. It says why.
        """
        if self.made_profile is None:
            raise DatasetError(f"{self.camera}: no profile can be made: {self.no_profile}")
        return self.made_profile

    @property
    def usual_gain_per_iso(self) -> float:
        """The median of K / ISO; nan if no gain is known."""
        return usual_gain_per_iso(self.all_isos)

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """Every remark, those of one ISO with its ISO in front."""
        of_isos = (f"ISO {one.iso:g}: {remark}" for one in self.all_isos for remark in one.all_remarks)
        return (*of_isos, *self.remarks)

    # --- as tables, text and JSON ---

    def tables(self) -> dict[str, Table]:
        """Return header and rows of the tables that have any, by name; values with standard errors, or "withheld".

        ``figures`` of the ISOs with bias frames (``9 + 1``: nine were used, one was kept out to hold the result
        against), ``gains`` of those with flats alone, ``colour-bias``, the ``fits`` over K, and ``reproduction``: how
        well the noise model reproduces the frames that were kept out.
        """
        from eldata.calibration.reproduction import HEADINGS

        gain = "K [DN/e-]"
        labels = [self.isos[0].figures[name].heading for name in _COLUMNS] if self.isos else ()
        channels = self.isos[0].channels if self.isos else ()
        figures: list[tuple[str, ...]] = [
            (
                f"{one.iso:g}",
                str(one.bias_frames) + (" + 1" if one.reproduction is not None else ""),
                str(one.flat_frames),
                one.gain_text,
                *(one.figures[name].text for name in _COLUMNS),
                str(one.pattern.defects),
            )
            for one in self.isos
        ]
        gains: list[tuple[str, ...]] = [(f"{one.iso:g}", str(one.flat_frames), one.gain_text) for one in self.gains]
        colour_bias: list[tuple[str, ...]] = []
        for one in self.isos:
            texts = ["withheld"] * len(channels) if one.colour_bias is None else [each.text for each in one.colour_bias]
            colour_bias.append((f"{one.iso:g}", *texts, f"{max(one.pattern.dsnu_dn):.2f}"))
        fits: list[tuple[str, ...]] = [
            (
                f"{label}, {one.mode}" if len(self.modes) > 1 else label,
                with_error(estimate.fit.slope, estimate.slope_error),
                with_error(estimate.fit.intercept, estimate.intercept_error),
                with_error(estimate.fit.sigma, estimate.sigma_error),
                f"{estimate.r_squared:.4f}",
            )
            for one in self.modes
            for scale, label in SCALES.items()
            if (estimate := one.estimates[scale]) is not None
        ]
        kept = [(f"{one.iso:g}", *one.reproduction.cells()) for one in self.isos if one.reproduction is not None]
        tables: dict[str, Table] = {
            "figures": (("ISO", "bias", "flat", gain, *labels, "defects"), figures),
            "gains": (("ISO", "flat", gain), gains),
            "colour-bias": (("ISO", *channels, "DSNU"), colour_bias),
            "fits": (("fit over ln K", "slope", "intercept", "sigma", "R2"), fits),
            "reproduction": (("ISO", *HEADINGS), kept),
        }
        return {name: (header, rows) for name, (header, rows) in tables.items() if rows}

    def format_text(self) -> str:
        """Return the measured figures as aligned tables, the fits, and the remarks."""
        titles = {
            "gains": "K alone, from flats without bias frames\n",
            "colour-bias": "colour bias over the recorded black level [DN]\n",
            "reproduction": "a bias frame kept out, against simulated ones\n",
        }
        parts = [
            titles.get(name, "") + text_table(header, rows, left=(0,) if name == "fits" else ())
            for name, (header, rows) in self.tables().items()
        ]
        if self.no_profile:
            parts.append(f"no profile can be made: {self.no_profile}")
        if self.accepted:
            parts.append("accepted, with larger errors\n" + "\n".join(f"  {one}" for one in self.accepted))
        if self.all_remarks:
            parts.append("remarks\n" + "\n".join(f"  {remark}" for remark in self.all_remarks))
        return "\n\n".join(parts)

    def __repr__(self) -> str:
        isos = ", ".join(f"{one.iso:g}" for one in self.all_isos)
        profile = "with a profile" if self.made_profile is not None else "no profile"
        remarks = counted(len(self.all_remarks), "remark")
        return f"Calibration({in_line(self.camera)!r}, ISO {isos or 'none'}; {profile}, {remarks})"

    def _repr_html_(self) -> str:
        tables = [table(*each) for name, each in self.tables().items() if name in {"figures", "gains"}]
        return block(f"Calibration of {self.camera}", *tables, notes=self.all_remarks)

    def as_dict(self) -> dict[str, Any]:
        """Return every figure with its standard error as plain JSON types.

        Numbers that are not finite are ``None``, and so is what is withheld; ``"withheld"`` has the reasons by figure.
        """
        fits = {f"{name}_fit": getattr(self, f"{name}_fit") for name in ("tukey_lambda", "gauss", "row")}
        return {
            "camera": self.camera,
            "isos": [one.as_dict() for one in self.isos],
            "gains": [one.as_dict() for one in self.gains],
            "failed_isos": [one.iso for one in self.failed],
            "problems": [asdict(problem) for problem in self.problems],
            "fits": {name: None if estimate is None else asdict(estimate) for name, estimate in fits.items()},
            "modes": [asdict(one) for one in self.modes] if len(self.modes) > 1 else [],
            "profile": None if self.made_profile is None else self.made_profile.as_dict(),
            "no_profile": self.no_profile or None,
            "accepted": list(self.accepted),
            "remarks": list(self.all_remarks),
        }

    # --- drawing ---

    @property
    def scale_panels(self) -> tuple[ScalePanel, ...]:
        """The scales over K that can be drawn: of the read noise by either model, and of the row noise."""
        quantities: tuple[Quantity, ...] = ("shape", "read noise", "row noise")
        panels = []
        for (scale, label), quantity in zip(SCALES.items(), quantities, strict=True):
            known = ((one.gain_dn_per_e, one.figures[scale]) for one in self.isos)
            points = tuple(
                (gain, figure.value, figure.error)
                for gain, figure in known
                if gain is not None and 0 < figure.value < math.inf
            )
            lines = ((one.mode, one.estimates[scale]) for one in self.modes)
            if points:
                drawn = tuple((mode, line) for mode, line in lines if line is not None)
                panels.append(ScalePanel(label.removeprefix("sigma_"), quantity, drawn, points))
        return tuple(panels)

    def plot(self, iso: float | None = None) -> Drawing:
        """Draw photon transfer at one ISO, K over the ISO, and the scales of the noise over K.

        Parameters
        ----------
        iso
            Whose photon transfer; by default the middle one of those that have one.

        Returns
        -------
        matplotlib.figure.Figure
            One axes for each of what was found; it belongs to no pyplot, and a notebook shows it.

        Raises
        ------
        ArgumentError
            If there is no photon transfer at the ISO, or nothing to draw at all.
        """
        from eldata.plots.axes import drawn_grid, nothing_to_draw
        from eldata.plots.gains import bar, gain_over_iso, iso_axis, scale_over_gain, transfer_lines

        transfers = {one.iso: (one.channels, one.transfer) for one in self.all_isos if one.transfer is not None}
        known = sorted(transfers)
        if iso is not None and iso not in transfers:
            listed = ", ".join(f"{one:g}" for one in known) or "none"
            raise ArgumentError(f"no photon transfer was measured at ISO {iso:g}; ISOs with one: {listed}")
        draws: list[tuple[str, Callable[[Axes, Theme], object]]] = []
        if known:
            chosen = known[len(known) // 2] if iso is None else iso
            names, transfer = transfers[chosen]

            def draw_transfer(axes: Axes, theme: Theme) -> None:
                transfer_lines(axes, None, names, transfer.channels, theme)
                axes.set_xlabel("signal [DN]")

            draws.append((f"photon transfer, ISO {chosen:g}", draw_transfer))
        gains = [(one.iso, one.gain.value, one.gain.error) for one in self.all_isos if one.gain is not None]
        if gains:

            def draw_gains(axes: Axes, theme: Theme) -> None:
                known, values, errors = zip(*gains, strict=True)
                usual = self.usual_gain_per_iso
                gain_over_iso(axes, known, values, [bar(error) for error in errors], usual, theme)
                iso_axis(axes, known)

            draws.append(("system gain", draw_gains))
        for panel in self.scale_panels:

            def draw_scales(axes: Axes, theme: Theme, panel: ScalePanel = panel) -> None:
                spans = [(line.fit, low, high) for line, low, high in panel.spans]
                scale_over_gain(axes, panel.name, spans, panel.points, theme)

            draws.append(("row noise" if panel.name == "row" else f"read noise, {panel.name}", draw_scales))
        if not draws:
            raise nothing_to_draw(f"the calibration of {self.camera}", "no ISO has flats or both K and bias frames")
        return drawn_grid(f"Calibration of {self.camera}", draws)


@dataclass(frozen=True, slots=True)
class ScalePanel:
    """The scale of one component over K.

    Attributes
    ----------
    name, quantity
        Index of its sigma, and what it is withheld with.
    lines
        The fitted ones, with their gain modes.
    points
        K, scale and its standard error where both are given and a logarithmic axis can show them; never empty.
    """

    name: str
    quantity: Quantity
    lines: tuple[tuple[GainMode, LogLogEstimate], ...]
    points: tuple[Point, ...]

    @property
    def spans(self) -> list[tuple[LogLogEstimate, float, float]]:
        """The lines, each with the lowest and the highest gain of its mode's points."""
        spans = []
        for mode, line in self.lines:
            inside = [gain for gain, _, _ in self.points if mode.distance(gain) == 0]
            spans.append((line, min(inside), max(inside)))
        return spans
