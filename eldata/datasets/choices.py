"""The keyword arguments that every dataset has, typed once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypedDict, get_args

from eldata.base.arguments import keywords
from eldata.errors import ArgumentError, check_choice
from eldata.manifest.pairs import Choice
from eldata.noise.dark_shading import DarkShading
from eldata.protocols.protocol import Amplification
from eldata.raw.levels import CLIP_RANGES, FRAME_LEVELS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from eldata.raw.levels import Clip, FrameLevels

AMPLIFICATIONS: tuple[Amplification, ...] = get_args(Amplification)


class Representation(TypedDict, total=False):
    """What becomes of DN: keyword arguments of every dataset of pairs or clips.

    Attributes
    ----------
    levels
        ``"published"``: white level 16383 for every camera; ``"metadata"``: the file's own. Black is the file's either
        way. Or the constants of the SID code, or of LRID's, by name: :func:`eldata.raw.levels.with_levels`. RGB is
        divided by 65535. By default those of the protocol that the set's card names: ``"published"`` of ELD and SID,
        ``"metadata"`` of a set of one's own.
    clip
        Of the input. ``"both"``: the normalised frame is clipped to [0, 1] before and after it is multiplied by the
        ratio, as published; ``"upper"``: at 1 only, so that negative read noise is kept; ``"none"``. The target lies in
        [0, 1] whatever it is.
    amplification
        What the input is multiplied by: ``"metadata"``, the ratio of ISO times exposure time that the files state,
        or ``"nominal"``, the manifest's ratio. The files' ratio is checked each time.
    dark_shading
        What the sensor shows of itself in the dark (:class:`~eldata.noise.DarkShading`, or its file), taken off the
        input of each pair or clip, in DN of the file, before anything is clipped. ``None``, the default: nothing. A
        frame of another model, size, CFA or ISO is refused.
    """

    levels: FrameLevels
    clip: Clip
    amplification: Amplification
    dark_shading: DarkShading | Path | str | None


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
    found = keywords(type(owner).__name__, options, *kinds)
    for name, known in (("levels", FRAME_LEVELS), ("clip", tuple(CLIP_RANGES)), ("amplification", AMPLIFICATIONS)):
        for part in found:
            if name in part:
                check_choice(name, part[name], known)
    return found


def chosen_shading(representation: Representation, cameras: Iterable[str] = ()) -> DarkShading | None:
    """Return the dark shading to take off inputs, loaded if it was given as its file.

    Raises
    ------
    ArgumentError
        If the inputs are of several cameras, or it is not a dark shading.
    ShadingError
        If the file cannot be read.
    """
    given = representation.get("dark_shading")
    if given is None:
        return None
    found, several = DarkShading.of(given), list(dict.fromkeys(cameras))
    if len(several) > 1:
        raise ArgumentError(
            f"dark_shading is of one body, {found.camera}, and there are pairs or clips of {len(several)} cameras: "
            f"{', '.join(several)}; choose one with cameras=[...]"
        )
    return found


def shading_text(shading: DarkShading | None) -> str:
    """Return what a repr says of a dark shading; nothing if there is none."""
    return "" if shading is None else f", dark_shading={shading.digest[:15]}"
