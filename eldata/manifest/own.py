"""A manifest and card of one's own raws, from what their files state and from how they lie in folders.

A scene is a folder, unless a pattern says otherwise. In it the reference is what was exposed most (ISO times exposure
time) at the lowest ISO: frames of factor 1 are exposed as much, at a higher one. Where that does not tell, it is asked.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from dataclasses import dataclass
from fnmatch import fnmatchcase
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from eldata.base.numbers import counted
from eldata.base.workers import Failed, Workers
from eldata.errors import ArgumentError, RawFileError
from eldata.manifest.card import CameraCard, Card, cfa_word, counts_of, title_of_set
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.manifest.verify_report import Problem
from eldata.raw.files import ShotFacts, find_doubles, raws_below
from eldata.raw.levels import packing_sites
from eldata.records import FrameRecord, Sensor

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime
    from pathlib import Path

    from eldata.base.workers import AnyWorkers
    from eldata.records import Role

SCENE = "{scene}"

_UNFIT = re.compile(r"[^\w.+-]+")  # for a name in a manifest
_BY_HAND = "or write its row by hand (docs/adding-a-dataset.md)"
_WHICH = "say which are references with --reference PATTERN, or where a scene's name stands with --scene PATTERN"


@dataclass(frozen=True, slots=True)
class OwnSet:
    """What a folder of raws was taken for.

    Attributes
    ----------
    card, records
        Of the set; what only its owner knows, such as the licence, is left to fill in.
    problems
        What could not be told of files or scenes; no row is right while there is one.
    left_out
        Files that show the shot of another one, and that one.
    """

    card: Card
    records: tuple[FrameRecord, ...]
    problems: tuple[Problem, ...]
    left_out: tuple[tuple[str, str], ...] = ()

    def format_text(self) -> str:
        """Return a line for the scenes of a camera that were shot alike: how many, and what was taken for what."""
        scenes: dict[tuple[str, str], list[FrameRecord]] = defaultdict(list)
        for record in self.records:
            scenes[record.camera, record.scene].append(record)
        alike: dict[tuple[str, str], list[FrameRecord]] = defaultdict(list)
        for (camera, _), frames in scenes.items():
            roles = Counter(record.role for record in frames)
            ratios = Counter(float(record.ratio) for record in frames if record.ratio is not None)
            what = [counted(count, role if role == "reference" else f"{role} frame") for role, count in roles.items()]
            of = ", ".join(f"{count} x{ratio:g}" for ratio, count in sorted(ratios.items()))
            first = next((record for record in frames if record.role == "reference"), frames[0])
            alike[camera, " and ".join(what) + (f" ({of})" if of else "")].append(first)
        lines = []
        for (camera, told), (first, *more) in alike.items():
            count = f"{counted(1 + len(more), 'scene')} with " if first.scene else ""
            stated = ("not stated" if value is None else str(value) for value in (first.iso, first.exposure_s))
            exposed = "ISO {}, {} s".format(*stated)
            lines.append(f"{camera}: {count}{told}; the first {first.role} is {first.path} ({exposed})")
        if self.left_out:
            path, other = self.left_out[0]
            others = f"; {len(self.left_out) - 1} more alike" if len(self.left_out) > 1 else ""
            lines.append(
                f"left out: {path} shows the shot of {other}{others}. Move copies away, which eldata verify takes for "
                "other frames"
            )
        return "\n".join(lines)


class _Frame(NamedTuple):
    """A file, and what it states."""

    path: str
    model: str
    camera: str
    iso: Fraction | None
    exposure_s: Fraction | None
    taken: datetime | None

    @property
    def light(self) -> Fraction:
        """What it was amplified and exposed to, together; 0: it does not state both."""
        return (self.iso or Fraction(0)) * (self.exposure_s or Fraction(0))

    @property
    def calibration(self) -> Role | None:
        """Whether it is a bias or flat frame, by the folders that it lies in."""
        parts = self.path.split("/")[:-1]
        return "bias" if "bias" in parts else "flat" if "flat" in parts else None

    def row(self, **fields: Any) -> FrameRecord:
        """Return its row of the manifest."""
        return FrameRecord(self.path, camera=self.camera, iso=self.iso, exposure_s=self.exposure_s, **fields)


def sort_own_set(
    folder: Path, name: str, *, reference: str | None = None, scene: str | None = None, workers: AnyWorkers = 1
) -> OwnSet:
    """Say what each raw below a folder is: reference, noisy frame of which reference and ratio, bias or flat frame.

    Frames below a folder ``bias`` or ``flat`` are calibration frames. A noisy frame belongs to the reference of its
    scene and camera that was taken nearest to it, by the clock where all of them state a time, else by their names'
    order. Its ratio is the nominal one: what the exposures give, to one digit if that is within a tenth, else to two.

    Parameters
    ----------
    folder
        The set's own; the folder above it is the data root.
    name
        Of the set.
    reference
        Pattern of the references' paths below the folder, with ``*`` and ``?`` as in a shell, in place of exposures.
    scene
        Pattern of all paths with ``{scene}`` where a scene's name stands, such as ``*/{scene}_*``; ``*`` ends at a
        folder. Without it, a scene is a folder; where two of a camera have one name, their paths are their names.
    workers
        Number of worker processes, or an executor, that look into the files.

    Raises
    ------
    DatasetError
        If there is no such folder, or no camera raw in it.
    ArgumentError
        If the pattern of scenes has not one ``{scene}``.
    """
    from eldata.raw.reading import raw_facts

    pattern = None if scene is None else _scene_pattern(scene)
    problem = partial(Problem, name)
    problems: list[Problem] = []
    frames: list[_Frame] = []
    for outcome in Workers.of(workers).attempt(partial(_looked_into, folder), raws_below(folder), label="reading"):
        if isinstance(outcome, Failed):
            problems.append(_broken(problem, outcome.unit.relative_to(folder).as_posix(), outcome.error))
        else:
            frames.append(outcome)
    frames, left_out = _drop_doubles(folder, frames, workers)
    spelled: dict[str, str] = {}
    for frame in frames:
        other = spelled.setdefault(frame.path.casefold(), frame.path)
        if other != frame.path:
            expected = "a name that differs from others in more than capitals"
            problems.append(problem(frame.path, "file", expected, other, "they are two shots: rename one of them"))
    filters = set()
    for first in {frame.model: frame for frame in reversed(frames)}.values():
        _, sensor = raw_facts(folder / first.path, decode=True)
        if isinstance(sensor, Sensor):
            filters.add(packing_sites(sensor.cfa).name)
        elif sensor is not None:
            problems.append(_broken(problem, first.path, sensor))
    records: list[FrameRecord] = []
    scenes: dict[tuple[str, str], list[_Frame]] = defaultdict(list)
    for frame in frames:
        found = None if pattern is None else pattern.fullmatch(frame.path)
        if not frame.camera:
            problems.append(problem(frame.path, "camera", "a model in EXIF", "none", f"use the original, {_BY_HAND}"))
        elif frame.calibration is not None:
            records.append(frame.row(role=frame.calibration))
        elif pattern is not None and found is None:
            problems.append(problem(frame.path, "scene", f"a path like {scene}", "another", "mend --scene PATTERN"))
        else:
            place = frame.path.rpartition("/")[0] if found is None else found[1]
            scenes[place or folder.name, frame.model].append(frame)
    titles: dict[tuple[str, str], str] = {}
    for (place, model), members in scenes.items():
        alike = [other for other, of in scenes if of == model and _last(other) == _last(place)]
        title = _UNFIT.sub("-", _last(place) if len(alike) == 1 else place)
        other = titles.setdefault((title, members[0].camera), f"{place} of {model}")
        if other != f"{place} of {model}":
            problems.append(problem(place, "scene", f"a name of its own, not {title}", other, "rename one of them"))
            continue
        rows, unclear = _sort_scene(title, members, reference, problem)
        records += rows
        problems += unclear
    records.sort(key=lambda record: record.path)
    card = _card(name, folder.name, cfa_word(filters), frames, records)
    return OwnSet(card, tuple(records), tuple(problems), left_out)


def _drop_doubles(
    folder: Path, frames: list[_Frame], workers: AnyWorkers
) -> tuple[list[_Frame], tuple[tuple[str, str], ...]]:
    """Return one frame of each shot, and which other files show it."""
    files = {folder / frame.path: ShotFacts(frame.model, frame.iso, frame.exposure_s, frame.taken) for frame in frames}
    doubles = find_doubles(files, workers, across=False)
    left_out = {path.relative_to(folder).as_posix(): other for path, other in doubles.items()}
    kept = [frame for frame in frames if frame.path not in left_out]
    return kept, tuple((path, other.relative_to(folder).as_posix()) for path, other in sorted(left_out.items()))


def _scene_pattern(scene: str) -> re.Pattern[str]:
    if scene.count(SCENE) != 1:
        raise ArgumentError(f"--scene takes a pattern with one {SCENE} in it, such as '*/{SCENE}_*'; found {scene!r}")
    signs = {"*": "[^/]*", "?": "[^/]"}
    before, after = ("".join(signs.get(sign, re.escape(sign)) for sign in part) for part in scene.split(SCENE))
    return re.compile(f"{before}([^/]+?){after}")


def _looked_into(folder: Path, path: Path) -> _Frame:
    from eldata.raw.reading import raw_facts

    header, _ = raw_facts(path, decode=False)
    camera, exposure = _UNFIT.sub("", header.model), header.exposure
    place = path.relative_to(folder).as_posix()
    return _Frame(place, header.model, camera, exposure.iso, exposure.exposure_s, header.taken)


def _last(place: str) -> str:
    return place.rpartition("/")[2]


def _broken(problem: partial[Problem], path: str, error: Exception) -> Problem:
    reason = error.reason if isinstance(error, RawFileError) else str(error)
    return problem(path, "file", "a camera raw", reason, "copy it again, or take it out of the folder")


def _sort_scene(
    scene: str, frames: Sequence[_Frame], reference: str | None, problem: partial[Problem]
) -> tuple[list[FrameRecord], list[Problem]]:
    """Return the rows of a scene's frames of one camera, or what is unclear about them."""
    unstated = [frame for frame in frames if not frame.light]
    if unstated:
        expected, advice = "ISO and exposure time in EXIF", f"use the original, {_BY_HAND}"
        return [], [problem(frame.path, "exposure", expected, "not both", advice) for frame in unstated]
    brightest = max(frames, key=lambda frame: frame.light)
    lowest = min(frame.iso or 0 for frame in frames)
    if reference is None:
        chosen = [one for one in frames if one.iso == lowest and one.light * (1 + RATIO_TOLERANCE) >= brightest.light]
        found = f"most light in {brightest.path}, at ISO {brightest.iso}, and others at ISO {lowest}"
    else:
        chosen = [one for one in frames if fnmatchcase(one.path, reference)]
        found = f"no path like {reference}"
    noisy = [frame for frame in frames if frame not in chosen]
    if not chosen or not noisy:
        alone = "exposed alike" if reference is None else "all of them references"
        found = found if noisy else f"{counted(len(frames), 'frame')}, {alone}"
        return [], [problem(scene, "reference", "references and noisy frames", found, _WHICH)]
    rows = [one.row(role="reference", scene=scene, split="test") for one in chosen]
    for one in noisy:
        nearest = _nearest(one, chosen, frames)
        ratio = _nominal(nearest.light / one.light)
        rows.append(one.row(role="noisy", scene=scene, split="test", ratio=ratio, reference=nearest.path))
    return rows, []


