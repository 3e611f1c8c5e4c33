"""The frames that are exported: what their files state of themselves."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple, Unpack, get_args

import numpy as np

from eldata.base.files import atomic_write, file_problem, folder_problem, inside, sha256_of
from eldata.base.numbers import counted
from eldata.base.workers import Failed, Workers, require_files
from eldata.errors import DatasetError, EldataError, check_choice
from eldata.manifest.catalogue import FrameFiles, known_manifest, load_manifest
from eldata.manifest.pairs import Choice, refuse_shifted, select_pairs
from eldata.raw.colour import camera_to_srgb

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.base.workers import AnyWorkers
    from eldata.manifest.catalogue import Manifest
    from eldata.records import Exposure, PairRecord, Sensor


@dataclass(frozen=True, slots=True)
class ExportFrame:
    """A frame: its path in the manifest, its file (absolute), what that states; ``sensor`` if it was asked for."""

    path: str
    file: Path
    exposure: Exposure
    sensor: Sensor | None = None


class ExportPair(NamedTuple):
    """A pair of a manifest, and both of its frames."""

    record: PairRecord
    noisy: ExportFrame
    reference: ExportFrame


def exported_pairs(
    name: str = "",
    *,
    manifest: Path | str | None = None,
    root: Path | str | None = None,
    with_sensors: bool = False,
    workers: AnyWorkers = 1,
    **choice: Unpack[Choice],
) -> tuple[Manifest, dict[str, list[ExportPair]]]:
    """Return a set's manifest and its chosen pairs by camera, once each of their files was asked for its exposure.

    ``with_sensors`` decodes the files, for white balance and matrix.

    Raises
    ------
    ManifestError
        If there is no such set, or the manifest is malformed.
    ArgumentError
        If a value of the choice is unknown; the message lists the known ones.
    DatasetError
        If files are missing, or cannot be read; the message has the first of them and how many there are.
    """
    loaded = known_manifest(name) if manifest is None else load_manifest(manifest)
    noisy = [record for record in loaded.records if record.role == "noisy"]
    if noisy and all(record.ratio is None for record in noisy):
        raise DatasetError(f"{loaded.name}: its noisy frames are clips without a ratio, and published code reads pairs")
    pairs = select_pairs(loaded.records, loaded.card.subsets, **choice)
    folder = loaded.folder(root)
    problem = folder_problem(folder)
    if problem is not None:
        raise DatasetError(f"{folder}: {problem}; --root names the folder that holds {loaded.card.folder}")
    paths = list(dict.fromkeys(path for pair in pairs for path in (pair.reference, pair.path)))
    stated = FrameFiles.of(folder, loaded.card, loaded.records).stated
    mosaics = [path for path in paths if path in stated]
    if mosaics:
        raise DatasetError(
            f"{folder / mosaics[0]}: is a mosaic whose levels the set's card states, as are {len(mosaics)} of "
            f"{len(paths)} files; published code reads raw files, by LibRaw: write them as DNG (eldata.raw.write_dng)"
        )
    absent = [path for path in paths if file_problem(inside(folder, path)) is not None]
    if absent:
        raise DatasetError(
            f"{folder / absent[0]}: {file_problem(folder / absent[0])}, as {len(absent)} of {len(paths)} files in all; "
            "choose the pairs that you have by --camera, --split or --subset (eldata verify lists what is missing)"
        )
    work = partial(_stated, folder.absolute(), with_sensors)
    frames = {frame.path: frame for frame in _all_read(Workers.of(workers).attempt(work, paths, label="reading"))}
    found: dict[str, list[ExportPair]] = {}
    for pair in pairs:
        refuse_shifted(pair, "published code compares frames as they lie: leave the pair out")
        found.setdefault(pair.camera, []).append(ExportPair(pair, frames[pair.path], frames[pair.reference]))
    return loaded, found


def _stated(folder: Path, with_sensors: bool, path: str) -> ExportFrame:
    from eldata.raw.reading import read_header, read_raw

    file = inside(folder, path)
    require_files(file)
    if not with_sensors:
        return ExportFrame(path, file, read_header(file).exposure)
    raw = read_raw(file)
    raw.whole_dn("published code, which reads with LibRaw,")
    return ExportFrame(path, file, raw.exposure, raw.sensor)


def _all_read(outcomes: Iterable[ExportFrame | Failed[str]]) -> list[ExportFrame]:
    every = list(outcomes)
    failed = [outcome for outcome in every if isinstance(outcome, Failed)]
    if failed:
        raise DatasetError(f"{failed[0].reason}" + (f"; so are {len(failed) - 1} more" if len(failed) > 1 else ""))
    return [outcome for outcome in every if not isinstance(outcome, Failed)]


# --- a sensor's colours as published code has them beside a frame: float32, nan where unknown -------------------------


def balance_multipliers(sensor: Sensor | None) -> NDArray[np.float32]:
    """Return the multipliers of R, G1, B and G2 as shot, G1 = 1: (4,); nan if the file states none."""
    stated = None if sensor is None else sensor.white_balance
    return np.array((np.nan,) * 4 if stated is None else tuple(map(float, stated)), np.float32)


def matrix_to_srgb(sensor: Sensor | None) -> NDArray[np.float32]:
    """Return the matrix from white-balanced camera R, G, B to linear sRGB: (3, 3); nan if the file states none."""
    if sensor is None or sensor.xyz_to_camera is None:
        return np.full((3, 3), np.nan, np.float32)
    return camera_to_srgb(sensor.xyz_to_camera).astype(np.float32)


# --- what is exported, and how it is written: links first, the lists that name them last, nothing over anything -------

Linking = Literal["symbolic", "hard", "copy"]
LINKINGS: tuple[Linking, ...] = get_args(Linking)


@dataclass(slots=True)
class ExportPlan:
    """What published code is given.

    Attributes
    ----------
    links
        Path below the folder, and the file that it is to lead to.
    lists
        Path below the folder, and the content of a list or info.
    usage
        What to set in the published code, in sentences.
    remarks
        What that code will do otherwise than the manifest says.
    """

    links: dict[str, Path] = field(default_factory=dict)
    lists: dict[str, bytes] = field(default_factory=dict)
    usage: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class ExportReport:
    """What was written.

    Attributes
    ----------
    folder
        Where.
    pairs
        Number of pairs.
    linked, there
        Links made, and files that were there already as wanted.
    lists
        Paths of lists and infos, below the folder.
    usage, remarks
        What to set in the published code, and what it will do otherwise than the manifest says.
    """

    folder: Path
    pairs: int
    linked: int
    there: int
    lists: tuple[str, ...]
    usage: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def format_text(self) -> str:
        """Return it as lines of text."""
        before = f", {counted(self.there, 'file')} there before" if self.there else ""
        lines = [f"{counted(self.pairs, 'pair')} below {self.folder}: {counted(self.linked, 'link')} made{before}"]
        lines += [f"  {path}" for path in self.lists]
        lines += [f"to use it: {line}" for line in self.usage]
        return "\n".join([*lines, *(f"note: {line}" for line in self.remarks)])


def write_export(folder: Path, plan: ExportPlan, pairs: int, linking: Linking) -> ExportReport:
    """Write a plan. What is there as wanted is left, so the same call goes on after an interruption.

    Raises
    ------
    EldataError
        If something else lies where a link or list is to be: nothing is written then. If the system refuses.
    ArgumentError
        If ``linking`` is unknown.
    """
    check_choice("link", linking, LINKINGS)
    links = {path: file for path, file in plan.links.items() if not _is_linked(folder / path, file)}
    lists = {path: content for path, content in plan.lists.items() if not _holds(folder / path, content)}
    taken = [path for path in (*links, *lists) if os.path.lexists(folder / path)]
    if taken:
        raise EldataError(
            f"{folder / taken[0]}: is there already, and not what would be written ({counted(len(taken), 'file')} in "
            "all); nothing was written: name a new folder, or move it away"
        )
    try:
        for path, file in links.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            _link(folder / path, file, linking)
    except OSError as error:
        advice = "; a hard link must lie on the disk of its file: take --link symbolic" if linking == "hard" else ""
        raise EldataError(f"cannot write {folder / path}: {error.strerror or error}{advice}") from error
    for path, content in lists.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(folder / path) as out:
            out.write(content)
    there = len(plan.links) - len(links) + len(plan.lists) - len(lists)
    return ExportReport(folder, pairs, len(links), there, tuple(plan.lists), tuple(plan.usage), tuple(plan.remarks))


def _link(path: Path, file: Path, linking: Linking) -> None:
    if linking == "symbolic":
        path.symlink_to(file)
    elif linking == "hard":
        path.hardlink_to(file.resolve())
    else:
        with file.open("rb") as source, atomic_write(path) as out:
            shutil.copyfileobj(source, out)


def _is_linked(path: Path, file: Path) -> bool:
    """Return whether a path is a link to this file, or a copy of it."""
    try:
        if path.samefile(file):
            return True
        return path.stat().st_size == file.stat().st_size and sha256_of(path) == sha256_of(file)
    except OSError:
        return False


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False
