"""Protocols in words: all fields of one, a line in a list of several, and in what two of them differ."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING, Any

from eldata.metrics.registry import IMAGES
from eldata.protocols.protocol import NEUTRAL, SCORED, Protocol, canonical

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence


LEVELS = {
    "published": "white 16383, black the file's",
    "metadata": "the file's own white and black",
    "metadata-per-channel": "LibRaw's white of each channel, black the file's",
    "sid-sony": "black 512, white 16383",
    "sid-fuji": "black 1024, white 16383",
    "lrid": "black 64, white 1023",
}
CLIPS = {"both": "to [0, 1]", "upper": "at 1 only", "none": "none"}
_CLAMPS = {"both": "to [0, 1], before and after the factor", "before": "to [0, 1] before the factor", "none": "none"}
_RESCALINGS = {"scalar": "one factor per image", "none": "none"}
_ROUNDINGS = {"none": "none", "8-bit": "to the nearest of 256 levels", "8-bit-truncated": "down to one of 256 levels"}
_QUANTISATIONS = {
    "none": "none",
    "dn-truncated": "down to whole DN",
    "dn-truncated-float32": "down to whole DN, in float32",
}
_WINDOWS = {
    "uniform-7": "7x7 uniform",
    "gaussian-11": "11x11 Gaussian",
    "gaussian-11-volume": "11x11x11 Gaussian, colours as a third axis",
}
_PLANES = {"packed": "each packed channel", "mosaic": "the mosaic"}
_RENDERINGS = {"none": "none", "libraw": "LibRaw's", "eld-isp": "the ELD paper's pipeline"}
_SPACES = {"raw": "packed raw", "srgb": "sRGB"}
_PIXELS = {"packed": "packed raw", "rgb": "preprocessed RGB"}
_AMPLIFICATIONS = {"metadata": "by the files' exposure ratio", "nominal": "by the manifest's ratio"}


def _join(values: Any) -> str:
    """List values in a line; ``all`` if there are none."""
    return ", ".join(map(str, values)) if values else "all"


def _join_ratios(values: Any) -> str:
    """List ratios in a line, as ``x100, x200``; ``all`` if there are none."""
    return ", ".join(f"x{value:g}" for value in values) if values else "all"


def region_words(region: str) -> str:
    """Describe a region."""
    kind, _, size = region.partition("-")
    words = {"centre": f"packed centre {size} x {size}", "border": f"all but {size} packed pixels at each edge"}
    return {"full": "full frame", **words}.get(kind, region)


def _shorten_response(value: str) -> str:
    """Describe a curve; a measured one by its digest and the number of its points."""
    if not value.startswith("curve "):
        return value.replace("-", " ")
    digest, points = sha256(value.encode()).hexdigest()[:8], len(value.partition(";")[0].split()) - 1
    return f"a curve of {points} points ({digest})"


# Field -> its name in words, and its value's.
FIELDS: Mapping[str, tuple[str, Callable[[Any], str]]] = {
    "dataset": ("dataset", str),
    "subset": ("subset", lambda value: value or "as chosen, else the card's first"),
    "ratios": ("factors", _join_ratios),
    "cameras": ("cameras", _join),
    "scenes": ("scenes", _join),
    "pixels": ("pixels", lambda value: _PIXELS[value]),
    "frames": ("frames", lambda value: {"evaluation": "the fifth to the ninth"}[value]),
    "frame_count": ("frames of a clip", lambda value: str(value or "all")),
    "space": ("space", lambda value: _SPACES[value]),
    "input_space": ("network's input", lambda value: _SPACES[value]),
    "prediction_space": ("predictions", lambda value: _SPACES[value]),
    "rendering": ("rendering", lambda value: _RENDERINGS[value]),
    "response": ("response curve", _shorten_response),
    "levels": ("levels", lambda value: LEVELS[value]),
    "reference_clip": ("reference's clip", lambda value: CLIPS[value]),
    "reference": ("reference", str),
    "region": ("region", region_words),
    "rescaling": ("rescaling", lambda value: _RESCALINGS[value]),
    "rescaling_region": ("factor's region", lambda value: "the scored one" if value == SCORED else region_words(value)),
    "prediction_clamp": ("prediction's clamp", lambda value: _CLAMPS[value]),
    "quantisation": ("prediction's values", lambda value: _QUANTISATIONS[value]),
    "rounding": ("rounding", lambda value: _ROUNDINGS[value]),
    "mse_offset": ("added to the error", lambda value: f"{value:g}"),
    "ssim_window": ("SSIM window", lambda value: _WINDOWS[value]),
    "ssim_covariance": ("SSIM covariance", str),
    "ssim_planes": ("SSIM of", lambda value: _PLANES[value]),
    "input_clip": ("input's clip", lambda value: CLIPS[value]),
    "amplification": ("input amplified", lambda value: _AMPLIFICATIONS[value]),
    "dark_shading": ("dark shading off", str),
    "psnr": ("PSNR", str),
    "ssim": ("SSIM", str),
    "st_rred": ("ST-RRED", str),
    "st_rred_peak": ("ST-RRED's peak", lambda value: f"{value:g}"),
}


def in_words(field: str, value: Any) -> str:
    """Describe a field's value; one that this version does not know stays as it is."""
    if field not in FIELDS:
        return str(value)
    try:
        return FIELDS[field][1](value)
    except (KeyError, TypeError, ValueError, AttributeError):
        return str(value)


