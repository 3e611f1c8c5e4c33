"""From matched files to a dataset: its layout, its manifest and its card, as ``eldata`` reads them.

Files go into the layout by copy or hard link: originals stay, and what is there already is never replaced. Symbolic
links are not made: ``eldata verify`` and every reader refuse a dataset whose files are elsewhere, since a link that
leads out of its folder is how a manifest from a stranger would reach other files.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Final, Literal

from capture.capture_errors import CaptureError
from capture.matching import can_be
from capture.plan import CALIBRATION, Plan
from eldata.base.files import atomic_write, naming_file, sha256_of
from eldata.base.numbers import counted
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.manifest.card import CameraCard, Card, cfa_word, counts_of, load_card, own_card, title_of_set
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.manifest.pairs import UNCERTAIN_ISO
from eldata.manifest.table import load_records
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.matching import Match, Slot
    from capture.observed import ObservedFrame
    from capture.shots import Shot

_PIECE: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Placement:
    """A row of a manifest, the file that it is made from, and where this goes."""

    path: Path
    target: Path
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
    before
        Rows that the set had before, with the references that they have now.
    remarks
        The effects of gaps: other references, noisy frames left out.
    """

    folder: Path
    rows: tuple[Placement, ...]
    before: tuple[FrameRecord, ...]
    remarks: tuple[str, ...]

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """All rows of the manifest."""
        return (*self.before, *(row.record for row in self.rows))


def layout_path(plan: Plan, scene: str, shot: Shot, suffix: str = "") -> str:
    """Return a shot's path in the dataset: ``<camera>/scene-1/IMG_0004.ARW``, ``<camera>/bias/ISO100/IMG_0001.ARW``."""
    place = f"{shot.role}/ISO{shot.iso}" if scene == CALIBRATION else scene
    return f"{plan.camera.name}/{place}/IMG_{shot.number:04d}{suffix}"


def make_dataset(
    plan: Plan, match: Match, folder: Path | None, existing: ExistingSet | None, workers: Workers
) -> Dataset:
    """Make the rows of a dataset, with size and SHA-256 of each original.

    Parameters
    ----------
    plan
        The whole plan.
    match
        Files of its shots, or of those that the existing set lacks.
    folder
        The dataset's folder, where the files are to go under their protocol names; ``None`` leaves them where they
        are, below the folder that they share.
    existing
        The set that they join.
    workers
        The workers that hash the files.

    Raises
    ------
    CaptureError
        If the files share only the root of the file system; or like :meth:`ExistingSet.find_rows`.
    """
    there = {} if existing is None else existing.find_rows(plan)
    listed = {record.path for record in there.values()}
    before = [] if existing is None else [record for record in existing.records if record.path not in listed]
    paths = {slot: record.path for slot, record in there.items()}
    if folder is None:
        files = {slot: Path(os.path.abspath(frame.path)) for slot, frame in match.frames.items()}  # noqa: PTH100 # links stay
        # One folder above the files' own: eldata looks for unlisted files in the folders below a dataset's own.
        folder = Path(os.path.commonpath([path.parent.parent for path in files.values()]))
        if folder == folder.parent:
            raise CaptureError(f"the files have no folder in common but {folder}; use --copy-to")
        paths |= {slot: path.relative_to(folder).as_posix() for slot, path in files.items()}
    else:
        for scene, shot in plan.shots:
            if (frame := match.frames.get((scene, shot.number))) is not None:
                paths[scene, shot.number] = layout_path(plan, scene, shot, frame.path.suffix)
    references: dict[str, list[int]] = {}
    for scene, shot in plan.shots:
        if shot.role == "reference" and (scene, shot.number) in paths:
            references.setdefault(scene, []).append(shot.number)
    rows, remarks = [], []
    for scene, shot in plan.shots:
        slot = (scene, shot.number)
        reference = None
        if slot in paths and shot.reference is not None:
            # The planned one; else the nearest by number, the earlier of two, as the protocol has it.
            near = sorted((abs(number - shot.number), number) for number in references.get(scene, ()))
            number = shot.reference if (scene, shot.reference) in paths else near[0][1] if near else None
            if number is None:
                remarks.append(f"{scene} frame {shot.number} is left out: the scene has no reference")
                continue
            if number != shot.reference:
                text = f"compared with frame {number}, as {shot.reference} is missing"
                remarks.append(f"{scene} frame {shot.number}: {text}")
            reference = paths[scene, number]
        if slot in there:
            before.append(replace(there[slot], reference=reference))
        elif slot in paths:
            frame = match.frames[slot]
            record = _make_record(plan, scene, shot, frame, paths[slot], reference)
            rows.append(Placement(frame.path, folder / record.path, record))
    hashed = workers.run(_hash_file, rows, label="hashing")
    return Dataset(folder, tuple(hashed), tuple(before), tuple(remarks))


