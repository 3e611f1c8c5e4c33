"""Clips of a manifest: rows of one scene in the order of their numbers, and windows of consecutive frames.

Rows of role ``noisy`` with the same scene are a clip, and their common ``reference`` is its reference. Positions in a
clip count from 0, whatever the numbers in the file names.

A *sequence* is photographed moment by moment, each a scene of its own, such as ``scene-1-moment-3``: nothing moves
within one, and something has moved from one to the next. Its noisy rows of one camera, ISO and ratio are a clip, in
which each frame has its own reference; of several such rows in each moment, the n-th are the n-th clip.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Literal, get_args

from eldata.errors import ArgumentError, DatasetError, ManifestError, check_choice
from eldata.manifest.card import Subset, find_subset
from eldata.manifest.pairs import Choice, filter_rows
from eldata.manifest.patterns import is_pattern, sequence_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from fractions import Fraction

    from eldata.records import FrameRecord

FrameRange = Literal["all", "authors", "evaluation"]
FRAME_RANGES: tuple[FrameRange, ...] = get_args(FrameRange)

# Neither the DRV nor the ELD paper says which five frames were scored. These are the first of the authors' range; the
# first of them is the one that the DRV repository's test_image.py writes.
EVALUATION_FRAMES = range(4, 9)

_MOMENT = re.compile(r"(.+)-moment-([1-9][0-9]{0,5})")


def moment_name(sequence: str, number: int) -> str:
    """Return the scene that a moment of a sequence is, counted from 1: ``scene-1-moment-3``."""
    return f"{sequence}-moment-{number}"


def moment_of(scene: str) -> tuple[str, int] | None:
    """Return the sequence that a scene is a moment of, and which; ``None`` if it is none."""
    found = _MOMENT.fullmatch(scene)
    return None if found is None else (found[1], int(found[2]))


@dataclass(frozen=True, slots=True)
class Clip:
    """One clip.

    Attributes
    ----------
    scene
        Its name: the scene; of a sequence as ``SonyA7S2/scene-1/ISO800-x100``, its second one ``...-x100-2``.
    split, camera
        As in the manifest.
    frames
        Files of its frames in order, POSIX paths relative to the dataset's folder.
    numbers
        The running number in each frame's name, if the names have one; of a sequence, the moments'.
    reference
        The file of its reference, if it has one; of a sequence, the first frame's.
    references
        Of a sequence, the reference of each frame; else none.
    iso, ratio
        Of a sequence, as in the manifest; else ``None``.
    flags
        Those that every frame has.
    """

    scene: str
    split: str
    camera: str
    frames: tuple[str, ...]
    numbers: tuple[int, ...] | None
    reference: str | None
    references: tuple[str, ...] = ()
    iso: Fraction | None = None
    ratio: Fraction | None = None
    flags: tuple[str, ...] = ()

    def continuous(self, start: int, stop: int) -> bool:
        """Tell whether no number is missing between the frames at these positions."""
        return self.numbers is None or self.numbers[stop - 1] - self.numbers[start] == stop - 1 - start


@dataclass(frozen=True, slots=True)
class ClipRecord:
    """A window of consecutive frames of a clip; answers to the names of :class:`~eldata.records.PairRecord`.

    Attributes
    ----------
    frames
        POSIX paths relative to the dataset's folder.
    start
        Position of the first one in the clip.
    reference, references, iso, ratio, flags
        As of :class:`Clip`; ``references`` are those of these frames.
    """

    frames: tuple[str, ...]
    start: int
    reference: str | None
    camera: str
    scene: str
    split: str
    references: tuple[str, ...] = ()
    iso: Fraction | None = None
    ratio: Fraction | None = None
    flags: tuple[str, ...] = ()

    @property
    def path(self) -> str:
        """The first frame."""
        return self.frames[0]

    @property
    def files(self) -> tuple[str, ...]:
        """The frames and what they are compared with."""
        return (*self.frames, *sorted({*self.references, *filter(None, (self.reference,))}))

    @property
    def name(self) -> str:
        """What messages call it: the clip."""
        return self.scene

    @property
    def nominal_ratio(self) -> float | None:
        """The ratio as a float, if the manifest states one."""
        return None if self.ratio is None else float(self.ratio)

    def reference_of(self, frame: str) -> str | None:
        """Return the reference of one of its frames, if there is one."""
        return self.references[self.frames.index(frame)] if self.references else self.reference

    def place(self, frame: str) -> str:
        """Return the place of a frame's prediction, without its extension.

        In a sequence that is the frame's own path; in another clip ``<clip>/<name of the frame>``, whatever folders the
        frame lies in.
        """
        return frame if self.references else clip_place(self.scene, frame)


def clip_place(scene: str, frame: str) -> str:
    """Return the place of the prediction of a clip's frame, by the frame's scene, without its extension."""
    return f"{scene}/{PurePosixPath(frame).name}" if moment_of(scene) is None else frame


def setting_name(row: FrameRecord) -> str:
    """Return the clip that a noisy row is of, by its scene; in a sequence ``SonyA7S2/scene-1/ISO800-x100``."""
    moment = moment_of(row.scene)
    if moment is None:
        return row.scene
    numbers = ((word, value) for word, value in (("ISO", row.iso), ("x", row.ratio)) if value is not None)
    setting = "-".join(f"{word}{float(value):g}" for word, value in numbers)
    return "/".join(filter(None, (row.camera, moment[0], setting)))


def clip_names(records: Iterable[FrameRecord]) -> dict[str, str]:
    """Return the name of the clip (:attr:`Clip.scene`) that each noisy row is of, by the row's path."""
    names: dict[str, str] = {}
    alike: Counter[tuple[str, str]] = Counter()
    for row in sorted(records, key=attrgetter("path")):
        if row.role == "noisy":
            name = setting_name(row)
            alike[name, row.scene] += 1
            rank = alike[name, row.scene] if moment_of(row.scene) else 1
            names[row.path] = name if rank == 1 else f"{name}-{rank}"
    return names


