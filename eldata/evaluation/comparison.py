"""Methods held against the first of them on the images that all have scores of: means, differences, warnings."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from eldata.base.tables import Strong, latex_table, markdown_table, markdown_text, text_table
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.common import json_safe, mean
from eldata.evaluation.statistics import LEVEL, RESAMPLES, SEED, Difference, paired_difference
from eldata.protocols.comparability import comparability
from eldata.reports.evaluation.tables import factor_text, group_text, short_digest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.evaluation.saved import SavedResult, SavedScore
    from eldata.reports.evaluation.tables import Format

METRICS: Final = (("PSNR", "dB", 2), ("SSIM", "", 3))
"""Name, unit, and decimals that papers print of a mean."""

_GAIN_DECIMALS = (2, 4)  # differences of SSIM are small

# What of the provenance decides neither which images are scored nor against what.
_NOT_DECIDING = (
    *("predictions", "protocol_digest"),
    *("eldata", "python", "libraw", "numpy", "numba", "rawpy", "exifread", "imagecodecs", "scipy"),
)


@dataclass(frozen=True, slots=True)
class Method:
    """A method by its name in tables, and its result."""

    name: str
    result: SavedResult


@dataclass(frozen=True, slots=True)
class Means:
    """Mean scores of one method over a group of images."""

    psnr_db: float
    ssim: float


@dataclass(frozen=True, slots=True)
class Gain:
    """How much better than the first a method is over a group of images."""

    psnr_db: Difference
    ssim: Difference


@dataclass(frozen=True, slots=True)
class Group:
    """Common images of a camera and factor; ``None`` spans all of them. ``gains`` are of all methods but the first."""

    camera: str | None
    ratio: float | None
    images: int
    scenes: int
    means: tuple[Means, ...]
    gains: tuple[Gain, ...]

    @property
    def name(self) -> str:
        """Camera and factor in words."""
        parts = ("all" if self.camera is None else self.camera, "" if self.ratio is None else factor_text(self.ratio))
        return " ".join(part for part in parts if part)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Methods on their common images.

    Attributes
    ----------
    methods
        The first is what the others are held against.
    images
        Scores of each common image by each method, in the first's order.
    groups
        Camera by factor, each factor over all cameras, and all.
    warnings
        Why the numbers may not compare, with the fields that differ.
    """

    methods: tuple[Method, ...]
    images: tuple[tuple[SavedScore, ...], ...]
    groups: tuple[Group, ...]
    warnings: tuple[str, ...]

    @property
    def whole(self) -> Group:
        """The group of all common images."""
        return self.groups[-1]

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
        result = {
            "methods": [
                {
                    "name": method.name,
                    "file": method.result.source,
                    "scored": len(method.result.images),
                    "protocol": method.result.protocol,
                    "provenance": method.result.provenance,
                }
                for method in self.methods
            ],
            "warnings": list(self.warnings),
            "statistics": {"level": LEVEL, "resamples": RESAMPLES, "seed": SEED, "clusters": ["camera", "scene"]},
            "common": [scores[0].path for scores in self.images],
            "groups": [asdict(group) for group in self.groups],
        }
        return json_safe(result)  # type: ignore[no-any-return] # a dict stays a dict


def compare(methods: Sequence[Method]) -> Comparison:
    """Compare methods with the first on their common images.

    Raises
    ------
    ArgumentError
        If there are fewer than two methods, or two of one name.
    EldataError
        If no image is common to all.
    """
    if len(methods) < 2:
        raise ArgumentError(f"a comparison needs two results or more; found {len(methods)}")
    names = [method.name for method in methods]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ArgumentError(f"two results are called {twice!r}; name each with --name, in the order of the files")
    scores = [{image.path: image for image in method.result.images} for method in methods]
    common = [path for path in scores[0] if all(path in others for others in scores[1:])]
    if not common:
        kinds = ", ".join(
            f"{method.name}: {len(method.result.images)} of {method.result.dataset}" for method in methods
        )
        raise EldataError(f"no image is common to the results ({kinds}); compare results on the same dataset")
    images = tuple(tuple(of[path] for of in scores) for path in common)
    return Comparison(
        methods=tuple(methods),
        images=images,
        groups=_groups(images),
        warnings=(*_warnings(methods), *_image_warnings(methods, images), *_coverage_warnings(methods, len(common))),
    )


def _groups(images: Sequence[tuple[SavedScore, ...]]) -> tuple[Group, ...]:
    cameras = list(dict.fromkeys(scores[0].camera for scores in images))
    ratios = sorted({scores[0].ratio for scores in images})
    keys: list[tuple[str | None, float | None]] = [(camera, ratio) for camera in cameras for ratio in ratios]
    if len(cameras) > 1:
        keys += [(None, ratio) for ratio in ratios]
    keys.append((None, None))
    groups = []
    for camera, ratio in keys:
        members = [
            scores
            for scores in images
            if camera in (None, scores[0].camera) and (ratio is None or scores[0].ratio == ratio)
        ]
        if members:
            groups.append(_group(camera, ratio, members))
    return tuple(groups)


