"""What a calibration found at one ISO: one record for each figure, with its error, and the findings that withhold it.

A figure is declared once, where its ISO makes its record (:attr:`IsoCalibration.figures`); profile, tables, JSON, page
and plots read that record. Each check (:mod:`eldata.calibration.checks`) leaves a finding for the figures that it
touches: they are withheld, or given with a larger error. A remark touches none. What they say is in ``sentences.toml``.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from eldata.base.fields import shipped_toml
from eldata.base.numbers import replace_infinities
from eldata.base.tables import with_error
from eldata.calibration.flats import PhotonTransfer, PhotonTransferLine, channel_names
from eldata.calibration.frames import FramesError
from eldata.errors import ArgumentError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from eldata.calibration.bias_sums import ColourBias, LineNoise, RowNoise
    from eldata.calibration.defects import PatternSummary
    from eldata.calibration.held_out import Reproduction
    from eldata.calibration.residuals import ProbabilityPlot, ReadNoise
    from eldata.calibration.sums import Plane
    from eldata.manifest.verify_report import Problem
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import ProfileRow
    from eldata.records import Sensor

# --- findings ---------------------------------------------------------------------------------------------------------


SENTENCES: Final = Path(__file__).with_name("sentences.toml")


def fill_sentence(kind: str, **words: object) -> str:
    """Return a sentence by kind and name, such as ``remarks.drift``, with its words filled in."""
    group, _, name = kind.partition(".")
    sentence: str = shipped_toml(SENTENCES)[group][name]
    return sentence.format(**words)


Quantity = Literal["gain", "shape", "read noise", "row noise", "colour bias"]
"""What a calibration measures at one ISO. Shape is that of the read noise with its scale: lambda and sigma_TL."""

Quantities: TypeAlias = tuple[Quantity, ...]

SYMBOLS: Final[Mapping[Quantity, str]] = {
    "gain": "K",
    "shape": "lambda, sigma_TL",
    "read noise": "sigma_G",
    "row noise": "sigma_row",
    "colour bias": "the colour bias",
}


def list_symbols(figures: Collection[Quantity]) -> str:
    """Return the figures' symbols as a list."""
    return ", ".join(symbol for figure, symbol in SYMBOLS.items() if figure in figures)


Effect = Literal["withheld", "wider", "remark"]

CHANCE: Final = 1e-5
"""That a check of bias frames speaks without a reason."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One check of one ISO's frames that an assumption did not pass.

    Attributes
    ----------
    check
        Its name, as docs/calibration.md lists it.
    figures
        The figures that rest on the assumption; empty for a remark.
    effect
        ``"withheld"``: the figures are not given. ``"wider"``: their errors are made larger by ``allowance``.
        ``"remark"``: the figures hold, and a person should know.
    statistic, threshold
        What the check measured, and beyond what it speaks.
    text
        What was seen, and what to do about it, in a sentence or two. What becomes of the figures is added to it.
    allowance
        What is added in quadrature to the standard errors of effect ``"wider"``, as a share of the figure; of lambda as
        it is, of the colour bias in DN. Of effect ``"withheld"``: what would be, if the finding is accepted.
    is_accepted
        Whether the figures would be withheld, and are given because somebody has accepted the check.
    """

    check: str
    figures: Quantities
    effect: Effect
    statistic: float
    threshold: float
    text: str
    allowance: float = 0.0
    is_accepted: bool = False

    @property
    def is_acceptable(self) -> bool:
        """Whether withheld figures can be given with a larger error: not if they may be off by all of themselves."""
        most = math.inf if self.figures == ("colour bias",) else 1
        return self.effect == "withheld" and self.check in ACCEPTABLE and 0 < self.allowance < most

    @property
    def remark(self) -> str:
        """The text, and what becomes of the figures for it."""
        if self.effect == "remark" or not self.figures:
            return self.text
        fate = f"withheld: {list_symbols(self.figures)}"
        if self.is_acceptable:
            fate += f'; to have it all the same, with a larger error: --accept "{self.check}"'
        elif self.is_accepted:
            fate = f"accepted, with a larger error: {list_symbols(self.figures)}"
        elif self.effect == "wider":
            fate = f"errors made larger: {list_symbols(self.figures)}"
        return f"{self.text} ({fate})"


