"""What is scored: pairs of frames and windows of clips, and where their predictions lie."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING, TypeAlias

from eldata.errors import DatasetError
from eldata.manifest.clips import ClipRecord, moment_of
from eldata.records import PairRecord
from eldata.sources.frames import stated_ratio

if TYPE_CHECKING:
    from eldata.protocols.protocol import Amplification

Pair: TypeAlias = PairRecord | ClipRecord


def frames_of(pair: Pair) -> tuple[str, ...]:
    """Return the noisy frames of a pair or a window."""
    return pair.paths if isinstance(pair, ClipRecord) else (pair.path,)


def files_of(pair: Pair) -> tuple[str, ...]:
    """Return a pair's frames, or a window's, and what they are compared with."""
    references = {reference_of(pair, frame) for frame in frames_of(pair)}
    return (*frames_of(pair), *sorted(filter(None, references)))


def name_of(pair: Pair) -> str:
    """Return what a person calls it: the path of a noisy frame, the number of a clip."""
    return pair.scene if isinstance(pair, ClipRecord) else pair.path


def ratio_of(pair: Pair) -> float | None:
    """Return the nominal factor of a pair; of windows of clips, only those of sequences state one."""
    return None if pair.ratio is None else float(pair.ratio)


def amplified_by(pair: Pair, amplification: Amplification) -> float | None:
    """Return what the manifest has an input multiplied by; ``None``: by the files' ratio, as windows of clips are.

    Raises
    ------
    DatasetError
        If it is to be the measured ratio, and the manifest has none.
    """
    if isinstance(pair, PairRecord):
        ratio = stated_ratio(pair, amplification)
        return None if ratio is None else float(ratio)
    if amplification == "measured":
        raise DatasetError(f"clip {pair.scene}: no ratio of clips is measured; amplification 'metadata' needs none")
    return None


def iso_of(pair: Pair) -> float:
    """Return the ISO of a pair's noisy frame; 0 where it is not known, and of windows of clips but sequences'."""
    return float(pair.iso or 0)


def reference_of(pair: Pair, frame: str) -> str | None:
    """Return what a noisy frame of a pair or a window is compared with, if there is anything."""
    return pair.reference_of(frame) if isinstance(pair, ClipRecord) else pair.reference


def place_of(pair: Pair, frame: str) -> str:
    """Return where the prediction of a noisy frame lies, but for its extension.

    That is the frame's own path, so that a sequence's predictions are those of its photographs; of another clip,
    ``<clip>/<name of the frame>``, whatever folders the frame lies in.
    """
    return clip_place(pair.scene, frame) if isinstance(pair, ClipRecord) and not pair.references else frame


def clip_place(scene: str, frame: str) -> str:
    """Return where the prediction of a clip's frame lies, by the frame's scene, but for its extension."""
    return f"{scene}/{PurePosixPath(frame).name}" if moment_of(scene) is None else frame
