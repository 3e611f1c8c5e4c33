"""What a protocol of images or of clips is: every choice that a score depends on besides the pixels; and its digest."""

from __future__ import annotations

import hashlib
import json
import re
from abc import ABC, abstractmethod
from dataclasses import MISSING, asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, get_args, get_origin, get_type_hints

from eldata.base.tables import block, table
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, check_choice
from eldata.metrics.registry import (
    CLIPS,
    IMAGES,
    Covariance,
    Kind,
    PredictionClamp,
    Rescaling,
    Rounding,
    SsimWindow,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from eldata.isp.rendering import Response
    from eldata.metrics.image_score import ScoringRules


Levels = Literal["metadata", "published", "metadata-per-channel", "sid-sony", "sid-fuji", "lrid"]
Clip = Literal["both", "upper", "none"]
Amplification = Literal["metadata", "nominal"]
Space = Literal["raw", "srgb"]
Pixels = Literal["packed", "srgb", "rgb"]
Rendering = Literal["none", "libraw", "eld-isp"]
Quantisation = Literal["none", "dn-truncated", "dn-truncated-float32"]
SsimPlanes = Literal["packed", "mosaic"]

ANY_DATASET = "any"

ONE_CAMERAS_LEVELS: tuple[Levels, ...] = ("sid-sony", "sid-fuji", "lrid")
"""Levels that are constants of one camera, whatever the file states."""

SCORED: Final = "scored"
"""Value of ``rescaling_region``: the region that is scored."""

NO_SHADING = "none"
"""Value of ``dark_shading``: the input is as the camera took it."""

_DIGEST = re.compile("sha256:[0-9a-f]{64}")
_REGION = re.compile(r"full|(centre|border)-([1-9][0-9]{0,4})")


class _Describable(ABC):
    """What says of itself in fields how something was scored: in a line, and in a notebook."""

    __slots__ = ()

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """List the fields as plain types."""

    @property
    def digest(self) -> str:
        """``sha256:<hex>`` of all that decides a score (``canonical``)."""
        return fields_digest(self.as_dict())

    def __repr__(self) -> str:
        name, title = (in_line(str(self.as_dict().get(field, ""))) for field in ("name", "title"))
        return f"{type(self).__name__}({name!r}, {title!r}, {self.digest[:15]})"

    def _repr_html_(self) -> str:
        """Show the stated fields and the digest as a table in notebooks."""
        stated = [(name, _format_value(value)) for name, value in self.as_dict().items() if value not in ("", [], None)]
        return block(f"Protocol {self.as_dict()['name']}", table((), [*stated, ("digest", self.digest)], left=(0, 1)))


def _format_value(value: Any) -> str:
    """Format a field's value; of a curve's points the first."""
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if not text.startswith("curve ") else f"{text[:60]} ..."


@dataclass(frozen=True, slots=True, repr=False)
class Protocol(_Describable):
    """Everything that a score of an image depends on besides the pixels.

    Attributes
    ----------
    name, title, source
        Short name, what it is, and where it was published, with what that leaves open.
    dataset
        The dataset whose pairs it scores, or what the names of several begin with: ``sid`` is for ``sid-sony`` and
        ``sid-fuji`` (:meth:`covers`); ``any`` is for every one.
    ratios
        Low-light factors of the pairs that are scored; empty means all.
    levels
        Levels that normalise the reference. ``published``: white is 16383, black the file's; ``metadata``: the file's
        own; ``metadata-per-channel``: LibRaw's white level of each channel; ``sid-sony``, ``sid-fuji``: the constants
        that the SID code has for every file of a camera, and PMN's too; ``lrid``: PMN's for the phone of LRID
        (:mod:`eldata.raw.levels`).
    reference_clip
        Clip of the normalised reference: to [0, 1], ``upper`` at 1 only, or ``none``.
    region
        The scored part of the frame, in packed pixels: ``full``; ``centre-512``, the central square of that side;
        ``border-2``, all but as many pixels at each edge.
    rescaling_region
        The part of the frame that the factor is found on: ``scored``, the region, or another in its words. LED finds it
        on the ``full`` frame.
    rescaling, prediction_clamp, rounding, mse_offset, ssim_window, ssim_covariance
        How the prediction is brought to the reference and compared with it:
        :class:`~eldata.metrics.image_score.ScoringRules`.
    quantisation
        ``dn-truncated``: before anything else a packed raw prediction is clipped to [0, 1] and cut down to whole DN of
        the reference's levels, as by code that saves its results as integers; ``dn-truncated-float32``: with the
        arithmetic of float32, of whose whole levels none moves. ``none``: it is taken as it is.
    ssim_planes
        What SSIM of packed raw values is of: each ``packed`` channel, or the ``mosaic`` in which they lie as on the
        sensor, as by code that scores raw images as grey ones. PSNR is the same.
    family
        The name under which several are published, one per dataset: ``pmn`` names ``pmn-sid`` and ``pmn-eld``.
    subset
        Name of a subset on the dataset's card. ``None``: the one that the user names, else the card's first, if any.
    cameras, scenes
        Cameras and scenes of the pairs that are scored; empty means all.
    input_clip, amplification
        Clip of the input before and after it is multiplied by the ratio, and which ratio: ``metadata``, the files', or
        ``nominal``, the manifest's. They matter where predictions are made, and for the score of the input itself.
    dark_shading
        The digest of the dark shading (:class:`eldata.noise.DarkShading`) that was taken off the input; ``none``.
        An evaluation fills it in (``--dark-shading``).
    space
        ``raw``: packed raw values are compared; ``srgb``: renderings.
    rendering
        What renders an sRGB reference: ``libraw``, the predictions being renderings already, or ``eld-isp``, the ELD
        paper's pipeline (:mod:`eldata.isp.rendering`), which renders a packed raw prediction too, once rescaled.
    input_space, prediction_space
        What a network gets and what it makes, ``raw`` or ``srgb``: the paper's Raw2Raw, Raw2RGB and RGB2RGB (section
        4.5). A prediction in ``srgb`` is (3, h, w), a pixel for each packed one, rescaled
        and compared as it is; an input in ``srgb`` is the amplified frame, rendered in 8 bits with the white balance
        and matrix of its own file. The input itself is scored as such a rendering in either case.
    response
        The curve of ``eld-isp``: ``gamma-2.2`` or of another exponent, or all points of a measured one
        (:attr:`eldata.isp.ResponseCurve.text`), which a file of one's own names instead
        (:func:`eldata.protocols.load_protocol`).
    """

    kind: ClassVar[Kind] = IMAGES
    """What is scored, with its words, metrics and columns.

    :meta hide-value:
    """

    name: str
    title: str
    source: str
    dataset: str
    levels: Levels
    reference_clip: Clip
    region: str
    rescaling: Rescaling
    ratios: tuple[int | float, ...] = ()
    rounding: Rounding = "none"
    family: str = ""
    subset: str | None = None
    cameras: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()
    input_clip: Clip = "both"
    amplification: Amplification = "metadata"
    dark_shading: str = NO_SHADING
    space: Space = "raw"
    rendering: Rendering = "none"
    input_space: Space = "raw"
    prediction_space: Space = "raw"
    response: str = "gamma-2.2"
    rescaling_region: str = SCORED
    prediction_clamp: PredictionClamp = "both"
    mse_offset: float = 0.0
    ssim_window: SsimWindow = "uniform-7"
    ssim_covariance: Covariance = "sample"
    quantisation: Quantisation = "none"
    ssim_planes: SsimPlanes = "packed"

    @property
    def psnr(self) -> str:
        """Definition of PSNR, per image; a table's entries are means over images."""
        error = f"mean squared error over all {'packed entries' if self.space == 'raw' else 'values'}"
        if self.mse_offset:
            error = f"({error} + {self.mse_offset:g})"
        return f"10 log10(1 / {error})"

    @property
    def ssim(self) -> str:
        """Definition of SSIM, per image."""
        window = {
            "uniform-7": "uniform 7x7 window",
            "gaussian-11": "Gaussian 11x11 window with sigma 1.5",
            "gaussian-11-volume": "Gaussian 11x11x11 window with sigma 1.5 over rows, columns and colours",
        }[self.ssim_window]
        channels = "packed channels" if self.space == "raw" else "colours"
        mean = f"mean over valid region {'of the mosaic' if self.ssim_planes == 'mosaic' else f'and {channels}'}"
        if self.ssim_window == "gaussian-11-volume":
            mean = "edges continued by their own values, mean over all values"
        return f"{window}, {self.ssim_covariance} covariance, K1=0.01, K2=0.03, {mean}"

    @property
    def rules(self) -> ScoringRules:
        """What decides the scores of a prediction and a reference in the region."""
        from eldata.metrics.image_score import ScoringRules

        return ScoringRules(
            rescaling=self.rescaling,
            prediction_clamp=self.prediction_clamp,
            rounding=self.rounding,
            mse_offset=self.mse_offset,
            ssim_window=self.ssim_window,
            ssim_covariance=self.ssim_covariance,
        )

    @property
    def pixels(self) -> Pixels:
        """What predictions and references are: packed raw values, renderings in sRGB, or (of clips) RGB frames."""
        return "srgb" if self.rendering == "libraw" or self.prediction_space == "srgb" else "packed"

    @property
    def is_of_packed(self) -> bool:
        """Whether references are packed raw values or made of them: levels and clips have a meaning."""
        return self.pixels == "packed" or self.rendering == "eld-isp"

    @property
    def curve(self) -> Response:
        """The response of renderings by ``eld-isp``."""
        from eldata.isp.response import response_of

        return response_of(self.response)

    @property
    def frame_levels(self) -> Literal["metadata", "published", "sid-sony", "sid-fuji", "lrid"]:
        """The levels of the datasets' frames, which have one white level for all channels."""
        return "metadata" if self.levels == "metadata-per-channel" else self.levels

    def covers(self, dataset: str) -> bool:
        """Whether it scores a dataset of this name."""
        return self.dataset in (ANY_DATASET, dataset) or dataset.startswith(f"{self.dataset}-")

    def as_dict(self) -> dict[str, Any]:
        """List the fields as plain types, with the definitions of PSNR and SSIM that follow from them."""
        plain = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}
        made = "srgb" if self.pixels == "srgb" else self.prediction_space  # LibRaw's rendering takes no other
        return plain | {"prediction_space": made, "psnr": self.psnr, "ssim": self.ssim}

    def crop(self, shape: tuple[int, ...]) -> tuple[slice, ...]:
        """Index the region in an image of this shape, (C, h, w).

        Raises
        ------
        ArgumentError
            If the image is too small for the region.
        """
        return _index_region(self.region, shape)

    @property
    def factor_region(self) -> str:
        """The part of the frame that the factor is found on, in the words of ``region``."""
        return self.region if self.rescaling_region == SCORED else self.rescaling_region

    def factor_crop(self, shape: tuple[int, ...]) -> tuple[slice, ...]:
        """Index the part that the factor is found on, as :meth:`crop` does; the region if there is no factor."""
        return _index_region(self.region if self.rescaling == "none" else self.factor_region, shape)

    def check(self) -> None:
        """Raise :class:`ArgumentError` if a field has a value that it cannot have, or two do not go together."""
        for name, known in CHOICES.items():
            check_choice(name, getattr(self, name), known)
        _kind_and_size("region", self.region)
        if self.rescaling_region != SCORED:
            _kind_and_size("rescaling_region", self.rescaling_region)
        self.rules.check()
        if self.dark_shading != NO_SHADING and not _DIGEST.fullmatch(self.dark_shading):
            raise ArgumentError(
                "dark_shading must be 'none' or the digest of one, sha256: and 64 hexadecimal digits; found "
                f"{self.dark_shading!r:.100}"
            )
        if (self.space == "raw") != (self.rendering == "none"):
            raise ArgumentError(
                f"rendering {self.rendering!r} does not go with space {self.space!r}: raw takes 'none', srgb another"
            )
        if self.rendering == "none" and self.prediction_space == "srgb":
            raise ArgumentError("prediction_space 'srgb' needs a reference to compare with: space 'srgb', a rendering")
        if self.quantisation != NEUTRAL["quantisation"] and self.pixels != "packed":
            raise ArgumentError("quantisation goes with packed raw predictions alone")
        if self.ssim_planes != NEUTRAL["ssim_planes"] and self.space != "raw":
            raise ArgumentError("ssim_planes goes with space 'raw' alone")
        if self.input_space == "srgb" and (self.rendering, self.prediction_space) != ("eld-isp", "srgb"):
            raise ArgumentError("input_space 'srgb' goes with rendering 'eld-isp' and prediction_space 'srgb'")
        if self.response != NEUTRAL["response"] and self.rendering != "eld-isp":
            raise ArgumentError("response goes with rendering 'eld-isp' alone, which applies it")
        self.curve  # noqa: B018 # it checks
        rounding = "none" if self.prediction_space == "srgb" else "8-bit-truncated"
        if self.rendering == "eld-isp" and self.rounding != rounding:
            raise ArgumentError(
                f"rendering 'eld-isp' makes 8 bits, and of predictions in {self.prediction_space} rounding must be "
                f"{rounding!r}, not {self.rounding!r}"
            )
        if self.rendering == "eld-isp" and self.mse_offset:
            raise ArgumentError("rendering 'eld-isp' is scored with mse_offset 0")
        if any(ratio <= 0 for ratio in self.ratios):
            raise ArgumentError(f"ratios must be positive; found {list(self.ratios)}")