def _group(camera: str | None, ratio: float | None, members: Sequence[tuple[SavedScore, ...]]) -> Group:
    places = [scores[0].place for scores in members]
    by_method = list(zip(*members, strict=True))
    psnr, ssim = ([[getattr(one, field) for one in of] for of in by_method] for field in ("psnr_db", "ssim"))
    return Group(
        camera,
        ratio,
        len(members),
        len(set(places)),
        tuple(Means(mean(first), mean(second)) for first, second in zip(psnr, ssim, strict=True)),
        tuple(
            Gain(paired_difference(psnr[0], first, places), paired_difference(ssim[0], second, places))
            for first, second in zip(psnr[1:], ssim[1:], strict=True)
        ),
    )


# --- warnings -----------------------------------------------------------------------------------------------------


def _warnings(methods: Sequence[Method]) -> list[str]:
    first = methods[0]
    found = []
    for other in methods[1:]:
        a, b = first.result, other.result
        fields = [f"protocol: {words}" for words in comparability(a.protocol, b.protocol)]
        fields += _differing(a.provenance, b.provenance)
        found += [f"{first.name} and {other.name} may not compare: {field}" for field in fields]
    return found


def _differing(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    return [
        f"{name.replace('_', ' ')}: {_value(a, name)} against {_value(b, name)}"
        for name in dict.fromkeys((*a, *b))
        if name not in _NOT_DECIDING and ((name in a) != (name in b) or a.get(name) != b.get(name))
    ]


def _value(fields: dict[str, Any], name: str) -> str:
    if name not in fields:
        return "not stated"
    value = fields[name]
    if isinstance(value, str) and value.startswith("sha256:"):
        return short_digest(value)
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _image_warnings(methods: Sequence[Method], images: Sequence[tuple[SavedScore, ...]]) -> list[str]:
    """Return where the same image is said to be another: of another manifest."""
    found = []
    for index, method in enumerate(methods[1:], start=1):
        for field in ("camera", "scene", "iso", "ratio"):
            off = [scores for scores in images if getattr(scores[0], field) != getattr(scores[index], field)]
            if off:
                was, now = (getattr(off[0][which], field) for which in (0, index))
                found.append(
                    f"{methods[0].name} and {method.name} may not compare: {field} of {len(off)} images differs, such "
                    f"as {off[0][0].path}: {was} and {now}; the groups below are the first's"
                )
    return found


def _coverage_warnings(methods: Sequence[Method], common: int) -> list[str]:
    return [
        f"{method.name} has scores of {len(method.result.images)} images, of which {common} are common to all and count"
        for method in methods
        if len(method.result.images) > common
    ] + [
        f"{method.name} is incomplete: {len(method.result.images)} of {method.result.pairs} pairs were scored"
        for method in methods
        if len(method.result.images) < method.result.pairs
    ]


# --- tables -------------------------------------------------------------------------------------------------------


def mean_texts(group: Group) -> list[str]:
    """Return PSNR and SSIM of each method as printed; what prints like the best of its row is :class:`Strong`."""
    columns = []
    for field, (_, _, decimals) in zip(("psnr_db", "ssim"), METRICS, strict=True):
        values = [getattr(means, field) for means in group.means]
        texts = [f"{value:.{decimals}f}" if not math.isnan(value) else "-" for value in values]
        known = [value for value in values if not math.isnan(value)]
        best = f"{max(known):.{decimals}f}" if known else ""
        columns.append([Strong(text) if text == best else text for text in texts])
    return [text for both in zip(*columns, strict=True) for text in both]


def gain_texts(gain: Gain) -> list[str]:
    """Return difference, interval and p-value of PSNR and of SSIM as printed."""
    cells = []
    for difference, decimals in zip((gain.psnr_db, gain.ssim), _GAIN_DECIMALS, strict=True):
        interval = difference.interval
        cells += [
            signed_text(interval.mean, decimals),
            f"{signed_text(interval.low, decimals)} to {signed_text(interval.high, decimals)}"
            if interval.is_known
            else "-",
            p_text(difference.p_value),
        ]
    return cells


def signed_text(value: float, decimals: int) -> str:
    """Return a difference with its sign; ``-`` for one that is not known."""
    return f"{value:+.{decimals}f}" if not math.isnan(value) else "-"


def p_text(p_value: float) -> str:
    """Return a p-value as printed: three decimals, ``<0.001`` below."""
    if math.isnan(p_value):
        return "-"
    return f"{p_value:.3f}" if p_value >= 0.0005 else "<0.001"


def gain_header() -> tuple[str, ...]:
    """Return the heads of :func:`gain_texts`."""
    heads = []
    for name, unit, _ in METRICS:
        heads += [f"{name}{f' [{unit}]' if unit else ''}", f"{LEVEL:.0%} interval", "p"]
    return tuple(heads)


def format_comparison(comparison: Comparison, form: Format) -> str:
    """Return the tables: means of every method, then each method's differences to the first."""
    if form == "latex":
        return _latex(comparison)
    return _markdown(comparison) if form == "markdown" else _text(comparison)


def summary_of(comparison: Comparison) -> str:
    """Return what was compared, in a line."""
    result = comparison.methods[0].result
    count, scenes = len(comparison.images), comparison.whole.scenes
    return (
        f"{len(comparison.methods)} methods on {count} common {'image' if count == 1 else 'images'} of {scenes} "
        f"{'scene' if scenes == 1 else 'scenes'}: {result.dataset}, protocol {result.protocol_name} "
        f"({short_digest(result.protocol_digest)})"
    )


def statistics_note() -> str:
    """Return what interval and p are, in a sentence."""
    return (
        f"Interval: {LEVEL:.0%}, bootstrap over scenes ({RESAMPLES} resamples, seed {SEED}); p: signs of whole scenes "
        "flipped, two-sided. Of fewer than 6 scenes there is no interval."
    )


def _labels(comparison: Comparison) -> list[tuple[str, str]]:
    """Return camera and factor of each group; a camera's name once."""
    names = [group_text(group.camera) for group in comparison.groups]
    return [
        ("" if index and name == names[index - 1] else name, factor_text(group.ratio))
        for index, (name, group) in enumerate(zip(names, comparison.groups, strict=True))
    ]


def _means_rows(comparison: Comparison) -> list[tuple[str, ...]]:
    return [
        (*label, str(group.images), *mean_texts(group))
        for label, group in zip(_labels(comparison), comparison.groups, strict=True)
    ]


def _gains_rows(comparison: Comparison, index: int) -> list[tuple[str, ...]]:
    return [
        (*label, str(group.images), str(group.scenes), *gain_texts(group.gains[index]))
        for label, group in zip(_labels(comparison), comparison.groups, strict=True)
    ]


_GROUP_HEADER = ("camera", "factor", "images")


def _means_header(comparison: Comparison) -> tuple[str, ...]:
    heads = [f"{method.name} {unit or name}" for method in comparison.methods for name, unit, _ in METRICS]
    return (*_GROUP_HEADER, *heads)


def _text(comparison: Comparison) -> str:
    rows = [
        tuple(
            f"{cell}*" if isinstance(cell, Strong) else f"{cell} " if index > 2 else cell
            for index, cell in enumerate(row)
        )
        for row in _means_rows(comparison)
    ]
    header = tuple(f"{name} " if index > 2 else name for index, name in enumerate(_means_header(comparison)))
    lines = [summary_of(comparison), "", text_table(header, rows), "* best of its row", ""]
    for index, method in enumerate(comparison.methods[1:]):
        lines += [f"{method.name} minus {comparison.methods[0].name}", ""]
        lines += [text_table((*_GROUP_HEADER, "scenes", *gain_header()), _gains_rows(comparison, index)), ""]
    return "\n".join([*lines, statistics_note()])


def _markdown(comparison: Comparison) -> str:
    blocks = [
        markdown_text(summary_of(comparison)),
        markdown_table(_means_header(comparison), _means_rows(comparison)),
    ]
    for index, method in enumerate(comparison.methods[1:]):
        blocks += [
            markdown_text(f"{method.name} minus {comparison.methods[0].name}:"),
            markdown_table((*_GROUP_HEADER, "scenes", *gain_header()), _gains_rows(comparison, index)),
        ]
    blocks += [markdown_text(statistics_note()), *(markdown_text(f"Warning: {text}") for text in comparison.warnings)]
    return "\n\n".join(blocks)


def _latex(comparison: Comparison) -> str:
    summary = summary_of(comparison)
    label = f"tab:{comparison.methods[0].result.dataset}-{comparison.methods[0].result.protocol_name}"
    rules = [index for index, (camera, _) in enumerate(_labels(comparison)) if index and camera]
    names = [name for _ in comparison.methods for name, _, _ in METRICS]
    tables = [
        latex_table(
            (*_GROUP_HEADER, *names),
            _means_rows(comparison),
            caption=f"{summary}. PSNR in dB.",
            label=f"{label}-methods",
            spans=[("", 3), *((method.name, len(METRICS)) for method in comparison.methods)],
            rules=rules,
        )
    ]
    tables += [
        latex_table(
            (*_GROUP_HEADER, "scenes", *gain_header()),
            _gains_rows(comparison, index),
            caption=f"{method.name} minus {comparison.methods[0].name}: {summary}. {statistics_note()}",
            label=f"{label}-{method.name}",
            rules=rules,
        )
        for index, method in enumerate(comparison.methods[1:])
    ]
    return "\n\n".join(tables)
