"""Does the noise model, with what was measured, make bias frames like the camera's? Compared with one kept out.

The real frame and simulated ones go the same way: a frame less the mean of n others, over the same piece of the sensor.
For the camera the n others are those that the estimators saw, for the model n more draws. So what the mean takes off is
the same on both sides, and the camera's fixed pattern, which the model does not have, is gone. One trace of it is left:
pixels whose levels differ by fractions of a DN are rounded in different places. So the simulated pixels are given the
camera's shading, and levels that scatter around it as much as the camera's (DSNU), or quiet noise would be taken for
another for its ripples alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.sums import Counts, Mosaic, Plane, Values, by_pixel

if TYPE_CHECKING:
    from eldata.calibration.defects import FixedPattern
    from eldata.noise.parameters import NoiseParameters
    from eldata.records import Sensor

_SIDE = 1024  # of the piece that is compared: a million pixels
_SHOWN = (128, 192)
_SHADING_BLOCK = 16  # CFA periods per side, of PatternSummary.shading_dn
_LEVELS = np.unique(
    np.concatenate([np.geomspace(1e-5, 0.05, 40), np.linspace(0.05, 0.95, 91), 1 - np.geomspace(1e-5, 0.05, 40)])
)

# What a table calls each figure, and how it writes it.
_SHOWN_FIGURES = {
    "r_squared": ("R2", ".5f"),
    "histogram_distance": ("histogram distance", ".4f"),
    "histogram_distance_by_chance": ("by chance", ".4f"),
    "sigma_real_dn": ("sigma real", ".4g"),
    "sigma_simulated_dn": ("simulated [DN]", ".4g"),
    "row_sigma_real_dn": ("row sigma real", ".3g"),
    "row_sigma_simulated_dn": ("simulated [DN]", ".3g"),
}
HEADINGS = tuple(heading for heading, _ in _SHOWN_FIGURES.values())


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """One held-out bias frame and its simulation. A residual is a pixel less its mean over n other frames.

    Attributes
    ----------
    pixels, frames
        Compared pixels; the n of the means.
    r_squared
        Of the real residuals' quantiles over the simulated ones', from 0.00001 to 0.99999.
    histogram_distance, histogram_distance_by_chance
        Half the sum of the absolute differences of the two histograms (total variation: 0 alike, 1 disjoint), in cells
        of about a fifth of the standard deviation; and what two simulations differ by.
    sigma_real_dn, sigma_simulated_dn
        Standard deviation of the residuals.
    row_sigma_real_dn, row_sigma_simulated_dn
        Standard deviation of the residuals' row means.
    levels, quantiles_real_dn, quantiles_simulated_dn
        Quantiles of the residuals.
    real_dn, simulated_dn
        A piece of both frames, less the black level, (128, 192): the real one with its fixed pattern, the simulated one
        with its shading and pixel levels that scatter as much.
    """

    pixels: int
    frames: int
    r_squared: float
    histogram_distance: float
    histogram_distance_by_chance: float
    sigma_real_dn: float
    sigma_simulated_dn: float
    row_sigma_real_dn: float
    row_sigma_simulated_dn: float
    levels: Values = field(repr=False)
    quantiles_real_dn: Values = field(repr=False)
    quantiles_simulated_dn: Values = field(repr=False)
    real_dn: Plane = field(repr=False)
    simulated_dn: Plane = field(repr=False)

    @property
    def shown_sigmas_dn(self) -> tuple[float, float]:
        """Standard deviations of the pieces of both frames, the real one's first."""
        return float(self.real_dn.std()), float(self.simulated_dn.std())

    def as_dict(self) -> dict[str, Any]:
        """Return the plain numbers."""
        return {name: getattr(self, name) for name in ("pixels", "frames", *_SHOWN_FIGURES)}

    def cells(self) -> tuple[str, ...]:
        """Return the figures of :data:`HEADINGS` as tables show them."""
        return tuple(format(getattr(self, name), shown) for name, (_, shown) in _SHOWN_FIGURES.items())


def compared_piece(mosaic: Mosaic, period: int) -> Mosaic:
    """Return a copy of all that :func:`reproduction` needs: a million pixels in the middle, from a CFA period on."""
    return mosaic[_cut_middle(mosaic.shape, (_SIDE, _SIDE), period)].copy()


