"""A set that more files join: another card, another night, another camera.

What it has is taken from its manifest: which of a plan's shots are there, and which of the files that are given. Only
sets in the dataset's layout can be joined, since there a file's name says which shot it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from capture.capture_errors import MappingError
from capture.manifest import card_of, counts_of, into_layout, layout_path, set_title
from capture.matching import can_be
from capture.plan import CALIBRATION
from eldata.base.numbers import counted
from eldata.manifest.card import Card, cfa_word, load_card
from eldata.manifest.table import load_records

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.manifest import Dataset
    from capture.matching import Match, Slot
    from capture.plan import Plan
    from capture.shots import Shot
    from eldata.records import FrameRecord


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
                    "as capture plan --scenes 11-15 does, or say with --progress at which time this one was metered"
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

    def into_layout(self, plan: Plan, match: Match, folder: Path) -> Dataset:
        """Return the set with a plan's files in it, under their protocol names in its folder.

        Raises
        ------
        MappingError
            Like :meth:`of`.
        """
        there = self.of(plan)
        paths = {record.path for record in there.values()}
        others = tuple(record for record in self.records if record.path not in paths)
        found = into_layout(plan, match, folder, there)
        return replace(found, before=(*others, *found.before))

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
