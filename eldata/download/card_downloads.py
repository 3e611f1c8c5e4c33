"""What a dataset card says about archives: names, sizes, parts, and which ones pooch may fetch."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from eldata.download.sizes import size_text
from eldata.errors import ArgumentError
from eldata.manifest.catalogue import data_root

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from pooch import Pooch

    from eldata.manifest.card import Card, Download

SUFFIXES = (".zip", ".7z", ".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")


def archive_name(download: Download) -> str:
    """Return the archive's name at the end of the address, empty if there is none."""
    name = PurePosixPath(unquote(urlsplit(download.address).path)).name
    plain = bool(name) and name[0] not in ".-" and not any(sign in name for sign in '/\\:\0\n\r"')
    return name if plain and name.lower().endswith(SUFFIXES) else ""


def archive_size(download: Download) -> str:
    """Return the size in words, empty if it is not known."""
    return size_text(download.size_bytes) if download.size_bytes is not None else download.about


def choose_parts(downloads: Sequence[Download], names: Collection[str]) -> tuple[Download, ...]:
    """Return the downloads that a program may fetch, one for each named part; a single part needs no name.

    Raises
    ------
    ArgumentError
        If a name is unknown, or no name is given although there are several parts; the message lists them.
    """
    first_of: dict[str, Download] = {}
    for download in downloads:
        if download.direct:
            first_of.setdefault(download.part, download)
    known = ", ".join(sorted(first_of)) or "none"
    for name in names:
        if name not in first_of:
            raise ArgumentError(f"no part is called {name!r}; known are {known}")
    if not names and len(first_of) > 1:
        raise ArgumentError(f"the dataset comes in several archives; name those you need with --part: {known}")
    return tuple(download for name, download in first_of.items() if not names or name in names)


def kept_archives(card: Card, root: Path | str | None = None) -> Pooch:
    """Return pooch's registry of the archives that a program may fetch: name, address and the card's hash of each.

    They are kept in ``archives`` below the data root; one that is there but differs is never replaced.
    """
    import pooch

    folder = data_root(root) / "archives"
    first_of = {archive_name(download): download for download in reversed(card.downloads) if download.direct}
    return pooch.create(
        path=folder.absolute() if folder.parts[0].startswith("~") else folder,  # pooch takes ~ for the home folder
        base_url="",
        urls={name: download.address for name, download in first_of.items()},
        registry={name: download.sha256 for name, download in first_of.items()},
        allow_updates=False,
    )