@dataclass(frozen=True, slots=True)
class Check:
    """What is looked at in the frames, and what of the figures rests on it.

    Attributes
    ----------
    name
        As docs/calibration.md lists it.
    figures
        What it withholds or gives with a larger error; empty: it only says what a person should know.
    most_allowed
        The share of a figure beyond which it is not given; up to it, its error allows for it.
    is_acceptable
        Whether a person may have what it withholds all the same: it knows how far off the figure may be.
    """

    name: str
    figures: Quantities = ()
    most_allowed: float = 0.05
    is_acceptable: bool = False

    def find(
        self, statistic: float, threshold: float, text: str, effect: Effect = "remark", figures: Quantities = (),
        allowance: float = 0.0,
    ) -> Finding:  # fmt: skip
        """Return a finding of this check; by default a remark."""
        return Finding(self.name, figures, effect, statistic, threshold, text, allowance)

    def withhold(
        self, statistic: float, threshold: float, text: str, figures: Quantities = (), allowance: float = 0.0
    ) -> Finding:
        """Return the finding that figures are withheld, by default all of this check."""
        return self.find(statistic, threshold, text, "withheld", figures or self.figures, allowance)

    def judge(
        self, statistic: float, threshold: float, text: str, shares: Mapping[Quantity, tuple[float, float]]
    ) -> Iterator[Finding]:
        """Yield the findings that follow, given the share by which each figure may be off, and its own error."""
        lost = {figure: share for figure, (share, _) in shares.items() if share > self.most_allowed}
        wider = {figure: share for figure, (share, error) in shares.items() if error < share <= self.most_allowed}
        if lost:
            yield self.withhold(statistic, threshold, text, tuple(lost), max(lost.values()))
        if wider:
            yield self.find(statistic, threshold, text, "wider", tuple(wider), max(wider.values()))
        if not lost and not wider:
            yield self.find(statistic, threshold, text)


READ: Final[Quantities] = ("shape", "read noise")
_TOO_WIDE: Final = 0.1
"""Of K: beyond it, no error says how wrong it may be."""

LIGHT: Final = Check("light", (*READ, "colour bias"), is_acceptable=True)
CORRELATED: Final = Check("correlated noise", (*READ, "row noise"), is_acceptable=True)
COARSE: Final = Check("coarse values", (*READ, "row noise", "gain"), is_acceptable=True)
NO_LINE: Final = Check("uneven flats", ("gain",), _TOO_WIDE, is_acceptable=True)
FLATS_CORRELATED: Final = Check("correlation in flats", ("gain",), _TOO_WIDE, is_acceptable=True)
SATURATION: Final = Check("saturation", ("gain",))
TRANSFER: Final = Check("photon transfer", ("gain",))
SHAPE: Final = Check("shape of the read noise", READ)
FIT: Final = Check("fit of the read noise", READ)
ROUNDING: Final = Check("rounding", (*READ, "row noise", "colour bias"))
CLIPPED: Final = Check("clipped black", (*READ, "row noise", "colour bias"))
STEP: Final = Check("a step over the ISOs")
BLACK: Final = Check("stated black", ("colour bias",))

CHECKS: Final = (
    *(LIGHT, CORRELATED, COARSE, NO_LINE, FLATS_CORRELATED, SATURATION),
    *(TRANSFER, SHAPE, FIT, ROUNDING, CLIPPED, STEP, BLACK),
)
"""Every one that there is."""

ACCEPTABLE: Final = tuple(check.name for check in CHECKS if check.is_acceptable)
"""Checks that know how far off a figure may be that they withhold: it can be accepted with that for its error."""


def check_acceptance(accept: Iterable[str]) -> tuple[str, ...]:
    """Return the names of checks to be accepted; :class:`ArgumentError` if one of them is not a check that can be."""
    names = (accept,) if isinstance(accept, str) else tuple(accept)
    for name in names:
        if name not in ACCEPTABLE:
            raise ArgumentError(
                f"{name!r} is not a check whose withheld figures can be accepted; known are "
                f"{', '.join(map(repr, ACCEPTABLE))}{did_you_mean(str(name), ACCEPTABLE)}"
            )
    return names