def _index_region(region: str, shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Index a region such as ``centre-512`` in an image of ``shape`` (..., h, w)."""
    height, width = shape[-2:]
    kind, size = _kind_and_size("region", region)
    if kind == "full":
        return slice(None), slice(None), slice(None)
    if min(height, width) < (size if kind == "centre" else 2 * size + 1):
        raise ArgumentError(f"a packed image of {height} x {width} is too small for the region {region!r}")
    if kind == "border":
        return slice(None), slice(size, height - size), slice(size, width - size)
    top, left = height // 2 - size // 2, width // 2 - size // 2
    return slice(None), slice(top, top + size), slice(left, left + size)


def _kind_and_size(field: str, region: str) -> tuple[str, int]:
    """Split a region into its kind and its size in packed pixels."""
    match = _REGION.fullmatch(region)
    if match is None:
        other = f", or {SCORED!r}" if field == "rescaling_region" else ""
        raise ArgumentError(f"{field} must be 'full', 'centre-N' or 'border-N'{other}; found {region!r}")
    return match[1] or "full", int(match[2] or 0)


@dataclass(frozen=True, slots=True, repr=False)
class StatedProtocol(_Describable):
    """A protocol as a saved result states it, in the fields that the version which wrote it had.

    Attributes
    ----------
    kind
        What was scored.
    fields
        As plain types.
    """

    kind: Kind
    fields: dict[str, Any]

    @property
    def name(self) -> str:
        """Its short name."""
        return str(self.fields["name"])

    @property
    def title(self) -> str:
        """What it is."""
        return str(self.fields.get("title", ""))

    @property
    def pixels(self) -> Pixels:
        """What predictions and references were, as of :attr:`Protocol.pixels`."""
        if self.fields.get("rendering") == "libraw" or self.fields.get("prediction_space") == "srgb":
            return "srgb"
        return "rgb" if self.fields.get("pixels") == "rgb" else "packed"

    def as_dict(self) -> dict[str, Any]:
        """List its fields."""
        return self.fields


CHOICES: dict[str, tuple[str, ...]] = {
    name: get_args(hint) for name, hint in get_type_hints(Protocol).items() if get_origin(hint) is Literal
}
"""Fields that have one of a few values, and these."""


# --- digests ----------------------------------------------------------------------------------------------------------

# Stands for what no field says: the definitions of PSNR, SSIM and ST-RRED, the order of the steps.
_VERSION: Final = 1

_PROSE: Final = ("name", "title", "source", "family", "psnr", "ssim", "st_rred", "reference")

CHOOSING: Final = ("dataset", "ratios", "subset", "cameras", "scenes")
"""Fields that choose the pairs."""

OF_INPUT: Final = ("input_clip", "amplification", "dark_shading", "input_space")
"""Fields of the noisy input: they decide the score of the input itself, and of a prediction through its method."""

_LARGEST_WHOLE: Final = 2**53  # that a float holds


def canonical(stated: Mapping[str, Any]) -> dict[str, Any]:
    """List the fields that decide a score: no prose, no neutral values, nothing without effect.

    A field that is added later, whose default means what was done before, changes no digest; neither does rewording.

    Parameters
    ----------
    stated
        Fields as :meth:`Protocol.as_dict` or a result's JSON has them. Missing ones are neutral (:data:`NEUTRAL`).

    Returns
    -------
    dict
        Plain types: numbers are floats, lists are sorted. ``version`` counts changes of this list.
    """
    values = {name: _to_plain(value) for name, value in stated.items() if name not in _PROSE}
    if values.get("rescaling") == "none" or values.get("rescaling_region") == values.get("region"):
        values.pop("rescaling_region", None)
    if values.get("rendering") == "libraw":  # which says it already
        values.pop("prediction_space", None)
    deciding = {name: value for name, value in values.items() if name not in NEUTRAL or value != NEUTRAL[name]}
    return {"version": _VERSION, **deciding}


def scoring(stated: Mapping[str, Any]) -> dict[str, Any]:
    """List the ``canonical`` fields that decide a given prediction's score: neither pairs nor input."""
    return {name: value for name, value in canonical(stated).items() if name not in (*CHOOSING, *OF_INPUT)}


def fields_digest(stated: Mapping[str, Any]) -> str:
    """``sha256:<hex>`` of what decides a score (``canonical``), as JSON with sorted names."""
    return f"sha256:{hashlib.sha256(json.dumps(canonical(stated), sort_keys=True).encode()).hexdigest()}"


def _to_plain(value: Any) -> Any:
    """Write 100 as 100.0, and a list in an order that does not depend on how it was written."""
    if isinstance(value, (list, tuple)):
        return sorted((_to_plain(item) for item in value), key=json.dumps)
    exact = type(value) is int and abs(value) <= _LARGEST_WHOLE
    return float(value) if exact else value


NEUTRAL: Final[Mapping[str, Any]] = {
    field.name: _to_plain(field.default)
    for field in fields(Protocol)
    if field.default is not MISSING and field.name not in _PROSE
}
"""What a protocol means that does not state a field. Defaults stay as they are for ever: digests depend on them."""


# --- clips ------------------------------------------------------------------------------------------------------------


OWN_SEQUENCES = "own-sequences"
"""In place of a dataset's name: sequences of a set of your own, in which each frame has its own reference."""

# What a clip's protocol states of itself, in this order; of the rest, which is about images, what is not neutral.
_STATED = (
    *("name", "title", "source", "dataset", "pixels", "rescaling", "frames", "frame_count", "levels"),
    *("reference_clip", "reference", "region", "st_rred_peak", "psnr", "ssim", "st_rred"),
)


@dataclass(frozen=True, slots=True, repr=False)
class ClipProtocol(Protocol):
    """Everything that the scores of a clip depend on besides the pixels.

    What it has in common with :class:`Protocol` means the same, of each frame. PSNR and SSIM are means over frames.

    Attributes
    ----------
    dataset
        Name of the manifest whose clips it scores, or :data:`OWN_SEQUENCES`.
    pixels
        ``rgb``: the preprocessed RGB frames; ``packed``: the packed mosaic.
    levels
        White level that normalises a raw reference; preprocessed frames have none.
    frames
        Which frames of a clip are scored (:func:`eldata.manifest.clips.frame_range`).
    frame_count
        Their number; 0: every frame that a clip has.
    reference
        What a frame is compared with.
    """

    kind: ClassVar[Kind] = CLIPS
    st_rred_peak: ClassVar[float] = 1.0
    """Scale at which ST-RRED is taken (:func:`eldata.metrics.st_rred`)."""

    levels: Levels = "metadata"
    reference_clip: Clip = "both"
    region: str = "full"
    rescaling: Rescaling = "scalar"
    pixels: Pixels = "packed"
    frames: Literal["evaluation", "all"] = "evaluation"
    frame_count: int = 5
    reference: str = "the clip's one still, for every frame"

    @property
    def psnr(self) -> str:
        """Definition of PSNR, per clip."""
        return "10 log10(1 / mean squared error over all entries of a frame), mean over frames"

    @property
    def ssim(self) -> str:
        """Definition of SSIM, per clip."""
        return (
            "uniform 7x7 window, sample covariance, K1=0.01, K2=0.03, mean over valid region and channels, mean over "
            "frames"
        )

    @property
    def st_rred(self) -> str:
        """Definition of ST-RRED, per clip."""
        return "of the grey frames after rescaling, frames in pairs 0-1, 2-3, as scikit-video 1.1.11 has it"

    def covers(self, dataset: str) -> bool:
        """Whether it scores a dataset of this name."""
        return self.dataset == dataset != OWN_SEQUENCES

    def as_dict(self) -> dict[str, Any]:
        """List what it states as plain types, with the definitions of its metrics."""
        every = Protocol.as_dict(self)  # super() does not find its class in one with slots
        more = {name: value for name, value in every.items() if value != NEUTRAL.get(name, value)}
        return {name: getattr(self, name) for name in _STATED} | more
