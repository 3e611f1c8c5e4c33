"""Where the files of a manifest lie, and what its card and rows state of those that are pixels alone."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from eldata.base.files import inside
from eldata.manifest.patterns import expand
from eldata.raw.stated import StatedFile
from eldata.records import Exposure

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping
    from pathlib import Path

    from eldata.manifest.card import Card
    from eldata.raw.stated import MosaicFacts
    from eldata.records import FrameRecord


@dataclass(frozen=True, slots=True)
class FrameFiles:
    """The files of a set.

    Attributes
    ----------
    folder
        The set's; paths start there, and may not leave it.
    stated
        What is stated of mosaics without levels of their own, by path.
    """

    folder: Path
    stated: Mapping[str, tuple[MosaicFacts, Exposure]] = field(default_factory=dict)

    @classmethod
    def of(cls, folder: Path, card: Card, records: Iterable[FrameRecord]) -> FrameFiles:
        """Return the files of these rows."""
        if not card.mosaics:
            return cls(folder)
        stated = {}
        for record in expand(tuple(records), folder):
            facts = mosaic_facts(card.mosaics, record)
            if facts is not None:
                stated[record.path] = facts, Exposure(record.iso, record.exposure_s)
        return cls(folder, stated)

    def at(self, path: str) -> Path | StatedFile:
        """Return what :func:`eldata.raw.read_raw` reads of a path.

        Raises
        ------
        ManifestError
            If it leads out of the folder.
        """
        file = inside(self.folder, path)
        return StatedFile(file, *self.stated[path]) if path in self.stated else file

    def absolute(self) -> FrameFiles:
        """Return the same, wherever a process starts."""
        return replace(self, folder=self.folder.absolute())

    def only(self, paths: Collection[str]) -> FrameFiles:
        """Return the same for these paths alone: what a worker gets."""
        return replace(self, stated={path: self.stated[path] for path in paths if path in self.stated})


def mosaic_facts(mosaics: Iterable[MosaicFacts], record: FrameRecord) -> MosaicFacts | None:
    """Return the first facts that a card states for a row's camera and path; ``None``: the file states them."""
    fit = (
        facts
        for facts in mosaics
        if fnmatchcase(record.path, facts.paths) and (not facts.cameras or record.camera in facts.cameras)
    )
    return next(fit, None)