def accept_findings(findings: Iterable[Finding], accept: Collection[str]) -> tuple[Finding, ...]:
    """Change findings of accepted checks: figures get a larger error instead of being withheld."""
    return tuple(
        replace(one, effect="wider", is_accepted=True) if one.is_acceptable and one.check in accept else one
        for one in findings
    )


# --- figures ----------------------------------------------------------------------------------------------------------

SCALES = {"sigma_tl_dn": "sigma_TL", "sigma_gauss_dn": "sigma_G", "sigma_row_dn": "sigma_row"}
"""Figures that have a line over K, with their labels."""

_FRAME_DECIMALS = 4  # of a DN: a mean of three million pixels of 1 DN is not known better than to 0.0006


@dataclass(frozen=True, slots=True)
class MeasuredFigure:
    """A figure at one ISO.

    Attributes
    ----------
    name, label, unit
        Its key in JSON, such as ``sigma_tl_dn``; what tables call it, such as ``sigma_TL``; ``"DN"``, or none.
    value, error
        The figure and its standard error with all allowances; nan: withheld, or not known.
    decimals
        Of a figure that has no error.
    is_stated
        Whether it was not measured: somebody has said so.
    """

    name: str
    label: str
    value: float
    error: float = math.nan
    unit: str = ""
    decimals: int | None = None
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

    ``transfer`` is what the estimator found, whatever the frames are like. What of it is given, and with which error,
    are ``gain`` and ``channel_gains``.

    Attributes
    ----------
    iso
        ISO speed.
    sensor
        As the frames state it: CFA, size, black and white levels.
    flat_frames
        How many of its pairs were summed up; without ``transfer`` none of them could be used.
    transfer
        Photon transfer from pairs of flats; ``None`` without flats of this ISO, or where no line can be found.
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
    remarks: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    stated_gain_dn_per_e: float | None = None
    step_dn: int = 1

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the CFA's channels."""
        return channel_names(len(self.sensor.black_level_dn))

    @property
    def withheld(self) -> frozenset[Quantity]:
        """What is not given, since an assumption that it rests on does not hold."""
        return self._collect_figures("withheld")

    @property
    def widened(self) -> frozenset[Quantity]:
        """What is given with an error made larger, since an assumption holds only nearly."""
        return self._collect_figures("wider") - self.withheld

    def _collect_figures(self, effect: Effect) -> frozenset[Quantity]:
        """Collect the figures that findings of one effect, such as ``withheld``, concern."""
        return frozenset(quantity for one in self.findings if one.effect == effect for quantity in one.figures)

    def symbols(self, effect: Effect) -> str:
        """List the symbols of the figures that are withheld, or given with a larger error."""
        return list_symbols(self.withheld if effect == "withheld" else self.widened)

    def why(self, *quantities: Quantity, effect: Effect = "withheld") -> str:
        """Return the reasons that figures are not given, or have a larger error; empty if there are none."""
        findings = (one for one in self.findings if one.effect == effect and {*quantities} & {*one.figures})
        return "; ".join(dict.fromkeys(one.text for one in findings))

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """Every remark, from the findings first."""
        return (*(one.remark for one in self.findings), *self.remarks)

    def judge(self, quantity: Quantity, figure: MeasuredFigure, scale: float | None = None) -> MeasuredFigure:
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
        if quantity in self.withheld:
            return replace(figure, value=math.nan, error=math.nan)
        scale = figure.value if scale is None else scale
        shares = (one.allowance for one in self.findings if quantity in one.figures and one.effect == "wider")
        return replace(figure, error=math.hypot(figure.error, *(share * scale for share in shares)))

    def _judge_gain(self, measured: PhotonTransfer | PhotonTransferLine | None) -> MeasuredFigure | None:
        """Return K of an estimate, if there is one; ``None`` if it is withheld."""
        if measured is None or "gain" in self.withheld:
            return None
        return self.judge("gain", MeasuredFigure(*_GAIN, measured.gain_dn_per_e, measured.gain_error, "DN/e-"))

    @property
    def gain(self) -> MeasuredFigure | None:
        """System gain K [DN/e-], measured or else stated; ``None`` if it is not known, or withheld.

        Wei et al., TPAMI 2021, section 3.2.1, equations 9 to 11; EMVA 1288, photon transfer method.
        """
        measured = self._judge_gain(self.transfer)
        if measured is None and self.stated_gain_dn_per_e is not None:
            return MeasuredFigure(*_GAIN, self.stated_gain_dn_per_e, unit="DN/e-", is_stated=True)
        return measured

    @property
    def gain_dn_per_e(self) -> float | None:
        """System gain K; ``None`` if it is not known, or withheld."""
        return None if self.gain is None else self.gain.value

    @property
    def channel_gains(self) -> tuple[MeasuredFigure, ...] | None:
        """K by CFA channel [DN/e-]."""
        gains = map(self._judge_gain, () if self.transfer is None else self.transfer.channels)
        return tuple(filter(None, gains)) or None

    @property
    def gain_text(self) -> str:
        """K with its error as tables show it: "-" if it was never measured, "withheld" if that is not given."""
        return self.gain.text if self.gain is not None else "withheld" if "gain" in self.withheld else "-"

    def as_dict(self) -> dict[str, Any]:
        """Return every figure with its standard error as JSON types; ``None``: withheld, or not finite."""
        gain, channel_gains = self.gain, self.channel_gains
        data = {
            "iso": self.iso,
            "black_level_dn": self.sensor.black_level_dn,
            "white_level_dn": self.sensor.white_level_dn,
            "flat_frames": self.flat_frames,
            "gain_dn_per_e": None if gain is None else gain.value,
            "gain_error": None if gain is None else gain.error,
            "gain_is_stated": gain is not None and gain.is_stated,
            "gain_by_channel": None if channel_gains is None else [channel.value for channel in channel_gains],
            "withheld": {quantity: self.why(quantity) for quantity in SYMBOLS if quantity in self.withheld},
            "findings": [asdict(finding) for finding in self.findings],
            "remarks": list(self.all_remarks),
        }
        plain: dict[str, Any] = replace_infinities(data)
        return plain


