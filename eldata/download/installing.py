"""From an archive, fetched or saved by hand, to the dataset's folder; which of its folders goes where there."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from eldata.download.archives import read_format, read_members, unpack_archive
from eldata.download.fetching import RangeDownloader, archive_name, fetch_archive
from eldata.errors import ArchiveError
from eldata.manifest.patterns import is_pattern

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable
    from pathlib import Path

    _Ends = dict[str, dict[str, set[str]]]

    from eldata.manifest.card import Download
    from eldata.manifest.catalogue import Manifest


@dataclass(frozen=True, slots=True)
class Installed:
    """What was unpacked from one archive, as paths relative to the dataset's folder.

    ``same_size`` were there already, and so were ``differing``, of another size or not files; all were left alone.
    ``files_listed`` of the archive's files are in the manifest; ``left`` are its members beside the dataset's folder.
    """

    archive: Path
    written: tuple[str, ...]
    same_size: tuple[str, ...]
    differing: tuple[str, ...]
    files_listed: int
    left: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain JSON types."""
        return asdict(self) | {"archive": str(self.archive)}

    def format_text(self) -> str:
        """Return it as text."""
        lines = [f"    left alone, differs in size from the archive's: {path}" for path in self.differing]
        lines.append(
            f"{self.archive.name}: {len(self.written)} files unpacked, {len(self.same_size)} were there already"
            + (f", {len(self.differing)} differ and were left alone" if self.differing else "")
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
        See :func:`~eldata.download.archives.read_members`, :func:`find_relocation` and
        :func:`~eldata.download.archives.unpack_archive`.
    """
    members = read_members(archive_path)
    listed = [record.path for record in manifest.records]
    names = [member.name for member in members]
    downloads = manifest.card.downloads
    below = next((one.below for one in downloads if archive_name(one.address) == archive_path.name), None)
    relocation = find_relocation(archive_path, names, listed, below)
    targets = {name: target for name in names if (target := relocation.target(name)) is not None}
    if read_format(archive_path) == "blocks":
        _require_blocks(archive_path, set(targets.values()), listed)
    outcome = unpack_archive(archive_path, members, targets, folder)
    left = tuple(sorted(set(names) - set(targets)))
    return Installed(archive_path, *outcome, count_listed(targets.values(), listed), left)


def _require_blocks(archive: Path, blocks: Collection[str], listed: Iterable[str]) -> None:
    """Refuse an array of other blocks than those that the manifest lists in their folder."""
    (folder,) = {path.rpartition("/")[0] for path in blocks}
    expected = {path for path in listed if path.rpartition("/")[0] == folder}
    if expected != blocks:
        raise ArchiveError(
            archive,
            f"holds {len(blocks)} blocks, up to {max(blocks)}, and the manifest lists {len(expected)}, up to "
            f"{max(expected)}; its sides must be (images, blocks, rows, columns), as published",
        )


def fetch_dataset(
    download: Download, manifest: Manifest, root: Path | str | None = None, downloader: RangeDownloader | None = None
) -> Installed:
    """Fetch an archive of the card into the data root's folder of archives, where it is kept, and unpack it.

    Raises
    ------
    ArchiveError, DownloadError
        See :func:`~eldata.download.fetching.fetch_archive` and :func:`unpack_dataset`.
    """
    archive = fetch_archive(download, root, downloader or RangeDownloader())
    return unpack_dataset(archive, manifest, manifest.stated_folder(root))


# --- which folder goes where ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Relocation:
    """The archive's folder ``inside`` is the folder ``below`` of the dataset; empty means the top."""

    inside: str
    below: str

    def target(self, name: str) -> str | None:
        """Return where a member belongs, relative to the dataset's folder; ``None`` if it lies elsewhere."""
        if self.inside and not name.startswith(f"{self.inside}/"):
            return None
        rest = name[len(self.inside) + 1 :] if self.inside else name
        return f"{self.below}/{rest}" if self.below else rest


def find_relocation(
    archive: Path, names: Collection[str], listed: Collection[str], unlisted_below: str | None = None
) -> Relocation:
    """Return the one relocation by which an archive's files are those that a manifest lists.

    A publisher packs ``Sony/short/...``, ``SID/Sony/short/...`` or ``short/...``, and changes that between versions.
    The ends of the listed paths tell which; where two fit (``scene-1/IMG_0001.CR2`` without its camera), nothing is
    guessed. If no file is listed, the archive's top folder is ``unlisted_below`` of the dataset, if that is given.

    Raises
    ------
    ArchiveError
        If no file is listed, or the files fit in several ways.
    """
    ends = _index_ends(listed)
    found = (_find_end(ends, name) for name in names)
    ways = dict.fromkeys(Relocation(within, below) for within, belows in found for below in sorted(belows))
    if len(ways) == 1:
        return next(iter(ways))
    by_hand = f"unpack it by hand so that {min(listed)} lies in the dataset's folder, then run eldata verify"
    if ways:
        shown = ", ".join(f"{way.inside or '.'} as {way.below or '.'}" for way in list(ways)[:3])
        raise ArchiveError(archive, f"its files fit the manifest in {len(ways)} ways ({shown}); {by_hand}")
    if unlisted_below is not None:
        return Relocation("", unlisted_below)
    raise ArchiveError(
        archive,
        f"none of its {len(names)} files is listed (found such as {min(names)}, expected such as {min(listed)}); "
        f"is it another dataset's archive? If not, {by_hand}",
    )


def count_listed(paths: Iterable[str], listed: Iterable[str]) -> int:
    """Return how many paths a manifest lists, by name or by pattern."""
    ends = _index_ends(listed)
    return sum("" in _find_end(ends, path)[1] for path in paths)


def _index_ends(listed: Iterable[str]) -> _Ends:
    """Return the ends of listed paths, such as ``short/00001_00_0.1s.ARW``: folder, then file, then what lies above."""
    ends: _Ends = {}
    for path in listed:
        *folders, file = path.split("/")
        for start in range(len(folders) + (not is_pattern(file))):  # *.png without a folder says nothing
            held = ends.setdefault("/".join(folders[start:]), {})
            held.setdefault(file, set()).add("/".join(folders[:start]))
    return ends


def _find_end(ends: _Ends, name: str) -> tuple[str, set[str]]:
    """Return what lies above a member in the archive, and what above its listed namesakes in the dataset."""
    *folders, file = name.split("/")
    for start in range(len(folders) + 1):  # the longest end that is listed says most
        held = ends.get("/".join(folders[start:]), {})
        fitting = (above for listed, above in held.items() if is_pattern(listed) and fnmatchcase(file, listed))
        above = held.get(file) or next(fitting, set())
        if above or (start < len(folders) and held):  # an unlisted file of a listed folder
            return "/".join(folders[:start]), above
    return "", set()
