"""From an archive, fetched or saved by hand, to a dataset's folder."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.download.archives import open_archive
from eldata.download.layout import count_listed, find_layout
from eldata.download.places import archives_folder, place_of_archive, places_of
from eldata.download.unpacking import Unpacked, unpack

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.download.fetching import Fetcher
    from eldata.download.places import Place
    from eldata.manifest.catalogue import Manifest


@dataclass(frozen=True, slots=True)
class Installed:
    """What came out of one archive.

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

    Which of its folders is which of the dataset's, the names that the manifest lists tell; where it lists none of them,
    the card may say where they go.

    Raises
    ------
    ArchiveError, DownloadError
        See :func:`~eldata.download.archives.open_archive`, :func:`~eldata.download.layout.find_layout` and
        :func:`~eldata.download.unpacking.unpack`.
    """
    archive = open_archive(archive_path)
    listed = [record.path for record in manifest.records]
    names = [member.name for member in archive.files]
    place = place_of_archive(places_of(manifest.card), archive_path.name)
    layout = find_layout(archive_path, names, listed, place.below if place is not None else None)
    targets = {name: target for name in names if (target := layout.target(name)) is not None}
    unpacked = unpack(archive, targets, folder)
    left = tuple(sorted(set(names) - set(targets)))
    return Installed(archive_path, unpacked, count_listed(targets.values(), listed), left)


def fetch_dataset(place: Place, manifest: Manifest, root: Path, fetcher: Fetcher) -> Installed:
    """Fetch an archive into the data root's folder of archives, where it is kept, and unpack it.

    Raises
    ------
    ArchiveError, DownloadError
        See :meth:`~eldata.download.fetching.Fetcher.fetch` and :func:`unpack_dataset`.
    """
    target = archives_folder(root) / place.file_name
    fetcher.fetch(place.address, target, size_bytes=place.size_bytes, sha256=place.sha256)
    return unpack_dataset(target, manifest, manifest.folder(root))
