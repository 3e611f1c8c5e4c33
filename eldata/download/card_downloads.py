"""What a dataset card says about archives: names, sizes, parts, and which ones pooch may fetch; room for them."""

from __future__ import annotations

import shutil
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from tqdm import tqdm

from eldata.errors import ArgumentError, DownloadError
from eldata.manifest.catalogue import data_root

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from pooch import Pooch

    from eldata.manifest.card import Card, Download

SUFFIXES = (".zip", ".7z")


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
    archives = [download for download in reversed(card.downloads) if download.direct and archive_name(download)]
    first_of = {archive_name(download): download for download in archives}
    return pooch.create(
        path=folder.absolute() if folder.parts[0].startswith("~") else folder,  # pooch takes ~ for the home folder
        base_url="",
        urls={name: download.address for name, download in first_of.items()},
        registry={name: download.sha256 for name, download in first_of.items()},
        allow_updates=False,
    )


# --- numbers of bytes -------------------------------------------------------------------------------------------------


def size_text(size_bytes: int) -> str:
    """Return a size in decimal units, as publishers and disks state it: ``25.1 GB``."""
    size = float(size_bytes)
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size_bytes} bytes" if unit == "bytes" else f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"


def progress_bar(name: str, total_bytes: int | None = None) -> tqdm[Any]:
    """Return a bar that counts bytes, seen only in a terminal."""
    return tqdm(desc=name, total=total_bytes, unit="B", unit_scale=True, unit_divisor=1000, disable=None, leave=False)


def check_room(folder: Path, missing_bytes: int, purpose: str) -> None:
    """Raise :class:`~eldata.errors.DownloadError` if this many bytes do not fit on the folder's disk."""
    free = shutil.disk_usage(folder).free
    if missing_bytes > free:
        raise DownloadError(
            f"{folder}: {size_text(missing_bytes)} are {purpose}, {size_text(free)} are free; make room, or choose "
            "another disk with --root"
        )
