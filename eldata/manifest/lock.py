"""Filling in a manifest's sizes and hashes from a copy that its user trusts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from eldata.base.files import inside, sha256_of, write_problem
from eldata.base.workers import AnyWorkers, Failed, Workers, require_files
from eldata.errors import ManifestError
from eldata.manifest.card import CameraCard, counts_of
from eldata.manifest.catalogue import (
    FrameFiles,
    Manifest,
    data_root,
    find_manifest,
    known_manifest,
    known_names,
    load_manifest,
    locked_path,
    save_manifest,
)
from eldata.manifest.file_checks import check_file
from eldata.manifest.patterns import expand
from eldata.manifest.verify import verify
from eldata.manifest.verify_report import Problem, VerifyReport, row_fault

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping
    from pathlib import Path

    from eldata.records import FrameRecord


@dataclass(frozen=True, slots=True)
class LockReport:
    """The result of :func:`lock`: the checks made first, and how much was filled in: nothing unless all was well.

    ``path`` is the manifest's file that has been written, or would have been.
    """

    path: Path
    checks: VerifyReport
    problems: tuple[Problem, ...]
    files_locked: int


def lock(
    manifest: Path | str,
    root: Path | str | None = None,
    *,
    cameras: Collection[str] | None = None,
    workers: AnyWorkers = 1,
) -> LockReport:
    """Record size and hash of every file of a manifest, and write the manifest whole or not at all.

    A row that stands for several files (:mod:`eldata.manifest.patterns`) becomes a row for each file of this copy; then
    the card, which says how many rows there are, is written too.

    The copy must pass :func:`~eldata.manifest.verify.verify` at level ``metadata`` first, files whose hash is not
    recorded must decode and show no damage, and none may contradict a size or hash that is recorded already; with any
    problem nothing is written.

    Parameters
    ----------
    manifest
        The manifest's CSV file, or a set's of one's own by its name: the file is changed. Or the name of a known set:
        what is filled in is then written to ``<root>/manifests/<name>.csv``, beside the data, where
        :func:`~eldata.manifest.verify.verify` finds it by name.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    cameras
        Lock just these cameras' files.
    workers
        Number of worker processes, or an executor that reads the files (:mod:`eldata.base.workers`).

    Raises
    ------
    ManifestError
        If the manifest is malformed, or no set has the name.
    EldataError
        If it cannot be written.
    """
    loaded, path = _find_source(manifest, root)
    workers = Workers.of(workers)
    checks = verify([loaded], root, cameras=cameras, level="metadata", workers=workers)
    if not checks.ok:
        return LockReport(path, checks, checks.problems, 0)
    folder = loaded.folder(root)
    listed = expand(loaded.records, folder)
    chosen = [record for record in listed if not cameras or record.camera in cameras]
    locked: dict[str, FrameRecord] = {}
    problems: list[Problem] = []
    work = partial(_lock_file, FrameFiles.of(folder.absolute(), loaded.card, chosen), loaded.card.cameras)
    for outcome in workers.attempt(work, chosen, label=f"{loaded.name} (hashing)"):
        if isinstance(outcome, Failed):
            advice = "make it readable where the hash is taken, and lock again"
            problems.append(Problem(loaded.name, outcome.unit.path, "sha256", "a hash", outcome.reason, advice))
        else:
            record, of_file = outcome
            locked[record.path] = record
            problems += [problem.of(loaded.name) for problem in of_file]
    if problems:
        return LockReport(path, checks, tuple(problems), 0)
    path.parent.mkdir(exist_ok=True)
    card = replace(loaded.card, counts=counts_of(listed))
    save_manifest(path, card, [locked.get(record.path, record) for record in listed])
    return LockReport(path, checks, (), len(chosen))


def _find_source(manifest: Path | str, root: Path | str | None) -> tuple[Manifest, Path]:
    """Return the manifest that is to be filled in, and the file that it is written to, which is tried."""
    if manifest not in known_names():
        loaded = find_manifest(manifest, root)
        return loaded, loaded.path
    known, path = known_manifest(str(manifest)), locked_path(str(manifest), root)
    loaded = load_manifest(path) if path.is_file() else known
    if loaded.card.version != known.card.version:  # of an earlier eldata: its hashes are taken again
        loaded = known
    folder = path.parent if path.parent.exists() else data_root(root)
    problem = write_problem(folder / path.name) if folder.exists() else None  # nothing there: the checks say so
    if problem is not None:
        raise ManifestError(f"cannot write {path}: {problem}")
    return loaded, path


def _lock_file(
    files: FrameFiles, cameras: Mapping[str, CameraCard], record: FrameRecord
) -> tuple[FrameRecord, list[Problem]]:
    """Fill a row with its file's size and hash; check the file or, if the row had a hash, compare that."""
    path = inside(files.folder, record.path)
    require_files(path)
    locked = replace(record, size_bytes=path.stat().st_size, sha256=sha256_of(path))
    if record.sha256 is None:  # a hash of a damaged file would make the damage official
        return locked, check_file(files, cameras, "full", record).problems
    advice = "if this copy is the right one, empty the row's size_bytes and sha256 and lock again"
    apart = row_fault(record.path, "sha256", record.sha256, str(locked.sha256), advice)
    return locked, [] if locked.sha256 == record.sha256 else [apart]
