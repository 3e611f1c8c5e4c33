"""The keyword arguments that every dataset has, typed once, and those of 0.1 that are understood until 0.3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, TypedDict, get_args

from eldata.base.keywords import keywords
from eldata.errors import check_choice
from eldata.manifest.pairs import RENAMED, Choice
from eldata.raw.cfa import CLIP_RANGES
from eldata.raw.levels import FRAME_LEVELS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from eldata.raw.cfa import Clip
    from eldata.raw.levels import FrameLevels

Amplification = Literal["metadata", "nominal"]
AMPLIFICATIONS: tuple[Amplification, ...] = get_args(Amplification)


class Representation(TypedDict, total=False):
    """What becomes of DN: keyword arguments of every dataset of pairs or clips.

    Attributes
    ----------
    levels
        ``"published"``: white level 16383 for every camera; ``"metadata"``: the file's own. Black is the file's either
        way. Or the constants of the SID code by name: :func:`eldata.raw.levels.with_levels`. RGB is divided by 65535.
    clip
        ``"both"``: the normalised frame is clipped to [0, 1] before and after the input is multiplied by the ratio,
        as published; ``"upper"``: at 1 only, so that negative read noise is kept; ``"none"``.
    amplification
        What the input is multiplied by: ``"metadata"``, the ratio of ISO times exposure time that the files state, or
        ``"nominal"``, the manifest's ratio. The files' ratio is checked either way.
    """

    levels: FrameLevels
    clip: Clip
    amplification: Amplification


class Options(Choice, Representation, total=False):
    """Which pairs or clips, and what becomes of their DN: see :class:`~eldata.manifest.pairs.Choice`."""


def understood(owner: object, options: Mapping[str, Any], *kinds: type) -> list[Any]:
    """Return a dataset's keyword arguments by kind, each a dictionary of those that a TypedDict names.

    Raises
    ------
    TypeError
        If a name is unknown; the message lists the known ones.
    ArgumentError
        If a value of :class:`Representation` is unknown; the message lists the known ones.
    """
    found = keywords(type(owner).__name__, options, *kinds, renamed=RENAMED | {"crops_per_tile": "crops_per_frame"})
    for name, known in (("levels", FRAME_LEVELS), ("clip", tuple(CLIP_RANGES)), ("amplification", AMPLIFICATIONS)):
        for part in found:
            if name in part:
                check_choice(name, part[name], known)
    return found
