"""From an archive, fetched or saved by hand, to the dataset's folder; which of its folders goes where there."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from eldata.download.archives import read_format, read_members, unpack_archive
from eldata.download.fetching import archive_name
from eldata.errors import ArchiveError
from eldata.manifest.patterns import as_glob, is_pattern

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable
    from pathlib import Path

    _Ends = dict[str, dict[str, set[str]]]

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
        """Return the record as plain JSON types."""
        return asdict(self) | {"archive": str(self.archive)}

    def format_text(self) -> str:
        """Return the record as lines of text."""
        lines = [f"    left alone, differs in size from the archive's: {path}" for path in self.differing]
        facts = [
            f"{self.archive.name}: {len(self.written)} files unpacked, {len(self.same_size)} were there already",
            f", {len(self.differing)} differ and were left alone" if self.differing else "",
            f"; {self.files_listed} of its files are listed in the manifest",
            f"; {len(self.left)} files beside the dataset's folder stay in it" if self.left else "",
        ]
        return "\n".join([*lines, "".join(facts)])


def unpack_dataset(archive_path: Path, manifest: Manifest, folder: Path) -> Installed:
    """Check an archive and unpack it into the dataset's folder.

    The names that the manifest lists show which of its folders is which of the dataset's; if it lists none of them, the
    card may say where they go.

    Raises
    ------
    ArchiveError, DownloadError
        See :func:`~eldata.download.archives.read_members`, :func:`find_targets` and
        :func:`~eldata.download.archives.unpack_archive`.
    """
    members = read_members(archive_path)
    listed = [record.path for record in manifest.records]
    names = [member.name for member in members]
    downloads = manifest.card.downloads
    below = next((one.below for one in downloads if archive_name(one.address) == archive_path.name), None)
    targets = find_targets(archive_path, names, listed, below)
    if read_format(archive_path) == "blocks":
        folders = {path.rpartition("/")[0] for path in targets.values()}
        blocks = {path for path in listed if path.rpartition("/")[0] in folders}
        if blocks != set(targets.values()):
            sides = "its sides must be (images, blocks, rows, columns), as published"
            holds = f"holds {len(targets)} blocks, and the manifest lists {len(blocks)}"
            raise ArchiveError(archive_path, f"{holds}; {sides}")
    outcome = unpack_archive(archive_path, members, targets, folder)
    left = tuple(sorted(set(names) - set(targets)))
    return Installed(archive_path, *outcome, count_listed(targets.values(), listed), left)


# --- which folder goes where ------------------------------------------------------------------------------------------


def find_targets(
    archive: Path, names: Collection[str], listed: Collection[str], unlisted_below: str | None = None
) -> dict[str, str]:
    """Find where an archive's files belong in the dataset's folder, so that they are those that a manifest lists.

    A publisher packs ``Sony/short/...``, ``SID/Sony/short/...`` or ``short/...``, and changes that between versions.
    The ends of the listed paths tell which; where two fit (``scene-1/IMG_0001.CR2`` without its camera), nothing is
    guessed. If no file is listed, the archive's top folder is ``unlisted_below`` of the dataset, if that is given.
    Files beside the archive's folder that is the dataset's have no target.

    Raises
    ------
    ArchiveError
        If no file is listed, or the files fit in several ways.
    """
    ends = _index_ends(listed)
    above = (_find_end(ends, name) for name in names)
    ways = list(dict.fromkeys((within, below) for within, belows in above for below in sorted(belows)))
    by_hand = f"unpack it by hand so that {min(listed)} lies in the dataset's folder, then run eldata verify"
    if len(ways) > 1:
        shown = ", ".join(f"{within or '.'} as {below or '.'}" for within, below in ways[:3])
        raise ArchiveError(archive, f"its files fit the manifest in {len(ways)} ways ({shown}); {by_hand}")
    if not ways and unlisted_below is not None:
        ways = [("", unlisted_below)]
    if not ways:
        examples = f"found such as {min(names)}, expected such as {min(listed)}"
        advice = f"is it another dataset's archive? If not, {by_hand}"
        raise ArchiveError(archive, f"none of its {len(names)} files is listed ({examples}); {advice}")
    within, below = (f"{folder}/" if folder else "" for folder in ways[0])
    return {name: below + name.removeprefix(within) for name in names if name.startswith(within)}


def count_listed(paths: Iterable[str], listed: Iterable[str]) -> int:
    """Count the paths that a manifest lists, by name or by pattern."""
    ends = _index_ends(listed)
    return sum("" in _find_end(ends, path)[1] for path in paths)


def _index_ends(listed: Iterable[str]) -> _Ends:
    """Return the ends of listed paths, such as ``short/00001_00_0.1s.ARW``: folder, then file, then what lies above."""
    ends: _Ends = {}
    for path in listed:
        *folders, file = as_glob(path).split("/")
        for start in range(len(folders) + (not is_pattern(file))):  # *.png without a folder says nothing
            held = ends.setdefault("/".join(folders[start:]), {})
            held.setdefault(file, set()).add("/".join(folders[:start]))
    return ends


def _find_end(ends: _Ends, name: str) -> tuple[str, set[str]]:
    """Return the folders above a member in the archive, and those above its listed namesakes in the dataset."""
    *folders, file = name.split("/")
    for start in range(len(folders) + 1):  # the longest end that is listed says most
        held = ends.get("/".join(folders[start:]), {})
        fitting = (above for listed, above in held.items() if is_pattern(listed) and fnmatchcase(file, listed))
        above = held.get(file) or next(fitting, set())
        if above or (start < len(folders) and held):  # an unlisted file of a listed folder
            return "/".join(folders[:start]), above
    return "", set()
