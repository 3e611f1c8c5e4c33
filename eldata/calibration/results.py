"""What a calibration found: one record per ISO, the fits over all of them, the profile, and what to be wary of."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.notebook import block, table
from eldata.base.numbers import counted
from eldata.base.tables import text_table, with_error
from eldata.base.visible import in_line
from eldata.calibration.audit import SYMBOLS, GivenFigure, given, named, widened, withheld
from eldata.calibration.spectrum import SpectrumLines
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from eldata.calibration.audit import Effect, Figure, Finding
    from eldata.calibration.colour_bias import ColourBias
    from eldata.calibration.defects import PatternSummary
    from eldata.calibration.joint import FittedMode, LogLogEstimate
    from eldata.calibration.panels import ScalePanel
    from eldata.calibration.photon_transfer import PhotonTransfer
    from eldata.calibration.read_noise import ProbabilityPlot, ReadNoise
    from eldata.calibration.reproduction import Reproduction
    from eldata.calibration.row_noise import LineNoise, RowNoise
    from eldata.calibration.single_frame import SingleFramePlot
    from eldata.calibration.structure import MeasuredStructure
    from eldata.manifest.verify_report import Problem
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import CameraProfile
    from eldata.plots.axes import Drawing
    from eldata.records import Sensor


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
    """

    iso: float
    sensor: Sensor
    flat_frames: int
    transfer: PhotonTransfer | None
    spatial: PhotonTransfer | None
    remarks: tuple[str, ...]
    findings: tuple[Finding, ...] = ()
    stated_gain_dn_per_e: float | None = None

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
        return widened(self.findings)

    @property
    def withheld_and_widened(self) -> tuple[str, str]:
        """The symbols of both kinds of figures."""
        return named(self.withheld), named(self.widened)

    def why_withheld(self, figure: Figure) -> str:
        """Return in words why a figure is not given; empty if it is."""
        return self._why(figure, "withheld")

    def why_widened(self, figure: Figure) -> str:
        """Return in words why a figure is given with a larger error; empty if it is not."""
        return self._why(figure, "wider") if figure in self.widened else ""

    def _why(self, figure: Figure, effect: Effect) -> str:
        return "; ".join(one.text for one in self.findings if one.effect == effect and figure in one.figures)

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
    bias, rows, read
        Colour bias, row (and column) noise, read noise.
    plot
        Quantiles of the residuals for the probability plots.
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
    structure
        What the noise of pixels has in common; ``None`` if it was not asked for.
    """

    bias_frames: int
    bias: ColourBias
    rows: RowNoise
    read: ReadNoise
    plot: ProbabilityPlot
    pattern: PatternSummary
    spectrum_dn2: NDArray[np.float32] = field(repr=False)
    reproduction: Reproduction | None
    single_frame: SingleFramePlot | None = None
    structure: MeasuredStructure | None = None

    @property
    def tukey_lambda(self) -> GivenFigure | None:
        """Shape of the read noise; ``None`` if it is withheld."""
        return given(self.findings, "read noise", self.read.tukey_lambda, self.read.tukey_lambda_error, 1.0)

    @property
    def sigma_tl_dn(self) -> GivenFigure | None:
        """Scale of the read noise; ``None`` if it is withheld."""
        scale = self.read.sigma_tl_dn
        return given(self.findings, "read noise", scale, self.read.sigma_tl_error_dn, scale)

    @property
    def sigma_gauss_dn(self) -> GivenFigure | None:
        """Standard deviation of the read noise; ``None`` if it is withheld."""
        scale = self.read.sigma_gauss_dn
        return given(self.findings, "read noise", scale, self.read.sigma_gauss_error_dn, scale)

    @property
    def sigma_row_dn(self) -> GivenFigure | None:
        """Standard deviation of the row noise; ``None`` if it is withheld."""
        return self._of_lines(self.rows.rows)

    @property
    def sigma_column_dn(self) -> GivenFigure | None:
        """Standard deviation of what columns have of their own; ``None`` if row noise is withheld."""
        return self._of_lines(self.rows.columns)

    def _of_lines(self, lines: LineNoise) -> GivenFigure | None:
        return given(self.findings, "row noise", lines.sigma_dn, lines.sigma_error_dn, lines.sigma_dn)

    @property
    def colour_bias(self) -> tuple[GivenFigure, ...] | None:
        """Colour bias by CFA channel [DN]; ``None`` if it is withheld."""
        found = [
            given(self.findings, "colour bias", value, error, 1.0)
            for value, error in zip(self.bias.bias_dn, self.bias.standard_error_dn, strict=True)
        ]
        return tuple(one for one in found if one is not None) or None

    @property
    def spectrum_lines(self) -> SpectrumLines:
        """The rows' and the columns' line in the spectrum, and the ground that they stand out from."""
        return SpectrumLines.of(self.spectrum_dn2)

    @property
    def colour_bias_dn(self) -> tuple[float, float, float, float] | None:
        """Colour bias of R, G1, B, G2; X-Trans has one green, which stands for both. ``None`` if it is withheld."""
        if self.colour_bias is None:
            return None
        bias = [channel.value for channel in self.colour_bias]
        return (bias[0], bias[1], bias[2], bias[3] if len(bias) == 4 else bias[1])

    @property
    def parameters(self) -> NoiseParameters | None:
        """The measured parameters as the noise model takes them; ``None`` if one of those in the dark is withheld.

        A gain of 1 stands for one that is not known.
        """
        from eldata.noise.parameters import NoiseParameters

        bias, row = self.colour_bias_dn, self.sigma_row_dn
        shape, scale, gauss = self.tukey_lambda, self.sigma_tl_dn, self.sigma_gauss_dn
        if bias is None or row is None or shape is None or scale is None or gauss is None:
            return None
        return NoiseParameters(
            gain_dn_per_e=self.gain_dn_per_e or 1.0,
            tukey_lambda=shape.value,
            sigma_tl_dn=scale.value,
            sigma_gauss_dn=gauss.value,
            sigma_row_dn=row.value,
            colour_bias_dn=bias,
        )


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
        return self.modes[0].tukey_lambda_fit if len(self.modes) == 1 else None

    @property
    def gauss_fit(self) -> LogLogEstimate | None:
        """The line of sigma_G over K; ``None`` as for ``tukey_lambda_fit``."""
        return self.modes[0].gauss_fit if len(self.modes) == 1 else None

    @property
    def row_fit(self) -> LogLogEstimate | None:
        """The line of sigma_row over K; ``None`` as for ``tukey_lambda_fit``."""
        return self.modes[0].row_fit if len(self.modes) == 1 else None

    @property
    def all_isos(self) -> tuple[IsoGain, ...]:
        """The ISOs that have bias frames and those that have flats alone, ascending."""
        return tuple(sorted((*self.isos, *self.gains), key=lambda one: one.iso))

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
    def scale_panels(self) -> tuple[ScalePanel, ...]:
        """The scales over K that can be drawn: of the read noise by either model, and of the row noise."""
        from eldata.calibration.panels import scale_panel

        found = (
            scale_panel(
                "TL",
                "read noise",
                [(one, one.tukey_lambda_fit) for one in self.modes],
                [(one.gain_dn_per_e, one.sigma_tl_dn) for one in self.isos],
            ),
            scale_panel(
                "G",
                "read noise",
                [(one, one.gauss_fit) for one in self.modes],
                [(one.gain_dn_per_e, one.sigma_gauss_dn) for one in self.isos],
            ),
            scale_panel(
                "row",
                "row noise",
                [(one, one.row_fit) for one in self.modes],
                [(one.gain_dn_per_e, one.sigma_row_dn) for one in self.isos],
            ),
        )
        return tuple(panel for panel in found if panel is not None)

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
        from eldata.calibration.drawing import calibration_figure

        transfers = {one.iso: (one.channels, one.transfer) for one in self.all_isos if one.transfer is not None}
        gains = [(one.iso, one.gain.value, one.gain.error) for one in self.all_isos if one.gain is not None]
        return calibration_figure(self.camera, transfers, iso, gains, self.usual_gain_per_iso, self.scale_panels)

    def __repr__(self) -> str:
        isos = ", ".join(f"{one.iso:g}" for one in self.all_isos)
        profile = "with a profile" if self.made_profile is not None else "no profile"
        remarks = counted(len(self.all_remarks), "remark")
        return f"Calibration({in_line(self.camera)!r}, ISO {isos or 'none'}; {profile}, {remarks})"

    def _repr_html_(self) -> str:
        tables = [table(header, rows) for header, rows in (self.table(), self.gain_table()) if rows]
        return block(f"Calibration of {self.camera}", *tables, notes=self.all_remarks)

    @property
    def usual_gain_per_iso(self) -> float:
        """The median of K / ISO; nan if no gain is known."""
        return usual_gain_per_iso(self.all_isos)

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """Every remark, those of one ISO with its ISO in front."""
        of_isos = (f"ISO {one.iso:g}: {remark}" for one in self.all_isos for remark in one.all_remarks)
        return (*of_isos, *self.remarks)

    def format_text(self) -> str:
        """Return the measured figures as aligned tables, the fits, and the remarks."""
        parts = []
        for title, (header, rows) in (
            ("", self.table()),
            ("K alone, from flats without bias frames\n", self.gain_table()),
            ("colour bias over the recorded black level [DN]\n", self.bias_table()),
            ("structure of the noise, for components C, W, T and F\n", self.structure_table()),
        ):
            if rows:
                parts.append(title + text_table(header, rows, left=()))
        fits = self.fit_table()
        if fits:
            parts.append(text_table(("fit over ln K", "slope", "intercept", "sigma", "R2"), fits))
        header, rows = self.reproduction_table()
        if rows:
            parts.append("a bias frame kept out, against simulated ones\n" + text_table(header, rows, left=()))
        if self.no_profile:
            parts.append(f"no profile can be made: {self.no_profile}")
        if self.all_remarks:
            parts.append("remarks\n" + "\n".join(f"  {remark}" for remark in self.all_remarks))
        return "\n\n".join(parts)

    def table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return header and rows of the figures by ISO, values with their standard errors, or "withheld".

        ``9 + 1`` bias frames: nine were used, one was kept out to hold the result against.
        """
        header = (
            *("ISO", "bias", "flat", "K [DN/e-]", "lambda", "sigma_TL [DN]", "sigma_G [DN]", "sigma_row [DN]"),
            *("R2 TL", "R2 G", "defects"),
        )
        rows: list[tuple[str, ...]] = []
        for one in self.isos:
            figures = (one.tukey_lambda, one.sigma_tl_dn, one.sigma_gauss_dn, one.sigma_row_dn)
            rows.append(
                (
                    f"{one.iso:g}",
                    str(one.bias_frames) + (" + 1" if one.reproduction is not None else ""),
                    str(one.flat_frames),
                    one.gain_text,
                    *map(_cell, figures),
                    f"{one.read.r_squared_tl:.5f}",
                    f"{one.read.r_squared_gauss:.5f}",
                    str(one.pattern.defects),
                )
            )
        return header, rows

    def gain_table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return header and rows of K at the ISOs that have flats alone."""
        return ("ISO", "flat", "K [DN/e-]"), [
            (f"{one.iso:g}", str(one.flat_frames), one.gain_text) for one in self.gains
        ]

    def bias_table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return header and rows of the colour bias by ISO and CFA channel."""
        rows = [
            (
                f"{one.iso:g}",
                *map(_cell, one.colour_bias or (None,) * len(one.channels)),
                f"{max(one.pattern.dsnu_dn):.2f}",
            )
            for one in self.isos
        ]
        return ("ISO", *(self.isos[0].channels if self.isos else ()), "DSNU"), rows

    def structure_table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return header and rows of what the noise of pixels has in common, where it was asked for."""
        from eldata.calibration.structure import HEADER

        rows = [(f"{one.iso:g}", *one.structure.cells()) for one in self.isos if one.structure is not None]
        return ("ISO", *HEADER), rows

    def fit_table(self) -> list[tuple[str, ...]]:
        """Return the rows of the joint fits that could be made, those of each gain mode after another."""
        named = [
            (f"{name}, {one.mode}" if len(self.modes) > 1 else name, estimate)
            for one in self.modes
            for name, estimate in (
                ("sigma_TL", one.tukey_lambda_fit),
                ("sigma_G", one.gauss_fit),
                ("sigma_row", one.row_fit),
            )
        ]
        return [
            (
                name,
                with_error(estimate.fit.slope, estimate.slope_error),
                with_error(estimate.fit.intercept, estimate.intercept_error),
                with_error(estimate.fit.sigma, estimate.sigma_error),
                f"{estimate.r_squared:.4f}",
            )
            for name, estimate in named
            if estimate is not None
        ]

    def reproduction_table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return header and rows of how well the noise model reproduces the frames that were kept out."""
        header = (
            *("ISO", "R2", "histogram distance", "by chance", "sigma real", "simulated [DN]"),
            *("row sigma real", "simulated [DN]"),
        )
        rows: list[tuple[str, ...]] = [
            (
                f"{one.iso:g}",
                f"{found.r_squared:.5f}",
                f"{found.histogram_distance:.4f}",
                f"{found.histogram_distance_by_chance:.4f}",
                f"{found.sigma_real_dn:.4g}",
                f"{found.sigma_simulated_dn:.4g}",
                f"{found.row_sigma_real_dn:.3g}",
                f"{found.row_sigma_simulated_dn:.3g}",
            )
            for one in self.isos
            if (found := one.reproduction) is not None
        ]
        return header, rows

    def as_dict(self) -> dict[str, Any]:
        """Return every figure with its standard error as plain JSON types.

        Numbers that are not finite are ``None``, and so is what is withheld; ``"withheld"`` has the reasons by figure.
        """
        from dataclasses import asdict

        fits = {
            "tukey_lambda_fit": self.tukey_lambda_fit,
            "gauss_fit": self.gauss_fit,
            "row_fit": self.row_fit,
        }
        return {
            "camera": self.camera,
            "isos": [_iso_dict(one) for one in self.isos],
            "gains": [_plain(_gain_dict(one)) for one in self.gains],
            "failed_isos": [one.iso for one in self.failed],
            "problems": [asdict(problem) for problem in self.problems],
            "fits": {name: None if estimate is None else asdict(estimate) for name, estimate in fits.items()},
            "modes": [asdict(one) for one in self.modes] if len(self.modes) > 1 else [],
            "profile": None if self.made_profile is None else self.made_profile.as_dict(),
            "no_profile": self.no_profile or None,
            "remarks": list(self.all_remarks),
        }


