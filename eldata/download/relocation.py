"""Which folder of an archive goes to which folder of the dataset: found by the names that the manifest lists."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from eldata.errors import ArchiveError
from eldata.manifest.patterns import is_pattern

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable
    from pathlib import Path


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
    ends = _Ends(listed)
    votes: Counter[Relocation] = Counter()
    unclear: list[str] = []
    for name in names:
        inside, above = ends.of(name)
        if len(above) == 1:
            votes[Relocation(inside, next(iter(above)))] += 1
        elif above:
            unclear.append(name)
    if len(votes) == 1 and not unclear:
        return next(iter(votes))
    by_hand = f"unpack it by hand so that {min(listed)} lies in the dataset's folder, then run eldata verify"
    if not votes and not unclear:
        if unlisted_below is not None:
            return Relocation("", unlisted_below)
        raise ArchiveError(
            archive,
            f"none of its {len(names)} files is listed (found such as {min(names)}, expected such as {min(listed)}); "
            f"is it another dataset's archive? If not, {by_hand}",
        )
    if unclear:
        raise ArchiveError(archive, f"{unclear[0]} could be any of several listed files; {by_hand}")
    ways = ", ".join(f"{way.inside or '.'} as {way.below or '.'}" for way, _ in votes.most_common(3))
    raise ArchiveError(archive, f"its files fit the manifest in {len(votes)} ways ({ways}); {by_hand}")


def count_listed(paths: Iterable[str], listed: Iterable[str]) -> int:
    """Return how many paths a manifest lists, by name or by pattern."""
    ends = _Ends(tuple(listed))
    return sum("" in ends.of(path)[1] for path in paths)


class _Ends:
    """The ends of listed paths, such as ``short/00001_00_0.1s.ARW``, and what lies above each."""

    def __init__(self, listed: Collection[str]) -> None:
        # End of the folder: name or pattern of the file: what lies above.
        self._above: dict[str, dict[str, set[str]]] = {}
        for path in listed:
            *folders, file = path.split("/")
            for start in range(len(folders) + 1):
                if start == len(folders) and is_pattern(file):
                    continue  # *.png without a folder says nothing
                ends = self._above.setdefault("/".join(folders[start:]), {})
                ends.setdefault(file, set()).add("/".join(folders[:start]))

    def of(self, name: str) -> tuple[str, set[str]]:
        """Return what lies above a member in the archive, and what above its listed namesakes in the dataset."""
        *folders, file = name.split("/")
        for start in range(len(folders) + 1):  # the longest end that is listed says most
            ends = self._above.get("/".join(folders[start:]))
            if ends is None:
                continue
            above = ends.get(file) or next(
                (found for listed, found in ends.items() if is_pattern(listed) and fnmatchcase(file, listed)), set()
            )
            if above or start < len(folders):  # an unlisted file of a listed folder is just that
                return "/".join(folders[:start]), above
        return "", set()
