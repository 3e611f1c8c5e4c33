"""What is scored: pairs of frames and windows of clips, and where their predictions lie."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING, TypeAlias

from eldata.errors import DatasetError
from eldata.manifest.clips import ClipRecord
from eldata.records import PairRecord
from eldata.sources.pairs import stated_ratio

if TYPE_CHECKING:
    from eldata.protocols.protocol import Amplification

Pair: TypeAlias = PairRecord | ClipRecord


def frames_of(pair: Pair) -> tuple[str, ...]:
    """Return the noisy frames of a pair or a window."""
    return pair.paths if isinstance(pair, ClipRecord) else (pair.path,)


def name_of(pair: Pair) -> str:
    """Return what a person calls it: the path of a noisy frame, the number of a clip."""
    return pair.scene if isinstance(pair, ClipRecord) else pair.path


def ratio_of(pair: Pair) -> float | None:
    """Return the nominal factor of a pair; windows of clips state none."""
    return float(pair.ratio) if isinstance(pair, PairRecord) else None


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
    """Return the ISO of a pair's noisy frame; 0 where it is not known, and of windows of clips."""
    return float(pair.iso or 0) if isinstance(pair, PairRecord) else 0.0


def place_of(pair: Pair, frame: str) -> str:
    """Return where the prediction of a noisy frame lies, but for its extension.

    That is the frame's own path; of a clip, ``<clip>/<name of the frame>``, whatever folders the frame lies in.
    """
    return clip_place(pair.scene, frame) if isinstance(pair, ClipRecord) else frame


def clip_place(clip: str, frame: str) -> str:
    """Return where the prediction of a clip's frame lies, but for its extension."""
    return f"{clip}/{PurePosixPath(frame).name}"