def _nearest(frame: _Frame, references: Sequence[_Frame], scene: Sequence[_Frame]) -> _Frame:
    """Return the reference that was taken nearest to a frame; the earlier of two."""
    if all(one.taken is not None for one in scene):
        return min(references, key=lambda one: abs(one.taken - frame.taken))  # type: ignore[operator] # all have one
    return min(references, key=lambda one: abs(scene.index(one) - scene.index(frame)))


def _nominal(ratio: Fraction) -> Fraction:
    """Return a ratio as people name it: shutters round, so that 200 may be 213 (:data:`RATIO_TOLERANCE`)."""
    one, two = (Fraction(f"{float(ratio):.{digits}e}") for digits in (0, 1))
    return one if abs(ratio - one) <= RATIO_TOLERANCE * one else two


def _card(name: str, folder: str, cfa: str, frames: Sequence[_Frame], records: Sequence[FrameRecord]) -> Card:
    models: dict[str, set[str]] = defaultdict(set)
    for frame in frames:
        models[frame.camera].add(frame.model)
    scenes = len({record.scene for record in records} - {""})
    return Card(
        name=name,
        title=title_of_set(records, scenes),
        version="1.0",
        folder=folder,
        citation="not stated",
        licence="not stated",
        homepage="not stated",
        cfa=cfa,
        cameras={camera: CameraCard(tuple(sorted(found))) for camera, found in models.items() if camera},
        counts=counts_of(records),
        sources=("eldata manifest: roles, ratios and exposures as EXIF and folders say",),
    )
