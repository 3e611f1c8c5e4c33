"""The composed noise model: clean raw data in, noisy raw data out.

``I = y range / (ratio K)`` photoelectrons; ``D = K shot(I) + N_read + N_row + N_q`` in DN above black; the result is
``D ratio / range``, amplified back to the clean image's brightness (K. Wei et al., TPAMI 2021, section 3).

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
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eldata.base.numbers import checked_number, checked_whole
from eldata.base.tensors import is_tensor
from eldata.errors import ArgumentError, check_choice
from eldata.noise.components import Components, parse_components
from eldata.noise.exposures import Adc, DarkCrops, Exposures
from eldata.noise.packed_rows import packed_rows
from eldata.noise.parameters import NoiseParameters, tukey_lambda_variance
from eldata.noise.randomness import Generator, key_from
from eldata.raw.cfa import CLIP_RANGES

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from eldata.noise.makers import DarkSource
    from eldata.raw.cfa import Cfa, Clip

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
        Round to whole DN and saturate as a converter does, in place of component U.
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
        generator: Generator,
        range_dn: float | None = None,
        threads: int | None = None,
        dark: DarkCrops | None = None,
    ) -> Image:
        """Return a noisy exposure of clean packed data.

        Parameters
        ----------
        clean
            (..., C, h, w), normalised, C = 4, 9, 16 or 36 (:mod:`eldata.raw.cfa`); a numpy array or a torch tensor of
            floating numbers: whole numbers are DN, which are refused. Leading dimensions are images of a batch or
            frames of a clip; each gets fresh noise. Values below 0 count as no light.
        parameters
            One draw for everything (a clip), or one for each image of a batch (N, C, h, w).
        ratio
            Exposure ratio, above 0: one, or one for each image.
        generator
            numpy's or torch's; for a tensor on another device than the CPU, a torch generator of that device.
        range_dn
            White level minus black level, DN; by default that of the camera whose profile the parameters come from.
        threads
            Of the compiled engine, 1 or more; default one per CPU. The result does not depend on it.
        dark
            With component D: crops of dark frames that somebody drew, one for each image, of its shape. By default they
            are drawn here, of the parameters' ISO; images that have one draw of parameters together, a clip, get
            different frames, from one place of them.

        Returns
        -------
        ndarray or Tensor
            As ``clean``: shape, device and dtype; computed in float32. Detached.

        Raises
        ------
        ArgumentError
            If shapes, dtype, parameters, ratio, range, generator, threads or dark frames do not fit.
        """
        check_normalised(clean)
        if clean.ndim < 3:
            raise ArgumentError(f"expected clean data (..., C, h, w); found shape {tuple(clean.shape)}")
        images = math.prod(clean.shape[:-3])
        channels = int(clean.shape[-3])
        packed_rows(channels)  # refuses another number of channels
        drawn = _one_each(parameters, images, "parameters")
        if not all(isinstance(item, NoiseParameters) for item in drawn):
            raise ArgumentError(f"parameters must be NoiseParameters, one or one for each image; found {parameters!r}")
        ratios = [checked_number("ratio", value, above=0) for value in _one_each(ratio, images, "ratio")]
        range_dn = _range_dn(drawn) if range_dn is None else checked_number("range_dn", range_dn, above=0)
        if threads is not None:
            checked_whole("threads", threads, at_least=1)
        packed = (channels, int(clean.shape[-2]), int(clean.shape[-1]))
        if dark is not None:
            self._check_dark(dark, images, packed)
        elif self.dark_frames is not None and images:
            source = np.random.default_rng(key_from(generator))
            dark = _drawn_dark(self.dark_frames, drawn, isinstance(parameters, NoiseParameters), packed, source)
        exposures = Exposures.of(
            self.components,
            drawn,
            ratios,
            channels,
            range_dn=range_dn,
            adc=self.adc,
            limits=CLIP_RANGES[self.clip or "none"],
            dark=dark,
            dithers=self.dark_frames is not None and self.dark_frames.dither,
        )
        if isinstance(clean, np.ndarray):
            return _in_numpy(clean, exposures, generator, threads).astype(clean.dtype, copy=False)
        import torch

        if clean.device.type == "cpu":
            drawn_here = torch.from_numpy(
                _in_numpy(clean.detach().to(torch.float32).numpy(), exposures, generator, threads)
            )
        else:
            from eldata.noise.on_device import expose_on_device

            if not isinstance(generator, torch.Generator) or generator.device.type != clean.device.type:
                raise ArgumentError(f"clean is on {clean.device}: give a torch.Generator of that device")
            flat = clean.detach().to(torch.float32).reshape(images, *clean.shape[-3:])
            drawn_here = expose_on_device(flat, exposures, generator).reshape(clean.shape)
        return drawn_here.to(clean.dtype)

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
        from eldata.noise.mosaic import pack_whole, unpack_whole

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

        ``K (K I) + sigma_TL^2 Var(TL) + sigma_row^2 + 1/12``, each term if its component is there. For an ``adc`` 1/12
        is an approximation, good where the other noise is above half a DN.

        Raises
        ------
        ArgumentError
            If the model has dark frames, whose variance is their own.
        """
        self._check_closed()
        parts = self.components
        gain = parameters.gain_dn_per_e
        shot = gain * gain * signal_e if parts.shot != "none" else 0.0
        read = {
            "none": 0.0,
            "gaussian": parameters.sigma_gauss_dn**2,
            "tukey-lambda": parameters.sigma_tl_dn**2 * tukey_lambda_variance(parameters.tukey_lambda),
        }[parts.read]
        row = parameters.sigma_row_dn**2 if parts.row else 0.0
        quantisation = 1 / 12 if parts.quantisation or self.adc is not None else 0.0
        return shot + read + row + quantisation

    def _check_closed(self) -> None:
        if self.components.dark:
            raise ArgumentError(f"noise model {self.components.spec!r}: there is no closed form for real dark frames")


