"""Virtual cameras: profiles that nobody measured, spread over the ranges of real ones.

A network that was trained on the noise of many virtual cameras needs but a few pairs of a real one, or none of its
calibration. Source of the idea: X. Jin, J.-W. Xiao, L.-H. Han, C. Guo, R. Zhang, X. Liu and C. Li, "Lighting Every
Darkness in Two Pairs: A Calibration-Free Pipeline for RAW Denoising", ICCV 2023 (LED).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal, get_args, overload

import numpy as np

from eldata.base.numbers import checked_number, checked_whole
from eldata.base.seeds import checked_seed, purpose_sequence
from eldata.errors import ArgumentError, check_choice
from eldata.noise.gain_modes import LogLogFit, ProfileRow
from eldata.noise.parameters import shape_problem
from eldata.noise.profile import CameraProfile

if TYPE_CHECKING:
    from collections.abc import Callable

Strategy = Literal["coverage", "grid", "uniform"]
Range = tuple[float, float]

# Keeps these random numbers apart from those of items (eldata/base/seeds.py), orders and workers (1 and 2).
_CAMERAS = 3


@dataclass(frozen=True, slots=True)
class FitRanges:
    """(lowest, highest) of what :class:`~eldata.noise.profile.LogLogFit` has."""

    slope: Range
    intercept: Range
    sigma: Range


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
        Of the lines of sigma_TL, of the Gaussian sigma and of sigma_row over K.
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
    tukey_lambda_fit: FitRanges
    gauss_fit: FitRanges
    row_fit: FitRanges
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
        """Return every range by its name, those of fits as ``"row_fit.slope"``."""
        found: dict[str, Any] = {}
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, FitRanges):
                found |= {f"{one.name}.{part.name}": getattr(value, part.name) for part in fields(value)}
            elif one.name not in ("source", "rows"):
                found[one.name] = value
        return found


LED_RANGES = CameraRanges(
    source="LED (Srameo/LED, options/base/noise_g/noise_g_virtual.yaml, commit ee3d372): the least and the greatest of "
    "the calibrations that the ELD authors published, one a camera",
    gain_dn_per_e=(0.1, 30.0),
    tukey_lambda_fit=FitRanges((0.462105, 0.6558756), (-0.090445, 1.5370439), (0.2392006, 0.3888189)),
    gauss_fit=FitRanges((0.5407496, 0.6771268), (0.7994101, 2.0798639), (0.2140823, 0.2675121)),
    row_fit=FitRanges((0.4482922, 0.7292221), (-1.7977103, -0.5917003), (0.2321799, 0.2942881)),
    tukey_lambda=(-0.2428571, 0.2),
    colour_bias_dn=(-1.9080039, 4.080531),
    colour_bias_spread_dn=(0.0068666, 3.0379589),
)
"""The ranges of virtual cameras that LED pre-trains with, as its authors published them."""


class VirtualCameras(Sequence[CameraProfile]):
    """Camera profiles for training without a calibrated camera: a sequence, and the same one for the same arguments.

    :class:`~eldata.datasets.synthetic.pairs.SyntheticPairs` takes it as its cameras; samples say which one by
    ``camera_id``.

    Parameters
    ----------
    n
        Number of cameras.
    ranges
        What their figures are drawn from; by default those of LED.
    strategy
        ``"coverage"``: each figure of camera i of n is drawn from the i-th of n equal shares of its range, so that
        together they cover it; cameras with large figures have all of them large. ``"grid"``: evenly spaced, the ends
        of the range included, which is what LED's code does under the name of coverage. ``"uniform"``: each figure from
        its whole range. The rows' colour biases come from their whole range always, as LED's do.
    seed
        Camera i depends on (seed, n, i) alone.

    Raises
    ------
    ArgumentError
        If an argument is out of its range; a grid has two cameras or more.

    Examples
    --------
    >>> from eldata.noise import VirtualCameras
    >>> cameras = VirtualCameras(5)
    >>> len(cameras), cameras[0].camera, cameras[0].gain_range_dn_per_e
    (5, 'virtual-1-of-5', (0.1, 30.0))
    """

    def __init__(
        self, n: int, ranges: CameraRanges = LED_RANGES, strategy: Strategy = "coverage", seed: int = 0
    ) -> None:
        check_choice("strategy", strategy, get_args(Strategy))
        if not isinstance(ranges, CameraRanges):
            raise ArgumentError(f"ranges must be a CameraRanges, such as LED_RANGES; found {ranges!r:.100}")
        self.n = checked_whole("n", n, at_least=2 if strategy == "grid" else 1)
        self.ranges = ranges
        self.strategy: Strategy = strategy
        self.seed = checked_seed(seed)

    def __len__(self) -> int:
        return self.n

    @overload
    def __getitem__(self, index: int) -> CameraProfile: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[CameraProfile, ...]: ...

    def __getitem__(self, index: int | slice) -> CameraProfile | tuple[CameraProfile, ...]:
        """Return one camera's profile, or those of a slice."""
        if isinstance(index, slice):
            return tuple(self[number] for number in range(*index.indices(self.n)))
        if not -self.n <= index < self.n:
            raise IndexError(f"camera {index} of {self.n} virtual ones")
        return self._camera(index % self.n)

    def _camera(self, number: int) -> CameraProfile:
        generator = np.random.default_rng(purpose_sequence(self.seed, number, _CAMERAS, self.n))
        place = self._places(number)
        ranges = self.ranges

        def drawn(limits: Range) -> float:
            low, high = limits
            return low + (high - low) * place(generator.random())

        def fit(of: FitRanges) -> LogLogFit:
            return LogLogFit(drawn(of.slope), drawn(of.intercept), drawn(of.sigma))

        fits = [fit(ranges.tukey_lambda_fit), fit(ranges.gauss_fit), fit(ranges.row_fit)]
        shape, spread = drawn(ranges.tukey_lambda), drawn(ranges.colour_bias_spread_dn)
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
            source=f"virtual camera {number + 1} of {self.n}, {self.strategy}, seed {self.seed}; {ranges.source}",
            gain_range_dn_per_e=(low, high),
            tukey_lambda_fit=fits[0],
            gauss_fit=fits[1],
            row_fit=fits[2],
            rows=rows,
            notes=("No such camera was measured: its figures were drawn from ranges.",),
        )

    def _places(self, number: int) -> Callable[[float], float]:
        """Return what turns a number from [0, 1) into a place in a range, from 0 to 1."""
        if self.strategy == "grid":
            return lambda _: number / (self.n - 1)
        if self.strategy == "uniform":
            return lambda u: u
        return lambda u: (number + u) / self.n

    def __repr__(self) -> str:
        return f"VirtualCameras({self.n}, strategy={self.strategy!r}, seed={self.seed}; {self.ranges.source})"
