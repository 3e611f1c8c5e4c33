"""The composed noise model: clean raw data in, noisy raw data out.

``I = y range / (ratio K)`` photoelectrons; ``D = K shot(I) + N_read + N_row + N_q`` in DN above black; the result is
``D ratio / range``, amplified back to the clean image's brightness (K. Wei et al., TPAMI 2021, sections
3.1 and 3.2.3).

Two engines draw the same distributions:

compiled
    numpy arrays and torch tensors on the CPU. Counter-based: each pixel's numbers depend on the seed, the image's place
    in the batch and the pixel's place alone, so the result is the same to the bit for any number of threads.
torch
    tensors on any other device, by torch's own operations there. The same generator state gives the same result on
    the same device and version of torch; it is another stream than the compiled engine's.
"""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eldata.base.numbers import checked_number, checked_whole
from eldata.errors import ArgumentError, check_choice
from eldata.noise.components import Components, parse_components
from eldata.noise.exposures import (
    Adc,
    DarkCrops,
    DarkSource,
    Exposures,
    check_normalised,
    common_range_dn,
    drawn_dark,
    one_each,
    read_variance_dn2,
)
from eldata.noise.mosaic import pack_whole, packed_rows, unpack_whole
from eldata.noise.parameters import Generator, NoiseParameters, key_from
from eldata.raw.levels import CLIP_RANGES

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from numpy.typing import NDArray

    from eldata.raw.levels import Cfa, Clip

Image = TypeVar("Image", "NDArray[Any]", "torch.Tensor")