_GAIN = ("gain_dn_per_e", "K")


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
    stepped: ReadNoise | None = None
    quantisation_step_dn: float = 1.0

    @property
    def figures(self) -> dict[str, MeasuredFigure]:
        """The figures of the dark by name, in the order of JSON; one that is withheld says why.

        Of the read noise (Wei et al., TPAMI 2021, section 3.2.1, figure 7) and of the row noise (figures 5 and 6).
        Where values end at a floor, there is no read noise.
        """
        read, rows, columns = self.read, self.rows.rows, self.rows.columns

        def of_read(label: str, name: str, error: str = "", **options: Any) -> MeasuredFigure:
            """Make a figure of the read noise by its field's name; nan if it is not known."""
            return MeasuredFigure(name, label, getattr(read, name, math.nan), getattr(read, error, math.nan), **options)

        def of_lines(label: str, name: str, noise: LineNoise) -> MeasuredFigure:
            """Make the figure sigma of the row or the column noise."""
            return MeasuredFigure(name, label, noise.sigma_dn, noise.sigma_error_dn, unit="DN")

        plain: dict[str, Any] = {"decimals": 5}
        figures = (
            self.judge("shape", of_read("lambda", "tukey_lambda", "tukey_lambda_error"), 1.0),
            self.judge("shape", of_read("sigma_TL", "sigma_tl_dn", "sigma_tl_error_dn", unit="DN")),
            self.judge("read noise", of_read("sigma_G", "sigma_gauss_dn", "sigma_gauss_error_dn", unit="DN")),
            self.judge("shape", of_read("lambda, PPCC", "ppcc_lambda", **plain)),
            self.judge("shape", of_read("sigma_TL, PPCC", "ppcc_sigma_tl_dn", unit="DN", **plain)),
            of_read("R2 TL", "r_squared_tl", **plain),
            of_read("R2 G", "r_squared_gauss", **plain),
            replace(of_read("chi2", "chi2_per_dof", **plain), name="read_chi2_per_dof"),
            self.judge("row noise", of_lines("sigma_row", "sigma_row_dn", rows)),
            MeasuredFigure("row_shapiro_p", "Shapiro-Wilk p", rows.shapiro_p, **plain),
            self.judge("row noise", of_lines("sigma_column", "sigma_column_dn", columns)),
        )
        return {figure.name: figure for figure in figures}

    def find_figure(self, name: str) -> MeasuredFigure | None:
        """Return a figure of the dark; ``None`` if it is withheld."""
        figure = self.figures[name]
        return None if math.isnan(figure.value) else figure

    @property
    def tukey_lambda(self) -> MeasuredFigure | None:
        """Shape of the read noise."""
        return self.find_figure("tukey_lambda")

    @property
    def sigma_tl_dn(self) -> MeasuredFigure | None:
        """Scale of the read noise [DN]."""
        return self.find_figure("sigma_tl_dn")

    @property
    def sigma_gauss_dn(self) -> MeasuredFigure | None:
        """Standard deviation of the read noise [DN]."""
        return self.find_figure("sigma_gauss_dn")

    @property
    def sigma_row_dn(self) -> MeasuredFigure | None:
        """Standard deviation of the row noise [DN]."""
        return self.find_figure("sigma_row_dn")

    @property
    def colour_bias(self) -> tuple[MeasuredFigure, ...] | None:
        """Colour bias by CFA channel [DN], section 3.2.1, figure 4; ``None`` if it is withheld."""
        if "colour bias" in self.withheld:
            return None
        pairs = zip(self.bias.bias_dn, self.bias.standard_error_dn, strict=True)
        channels = (MeasuredFigure("colour_bias_dn", "colour bias", value, error, "DN") for value, error in pairs)
        return tuple(self.judge("colour bias", channel, 1.0) for channel in channels)

    @property
    def colour_bias_dn(self) -> tuple[float, float, float, float] | None:
        """Colour bias of R, G1, B, G2; X-Trans has one green, which stands for both. ``None`` if it is withheld."""
        if self.colour_bias is None:
            return None
        values = [channel.value for channel in self.colour_bias]
        return (*values, values[1])[:4]  # type: ignore[return-value] # of three or four channels

    @property
    def spectrum_lines(self) -> tuple[float, float, float]:
        """The spectrum's ground, DN^2, and the means of the rows' and of the columns' line.

        Without the frequencies next to 0, which are shading and drift in both directions.
        """
        spectrum = np.asarray(self.spectrum_dn2, dtype=np.float64)
        middle = len(spectrum) // 2
        far = np.abs(np.arange(len(spectrum)) - middle) > 4
        return float(np.median(spectrum)), float(spectrum[far, middle].mean()), float(spectrum[middle, far].mean())

    @property
    def parameters(self) -> NoiseParameters | None:
        """The measured parameters as the noise model takes them; ``None`` if one of those in the dark is withheld.

        A gain of 1 stands for one that is not known.
        """
        if (row := self.profile_row) is None:
            return None
        row = replace(row, iso=None, gain_dn_per_e=self.gain_dn_per_e or 1.0)
        return row.parameters(None, self.quantisation_step_dn)

    @property
    def profile_row(self) -> ProfileRow | None:
        """The row of a profile; ``None`` if lambda or the colour bias, which every row has, is withheld."""
        from eldata.noise.profile import ProfileRow

        values = {name: figure.value for name, figure in self.figures.items() if not math.isnan(figure.value)}
        colour_bias = self.colour_bias_dn
        if colour_bias is None or not {"tukey_lambda", "sigma_tl_dn", "sigma_gauss_dn"} <= values.keys():
            return None
        frames = [(*bias, bias[1])[:4] for bias in self.bias.frame_bias_dn.round(_FRAME_DECIMALS).tolist()]
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
        plain: dict[str, Any] = replace_infinities(data)
        return plain


@dataclass(frozen=True, slots=True)
class FailedIso:
    """An ISO that is left out of a calibration, and all that is wrong with its frames."""

    iso: float
    problems: tuple[Problem, ...]

    @property
    def remark(self) -> str:
        """What the calibration says of it."""
        return fill_sentence("remarks.failed-iso", iso=self.iso, problems=FramesError(self.problems))
