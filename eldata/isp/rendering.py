"""The paper's raw-to-sRGB pipeline as one object with explicit parameters, and pairs of images as it scores them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from eldata.errors import ArgumentError
from eldata.isp.steps import bin_colours, colour_matrix, gamma_curve, truncate_to_8_bits, white_balance
from eldata.raw.colour import camera_to_srgb

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from numpy.typing import NDArray

    from eldata.records import Matrix3, Sensor


class Response(Protocol):
    """What turns linear sRGB in [0, 1] into display values in [0, 1]: :class:`Gamma`, or a measured curve."""

    def __call__(self, linear: torch.Tensor) -> torch.Tensor:
        """Return the display values of (..., 3, h, w) linear ones."""

    def describe(self) -> str:
        """Say in a few words what it is."""


@dataclass(frozen=True, slots=True)
class Gamma:
    """A power law, ``max(x, 1e-8) ** (1 / exponent)``; 2.2 is the ELD code's, 1 leaves linear light as it is.

    Examples
    --------
    >>> import torch
    >>> from eldata.isp import Gamma
    >>> Gamma(2.0)(torch.tensor([0.25, 1.0]))
    tensor([0.5000, 1.0000])
    """

    exponent: float = 2.2

    def __post_init__(self) -> None:
        if not 0 < self.exponent < np.inf:
            raise ArgumentError(f"the exponent of a gamma curve must be positive; found {self.exponent}")

    def __call__(self, linear: torch.Tensor) -> torch.Tensor:
        """Return :func:`eldata.isp.steps.gamma_curve` of the image."""
        return linear if self.exponent == 1 else gamma_curve(linear, self.exponent)

    def describe(self) -> str:
        """Say in a few words what it is."""
        return "no tone curve (linear)" if self.exponent == 1 else f"gamma {self.exponent:g}"


PAPER_GAMMA = Gamma(2.2)


@dataclass(frozen=True, slots=True)
class CameraColour:
    """What turns one camera's packed values into linear sRGB.

    Attributes
    ----------
    white_balance
        Multipliers of R, G1, B, G2.
    camera_to_srgb
        Matrix (3, 3) from white-balanced camera R, G, B to linear sRGB (:func:`eldata.raw.colour.camera_to_srgb`).

    Raises
    ------
    ArgumentError
        If there are not four positive multipliers and nine finite numbers.
    """

    white_balance: tuple[float, float, float, float]
    camera_to_srgb: Matrix3

    def __post_init__(self) -> None:
        balance, matrix = np.asarray(self.white_balance, float), np.asarray(self.camera_to_srgb, float)
        if balance.shape != (4,) or not np.all((balance > 0) & np.isfinite(balance)):
            raise ArgumentError(f"white_balance must be four positive multipliers; found {self.white_balance}")
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise ArgumentError(f"camera_to_srgb must be 3 x 3 finite numbers; found {self.camera_to_srgb}")

    @classmethod
    def of(cls, sensor: Sensor) -> CameraColour:
        """Take white balance and matrix from what a file says of its sensor.

        Raises
        ------
        ArgumentError
            If the sensor lacks one of them: there is no neutral stand-in for either.
        """
        camera = f"{sensor.make} {sensor.model}".strip() or "an unnamed camera"
        balance, matrix = sensor.white_balance, sensor.xyz_to_camera
        for name, value in (("white balance", balance), ("colour matrix (xyz_to_camera)", matrix)):
            if value is None:
                raise ArgumentError(
                    f"the sensor record of {camera} has no {name}; take it from another file of that camera, or give "
                    "CameraColour(white_balance, camera_to_srgb) yourself"
                )
        rows = tuple(map(tuple, camera_to_srgb(matrix).tolist()))  # type: ignore[arg-type] # checked above
        return cls(balance, rows)  # type: ignore[arg-type] # checked above, 3 x 3


@dataclass(frozen=True, slots=True)
class Rendering:
    """Packed raw to sRGB as the paper has it; ``rendering(packed)`` renders.

    White balance, clip to [0, 1], the greens averaged (one RGB pixel per packed pixel), camera to sRGB, clip to [0, 1],
    response.

    Attributes
    ----------
    colours
        One camera's colour for all images, or one for each item of a batch, in its order.
    response
        Gamma 2.2, or a measured :class:`~eldata.isp.response.ResponseCurve`.

    Examples
    --------
    >>> import torch
    >>> from eldata.isp import Rendering
    >>> from eldata.raw import read_raw
    >>> sensor = read_raw("eldata-demo/data/ELD-demo/DemoAlpha/scene-1/IMG_0001.dng").sensor
    >>> Rendering.of(sensor)(torch.full((4, 8, 8), 0.2)).shape
    torch.Size([3, 8, 8])
    """

    colours: tuple[CameraColour, ...]
    response: Response = PAPER_GAMMA

    def __post_init__(self) -> None:
        if not self.colours:
            raise ArgumentError("a rendering needs the colour of one camera or of each item of a batch; found none")

    @classmethod
    def of(cls, sensors: Sensor | Sequence[Sensor], response: Response = PAPER_GAMMA) -> Rendering:
        """Return the rendering with the white balance and matrix of a sensor, or of one sensor per batch item.

        Raises
        ------
        ArgumentError
            If a sensor lacks one of them.
        """
        from eldata.records import Sensor as SensorRecord

        each = (sensors,) if isinstance(sensors, SensorRecord) else tuple(sensors)
        return cls(tuple(CameraColour.of(sensor) for sensor in each), response)

    def linear(self, packed: torch.Tensor) -> torch.Tensor:
        """Return linear sRGB, clipped to [0, 1]: everything but the response. Arguments and errors are a call's."""
        import torch

        def values(name: str) -> torch.Tensor:
            each = [getattr(colour, name) for colour in self.colours]
            return torch.tensor(each if len(each) > 1 else each[0], dtype=torch.float64)

        balanced = white_balance(packed, values("white_balance")).clamp(0, 1)
        return colour_matrix(bin_colours(balanced), values("camera_to_srgb")).clamp(0, 1)

    def __call__(self, packed: torch.Tensor) -> torch.Tensor:
        """Render.

        Parameters
        ----------
        packed
            (..., C, h, w), normalised, floating point: Bayer (C = 4), X-Trans (9), quad-Bayer (16) or nona-Bayer (36).
            With several cameras the first dimension counts them.

        Returns
        -------
        Tensor
            (..., 3, h, w) in [0, 1], R, G, B, of the same dtype and on the same device; differentiable.

        Raises
        ------
        ArgumentError
            If the shape or dtype does not fit, or the batch does not have one item per camera.
        """
        return self.response(self.linear(packed))

    def describe(self) -> str:
        """Say in words what is done with which numbers."""

        def numbers(values: Sequence[float]) -> str:
            return ", ".join(f"{value:.4g}" for value in values)

        first = self.colours[0]
        others = f" (item 1 of {len(self.colours)}, each with its own)" if len(self.colours) > 1 else ""
        rows = "; ".join(numbers(row) for row in first.camera_to_srgb)
        return (
            f"white balance R, G1, B, G2 = {numbers(first.white_balance)}{others}; clip to [0, 1]; greens averaged, "
            f"one RGB pixel per packed pixel; camera to sRGB [{rows}]{others}; clip to [0, 1]; "
            f"{self.response.describe()}"
        )


