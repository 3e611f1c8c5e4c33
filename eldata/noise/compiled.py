"""The compiled CPU engine of the noise model, as one function on arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from eldata.base.compiled import in_threads
from eldata.errors import ArgumentError
from eldata.noise import _kernels
from eldata.noise._tables import poisson_tables

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_PIECE = 1 << 16  # pixels in a band of rows: a fraction of a millisecond

_SHOT = {"none": _kernels.NONE, "gaussian": _kernels.GAUSSIAN, "poisson": _kernels.POISSON}
_READ = {"none": _kernels.NONE, "gaussian": _kernels.GAUSSIAN, "tukey-lambda": _kernels.TUKEY_LAMBDA}
_QUANTISATION = {"none": _kernels.NONE, "uniform": _kernels.UNIFORM, "adc": _kernels.ADC}

_LAMBDA_RANGE = (-1.0, 2.0)


def add_noise(
    clean: NDArray[np.float32],
    *,
    gain_dn_per_e: ArrayLike,
    range_dn: ArrayLike,
    ratio: ArrayLike,
    shot: Literal["none", "gaussian", "poisson"],
    read: Literal["none", "gaussian", "tukey-lambda"],
    key: int,
    row_table: NDArray[np.int64],
    period: int,
    tukey_lambda: ArrayLike = 0.0,
    sigma_read_dn: ArrayLike = 0.0,
    sigma_row_dn: ArrayLike = 0.0,
    bias_dn: ArrayLike = 0.0,
    quantisation: Literal["none", "uniform", "adc"] = "none",
    black_dn: ArrayLike = 0.0,
    white_dn: ArrayLike = math.inf,
    low: ArrayLike = -math.inf,
    high: ArrayLike = math.inf,
    first_image: int = 0,
    threads: int | None = None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Return noisy exposures of clean packed images.

    With I = clean range / (ratio K) photoelectrons, K being ``gain_dn_per_e``::

        D = K Poisson(I) + read noise + bias + row noise + U(-1/2, 1/2),    out = D ratio / range

    The random numbers of a pixel depend on ``key``, its image's index, its place in the image and the component alone:
    neither on the number of threads nor on how images are put into batches (see ``first_image``), and one component
    does not change when another one is switched off.

    Parameters
    ----------
    clean
        (N, C, h, w) float32, C-contiguous, normalised. Values below 0 count as no light; NaN gives NaN.
    gain_dn_per_e
        K, DN per photoelectron. Like every parameter below up to ``high``: one number, or one for each image.
    range_dn, ratio
        White level minus black level, and the exposure ratio.
    shot
        "poisson"; "gaussian" with the same mean and variance; or "none", which keeps K I.
    read
        "tukey-lambda", ``sigma_read_dn`` times the quantile ``(u^l - (1 - u)^l) / l``; "gaussian", of standard
        deviation ``sigma_read_dn``; or "none".
    key
        0 to 2^64 - 1.
    row_table, period
        Packed entry (c, y, x) lies in mosaic row ``(y // s) * period + row_table[c, y % s, x % s]``; the table is
        (C, s, s). All entries of a mosaic row get the same draw of row noise.
    tukey_lambda
        l, from -1 to 2.
    sigma_row_dn
        Standard deviation of the row noise.
    bias_dn
        Colour bias: one number, or anything that broadcasts to (N, C).
    quantisation
        "uniform" adds U(-1/2, 1/2) DN. "adc" rounds D + black to an integer from 0 to white and takes black off again.
    black_dn, white_dn
        Levels of the converter, for "adc".
    low, high
        Limits of the output; default none.
    first_image
        Index of the first image: a batch of N images gives the same as two halves with 0 and N / 2.
    threads
        Default: one per CPU.
    out
        Where to write, like ``clean``; may be ``clean``.

    Returns
    -------
    ndarray
        (N, C, h, w) float32, ``out`` if given.

    Raises
    ------
    ArgumentError
        If an array, a shape, a name or a number does not fit.
    """
    _check_arrays(clean, out, row_table, period)
    for name, value, known in (
        ("shot", shot, _SHOT),
        ("read", read, _READ),
        ("quantisation", quantisation, _QUANTISATION),
    ):
        if value not in known:
            raise ArgumentError(f"{name} must be one of {', '.join(known)}; found {value!r}")
    if not 0 <= key < 1 << 64:
        raise ArgumentError(f"key must be from 0 to 2^64 - 1; found {key}")
    if first_image < 0:
        raise ArgumentError(f"first_image must not be negative; found {first_image}")
    images, channels, rows, columns = clean.shape
    result = np.empty_like(clean) if out is None else out
    if clean.size == 0:
        return result

    def of_images(value: ArrayLike, name: str) -> NDArray[np.float64]:
        return _broadcast(value, (images,), name)

    gain = of_images(gain_dn_per_e, "gain_dn_per_e") if shot != "none" else np.ones(images)
    span = of_images(range_dn, "range_dn")
    times = of_images(ratio, "ratio")
    for name, values in (("gain_dn_per_e", gain), ("range_dn", span), ("ratio", times)):
        if not (np.isfinite(values) & (values > 0)).all():
            raise ArgumentError(f"{name} must be finite and above 0; found {values}")
    sigma_read, sigma_row = of_images(sigma_read_dn, "sigma_read_dn"), of_images(sigma_row_dn, "sigma_row_dn")
    for name, values in (("sigma_read_dn", sigma_read), ("sigma_row_dn", sigma_row)):
        if not (np.isfinite(values) & (values >= 0)).all():
            raise ArgumentError(f"{name} must be finite and not negative; found {values}")
    shape = of_images(tukey_lambda if read == "tukey-lambda" else 0.0, "tukey_lambda")
    if not ((shape >= _LAMBDA_RANGE[0]) & (shape <= _LAMBDA_RANGE[1])).all():
        raise ArgumentError(f"tukey_lambda must be from {_LAMBDA_RANGE[0]:g} to {_LAMBDA_RANGE[1]:g}; found {shape}")
    exponent = np.where(np.abs(shape) < _kernels.LAMBDA_FLOOR, _kernels.LAMBDA_FLOOR, shape).astype(np.float32)
    power = _power_coefficients(exponent)
    bias = _broadcast(bias_dn, (images, channels), "bias_dn")
    if not np.isfinite(bias).all():
        raise ArgumentError(f"bias_dn must be finite; found {bias}")
    black, white = of_images(black_dn, "black_dn"), of_images(white_dn, "white_dn")
    lowest, highest = of_images(low, "low"), of_images(high, "high")
    coarse, fine = poisson_tables()

    def settings(image: int, channel: int) -> _kernels.Settings:
        numbers = (
            span[image] / (times[image] * gain[image]),
            gain[image],
            exponent[image],
            sigma_read[image],
            sigma_row[image],
            bias[image, channel],
            black[image],
            white[image],
            times[image] / span[image],
            lowest[image],
            highest[image],
        )
        modes = _SHOT[shot], _READ[read], _QUANTISATION[quantisation]
        return _kernels.Settings(*modes, *(np.float32(number) for number in numbers))

    def work(piece: tuple[int, int, int, int]) -> None:
        image, channel, first_row, last_row = piece
        _kernels.add_noise_rows(
            clean[image, channel],
            result[image, channel],
            first_row,
            last_row,
            each[image][channel],
            power[image],
            coarse,
            fine,
            table[channel],
            period,
            np.uint64(key),
            np.uint64(first_image + image),
            np.uint64(channel * rows * columns),
        )

    each = [[settings(image, channel) for channel in range(channels)] for image in range(images)]
    table = np.ascontiguousarray(row_table, dtype=np.int64)
    band = max(1, _PIECE // columns)
    pieces = [
        (image, channel, first, min(first + band, rows))
        for image in range(images)
        for channel in range(channels)
        for first in range(0, rows, band)
    ]
    in_threads(work, pieces, threads)
    return result


def _check_arrays(
    clean: NDArray[np.float32], out: NDArray[np.float32] | None, row_table: NDArray[np.int64], period: int
) -> None:
    """Raise unless the arrays are of the kind that the kernels read."""
    for name, array in (("clean", clean), ("out", clean if out is None else out)):
        if array.ndim != 4 or array.dtype != np.float32 or not array.flags.c_contiguous:
            raise ArgumentError(
                f"{name} must be a C-contiguous float32 array (N, C, h, w); found {array.dtype} {array.shape}"
            )
    if out is not None:
        if out.shape != clean.shape or not out.flags.writeable:
            raise ArgumentError(f"out must be writeable and of shape {clean.shape}; found {out.shape}")
        if np.may_share_memory(out, clean) and out.ctypes.data != clean.ctypes.data:
            raise ArgumentError("out overlaps clean without being the same array")
    if row_table.ndim != 3 or row_table.shape[0] != clean.shape[1] or row_table.shape[1] != row_table.shape[2]:
        raise ArgumentError(f"row_table must be (C, s, s) with C = {clean.shape[1]}; found {row_table.shape}")
    if row_table.size and not 0 <= row_table.min() <= row_table.max() < period:
        raise ArgumentError(f"row_table must hold rows from 0 to period - 1 = {period - 1}")


def _broadcast(value: ArrayLike, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    """Return ``value`` as a float64 array of ``shape``."""
    array = np.asarray(value, dtype=np.float64)
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        raise ArgumentError(f"{name} must be one number or broadcast to {shape}; found shape {array.shape}") from None


def _power_coefficients(shape: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return, for each l, the coefficients of a polynomial for (1 - v)^l, 0 <= v <= 1/2.

    It interpolates at Chebyshev nodes: relative error below 1e-7 for l from -1 to 2, 1e-8 for abs(l) <= 0.3.
    """
    count = _kernels.POWER_TERMS
    nodes = 0.25 + 0.25 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = (1.0 - nodes[:, None]) ** shape.astype(np.float64)
    return np.ascontiguousarray(np.linalg.solve(np.vander(nodes, increasing=True), values).T, dtype=np.float32)