def described(protocol: Protocol) -> list[tuple[str, str]]:
    """Describe a protocol's fields in the order of an evaluation; fields that play no part are left out."""
    values = protocol.as_dict()
    skipped = {"ssim_window", "ssim_covariance", "ssim_planes", "mse_offset"}  # PSNR and SSIM say them
    if protocol.rescaling == "none":
        skipped.add("rescaling_region")
    if protocol.rendering == "none":
        skipped.add("rendering")
    skipped |= {field for field in ("response", "quantisation") if getattr(protocol, field) == NEUTRAL[field]}
    if not protocol.is_of_packed:
        skipped |= {"levels", "reference_clip"}
    if protocol.pixels != "srgb" or not protocol.is_of_packed:
        skipped |= {"input_space", "prediction_space"}
    rows = [
        (name, words(values[field]))
        for field, (name, words) in FIELDS.items()
        if field in values and field not in skipped
    ]
    told = {name for name, _ in rows}
    metrics = [(figure.label, figure.meaning) for figure in protocol.kind.metrics if figure.label not in told]
    return [("name", protocol.name), ("title", protocol.title), *rows, *metrics]


HEADER = ("protocol", "dataset", "pairs", "differs from eld by")
"""Columns of a list of protocols."""


def summary(protocol: Protocol, eld: Protocol) -> tuple[str, ...]:
    """Make a protocol's cells of such a list; the last names its differences from the paper's."""
    own, usual = _summarise(protocol), _summarise(eld)
    unlike = "; ".join(f"{name} {cell}" for name, cell in own.items() if cell != usual[name])
    return protocol.name, protocol.dataset, _summarise_pairs(protocol), unlike


def _summarise_pairs(protocol: Protocol) -> str:
    """Summarise a protocol's pairs: factors, subset, scenes, cameras; of clips their number of frames."""
    if protocol.kind is not IMAGES:
        return f"{protocol.as_dict()['frame_count'] or 'all'} frames per clip"
    pairs = [protocol.subset or "", _summarise_scenes(protocol.scenes), ", ".join(protocol.cameras)]
    if protocol.subset is None:
        pairs.insert(0, " ".join(f"x{ratio:g}" for ratio in protocol.ratios) or "all factors")
    return ", ".join(part for part in pairs if part)