def reproduction(
    held_out: Mosaic, fixed: FixedPattern, sensor: Sensor, parameters: NoiseParameters, generator: np.random.Generator
) -> Reproduction:
    """Compare a bias frame that is not part of ``fixed`` with simulated ones, in the middle of the sensor.

    ``held_out`` is the frame, or what :func:`compared_piece` has kept of it.

    The pattern's frames have 192 pixels a side or more.
    """
    shape, period = fixed.total_dn.shape, len(fixed.pattern)
    place = _cut_middle(shape, (_SIDE, _SIDE), period)
    sound = ~fixed.defects[place]
    if held_out.shape == shape:
        held_out = held_out[place]
    real = held_out - fixed.total_dn[place] / fixed.frames
    channel = by_pixel(np.arange(len(sensor.black_level_dn)), fixed.pattern, real.shape)
    block = _SHADING_BLOCK * len(fixed.pattern)
    rows_of, columns_of = (np.arange(part.start, part.stop) // block for part in place)
    level = fixed.summary.shading_dn[channel, rows_of[:, None], columns_of]
    spread = np.asarray(fixed.summary.dsnu_dn)[channel]
    first, simulated = _simulate(level, spread, channel, fixed.frames, sensor, parameters, generator)
    _, again = _simulate(level, spread, channel, fixed.frames, sensor, parameters, generator)
    for residual in (real, simulated, again):
        for index in range(int(channel.max()) + 1):
            chosen = channel == index
            residual[chosen] -= residual[chosen & sound].mean()  # drift of a channel from frame to frame

    values = [np.sort(residual[sound]) for residual in (real, simulated, again)]
    sigmas = [float(ordered.std()) for ordered in values]
    quantiles = [np.quantile(ordered, _LEVELS) for ordered in values]
    # Odd multiples of 1/n DN, on which residuals lie: other cells would hold now more, now fewer of those steps, and
    # edges on the steps themselves would tell frames apart by the slightest drift.
    steps = round(fixed.frames * sigmas[1] / 5)
    cell = max(1, steps - 1 + steps % 2) / fixed.frames
    edges = [-np.inf, *(np.arange(-60, 61) + 0.5) * cell, np.inf]  # 120 cells around 0, and two open ones beyond
    histograms = [np.asarray(np.histogram(ordered, edges)[0] / ordered.size) for ordered in values]
    pixels = np.maximum(sound.sum(axis=1), 1)
    rows = [np.where(sound, residual, 0).sum(axis=1) / pixels for residual in (real, simulated)]
    shown = tuple(
        slice(part.start - whole.start, part.stop - whole.start)
        for part, whole in zip(_cut_middle(shape, _SHOWN, period), place, strict=True)
    )
    black = by_pixel(np.asarray(sensor.black_level_dn), fixed.pattern, _SHOWN)
    return Reproduction(
        pixels=values[0].size,
        frames=fixed.frames,
        r_squared=float(np.corrcoef(quantiles[0], quantiles[1])[0, 1]) ** 2,
        histogram_distance=_measure_distance(histograms[0], histograms[1]),
        histogram_distance_by_chance=_measure_distance(histograms[2], histograms[1]),
        sigma_real_dn=sigmas[0],
        sigma_simulated_dn=sigmas[1],
        row_sigma_real_dn=float(rows[0].std()),
        row_sigma_simulated_dn=float(rows[1].std()),
        levels=_LEVELS,
        quantiles_real_dn=quantiles[0],
        quantiles_simulated_dn=quantiles[1],
        real_dn=(held_out[shown] - black).astype(np.float32),
        simulated_dn=(first[: _SHOWN[0], : _SHOWN[1]] - black).astype(np.float32),
    )


def _cut_middle(shape: tuple[int, ...], side: tuple[int, int], period: int) -> tuple[slice, slice]:
    """Return a piece in the middle that begins with the CFA's period."""
    rows, columns = (
        slice(start := max(0, (length - size) // 2) // period * period, start + min(size, length))
        for length, size in zip(shape, side, strict=True)
    )
    return rows, columns


def _simulate(
    level_dn: Values, spread_dn: Values, channel: Counts, frames: int, sensor: Sensor, parameters: NoiseParameters,
    generator: np.random.Generator,
) -> tuple[Values, Values]:  # fmt: skip
    """Return one simulated bias frame in DN, and its residual to the mean of n more.

    Pixels scatter by ``spread_dn`` around ``level_dn``, which comes on top of their channel's black level and bias.
    """
    from eldata.noise.model import NoiseModel
    from eldata.noise.parameters import Adc

    # The model's converter has one black level: a whole one, as another would round the noise elsewhere. By what a
    # channel's own differs from it, its pixels' levels are shifted.
    black = float(np.rint(np.mean(sensor.black_level_dn)))
    level_dn = level_dn + (np.asarray(sensor.black_level_dn) - black)[channel]
    range_dn = sensor.white_level_dn - black
    model = NoiseModel("G*+B+R", adc=Adc(black, sensor.white_level_dn))
    # Without shot noise, the model adds its noise to what it is given and rounds the sum. Values below 0 count as no
    # light there: all are raised by whole DN, and the colour bias is lowered by as many.
    pattern = level_dn + spread_dn * generator.standard_normal(spread_dn.shape)
    raised = float(np.ceil(max(0.0, -pattern.min())))
    bias: Any = tuple(bias - raised for bias in parameters.colour_bias_dn)
    parameters = replace(parameters, colour_bias_dn=bias)
    levels = ((pattern + raised) / range_dn).astype(np.float32)

    options: dict[str, Any] = {"parameters": parameters, "ratio": 1.0, "range_dn": range_dn, "generator": generator}

    def make_frame() -> Values:
        """Simulate a bias frame, in whole DN."""
        noisy = model.on_mosaic(levels, cfa=sensor.cfa, **options)
        return np.asarray(np.rint(noisy.astype(np.float64) * range_dn + black))

    first = make_frame()
    others = np.zeros(spread_dn.shape)
    for _ in range(frames):
        others += make_frame()
    return first, first - others / frames


def _measure_distance(first: Values, second: Values) -> float:
    """Measure how unlike two histograms are: 0 if equal, 1 if they share no cell."""
    return 0.5 * float(np.abs(first - second).sum())
