"""Rows that stand for several files, where the names are not published: the last part of the path has a ``*``.

``VBM4D_rawRGB/0001/*.png`` is every PNG file of that folder. :func:`expand` replaces such rows by the files of one
copy; ``eldata lock`` writes those into the manifest. Until then a missing file shows as a gap in the numbering, or not
at all: how many there should be is not known.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import pairwise
from operator import attrgetter
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from eldata.base.files import inside, visible_below

if TYPE_CHECKING:
    from collections.abc import Iterable

    from eldata.records import FrameRecord

_END = 3
_DIGITS = re.compile(r"([0-9]+)")


def is_pattern(path: str) -> bool:
    """Tell whether a row's path is a pattern, which stands for all files that it matches."""
    return "*" in path


def is_png(path: str) -> bool:
    """Tell whether a path is a PNG file's."""
    return path.lower().endswith(".png")


def matching(folder: Path, pattern: str) -> tuple[str, ...]:
    """Return the files that a pattern matches, relative to the dataset's folder, in the order of their numbers.

    Hidden files are left out.

    Raises
    ------
    ManifestError
        If the pattern's folder leads outside of the dataset's folder.
    """
    place = PurePosixPath(pattern)
    parent = inside(folder, place.parent.as_posix())
    files = visible_below(parent, deep=False)
    names = [path.name for path in files if fnmatchcase(path.name, place.name) and path.is_file()]
    return tuple(str(place.with_name(name)) for name in sequence_of(names).names)


def find_elsewhere(folder: Path, paths: Iterable[str]) -> dict[str, str]:
    """Find where else below a set's folder files of these paths lie, by the last three parts of a path.

    Loaders and archives lay one set out differently, such as CRVD with a folder more, or less, for each kind of frame.
    """
    ends = {PurePosixPath(path).parts[-_END:]: path for path in paths}
    places = (PurePosixPath(file.relative_to(folder)) for file in (visible_below(folder) if ends else ()))
    return {ends[place.parts[-_END:]]: str(place) for place in places if place.parts[-_END:] in ends}


def expand(records: Iterable[FrameRecord], folder: Path) -> tuple[FrameRecord, ...]:
    """Return rows in which the files of a copy replace the patterns, sorted by path.

    A pattern that matches nothing stays, and so does one in ``reference`` unless it matches one file.
    """
    rows = tuple(records)
    files = {row.path: matching(folder, row.path) for row in rows if is_pattern(row.path)}
    if not files:
        return tuple(sorted(rows, key=attrgetter("path")))
    only = {pattern: found[0] for pattern, found in files.items() if len(found) == 1}
    expanded = [
        replace(row, path=path, reference=None if row.reference is None else only.get(row.reference, row.reference))
        for row in rows
        for path in files.get(row.path) or (row.path,)
    ]
    return tuple(sorted(expanded, key=attrgetter("path")))


# --- running numbers --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FrameSequence:
    """The names of a clip's frames in order.

    Attributes
    ----------
    names
        In the order of the numbers in them (``2.png`` before ``10.png``).
    numbers
        The running number of each name of ``names`` that is not ``odd``; ``None`` if they have none.
    odd
        Names that are not like most others, such as ``0005 (1).png``.
    """

    names: tuple[str, ...]
    numbers: tuple[int, ...] | None
    odd: tuple[str, ...]

    @property
    def gaps(self) -> tuple[tuple[int, int], ...]:
        """First and last missing number of each gap."""
        return tuple((a + 1, b - 1) for a, b in pairwise(self.numbers or ()) if b > a + 1)

    @property
    def doubles(self) -> tuple[int, ...]:
        """Numbers that two names have, such as ``5.png`` and ``05.png``."""
        return tuple(a for a, b in pairwise(self.numbers or ()) if a == b)


def sequence_of(names: Iterable[str]) -> FrameSequence:
    """Return names in order, with the one number that runs through them if there is one."""
    split = {name: _DIGITS.split(name) for name in names}
    ordered = sorted(split, key=lambda name: ([_make_sort_key(part) for part in split[name]], name))
    kinds = Counter("0".join(split[name][::2]) for name in ordered)
    if not kinds:
        return FrameSequence((), None, ())
    usual = kinds.most_common(1)[0][0]
    alike = [name for name in ordered if "0".join(split[name][::2]) == usual]
    columns = list(zip(*([int(part) for part in split[name][1::2]] for name in alike), strict=True))
    running = [column for column in columns if len(set(column)) > 1]
    numbers = running[0] if len(running) == 1 else None
    return FrameSequence(tuple(ordered), numbers, tuple(name for name in ordered if name not in alike))


def _make_sort_key(part: str) -> tuple[int, int, str]:
    """Make a sort key of a name's part: numbers by value, before other text."""
    return (0, int(part), "") if part.isdecimal() else (1, 0, part)
