"""The other choices of a protocol, one at a time, and what an image scores under each.

A protocol is data, and so is what could be otherwise: one field has the value that another shipped protocol has. What
scores it is the loop that scores everything (:func:`eldata.evaluation.units.score_plans`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

from eldata.errors import ArgumentError
from eldata.evaluation.layouts import find_predictions
from eldata.evaluation.originals import Originals
from eldata.evaluation.planning import ScoringPlan
from eldata.evaluation.scores import frames_of, place_of
from eldata.evaluation.units import Contender, score_plans
from eldata.protocols.digests import CHOOSING, NEUTRAL, OF_INPUT
from eldata.protocols.kinds import IMAGES
from eldata.protocols.named import PROTOCOLS
from eldata.protocols.protocol import ONE_CAMERAS_LEVELS
from eldata.protocols.words import FIELDS, in_words

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from eldata.evaluation.looking import ScoredImage
    from eldata.evaluation.request import Request
    from eldata.evaluation.scores import Pair
    from eldata.evaluation.units import PlanScores
    from eldata.protocols.protocol import Protocol

# Fields that do not choose how one image is scored: which images, and prose.
_FIXED = (*CHOOSING, "reference")
# What chooses other frames or files than those that were scored.
_OTHER_FILES = {
    "frames": "other frames of the clip",
    "frame_count": "other frames of the clip",
    "pixels": "other files",
}
_NAMES_SHOWN = 2


@dataclass(frozen=True, slots=True)
class Alternative:
    """One field of the protocol with another value, and the score that the same image has so.

    Attributes
    ----------
    name, value
        The field's, such as ``rescaling`` and ``none``.
    like
        The shipped protocols that have this value, those for the dataset first.
    numbers
        The numbers of the score; empty: there is none.
    group, reason
        Why not: ``input``, the prediction was made before; ``alone``, other fields have to change too; ``here``, not
        of this image, for that reason.
    """

    name: str
    value: Any
    like: tuple[str, ...]
    numbers: dict[str, float] = field(default_factory=dict)
    group: str = ""
    reason: str = ""

    @property
    def words(self) -> str:
        """Such as ``rescaling: none, as eld-uncorrected does``."""
        names, more = self.like[:_NAMES_SHOWN], len(self.like) - _NAMES_SHOWN
        text = self._text
        if self.name == "rescaling" and self.numbers and self.value != "none":
            text += f", here {self.numbers['rescale']:.4g}"
        if not names:
            return text
        whose = f"{', '.join(names)} and {more} more" if more > 0 else " and ".join(names)
        return f"{text}, as {whose} {'does' if len(self.like) == 1 else 'do'}"

    @property
    def in_short(self) -> str:
        """Such as ``rescaling: none (eld-uncorrected)``."""
        return f"{self._text} ({self.like[0]})" if self.like else self._text

    @property
    def _text(self) -> str:
        return f"{FIELDS[self.name][0]}: {in_words(self.name, self.value)}"


def changes_of(protocol: Protocol, request: Request, unit: Pair) -> Iterator[Alternative]:
    """Yield each field with each value that another shipped protocol has, or that is neutral, without scores yet."""
    dataset = request.manifest.name
    pool = [one for one in PROTOCOLS.values() if protocol.kind is not IMAGES or one.kind is IMAGES]
    pool.sort(key=lambda one: (one.kind is not protocol.kind, not one.covers(dataset)))
    having = {one.name: {field.name for field in fields(one)} for one in (protocol, *pool)}
    for name in FIELDS:
        if name not in having[protocol.name] or name in _FIXED:
            continue
        like: dict[Any, list[Protocol]] = {NEUTRAL[name]: []} if name in NEUTRAL else {}
        for one in pool:
            if name in having[one.name]:
                like.setdefault(getattr(one, name), []).append(one)
        like.pop(getattr(protocol, name), None)
        for value, of in like.items():
            group, reason = _why_not(protocol, name, value, request)
            if name == "levels" and value in ONE_CAMERAS_LEVELS and not any(_is_for(one, dataset, unit) for one in of):
                group, reason = "here", "constants of another camera"
            yield Alternative(name, value, tuple(one.name for one in of), group=group, reason=reason)


def _is_for(protocol: Protocol, dataset: str, unit: Pair) -> bool:
    return protocol.covers(dataset) and (not protocol.cameras or unit.camera in protocol.cameras)


def _why_not(protocol: Protocol, field: str, value: Any, request: Request) -> tuple[str, str]:
    """Return why a choice is not to be scored, if it is not: a group of :class:`Alternative`, and the reason."""
    if field in _OTHER_FILES:
        return "here", f"it chooses {_OTHER_FILES[field]}"
    try:
        replace(protocol, **{field: value}).check()
    except ArgumentError as error:
        return "alone", str(error)
    if field in OF_INPUT and request.predictions is not None:
        return "input", "the prediction was made before"
    if field == "dark_shading":
        return "here", "leave --dark-shading (dark_shading) out"
    return "", ""


def score_each(
    request: Request, images: Sequence[ScoredImage], protocols: Sequence[Sequence[Protocol]]
) -> list[PlanScores]:
    """Return what each image scores under each of its protocols; under the first it is looked at for mistakes."""
    contenders = []
    for image, of in zip(images, protocols, strict=True):
        places = [place_of(image.pair, frame) for frame in frames_of(image.pair)]
        files = None if request.predictions is None else find_predictions(request.predictions, places).files
        contenders += [Contender(ScoringPlan(protocol, (image.pair,)), 0, files, protocol is of[0]) for protocol in of]
    return score_plans(request, Originals.opened(request.files, request.store), contenders)


def with_score(one: Alternative, found: PlanScores, path: str) -> Alternative:
    """Return a choice with what the image of this path scored under it, or with why it has no score."""
    if path in found.scores:
        return replace(one, numbers=found.scores[path].values)
    reason = (*found.unfit, *found.problems)[0].reason
    return replace(one, group="here", reason=reason.partition(" cannot score it: ")[2] or reason)