def _make_record(
    plan: Plan, scene: str, shot: Shot, frame: ObservedFrame, path: str, reference: str | None
) -> FrameRecord:
    """Make the manifest's row of a shot's frame, with exact ratio and flags."""
    flags: tuple[str, ...] = ()
    if shot.true_iso is not None and shot.named_ratio is not None and shot.factor is not None:
        # Names of ISOs say another ratio than measured speeds.
        flags = (UNCERTAIN_ISO,) if abs(shot.named_ratio - shot.factor) > RATIO_TOLERANCE * shot.factor else ()
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
        flags=flags,
    )


def _hash_file(row: Placement) -> Placement:
    """Fill in the size and SHA-256 of the original file."""
    return replace(row, record=replace(row.record, size_bytes=row.path.stat().st_size, sha256=sha256_of(row.path)))


def make_card(plan: Plan, name: str, folder: str, records: Sequence[FrameRecord]) -> Card:
    """Make the dataset's card; what only the photographer knows, such as the licence, is left to fill in."""
    sources = (f"capture manifest: protocol of {plan.protocol}; ISO and exposure times as the files state them",)
    cameras = {plan.camera.name: CameraCard(plan.camera.models)}
    return own_card(name, folder, records, cfa=plan.camera.cfa, cameras=cameras, protocol="raw", sources=sources)


# --- a set that more files join ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ExistingSet:
    """An existing set: the path of its manifest, its card and its rows."""

    path: Path
    card: Card
    records: tuple[FrameRecord, ...]

    @classmethod
    def load(cls, path: Path, folder: Path) -> ExistingSet:
        """Read a set's manifest (CSV); ``folder`` is the dataset's, which gets the new files.

        Raises
        ------
        ManifestError
            If manifest or card are malformed.
        CaptureError
            If the manifest does not exist, or its files are not in this folder.
        """
        if not path.exists():
            raise CaptureError(f"{path}: this set does not exist yet; leave --append out for its first files")
        card, records = load_card(path.with_suffix(".json")), load_records(path)
        lacking = [record.path for record in records if not (folder / record.path).is_file()]
        if card.folder != folder.name or lacking:
            example = f", such as {lacking[0]}" if lacking else ""
            raise CaptureError(
                f"{folder} is not where the files of {path} are: its folder is called {card.folder}, and "
                f"{counted(len(lacking), 'file')} of {len(records)} are not in the one given{example}. Name the "
                "folder that they were copied or linked to"
            )
        return cls(path, card, records)

    def find_rows(self, plan: Plan) -> dict[Slot, FrameRecord]:
        """Return the rows of a plan's shots, by scene and number.

        Raises
        ------
        CaptureError
            If a shot of that name has other settings: the set has another scene of this name.
        """
        rows = {PurePosixPath(record.path).with_suffix("").as_posix(): record for record in self.records}
        rows_of_shots: dict[Slot, FrameRecord] = {}
        for scene, shot in plan.shots:
            record = rows.get(layout_path(plan, scene, shot))
            if record is None:
                continue
            if not can_be(shot, record):
                raise CaptureError(
                    f"{self.path} has {record.path}, taken at ISO {record.iso}, {record.exposure_s} s, and the plan "
                    f"asks for {shot.settings} there: they are different scenes. Give those of the plan other names, "
                    "as capture plan --scenes 11-15 does, or give this one its own metered time: capture plan --remeter"
                )
            rows_of_shots[scene, shot.number] = record
        return rows_of_shots

    def lacking(self, plan: Plan) -> Plan | None:
        """Return the part of a plan that the set lacks; ``None`` if it has all.

        Raises
        ------
        CaptureError
            Like :meth:`find_rows`.
        """
        there = self.find_rows(plan)

        def keep(scene: str, shots: Sequence[Shot]) -> tuple[Shot, ...]:
            """Keep the shots that the set lacks."""
            return tuple(shot for shot in shots if (scene, shot.number) not in there)

        parts = [replace(scene, shots=keep(scene.name, scene.shots)) for scene in plan.scenes]
        scenes = tuple(scene for scene in parts if scene.shots)
        calibration = plan.calibration and replace(plan.calibration, shots=keep(CALIBRATION, plan.calibration.shots))
        calibration = calibration if calibration and calibration.shots else None
        return replace(plan, scenes=scenes, calibration=calibration) if scenes or calibration else None

    def join(self, plan: Plan, records: Sequence[FrameRecord]) -> Card:
        """Return the card of the set with the plan's rows in it; what the photographer wrote into it stays.

        Raises
        ------
        CaptureError
            If the card contradicts the manifest, or knows the plan's camera by other names in EXIF.
        """
        name, new = plan.camera.name, make_card(plan, self.card.name, self.card.folder, records)
        known = self.card.cameras.get(name)
        if known is not None and known != new.cameras[name]:
            raise CaptureError(
                f"{self.path} has files of {name}, whose model in EXIF is {' or '.join(known.models)}, and that of the "
                f"plan's {name} is {' or '.join(plan.camera.models)}: give the other camera a name of its own"
            )
        if self.card.counts not in (counts_of(self.records), new.counts):
            raise CaptureError(
                f"{self.path}: its card expects {self.card.counts} rows per role, and it has "
                f"{counts_of(self.records)}: correct the one that is wrong first"
            )
        # "both" is the card's word for sets of both kinds.
        words = (self.card.cfa, new.cfa)
        kinds = {"bayer", "xtrans"} if "both" in words else set(words)
        return replace(
            self.card,
            title=new.title if self.card.title == title_of_set(self.records) else self.card.title,
            cfa=cfa_word(kinds),
            cameras=self.card.cameras | new.cameras,
            counts=new.counts,
            sources=tuple(dict.fromkeys((*self.card.sources, *new.sources))),
        )


