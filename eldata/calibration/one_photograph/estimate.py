"""A camera profile of one row from one raw photograph: for phones and cameras that nobody has calibrated.

Gain and read noise come from the file's NoiseProfile where it is a DNG that has one, else from the pixels
(:mod:`eldata.calibration.one_photograph.noise_line`). One photograph does not show all that bias and flat frames do:
the shape of the read noise is taken as Gaussian, row noise and colour bias are not known and 0 in the profile, and the
sensor's fixed pattern counts as noise. The profile's notes say so.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from eldata.base.tables import one_line
from eldata.calibration.iso_results import without_infinities
from eldata.calibration.joint import NO_NOISE_DN
from eldata.errors import DatasetError, check_choice
from eldata.noise.gain_modes import LogLogFit, ProfileRow
from eldata.noise.parameters import tukey_lambda_variance
from eldata.noise.profile import CameraProfile
from eldata.raw.cfa import pack
from eldata.raw.levels import packed_black_level_dn

if TYPE_CHECKING:
    from eldata.calibration.one_photograph.noise_line import NoiseLine
    from eldata.records import RawFrame

Source = Literal["auto", "tag", "pixels"]

GAUSSIAN_SHAPE = 0.14
"""The Tukey-lambda shape nearest to the normal distribution (J. J. Filliben, Technometrics 17, 1975)."""

NOT_KNOWN = (
    f"not calibrated: read noise is taken as Gaussian (lambda {GAUSSIAN_SHAPE}); row noise and colour bias are "
    "not known and 0 here; the fixed pattern of the sensor counts as read noise"
)
"""What every profile from one photograph says of itself."""

_ROUNDING_DN2 = 1 / 12
# How far the true black lies from the recorded one, as a share of the range: the colour bias of the five published
# calibrations, mean over the channels, is 1.1 DN of 14 bits (root mean square over rows, then cameras).
_BLACK_ERROR = 7e-5
_SHOWN = 2.0  # standard errors that a figure must be above 0 by
_DISAGREE = 4.0  # standard errors


@dataclass(frozen=True, slots=True)
class NoiseFigures:
    """Gain and read noise from one source.

    Attributes
    ----------
    gain_dn_per_e, gain_error
        System gain K, DN per photoelectron, and its standard error; ``None`` where the source states none.
    variance_dn2, variance_error
        Variance without light less that of rounding, DN^2; below 0 it is not known. Its error has a part for the black
        level, which may be a DN off: that moves the variance by K.
    """

    gain_dn_per_e: float
    variance_dn2: float
    gain_error: float | None = None
    variance_error: float | None = None

    @property
    def sigma_dn(self) -> float:
        """Standard deviation of the read noise, DN; 0 where the variance is below 0."""
        return math.sqrt(max(self.variance_dn2, 0.0))

    @property
    def sigma_error(self) -> float | None:
        """Standard error of the standard deviation, DN."""
        if self.variance_error is None:
            return None
        # Of a square root: of a variance that is its own error, the half of its root.
        return self.variance_error / (2 * math.sqrt(max(self.variance_dn2, self.variance_error)))

    def format_text(self) -> str:
        """Return both on one line."""

        def with_error(value: float, error: float | None) -> str:
            return f"{value:.4g}" if error is None else f"{value:.4g} +- {error:.2g}"

        gain, sigma = with_error(self.gain_dn_per_e, self.gain_error), with_error(self.sigma_dn, self.sigma_error)
        return f"K {gain} DN/e-, read noise {sigma} DN"


@dataclass(frozen=True, slots=True)
class ImageEstimate:
    """What one photograph tells of its camera's noise.

    Attributes
    ----------
    camera, path, iso
        Make and model, the file, and its ISO if it states one.
    stated
        From the file's NoiseProfile; ``None`` without a usable one.
    measured
        From the pixels; ``None`` if they do not tell.
    line
        What was measured, in detail.
    source
        Which of the two the profile has, ``"tag"`` or ``"pixels"``; ``None`` without either.
    problems
        Why there is no profile; empty if there is one.
    remarks
        What to know of the figures.
    profile
        A profile of one row, or ``None``.
    """

    camera: str
    path: Path
    iso: float | None
    stated: NoiseFigures | None
    measured: NoiseFigures | None
    line: NoiseLine | None
    source: Literal["tag", "pixels"] | None
    problems: tuple[str, ...]
    remarks: tuple[str, ...]
    profile: CameraProfile | None

    def as_dict(self) -> dict[str, Any]:
        """Return all of it as plain values, for JSON; ``None`` for an error that is not finite."""
        content = asdict(self) | {"path": str(self.path)}
        for name in ("stated", "measured"):
            figures: NoiseFigures | None = getattr(self, name)
            if figures is not None:
                content[name] |= {"sigma_dn": figures.sigma_dn, "sigma_error": figures.sigma_error}
        if self.profile is not None:
            content["profile"] = self.profile.as_dict()
        plain: dict[str, Any] = without_infinities(content)
        return plain

    def format_text(self) -> str:
        """Return the figures, problems and remarks, a line each."""
        iso = "ISO not stated" if self.iso is None else f"ISO {self.iso:g}"
        lines = [f"{one_line(self.camera)}, {iso}"]
        if self.stated is not None:
            lines.append(f"  NoiseProfile  {self.stated.format_text()} (the file states no error)")
        if self.measured is not None and self.line is not None:
            smooth = f"{self.line.windows} smooth windows, {self.line.smooth_share:.0%}"
            lines.append(f"  pixels        {self.measured.format_text()} ({smooth})")
        lines += [f"  no profile: {problem}" for problem in self.problems]
        lines += [f"  {remark}" for remark in self.remarks]
        return "\n".join(lines)


def estimate_profile(image: RawFrame | Path | str, *, source: Source = "auto") -> ImageEstimate:
    """Estimate a camera's gain and read noise at one ISO from one photograph.

    Parameters
    ----------
    image
        A raw frame or file, as the camera wrote it. Best is a scene out of focus with dark and bright parts.
    source
        ``"tag"``: the file's NoiseProfile; ``"pixels"``: the line of variance over signal; ``"auto"``: the tag where
        the file has one, held against the pixels, else the pixels.

    Raises
    ------
    ArgumentError
        If ``source`` is another word.
    RawFileError
        If the file cannot be read.
    """
    from eldata.raw.reading import read_raw

    check_choice("source", source, get_args(Source))
    frame = read_raw(image) if isinstance(image, (Path, str)) else image
    frame.whole_dn("an estimate of noise")
    remarks: list[str] = []
    stated, of_tag = (None, "") if source == "pixels" else _stated(frame, remarks)
    line, of_pixels = (None, "") if source == "tag" else _line(frame)
    measured = None if line is None else _measured(frame, line)
    if line is not None and line.channels_differ:
        slopes = ", ".join(f"{slope:.3g}" for slope in line.channel_slopes)
        remarks.append(
            f"K of the packed channels differs by more than chance ({slopes} DN/e-): one K does not fit all of them, "
            "as where a camera amplifies its colours differently; the error has their scatter"
        )
    problems: list[str] = []
    chosen: Literal["tag", "pixels"] | None = None
    if stated is not None:
        chosen = "tag"
        if of_pixels:
            remarks.append(f"the NoiseProfile could not be checked against the pixels: {of_pixels}")
        if measured is not None:
            remarks += _disagreements(stated, measured)
    elif measured is not None:
        chosen = "pixels"
        if of_tag not in ("", _NO_TAG):
            remarks.append(of_tag)
        problems = _not_shown(measured)
    else:
        is_expected = source == "auto" and of_tag == _NO_TAG
        problems = [problem for problem in ("" if is_expected else of_tag, of_pixels) if problem]
    figures = stated if stated is not None else measured
    made = None
    if figures is not None and chosen is not None and not problems:
        made = _profile(frame, figures, chosen, remarks)
    return ImageEstimate(
        camera=_camera(frame),
        path=frame.path,
        iso=_iso(frame),
        stated=stated,
        measured=measured,
        line=line,
        source=chosen,
        problems=tuple(problems),
        remarks=tuple(remarks),
        profile=made,
    )


# --- the two sources ------------------------------------------------------------------------------------------

_NO_TAG = "the file has no NoiseProfile (tag 51041 of a DNG); estimate from the pixels"


def _range_dn(frame: RawFrame) -> float:
    return frame.sensor.white_level_dn - max(frame.sensor.black_level_dn)


def _stated(frame: RawFrame, remarks: list[str]) -> tuple[NoiseFigures | None, str]:
    """Return the figures of the file's NoiseProfile, or why there are none."""
    from eldata.raw.sensor_facts import dng_noise_profile

    numbers = dng_noise_profile(frame.path) if frame.path.is_file() else None
    if numbers is None:
        return None, _NO_TAG
    shown = ", ".join(f"{number:.4g}" for number in numbers[:8])
    if len(numbers) not in (2, 6):
        return None, f"its NoiseProfile has {len(numbers)} numbers ({shown}); expected 2, or 6 for three colours"
    slopes, offsets = np.array(numbers[::2]), np.array(numbers[1::2])
    if not (slopes.min() > 0 and slopes.max() < 1 and offsets.min() >= 0 and offsets.max() < 1):
        return (
            None,
            f"its NoiseProfile ({shown}) is not one of a camera: slopes lie between 0 and 1, offsets from 0 to 1",
        )
    if slopes.max() > 1.1 * slopes.min():
        remarks.append(
            "the NoiseProfile's slopes differ by colour, "
            f"{slopes.max() / slopes.min() - 1:.0%} at most; the profile has their mean, with green twice"
        )
    # Planes are R, G, B. Of two numbers the one pair counts for all.
    weights = np.array([1, 2, 1]) if len(slopes) == 3 else np.ones(1)
    span = _range_dn(frame)
    gain = float(np.average(slopes, weights=weights)) * span
    return NoiseFigures(gain, float(np.average(offsets, weights=weights)) * span**2 - _ROUNDING_DN2), ""


