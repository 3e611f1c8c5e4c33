"""What a calibration found: one record per ISO, the fits over all of them, the profile, and what to be wary of."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.tables import text_table, with_error
from eldata.calibration.spectrum import SpectrumLines

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from eldata.calibration.colour_bias import ColourBias
    from eldata.calibration.defects import PatternSummary
    from eldata.calibration.joint import LogLogEstimate
    from eldata.calibration.photon_transfer import PhotonTransfer
    from eldata.calibration.read_noise import ProbabilityPlot, ReadNoise
    from eldata.calibration.reproduction import Reproduction
    from eldata.calibration.row_noise import RowNoise
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import CameraProfile
    from eldata.records import Sensor


@dataclass(frozen=True, slots=True, eq=False)
class IsoCalibration:
    """All that was measured at one ISO.

    Attributes
    ----------
    iso
        ISO speed.
    sensor
        As the frames state it: CFA, size, black and white levels.
    bias_frames, flat_frames
        How many went into the estimates.
    transfer
        Photon transfer from pairs of flats; ``None`` without flats of this ISO.
    spatial
        The published single-frame method on the same flats, for comparison; ``None`` where it is not available.
    bias, rows, read
        Colour bias, row (and column) noise, read noise.
    plot
        Quantiles of the residuals for the probability plots.
    pattern
        What stays from frame to frame.
    spectrum_dn2
        (256, 256) power spectrum of a bias frame less its channels' means, zero frequency in the centre, averaged over
        tiles of 256 x 256 pixels; white noise of variance s^2 gives s^2 throughout.
    reproduction
        The noise model with these parameters against a bias frame that no estimator saw; ``None`` if there were too
        few frames to hold one out, or no gain.
    remarks
        What a person should know before believing these figures.
    """

    iso: float
    sensor: Sensor
    bias_frames: int
    flat_frames: int
    transfer: PhotonTransfer | None
    spatial: PhotonTransfer | None
    bias: ColourBias
    rows: RowNoise
    read: ReadNoise
    plot: ProbabilityPlot
    pattern: PatternSummary
    spectrum_dn2: NDArray[np.float32] = field(repr=False)
    reproduction: Reproduction | None
    remarks: tuple[str, ...]

    @property
    def spectrum_lines(self) -> SpectrumLines:
        """The rows' and the columns' line in the spectrum, and the ground that they stand out from."""
        return SpectrumLines.of(self.spectrum_dn2)

    @property
    def gain_dn_per_e(self) -> float | None:
        """System gain K; ``None`` without flats."""
        return None if self.transfer is None else self.transfer.gain_dn_per_e

    @property
    def colour_bias_dn(self) -> tuple[float, float, float, float]:
        """Colour bias of R, G1, B, G2; X-Trans has one green, which stands for both."""
        bias = self.bias.bias_dn
        return (bias[0], bias[1], bias[2], bias[3] if len(bias) == 4 else bias[1])

    @property
    def parameters(self) -> NoiseParameters:
        """The measured parameters as the noise model takes them; a gain of 1 stands for one that is not known."""
        from eldata.noise.parameters import NoiseParameters

        return NoiseParameters(
            gain_dn_per_e=self.gain_dn_per_e or 1.0,
            tukey_lambda=self.read.tukey_lambda,
            sigma_tl_dn=self.read.sigma_tl_dn,
            sigma_gauss_dn=self.read.sigma_gauss_dn,
            sigma_row_dn=self.rows.rows.sigma_dn,
            colour_bias_dn=self.colour_bias_dn,
        )


def usual_gain_per_iso(isos: Iterable[IsoCalibration]) -> float:
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
        One record per ISO, ascending.
    profile
        For :class:`~eldata.noise.model.NoiseModel`.
    tukey_lambda_fit, gauss_fit, row_fit
        The lines over K with their uncertainty; ``None`` where fewer than three ISOs can be fitted. The profile then
        says in a note what it holds instead.
    remarks
        About the calibration as a whole.
    """

    camera: str
    isos: tuple[IsoCalibration, ...]
    profile: CameraProfile
    tukey_lambda_fit: LogLogEstimate | None
    gauss_fit: LogLogEstimate | None
    row_fit: LogLogEstimate | None
    remarks: tuple[str, ...]

    @property
    def usual_gain_per_iso(self) -> float:
        """The median of K / ISO; nan if no gain is known."""
        return usual_gain_per_iso(self.isos)

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """Every remark, those of one ISO with its ISO in front."""
        return (*(f"ISO {one.iso:g}: {remark}" for one in self.isos for remark in one.remarks), *self.remarks)

    def format_text(self) -> str:
        """Return the measured figures as aligned tables, the fits, and the remarks."""
        header, rows = self.table()
        parts = [text_table(header, rows, left=())]
        header, rows = self.bias_table()
        parts.append("colour bias over the recorded black level [DN]\n" + text_table(header, rows, left=()))
        fits = self.fit_table()
        if fits:
            parts.append(text_table(("fit over ln K", "slope", "intercept", "sigma", "R2"), fits))
        header, rows = self.reproduction_table()
        if rows:
            parts.append("a bias frame kept out, against simulated ones\n" + text_table(header, rows, left=()))
        if self.all_remarks:
            parts.append("remarks\n" + "\n".join(f"  {remark}" for remark in self.all_remarks))
        return "\n\n".join(parts)

    def table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return header and rows of the figures by ISO, values with their standard errors.

        ``9 + 1`` bias frames: nine were used, one was kept out to hold the result against.
        """
        header = (
            *("ISO", "bias", "flat", "K [DN/e-]", "lambda", "sigma_TL [DN]", "sigma_G [DN]", "sigma_row [DN]"),
            *("R2 TL", "R2 G", "defects"),
        )
        rows: list[tuple[str, ...]] = []
        for one in self.isos:
            read, row = one.read, one.rows.rows
            gain = "-" if one.transfer is None else with_error(one.transfer.gain_dn_per_e, one.transfer.gain_error)
            rows.append(
                (
                    f"{one.iso:g}",
                    str(one.bias_frames) + (" + 1" if one.reproduction is not None else ""),
                    str(one.flat_frames),
                    gain,
                    with_error(read.tukey_lambda, read.tukey_lambda_error),
                    with_error(read.sigma_tl_dn, read.sigma_tl_error_dn),
                    with_error(read.sigma_gauss_dn, read.sigma_gauss_error_dn),
                    with_error(row.sigma_dn, row.sigma_error_dn),
                    f"{read.r_squared_tl:.5f}",
                    f"{read.r_squared_gauss:.5f}",
                    str(one.pattern.defects),
                )
            )
        return header, rows

    def bias_table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return header and rows of the colour bias by ISO and CFA channel."""
        rows = [
            (
                f"{one.iso:g}",
                *map(with_error, one.bias.bias_dn, one.bias.standard_error_dn),
                f"{max(one.pattern.dsnu_dn):.2f}",
            )
            for one in self.isos
        ]
        return ("ISO", *self.isos[0].bias.channels, "DSNU"), rows

    def fit_table(self) -> list[tuple[str, ...]]:
        """Return the rows of the joint fits that could be made."""
        named = (("sigma_TL", self.tukey_lambda_fit), ("sigma_G", self.gauss_fit), ("sigma_row", self.row_fit))
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
        """Return every figure with its standard error as plain JSON types; numbers that are not finite are ``None``."""
        from dataclasses import asdict

        fits = {
            "tukey_lambda_fit": self.tukey_lambda_fit,
            "gauss_fit": self.gauss_fit,
            "row_fit": self.row_fit,
        }
        return {
            "camera": self.camera,
            "isos": [_iso_dict(one) for one in self.isos],
            "fits": {name: None if estimate is None else asdict(estimate) for name, estimate in fits.items()},
            "profile": asdict(self.profile),
            "remarks": list(self.all_remarks),
        }