def check_normalised(clean: Any, name: str = "clean") -> None:
    """Refuse what cannot be normalised data.

    Raises
    ------
    ArgumentError
        If it is neither an array nor a tensor, or of anything but floating numbers.
    """
    if is_tensor(clean):
        is_float, is_whole = clean.is_floating_point(), not clean.is_complex()
    elif isinstance(clean, np.ndarray):
        is_float, is_whole = clean.dtype.kind == "f", clean.dtype.kind in "iu"
    else:
        raise ArgumentError(f"{name} must be a numpy array or a torch tensor, not {type(clean).__name__}")
    if is_float:
        return
    if is_whole:
        raise ArgumentError(
            f"{name} is {clean.dtype}, whole numbers as a file has them, and expected is normalised data, where 0 is "
            "black and 1 is white; give (clean - black) / (white - black) in float32, as eldata.raw.normalise makes it "
            "of packed DN and eldata.raw.pack_normalised of a mosaic"
        )
    raise ArgumentError(f"{name} is {clean.dtype}; expected floating numbers, such as float32, where 1 is white")


def _in_numpy(
    clean: NDArray[Any], exposures: Exposures, generator: Generator, threads: int | None
) -> NDArray[np.float32]:
    from eldata.noise.compiled import expose_compiled

    flat = np.ascontiguousarray(clean, dtype=np.float32).reshape(math.prod(clean.shape[:-3]), *clean.shape[-3:])
    return expose_compiled(flat, exposures, key=key_from(generator), threads=threads).reshape(clean.shape)


def _drawn_dark(
    source: DarkSource,
    drawn: Sequence[NoiseParameters],
    is_clip: bool,
    packed: tuple[int, int, int],
    generator: np.random.Generator,
) -> DarkCrops:
    """Return a dark crop for each image."""

    def of(parameters: NoiseParameters, count: int) -> DarkCrops:
        if parameters.iso is None:
            raise ArgumentError(
                "component D takes dark frames of the parameters' ISO, and they do not state it; draw them at one, as "
                "profile.sample(generator, iso=800) does"
            )
        return source.draw(parameters.iso, count, packed, generator)

    if is_clip or len(drawn) == 1:
        return of(drawn[0], len(drawn))
    each = [of(parameters, 1) for parameters in drawn]
    black = np.concatenate([one.black_level_dn for one in each])
    return DarkCrops(np.concatenate([one.dn for one in each]), black)


def _range_dn(drawn: Sequence[NoiseParameters]) -> float:
    """Return the range from black to white that the parameters bring with them."""
    known = {item.range_dn for item in drawn}
    if len(known) == 1 and (range_dn := known.pop()) is not None:
        return range_dn
    found = "differ in it" if len(known) > 1 else "do not know it (their profile states no levels)"
    raise ArgumentError(f"give range_dn, the white level minus the black level in DN: the parameters {found}")


def _one_each(value: Any, images: int, name: str) -> list[Any]:
    if isinstance(value, np.ndarray) or is_tensor(value):
        value = value.tolist()
    if isinstance(value, str) or not isinstance(value, Sequence):
        return [value] * images
    if len(value) != images:
        raise ArgumentError(f"{name}: expected one, or one for each of {images} images; found {len(value)}")
    return list(value)