def _line(frame: RawFrame) -> tuple[NoiseLine | None, str]:
    """Return the line of the pixels' variance over their signal, or why there is none."""
    from eldata.calibration.one_photograph.noise_line import noise_line

    sensor = frame.sensor
    packed = pack(frame.mosaic, sensor.cfa)
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn).reshape(-1, 1, 1)
    usable = (packed > 0) & (packed < sensor.white_level_dn)
    try:
        return noise_line(packed.astype(np.float32) - black, usable), ""
    except DatasetError as error:
        return None, str(error)


def _measured(frame: RawFrame, line: NoiseLine) -> NoiseFigures:
    black_dn = _BLACK_ERROR * _range_dn(frame)
    return NoiseFigures(
        gain_dn_per_e=line.slope,
        variance_dn2=line.offset - _ROUNDING_DN2,
        gain_error=line.slope_error,
        variance_error=math.hypot(line.offset_error, max(line.slope, 0.0) * black_dn),
    )


def _not_shown(figures: NoiseFigures) -> list[str]:
    """Return what the pixels do not show: a figure that is not above 0 by two standard errors."""
    problems = []
    error, scatter = figures.gain_error or 0.0, figures.variance_error or 0.0
    if not figures.gain_dn_per_e > _SHOWN * error:
        problems.append(
            f"K, {figures.gain_dn_per_e:.2g} +- {error:.2g} DN/e-, is not above 0 by {_SHOWN:g} standard errors: the "
            "photograph has too little light to show it; take a brighter one, or one with bright smooth parts"
        )
    if not figures.variance_dn2 > _SHOWN * scatter:
        problems.append(
            f"the read noise's variance, {figures.variance_dn2:.2g} +- {scatter:.2g} DN^2, is not above 0 by "
            f"{_SHOWN:g} standard errors: the photograph has no dark smooth parts to show it; take one with "
            "deep shadows, or darker"
        )
    return problems