class NoiseModel:
    """The noise model with the components of a spec (:mod:`eldata.noise.components`).

    Parameters
    ----------
    spec
        Such as ``"P*+G*+B+R+U"``, the full model.
    clip
        Of the result: ``"none"``, ``"upper"`` (at 1: negative read noise is kept) or ``"both"`` ([0, 1], what the
        published ELD loader gives a network). ``None``, the default, leaves it to who uses the model: called by itself
        it does not clip, and a dataset clips as its own ``clip`` says.
    adc
        Round to whole DN (the parameters' step) and saturate as a converter does, in place of component U.
    dark_frames
        The frames of component D: :class:`eldata.datasets.DarkFrames`.

    Raises
    ------
    ArgumentError
        If the spec or the clip is unknown, ``adc`` is not an :class:`Adc`, the spec has U and there is one too, or D
        without dark frames, or these without D.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.noise import CameraProfile, NoiseModel
    >>> generator = np.random.default_rng(0)
    >>> parameters = CameraProfile.load("SonyA7S2").sample(generator)
    >>> clean = np.full((4, 64, 64), 0.2, dtype=np.float32)
    >>> noisy = NoiseModel()(clean, parameters=parameters, ratio=100.0, generator=generator)
    >>> noisy.shape, noisy.dtype
    ((4, 64, 64), dtype('float32'))
    """

    def __init__(
        self,
        spec: str = "P*+G*+B+R+U",
        *,
        clip: Clip | None = None,
        adc: Adc | None = None,
        dark_frames: DarkSource | None = None,
    ) -> None:
        self.components: Components = parse_components(spec)
        if clip is not None:
            check_choice("clip", clip, CLIP_RANGES)
        if adc is not None and not isinstance(adc, Adc):
            raise ArgumentError(f"adc must be an Adc, such as Adc(512, 16383); found {adc!r:.100}")
        if adc is not None and self.components.quantisation:
            raise ArgumentError(
                f"noise model {spec!r}: U stands for the converter's rounding; leave it out with adc=..."
            )
        if self.components.dark and not callable(getattr(dark_frames, "draw", None)):
            raise ArgumentError(
                f"noise model {spec!r}: D takes real frames; give dark_frames=DarkFrames(...) of eldata.datasets; "
                f"found {dark_frames!r:.100}"
            )
        if dark_frames is not None and not self.components.dark:
            raise ArgumentError(f"noise model {spec!r} takes no dark frames: it has no component D, as 'P*+D' has")
        if adc is not None and dark_frames is not None and not dark_frames.dither:
            raise ArgumentError(
                "adc rounds what dark frames and photons add up to, and without a dither it would round single photons "
                "away; leave dither=False out"
            )
        self.clip: Clip | None = clip
        self.adc = adc
        self.dark_frames = dark_frames

    def __repr__(self) -> str:
        names = ("clip", "adc", "dark_frames")
        options = [f", {name}={value!r}" for name in names if (value := getattr(self, name)) is not None]
        return f"NoiseModel({self.components.spec!r}{''.join(options)})"

    def with_clip(self, clip: Clip) -> NoiseModel:
        """Return this model with another clip."""
        check_choice("clip", clip, CLIP_RANGES)
        changed = copy.copy(self)
        changed.clip = clip
        return changed

    def __call__(
        self,
        clean: Image,
        *,
        parameters: NoiseParameters | Sequence[NoiseParameters],
        ratio: float | Sequence[float],
        generator: Generator | list[Generator] | tuple[Generator, ...],
        range_dn: float | Sequence[float] | None = None,
        threads: int | None = None,
        dark: DarkCrops | None = None,
        out: NDArray[np.float32] | None = None,
    ) -> Image:
        """Return a noisy exposure of clean packed data.

        Parameters
        ----------
        clean
            (..., C, h, w), normalised, C = 4, 9, 16 or 36 (:mod:`eldata.raw.levels`); a numpy array or a torch tensor
            of floating numbers: whole numbers are DN, which are refused. Leading dimensions are images of a batch or
            frames of a clip; each gets fresh noise. Values below 0 count as no light.
        parameters
            One draw for everything (a clip), or one for each image of a batch (N, C, h, w).
        ratio
            Exposure ratio, above 0: one, or one for each image.
        generator
            numpy's or torch's; for a tensor on another device than the CPU, a torch generator of that device. Several,
            on the CPU: each for as many images in turn, whose noise is to the bit what a call for them alone gives.
        range_dn
            White level minus black level, DN, one, or one for each image; by default that of the camera whose profile
            the parameters come from.
        threads
            Of the compiled engine, 1 or more; default one per CPU. The result does not depend on it.
        dark
            With component D: crops of dark frames that somebody drew, one for each image, of its shape. By default they
            are drawn here, of the parameters' ISO; images that have one draw of parameters together, a clip, get
            different frames, from one place of them.
        out
            Of an array: where to write, C-contiguous float32 of its shape, and not its memory. The pages of a new array
            cost as much as a sixth of the noise.

        Returns
        -------
        ndarray or Tensor
            As ``clean``: shape, device and dtype; computed in float32. Detached. Or ``out``.

        Raises
        ------
        ArgumentError
            If shapes, dtype, parameters, ratio, range, generator, threads, dark frames or ``out`` do not fit.
        """
        check_normalised(clean)
        if clean.ndim < 3:
            raise ArgumentError(f"expected clean data (..., C, h, w); found shape {tuple(clean.shape)}")
        images = math.prod(clean.shape[:-3])
        channels = int(clean.shape[-3])
        packed_rows(channels)  # refuses another number of channels
        drawn = one_each(parameters, images, "parameters")
        if not all(isinstance(item, NoiseParameters) for item in drawn):
            raise ArgumentError(f"parameters must be NoiseParameters, one or one for each image; found {parameters!r}")
        ratios = [checked_number("ratio", value, above=0) for value in one_each(ratio, images, "ratio")]
        given = [common_range_dn(drawn)] if range_dn is None else one_each(range_dn, max(images, 1), "range_dn")
        ranges = [checked_number("range_dn", value, above=0) for value in given]
        several = list(generator) if isinstance(generator, (list, tuple)) else [generator]
        draws = dark is None and self.dark_frames is not None  # frames are drawn here once for all images
        if len(several) != 1 and (not several or images % len(several) or draws):
            raise ArgumentError(
                f"expected one generator, or several, each for as many of {images} images; found {len(several)}"
            )
        if threads is not None:
            checked_whole("threads", threads, at_least=1)
        packed = (channels, int(clean.shape[-2]), int(clean.shape[-1]))
        if dark is not None:
            self._check_dark(dark, images, packed)
        elif self.dark_frames is not None and images:
            source = np.random.default_rng(key_from(several[0]))
            dark = drawn_dark(self.dark_frames, drawn, isinstance(parameters, NoiseParameters), packed, source)
        exposures = Exposures.of(
            self.components,
            drawn,
            ratios,
            channels,
            range_dn=ranges if len(set(ranges)) > 1 else ranges[0],
            adc=self.adc,
            limits=CLIP_RANGES[self.clip or "none"],
            dark=dark,
            dithers=self.dark_frames is not None and self.dark_frames.dither,
        )
        if out is not None:
            _check_out(out, clean)
        if isinstance(clean, np.ndarray):
            drawn_in_numpy = _in_numpy(clean, exposures, several, threads, out)
            return drawn_in_numpy if out is not None else drawn_in_numpy.astype(clean.dtype, copy=False)
        noisy: Image = _in_torch(clean, exposures, several, threads)
        return noisy

    def _check_dark(self, dark: Any, images: int, packed: tuple[int, int, int]) -> None:
        if self.dark_frames is None:
            raise ArgumentError(f"dark= is for models with component D; this is {self!r}")
        found = dark.dn.shape if isinstance(dark, DarkCrops) else type(dark).__name__
        if found != (images, *packed):
            raise ArgumentError(f"dark must be DarkCrops of shape {(images, *packed)}; found {found}")

    def on_mosaic(
        self,
        clean: Image,
        *,
        cfa: Cfa,
        parameters: NoiseParameters | Sequence[NoiseParameters],
        ratio: float | Sequence[float],
        generator: Generator,
        range_dn: float | None = None,
        threads: int | None = None,
    ) -> Image:
        """Return a noisy exposure of clean mosaics (..., H, W), normalised, of any size and CFA phase.

        ``cfa`` is that of pixel (0, 0), as :attr:`eldata.records.Sensor.cfa`. Everything else is as for packed data:
        the mosaic is packed, exposed and put together again, and no pixel is left out.

        Raises
        ------
        ArgumentError
            As for packed data, or if the CFA is unsupported.
        """
        check_normalised(clean)
        noisy = self(
            pack_whole(clean, cfa),
            parameters=parameters,
            ratio=ratio,
            range_dn=range_dn,
            generator=generator,
            threads=threads,
        )
        return unpack_whole(noisy, cfa, (clean.shape[-2], clean.shape[-1]))

    def expected_mean_dn(self, signal_e: float, parameters: NoiseParameters, channel: int = 0) -> float:
        """Return the closed-form mean of D, in DN above black: K I, plus the bias of a Bayer channel.

        Raises
        ------
        ArgumentError
            If the model has dark frames, whose mean is their own.
        """
        self._check_closed()
        bias = parameters.colour_bias_dn[channel] if self.components.colour_bias else 0.0
        return parameters.gain_dn_per_e * signal_e + bias

    def expected_variance_dn2(self, signal_e: float, parameters: NoiseParameters) -> float:
        """Return the closed-form variance of D over pixels and rows, in DN^2 (without saturation).

        ``K (K I) + sigma_TL^2 Var(TL) + sigma_row^2 + q^2/12``, each term if its component is there. For an ``adc``
        q^2/12 is an approximation, good where the other noise is above half a step q.

        Raises
        ------
        ArgumentError
            If the model has dark frames, whose variance is their own.
        """
        self._check_closed()
        parts = self.components
        gain = parameters.gain_dn_per_e
        shot = gain * gain * signal_e if parts.shot != "none" else 0.0
        read = read_variance_dn2(parts, parameters)
        row = parameters.sigma_row_dn**2 if parts.row else 0.0
        quantisation = parameters.quantisation_step_dn**2 / 12 if parts.quantisation or self.adc is not None else 0.0
        return shot + read + row + quantisation

    def _check_closed(self) -> None:
        if self.components.dark:
            raise ArgumentError(f"noise model {self.components.spec!r}: there is no closed form for real dark frames")


