"""The steps of the paper's raw-to-sRGB pipeline, one function each, on torch tensors.

K. Wei et al., TPAMI 2021, section 4.5; order, clips and constants as in the code released with it (ELD repository,
util/process.py). Each works on any leading dimensions, on the tensor's own device, in its own floating dtype, and is
differentiable, except the last two, which make 8 bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.errors import ArgumentError
from eldata.raw.levels import packed_forms, packed_layouts

if TYPE_CHECKING:
    import torch

# Which of R, G, B (0, 1, 2) each packed channel shows, by the number of packed channels.
COLOUR_OF_CHANNEL = {
    channels: tuple("RGB".index(name[0]) for name in sites.names) for channels, sites in packed_layouts().items()
}
# The packed channels of each of R, G, B.
CHANNELS_OF_COLOUR = {
    channels: tuple(tuple(at for at, colour in enumerate(colours) if colour == wanted) for wanted in range(3))
    for channels, colours in COLOUR_OF_CHANNEL.items()
}

# Below it the gamma curve is constant, so that its slope stays finite (util/process.py).
GAMMA_FLOOR = 1e-8


def white_balance(packed: torch.Tensor, multipliers: torch.Tensor) -> torch.Tensor:
    """Multiply each packed channel by the white balance of its colour.

    Parameters
    ----------
    packed
        (..., C, h, w), normalised: Bayer (C = 4), X-Trans (9), quad-Bayer (16) or nona-Bayer (36).
    multipliers
        (4,), or (N, 4) for a batch of N items: those of R, G1, B, G2. X-Trans takes R, G1 and B.

    Returns
    -------
    Tensor
        As ``packed``; not clipped.

    Raises
    ------
    ArgumentError
        If a shape does not fit.
    """
    _check_packed(packed)
    per_item = _per_item(multipliers, (4,), packed, "the white balance's multipliers")
    order = list(packed_layouts()[packed.shape[-3]].colours)
    return packed * per_item[..., order, None, None]


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
    """Return ``matrix @ rgb`` at each pixel.

    Parameters
    ----------
    rgb
        (..., 3, h, w).
    matrix
        (3, 3), or (N, 3, 3) for a batch of N items.

    Raises
    ------
    ArgumentError
        If a shape does not fit.
    """
    import torch

    if rgb.ndim < 3 or rgb.shape[-3] != 3:
        raise ArgumentError(f"expected an image (..., 3, h, w); found shape {tuple(rgb.shape)}")
    return torch.einsum("...ij,...jhw->...ihw", _per_item(matrix, (3, 3), rgb, "the colour matrix"), rgb)


def gamma_curve(linear: torch.Tensor, exponent: float = 2.2) -> torch.Tensor:
    """Return ``max(linear, 1e-8) ** (1 / exponent)``."""
    return linear.clamp(min=GAMMA_FLOOR) ** (1 / exponent)


def truncate_to_8_bits(image: torch.Tensor) -> torch.Tensor:
    """Return uint8 codes ``int(255 image)``, clipped to 0 and 255: as the ELD code stores and scores sRGB images.

    The product is formed in float32, as there.

    Raises
    ------
    ArgumentError
        If the image holds NaN or infinities, which have no code.
    """
    import torch

    _check_finite(image)
    return (image.detach().to(torch.float32) * 255).clamp(0, 255).to(torch.uint8)


def round_to_8_bits(image: torch.Tensor) -> torch.Tensor:
    """Return uint8 codes ``round(255 image)``, clipped to 0 and 255: the nearest, for saving and looking at.

    Raises
    ------
    ArgumentError
        If the image holds NaN or infinities, which have no code.
    """
    import torch

    _check_finite(image)
    return (image.detach().to(torch.float64) * 255).round().clamp(0, 255).to(torch.uint8)


def _check_packed(packed: torch.Tensor) -> None:
    if packed.ndim < 3 or packed.shape[-3] not in COLOUR_OF_CHANNEL:
        forms = packed_forms("(..., {channels}, h, w)")
        raise ArgumentError(f"expected packed data {forms}; found shape {tuple(packed.shape)}")
    if not packed.is_floating_point():
        raise ArgumentError(f"expected normalised floating-point data; found {packed.dtype}")


def _per_item(values: torch.Tensor, shape: tuple[int, ...], image: torch.Tensor, name: str) -> torch.Tensor:
    """Return values of ``shape``, one set or one per batch item, to broadcast over the image's leading axes."""
    values = values.to(device=image.device, dtype=image.dtype)
    if values.shape == shape:
        return values
    leading = image.shape[:-3]
    if values.shape[1:] == shape and leading and values.shape[0] == leading[0]:
        return values.reshape(leading[0], *(1,) * (len(leading) - 1), *shape)
    raise ArgumentError(
        f"{name} must have shape {shape}, or {('N', *shape)} for a batch of N items; found "
        f"{tuple(values.shape)} for images {tuple(image.shape)}"
    )


def _check_finite(image: torch.Tensor) -> None:
    if not bool(image.isfinite().all()):
        raise ArgumentError("the image holds NaN or infinities, which have no 8-bit code")
