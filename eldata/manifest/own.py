"""One's own raws, from what their files state and how they lie in folders: a manifest and card, or the clean ones.

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
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple

from eldata.base.numbers import counted
from eldata.base.workers import AnyWorkers, Failed, Workers
from eldata.errors import ArgumentError, DatasetError, ManifestError, RawFileError
from eldata.manifest.card import CameraCard, Card, cfa_word, load_card, own_card
from eldata.manifest.catalogue import load_manifest, shipped_folder
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.manifest.verify_report import Problem, row_fault
from eldata.raw.files import ShotFacts, find_doubles, raws_below
from eldata.raw.levels import packing_sites
from eldata.records import FrameRecord, RawHeader, Role, Sensor

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime


SCENE = "{scene}"

_UNFIT = re.compile(r"[^\w.+-]+")  # for a name in a manifest
_BY_HAND = "or write its row by hand (docs/adding-a-dataset.md)"
_UP = 4  # folders above one in which its manifest may lie
_HOW = (
    "say which are: give a manifest (eldata manifest FOLDER -o mine.csv), or a pattern of their paths, such as "
    "reference='*/long/*' (--reference of eldata pack and synthesize); '*' takes all"
)
_WHICH = "say which are references with --reference PATTERN, or where a scene's name stands with --scene PATTERN"


@dataclass(frozen=True, slots=True)
class OwnSet:
    """A manifest of one's own raws, and its problems.

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
    """Sort the raws below a folder into references, noisy frames with their reference and ratio, bias and flat frames.

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
        Pattern of the references' paths below the folder, with ``*`` and ``?`` as in a shell, instead of exposures.
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

    pattern = None if scene is None else _compile_scene(scene)
    frames, left_out, problems = _read_frames(folder, workers)
    cfas = set()
    for first in {frame.model: frame for frame in reversed(frames)}.values():
        _, sensor = raw_facts(folder / first.path, decode=True)
        if isinstance(sensor, Sensor):
            cfas.add(packing_sites(sensor.cfa).name)
        elif sensor is not None:
            problems.append(_describe_unreadable(first.path, sensor))
    records: list[FrameRecord] = []
    scenes: dict[tuple[str, str], list[_Frame]] = defaultdict(list)
    for frame in frames:
        fit = None if pattern is None else pattern.fullmatch(frame.path)
        if not frame.camera:
            problems.append(row_fault(frame.path, "camera", "a model in EXIF", "none", f"use the original, {_BY_HAND}"))
        elif frame.calibration is not None:
            records.append(frame.row(role=frame.calibration))
        elif pattern is not None and fit is None:
            problems.append(row_fault(frame.path, "scene", f"a path like {scene}", "another", "mend --scene PATTERN"))
        else:
            place = frame.path.rpartition("/")[0] if fit is None else fit[1]
            scenes[place or folder.name, frame.model].append(frame)
    count_of = Counter((PurePosixPath(place).name, model) for place, model in scenes)
    titles: dict[tuple[str, str], str] = {}
    for (place, model), members in scenes.items():
        last = PurePosixPath(place).name
        title = _UNFIT.sub("-", last if count_of[last, model] == 1 else place)
        other = titles.setdefault((title, members[0].camera), f"{place} of {model}")
        if other == f"{place} of {model}":
            rows, unclear = _sort_scene(title, members, reference)
            records += rows
            problems += unclear
        else:
            problems.append(row_fault(place, "scene", f"a name of its own, not {title}", other, "rename one of them"))
    records.sort(key=lambda record: record.path)
    models: dict[str, set[str]] = defaultdict(set)
    for frame in frames:
        models[frame.camera].add(frame.model)
    cameras = {camera: CameraCard(tuple(sorted(found))) for camera, found in models.items() if camera}
    sources = ("eldata manifest: roles, ratios and exposures as EXIF and folders say",)
    card = own_card(name, folder.name, records, cfa=cfa_word(cfas), cameras=cameras, sources=sources)
    return OwnSet(card, tuple(records), tuple(problem.of(name) for problem in problems), left_out)


def _read_frames(folder: Path, workers: AnyWorkers) -> tuple[list[_Frame], tuple[tuple[str, str], ...], list[Problem]]:
    """Return one frame of each shot, which other files show it, and the problems of files."""
    frames: list[_Frame] = []
    problems: list[Problem] = []
    for outcome in Workers.of(workers).attempt(partial(_read_frame, folder), raws_below(folder), label="reading"):
        if isinstance(outcome, Failed):
            problems.append(_describe_unreadable(outcome.unit.relative_to(folder).as_posix(), outcome.error))
        else:
            frames.append(outcome)
    files = {folder / frame.path: ShotFacts(frame.model, frame.iso, frame.exposure_s, frame.taken) for frame in frames}
    doubles = find_doubles(files, workers, across=False)
    left_out = {path.relative_to(folder).as_posix(): other for path, other in doubles.items()}
    frames = [frame for frame in frames if frame.path not in left_out]
    spelled: dict[str, str] = {}
    for frame in frames:
        other = spelled.setdefault(frame.path.casefold(), frame.path)
        if other != frame.path:
            expected = "a name that differs from others in more than capitals"
            problems.append(row_fault(frame.path, "file", expected, other, "they are two shots: rename one of them"))
    pairs = sorted((path, other.relative_to(folder).as_posix()) for path, other in left_out.items())
    return frames, tuple(pairs), problems


def _compile_scene(scene: str) -> re.Pattern[str]:
    """Compile a ``--scene`` pattern to an expression whose one group is the scene."""
    if scene.count(SCENE) != 1:
        raise ArgumentError(f"--scene takes a pattern with one {SCENE} in it, such as '*/{SCENE}_*'; found {scene!r}")
    signs = {"*": "[^/]*", "?": "[^/]"}
    before, after = ("".join(signs.get(sign, re.escape(sign)) for sign in part) for part in scene.split(SCENE))
    return re.compile(f"{before}([^/]+?){after}")


def _read_frame(folder: Path, path: Path) -> _Frame:
    """Read a raw file's camera, exposure and time from its header."""
    from eldata.raw.reading import raw_facts

    header, _ = raw_facts(path, decode=False)
    return _make_frame(header, path.relative_to(folder).as_posix())


