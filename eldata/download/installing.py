"""From an archive, fetched or saved by hand, to the dataset's folder."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.download.archives import open_archive
from eldata.download.card_downloads import SUFFIXES, archive_name, kept_archives
from eldata.download.relocation import count_listed, find_relocation
from eldata.download.unpacking import Unpacked, unpack_archive
from eldata.errors import DownloadError

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.download.fetching import Fetcher
    from eldata.manifest.card import Download
    from eldata.manifest.catalogue import Manifest


@dataclass(frozen=True, slots=True)
class Installed:
    """What was unpacked from one archive.

    ``files_listed`` of its files are in the manifest; ``left`` are its members beside the dataset's folder.
    """

    archive: Path
    unpacked: Unpacked
    files_listed: int
    left: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain JSON types."""
        return asdict(self) | {"archive": str(self.archive)}

    def format_text(self) -> str:
        """Return it as text."""
        done = self.unpacked
        lines = [f"    left alone, differs from the archive: {path}" for path in done.differing]
        lines.append(
            f"{self.archive.name}: {len(done.written)} files unpacked, {len(done.identical)} were there already"
            + (f", {len(done.differing)} differ and were left alone" if done.differing else "")
            + f"; {self.files_listed} of its files are listed in the manifest"
            + (f"; {len(self.left)} files beside the dataset's folder stay in it" if self.left else "")
        )
        return "\n".join(lines)


def unpack_dataset(archive_path: Path, manifest: Manifest, folder: Path) -> Installed:
    """Check an archive and unpack it into the dataset's folder.

    The names that the manifest lists show which of its folders is which of the dataset's; if it lists none of them, the
    card may say where they go.

    Raises
    ------
    ArchiveError, DownloadError
        See :func:`~eldata.download.archives.open_archive`, :func:`~eldata.download.relocation.find_relocation` and
        :func:`~eldata.download.unpacking.unpack_archive`.
    """
    archive = open_archive(archive_path)
    listed = [record.path for record in manifest.records]
    names = [member.name for member in archive.files]
    below = next((one.below for one in manifest.card.downloads if archive_name(one) == archive_path.name), None)
    relocation = find_relocation(archive_path, names, listed, below)
    targets = {name: target for name in names if (target := relocation.target(name)) is not None}
    unpacked = unpack_archive(archive, targets, folder)
    left = tuple(sorted(set(names) - set(targets)))
    return Installed(archive_path, unpacked, count_listed(targets.values(), listed), left)


def fetch_dataset(download: Download, manifest: Manifest, root: Path, fetcher: Fetcher) -> Installed:
    """Fetch an archive of the card into the data root's folder of archives, where it is kept, and unpack it.

    Raises
    ------
    ArchiveError, DownloadError
        See :meth:`~eldata.download.fetching.Fetcher.fetch` and :func:`unpack_dataset`.
    """
    name = archive_name(download)
    if not name:
        raise DownloadError(
            f"{download.address}: expected an address that ends in the name of an archive ({', '.join(SUFFIXES)}); "
            "fetch it in a browser and use --from"
        )

    def process(archive: Path) -> Installed:
        return unpack_dataset(archive, manifest, manifest.folder(root))

    return fetcher.fetch(kept_archives(manifest.card, root), name, process, size_bytes=download.size_bytes)
