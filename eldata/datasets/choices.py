"""What becomes of DN, in every dataset of pairs and clips."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from eldata.errors import ArgumentError, check_choice
from eldata.noise.dark_shading import DarkShading
from eldata.protocols.protocol import Amplification
from eldata.raw.levels import CLIP_RANGES, FRAME_LEVELS

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from eldata.raw.levels import Clip, FrameLevels

AMPLIFICATIONS: tuple[Amplification, ...] = get_args(Amplification)


def check_representation(levels: FrameLevels, clip: Clip, amplification: Amplification) -> None:
    """Raise :class:`ArgumentError` if one is unknown; the message lists the known ones."""
    check_choice("levels", levels, FRAME_LEVELS)
    check_choice("clip", clip, tuple(CLIP_RANGES))
    check_choice("amplification", amplification, AMPLIFICATIONS)


def chosen_shading(shading: DarkShading | Path | str | None, cameras: Iterable[str]) -> DarkShading | None:
    """Return the dark shading to take off the inputs of these cameras, loaded if it was given as its file.

    Raises
    ------
    ArgumentError
        If the inputs are of several cameras, or it is not a dark shading.
    ShadingError
        If the file cannot be read.
    """
    if shading is None:
        return None
    found, several = DarkShading.of(shading), list(dict.fromkeys(cameras))
    if len(several) > 1:
        raise ArgumentError(
            f"dark_shading is of one body, {found.camera}, and there are pairs or clips of {len(several)} cameras: "
            f"{', '.join(several)}; choose one with cameras=[...]"
        )
    return found


def shading_text(shading: DarkShading | None) -> str:
    """Return what a repr says of a dark shading; nothing if there is none."""
    return "" if shading is None else f", dark_shading={shading.digest[:15]}"