def choose_clips(
    records: Iterable[FrameRecord],
    subsets: Sequence[Subset],
    choice: Choice = Choice(),  # noqa: B008 # frozen
    *,
    ids: Collection[str] | None = None,
) -> tuple[FrameRecord, ...]:
    """Return the rows of the chosen clips; a clip is chosen if one of its noisy frames is.

    Parameters
    ----------
    records, subsets
        Rows of a manifest, and the subsets of its card.
    choice
        By the values of their noisy frames.
    ids
        Names of clips; the name of a sequence, or of a setting of it, is all of its clips.

    Raises
    ------
    ArgumentError
        If a value does not occur; the message lists those that do. If no clip has all of them.
    ManifestError
        If the subset has another number of clips than its card says.
    """
    rows = tuple(records)
    chosen = noisy = [row for row in rows if row.role == "noisy"]
    if choice.subset is not None:
        subset = find_subset(subsets, choice.subset)
        chosen = subset.members(noisy)
        clips = {row.scene for row in chosen}
        if len(clips) != (subset.pairs or len(clips)):
            raise ManifestError(
                f"subset {choice.subset!r}: the card expects {subset.pairs} clips, the manifest has {len(clips)}; name "
                "those with ids"
            )
    chosen = filter_rows(chosen, noisy, "clip", choice.wanted_values)
    if ids is not None:
        chosen = _of_ids(chosen, noisy, ids)
    kept = {setting_name(row) for row in chosen}
    scenes = {row.scene for row in noisy if setting_name(row) in kept}
    return tuple(row for row in rows if row.scene in scenes and (row.role != "noisy" or setting_name(row) in kept))


