"""The composed noise model: clean raw data in, noisy raw data out.

What it draws is defined in :mod:`eldata.noise.components` (K. Wei et al., TPAMI 2021, sections 3.1 and 3.2.3). Two
engines draw the same distributions:

compiled
    numpy arrays and torch tensors on the CPU. Counter-based: each pixel's numbers depend on the seed, the image's place
    in the batch and the pixel's place alone, so the result is the same to the bit for any number of threads.
torch
    tensors on any other device, by torch's own operations there. The same generator state gives the same result on
    the same device and version of torch; it is another stream than the compiled engine's.
"""

from __future__ import annotations

import copy
import inspect
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from eldata.base.arrays import is_tensor
from eldata.base.numbers import checked_whole
from eldata.base.visible import name_of
from eldata.errors import ArgumentError, check_choice
from eldata.noise.components import packed_rows, parse_components
from eldata.noise.parameters import Adc, Generator, NoiseDraw, NoiseParameters, key_from
from eldata.raw.levels import CLIP_RANGES, packing_sites

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from eldata.raw.levels import Cfa, Clip

Image = TypeVar("Image", "NDArray[Any]", "torch.Tensor")


class DarkSource(Protocol):
    """Where component D of a noise model has its frames from; :class:`eldata.datasets.DarkFrames` is one."""

    @property
    def dither(self) -> bool:
        """Whether the frames are dithered, by U over one step of their values."""

    def draw(
        self, iso: float, count: int, shape: tuple[int, int, int], generator: np.random.Generator
    ) -> NDArray[np.float32]:
        """Draw crops (count, C, h, w) of as many frames of an ISO, from one place of them, in DN above black."""


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
        Round to whole DN (the parameters' step) and saturate as a converter does, instead of component U.
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
        self.components = parse_components(spec)
        if clip is not None:
            check_choice("clip", clip, CLIP_RANGES)
        if adc is not None and not isinstance(adc, Adc):
            raise ArgumentError(f"adc must be an Adc, such as Adc(512, 16383); found {adc!r:.100}")
        if adc is not None and "U" in self.components:
            raise ArgumentError(
                f"noise model {spec!r}: U stands for the converter's rounding; leave it out with adc=..."
            )
        if "D" in self.components and not callable(getattr(dark_frames, "draw", None)):
            raise ArgumentError(
                f"noise model {spec!r}: D takes real frames; give dark_frames=DarkFrames(...) of eldata.datasets; "
                f"found {dark_frames!r:.100}"
            )
        if dark_frames is not None and "D" not in self.components:
            raise ArgumentError(f"noise model {spec!r} takes no dark frames: it has no component D, as 'P*+D' has")
        if adc is not None and dark_frames is not None and not dark_frames.dither:
            raise ArgumentError(
                "adc rounds what dark frames and photons add up to, and without a dither it would round single photons "
                "away; leave dither=False out"
            )
        self.clip: Clip | None = clip
        self.adc = adc
        self.dark_frames = dark_frames

    @property
    def spec(self) -> str:
        """The components as :func:`parse_components` reads them."""
        return "+".join(self.components)

    @property
    def formulas(self) -> tuple[str, ...]:
        """The components that an engine draws; the dither of dark frames is one, U."""
        formulas = tuple(name for name in self.components if name != "D")
        return (*formulas, "U") if self.dark_frames is not None and self.dark_frames.dither else formulas

    def __repr__(self) -> str:
        names = ("clip", "adc", "dark_frames")
        options = [f", {name}={value!r}" for name in names if (value := getattr(self, name)) is not None]
        return f"NoiseModel({self.spec!r}{''.join(options)})"

    def with_clip(self, clip: Clip) -> NoiseModel:
        """Return this model with another clip."""
        check_choice("clip", clip, CLIP_RANGES)
        changed = copy.copy(self)
        changed.clip = clip
        return changed

    def __call__(
        self, clean: Image, *,
        parameters: NoiseParameters | Sequence[NoiseParameters], ratio: float | Sequence[float], generator: Generator,
        range_dn: float | Sequence[float] | None = None, dark: NDArray[np.float32] | None = None,
        threads: int | None = None, out: NDArray[np.float32] | None = None,
    ) -> Image:  # fmt: skip
        """Make a noisy exposure of clean packed data.

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
            numpy's or torch's; for a tensor on another device than the CPU, a torch generator of that device.
        range_dn
            White level minus black level, DN, one, or one for each image; by default the range of the camera whose
            profile the parameters come from.
        dark
            With component D: dark frames (N, C, h, w) in DN above black. By default they are drawn here, of the
            parameters' ISO; images that have one draw of parameters together, a clip, get different frames, from one
            place of them.
        threads
            Of the compiled engine, 1 or more; default one per CPU. The result does not depend on it.
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
        images = _count_images(clean)
        each = _per_image(parameters, images, "parameters")
        if not all(isinstance(item, NoiseParameters) for item in each):
            raise ArgumentError(f"parameters must be NoiseParameters, one or one for each image; found {parameters!r}")
        ranges = _per_image(_common_range_dn(each) if range_dn is None else range_dn, images, "range_dn")
        ratios = _per_image(ratio, images, "ratio")
        draws = [NoiseDraw(*fields) for fields in zip(each, ratios, ranges, strict=True)]
        if dark is None and self.dark_frames is not None and images:
            groups = [each] if isinstance(parameters, NoiseParameters) else [[image] for image in each]
            dark = self._draw_dark(groups, (clean.shape[-3], clean.shape[-2], clean.shape[-1]), generator)
        return self.apply(clean, draws, generator, dark=dark, threads=threads, out=out)

    def apply(
        self, clean: Image, draws: NoiseDraw | Sequence[NoiseDraw], generator: Generator | Sequence[Generator], *,
        dark: NDArray[np.float32] | None = None, threads: int | None = None, out: NDArray[np.float32] | None = None,
    ) -> Image:  # fmt: skip
        """Make the noisy exposure that was drawn: the same one for the same draws and state of the generator.

        Parameters
        ----------
        draws
            One for everything (a clip), or one for each image, such as ``dataset.item(index).draw``.
        generator
            As in a call; or several, on the CPU, each for as many images in turn, whose noise is to the bit what a call
            for them alone gives.
        clean, dark, threads, out
            As in a call; with component D, dark frames must be given.

        Raises
        ------
        ArgumentError
            As a call does.
        """
        images = _count_images(clean)
        each = _per_image(draws, images, "draws")
        generators = list(generator) if isinstance(generator, Sequence) else [generator]
        if len(generators) != 1 and (not generators or images % len(generators)):
            raise ArgumentError(
                f"expected one generator, or several, each for as many of {images} images; found {len(generators)}"
            )
        if threads is not None:
            checked_whole("threads", threads, at_least=1)
        if dark is not None or (self.dark_frames is not None and images):
            self._check_dark(dark, (images, *clean.shape[-3:]))
        if out is not None:
            _check_out(out, clean)
        shape = (images, *clean.shape[-3:])
        options: dict[str, Any] = {"adc": self.adc, "limits": CLIP_RANGES[self.clip or "none"], "dark": dark}
        image: Any = clean
        noisy: Any
        if not isinstance(clean, np.ndarray):
            import torch

            image = clean.detach().to(torch.float32)
        if isinstance(image, np.ndarray) or image.device.type == "cpu":
            from eldata.noise._kernels import expose_compiled

            keys = [key_from(source) for source in generators] if images else [0]
            flat = np.ascontiguousarray(image, dtype=np.float32).reshape(shape)
            target = None if out is None else out.reshape(shape)
            noisy = expose_compiled(flat, each, self.formulas, keys=keys, threads=threads, out=target, **options)
        else:
            from eldata.noise.on_device import expose_on_device

            device, (drawing, *others) = image.device, generators
            if others or not isinstance(drawing, torch.Generator) or drawing.device.type != device.type:
                raise ArgumentError(f"clean is on {device}: give a torch.Generator of that device")
            noisy = expose_on_device(image.reshape(shape), each, self.formulas, drawing, **options)
        if not isinstance(clean, np.ndarray):
            noisy = torch.as_tensor(noisy).to(clean.dtype)
        elif out is None:
            noisy = noisy.astype(clean.dtype, copy=False)
        result: Image = noisy.reshape(clean.shape)
        return result

    def _draw_dark(
        self, groups: Sequence[Sequence[NoiseParameters]], packed: tuple[int, int, int], generator: Generator
    ) -> NDArray[np.float32] | None:
        """Draw a dark frame for each image; the images of a group get theirs from one place."""
        source = np.random.default_rng(key_from(generator))
        crops = []
        for parameters, count in ((group[0], len(group)) for group in groups):
            if parameters.iso is None:
                raise ArgumentError(
                    "component D takes dark frames of the parameters' ISO, and they do not state it; draw them at one, "
                    "as profile.sample(generator, iso=800) does"
                )
            if self.dark_frames is not None:
                crops.append(self.dark_frames.draw(parameters.iso, count, packed, source))
        return np.concatenate(crops)

    def _check_dark(self, dark: Any, expected: tuple[int, ...]) -> None:
        """Refuse dark noise of another type or shape, or for a model without component D."""
        if self.dark_frames is None:
            raise ArgumentError(f"dark= is for models with component D; this is {self!r}")
        if not isinstance(dark, np.ndarray) or dark.dtype != np.float32 or dark.shape != expected:
            found = f"{dark.dtype} {dark.shape}" if isinstance(dark, np.ndarray) else type(dark).__name__
            raise ArgumentError(f"dark must be float32 of shape {expected}, in DN above black; found {found}")

    def on_mosaic(
        self,
        clean: Image,
        *,
        cfa: Cfa,
        parameters: NoiseParameters | Sequence[NoiseParameters],
        ratio: float | Sequence[float],
        generator: Generator,
        range_dn: float | None = None,
    ) -> Image:
        """Make a noisy exposure of clean mosaics (..., H, W), normalised, of any size and CFA phase.

        ``cfa`` is the CFA of pixel (0, 0), as :attr:`eldata.records.Sensor.cfa`. Everything else is as for packed data:
        the mosaic is packed, exposed and put together again, and no pixel is left out.

        Raises
        ------
        ArgumentError
            As for packed data, or if the CFA is unsupported.
        """
        check_normalised(clean)
        packed = pack_whole(clean, cfa)
        noisy = self(packed, parameters=parameters, ratio=ratio, range_dn=range_dn, generator=generator)
        return unpack_whole(noisy, cfa, (clean.shape[-2], clean.shape[-1]))


# --- mosaics of any size: packing that loses no pixel, for noise is wanted on all of them ----------------------------


def pack_whole(mosaic: Image, cfa: Cfa) -> Image:
    """Pack mosaics (..., H, W) to (..., C, h, w), extended by zeros to whole periods on all sides.

    Raises
    ------
    ArgumentError
        If there are fewer than two dimensions, or the CFA is unsupported.
    """
    if mosaic.ndim < 2:
        raise ArgumentError(f"expected mosaics (..., H, W); found shape {tuple(mosaic.shape)}")
    sites = packing_sites(cfa)
    top, left = -sites.top % sites.period, -sites.left % sites.period
    height, width = (
        -(-(first + side) // sites.period) for first, side in ((top, mosaic.shape[-2]), (left, mosaic.shape[-1]))
    )
    leading: tuple[int, ...] = tuple(mosaic.shape[:-2])
    whole: Image = _make_zeros(mosaic, (*leading, height * sites.period, width * sites.period))
    whole[..., top : top + mosaic.shape[-2], left : left + mosaic.shape[-1]] = mosaic
    packed: Image = _make_zeros(mosaic, (*leading, sites.channels, height * sites.sub, width * sites.sub))
    for in_mosaic, in_packed in sites.slices:
        packed[in_packed] = whole[in_mosaic]
    return packed


def unpack_whole(packed: Image, cfa: Cfa, shape: tuple[int, int]) -> Image:
    """Undo :func:`pack_whole` for mosaics of ``shape`` (H, W)."""
    sites = packing_sites(cfa)
    height, width = (side // sites.sub * sites.period for side in packed.shape[-2:])
    whole: Image = _make_zeros(packed, (*tuple(packed.shape[:-3]), height, width))
    for in_mosaic, in_packed in sites.slices:
        whole[in_mosaic] = packed[in_packed]
    top, left = -sites.top % sites.period, -sites.left % sites.period
    cropped: Image = whole[..., top : top + shape[0], left : left + shape[1]]
    return cropped


def _make_zeros(like: Any, shape: tuple[int, ...]) -> Any:
    """Make zeros of a shape: an array, or a tensor on the same device, as ``like`` is."""
    return np.zeros(shape, like.dtype) if isinstance(like, np.ndarray) else like.new_zeros(shape)


# --- what a call gives, one of each per image ----------------------------------------------------------------------


def check_normalised(clean: Any, name: str = "clean") -> None:
    """Refuse what cannot be normalised data.

    Raises
    ------
    ArgumentError
        If it is neither an array nor a tensor, or of anything but floating numbers.
    """
    if isinstance(clean, np.ndarray):
        is_float, is_whole = clean.dtype.kind == "f", clean.dtype.kind in "iu"
    elif is_tensor(clean):
        is_float, is_whole = clean.is_floating_point(), not clean.is_complex()
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


def _count_images(clean: Any) -> int:
    """Count the images of clean packed data, and refuse other data."""
    check_normalised(clean)
    if clean.ndim < 3:
        raise ArgumentError(f"expected clean data (..., C, h, w); found shape {tuple(clean.shape)}")
    packed_rows(int(clean.shape[-3]))  # refuses another number of channels
    return math.prod(clean.shape[:-3])


def _per_image(value: Any, images: int, name: str) -> list[Any]:
    """Spread one value over all images, or take one for each; of others raise :class:`ArgumentError`."""
    if not isinstance(value, Sequence) and hasattr(value, "tolist"):  # an array or a tensor
        value = value.tolist()
    if isinstance(value, str) or not isinstance(value, Sequence):
        return [value] * images
    if len(value) != images:
        raise ArgumentError(f"{name}: expected one, or one for each of {images} images; found {len(value)}")
    return list(value)


def _common_range_dn(drawn: Sequence[NoiseParameters]) -> float:
    """Return the range from black to white that the parameters bring with them."""
    known = {item.range_dn for item in drawn}
    if len(known) == 1 and (range_dn := known.pop()) is not None:
        return range_dn
    found = "differ in it" if len(known) > 1 else "do not know it (their profile states no levels)"
    raise ArgumentError(f"give range_dn, the white level minus the black level in DN: the parameters {found}")


def _check_out(out: Any, clean: Any) -> None:
    """Refuse an output array that does not fit ``clean``, or shares memory with it."""
    if not isinstance(clean, np.ndarray):
        raise ArgumentError("out= is for arrays; of a tensor leave it out")
    fits = isinstance(out, np.ndarray) and out.shape == clean.shape and out.dtype == np.float32
    if not fits or not out.flags.c_contiguous or not out.flags.writeable or np.may_share_memory(out, clean):
        found = f"{out.dtype} {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        raise ArgumentError(
            f"out must be a writeable C-contiguous float32 array of shape {clean.shape} with memory of its own; found "
            f"{found}"
        )


# --- noise of the caller's own ---------------------------------------------------------------------------------------


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
        self, clean: NDArray[np.float32], /, *,
        parameters: NoiseParameters, ratio: float, range_dn: float, generator: np.random.Generator,
    ) -> Any:  # fmt: skip
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
        raise ArgumentError(f"{name_of(maker)} cannot be called as {call}: {error}") from error


def made_exposure(
    maker: NoiseMaker, clean: NDArray[np.float32], draw: NoiseDraw, generator: np.random.Generator
) -> NDArray[np.float32]:
    """Call somebody's own maker with a copy of clean data; return its exposure as float32.

    Raises
    ------
    ArgumentError
        If that is not an array of the same shape, of floating numbers.
    """
    made = maker(
        clean.copy(), parameters=draw.parameters, ratio=draw.ratio, range_dn=draw.range_dn, generator=generator
    )
    if is_tensor(made):
        made = made.detach().cpu().numpy()
    if not isinstance(made, np.ndarray) or made.shape != clean.shape or made.dtype.kind != "f":
        is_array = isinstance(made, np.ndarray)
        found = f"{made.dtype} of shape {made.shape}" if is_array else type(made).__name__
        raise ArgumentError(f"{name_of(maker)} returned {found}; expected an array like the clean one, {clean.shape}")
    return made.astype(np.float32, copy=False)