def _summarise(protocol: Protocol) -> dict[str, str]:
    """Summarise what distinguishes protocols from one another."""
    levels = {"published": "16383", "metadata": "file", "metadata-per-channel": "file, channel"}
    levels |= {"sid-sony": "16383, black 512", "sid-fuji": "16383, black 1024", "lrid": "1023, black 64"}
    scalar = "yes" if protocol.factor_region == protocol.region else f"from {_shorten_region(protocol.factor_region)}"
    space = {"raw": "raw", "srgb": "sRGB, 8 bit" if protocol.rounding != "none" else "sRGB"}[protocol.space]
    if protocol.prediction_space == "srgb":
        space += f" from {'sRGB' if protocol.input_space == 'srgb' else 'raw'}"
    windows = {"uniform-7": "7x7", "gaussian-11": "Gauss 11", "gaussian-11-volume": "Gauss 11, RGB"}
    return {
        "region": _shorten_region(protocol.region),
        "white": levels[protocol.levels] if protocol.is_of_packed else {"srgb": "LibRaw"}.get(protocol.pixels, "none"),
        "scalar": scalar if protocol.rescaling == "scalar" else "no",
        "input clip": protocol.input_clip,
        "SSIM": windows[protocol.ssim_window] + (", mosaic" if protocol.ssim_planes == "mosaic" else ""),
        "space": "RGB" if protocol.pixels == "rgb" else space,
    }


def _shorten_region(region: str) -> str:
    """Shorten a region for a table's cell: ``centre 512``, ``8 px off``."""
    kind, _, size = region.partition("-")
    return {"centre": f"centre {size}", "border": f"{size} px off"}.get(kind, region)


def _summarise_scenes(scenes: tuple[str, ...]) -> str:
    """Summarise scenes: ``scenes 1-10`` if their numbers follow one another, else their count."""
    if not scenes:
        return ""
    numbers = [name.removeprefix("scene-") for name in scenes]
    whole = all(number.isdecimal() for number in numbers)
    if whole and [int(n) for n in numbers] == list(range(int(numbers[0]), int(numbers[0]) + len(numbers))):
        return f"scenes {numbers[0]}-{numbers[-1]}"
    return f"{len(scenes)} scenes"


# --- do scores of two compare? ----------------------------------------------------------------------------------------


def comparability(
    first: Mapping[str, Any],
    second: Mapping[str, Any],
    *,
    equal: Sequence[Mapping[str, Collection[str]]] = (),
    ignored: Collection[str] = (),
) -> list[str]:
    """Name the differences of two protocols in words; none if their scores compare.

    Names and sentences do not count: two protocols of different names may score alike. Neither do fields that have no
    effect, such as where a factor is found that is not used.

    Parameters
    ----------
    first, second
        Protocols as a result's JSON holds them (``protocol``), of images or of clips. A field that one of them does not
        state, because an older version wrote it, is neutral (:data:`eldata.protocols.protocol.NEUTRAL`).
    equal
        Values of a field that came to the same where something was scored, by the field: such as ``{"levels":
        ["published", "sid-sony"]}`` of files whose black level is 512.
    ignored
        Fields that do not count.

    Returns
    -------
    list of str
        Such as ``"region: full frame against packed centre 512 x 512"``, in the order of an evaluation.
    """
    a, b = canonical(first), canonical(second)
    names = [name for name in dict.fromkeys((*FIELDS, *a, *b)) if name not in ignored and a.get(name) != b.get(name)]
    regions = [_find_factor_region(fields) for fields in (first, second)]
    if "rescaling" in names or regions[0] == regions[1]:  # where a factor is found says nothing against no factor
        names = [name for name in names if name != "rescaling_region"]
    stated = [{**fields, "rescaling_region": region} for fields, region in zip((first, second), regions, strict=True)]
    return [
        f"{FIELDS[name][0] if name in FIELDS else name.replace('_', ' ')}: "
        + " against ".join(_format_value(fields, name) for fields in stated)
        for name in names
        if not any(all(_find_value(fields, name) in choices.get(name, ()) for fields in stated) for choices in equal)
    ]


def _find_factor_region(protocol: Mapping[str, Any]) -> Any:
    """Find the region for a protocol's rescaling factor, which may be the scored one."""
    region = _find_value(protocol, "rescaling_region")
    return protocol.get("region") if region == SCORED else region


def _find_value(protocol: Mapping[str, Any], name: str) -> Any:
    """Find a field's value, or its neutral one if the protocol does not state it."""
    return protocol.get(name, NEUTRAL.get(name))


def _format_value(protocol: Mapping[str, Any], name: str) -> str:
    """Describe a field's value; ``not stated`` if it has none, not even a neutral one."""
    return in_words(name, _find_value(protocol, name)) if name in (*protocol, *NEUTRAL) else "not stated"
