"""Folders of predictions in other layouts: which noisy frame a file is meant for, by the words and numbers in its name.

Pure functions of names. Nothing is scored by them: they make one message of what would be one for each frame.
"""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

EXTENSIONS = (".npy", ".npz", ".h5", ".tif", ".tiff", ".png", ".dng")
"""The kinds of file that a prediction may be, by the ends of their names."""

_WORD = re.compile(r"[^\W\d_]+|\d+")
_EXTENSION = re.compile(r"\.[a-z][a-z0-9]{0,8}")  # not the end of 00001_00_0.1s
_MOST_EXAMINED = 20  # files whose names are held against those of all noisy frames
_MOST_WORDS = 40  # of a path, at its end
_MOST_NAMED = 3
_FOLDERS_ABOVE = 3
READ = f"{', '.join(EXTENSIONS[:-1])} or {EXTENSIONS[-1]}"


@dataclass(frozen=True, slots=True)
class Expected:
    """Names that files of predictions may have, all as POSIX paths relative to their folder.

    Attributes
    ----------
    places
        Of the predictions that are to be scored: the noisy frames' paths.
    references
        Paths of references, each with that of a noisy frame that it is the reference of.
    elsewhere
        Paths of the noisy frames of other datasets, by their names.
    """

    places: Collection[str]
    references: Mapping[str, str]
    elsewhere: Mapping[str, Collection[str]]


def stem_of(path: str) -> str:
    """Return a path without its extension."""
    return Path(path).with_suffix("").as_posix()


def is_read(name: str) -> bool:
    """Return whether a file's extension is one that predictions have."""
    return Path(name).suffix.lower() in EXTENSIONS


def layout_in_words(folder: Path, names: Sequence[str], expected: Expected) -> str:
    """Return what lies in a folder in which no prediction lies where it is looked for, and the nearest layout.

    Parameters
    ----------
    folder
        The folder of predictions; those above it may be the right one.
    names
        The files in it, POSIX paths relative to it.
    expected
        What would be looked for.
    """
    read = [name for name in names if is_read(name)]
    place = next(iter(expected.places))
    rule = f"the prediction of {place} is {_target(place)}"
    if not names:
        return f"found no file, but for hidden ones and links to folders; expected one for each noisy frame: {rule}"
    found = f"found {_counted(read or names)}, "
    if read:
        found += f"none of them where expected ({rule})"
    else:
        found += f"none of them read; expected {READ} ({rule}, and eldata.evaluation.save_prediction writes it)"
    likely = read or names
    advice = (
        _of_other_datasets(likely, expected) or _other_folder(folder, likely, expected) or _nearest(likely, expected)
    )
    return f"{found}; {advice or 'is it the right folder, and the right dataset?'}"


def nearest_in_words(names: Sequence[str], places: Iterable[str]) -> str | None:
    """Return what a file's name would have to be, of the first file of which it can be told, or ``None``."""
    words = _Words(places)
    for name in names[:_MOST_EXAMINED]:
        meant, _ = words.meant(name)
        if len(meant) == 1:
            return f"{name} would be {_target(meant[0], name)}"
    return None


# --- the nearest layout -----------------------------------------------------------------------------------------------


def _of_other_datasets(names: Sequence[str], expected: Expected) -> str | None:
    stems = {stem_of(name) for name in names}
    counts = {name: len(stems & {stem_of(path) for path in paths}) for name, paths in expected.elsewhere.items()}
    there = [f"{count} of them of {name} (--dataset {name})" for name, count in counts.items() if count]
    return f"it holds predictions of other data, {_listed(there, 'and')}" if there else None


def _other_folder(folder: Path, names: Sequence[str], expected: Expected) -> str | None:
    """Return which other folder has the expected layout: one below, several below, or one above this."""
    stems = {stem_of(place) for place in expected.places}
    depths = {stem.count("/") + 1 for stem in stems}
    below: set[str] = set()
    for name in names:
        parts = stem_of(name).split("/")
        cuts = [len(parts) - depth for depth in depths if depth < len(parts)]
        below.update("/".join(parts[:cut]) for cut in cuts if "/".join(parts[cut:]) in stems)
    if len(below) == 1:
        (one,) = below
        return f"they lie below {one}: give {folder / one} as the folder of predictions"
    if below:
        several = _listed([str(folder / name) for name in sorted(below)], "and")
        return f"each of {several} holds some: give one of them as the folder of predictions"
    above = Path(os.path.abspath(folder))  # noqa: PTH100 # as it was called, links are not followed
    for levels in range(1, min(_FOLDERS_ABOVE, len(above.parts) - 1) + 1):
        prefix = "/".join(above.parts[-levels:])
        if any(f"{prefix}/{stem_of(name)}" in stems for name in names):
            return f"this is {prefix} of the layout: give {above.parents[levels - 1]} as the folder of predictions"
    return None


