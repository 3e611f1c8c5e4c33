"""What a calibration found at one ISO: records of figures with their errors, and why some are withheld."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.core.figures import (
    DARK_FIGURES,
    SIGMA_COLUMN,
    SIGMA_GAUSS,
    SIGMA_ROW,
    SIGMA_TL,
    TUKEY_LAMBDA,
)
from eldata.calibration.core.findings import (
    COARSE,
    FIT,
    ROUNDING,
    SHAPE,
    SYMBOLS,
    GivenFigure,
    given,
    named,
    withheld,
)
from eldata.calibration.core.read_noise import read_noise_findings

if TYPE_CHECKING:
    from collections.abc import Iterable

    from eldata.calibration.core._frames import Plane
    from eldata.calibration.core.defects import PatternSummary
    from eldata.calibration.core.findings import Effect, Figure, Finding
    from eldata.calibration.core.photon_transfer import PhotonTransfer
    from eldata.calibration.core.read_noise import ProbabilityPlot, ReadNoise
    from eldata.calibration.core.row_noise import ColourBias, RowNoise
    from eldata.calibration.core.single_frame import SingleFramePlot
    from eldata.calibration.reproduction import Reproduction
    from eldata.manifest.verify_report import Problem
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import ProfileRow
    from eldata.records import Sensor

_FRAME_DECIMALS = 4  # of a DN: a mean of three million pixels of 1 DN is not known better than to 0.0006


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
    def withheld(self) -> frozenset[Figure]:
        """The figures that are not given, since an assumption that they rest on does not hold."""
        return withheld(self.findings)

    @property
    def widened(self) -> frozenset[Figure]:
        """The figures that are given with an error made larger, since an assumption holds only nearly."""
        wider = (figure for one in self.findings if one.effect == "wider" for figure in one.figures)
        return frozenset(wider) - self.withheld

    @property
    def withheld_and_widened(self) -> tuple[str, str]:
        """The symbols of both kinds of figures."""
        return named(self.withheld), named(self.widened)

    def why(self, *figures: Figure, effect: Effect = "withheld") -> str:
        """Return in words why figures are not given, or have a larger error; empty if it is not so."""
        texts = (one.text for one in self.findings if one.effect == effect and not {*figures}.isdisjoint(one.figures))
        return "; ".join(dict.fromkeys(texts))

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """Every remark, those of the findings first."""
        return (*(one.remark for one in self.findings), *self.remarks)

    @property
    def gain(self) -> GivenFigure | None:
        """System gain K [DN/e-], measured or else stated; ``None`` if it is not known, or withheld."""
        measured = None
        if self.transfer is not None:
            measured = self._of_gain(self.transfer.gain_dn_per_e, self.transfer.gain_error)
        if measured is None and self.stated_gain_dn_per_e is not None:
            return GivenFigure(self.stated_gain_dn_per_e, math.nan, is_stated=True)
        return measured

    @property
    def gain_dn_per_e(self) -> float | None:
        """System gain K; ``None`` if it is not known, or withheld."""
        return None if self.gain is None else self.gain.value

    @property
    def channel_gains(self) -> tuple[GivenFigure, ...] | None:
        """K by CFA channel [DN/e-]."""
        lines = () if self.transfer is None else self.transfer.channels
        found = [self._of_gain(line.gain_dn_per_e, line.gain_error) for line in lines]
        return tuple(one for one in found if one is not None) or None

    @property
    def spatial_gain(self) -> GivenFigure | None:
        """K by the published single-frame method [DN/e-], for comparison."""
        return None if self.spatial is None else self._of_gain(self.spatial.gain_dn_per_e, self.spatial.gain_error)

    def _of_gain(self, value: float, error: float) -> GivenFigure | None:
        return given(self.findings, "gain", value, error, value)

    @property
    def gain_text(self) -> str:
        """K with its error as tables show it: "-" if it was never measured, "withheld" if that is not given."""
        if self.gain is None:
            return "withheld" if "gain" in self.withheld else "-"
        return self.gain.text

    def as_dict(self) -> dict[str, Any]:
        """Return every figure with its standard error as JSON types; ``None``: withheld, or not finite."""
        channel_gains = self.channel_gains
        found = {
            "iso": self.iso,
            "black_level_dn": self.sensor.black_level_dn,
            "white_level_dn": self.sensor.white_level_dn,
            "flat_frames": self.flat_frames,
            "gain_dn_per_e": self.gain_dn_per_e,
            "gain_error": None if self.gain is None else self.gain.error,
            "gain_is_stated": self.gain is not None and self.gain.is_stated,
            "gain_by_channel": None if channel_gains is None else [channel.value for channel in channel_gains],
            "gain_spatial_dn_per_e": None if self.spatial_gain is None else self.spatial_gain.value,
            "withheld": {figure: self.why(figure) for figure in SYMBOLS if figure in self.withheld},
            "findings": [asdict(finding) for finding in self.findings],
            "remarks": list(self.all_remarks),
        }
        return {name: without_infinities(value) for name, value in found.items()}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IsoCalibration(IsoGain):
    """All that was measured at one ISO.

    ``bias``, ``rows`` and ``read``, like ``transfer``, are what the estimators found. What of it is given are
    ``tukey_lambda``, ``sigma_tl_dn``, ``sigma_gauss_dn``, ``sigma_row_dn`` and ``colour_bias``: tables, JSON, profile
    and page take the figures from there.

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
        R^2 as the paper takes it; ``None`` if it was not.
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
    tukey_lambda, sigma_tl_dn, sigma_gauss_dn
        Shape, scale and standard deviation of the read noise; ``None`` if it is withheld.
    sigma_row_dn, sigma_column_dn
        Standard deviations of the row noise, and of what columns have of their own; ``None`` if row noise is withheld.
    """

    bias_frames: int
    bias: ColourBias
    rows: RowNoise
    read: ReadNoise | None
    plot: ProbabilityPlot | None
    pattern: PatternSummary
    spectrum_dn2: Plane = field(repr=False)
    reproduction: Reproduction | None = None
    single_frame: SingleFramePlot | None = None
    stepped: ReadNoise | None = None
    quantisation_step_dn: float = 1.0

    tukey_lambda = TUKEY_LAMBDA
    sigma_tl_dn = SIGMA_TL
    sigma_gauss_dn = SIGMA_GAUSS
    sigma_row_dn = SIGMA_ROW
    sigma_column_dn = SIGMA_COLUMN

    @property
    def colour_bias(self) -> tuple[GivenFigure, ...] | None:
        """Colour bias by CFA channel [DN]; ``None`` if it is withheld."""
        found = [
            given(self.findings, "colour bias", value, error, 1.0)
            for value, error in zip(self.bias.bias_dn, self.bias.standard_error_dn, strict=True)
        ]
        return tuple(one for one in found if one is not None) or None

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
    def colour_bias_dn(self) -> tuple[float, float, float, float] | None:
        """Colour bias of R, G1, B, G2; X-Trans has one green, which stands for both. ``None`` if it is withheld."""
        if self.colour_bias is None:
            return None
        bias = [channel.value for channel in self.colour_bias]
        return (bias[0], bias[1], bias[2], bias[3] if len(bias) == 4 else bias[1])

    @property
    def in_steps(self) -> IsoCalibration:
        """The ISO with the read noise that is left beside rounding to its step; as it is, where that is not known."""
        if self.stepped is None:
            return self
        text = f"the values step by {self.step_dn} DN: fewer bits than the file has room for; the read noise is without"
        seen = COARSE.seen(self.step_dn, 1.0, f"{text} that rounding, which is component U's (quantisation_step_dn)")
        of_steps = read_noise_findings(self.stepped, self.bias, self.rows.rows, self.step_dn, self.step_dn)
        others = (one for one in self.findings if one.check not in {COARSE.name, FIT.name, SHAPE.name, ROUNDING.name})
        findings = (*others, *of_steps, seen)
        return replace(self, read=self.stepped, findings=findings, quantisation_step_dn=float(self.step_dn))

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
        from eldata.noise.profile import ProfileRow

        shape, scale, gauss, row = self.tukey_lambda, self.sigma_tl_dn, self.sigma_gauss_dn, self.sigma_row_dn
        if shape is None or scale is None or gauss is None or self.colour_bias_dn is None:
            return None
        frames = [(*of_one, of_one[1])[:4] for of_one in self.bias.frame_bias_dn.round(_FRAME_DECIMALS).tolist()]
        return ProfileRow(
            tukey_lambda=shape.value,
            colour_bias_dn=self.colour_bias_dn,
            iso=self.iso,
            gain_dn_per_e=self.gain_dn_per_e,
            sigma_tl_dn=scale.value,
            sigma_gauss_dn=gauss.value,
            sigma_row_dn=None if row is None else row.value,
            r_squared_tl=None if self.read is None else self.read.r_squared_tl,
            r_squared_gauss=None if self.read is None else self.read.r_squared_gauss,
            frame_bias_dn=tuple(frames),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return every figure with its standard error as JSON types; ``None``: withheld, or not finite."""
        bias = self.colour_bias
        found = {**IsoGain.as_dict(self), "bias_frames": self.bias_frames}
        for figure in DARK_FIGURES.values():
            found |= figure.as_dict(self)
        found |= {
            "colour_bias_dn": None if bias is None else [channel.value for channel in bias],
            "colour_bias_error_dn": None if bias is None else [channel.error for channel in bias],
            "dsnu_dn": self.pattern.dsnu_dn,
            "defects": self.pattern.defects,
            "reproduction": None if self.reproduction is None else self.reproduction.as_dict(),
        }
        return {name: without_infinities(value) for name, value in found.items()}


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


def usual_gain_per_iso(isos: Iterable[IsoGain]) -> float:
    """Return the median of K / ISO, DN per electron at ISO 1; nan if no gain is known."""
    ratios = [one.gain_dn_per_e / one.iso for one in isos if one.gain_dn_per_e is not None]
    return float(np.median(ratios)) if ratios else math.nan


def without_infinities(value: Any) -> Any:
    """Return dictionaries and lists with ``None`` for numbers that are not finite."""
    if isinstance(value, dict):
        return {name: without_infinities(item) for name, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [without_infinities(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
