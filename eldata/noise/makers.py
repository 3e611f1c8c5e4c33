"""What makes noise: the model of this package, or a callable of one's own with the same arguments."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from eldata.base.arrays import is_tensor
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise.parameters import NoiseParameters


class NoiseMaker(Protocol):
    """A callable that makes noisy exposures of clean data, for the datasets that take a noise model.

    :class:`~eldata.noise.model.NoiseModel` is one. Another one is a function, or an object with ``__call__``, that can
    be pickled if workers are to have it.

    Called with one image (C, h, w) or one clip (T, C, h, w), float32, normalised, in memory that it may write to, it
    returns an array (or a tensor on the CPU) of the same shape: the exposure, amplified by ``ratio`` back to the
    brightness of the clean data. The dataset clips it, as it says itself. ``parameters``, the draw of the dataset's
    camera (with its ``iso``, where one was drawn), ``ratio`` and ``range_dn``, white minus black in DN, may be used or
    not; they stand in the sample. All random numbers are to come from ``generator``: then an item depends on (seed,
    epoch, index) alone.
    """

    def __call__(
        self,
        clean: NDArray[np.float32],
        /,
        *,
        parameters: NoiseParameters,
        ratio: float,
        range_dn: float,
        generator: np.random.Generator,
    ) -> Any:
        """Return a noisy exposure."""


def check_noise_maker(maker: Any) -> None:
    """Refuse what cannot be called as a :class:`NoiseMaker`.

    Raises
    ------
    ArgumentError
        If it is not callable, or does not take these arguments.
    """
    if isinstance(maker, str):
        raise ArgumentError(f"model={maker!r} is a text; give NoiseModel({maker!r})")
    call = "model(clean, parameters=..., ratio=..., range_dn=..., generator=...)"
    if isinstance(maker, type) or not callable(maker):
        raise ArgumentError(f"model must be a NoiseModel, or an object to be called as {call}; found {maker!r:.100}")
    try:
        signature = inspect.signature(maker)
    except ValueError:  # compiled code need not state it
        return
    try:
        signature.bind(None, parameters=None, ratio=None, range_dn=None, generator=None)
    except TypeError as error:
        raise ArgumentError(f"{maker_name(maker)} cannot be called as {call}: {error}") from error


def made_exposure(maker: NoiseMaker, clean: NDArray[np.float32], **options: Any) -> NDArray[np.float32]:
    """Return what a callable of somebody's own makes of a copy of clean data, as float32.

    Raises
    ------
    ArgumentError
        If that is not an array of the same shape, of floating numbers.
    """
    made = maker(clean.copy(), **options)
    if is_tensor(made):
        made = made.detach().cpu().numpy()
    if not isinstance(made, np.ndarray) or made.shape != clean.shape or made.dtype.kind != "f":
        is_array = isinstance(made, np.ndarray)
        found = f"{made.dtype} of shape {made.shape}" if is_array else type(made).__name__
        raise ArgumentError(
            f"{maker_name(maker)} returned {found}; expected an array like the clean one, {clean.shape}"
        )
    return made.astype(np.float32, copy=False)


def maker_name(maker: Any) -> str:
    """Return what a callable is called: a function's name, or what the object says of itself."""
    name = getattr(maker, "__qualname__", None)
    return name if isinstance(name, str) else repr(maker)