def _nearest(names: Sequence[str], expected: Expected) -> str | None:
    """Return an example: a file, and what its name would have to be."""
    noisy, references = _Words(expected.places), _Words(expected.references)
    unclear = None
    for name in names[:_MOST_EXAMINED]:
        meant, whole = noisy.meant(name)
        reference, is_reference = references.meant(name)
        if is_reference and not whole:
            frame = expected.references[reference[0]]
            return (
                f"{name} has the name of a reference; predictions have that of their noisy frame, such as "
                f"{_target(frame, name)}"
            )
        if len(meant) == 1:
            return f"{name} would be {_target(meant[0], name)}"
        if meant and unclear is None:
            several = _listed([_target(place, name) for place in meant], "or")
            unclear = f"{name} could be {several}: its name does not tell which"
    return unclear


class _Words:
    """Places by the words and numbers in their names, to find those that another name has most of."""

    def __init__(self, places: Iterable[str]) -> None:
        self._words = {place: _words(stem_of(place)) for place in places}
        self._whole: defaultdict[tuple[str, ...], list[str]] = defaultdict(list)
        self._begun: defaultdict[tuple[str, ...], list[str]] = defaultdict(list)
        for place in self._words:
            frame = _words(stem_of(place).rpartition("/")[2])
            self._whole[frame].append(place)
            for length in range(1, len(frame)):
                if any(word.isdecimal() for word in frame[:length]):
                    self._begun[frame[:length]].append(place)

    def meant(self, name: str) -> tuple[list[str], bool]:
        """Return the places that a file is most likely meant for, and whether it has their frames' whole names."""
        words = _words(stem_of(name) if _extension(name) else name)
        for index, whole in ((self._whole, True), (self._begun, False)):
            for length in range(min(len(words), max(map(len, index), default=0)), 0, -1):
                runs = {words[start : start + length] for start in range(len(words) - length + 1)}
                found = dict.fromkeys(place for run in sorted(runs) for place in index.get(run, ()))
                if found:
                    shared = {place: _in_common(self._words[place], words) for place in found}
                    most = max(shared.values())
                    return [place for place, count in shared.items() if count == most], whole
        return [], False


def _words(text: str) -> tuple[str, ...]:
    """Return words and numbers, without case and leading zeros: ``scene-1/IMG_0004`` as scene, 1, img, 4."""
    return tuple(word.lstrip("0") or "0" for word in _WORD.findall(text.casefold())[-_MOST_WORDS:])


def _in_common(one: Sequence[str], other: Sequence[str]) -> tuple[int, int]:
    """Return how many words two sequences share, and how many in the same order (longest common subsequence)."""
    row = [0] * (len(other) + 1)
    for word in one:
        before, row = row, [0]
        for column, found in enumerate(other):
            row.append(before[column] + 1 if word == found else max(before[column + 1], row[column]))
    return (Counter(one) & Counter(other)).total(), row[-1]


# --- in words ---------------------------------------------------------------------------------------------------------


def _target(place: str, name: str = "") -> str:
    """Return where a prediction would lie: with its own extension if that is one that is read."""
    return stem_of(place) + (Path(name).suffix if is_read(name) else EXTENSIONS[0])


def _extension(name: str) -> str:
    suffix = Path(name).suffix.lower()
    return suffix if _EXTENSION.fullmatch(suffix) else ""


def _counted(names: Sequence[str]) -> str:
    """Return the numbers of files by extension, such as ``12 .npy files and 1 .json file``."""
    counts = Counter(_extension(name) or "no extension" for name in names).most_common()
    texts = [
        (f"{count} {what} file" if what.startswith(".") else f"{count} file")
        + "s" * (count > 1)
        + ("" if what.startswith(".") else " without an extension")
        for what, count in counts
    ]
    return _listed(texts, "and")


def _listed(texts: Sequence[str], word: str) -> str:
    """Return the first of some texts in a sentence, such as ``a, b and 3 others``."""
    shown = list(texts[:_MOST_NAMED])
    if len(texts) > _MOST_NAMED + 1:
        shown.append(f"{len(texts) - _MOST_NAMED} others")
    else:
        shown = list(texts)
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} {word} {shown[-1]}"