def _make_frame(header: RawHeader, path: str) -> _Frame:
    """Make a frame of a raw file's header and its path."""
    camera, exposure = name_camera(header.model), header.exposure
    return _Frame(path, header.model, camera, exposure.iso, exposure.exposure_s, header.taken)


def name_camera(model: str) -> str:
    """Name a camera as ``eldata manifest`` does: its model in EXIF, without what does not fit a name."""
    return _UNFIT.sub("", model)


def _describe_unreadable(path: str, error: Exception) -> Problem:
    """Make the problem of a file that cannot be read."""
    reason = error.reason if isinstance(error, RawFileError) else str(error)
    return row_fault(path, "file", "a camera raw", reason, "copy it again, or take it out of the folder")


def _sort_scene(scene: str, frames: Sequence[_Frame], reference: str | None) -> tuple[list[FrameRecord], list[Problem]]:
    """Return the rows of one camera's frames of a scene, or the problems that keep them from being sorted."""
    if unstated := [frame for frame in frames if not frame.light]:
        expected, advice = "ISO and exposure time in EXIF", f"use the original, {_BY_HAND}"
        return [], [row_fault(frame.path, "exposure", expected, "not both", advice) for frame in unstated]
    brightest = max(frames, key=lambda frame: frame.light)
    lowest = min(frame.iso or 0 for frame in frames)
    if reference is None:
        enough = brightest.light / (1 + RATIO_TOLERANCE)
        chosen = [frame for frame in frames if frame.iso == lowest and frame.light >= enough]
        found = f"most light in {brightest.path}, at ISO {brightest.iso}, and others at ISO {lowest}"
    else:
        chosen = [frame for frame in frames if fnmatchcase(frame.path, reference)]
        found = f"no path like {reference}"
    noisy = [frame for frame in frames if frame not in chosen]
    if not chosen or not noisy:
        alone = "exposed alike" if reference is None else "all of them references"
        found = found if noisy else f"{counted(len(frames), 'frame')}, {alone}"
        return [], [row_fault(scene, "reference", "references and noisy frames", found, _WHICH)]
    rows = [frame.row(role="reference", scene=scene, split="test") for frame in chosen]
    for frame in noisy:
        nearest = _nearest(frame, chosen, frames)
        ratio = _nominal(nearest.light / frame.light)
        rows.append(frame.row(role="noisy", scene=scene, split="test", ratio=ratio, reference=nearest.path))
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


