"""Methods held against the first of them on the images or clips that all have scores of."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.scores import UnitScore, json_object, means
from eldata.evaluation.statistics import LEVEL, RESAMPLES, SEED, Difference, paired_difference
from eldata.evaluation.table import factor_text, groups_of, short_digest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from eldata.evaluation.results import EvaluationResult
    from eldata.protocols.kinds import Kind, Metric

# What of the provenance decides neither which images are scored nor against what.
_NOT_DECIDING = (
    *("predictions", "protocol_digest", "included_flags", "equal_choices", "lpips"),
    *("eldata", "python", "libraw", "numpy", "numba", "rawpy", "exifread", "imagecodecs", "scipy"),
)
# What of it chooses the images, which does not count where the same were chosen.
_CHOOSING = ("cameras", "subset", "ids", "ratios", "set_aside", "excluded_flags")
# What a result means that does not state it, as those of clips of version 0.1 do not.
_UNSTATED: dict[str, Any] = {"cameras": "all", "excluded_flags": {}}
_SHOWN = 10  # biggest wins, and losses


@dataclass(frozen=True, slots=True)
class Method:
    """A method by its name in tables, and its result."""

    name: str
    result: EvaluationResult


@dataclass(frozen=True, slots=True)
class Group:
    """Common images of a camera and factor; ``None`` spans all of them.

    Attributes
    ----------
    camera, ratio, images, scenes
        Which they are, how many (of clips, too), and of how many scenes.
    means
        Of each method, by the metric's name.
    gains
        How much each method but the first is above the first, by the metric's name.
    """

    camera: str | None
    ratio: float | None
    images: int
    scenes: int
    means: tuple[dict[str, float], ...]
    gains: tuple[dict[str, Difference], ...]

    @property
    def name(self) -> str:
        """Camera and factor in words."""
        parts = ("all" if self.camera is None else self.camera, "" if self.ratio is None else factor_text(self.ratio))
        return " ".join(part for part in parts if part)


@dataclass(frozen=True, slots=True)
class Pairing:
    """Scores of one image by the first method and by another."""

    first: UnitScore
    other: UnitScore

    @property
    def gain_db(self) -> float:
        """By how much the other's PSNR is higher; nan if both are infinite."""
        return self.other.psnr_db - self.first.psnr_db

    @property
    def gain_ssim(self) -> float:
        """By how much the other's SSIM is higher."""
        return self.other.ssim - self.first.ssim

    @property
    def is_finite(self) -> bool:
        """Whether both have a finite PSNR."""
        return math.isfinite(self.first.psnr_db) and math.isfinite(self.other.psnr_db)


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
    images: tuple[tuple[UnitScore, ...], ...]
    groups: tuple[Group, ...]
    warnings: tuple[str, ...]

    @property
    def kind(self) -> Kind:
        """What was scored: images or clips, with the numbers that every method has; LPIPS is one of some alone."""
        return _common_kind(self.methods)

    @property
    def whole(self) -> Group:
        """The group of all common images."""
        return self.groups[-1]

    def pairings(self, index: int) -> tuple[Pairing, ...]:
        """Return the scores of the first method and of that of this index among all but the first, image by image."""
        return tuple(Pairing(scores[0], scores[index + 1]) for scores in self.images)

    def extremes(self, index: int) -> tuple[tuple[Pairing, ...], tuple[Pairing, ...]]:
        """Return the biggest wins of that method by PSNR, the biggest first, and its biggest losses."""
        known = sorted((one for one in self.pairings(index) if one.is_finite), key=lambda one: one.gain_db)
        wins = tuple(one for one in known[::-1][:_SHOWN] if one.gain_db > 0)
        return wins, tuple(one for one in known[:_SHOWN] if one.gain_db < 0)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
        result = {
            "methods": [
                {
                    "name": method.name,
                    "file": method.result.source,
                    "scored": method.result.scored,
                    "protocol": method.result.protocol.as_dict(),
                    "provenance": method.result.provenance,
                }
                for method in self.methods
            ],
            "warnings": list(self.warnings),
            "statistics": {"level": LEVEL, "resamples": RESAMPLES, "seed": SEED, "clusters": ["camera", "scene"]},
            "common": [scores[0].path for scores in self.images],
            "groups": [asdict(group) for group in self.groups],
        }
        return json_object(result)


