"""A camera's response function as a measured curve, read from a table and applied by linear interpolation, on torch."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.fields import TextFile
from eldata.base.numbers import number_of
from eldata.errors import ArgumentError, FileError
from eldata.isp.rendering import Gamma

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from eldata.isp.rendering import Response

_LEAST_POINTS = 2
_CURVE, _GAMMA = "curve ", "gamma-"
_END_TOLERANCE = 1e-4
_SEPARATORS = re.compile(r"[\s,;]+")


@dataclass(frozen=True, slots=True, eq=False)
class ResponseCurve:
    """Brightness as a function of irradiance, both in [0, 1], one curve for all colours or one each for R, G, B.

    Between its points the curve is straight, as in the published code (ELD repository, util/process.py), so that it is
    differentiable everywhere else.

    Attributes
    ----------
    irradiance
        (1 or 3, n) float64, rising, first 0 and last 1 (what is within 0.0001 of them is set to them).
    brightness
        (1 or 3, n) float64, never falling, first 0 and last 1, likewise.
    name
        Where it comes from.

    Raises
    ------
    ArgumentError
        If the shapes differ, there are fewer than 2 points, a number is not finite, irradiance does not rise,
        brightness falls, or an end is elsewhere.
    """

    irradiance: NDArray[np.float64]
    brightness: NDArray[np.float64]
    name: str = "response curve"

    def __post_init__(self) -> None:
        for field in ("irradiance", "brightness"):
            values = np.array(getattr(self, field), dtype=np.float64, ndmin=2, order="C")
            ends = values[..., [0, -1]] if values.shape[-1] > 1 else np.full(2, np.nan)
            if (np.abs(ends - [0, 1]) <= _END_TOLERANCE).all():  # as few digits of a text file leave them
                values = values.clip(0, 1)
                values[..., 0], values[..., -1] = 0, 1
            values.flags.writeable = False
            object.__setattr__(self, field, values)
        e, b = self.irradiance, self.brightness
        if e.shape != b.shape or e.ndim != 2 or e.shape[0] not in (1, 3) or e.shape[1] < _LEAST_POINTS:
            raise ArgumentError(
                f"{self.name}: expected 2 or more points of one curve (n,) or of three (3, n); found "
                f"irradiance {e.shape} and brightness {b.shape}"
            )
        if not (np.isfinite(e).all() and np.isfinite(b).all()):
            raise ArgumentError(f"{self.name}: holds NaN or infinities")
        for field, values, steps_are_good, wanted in (
            ("irradiance", e, np.diff(e) > 0, "rise from point to point"),
            ("brightness", b, np.diff(b) >= 0, "never fall"),
        ):
            if not steps_are_good.all():
                curve, at = np.argwhere(~steps_are_good)[0]
                raise ArgumentError(
                    f"{self.name}: {field} must {wanted}; point {at + 2} has {values[curve, at + 1]:g} after "
                    f"{values[curve, at]:g}"
                )
            if (values[:, 0] != 0).any() or (values[:, -1] != 1).any():
                raise ArgumentError(
                    f"{self.name}: {field} must go from 0 to 1; found {values[:, 0].tolist()} to "
                    f"{values[:, -1].tolist()}"
                )

    def __call__(self, linear: torch.Tensor) -> torch.Tensor:
        """Apply the curve to an irradiance (..., 3, h, w), or of any shape if one curve serves all colours.

        Values outside [0, 1] are clipped. dtype and device stay.

        Raises
        ------
        ArgumentError
            If there are three curves and the image does not have three channels.
        """
        import torch

        if len(self.irradiance) == 3 and (linear.ndim < 3 or linear.shape[-3] != 3):
            raise ArgumentError(
                f"{self.name}: has a curve each for R, G, B; expected an image (..., 3, h, w), found shape "
                f"{tuple(linear.shape)}"
            )
        # (curves, values): each channel has its curve's points.
        rows = linear.movedim(-3, 0).reshape(3, -1) if len(self.irradiance) == 3 else linear.reshape(1, -1)
        # Half precision cannot tell neighbouring points apart.
        rows = rows.clamp(0, 1).to(torch.promote_types(rows.dtype, torch.float32))
        x = torch.tensor(self.irradiance, dtype=rows.dtype, device=rows.device)
        y = torch.tensor(self.brightness, dtype=rows.dtype, device=rows.device)
        # The segment whose left end lies below the value and whose right end does not: it is never flat.
        left = (torch.searchsorted(x, rows.detach().contiguous()) - 1).clamp(0, x.shape[1] - 2)
        x0, x1, y0, y1 = (points.gather(1, index) for points in (x, y) for index in (left, left + 1))
        width = torch.where(x1 > x0, x1 - x0, torch.ones_like(x0))  # a flat start, where the share is 0
        result = (y0 + (rows - x0) / width * (y1 - y0)).to(linear.dtype)
        if len(self.irradiance) == 3:
            moved = linear.movedim(-3, 0)
            return result.reshape(moved.shape).movedim(0, -3)
        return result.reshape(linear.shape)

    @property
    def text(self) -> str:
        """All of its points in a line, as a protocol states them: irradiance; brightness of each colour."""
        shared = (self.irradiance == self.irradiance[0]).all()
        rows = [*(self.irradiance[:1] if shared else self.irradiance), *self.brightness]
        return f"{_CURVE}{'; '.join(' '.join(repr(float(value)) for value in row) for row in rows)}"

    def __repr__(self) -> str:
        return f"ResponseCurve({self.name!r}, {len(self.irradiance)} x {self.irradiance.shape[1]} points)"


def read_response_table(path: Path | str) -> ResponseCurve:
    """Read a text file of two columns (irradiance, brightness) or four (irradiance, brightness of R, G, B).

    Numbers are separated by white space, commas or semicolons; ``#`` starts a comment.

    Raises
    ------
    FileError
        If the file is missing, not text, has lines of other lengths, or the curve does not rise from 0 to 1.
    """
    path = Path(path)
    lines = TextFile(path, FileError).text("a text file with a response curve").splitlines()
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            rows.append([number_of(text) for text in _SEPARATORS.split(line.partition("#")[0].strip()) if text])
        except ArgumentError as error:
            raise FileError(path, f"line {number}: {error}") from error
    rows = [row for row in rows if row]
    widths = {len(row) for row in rows}
    if widths not in ({2}, {4}):
        raise FileError(
            path,
            "expected lines of 2 numbers (irradiance, brightness) or 4 (irradiance, brightness of R, G, B); found "
            f"{'no line of numbers' if not rows else f'lines of {sorted(widths)} numbers'}",
        )
    irradiance, *brightness = np.array(rows).T
    try:
        return ResponseCurve(np.broadcast_to(irradiance, (len(brightness), len(rows))), np.array(brightness), path.stem)
    except ArgumentError as error:
        raise FileError(path, str(error)) from error


@lru_cache(maxsize=8)
def response_of(text: str) -> Response:
    """Make the response that a protocol states: ``gamma-2.2``, or a curve's :attr:`ResponseCurve.text`.

    Raises
    ------
    ArgumentError
        If it is neither, or no curve from 0 to 1.
    """
    try:
        if text.startswith(_GAMMA):
            exponent = number_of(text.removeprefix(_GAMMA))
            if text == f"{_GAMMA}{exponent:g}":
                return Gamma(exponent)
        elif text.startswith(_CURVE):
            rows = [[number_of(value) for value in row.split()] for row in text.removeprefix(_CURVE).split(";")]
            if len(rows) in (2, 4, 6) and len(set(map(len, rows))) == 1:
                values = np.array(rows)
                count = 3 if len(rows) > 2 else 1
                irradiance = np.broadcast_to(values[:-count], (count, values.shape[1]))
                name = f"the protocol's response {sha256(text.encode()).hexdigest()[:8]}"
                return ResponseCurve(irradiance, values[-count:], name)
    except ArgumentError as error:
        raise ArgumentError(f"response: {error}") from error
    raise ArgumentError(
        f"response must be 'gamma-2.2' or another exponent, or the points of a curve; found {text!r:.60}"
    )