def _of_ids(chosen: Iterable[FrameRecord], every: Iterable[FrameRecord], ids: Collection[str]) -> list[FrameRecord]:
    """Return the chosen rows whose clips, or sequences, have these names."""
    clips_in: dict[str, list[str]] = defaultdict(list)
    for row in every:
        if (moment := moment_of(row.scene)) is not None:
            clips_in[moment[0]].append(setting_name(row))
    wanted = ids if isinstance(ids, str) else [name for one in ids for name in clips_in.get(one, [one])]
    by_name = [[replace(row, scene=setting_name(row)) for row in rows] for rows in (chosen, every)]
    kept = {row.path for row in filter_rows(by_name[0], by_name[1], "clip", {"scene": wanted})}
    return [row for row in chosen if row.path in kept]


def clips_of(records: Iterable[FrameRecord]) -> tuple[Clip, ...]:
    """Return the clips of a manifest's rows, sorted by name. Every row must be a file (:func:`expand`).

    Raises
    ------
    DatasetError
        If a clip has no frames or no file for its reference, or the frames' names do not follow one numbering.
    """
    scenes: dict[str, list[FrameRecord]] = defaultdict(list)
    records = tuple(records)
    files = {row.path for row in records}
    names = clip_names(records)
    for row in records:
        if row.role == "noisy":
            scenes[names[row.path]].append(row)
    without = sorted(scene for scene, rows in scenes.items() if any(is_pattern(row.path) for row in rows))
    if without:
        have = sorted(set(scenes) - set(without))
        hint = f"choose those that you have with ids={have!r}" if have else "is this the right folder?"
        raise DatasetError(f"no frames of {len(without)} clips, {', '.join(without[:5])} ...: {hint}")
    return tuple(_make_clip(scene, rows, files) for scene, rows in sorted(scenes.items()))


def _make_clip(scene: str, rows: Sequence[FrameRecord], files: Collection[str]) -> Clip:
    """Make a clip of its noisy rows; refuse one without one numbering, folder and reference."""
    moments = {row.path: moment[1] for row in rows if (moment := moment_of(row.scene)) is not None}
    if moments:
        return _sequence(scene, sorted(rows, key=lambda row: moments[row.path]), tuple(sorted(moments.values())), files)
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
    split, camera = rows[0].split, rows[0].camera
    return Clip(scene, split, camera, frames, sequence.numbers, reference, flags=_shared_flags(rows))


def _shared_flags(rows: Sequence[FrameRecord]) -> tuple[str, ...]:
    """List the flags that all rows have."""
    return tuple(flag for flag in rows[0].flags if all(flag in row.flags for row in rows))


def _sequence(name: str, rows: Sequence[FrameRecord], moments: tuple[int, ...], files: Collection[str]) -> Clip:
    """Make a clip of a sequence's moments, sorted, each with a reference of its own."""
    references = tuple(row.reference for row in rows if row.reference is not None and row.reference in files)
    if len(references) < len(rows):
        lone = ", ".join(row.path for row in rows if row.reference is None or row.reference not in files)
        raise DatasetError(f"clip {name}: expected a file as the reference of each frame; found none of {lone}")
    first = rows[0]
    frames = tuple(row.path for row in rows)
    facts = first.iso, first.ratio, _shared_flags(rows)
    return Clip(name, first.split, first.camera, frames, moments, references[0], references, *facts)


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
    place, facts = (clip.camera, clip.scene, clip.split), (clip.iso, clip.ratio, clip.flags)
    found = [
        ClipRecord(clip.frames[start:stop], start, next(iter(own), clip.reference), *place, own, *facts)
        for start in range(inside.start, inside.stop - length + 1, stride)
        for stop, own in [(start + length, clip.references[start : start + length])]
        if clip.continuous(start, stop)
    ]
    if not found:
        raise DatasetError(
            f"clip {clip.scene}: has no {length} continuous frames among its {len(clip.frames)} (frames={frames!r}); "
            "is the copy whole? eldata verify finds gaps"
        )
    return found