# --- which raws of a folder are clean ---------------------------------------------------------------------------------


def clean_raws(folder: Path, reference: str | None = None) -> list[Path]:
    """Return the camera raws below a folder that are clean frames, sorted.

    Of files that a manifest beside them lists, or the shipped one of a folder of that name, these are the references.
    Of others all, if a camera's are of one ISO; else, as ``eldata manifest`` has it, those at its lowest ISO, if in
    each folder they are what was exposed most (ISO times exposure time), and no folder is without them.

    Parameters
    ----------
    folder
        Searched through at any depth.
    reference
        Pattern of the clean frames' paths below it, with ``*`` and ``?``, instead of all this.

    Raises
    ------
    DatasetError
        If there is none, or it is not certain which they are.
    """
    paths = raws_below(folder)
    if reference is not None:
        chosen = [path for path in paths if fnmatchcase(path.relative_to(folder).as_posix(), reference)]
        if not chosen:
            raise DatasetError(f"{folder}: none of its {counted(len(paths), 'camera raw')} has a path like {reference}")
        return chosen
    roles = _listed_roles(folder, paths)
    chosen = [path for path in paths if roles.get(path) == "reference"]
    others = [path for path in paths if path not in roles]
    if not chosen and not others:
        raise DatasetError(f"{folder}: its manifest lists no reference among its {counted(len(paths), 'camera raw')}")
    return sorted(chosen + (_choose_by_exposure(folder, others) if len(others) > 1 else others))


def _listed_roles(folder: Path, paths: Sequence[Path]) -> dict[Path, Role]:
    """Return the roles that a manifest states of these files: the nearest one that lists some."""
    whole = folder.resolve()
    above = (whole, *whole.parents[:_UP])
    near = (*above, *(path for path in whole.iterdir() if path.is_dir()))
    for place in (*(each for one in above for each in (one, one / "manifests")), shipped_folder()):
        for table in sorted(place.glob("*.csv")):
            try:
                name = load_card(table.with_suffix(".json")).folder
            except ManifestError:  # another table
                continue
            bases = [path for path in near if path.name.casefold() == name.casefold()]
            records = load_manifest(table).records if bases else ()
            for base in bases:
                rows = {base / record.path: record.role for record in records}
                roles = {path: rows[there] for path in paths if (there := whole / path.relative_to(folder)) in rows}
                if roles:
                    return roles
    return {}


def _choose_by_exposure(folder: Path, paths: Sequence[Path]) -> list[Path]:
    """Choose each camera's files at its lowest ISO; refuse a folder in which others were exposed more."""
    from eldata.raw.reading import read_header

    cameras: dict[str, list[tuple[Path, _Frame]]] = defaultdict(list)
    chosen: list[Path] = []
    for path in paths:
        try:
            header = read_header(path)
        except RawFileError:
            chosen.append(path)  # whatever reads it says why it cannot
        else:
            cameras[header.model].append((path, _make_frame(header, str(path.parent))))
    for frames in cameras.values():
        isos = sorted({frame.iso for _, frame in frames if frame.iso is not None})
        if len(isos) < 2:
            chosen += [path for path, _ in frames]
            continue
        for place in dict.fromkeys(frame.path for _, frame in frames):
            members = [(path, frame) for path, frame in frames if frame.path == place]
            lowest = [(path, frame) for path, frame in members if frame.iso == isos[0]]
            darkest = min((frame.light for _, frame in lowest), default=Fraction(0))
            if darkest * (1 + RATIO_TOLERANCE) < max(frame.light for _, frame in members) or not lowest:
                those = "those at the lowest are not what was exposed most" if lowest else "none is at the lowest"
                raise DatasetError(
                    f"{folder}: its {counted(len(frames), 'camera raw')} are of ISO {isos[0]} to {isos[-1]}, and in "
                    f"{place} {those}, so it is not certain which are clean; {_HOW}"
                )
            chosen += [path for path, _ in lowest]
    return chosen