def _cell(figure: GivenFigure | None) -> str:
    return "withheld" if figure is None else figure.text


def _with_error(name: str, figure: GivenFigure | None) -> dict[str, float | None]:
    """Return a figure and its error: ``sigma_tl_dn`` and ``sigma_tl_error_dn``."""
    stem = name.removesuffix("_dn")
    error = f"{stem}_error{name.removeprefix(stem)}"
    return {name: None if figure is None else figure.value, error: None if figure is None else figure.error}


def _gain_dict(one: IsoGain) -> dict[str, Any]:
    from dataclasses import asdict

    channel_gains = one.channel_gains
    return {
        "iso": one.iso,
        "black_level_dn": one.sensor.black_level_dn,
        "white_level_dn": one.sensor.white_level_dn,
        "flat_frames": one.flat_frames,
        "gain_dn_per_e": one.gain_dn_per_e,
        "gain_error": None if one.gain is None else one.gain.error,
        "gain_is_stated": one.gain is not None and one.gain.is_stated,
        "gain_by_channel": None if channel_gains is None else [channel.value for channel in channel_gains],
        "gain_spatial_dn_per_e": None if one.spatial_gain is None else one.spatial_gain.value,
        "withheld": {figure: one.why_withheld(figure) for figure in SYMBOLS if figure in one.withheld},
        "findings": [asdict(finding) for finding in one.findings],
        "remarks": list(one.all_remarks),
    }


