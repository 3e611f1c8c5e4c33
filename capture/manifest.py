"""From matched files to a dataset: its layout, its manifest and its card, as ``eldata`` reads them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from capture.calibration import WARM
from capture.capture_errors import MappingError
from capture.matching import can_be
from capture.placing import Placement
from capture.plan import CALIBRATION
from eldata.base.files import sha256_of
from eldata.base.numbers import counted
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.manifest.card import CameraCard, Card, cfa_word, counts_of, load_card, title_of_set
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.manifest.pairs import UNCERTAIN_ISO, WARM_SENSOR
from eldata.manifest.table import load_records
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from capture.matching import Match, Slot
    from capture.observed import ObservedFrame
    from capture.plan import Plan
    from capture.shots import Shot


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
    rows: tuple[Placement, ...]
    remarks: tuple[str, ...]
    before: tuple[FrameRecord, ...] = ()

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """All rows of the manifest."""
        return (*self.before, *(row.record for row in self.rows))


def layout_path(plan: Plan, scene: str, shot: Shot, source: Path) -> str:
    """Return a shot's path in the dataset: ``<camera>/scene-1/IMG_0004.ARW``, ``<camera>/bias/ISO100/IMG_0001.ARW``.

    Bias frames of a warm sensor are kept apart, in a folder that ``eldata calibrate`` takes as it is:
    ``<camera>/warm/bias/ISO800/IMG_0133.ARW``.
    """
    place = "/".join(filter(None, (shot.series, shot.role, f"ISO{shot.iso}"))) if scene == CALIBRATION else scene
    return f"{plan.camera.name}/{place}/IMG_{shot.number:04d}{source.suffix}"


def into_layout(plan: Plan, match: Match, folder: Path, begun: Begun | None = None) -> Dataset:
    """Return the dataset with its files under their protocol names in ``folder``.

    Parameters
    ----------
    plan
        The whole plan.
    match
        Files of its shots, or of those that are not there.
    folder
        The dataset's folder.
    begun
        The set that they join.

    Raises
    ------
    MappingError
        Like :meth:`Begun.of`.
    """
    there = {} if begun is None else begun.of(plan)
    paths = {slot: record.path for slot, record in there.items()}
    known = set(paths.values())
    others = () if begun is None else tuple(one for one in begun.records if one.path not in known)
    for scene, shot in plan.shots:
        frame = match.frames.get((scene, shot.number))
        if frame is not None:
            paths[scene, shot.number] = layout_path(plan, scene, shot, frame.path)
    found = _dataset(plan, match, folder, paths, there)
    return replace(found, before=(*others, *found.before))


def in_place(plan: Plan, match: Match) -> Dataset:
    """Return the dataset with its files where they are, below the folder that they share.

    Raises
    ------
    MappingError
        If they share only the root of the file system.
    """
    files = {slot: Path(os.path.abspath(frame.path)) for slot, frame in match.frames.items()}  # noqa: PTH100 # links stay
    # One folder above that of the files: eldata looks for unlisted files in the folders below a dataset's own.
    folder = Path(os.path.commonpath([path.parent.parent for path in files.values()]))
    if folder == folder.parent:
        raise MappingError(f"the files have no folder in common but {folder}; use --copy-to")
    paths = {slot: path.relative_to(folder).as_posix() for slot, path in files.items()}
    return _dataset(plan, match, folder, paths, there={})


def _dataset(
    plan: Plan,
    match: Match,
    folder: Path,
    paths: dict[Slot, str],
    there: Mapping[Slot, FrameRecord],
) -> Dataset:
    references: dict[str, list[int]] = {}
    for scene, shot in plan.shots:
        if shot.role == "reference" and (scene, shot.number) in paths:
            references.setdefault(scene, []).append(shot.number)
    rows, before, remarks = [], [], []
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
            before.append(replace(there[slot], reference=reference))
        else:
            frame = match.frames[slot]
            record = _record(plan, scene, shot, frame, paths[slot], reference)
            rows.append(Placement(frame.path, folder / record.path, record))
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
        flags=_flags(shot),
    )


def _flags(shot: Shot) -> tuple[str, ...]:
    """Return what is known beforehand: a warm sensor, and names of ISOs that say another ratio than measured speeds."""
    if shot.series == WARM:
        return (WARM_SENSOR,)
    if shot.true_iso is None or shot.named_ratio is None or shot.factor is None:
        return ()
    return (UNCERTAIN_ISO,) if abs(shot.named_ratio - shot.factor) > RATIO_TOLERANCE * shot.factor else ()


def with_hashes(dataset: Dataset, workers: Workers = IN_THIS_PROCESS) -> Dataset:
    """Return the dataset with size and SHA-256 of each original filled in: copies are checked against them."""
    return replace(dataset, rows=tuple(workers.run(_with_hash, dataset.rows, label="hashing")))


def _with_hash(row: Placement) -> Placement:
    return replace(row, record=replace(row.record, size_bytes=row.path.stat().st_size, sha256=sha256_of(row.path)))


def set_title(records: Sequence[FrameRecord]) -> str:
    """Return what a set holds, in words."""
    return title_of_set(records, len({record.scene for record in records} - {""}))


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
        protocol="raw",
        sources=(f"capture manifest: protocol of {plan.protocol}; ISO and exposure times as the files state them",),
    )


# --- a manifest that was begun ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Begun:
    """A set that is there.

    Attributes
    ----------
    path
        Its manifest.
    card, records
        What that says.
    """

    path: Path
    card: Card
    records: tuple[FrameRecord, ...]

    @classmethod
    def load(cls, path: Path, folder: Path) -> Begun:
        """Read a set's manifest.

        Parameters
        ----------
        path
            The manifest (CSV).
        folder
            The dataset's folder, where the files are and more are to go.

        Raises
        ------
        ManifestError
            If manifest or card are malformed.
        MappingError
            If the manifest does not exist, or its files are not in this folder.
        """
        if not path.exists():
            raise MappingError(f"{path}: this set does not exist yet; leave --append out for its first files")
        begun = cls(path, load_card(path.with_suffix(".json")), load_records(path))
        lacking = [record.path for record in begun.records if not (folder / record.path).is_file()]
        if begun.card.folder != folder.name or lacking:
            example = f", such as {lacking[0]}" if lacking else ""
            raise MappingError(
                f"{folder} is not where the files of {path} are: its folder is called {begun.card.folder}, and "
                f"{counted(len(lacking), 'file')} of {len(begun.records)} are not in the one given{example}. Name the "
                "folder that they were copied or linked to"
            )
        return begun

    def of(self, plan: Plan) -> dict[Slot, FrameRecord]:
        """Return the rows of a plan's shots, by scene and number.

        Raises
        ------
        MappingError
            If a shot of that name has other settings: the set has another scene of this name.
        """
        rows = {PurePosixPath(record.path).with_suffix("").as_posix(): record for record in self.records}
        found: dict[Slot, FrameRecord] = {}
        for scene, shot in plan.shots:
            record = rows.get(layout_path(plan, scene, shot, Path()))
            if record is None:
                continue
            if not can_be(shot, record):
                raise MappingError(
                    f"{self.path} has {record.path}, taken at ISO {record.iso}, {record.exposure_s} s, and the plan "
                    f"asks for {shot.settings} there: they are different scenes. Give those of the plan other names, "
                    "as capture plan --scenes 11-15 does, or give this one its own metered time: capture plan --remeter"
                )
            found[scene, shot.number] = record
        return found

    def lacking(self, plan: Plan) -> Plan | None:
        """Return the part of a plan that the set has not; ``None`` if it has all.

        Raises
        ------
        MappingError
            Like :meth:`of`.
        """
        there = self.of(plan)
        left: dict[str, tuple[Shot, ...]] = {}
        for name, shot in plan.shots:
            if (name, shot.number) not in there:
                left[name] = (*left.get(name, ()), shot)
        if not left:
            return None
        scenes = tuple(replace(scene, shots=left[scene.name]) for scene in plan.scenes if scene.name in left)
        frames = plan.calibration
        if frames is not None:
            frames = replace(frames, shots=left[CALIBRATION]) if CALIBRATION in left else None
        return replace(plan, scenes=scenes, calibration=frames)

    def joined(self, plan: Plan, records: Sequence[FrameRecord]) -> Card:
        """Return the card of the set with the plan's rows in it; what the photographer wrote into it stays.

        Raises
        ------
        MappingError
            If the card contradicts the manifest, or knows the plan's camera by other names in EXIF.
        """
        name, camera = plan.camera.name, card_of(plan, self.card.name, self.card.folder, records)
        known = self.card.cameras.get(name)
        if known is not None and known != camera.cameras[name]:
            raise MappingError(
                f"{self.path} has files of {name}, whose model in EXIF is {' or '.join(known.models)}, and that of the "
                f"plan's {name} is {' or '.join(plan.camera.models)}: give the other camera a name of its own"
            )
        if self.card.counts not in (counts_of(self.records), camera.counts):
            raise MappingError(
                f"{self.path}: its card expects {self.card.counts} rows per role, and it has "
                f"{counts_of(self.records)}: correct the one that is wrong first"
            )
        # "both" is the card's word for sets of both kinds.
        kinds = {kind for word in (self.card.cfa, camera.cfa) for kind in _KINDS.get(word, (word,))}
        return replace(
            self.card,
            title=set_title(records) if self.card.title == set_title(self.records) else self.card.title,
            cfa=cfa_word(kinds),
            cameras=self.card.cameras | camera.cameras,
            counts=camera.counts,
            sources=tuple(dict.fromkeys((*self.card.sources, *camera.sources))),
        )


_KINDS: Final = {"both": ("bayer", "xtrans")}
