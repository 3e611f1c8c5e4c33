"""Packed raw to sRGB: the paper's pipeline with explicit parameters, its steps, and a quick look in numpy.

K. Wei et al., TPAMI 2021, section 4.5; order, clips and constants as in the code released with it (ELD repository,
util/process.py). The steps are functions of torch tensors. Each works on any leading dimensions, on the tensor's own
device, in its own floating dtype, and is differentiable, except the two that make 8 bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from eldata.errors import ArgumentError
from eldata.raw.colour import camera_to_srgb
from eldata.raw.levels import packed_forms, packed_layouts

if TYPE_CHECKING:
    from collections.abc import Callable

    import torch
    from numpy.typing import NDArray

    from eldata.records import Matrix3, Sensor

    Response: TypeAlias = Callable[[torch.Tensor], torch.Tensor]
    """What turns linear sRGB in [0, 1], (..., 3, h, w), into display values in [0, 1]."""

# The packed channels of each of R, G, B, by the number of packed channels.
CHANNELS_OF_COLOUR = {
    channels: tuple(tuple(at for at, name in enumerate(sites.names) if name[0] == colour) for colour in "RGB")
    for channels, sites in packed_layouts().items()
}

# Below it the gamma curve is constant, so that its slope stays finite (util/process.py).
GAMMA_FLOOR = 1e-8


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
        """Apply :func:`gamma_curve` to an image."""
        return linear if self.exponent == 1 else gamma_curve(linear, self.exponent)


PAPER_GAMMA = Gamma(2.2)


@dataclass(frozen=True, slots=True)
class Rendering:
    """Packed raw of one camera to sRGB as the paper has it; ``rendering(packed)`` renders.

    White balance, clip to [0, 1], the greens averaged (one RGB pixel per packed pixel), camera to sRGB, clip to [0, 1],
    response.

    Attributes
    ----------
    white_balance
        Multipliers of R, G1, B, G2.
    camera_to_srgb
        Matrix (3, 3) from white-balanced camera R, G, B to linear sRGB (:func:`eldata.raw.colour.camera_to_srgb`).
    response
        Gamma 2.2, or a measured :class:`~eldata.isp.response.ResponseCurve`.

    Raises
    ------
    ArgumentError
        If there are not four positive multipliers and nine finite numbers.

    Examples
    --------
    >>> import torch
    >>> from eldata.isp import Rendering
    >>> from eldata.raw import read_raw
    >>> sensor = read_raw("eldata-demo/data/ELD-demo/DemoAlpha/scene-1/IMG_0001.dng").sensor
    >>> Rendering.of(sensor)(torch.full((4, 8, 8), 0.2)).shape
    torch.Size([3, 8, 8])
    """

    white_balance: tuple[float, float, float, float]
    camera_to_srgb: Matrix3
    response: Response = PAPER_GAMMA

    def __post_init__(self) -> None:
        balance, matrix = np.asarray(self.white_balance, float), np.asarray(self.camera_to_srgb, float)
        if balance.shape != (4,) or not np.all((balance > 0) & np.isfinite(balance)):
            raise ArgumentError(f"white_balance must be four positive multipliers; found {self.white_balance}")
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise ArgumentError(f"camera_to_srgb must be 3 x 3 finite numbers; found {self.camera_to_srgb}")

    @classmethod
    def of(cls, sensor: Sensor, response: Response = PAPER_GAMMA) -> Rendering:
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
                    "Rendering(white_balance, camera_to_srgb) yourself"
                )
        rows = tuple(map(tuple, camera_to_srgb(matrix).tolist()))  # type: ignore[arg-type] # checked above
        return cls(balance, rows, response)  # type: ignore[arg-type] # checked above, 3 x 3

    def __call__(self, packed: torch.Tensor) -> torch.Tensor:
        """Render.

        Parameters
        ----------
        packed
            (..., C, h, w), normalised, floating point: Bayer (C = 4), X-Trans (9), quad-Bayer (16) or nona-Bayer (36).

        Returns
        -------
        Tensor
            (..., 3, h, w) in [0, 1], R, G, B, of the same dtype and on the same device; differentiable.

        Raises
        ------
        ArgumentError
            If the shape or dtype does not fit.
        """
        import torch

        balance = torch.tensor(self.white_balance, dtype=torch.float64)
        matrix = torch.tensor(self.camera_to_srgb, dtype=torch.float64)
        camera = bin_colours(white_balance(packed, balance).clamp(0, 1))
        return self.response(colour_matrix(camera, matrix).clamp(0, 1))


# --- steps ------------------------------------------------------------------------------------------------------------


def white_balance(packed: torch.Tensor, multipliers: torch.Tensor) -> torch.Tensor:
    """Multiply each packed channel by the white balance of its colour.

    Parameters
    ----------
    packed
        (..., C, h, w), normalised: Bayer (C = 4), X-Trans (9), quad-Bayer (16) or nona-Bayer (36).
    multipliers
        (4,): for R, G1, B, G2. X-Trans takes R, G1 and B.

    Returns
    -------
    Tensor
        As ``packed``; not clipped.

    Raises
    ------
    ArgumentError
        If the shape does not fit.
    """
    _check_packed(packed)
    order = list(packed_layouts()[packed.shape[-3]].colours)
    return packed * multipliers.to(packed)[order, None, None]


def bin_colours(packed: torch.Tensor) -> torch.Tensor:
    """Average the packed channels of each colour: one RGB pixel per packed pixel, no demosaicing.

    Bayer: R, (G1 + G2) / 2, B. X-Trans: the means of the 2 reds, 5 greens and 2 blues of a 3 x 3 block; quad and nona:
    those of a period's 4, 8 and 4 or 9, 18 and 9. The paper has Bayer alone.

    Parameters
    ----------
    packed
        (..., C, h, w), C as for :func:`white_balance`.

    Returns
    -------
    Tensor
        (..., 3, h, w), the camera's R, G, B.

    Raises
    ------
    ArgumentError
        If the shape does not fit.
    """
    import torch

    _check_packed(packed)
    indices = CHANNELS_OF_COLOUR[packed.shape[-3]]
    return torch.stack([packed[..., list(channels), :, :].mean(dim=-3) for channels in indices], dim=-3)


def colour_matrix(rgb: torch.Tensor, matrix: torch.Tensor) -> torch.Tensor:
    """Multiply each pixel by a matrix: ``matrix @ rgb``.

    Parameters
    ----------
    rgb
        (..., 3, h, w).
    matrix
        (3, 3).

    Raises
    ------
    ArgumentError
        If a shape does not fit.
    """
    import torch

    if rgb.ndim < 3 or rgb.shape[-3] != 3:
        raise ArgumentError(f"expected an image (..., 3, h, w); found shape {tuple(rgb.shape)}")
    return torch.einsum("ij,...jhw->...ihw", matrix.to(rgb), rgb)


def gamma_curve(linear: torch.Tensor, exponent: float = 2.2) -> torch.Tensor:
    """Raise to a power, ``max(linear, 1e-8) ** (1 / exponent)``."""
    return linear.clamp(min=GAMMA_FLOOR) ** (1 / exponent)


def truncate_to_8_bits(image: torch.Tensor) -> torch.Tensor:
    """Make uint8 codes ``int(255 image)``, clipped to 0 and 255: as the ELD code stores and scores sRGB images.

    The product is formed in float32, as there.

    Raises
    ------
    ArgumentError
        If the image holds NaN or infinities, which have no code.
    """
    import torch

    if not bool(image.isfinite().all()):
        raise ArgumentError("the image holds NaN or infinities, which have no 8-bit code")
    return (image.detach().to(torch.float32) * 255).clamp(0, 255).to(torch.uint8)


def _check_packed(packed: torch.Tensor) -> None:
    """Refuse data other than floating-point, (..., C, h, w), with the channels of a packed CFA."""
    if packed.ndim < 3 or packed.shape[-3] not in CHANNELS_OF_COLOUR:
        forms = packed_forms("(..., {channels}, h, w)")
        raise ArgumentError(f"expected packed data {forms}; found shape {tuple(packed.shape)}")
    if not packed.is_floating_point():
        raise ArgumentError(f"expected normalised floating-point data; found {packed.dtype}")


# --- as the ELD code scores -------------------------------------------------------------------------------------------


def render_pair_for_scoring(
    prediction: NDArray[np.floating[Any]],
    target: NDArray[np.floating[Any]],
    sensor: Sensor,
    *,
    response: Response = PAPER_GAMMA,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Render a packed prediction and its reference to 8-bit sRGB as the ELD code does before it scores them.

    Both are rendered by :class:`Rendering` with the reference file's white balance and matrix
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


# --- a quick look -----------------------------------------------------------------------------------------------------


_DARK, _BRIGHT, _MOST_BRIGHTER = 0.4, 0.6, 8.0


def srgb_encode(linear: NDArray[Any]) -> NDArray[Any]:
    """Apply the sRGB transfer function to linear light in [0, 1] (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def brightening(reference: NDArray[Any]) -> float:
    """Find the factor that makes a dark reference visible, rounded to two digits; 1 of a bright one."""
    light = float(np.quantile(reference, 0.99))
    if light >= _DARK or light <= 0:
        return 1.0
    return float(f"{min(_MOST_BRIGHTER, _BRIGHT / light):.2g}")


def preview(packed: NDArray[np.floating[Any]], sensor: Sensor | None) -> NDArray[np.uint8]:
    """Render packed raw data for viewing: one pixel per packed pixel, no demosaicing.

    Parameters
    ----------
    packed
        (C, h, w), normalised; values outside [0, 1] are clipped.
    sensor
        White balance and colour matrix; without them, or a sensor, the camera's own colours are shown.

    Returns
    -------
    ndarray
        (h, w, 3) uint8, sRGB.

    Raises
    ------
    ArgumentError
        If there are not 4, 9, 16 or 36 channels.
    """
    if packed.ndim != 3 or packed.shape[0] not in CHANNELS_OF_COLOUR:
        raise ArgumentError(f"expected packed data {packed_forms('({channels}, h, w)')}; found shape {packed.shape}")
    clipped = np.clip(packed, 0, 1)
    camera = np.stack([clipped[list(indices)].mean(axis=0) for indices in CHANNELS_OF_COLOUR[packed.shape[0]]])
    if sensor is not None and sensor.white_balance is not None:
        red, green, blue, _ = sensor.white_balance
        # Clipped at the level where the first channel saturates, so that blown highlights stay white.
        camera = np.minimum(camera * np.array([red, green, blue])[:, None, None], 1.0)
    if sensor is not None and sensor.xyz_to_camera is not None:
        camera = np.einsum("ij,jhw->ihw", camera_to_srgb(sensor.xyz_to_camera), camera)
    codes: NDArray[np.uint8] = np.rint(srgb_encode(np.clip(camera, 0, 1)) * 255).astype(np.uint8)
    return codes.transpose(1, 2, 0)
