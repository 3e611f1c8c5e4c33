"""Rows that stand for several files, where not all names are published: a part of the path has a ``*`` or a field.

``VBM4D_rawRGB/0001/*.png`` is every PNG file of that folder. A field fills in a row: ``noisy/{scene}/{ratio}.npy`` is
a row for each such file, of that scene and ratio, ``clip.npy#{frame}`` one for each part of an array's first side; what
a field stands for (of any name) is put into ``reference``, too. :func:`expand` replaces such rows by the files of one
copy; ``eldata lock`` writes those into the manifest. Until then a missing file shows as a gap in the numbering, or not
at all: how many there should be is not known.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from operator import attrgetter
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from eldata.base.files import inside, split_member, visible_below
from eldata.base.numbers import natural
from eldata.errors import FileError
from eldata.manifest.table import parse_cell
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_END = 3
_FIELD = re.compile(r"\{([a-z_]+)\}")
_FILLED = ("camera", "scene", "split", "iso", "exposure_s", "ratio")  # fields of a row that a path may state
_DIGITS = re.compile(r"([0-9]+)")


def is_pattern(path: str) -> bool:
    """Tell whether a row's path is a pattern, which stands for all files that it matches."""
    return "*" in path or has_fields(path)


def has_fields(path: str) -> bool:
    """Tell whether a row's path is a pattern with fields; in a copy's manifest, that no file of it is there."""
    return _FIELD.search(path) is not None


def as_glob(path: str) -> str:
    """Return the path of a row's file with a ``*`` for each field."""
    return _FIELD.sub("*", split_member(path)[0])


def is_png(path: str) -> bool:
    """Tell whether a path is a PNG file's."""
    return path.lower().endswith(".png")


def matching(folder: Path, pattern: str) -> dict[str, dict[str, str]]:
    """Return the files that a pattern matches, relative to the dataset's folder, and what its fields stand for.

    They are in the order of their numbers. Hidden files are left out.

    Raises
    ------
    ManifestError
        If the pattern's folder leads outside of the dataset's folder.
    """
    pattern, member = split_member(pattern)
    found: dict[str, dict[str, str]] = {"": {}}
    for part in PurePosixPath(pattern).parts:
        below: dict[str, dict[str, str]] = {}
        for place, fields in found.items():
            name = _fill(part, fields)
            if not is_pattern(name):
                below[f"{place}{name}/"] = fields
                continue
            entries = visible_below(inside(folder, place[:-1]) if place else folder, deep=False)
            fits = {path.name: _compile(name).fullmatch(path.name) for path in entries}
            below |= {
                f"{place}{own}/": fields | fit.groupdict()
                for own in sequence_of(own for own, fit in fits.items() if fit).names
                if (fit := fits[own])
            }
        found = below
    files = {place[:-1]: fields for place, fields in found.items() if inside(folder, place[:-1]).is_file()}
    if not member:
        return files
    return {
        f"{path}#{part}": fields | more
        for path, fields in files.items()
        for part, more in _parts_of(folder / path, _fill(member, fields)).items()
    }


def _parts_of(file: Path, member: str) -> dict[str, dict[str, str]]:
    """List the parts of an array file that a row names, each with the number that its field stands for."""
    if (field := _FIELD.search(member)) is None:
        return {member: {}}
    from eldata.base.arrays import declared_array

    try:
        shape = declared_array(file, name=member[: field.start()].rstrip(":"), error=FileError).shape
    except FileError:  # whatever reads it, or checks it, says why it cannot
        return {member: {}}
    return {_FIELD.sub(str(part), member): {field[1]: str(part)} for part in range((*shape, 0)[0])}


def _fill(pattern: str, fields: Mapping[str, str]) -> str:
    """Put what fields stand for into a pattern, where it is known."""
    return _FIELD.sub(lambda field: fields.get(field[1], field[0]), pattern)


@cache
def _compile(part: str) -> re.Pattern[str]:
    """Compile a part of a pattern to an expression with a group for each field."""
    texts = re.split(r"(\*|\?|\{[a-z_]+\})", part)
    signs = {"*": ".*", "?": "."}
    return re.compile(
        "".join(
            f"(?P<{text[1:-1]}>.+?)" if _FIELD.fullmatch(text) else signs.get(text, re.escape(text)) for text in texts
        )
    )


def find_elsewhere(folder: Path, paths: Iterable[str], listed: Iterable[FrameRecord] = ()) -> dict[str, str]:
    """Find where else below a set's folder files of these paths lie, by the last three parts of a path.

    Loaders and archives lay one set out differently, such as CRVD with a folder more, or less, for each kind of frame;
    or flat, as downloads are: a file of a name that one ``listed`` row has is found in any folder.
    """
    wanted, names = [*paths], Counter(PurePosixPath(row.path).name for row in listed)
    ends = {PurePosixPath(path).parts[-_END:]: path for path in wanted}
    ends |= {PurePosixPath(path).parts[-1:]: path for path in wanted if names[PurePosixPath(path).name] == 1}
    places = (PurePosixPath(file.relative_to(folder)) for file in (visible_below(folder) if ends else ()))
    found = ((ends.get(place.parts[-_END:]) or ends.get(place.parts[-1:]), str(place)) for place in places)
    return {path: place for path, place in found if path is not None}


def expand(records: Iterable[FrameRecord], folder: Path) -> tuple[FrameRecord, ...]:
    """Return rows in which the files of a copy replace the patterns, sorted by path.

    A pattern that matches nothing stays; so does one in ``reference`` unless it matches one file, of the same fields.

    Raises
    ------
    ManifestError
        If a field's text does not fit its column, such as a ratio that is not a number.
    """
    rows = tuple(records)
    files = {row.path: matching(folder, row.path) for row in rows if is_pattern(row.path)}
    if not files:
        return tuple(sorted(rows, key=attrgetter("path")))
    only = {pattern: next(iter(found.items())) for pattern, found in files.items() if len(found) == 1}
    expanded = []
    for row in rows:
        for path, fields in (files.get(row.path) or {row.path: {}}).items():
            filled = {name: parse_cell(name, text, path) for name, text in fields.items() if name in _FILLED}
            if row.reference is not None:
                reference = _fill(row.reference, fields)
                place, own = only.get(row.reference, (reference, {}))
                alike = all(fields.get(name, text) == text for name, text in own.items())  # else it is another's
                filled["reference"] = place if is_pattern(reference) and alike else reference
            expanded.append(replace(row, path=path, **filled))
    paths = {row.path for row in expanded}
    needing = {row.reference: row for row in expanded if row.reference is not None}
    expanded += [
        FrameRecord(path, "reference", row.camera, row.scene, row.split)
        for path, row in needing.items()
        if path not in paths and not is_pattern(path)  # so that it is missed
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
    ordered = sorted(split, key=natural)
    kinds = Counter("0".join(split[name][::2]) for name in ordered)
    if not kinds:
        return FrameSequence((), None, ())
    usual = kinds.most_common(1)[0][0]
    alike = [name for name in ordered if "0".join(split[name][::2]) == usual]
    columns = list(zip(*([int(part) for part in split[name][1::2]] for name in alike), strict=True))
    running = [column for column in columns if len(set(column)) > 1]
    numbers = running[0] if len(running) == 1 else None
    return FrameSequence(tuple(ordered), numbers, tuple(name for name in ordered if name not in alike))
