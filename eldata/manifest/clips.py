"""Clips of a manifest: rows of one scene in the order of their numbers, and windows of consecutive frames.

Rows of role ``noisy`` with the same scene are a clip, and their common ``reference`` is its reference. Positions in a
clip count from 0, whatever the numbers in the file names.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Literal, Unpack, get_args

from eldata.errors import ArgumentError, DatasetError, ManifestError, check_choice
from eldata.manifest.pairs import Choice, narrowed, splits_of
from eldata.manifest.patterns import is_pattern, sequence_of
from eldata.manifest.subsets import find_subset

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from eldata.manifest.subsets import Subset
    from eldata.records import FrameRecord

FrameRange = Literal["all", "authors", "evaluation"]
FRAME_RANGES: tuple[FrameRange, ...] = get_args(FrameRange)

# Neither the DRV nor the ELD paper says which five frames were scored. These are the first of the authors' range; the
# first of them is the one that the DRV repository's test_image.py writes.
EVALUATION_FRAMES = range(4, 9)


@dataclass(frozen=True, slots=True)
class Clip:
    """One clip.

    Attributes
    ----------
    scene, split, camera
        As in the manifest.
    frames
        Files of its frames in order, POSIX paths relative to the dataset's folder.
    numbers
        The running number in each frame's name, if the names have one.
    reference
        The file of its reference, if it has one.
    """

    scene: str
    split: str
    camera: str
    frames: tuple[str, ...]
    numbers: tuple[int, ...] | None
    reference: str | None

    def continuous(self, start: int, stop: int) -> bool:
        """Return whether no number is missing between the frames at these positions."""
        return self.numbers is None or self.numbers[stop - 1] - self.numbers[start] == stop - 1 - start


@dataclass(frozen=True, slots=True)
class ClipRecord:
    """A window of consecutive frames of a clip.

    Attributes
    ----------
    paths
        Its frames, POSIX paths relative to the dataset's folder.
    start
        Position of the first one in the clip.
    reference
        The clip's reference, if it has one.
    """

    paths: tuple[str, ...]
    start: int
    reference: str | None
    camera: str
    scene: str
    split: str

    @property
    def path(self) -> str:
        """The first frame."""
        return self.paths[0]


def choose_clips(
    records: Iterable[FrameRecord],
    subsets: Sequence[Subset],
    *,
    ids: Collection[str] | None = None,
    **choice: Unpack[Choice],
) -> tuple[FrameRecord, ...]:
    """Return the rows of the chosen clips: those of whose noisy frames one is chosen.

    Parameters
    ----------
    records, subsets
        Rows of a manifest, and the subsets of its card.
    ids
        Scenes, by another name.
    choice
        See :class:`~eldata.manifest.pairs.Choice`.

    Raises
    ------
    ArgumentError
        If a value does not occur; the message lists those that do. If no clip has all of them.
    ManifestError
        If the subset has not as many clips as its card says.
    """
    rows = tuple(records)
    chosen = noisy = [row for row in rows if row.role == "noisy"]
    name = choice.get("subset")
    if name is not None:
        subset = find_subset(subsets, name)
        chosen = [row for row in noisy if subset.holds(row)]
        clips = {row.scene for row in chosen}
        if len(clips) != subset.pairs:
            raise ManifestError(
                f"subset {name!r}: the card expects {subset.pairs} clips, the manifest has {len(clips)}; name "
                "those with ids"
            )
    wanted: dict[str, Collection[object] | None] = {
        "camera": choice.get("cameras"),
        "split": splits_of(choice.get("split")),
        "ISO": choice.get("isos"),
        "ratio": choice.get("ratios"),
        "flag": choice.get("exclude_flags", ()),
    }
    for scenes in (choice.get("scenes"), ids):
        chosen = narrowed(chosen, noisy, "clip", wanted | {"scene": scenes})
    kept = {row.scene for row in chosen}
    return tuple(row for row in rows if row.scene in kept)


def clips_of(records: Iterable[FrameRecord]) -> tuple[Clip, ...]:
    """Return the clips of a manifest's rows, sorted by scene. Every row must be a file (:func:`expand`).

    Raises
    ------
    DatasetError
        If a clip has no frames or no file for its reference, or the frames' names do not follow one numbering.
    """
    scenes: dict[str, list[FrameRecord]] = defaultdict(list)
    files: set[str] = set()
    for row in records:
        files.add(row.path)
        if row.role == "noisy":
            scenes[row.scene].append(row)
    without = sorted(scene for scene, rows in scenes.items() if any(is_pattern(row.path) for row in rows))
    if without:
        have = sorted(set(scenes) - set(without))
        hint = f"choose those that you have with ids={have!r}" if have else "is this the right folder?"
        raise DatasetError(f"no frames of {len(without)} clips, {', '.join(without[:5])} ...: {hint}")
    return tuple(_clip(scene, rows, files) for scene, rows in sorted(scenes.items()))


def _clip(scene: str, rows: Sequence[FrameRecord], files: Collection[str]) -> Clip:
    paths = {row.path: PurePosixPath(row.path) for row in rows}
    parents = {path.parent for path in paths.values()}
    sequence = sequence_of(path.name for path in paths.values())
    if sequence.odd or sequence.doubles or len(parents) > 1:
        raise DatasetError(
            f"clip {scene}: its frames do not follow one numbering in one folder: "
            f"{', '.join(sequence.odd) or sequence.doubles or sorted(map(str, parents))}; eldata verify names them"
        )
    references = {row.reference for row in rows}
    reference = references.pop()
    if references or (reference is not None and (is_pattern(reference) or reference not in files)):
        raise DatasetError(
            f"clip {scene}: expected one file as its reference, {reference}; found none, or several (eldata verify "
            "names them)"
        )
    (parent,) = parents
    frames = tuple(str(parent / name) for name in sequence.names)
    return Clip(scene, rows[0].split, rows[0].camera, frames, sequence.numbers, reference)


def frame_range(name: FrameRange, count: int) -> range:
    """Return the positions of a named choice of frames in a clip of ``count`` frames.

    ``"all"``; ``"authors"``: 4 to ``count - 4``, the frames that the DRV repository's test_video.py takes;
    ``"evaluation"``: 4 to 8, five continuous frames per clip as in the ELD paper.

    Raises
    ------
    ArgumentError
        If the name is unknown.
    """
    check_choice("frames", name, FRAME_RANGES)
    chosen = {"all": range(count), "authors": range(4, count - 3), "evaluation": EVALUATION_FRAMES}[name]
    return range(chosen.start, max(chosen.start, min(chosen.stop, count)))


def windows(clip: Clip, *, length: int, stride: int, frames: FrameRange) -> list[ClipRecord]:
    """Return the windows of ``length`` consecutive frames, ``stride`` apart, that lie inside a named range.

    A window in which a number is missing is left out: its frames are not consecutive.

    Raises
    ------
    ArgumentError
        If ``length`` or ``stride`` is below 1, or the range is unknown.
    DatasetError
        If there is no window.
    """
    if length < 1 or stride < 1:
        raise ArgumentError(f"window and stride must be 1 or more; found {length}, {stride}")
    inside = frame_range(frames, len(clip.frames))
    found = [
        ClipRecord(clip.frames[start : start + length], start, clip.reference, clip.camera, clip.scene, clip.split)
        for start in range(inside.start, inside.stop - length + 1, stride)
        if clip.continuous(start, start + length)
    ]
    if not found:
        raise DatasetError(
            f"clip {clip.scene}: has no {length} continuous frames among its {len(clip.frames)} (frames={frames!r}); "
            "is the copy whole? eldata verify finds gaps"
        )
    return found