def _in_numpy(
    clean: NDArray[Any],
    exposures: Exposures,
    generators: Sequence[Generator],
    threads: int | None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    from eldata.noise.compiled import expose_compiled

    shape = math.prod(clean.shape[:-3]), *clean.shape[-3:]
    flat = np.ascontiguousarray(clean, dtype=np.float32).reshape(shape)
    keys = [key_from(generator) for generator in generators] if len(flat) else [0]
    target = None if out is None else out.reshape(shape)
    return expose_compiled(flat, exposures, key=keys, threads=threads, out=target).reshape(clean.shape)


def _in_torch(clean: Any, exposures: Exposures, generators: Sequence[Generator], threads: int | None) -> Any:
    import torch

    numbers = clean.detach().to(torch.float32)
    if clean.device.type == "cpu":
        return torch.from_numpy(_in_numpy(numbers.numpy(), exposures, generators, threads)).to(clean.dtype)
    from eldata.noise.on_device import expose_on_device

    generator = generators[0]
    if len(generators) > 1 or not isinstance(generator, torch.Generator) or generator.device.type != clean.device.type:
        raise ArgumentError(f"clean is on {clean.device}: give a torch.Generator of that device")
    drawn = expose_on_device(numbers.reshape(-1, *clean.shape[-3:]), exposures, generator)
    return drawn.reshape(clean.shape).to(clean.dtype)


def _check_out(out: Any, clean: Any) -> None:
    if not isinstance(clean, np.ndarray):
        raise ArgumentError("out= is for arrays; of a tensor leave it out")
    fits = isinstance(out, np.ndarray) and out.shape == clean.shape and out.dtype == np.float32
    if not fits or not out.flags.c_contiguous or not out.flags.writeable or np.may_share_memory(out, clean):
        found = f"{out.dtype} {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        raise ArgumentError(
            f"out must be a writeable C-contiguous float32 array of shape {clean.shape} with memory of its own; found "
            f"{found}"
        )
