"""Where a dataset's archives are published, and where fetched ones are kept."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from eldata.download.formats import SUFFIXES
from eldata.download.sizes import size_text
from eldata.errors import ArgumentError
from eldata.manifest.catalogue import data_root

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from eldata.manifest.card import Card, Download


@dataclass(frozen=True, slots=True)
class Place:
    """A place to get an archive from.

    Attributes
    ----------
    address, size_bytes, notes, sha256
        As on the dataset card.
    direct
        Whether the publisher lets a program fetch it; the others are web pages for a person.
    part
        Name of the archive's share of the dataset, for ``--part``. Empty: of any.
    paths
        Pattern of the manifest's paths that the archive holds.
    below
        Folder of the dataset to unpack it into if the manifest lists none of its files; ``None``: not known.
    about
        Its size in words, where ``size_bytes`` is not known; empty if that is not known either.
    """

    address: str
    size_bytes: int | None = None
    notes: str = ""
    direct: bool = False
    part: str = ""
    paths: str = "*"
    sha256: str | None = None
    below: str | None = None
    about: str = ""

    @property
    def file_name(self) -> str:
        """The archive's name, empty where the address is a web page."""
        return archive_name(self.address)

    @property
    def size_text(self) -> str:
        """The size in words, empty if it is not known."""
        return size_text(self.size_bytes) if self.size_bytes is not None else self.about

    def holds(self, path: str) -> bool:
        """Return whether the archive holds a path of the manifest."""
        return fnmatchcase(path, self.paths)


def archive_name(address: str) -> str:
    """Return the name of the archive that an address ends in, empty if it does not end in one."""
    name = PurePosixPath(unquote(urlsplit(address).path)).name
    plain = bool(name) and name[0] not in ".-" and not any(sign in name for sign in '/\\:\0\n\r"')
    return name if plain and name.lower().endswith(SUFFIXES) else ""


def places_of(card: Card) -> tuple[Place, ...]:
    """Return where a dataset is published, in the card's order."""
    return tuple(_place(download) for download in card.downloads)


def _place(download: Download) -> Place:
    return Place(
        address=download.address,
        size_bytes=download.size_bytes,
        notes=download.notes,
        direct=download.direct,
        part=download.part,
        paths=download.paths,
        sha256=download.sha256,
        below=download.below,
        about=download.about,
    )


def choose_parts(places: Sequence[Place], names: Collection[str]) -> tuple[Place, ...]:
    """Return the directly fetched places of the named parts, one each; with a single part there is nothing to name.

    Raises
    ------
    ArgumentError
        If a name is unknown, or none is given although there are several; the message lists them.
    """
    first_of: dict[str, Place] = {}
    for place in places:
        if place.direct:
            first_of.setdefault(place.part, place)
    known = ", ".join(sorted(first_of)) or "none"
    for name in names:
        if name not in first_of:
            raise ArgumentError(f"no part is called {name!r}; known are {known}")
    if not names and len(first_of) > 1:
        raise ArgumentError(f"the dataset comes in several archives; name those you need with --part: {known}")
    return tuple(place for name, place in first_of.items() if not names or name in names)


def place_of_archive(places: Sequence[Place], name: str) -> Place | None:
    """Return the place that an archive of this name comes from, if one serves it under that name."""
    return next((place for place in places if place.file_name == name), None)


def archives_folder(root: Path | str | None = None) -> Path:
    """Return the folder that keeps fetched archives, below the data root."""
    return data_root(root) / "archives"
