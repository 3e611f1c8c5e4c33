"""Check a manifest's files by their pixels, one scene or set of calibration frames at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capture.check.calibration import check_bias, check_flats
from capture.check.frames import Unit
from capture.check.result import CheckedGroup, CheckReport
from capture.check.scene import check_scene
from eldata.base.workers import AnyWorkers, Workers
from eldata.errors import ArgumentError, ManifestError
from eldata.manifest.catalogue import Manifest, load_manifest
from eldata.manifest.pairs import filter_rows

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from eldata.records import FrameRecord


def check(
    manifest: Manifest | Path | str,
    root: Path | str | None = None,
    *,
    scenes: Collection[str] = (),
    cameras: Collection[str] = (),
    workers: AnyWorkers = 1,
) -> CheckReport:
    """Check the pixels of a manifest's scenes and calibration frames.

    Parameters
    ----------
    manifest
        A manifest, or its CSV file.
    root
        The folder that holds the dataset; default ``$ELDATA_ROOT``, else ``./data``.
    scenes
        Only these scenes, by name or number (``"scene-3"``, ``"3"``), without the calibration frames; none means all.
    cameras
        Only these cameras; none means all.
    workers
        Number of worker processes; with fewer scenes than that, files are also decoded ahead.

    Raises
    ------
    ArgumentError
        If a scene or camera is unknown, or there is nothing to check.
    ManifestError
        If the manifest is malformed, or its dataset's folder does not exist.
    """
    workers = Workers.of(workers)
    loaded = manifest if isinstance(manifest, Manifest) else load_manifest(manifest)
    folder = loaded.folder(root)
    if not folder.is_dir():
        raise ManifestError(f"no folder {folder}: --root names the folder that holds {loaded.card.folder}")
    rows = [record for record in loaded.records if record.scene or not scenes]
    if rows:
        numbers = [int(scene) if scene.isdecimal() else scene for scene in scenes]
        rows = filter_rows(rows, rows, "frame", {"camera": cameras or None, "scene": numbers or None})
    if not rows:
        raise ArgumentError(f"{loaded.name}: no scenes and no calibration frames to check")
    groups = workers.run(check_unit, split_units(rows, folder, workers), label=loaded.name, unit="scene")
    return CheckReport(loaded.name, tuple(groups))


def split_units(records: Sequence[FrameRecord], folder: Path, workers: Workers) -> list[Unit]:
    """Split a manifest's rows into units of work."""
    groups: dict[str, list[FrameRecord]] = {}
    for record in records:
        groups.setdefault(_name_unit(record), []).append(record)
    within = Workers(max(1, workers.jobs // max(1, len(groups))))
    return [
        Unit(name, folder, tuple(sorted(rows, key=lambda record: (record.role == "noisy", record.path))), within)
        for name, rows in groups.items()
    ]


def check_unit(unit: Unit) -> CheckedGroup:
    """Check one unit of work."""
    return {"bias": check_bias, "flat": check_flats}.get(unit.records[0].role, check_scene)(unit)


def _name_unit(record: FrameRecord) -> str:
    """Name the unit of a row: camera and scene, or camera, role and ISO."""
    if record.role in ("bias", "flat"):
        return f"{record.camera} {record.role} ISO {'?' if record.iso is None else f'{float(record.iso):g}'}"
    return f"{record.camera} {record.scene}".rstrip()
