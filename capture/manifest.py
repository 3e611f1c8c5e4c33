"""From matched files to a dataset: its layout, its manifest and its card, as ``eldata`` reads them."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from capture.calibration import WARM
from capture.capture_errors import MappingError
from capture.plan import CALIBRATION
from capture.scene_plan import sequence_name
from eldata.base.files import sha256_of
from eldata.base.numbers import counted
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.manifest.card import CameraCard, Card
from eldata.manifest.pairs import LONGER_DARK, UNCERTAIN_ISO, WARM_SENSOR
from eldata.manifest.verify import RATIO_TOLERANCE
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from capture.matching import Match, Slot
    from capture.observed import ObservedFrame
    from capture.plan import Plan
    from capture.shots import Shot


@dataclass(frozen=True, slots=True)
class CopiedRow:
    """A row of the manifest, and the file that it is made from."""

    path: Path
    record: FrameRecord


@dataclass(frozen=True, slots=True)
class Dataset:
    """What the matched files become.

    Attributes
    ----------
    folder
        The dataset's folder, which the rows' paths start from.
    rows
        Of the files that were matched, by scene and number.
    remarks
        The effects of gaps: other references, noisy frames left out.
    before
        Rows that the set had before, with the references that they have now.
    """

    folder: Path
    rows: tuple[CopiedRow, ...]
    remarks: tuple[str, ...]
    before: tuple[FrameRecord, ...] = ()

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """All rows of the manifest."""
        return (*self.before, *(row.record for row in self.rows))


def layout_path(plan: Plan, scene: str, shot: Shot, source: Path) -> str:
    """Return a shot's path in the dataset: ``<camera>/scene-1/IMG_0004.ARW``, ``<camera>/bias/ISO100/IMG_0001.ARW``.

    Dark frames and those of a warm sensor are kept apart, in folders that ``eldata calibrate`` takes as they are:
    ``<camera>/dark-0.5s/bias/ISO800/IMG_0133.ARW``.
    """
    place = "/".join(filter(None, (shot.series, shot.role, f"ISO{shot.iso}"))) if scene == CALIBRATION else scene
    return f"{plan.camera.name}/{place}/IMG_{shot.number:04d}{source.suffix}"


def into_layout(
    plan: Plan, match: Match, folder: Path, there: Mapping[Slot, FrameRecord] = MappingProxyType({})
) -> Dataset:
    """Return the dataset with its files under their protocol names in ``folder``.

    Parameters
    ----------
    plan
        The whole plan.
    match
        Files of its shots, or of those that are not there.
    folder
        The dataset's folder.
    there
        The rows of shots that the set has already.
    """
    paths = {
        (scene, shot.number): layout_path(plan, scene, shot, match.frames[scene, shot.number].path)
        for scene, shot in plan.shots
        if (scene, shot.number) in match.frames
    }
    return _dataset(plan, match, folder, {slot: record.path for slot, record in there.items()} | paths, there)


def in_place(plan: Plan, match: Match) -> Dataset:
    """Return the dataset with its files where they are, below the folder that they share.

    Raises
    ------
    MappingError
        If they share only the root of the file system.
    """
    files = {slot: Path(os.path.abspath(frame.path)) for slot, frame in match.frames.items()}  # noqa: PTH100 # links stay
    if not files:
        raise MappingError("no file was matched to a shot; nothing to list")
    # One folder above that of the files: eldata looks for unlisted files in the folders below a dataset's own.
    folder = Path(os.path.commonpath([path.parent.parent for path in files.values()]))
    if folder == folder.parent:
        raise MappingError(f"the files have no folder in common but {folder}; use --copy-to")
    return _dataset(plan, match, folder, {slot: path.relative_to(folder).as_posix() for slot, path in files.items()})


def _dataset(
    plan: Plan,
    match: Match,
    folder: Path,
    paths: dict[Slot, str],
    there: Mapping[Slot, FrameRecord] = MappingProxyType({}),
) -> Dataset:
    references: dict[str, list[int]] = {}
    for scene, shot in plan.shots:
        if shot.role == "reference" and (scene, shot.number) in paths:
            references.setdefault(scene, []).append(shot.number)
    rows, before, remarks, others = [], [], [], 0
    for scene, shot in plan.shots:
        slot = (scene, shot.number)
        if slot not in paths:
            continue
        reference = None
        if shot.reference is not None:
            known = references.get(scene, [])
            if not known:
                remarks.append(f"{scene} frame {shot.number} is left out: the scene has no reference")
                continue
            number = min(known, key=lambda other, shot=shot: _distance(shot, other))  # type: ignore[misc] # bound here
            if number != shot.reference:
                remarks.append(
                    f"{scene} frame {shot.number}: compared with frame {number}, as {shot.reference} is missing"
                )
            reference = paths[scene, number]
        if slot in there:
            row = there[slot]
            if row.reference != reference:  # what was measured was measured against another one
                others += row.reference is not None and row.reference not in paths.values()
                row = replace(row, reference=reference, measured_ratio=None, measured_shift_px=None)
            before.append(row)
        else:
            frame = match.frames[slot]
            rows.append(CopiedRow(frame.path, _record(plan, scene, shot, frame, paths[slot], reference)))
    if others:
        remarks.append(
            f"{counted(others, 'noisy frame')} of the set compared with single references again: capture average makes "
            "their means anew"
        )
    return Dataset(folder, tuple(rows), tuple(remarks), tuple(before))


def _distance(shot: Shot, other: int) -> tuple[bool, int, int]:
    # The planned one first; else the nearest by number, the earlier of two, as the protocol has it.
    return other != shot.reference, abs(other - shot.number), other


def _record(plan: Plan, scene: str, shot: Shot, frame: ObservedFrame, path: str, reference: str | None) -> FrameRecord:
    return FrameRecord(
        path=path,
        role=shot.role,
        camera=plan.camera.name,
        scene="" if scene == CALIBRATION else scene,
        split="" if scene == CALIBRATION else "test",
        iso=frame.iso,
        exposure_s=frame.exposure_s,
        ratio=None if shot.factor is None else Fraction(shot.factor),
        reference=reference,
        flags=(*flags_of(shot.series), *_doubted(shot)),
    )


def _doubted(shot: Shot) -> tuple[str, ...]:
    """Return the flag of a pair whose names of ISOs say another ratio than their measured speeds, known beforehand."""
    if shot.true_iso is None or shot.named_ratio is None or shot.factor is None:
        return ()
    return (UNCERTAIN_ISO,) if abs(shot.named_ratio - shot.factor) > RATIO_TOLERANCE * shot.factor else ()


def flags_of(series: str) -> tuple[str, ...]:
    """Return the flags of calibration frames of a series: by them ``eldata calibrate`` leaves these rows to it."""
    parts = series.split("/")
    found = [WARM_SENSOR] if parts[0] == WARM else []
    return tuple(found + ([LONGER_DARK] if parts[-1] not in ("", WARM) else []))


def with_hashes(dataset: Dataset, workers: Workers = IN_THIS_PROCESS) -> Dataset:
    """Return the dataset with size and SHA-256 of each original filled in: copies are checked against them."""
    return replace(dataset, rows=tuple(workers.run(_with_hash, dataset.rows, label="hashing")))


def _with_hash(row: CopiedRow) -> CopiedRow:
    return replace(row, record=replace(row.record, size_bytes=row.path.stat().st_size, sha256=sha256_of(row.path)))


def counts_of(records: Iterable[FrameRecord]) -> dict[str, int]:
    """Return the number of rows of each role, as cards state it."""
    roles = Counter(record.role for record in records)
    return {role: roles[role] for role in sorted(roles)}


def set_title(records: Sequence[FrameRecord]) -> str:
    """Return what a set holds, in words."""
    scenes = len({sequence_name(record.scene) for record in records} - {""})
    what = [counted(scenes, "scene")] if scenes else []
    what += ["calibration frames"] if {"bias", "flat"} & set(counts_of(records)) else []
    cameras = dict.fromkeys(sorted(record.camera for record in records))
    return f"{' and '.join(what)} taken with {' and '.join(cameras)}"


def card_of(plan: Plan, name: str, folder: str, records: Sequence[FrameRecord]) -> Card:
    """Return the dataset's card; what only the photographer knows, such as the licence, is left to fill in."""
    return Card(
        name=name,
        title=set_title(records),
        version="1.0",
        folder=folder,
        citation="not stated",
        licence="not stated",
        homepage="not stated",
        cfa=plan.camera.cfa,
        cameras={plan.camera.name: CameraCard(plan.camera.models)},
        counts=counts_of(records),
        protocol="raw" if plan.protocol.moments == 1 else "sequences",
        sources=(f"capture manifest: protocol of {plan.protocol}; ISO and exposure times as the files state them",),
    )