def _iso_dict(one: IsoCalibration) -> dict[str, Any]:
    read, rows, columns = one.read, one.rows.rows, one.rows.columns
    of_read = (
        *("tukey_lambda", "tukey_lambda_error", "sigma_tl_dn", "sigma_tl_error_dn"),
        *("sigma_gauss_dn", "sigma_gauss_error_dn", "ppcc_lambda", "ppcc_sigma_tl_dn", "r_squared_tl"),
        "r_squared_gauss",
    )
    found = {
        "iso": one.iso,
        "black_level_dn": one.sensor.black_level_dn,
        "white_level_dn": one.sensor.white_level_dn,
        "bias_frames": one.bias_frames,
        "flat_frames": one.flat_frames,
        "gain_dn_per_e": one.gain_dn_per_e,
        "gain_error": None if one.transfer is None else one.transfer.gain_error,
        "gain_by_channel": None if one.transfer is None else [line.gain_dn_per_e for line in one.transfer.channels],
        "gain_spatial_dn_per_e": None if one.spatial is None else one.spatial.gain_dn_per_e,
        **{name: getattr(read, name) for name in of_read},
        "read_chi2_per_dof": read.chi2_per_dof,
        "read_is_reliable": read.is_reliable,
        "sigma_row_dn": rows.sigma_dn,
        "sigma_row_error_dn": rows.sigma_error_dn,
        "row_shapiro_p": rows.shapiro_p,
        "sigma_column_dn": columns.sigma_dn,
        "sigma_column_error_dn": columns.sigma_error_dn,
        "colour_bias_dn": one.bias.bias_dn,
        "colour_bias_error_dn": one.bias.standard_error_dn,
        "dsnu_dn": one.pattern.dsnu_dn,
        "defects": one.pattern.defects,
        "reproduction": None if one.reproduction is None else one.reproduction.as_dict(),
        "remarks": list(one.remarks),
    }
    return {name: _plain(value) for name, value in found.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