def _iso_dict(one: IsoCalibration) -> dict[str, Any]:
    from dataclasses import asdict

    read, bias, single = one.read, one.colour_bias, one.single_frame
    ppcc = None if "read noise" in one.withheld else read
    found = {
        **_gain_dict(one),
        "bias_frames": one.bias_frames,
        **_with_error("tukey_lambda", one.tukey_lambda),
        **_with_error("sigma_tl_dn", one.sigma_tl_dn),
        **_with_error("sigma_gauss_dn", one.sigma_gauss_dn),
        "ppcc_lambda": None if ppcc is None else ppcc.ppcc_lambda,
        "ppcc_sigma_tl_dn": None if ppcc is None else ppcc.ppcc_sigma_tl_dn,
        "r_squared_tl": read.r_squared_tl,
        "r_squared_gauss": read.r_squared_gauss,
        "single_frame_r_squared_tl": None if single is None else single.r_squared_tl,
        "single_frame_r_squared_gauss": None if single is None else single.r_squared_gauss,
        "read_chi2_per_dof": read.chi2_per_dof,
        **_with_error("sigma_row_dn", one.sigma_row_dn),
        "row_shapiro_p": one.rows.rows.shapiro_p,
        **_with_error("sigma_column_dn", one.sigma_column_dn),
        "colour_bias_dn": None if bias is None else [channel.value for channel in bias],
        "colour_bias_error_dn": None if bias is None else [channel.error for channel in bias],
        "dsnu_dn": one.pattern.dsnu_dn,
        "defects": one.pattern.defects,
        "reproduction": None if one.reproduction is None else one.reproduction.as_dict(),
    }
    if one.structure is not None:
        found["structure"] = asdict(one.structure)
    return {name: _plain(value) for name, value in found.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
