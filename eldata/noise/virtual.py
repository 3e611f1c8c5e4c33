"""Virtual cameras: profiles that nobody measured, spread over the ranges of real ones.

A network that was trained on the noise of many virtual cameras needs but a few pairs of a real one, or none of its
calibration. Source of the idea: X. Jin, J.-W. Xiao, L.-H. Han, C. Guo, R. Zhang, X. Liu and C. Li, "Lighting Every
Darkness in Two Pairs: A Calibration-Free Pipeline for RAW Denoising", ICCV 2023 (LED).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass
from typing import Any, overload

import numpy as np

from eldata.base.numbers import checked_number, checked_whole
from eldata.base.seeds import checked_seed, purpose_sequence
from eldata.errors import ArgumentError
from eldata.noise.parameters import shape_problem
from eldata.noise.profile import CameraProfile, LogLogFit, ProfileRow

Range = tuple[float, float]
Lines = tuple[LogLogFit, LogLogFit]

# Keeps these random numbers apart from those of items (eldata/base/seeds.py), orders and workers (1 and 2).
_CAMERAS = 3


@dataclass(frozen=True, slots=True)
class CameraRanges:
    """What virtual cameras are drawn from, each as (lowest, highest).

    Attributes
    ----------
    source
        Where the ranges come from.
    gain_dn_per_e
        The system gains K of every camera.
    tukey_lambda_fit, gauss_fit, row_fit
        Of the lines of sigma_TL, of the Gaussian sigma and of sigma_row over K: their lowest slope, intercept and
        sigma, and their highest.
    tukey_lambda
        Shape of the read noise, one a camera.
    colour_bias_dn
        Of the mean over the channels of a row's colour bias. Each row of each camera has its own.
    colour_bias_spread_dn
        Of the standard deviation of the channels around it, one a camera.
    rows
        Colour biases per camera, for shares of the gain that are equal in K.

    Raises
    ------
    ArgumentError
        If a range is not two numbers, the lower first, or lies outside of what a profile may have.
    """

    source: str
    gain_dn_per_e: Range
    tukey_lambda_fit: Lines
    gauss_fit: Lines
    row_fit: Lines
    tukey_lambda: Range
    colour_bias_dn: Range
    colour_bias_spread_dn: Range
    rows: int = 16

    def __post_init__(self) -> None:
        for name, limits in self.named().items():
            if not isinstance(limits, (tuple, list)) or len(limits) != 2:
                raise ArgumentError(f"{name} must be the lowest and the highest; found {limits!r:.100}")
            low, high = (checked_number(name, limit) for limit in limits)
            if low > high:
                raise ArgumentError(f"{name} must be the lowest, then the highest; found {limits!r:.100}")
            if low < 0 and name.endswith(("sigma", "spread_dn")):
                raise ArgumentError(f"{name} must not be negative; found {limits!r:.100}")
        checked_number("gain_dn_per_e", self.gain_dn_per_e[0], above=0)
        for limit in self.tukey_lambda:
            if (problem := shape_problem(limit)) is not None:
                raise ArgumentError(f"tukey_lambda must lie {problem}; found {limit!r:.100}")
        checked_whole("rows", self.rows, at_least=1)

    def named(self) -> dict[str, Any]:
        """Return every range by its name, the ranges of lines as ``"row_fit.slope"``."""
        ranges: dict[str, Any] = {
            name: getattr(self, name)
            for name in ("gain_dn_per_e", "tukey_lambda", "colour_bias_dn", "colour_bias_spread_dn")
        }
        for name in ("tukey_lambda_fit", "gauss_fit", "row_fit"):
            low, high = map(asdict, getattr(self, name))
            ranges |= {f"{name}.{part}": (low[part], high[part]) for part in low}
        return ranges


LED_RANGES = CameraRanges(
    source="LED (Srameo/LED, options/base/noise_g/noise_g_virtual.yaml, commit ee3d372): the least and the greatest of "
    "the calibrations that the ELD authors published, one a camera",
    gain_dn_per_e=(0.1, 30.0),
    tukey_lambda_fit=(LogLogFit(0.462105, -0.090445, 0.2392006), LogLogFit(0.6558756, 1.5370439, 0.3888189)),
    gauss_fit=(LogLogFit(0.5407496, 0.7994101, 0.2140823), LogLogFit(0.6771268, 2.0798639, 0.2675121)),
    row_fit=(LogLogFit(0.4482922, -1.7977103, 0.2321799), LogLogFit(0.7292221, -0.5917003, 0.2942881)),
    tukey_lambda=(-0.2428571, 0.2),
    colour_bias_dn=(-1.9080039, 4.080531),
    colour_bias_spread_dn=(0.0068666, 3.0379589),
)
"""The ranges of virtual cameras that LED pre-trains with, as its authors published them."""


class VirtualCameras(Sequence[CameraProfile]):
    """Camera profiles for training without a calibrated camera: a sequence, and the same one for the same arguments.

    Each figure of camera i of n is drawn from the i-th of n equal shares of its range, so that together they cover it;
    cameras with large figures have all of them large. The rows' colour biases come from their whole range.

    :class:`~eldata.datasets.synthetic.pairs.SyntheticPairs` takes it as its cameras; samples say which one by
    ``camera_id``.

    Parameters
    ----------
    n
        Number of cameras.
    ranges
        What their figures are drawn from; by default LED's.
    seed
        Camera i depends on (seed, n, i) alone.

    Raises
    ------
    ArgumentError
        If an argument is out of its range.

    Examples
    --------
    >>> from eldata.noise import VirtualCameras
    >>> cameras = VirtualCameras(5)
    >>> len(cameras), cameras[0].camera, cameras[0].gain_range_dn_per_e
    (5, 'virtual-1-of-5', (0.1, 30.0))
    """

    def __init__(self, n: int, ranges: CameraRanges = LED_RANGES, seed: int = 0) -> None:
        if not isinstance(ranges, CameraRanges):
            raise ArgumentError(f"ranges must be a CameraRanges, such as LED_RANGES; found {ranges!r:.100}")
        self.n = checked_whole("n", n, at_least=1)
        self.ranges = ranges
        self.seed = checked_seed(seed)

    def __len__(self) -> int:
        return self.n

    @overload
    def __getitem__(self, index: int) -> CameraProfile: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[CameraProfile, ...]: ...

    def __getitem__(self, index: int | slice) -> CameraProfile | tuple[CameraProfile, ...]:
        """Return one camera's profile, or the profiles of a slice."""
        if isinstance(index, slice):
            return tuple(self[number] for number in range(*index.indices(self.n)))
        if not -self.n <= index < self.n:
            raise IndexError(f"camera {index} of {self.n} virtual ones")
        return self._draw_camera(index % self.n)

    def _draw_camera(self, number: int) -> CameraProfile:
        """Draw the profile of one camera, by its number."""
        generator = np.random.default_rng(purpose_sequence(self.seed, number, _CAMERAS, self.n))
        ranges = self.ranges

        def draw(low: float, high: float) -> float:
            """Draw a number from the camera's share of a range: one of n equal parts."""
            return low + (high - low) * ((number + generator.random()) / self.n)

        def draw_line(lines: Lines) -> LogLogFit:
            """Draw slope, intercept and residual deviation of a line."""
            return LogLogFit(*(draw(low, high) for low, high in zip(*map(astuple, lines), strict=True)))

        fits = [draw_line(lines) for lines in (ranges.tukey_lambda_fit, ranges.gauss_fit, ranges.row_fit)]
        shape, spread = draw(*ranges.tukey_lambda), draw(*ranges.colour_bias_spread_dn)
        means = generator.uniform(*ranges.colour_bias_dn, ranges.rows)
        biases = means[:, None] + spread * generator.standard_normal((ranges.rows, 4))
        low, high = ranges.gain_dn_per_e
        gains = low + (high - low) * (np.arange(ranges.rows) + 0.5) / ranges.rows
        rows = tuple(
            ProfileRow(shape, (red, green, blue, second_green), gain_dn_per_e=gain)
            for (red, green, blue, second_green), gain in zip(biases.tolist(), gains.tolist(), strict=True)
        )
        return CameraProfile(
            camera=f"virtual-{number + 1}-of-{self.n}",
            source=f"virtual camera {number + 1} of {self.n}, seed {self.seed}; {ranges.source}",
            gain_range_dn_per_e=(low, high),
            tukey_lambda_fit=fits[0],
            gauss_fit=fits[1],
            row_fit=fits[2],
            rows=rows,
            notes=("No such camera was measured: its figures were drawn from ranges.",),
        )

    def __repr__(self) -> str:
        return f"VirtualCameras({self.n}, seed={self.seed}; {self.ranges.source})"