def compare(methods: Sequence[Method]) -> Comparison:
    """Compare methods with the first on their common images or clips.

    Raises
    ------
    ArgumentError
        If there are fewer than two methods, two of one name, or results of images and of clips.
    EldataError
        If no image is common to all.
    """
    if len(methods) < 2:
        raise ArgumentError(f"a comparison needs two results or more; found {len(methods)}")
    names = [method.name for method in methods]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ArgumentError(f"two results are called {twice!r}; name each with --name, in the order of the files")
    kind = _common_kind(methods)
    units = methods[0].result.kind.units
    for method in methods[1:]:
        other = method.result.kind.units
        if other != units:
            raise ArgumentError(f"{names[0]} has scores of {units}, {method.name} of {other}; these do not compare")
    scores = [{score.path: score for score in method.result.scores} for method in methods]
    common = [path for path in scores[0] if all(path in others for others in scores[1:])]
    if not common:
        kinds = ", ".join(f"{method.name}: {method.result.scored} of {method.result.dataset}" for method in methods)
        raise EldataError(f"no {kind.unit} is common to the results ({kinds}); compare results on the same dataset")
    images = tuple(tuple(of[path] for of in scores) for path in common)
    return Comparison(
        methods=tuple(methods),
        images=images,
        groups=_groups(images, kind.metrics),
        warnings=(*_warnings(methods), *_image_warnings(methods, images), *_coverage_warnings(methods, len(common))),
    )


def _common_kind(methods: Sequence[Method]) -> Kind:
    return min((method.result.kind for method in methods), key=lambda kind: len(kind.metrics))


def _groups(images: Sequence[tuple[UnitScore, ...]], metrics: Sequence[Metric]) -> tuple[Group, ...]:
    names = [metric.name for metric in metrics]
    groups = []
    for camera, ratio in groups_of([(scores[0].camera, scores[0].ratio) for scores in images]):
        members = [
            scores for scores in images if camera in (None, scores[0].camera) and ratio in (None, scores[0].ratio)
        ]
        places = [scores[0].place for scores in members]
        of_methods = tuple(zip(*members, strict=True))
        values = [{name: [score.values[name] for score in scores] for name in names} for scores in of_methods]
        groups.append(
            Group(
                camera,
                ratio,
                images=len(members),
                scenes=len(set(places)),
                means=tuple(means(scores, names) for scores in of_methods),
                gains=tuple(
                    {name: paired_difference(values[0][name], other[name], places) for name in names}
                    for other in values[1:]
                ),
            )
        )
    return tuple(groups)


# --- warnings -----------------------------------------------------------------------------------------------------


def _warnings(methods: Sequence[Method]) -> list[str]:
    first = methods[0]
    found = []
    for other in methods[1:]:
        a, b = first.result, other.result
        fields = [f"protocol: {words}" for words in a.scored_unlike(b)]
        fields += _differing(a.provenance, b.provenance, ignored=_CHOOSING if a.chosen == b.chosen else ())
        found += [f"{first.name} and {other.name} may not compare: {field}" for field in fields]
    return found


def _differing(first: Mapping[str, Any], second: Mapping[str, Any], ignored: Sequence[str]) -> list[str]:
    a, b = _UNSTATED | dict(first), _UNSTATED | dict(second)
    return [
        f"{name.replace('_', ' ')}: {_value(a, name)} against {_value(b, name)}"
        for name in dict.fromkeys((*a, *b))
        if name not in (*_NOT_DECIDING, *ignored) and ((name in a) != (name in b) or a.get(name) != b.get(name))
    ]


def _value(fields: dict[str, Any], name: str) -> str:
    if name not in fields:
        return "not stated"
    value = fields[name]
    if isinstance(value, str) and value.startswith("sha256:"):
        return short_digest(value)
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _image_warnings(methods: Sequence[Method], images: Sequence[tuple[UnitScore, ...]]) -> list[str]:
    """Return where the same image is said to be another: of another manifest."""
    units = methods[0].result.kind.units
    found = []
    for index, method in enumerate(methods[1:], start=1):
        for field in ("camera", "scene", "iso", "ratio"):
            off = [scores for scores in images if getattr(scores[0], field) != getattr(scores[index], field)]
            if off:
                was, now = (getattr(off[0][which], field) for which in (0, index))
                found.append(
                    f"{methods[0].name} and {method.name} may not compare: {field} of {len(off)} {units} differs, such "
                    f"as {off[0][0].path}: {was} and {now}; the groups below are the first's"
                )
    return found


def _coverage_warnings(methods: Sequence[Method], common: int) -> list[str]:
    kind = methods[0].result.kind
    counting = f"{kind.units}, of which {common} are common to all and count"
    return [
        f"{method.name} has scores of {method.result.scored} {counting}"
        for method in methods
        if method.result.scored > common
    ] + [
        f"{method.name} is incomplete: {method.result.scored} of {method.result.expected} {kind.counted} were scored"
        for method in methods
        if method.result.scored < method.result.expected
    ]
