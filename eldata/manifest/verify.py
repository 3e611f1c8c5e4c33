"""Verifying files on the disk against manifests: every problem is found and listed, nothing is written.

Levels, each with those before it:

quick
    Every listed file is there, of the recorded size and not empty; no unlisted raw file lies beside them.
metadata
    Every file opens as a raw file and is not truncated; camera model, ISO and exposure time are the manifest's, and
    the exposure ratio of each noisy frame to its reference is within a tenth of the nominal one. What should be known
    of files that are well is remarked on, each thing once.
full
    Every recorded hash matches. Files without one are decoded instead and searched for damage that shows
    (:mod:`eldata.raw.damage`), which finds less.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import inside, visible_below
from eldata.base.workers import AnyWorkers, Failed, Workers
from eldata.errors import ManifestError, check_choice, did_you_mean
from eldata.manifest.catalogue import FrameFiles, Manifest, find_manifests
from eldata.manifest.file_checks import CheckedFile, check_file
from eldata.manifest.pair_checks import clip_faults, pattern_faults, png_size_faults, ratio_faults, white_remarks
from eldata.manifest.patterns import expand, find_elsewhere, is_pattern, is_png
from eldata.manifest.verify_report import COPY_AGAIN, LEVELS, DatasetReport, VerifyReport, distinct, row_fault
from eldata.raw.files import RAW_EXTENSIONS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from eldata.manifest.verify_report import FileRemark, Level, Problem
    from eldata.raw.levels import MeanLevels
    from eldata.records import FrameRecord


def verify(
    manifests: Path | str | Iterable[Manifest],
    root: Path | str | None = None,
    *,
    cameras: Collection[str] | None = None,
    level: Level = "quick",
    workers: AnyWorkers = 1,
) -> VerifyReport:
    """Check the files below ``root`` against manifests.

    Parameters
    ----------
    manifests
        A manifest's CSV file, a folder of them, a known set's name (its manifest is then as ``eldata lock NAME`` has
        filled it in, if it has), or loaded manifests. Sets that are not there are named as absent; one
        at least must be.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    cameras
        Only these cameras' files are checked, for who has a part of a dataset.
    level
        How deep to look; see the module's text.
    workers
        Number of worker processes, or an executor that looks into the files (:mod:`eldata.base.workers`).

    Raises
    ------
    ManifestError
        If a manifest is malformed, or none has such a camera.

    Examples
    --------
    >>> from eldata import verify
    >>> report = verify("eldata-demo/manifests", "eldata-demo/data", level="metadata")
    >>> len(report.problems)
    0
    """
    workers = Workers.of(workers)
    check_choice("level", level, LEVELS)
    chosen = list(find_manifests(manifests, root) if isinstance(manifests, (str, Path)) else manifests)
    known = sorted({camera for manifest in chosen for camera in manifest.card.cameras})
    for camera in cameras or ():
        if camera not in known:
            hint = did_you_mean(camera, known)
            raise ManifestError(f"no manifest has a camera called {camera!r}; known are {', '.join(known)}{hint}")
    if cameras:
        chosen = [manifest for manifest in chosen if set(cameras) & set(manifest.card.cameras)]
    reports = [_verify_dataset(manifest, manifest.folder(root), cameras, level, workers) for manifest in chosen]
    return VerifyReport(level, tuple(reports))


def _verify_dataset(
    manifest: Manifest, folder: Path, cameras: Collection[str] | None, level: Level, workers: Workers
) -> DatasetReport:
    """Check one manifest's files of these cameras; a missing folder is reported and nothing checked."""
    records = [record for record in manifest.records if not cameras or record.camera in cameras]
    # Two datasets may share a folder and have one each in it (SID/Sony, SID/Fuji): a copy of one may lack the other.
    tops = {record.path.partition("/")[0] for record in manifest.records}
    needed = folder / tops.pop() if len(tops) == 1 and not any(map(is_pattern, tops)) else folder
    if not needed.is_dir():
        return DatasetReport(manifest.name, needed, True, manifest.card.homepage, len(records), 0, 0, ())
    problems, present, remarks, levels_dn = check_files(manifest, folder, records, level=level, workers=workers)
    if level != "quick":
        files = FrameFiles.of(folder.absolute(), manifest.card, present)
        remarks += white_remarks(present, levels_dn, manifest.card.cameras, files, workers)
    hashed = sum(record.sha256 is not None for record in present) if level == "full" else 0
    counts = len(expand(records, folder)), len(present), hashed
    return DatasetReport(manifest.name, folder, False, manifest.card.homepage, *counts, problems, remarks)


def check_files(
    manifest: Manifest, folder: Path, records: Sequence[FrameRecord], *, level: Level, workers: Workers
) -> tuple[tuple[Problem, ...], tuple[FrameRecord, ...], tuple[FileRemark, ...], dict[str, MeanLevels | None]]:
    """Check some of a manifest's files; return the problems, the records of files that are there, remarks, levels.

    The problems are in the order of paths. Levels are known of some files, and of none at level ``quick``.
    """
    listed = expand(records, folder)
    present, problems = _check_presence(manifest, folder, listed)
    problems += _check_unlisted(manifest, folder, listed)
    problems += pattern_faults(records, folder)
    remarks: tuple[FileRemark, ...] = ()
    levels_dn: dict[str, MeanLevels | None] = {}
    if level != "quick":
        files = FrameFiles.of(folder.absolute(), manifest.card, present)
        work = partial(check_file, files, manifest.card.cameras, level)
        outcomes = workers.attempt(work, present, label=f"{manifest.name} ({level})")
        checked = {record.path: _take_outcome(outcome) for record, outcome in zip(present, outcomes, strict=True)}
        problems += [problem for outcome in checked.values() for problem in outcome.problems]
        product_of = {path: outcome.product for path, outcome in checked.items()}
        remarks = distinct((path, outcome.remarks) for path, outcome in checked.items())
        levels_dn = {path: outcome.levels_dn for path, outcome in checked.items()}
        problems += ratio_faults(present, product_of)
        problems += png_size_faults(folder, present)
        problems += clip_faults(present, product_of)
    ordered = sorted(problems, key=lambda problem: problem.path)
    return tuple(problem.of(manifest.name) for problem in ordered), tuple(present), remarks, levels_dn