def _disagreements(stated: NoiseFigures, measured: NoiseFigures) -> list[str]:
    rows = (
        ("K", stated.gain_dn_per_e, measured.gain_dn_per_e, measured.gain_error, "DN/e-"),
        ("the read noise's variance", stated.variance_dn2, measured.variance_dn2, measured.variance_error, "DN^2"),
    )
    return [
        f"{what} of the NoiseProfile, {first:.4g} {unit}, is {abs(first - second) / error:.0f} standard errors off "
        f"what the pixels show, {second:.4g} +- {error:.2g}; --from pixels (source='pixels') takes the latter"
        for what, first, second, error, unit in rows
        if error and abs(first - second) > _DISAGREE * error
    ]


# --- the profile ----------------------------------------------------------------------------------------------


def _camera(frame: RawFrame) -> str:
    return " ".join(filter(None, (frame.sensor.make, frame.sensor.model))) or "camera not stated"


def _iso(frame: RawFrame) -> float | None:
    return None if frame.exposure.iso is None else float(frame.exposure.iso)


def _profile(
    frame: RawFrame, figures: NoiseFigures, source: Literal["tag", "pixels"], remarks: list[str]
) -> CameraProfile:
    gain, sigma, iso = figures.gain_dn_per_e, figures.sigma_dn, _iso(frame)
    if not sigma > 0:
        remarks.append("the NoiseProfile's noise without light is not above what rounding makes: the read noise is 0")
    scale = sigma / math.sqrt(tukey_lambda_variance(GAUSSIAN_SHAPE))
    found = {"tag": "its NoiseProfile", "pixels": "variance over signal of its smooth parts"}[source]
    notes = (
        f"from one photograph: {figures.format_text()}",
        NOT_KNOWN,
        *remarks,
    )
    return CameraProfile(
        camera=_camera(frame),
        source=f"{frame.path.name}: {found}",
        gain_range_dn_per_e=(gain, gain),
        tukey_lambda_fit=_constant(scale),
        gauss_fit=_constant(sigma),
        row_fit=_constant(0.0),
        rows=(
            ProfileRow(
                tukey_lambda=GAUSSIAN_SHAPE,
                colour_bias_dn=(0.0, 0.0, 0.0, 0.0),
                iso=iso,
                gain_dn_per_e=gain,
                sigma_tl_dn=scale,
                sigma_gauss_dn=sigma,
            ),
        ),
        iso_range=None if iso is None else (iso, iso),
        black_level_dn=max(frame.sensor.black_level_dn),
        white_level_dn=frame.sensor.white_level_dn,
        notes=notes,
    )


def _constant(scale_dn: float) -> LogLogFit:
    return LogLogFit(0.0, math.log(max(scale_dn, NO_NOISE_DN)), 0.0)
