"""A camera's response function from pictures: the PCA model of Grossberg and Nayar, fitted by least squares.

M. D. Grossberg and S. K. Nayar, "Modeling the Space of Camera Response Functions", PAMI 26(10), 2004: a response is
``f = f0 + sum_n c_n h_n`` with the mean f0 and the leading components h_n of many measured responses (EMoR), and its
inverse is ``g = g0 + sum_n c_n hinv_n``. Two ways to the weights:

:func:`fit_to_samples`
    Irradiance is known, such as a colour chart's patches in the raw file, and brightness is read in the camera's own
    JPEG of it: the paper's way, ``f(E_i) = B_i``.
:func:`fit_to_exposures`
    Several registered exposures of one scene, exposure times known, irradiance not: ``g(B_2) = (t_2 / t_1) g(B_1)`` at
    each pixel, which is linear in the weights of the inverse model.

Both under the condition that the curve rises. The first is linear least squares with that condition, solved exactly
(C. L. Lawson and R. J. Hanson, "Solving Least Squares Problems", chapter 23: LSI by NNLS); the second has errors on
both sides of its equation and starts there.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import ArgumentError
from eldata.isp.response import ResponseCurve

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_MOST_BLOCKS = 1 << 14
_FLAT = 0.02  # of full brightness: the standard deviation inside a block that counts as flat
_LEAST_PAIRS = 20  # for each component
# A fitted inverse rises by at least this from point to point: one that stands still is not an inverse.
_LEAST_RISE = 1e-7
_GRID_POINTS = 1024  # as EMoR
_MOST_STEPS = 100
_LEAST_GAIN = 1e-9  # of the squared residual, in a step


@dataclass(frozen=True, slots=True, eq=False)
class CurveModel:
    """A mean curve and components, on a grid: a linear space of curves from 0 to 1.

    Attributes
    ----------
    grid
        (n,) rising from 0 to 1: irradiance, or brightness if ``inverse``.
    mean
        (n,) rising from 0 to 1: the mean response, or the mean inverse.
    components
        (k, n), 0 at both ends.
    inverse
        Whether it is of inverse responses (invemor.txt): irradiance over brightness.
    name
        Where it comes from.

    Raises
    ------
    ArgumentError
        If the shapes do not fit, a number is not finite, or grid, mean or components are not as said.
    """

    grid: Floats
    mean: Floats
    components: Floats
    inverse: bool
    name: str = "curve model"

    def __post_init__(self) -> None:
        grid, mean, components = self.grid, self.mean, self.components
        if grid.ndim != 1 or mean.shape != grid.shape or components.ndim != 2 or components.shape[1:] != grid.shape:
            raise ArgumentError(
                f"{self.name}: expected a grid (n,), a mean (n,) and components (k, n); found {grid.shape}, "
                f"{mean.shape} and {components.shape}"
            )
        if not all(np.isfinite(values).all() for values in (grid, mean, components)):
            raise ArgumentError(f"{self.name}: holds NaN or infinities")
        for what, values in (("grid", grid), ("mean curve", mean)):
            falls = np.diff(values) <= 0 if what == "grid" else np.diff(values) < 0
            if falls.any() or abs(values[0]) > 1e-4 or abs(values[-1] - 1) > 1e-4:
                raise ArgumentError(
                    f"{self.name}: the {what} must rise from 0 to 1; found {values[0]:g} to {values[-1]:g}"
                    + (f", falling at point {int(np.argmax(falls)) + 2}" if falls.any() else "")
                )
        if np.abs(components[:, [0, -1]]).max(initial=0) > 1e-4:
            raise ArgumentError(f"{self.name}: the components must be 0 at both ends")

    @classmethod
    def of_curves(
        cls, curves: Sequence[ResponseCurve], components: int = 5, *, inverse: bool = False, name: str = "curve model"
    ) -> CurveModel:
        """Return the mean and the leading principal components of response curves, such as those of DoRF.

        A curve with three colours counts as three.

        Parameters
        ----------
        curves
            More curves than ``components``.
        components
            How many; the paper's curve has 5.
        inverse
            Model the curves' inverses, for :func:`fit_to_exposures`.
        name
            What to call it.

        Raises
        ------
        ArgumentError
            If there are too few curves.
        """
        grid = np.linspace(0, 1, _GRID_POINTS)
        rows = []
        for curve in curves:
            for e, b in zip(curve.irradiance, curve.brightness, strict=True):
                if inverse:  # of a flat stretch the first point, as ResponseCurve.inverse
                    distinct, first = np.unique(b, return_index=True)
                    rows.append(np.interp(grid, distinct, e[first]))
                else:
                    rows.append(np.interp(grid, e, b))
        if components < 1 or len(rows) <= components:
            raise ArgumentError(f"{components} components need more than {components} curves; found {len(rows)}")
        values = np.array(rows)
        values[:, 0], values[:, -1] = 0, 1
        mean = values.mean(axis=0)
        directions = np.linalg.svd(values - mean, full_matrices=False)[2][:components]
        directions[:, [0, -1]] = 0
        return cls(grid, mean, directions, inverse=inverse, name=name)

    def first(self, components: int) -> CurveModel:
        """Return the model with its leading components alone.

        Raises
        ------
        ArgumentError
            If it has fewer.
        """
        if not 1 <= components <= len(self.components):
            raise ArgumentError(
                f"{self.name} has {len(self.components)} components; asked for {components}: choose 1 or more of them"
            )
        return CurveModel(self.grid, self.mean, self.components[:components], inverse=self.inverse, name=self.name)

    def values(self, weights: Floats) -> Floats:
        """Return ``mean + weights @ components``, (n,), its ends exactly 0 and 1."""
        values: Floats = self.mean + weights @ self.components
        values[0], values[-1] = 0, 1
        return values

    def response(self, weights: Sequence[float]) -> ResponseCurve:
        """Return the response with these weights of the leading components.

        Raises
        ------
        ArgumentError
            If the model has fewer components or is of inverses, or the curve falls.
        """
        if self.inverse:
            raise ArgumentError(f"{self.name} models inverse responses; weights of responses need emor.txt's kind")
        values = self.first(len(weights)).values(np.array(weights, float))
        return ResponseCurve(self.grid, values, f"{self.name}, weights {', '.join(f'{one:g}' for one in weights)}")

    def at(self, positions: Floats) -> tuple[Floats, Floats]:
        """Return mean (m,) and components (m, k) at positions on the grid's axis."""
        mean = np.interp(positions, self.grid, self.mean)
        return mean, np.stack([np.interp(positions, self.grid, row) for row in self.components], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class RadiometricFit:
    """A fitted response.

    Attributes
    ----------
    curve
        One curve, or one each for R, G, B.
    weights
        (1 or 3, k): of the model's components.
    rms_brightness
        (1 or 3,): root mean square of what the fit leaves, as a share of full brightness. Quantisation to 8 bits alone
        leaves 0.0011 where irradiance is known; much more says that the model or the pictures do not fit.
    samples
        (1 or 3,): how many readings, or pairs of readings, it rests on.
    """

    curve: ResponseCurve
    weights: Floats
    rms_brightness: tuple[float, ...]
    samples: tuple[int, ...]


def fit_to_samples(
    model: CurveModel, irradiance: NDArray[np.floating[Any]], brightness: NDArray[np.floating[Any]]
) -> RadiometricFit:
    """Fit a response to readings of known irradiance.

    Parameters
    ----------
    model
        Of responses (emor.txt).
    irradiance, brightness
        (m,) or (3, m) in [0, 1]. Leave saturated readings out, and give the two ends no readings: they are known.

    Raises
    ------
    ArgumentError
        If the model is of inverses, the arrays do not fit, values lie outside [0, 1], or the readings are too few or
        too much alike for the model's components.
    """
    if model.inverse:
        raise ArgumentError(f"{model.name} models inverse responses; readings of known irradiance need emor.txt's kind")
    e, b = (np.array(values, dtype=np.float64, ndmin=2) for values in (irradiance, brightness))
    if e.shape != b.shape or e.ndim != 2 or len(e) not in (1, 3):
        raise ArgumentError(
            f"expected irradiance and brightness (m,) or (3, m) of one shape; found {e.shape} and {b.shape}"
        )
    for name, values in (("irradiance", e), ("brightness", b)):
        if not ((values >= 0) & (values <= 1)).all():  # NaN too
            raise ArgumentError(f"{name} must lie in [0, 1]; found {np.min(values):g} to {np.max(values):g}")
    rises = np.diff(model.components, axis=1).T
    weights, residuals = [], []
    for e_row, b_row in zip(e, b, strict=True):
        mean, components = model.at(e_row)
        found = _least_squares(components, b_row - mean, rises, -np.diff(model.mean))
        weights.append(found)
        residuals.append(float(np.sqrt(np.mean((mean + components @ found - b_row) ** 2))))
    # Rounding may leave a flat stretch falling by 1e-17.
    curves = np.array([np.maximum.accumulate(model.values(found)).clip(0, 1) for found in weights])
    curve = ResponseCurve(np.broadcast_to(model.grid, curves.shape), curves, f"fitted with {model.name}")
    return RadiometricFit(curve, np.array(weights), tuple(residuals), (e.shape[1],) * len(e))


def fit_to_exposures(
    model: CurveModel,
    images: Sequence[NDArray[np.unsignedinteger[Any]]],
    exposures_s: Sequence[float],
    *,
    block: int = 8,
) -> RadiometricFit:
    """Fit a response to registered exposures of one scene.

    The images are read in flat blocks: their means, of blocks that vary little and have no pixel that is 0 or
    saturated. Single pixels will not do: noise of one code, and leaving out noisy pixels by their own value, bends the
    curve by tens of codes. What is left of a pair's equation counts relative to the error that equal errors of both
    brightnesses make in it, ``g'(B_2)^2 + (t_2 / t_1)^2 g'(B_1)^2``. That depends on the curve that is sought: plain
    least squares would prefer curves that are too flat.

    Parameters
    ----------
    model
        Of inverse responses (invemor.txt).
    images
        Two or more, (H, W) or (3, H, W) uint8 or uint16, same size, as the camera wrote them (aperture, ISO and white
        balance fixed, decoded and nothing else), of a scene that does not move.
    exposures_s
        Their exposure times in seconds, all different; only their ratios count.
    block
        Side of a block in pixels: 8, that of JPEG.

    Raises
    ------
    ArgumentError
        If the model is of responses, the images or times do not fit, or too few blocks are well exposed in two images.
    """
    if not model.inverse:
        raise ArgumentError(f"{model.name} models responses; exposures of unknown irradiance need invemor.txt's kind")
    _check_exposures(images, exposures_s, block)
    means, usable = zip(*(_block_means(image, block) for image in images), strict=True)
    readings, well_exposed = np.stack(means), np.stack(usable)
    fitted, residuals, counts = [], [], []
    for channel in range(readings.shape[1]):
        dark, bright, ratio = _pairs(readings[:, channel], well_exposed[:, channel], exposures_s)
        if len(ratio) < _LEAST_PAIRS * len(model.components):
            raise ArgumentError(
                f"only {len(ratio)} pairs of flat blocks are well exposed in two images; {len(model.components)} "
                f"components need {_LEAST_PAIRS * len(model.components)} or more: closer exposure times, or a scene "
                "with flat parts of many brightnesses"
            )
        weights, rms = _fit_pairs(model, dark, bright, ratio)
        fitted.append(weights)
        residuals.append(rms)
        counts.append(len(ratio))
    inverse = np.array([model.values(weights) for weights in fitted])
    curve = ResponseCurve(inverse, np.broadcast_to(model.grid, inverse.shape), f"fitted with {model.name}")
    return RadiometricFit(curve, np.array(fitted), tuple(residuals), tuple(counts))


def _check_exposures(
    images: Sequence[NDArray[np.unsignedinteger[Any]]], exposures_s: Sequence[float], block: int
) -> None:
    if len(images) < 2 or len(images) != len(exposures_s):
        raise ArgumentError(
            f"expected two or more images with an exposure time each; found {len(images)} images and "
            f"{len(exposures_s)} times"
        )
    shapes, dtypes = {image.shape for image in images}, {image.dtype for image in images}
    shape, dtype = images[0].shape, images[0].dtype
    if len(shapes) > 1 or not (len(shape) == 2 or (len(shape) == 3 and shape[0] == 3)):
        raise ArgumentError(f"expected images (H, W) or (3, H, W) of one size; found {sorted(shapes)}")
    if len(dtypes) > 1 or dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise ArgumentError(f"expected images of uint8 or of uint16 codes; found {sorted(map(str, dtypes))}")
    if not all(0 < time < np.inf for time in exposures_s) or len(set(exposures_s)) < len(exposures_s):
        raise ArgumentError(f"expected exposure times above 0 s, all different; found {list(exposures_s)}")
    if not 1 <= block <= min(shape[-2:]):
        raise ArgumentError(f"block must be from 1 to the images' side; found {block} for {shape}")


def _block_means(image: NDArray[np.unsignedinteger[Any]], block: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the blocks' mean brightnesses (channels, blocks), and which of them are flat and not clipped."""
    full = np.iinfo(image.dtype).max
    channels, (height, width) = image.reshape(-1, *image.shape[-2:]), image.shape[-2:]
    rows, columns = height // block, width // block
    # A regular grid of no more blocks than needed: the fit has a handful of unknowns.
    step = max(1, int(np.ceil(np.sqrt(rows * columns / _MOST_BLOCKS))))
    cut = channels[:, : rows * block, : columns * block].reshape(-1, rows, block, columns, block)[:, ::step, :, ::step]
    pixels = cut.transpose(0, 1, 3, 2, 4).reshape(len(channels), -1, block * block).astype(np.float64) / full
    inside = (pixels.min(axis=-1) > 0) & (pixels.max(axis=-1) < 1)
    return pixels.mean(axis=-1), inside & (pixels.std(axis=-1) <= _FLAT)


def _pairs(readings: Floats, usable: NDArray[np.bool_], exposures_s: Sequence[float]) -> tuple[Floats, Floats, Floats]:
    """Return the brightnesses of each block in the shorter and the longer of two exposures, and their times' ratio."""
    found = []
    for i, j in combinations(range(len(readings)), 2):
        short, long = (i, j) if exposures_s[i] < exposures_s[j] else (j, i)
        both = usable[short] & usable[long]
        ratio = np.full(int(both.sum()), exposures_s[long] / exposures_s[short])
        found.append((readings[short][both], readings[long][both], ratio))
    dark, bright, ratios = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return dark, bright, ratios


def _fit_pairs(model: CurveModel, dark: Floats, bright: Floats, ratio: Floats) -> tuple[Floats, float]:
    """Return the weights of one channel, and the root mean square of what is left, as a share of full brightness."""
    rises, least = np.diff(model.components, axis=1).T, _LEAST_RISE - np.diff(model.mean)
    mean_dark, of_dark = model.at(dark)
    mean_bright, of_bright = model.at(bright)
    rows, start = of_bright - ratio[:, None] * of_dark, mean_bright - ratio * mean_dark

    def slope_at(positions: Floats) -> tuple[Floats, Floats]:
        """Return the slopes of mean (m,) and components (m, k)."""
        mean = np.interp(positions, model.grid, np.gradient(model.mean, model.grid))
        each = [np.interp(positions, model.grid, np.gradient(row, model.grid)) for row in model.components]
        return mean, np.stack(each, axis=-1)

    (mean_slope_dark, slope_dark), (mean_slope_bright, slope_bright) = slope_at(dark), slope_at(bright)
    root = len(ratio) ** -0.5

    def residuals(weights: Floats) -> tuple[Floats, Floats]:
        """Return what is left of each equation in units of brightness, and its derivatives by the weights."""
        left = start + rows @ weights
        of_bright_slope = mean_slope_bright + slope_bright @ weights
        of_dark_slope = ratio * (mean_slope_dark + slope_dark @ weights)
        error = np.hypot(of_bright_slope, of_dark_slope) + 1e-9
        by_slope = of_bright_slope[:, None] * slope_bright + (ratio * of_dark_slope)[:, None] * slope_dark
        each = rows / error[:, None] - by_slope * (left / error**3)[:, None]
        return root * left / error, root * each

    plain_scale = root / np.sqrt(mean_slope_bright**2 + (ratio * mean_slope_dark) ** 2 + 1e-9)
    weights = _least_squares(rows * plain_scale[:, None], -start * plain_scale, rises, least)
    left, each = residuals(weights)
    # Gauss and Newton, each step among the curves that rise, which are a convex set: part of a step stays inside.
    for _ in range(_MOST_STEPS):
        step = _least_squares(each, each @ weights - left, rises, least) - weights
        for share in 0.5 ** np.arange(12):
            tried, tried_each = residuals(weights + share * step)
            if tried @ tried < left @ left:
                break
        else:
            return weights, float(np.sqrt(left @ left))
        weights, gain = weights + share * step, left @ left - tried @ tried
        left, each = tried, tried_each
        if gain < _LEAST_GAIN * (left @ left):
            return weights, float(np.sqrt(left @ left))
    raise ArgumentError("the fit does not converge; try fewer components: model.first(3)")


def _least_squares(a: Floats, b: Floats, rises: Floats, least: Floats) -> Floats:
    """Return the x that minimises ``|a x - b|`` under ``rises x >= least`` (Lawson and Hanson, LSI)."""
    from scipy.optimize import nnls

    unknowns = a.shape[1]
    if len(a) < unknowns:
        raise ArgumentError(f"{len(a)} readings are too few for {unknowns} components")
    q, r = np.linalg.qr(a)
    diagonal = np.abs(np.diag(r))
    if not diagonal.min() > 1e-9 * diagonal.max():
        raise ArgumentError(
            f"the readings are too much alike to tell {unknowns} components apart; take more brightnesses, or fewer "
            "components: model.first(3)"
        )
    free: Floats = np.linalg.solve(r, q.T @ b)
    if (rises @ free >= least).all():
        return free
    # Least distance: the shortest z = r x - q'b within the half spaces.
    halves = np.linalg.solve(r.T, rises.T).T
    limits = least - rises @ free
    dual = np.vstack([halves.T, limits])
    target = np.zeros(unknowns + 1)
    target[-1] = 1
    try:
        multipliers = nnls(dual, target)[0]
    except RuntimeError as error:  # its iterations ran out
        raise ArgumentError("the fit does not converge; try fewer components: model.first(3)") from error
    rest = dual @ multipliers - target
    if not abs(rest[-1]) > 1e-12:
        raise ArgumentError("no curve of the model rises all the way; the model's mean curve itself must")
    bounded: Floats = free + np.linalg.solve(r, -rest[:-1] / rest[-1])
    return bounded