# --- as the ELD code scores -------------------------------------------------------------------------------------------


def render_pair_for_scoring(
    prediction: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    sensor: Sensor,
    *,
    response: Response = PAPER_GAMMA,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Render a packed prediction and its reference to 8-bit sRGB as the ELD code does before it scores them.

    Both are rendered by :class:`~eldata.isp.rendering.Rendering` with the reference file's white balance and matrix
    (the paper's "oracle white balance") and truncated, not rounded, to 8 bits (ELD repository, models/ELD_model.py and
    util/process.py, stage_eval = srgb). A prediction that is rescaled is rescaled first, in raw. There the sums are
    float32; here they are float64 up to the 8 bits, so that the codes do not depend on the machine.

    Parameters
    ----------
    prediction, target
        Packed and normalised, (C, h, w), of the same shape. Values outside [0, 1] are clipped after white
        balance. The ELD code has this for Bayer alone.
    sensor
        The reference's.
    response
        Gamma 2.2, the code's default, or a measured curve, which the paper's tables were made with.

    Returns
    -------
    (ndarray, ndarray)
        (3, h, w) uint8 each, R, G, B. Score them as floating point on data range 255.

    Raises
    ------
    ArgumentError
        If the shapes do not fit or differ, a value is NaN or infinite, or the sensor lacks white balance or matrix.
    """
    if prediction.shape != target.shape or target.ndim != 3:
        raise ArgumentError(
            f"expected a prediction and a reference (C, h, w) of one shape; found {prediction.shape} and {target.shape}"
        )
    return (
        render_to_8_bits(prediction, sensor, response=response, name="prediction"),
        render_to_8_bits(target, sensor, response=response, name="reference"),
    )


def render_to_8_bits(
    packed: NDArray[np.floating[Any]], sensor: Sensor, *, response: Response = PAPER_GAMMA, name: str = "image"
) -> NDArray[np.uint8]:
    """Render a packed image, (C, h, w), with a sensor's colours to (3, h, w) uint8 codes, truncated; see above.

    Raises
    ------
    ArgumentError
        If a value is NaN or infinite (``name`` is what the image is called then), the shape does not fit, or the sensor
        lacks white balance or matrix.
    """
    import torch

    if not np.isfinite(packed).all():  # before the clips, which infinities pass
        raise ArgumentError(f"the {name} holds NaN or infinities")
    wide = np.ascontiguousarray(packed, dtype=np.float64)
    with torch.no_grad():
        codes: NDArray[np.uint8] = truncate_to_8_bits(Rendering.of(sensor, response)(torch.from_numpy(wide))).numpy()
    return codes