# --- files into their places ------------------------------------------------------------------------------------------


def place_files(rows: Sequence[Placement], how: Literal["copy", "link"], workers: Workers = IN_THIS_PROCESS) -> None:
    """Copy files to their targets, or link them; targets that hold their file already stay as they are.

    Raises
    ------
    CaptureError
        If a target holds something else, which is found before anything is written; if a source changed meanwhile; or
        if a link's target lies on another file system.
    """
    missing = []
    for row in rows:
        if not os.path.lexists(row.target):
            missing.append(row)
        elif not _holds_file(row):
            raise CaptureError(
                f"{row.target} is there already with another content than {row.path}; nothing was copied. Choose "
                "another folder, or move that file away"
            )
    for row in missing:
        row.target.parent.mkdir(parents=True, exist_ok=True)
    for _ in workers.run(_copy_file if how == "copy" else _link_file, missing, label=how):
        pass


def _copy_file(row: Placement) -> None:
    """Copy a file to its target, whole or not at all; refuse one that has changed since it was hashed."""
    digest = hashlib.sha256()
    with row.path.open("rb") as reading, atomic_write(row.target) as writing:
        while piece := _read_piece(reading, row.path):
            digest.update(piece)
            writing.write(piece)
        if f"sha256:{digest.hexdigest()}" != row.record.sha256:
            raise CaptureError(f"{row.path} changed while it was being copied; run this again")
        times = os.fstat(reading.fileno())
    os.utime(row.target, ns=(times.st_atime_ns, times.st_mtime_ns))


def _read_piece(file: IO[bytes], path: Path) -> bytes:
    """Read the next bytes of a file; an error names the file."""
    with naming_file(path):
        return file.read(_PIECE)


def _link_file(row: Placement) -> None:
    """Make a hard link to a file."""
    try:
        row.target.hardlink_to(row.path)
    except OSError as error:
        raise CaptureError(
            f"{row.target} cannot be a hard link to {row.path} ({error.strerror}); use --copy-to"
        ) from error


def _holds_file(row: Placement) -> bool:
    """Check that the target is the file already, or an equal copy."""
    if not row.target.is_file():
        return False
    if row.target.samefile(row.path):
        return True
    return row.target.stat().st_size == row.path.stat().st_size and sha256_of(row.target) == row.record.sha256
