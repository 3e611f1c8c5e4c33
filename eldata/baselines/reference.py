"""The network that ships with the package, to score beside others."""

from __future__ import annotations

from importlib.resources import as_file, files
from typing import TYPE_CHECKING

from safetensors.torch import load_file, save_file

from eldata.baselines.unet import UNet
from eldata.errors import FileError

if TYPE_CHECKING:
    from pathlib import Path

_WEIGHTS = "reference.safetensors"


def blank_reference(seed: int = 0) -> UNet:
    """Return the network with its first weights, as its training begins."""
    return UNet(4, width=14, depth=3, residual=True, bias=False, seed=seed)


def reference_network() -> UNet:
    """Return a small U-Net for Bayer cameras that was trained on the noise of virtual cameras alone.

    368,648 parameters. It takes (N, 4, h, w) float32 of any camera, packed, black 0 and white 1, amplified and not
    clipped, in sides that are multiples of 8, and saw no real photograph. docs/proof.md has its card: how it was
    trained, what it scores, and where it fails.

    Raises
    ------
    FileError
        If its weights are not there or not its own: the installation is damaged.

    Examples
    --------
    >>> from eldata.baselines import reference_network
    >>> sum(weights.numel() for weights in reference_network().parameters())
    368648
    """
    network = blank_reference()
    with as_file(files("eldata.baselines") / _WEIGHTS) as path:
        try:
            network.load_state_dict(load_file(path))
        except Exception as error:  # safetensors and torch raise what their parts raise
            raise FileError(path, f"is not what was shipped; install eldata again ({type(error).__name__})") from error
    return network


def save_weights(network: UNet, path: Path) -> None:
    """Write a network's weights in half precision, as they ship: half of the size, and rounded by 5e-4 of each."""
    save_file({name: value.half().contiguous() for name, value in network.state_dict().items()}, path)