def _take_outcome(outcome: CheckedFile | Failed[FrameRecord]) -> CheckedFile:
    """Return a file's check; one that failed to run becomes a problem of its file."""
    if not isinstance(outcome, Failed):
        return outcome
    advice = "make it readable where the check runs, and check again"
    return CheckedFile([row_fault(outcome.unit.path, "check", "a finished check", outcome.reason, advice)])


def _check_presence(
    manifest: Manifest, folder: Path, records: Sequence[FrameRecord]
) -> tuple[list[FrameRecord], list[Problem]]:
    """Return the records whose files can be opened, and the problems of the others."""
    present: list[FrameRecord] = []
    problems: list[Problem] = []
    missing: dict[str, list[FrameRecord]] = defaultdict(list)
    for record in records:
        try:
            path = inside(folder, record.path)
            size = path.stat().st_size if path.is_file() else None
        except ManifestError as error:
            expected = "a file below the dataset's folder"
            problems.append(row_fault(record.path, "path", expected, "a link outside", str(error)))
            continue
        if size is None:
            # One line for a whole missing folder, the topmost one that is missing.
            parents = (*reversed(Path(record.path).parents), Path(record.path))
            top = next((part.as_posix() for part in parents if not (folder / part).exists()), record.path)
            missing[top].append(record)
            continue
        if size == 0 or size != (record.size_bytes or size):
            expected = "more than 0 bytes" if record.size_bytes is None else f"{record.size_bytes} bytes"
            problems.append(row_fault(record.path, "size_bytes", expected, f"{size} bytes", COPY_AGAIN))
        if size > 0:
            present.append(record)
    elsewhere = find_elsewhere(folder, (lost[0].path for top, lost in missing.items() if top != lost[0].path), records)
    problems += [_missing(manifest, folder, top, lost, elsewhere) for top, lost in missing.items()]
    return present, problems


def _missing(
    manifest: Manifest, folder: Path, top: str, lost: Sequence[FrameRecord], elsewhere: Mapping[str, str]
) -> Problem:
    """Return the problem that rows have no file, or no folder ``top``."""
    path, other = folder / top, elsewhere.get(lost[0].path)
    beside = visible_below(path.parent, deep=False)
    alike = [other.name for other in beside if other.name.casefold() == path.name.casefold()]
    if top == lost[0].path:
        found, advice = "nothing", COPY_AGAIN
        if path.is_dir():
            found, advice = "a folder", "move it away and copy the file"
        elif alike:
            found, advice = f"only {alike[0]}", f"rename it to {path.name}"
        return row_fault(top, "file", "a file", found, advice)
    if other is not None:
        found, advice = f"{lost[0].path} in another place, {other}", "move it, and the others, to where they are listed"
    elif alike:
        found, advice = f"only {alike[0]}/", f"rename it to {path.name}"
    else:
        found, advice = "no such folder", "unpack it there"
        if len(manifest.card.cameras) > 1 and len({record.camera for record in lost}) == 1:
            advice += f", or check the cameras you have with --camera (this is {lost[0].camera})"
    return row_fault(f"{top}/", "folder", f"{len(lost)} files", found, advice)


def _check_unlisted(manifest: Manifest, folder: Path, records: Sequence[FrameRecord]) -> list[Problem]:
    """Name files of the listed kind that the manifest does not list, in the folders of these records.

    Another form of a listed shot, such as the DNG made of a raw file, is no sign of other frames.
    """
    every = expand(manifest.records, folder)
    count_in = Counter(_name_folder(record.path) for record in every)
    kinds: dict[str, frozenset[str]] = defaultdict(frozenset)
    for record in every:
        if Path(record.path).suffix.lower() in RAW_EXTENSIONS:
            kinds[_name_folder(record.path)] |= RAW_EXTENSIONS
        elif is_png(record.path) and record.role == "noisy":  # beside references may lie other pictures (DRV)
            kinds[_name_folder(record.path)] |= {".png"}
    shots, spelled = {_shot(record.path) for record in every}, {record.path.casefold(): record.path for record in every}
    problems = []
    for parent in sorted({_name_folder(record.path) for record in records}):
        files = visible_below(folder / parent, deep=False)
        alike = [path.relative_to(folder).as_posix() for path in files if path.suffix.lower() in kinds[parent]]
        for path in alike:
            listed = spelled.get(path.casefold())  # if that is missing, so it is reported, with what to do
            if path != listed and (_shot(path) not in shots if listed is None else (folder / listed).exists()):
                expected = f"the {count_in[parent]} listed raw files in this folder"
                advice = "move it away, and make sure that the others were not renumbered"
                problems.append(row_fault(path, "file", expected, f"{len(alike)} raw files, this one unlisted", advice))
    return problems


def _name_folder(path: str) -> str:
    """Return the folder of a POSIX path; ``.`` if it has none."""
    return path.rpartition("/")[0] or "."


def _shot(path: str) -> str:
    """Return a path without extension, in lower case: the same for a shot's raw file and its JPEG."""
    return Path(path).with_suffix("").as_posix().casefold()
