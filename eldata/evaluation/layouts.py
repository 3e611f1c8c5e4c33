"""Folders of predictions: which files lie in one, and which noisy frame a file is meant for, by the words in its name.

Where nothing lies as expected, one message names the nearest layout.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import TYPE_CHECKING

from eldata.base.files import folder_problem, visible_below
from eldata.base.numbers import counted
from eldata.errors import EldataError
from eldata.evaluation.scores import EvaluationProblem

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

EXTENSIONS = (".npy", ".npz", ".h5", ".tif", ".tiff", ".png", ".dng")
"""The kinds of file that a prediction may be, by the ends of their names."""

_WORD = re.compile(r"[^\W\d_]+|\d+")
_EXTENSION = re.compile(r"\.[a-z][a-z0-9]{0,8}")  # not the end of 00001_00_0.1s
_MOST_EXAMINED = 20  # files whose names are compared with all noisy frames'
_MOST_WORDS = 40  # of a path, at its end
_MOST_NAMED = 3
_FOLDERS_ABOVE = 3
_MOST_EXTRA = 100  # files of no noisy frame that are named one by one
_MOST_SHOWN = 8  # predictions of one frame
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
    """Describe a folder in which no prediction lies where it is looked for, and the nearest layout.

    Parameters
    ----------
    folder
        The folder of predictions; those above it may be the right one.
    names
        The files in it, POSIX paths relative to it.
    expected
        What would be looked for.
    """
    likely = [name for name in names if is_read(name)]
    place = next(iter(expected.places))
    rule = f"the prediction of {place} is {_target(place)}"
    if not names:
        return f"found no file, but for hidden ones and links to folders; expected one for each noisy frame: {rule}"
    wrong = f"none of them where expected ({rule})"
    if not likely:
        likely = list(names)
        wrong = f"none of them read; expected {READ} ({rule}, and eldata.evaluation.save_prediction writes it)"
    advice = (
        _of_other_datasets(likely, expected) or _other_folder(folder, likely, expected) or _nearest(likely, expected)
    )
    return f"found {_counted(likely)}, {wrong}; {advice or 'is it the right folder, and the right dataset?'}"


def nearest_in_words(names: Sequence[str], places: Iterable[str]) -> str | None:
    """Say what the first file's name would have to be of which it can be told, or ``None``."""
    return _nearest(names, Expected(tuple(places), {}, {}), ambiguous=False)


# --- the nearest layout -----------------------------------------------------------------------------------------------


def _of_other_datasets(names: Sequence[str], expected: Expected) -> str | None:
    stems = {stem_of(name) for name in names}
    counts = {name: len(stems & {stem_of(path) for path in paths}) for name, paths in expected.elsewhere.items()}
    there = [f"{count} of them of {name} (--dataset {name})" for name, count in counts.items() if count]
    return f"it holds predictions of other data, {_listed(there, 'and')}" if there else None


def _other_folder(folder: Path, names: Sequence[str], expected: Expected) -> str | None:
    """Say which other folder has the expected layout: one below, several below, or one above this."""
    stems = {stem_of(place) for place in expected.places}
    deepest = max(stem.count("/") + 1 for stem in stems)
    below = set()
    for parts in (stem_of(name).split("/") for name in names):
        cuts = range(max(1, len(parts) - deepest), len(parts))
        below |= {"/".join(parts[:cut]) for cut in cuts if "/".join(parts[cut:]) in stems}
    several = [str(folder / name) for name in sorted(below)]
    if len(several) == 1:
        return f"they lie below {below.pop()}: give {several[0]} as the folder of predictions"
    if several:
        return f"each of {_listed(several, 'and')} holds some: give one of them as the folder of predictions"
    above = Path(os.path.abspath(folder))  # noqa: PTH100 # as it was called, links are not followed
    for levels in range(1, min(_FOLDERS_ABOVE, len(above.parts) - 1) + 1):
        prefix = "/".join(above.parts[-levels:])
        if any(f"{prefix}/{stem_of(name)}" in stems for name in names):
            return f"this is {prefix} of the layout: give {above.parents[levels - 1]} as the folder of predictions"
    return None


def _nearest(names: Sequence[str], expected: Expected, *, ambiguous: bool = True) -> str | None:
    """Return an example: a file, and what its name would have to be, or else, if wanted, what it could be."""
    words = {place: _words(stem_of(place)) for place in (*expected.references, *expected.places)}
    beginnings = {place: _beginning(place) for place in words}
    unclear = None
    for name in names[:_MOST_EXAMINED]:
        its = _words(stem_of(name) if _extension(name) else name)
        alike = {place: _likeness(words[place], its) for place in words if beginnings[place].issubset(its)}
        most = max(alike.values(), default=None)
        best = [place for place, likeness in alike.items() if likeness == most]
        meant = [place for place in best if place not in expected.references]
        if best and not meant:
            return (
                f"{name} has the name of a reference; predictions have that of their noisy frame, such as "
                f"{_target(expected.references[best[0]], name)}"
            )
        if len(meant) == 1:
            return f"{name} would be {_target(meant[0], name)}"
        if meant and ambiguous and unclear is None:
            several = _listed([_target(place, name) for place in meant], "or")
            unclear = f"{name} could be {several}: its name does not tell which"
    return unclear


def _words(text: str) -> tuple[str, ...]:
    """Return words and numbers, without case and leading zeros: ``scene-1/IMG_0004`` as scene, 1, img, 4."""
    return tuple(word.lstrip("0") or "0" for word in _WORD.findall(text.casefold())[-_MOST_WORDS:])


def _beginning(place: str) -> frozenset[str]:
    """Return the words of a frame's name up to the first number, which its prediction's name has too."""
    words = _words(stem_of(place).rpartition("/")[2])
    first = next((index for index, word in enumerate(words) if word.isdecimal()), len(words))
    return frozenset(words[: first + 1])


def _likeness(one: Sequence[str], other: Sequence[str]) -> tuple[int, int]:
    """Count the words that two names share, and those of them in the same order."""
    in_order = sum(block.size for block in SequenceMatcher(None, one, other, autojunk=False).get_matching_blocks())
    return (Counter(one) & Counter(other)).total(), in_order


# --- in words ---------------------------------------------------------------------------------------------------------


def _target(place: str, name: str = "") -> str:
    """Return the place of a prediction, with the file's own extension if predictions may have it."""
    return stem_of(place) + (Path(name).suffix if is_read(name) else EXTENSIONS[0])


def _extension(name: str) -> str:
    suffix = Path(name).suffix.lower()
    return suffix if _EXTENSION.fullmatch(suffix) else ""


def _counted(names: Sequence[str]) -> str:
    """Return the numbers of files by extension, such as ``12 .npy files and 1 .json file``."""
    counts = Counter(map(_extension, names)).most_common()
    texts = [
        counted(count, f"{end} file") if end else f"{counted(count, 'file')} without an extension"
        for end, count in counts
    ]
    return _listed(texts, "and")


def _listed(texts: Sequence[str], word: str) -> str:
    """Return the first of some texts in a sentence, such as ``a, b and 3 others``."""
    if len(texts) > _MOST_NAMED + 1:
        texts = [*texts[:_MOST_NAMED], f"{len(texts) - _MOST_NAMED} others"]
    return f" {word} ".join(filter(None, (", ".join(texts[:-1]), texts[-1])))


# --- what lies in a folder --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FoundPredictions:
    """The files of a folder of predictions, matched with the frames to score.

    Attributes
    ----------
    files
        Prediction of each noisy frame, by its place.
    problems
        Noisy frames with several predictions or none, and files that are the prediction of no noisy frame.
    unscored
        Number of predictions of noisy frames that this evaluation does not score.
    elsewhere
        Numbers of predictions of other datasets, by their names.
    """

    files: dict[str, Path]
    problems: tuple[EvaluationProblem, ...]
    unscored: int
    elsewhere: dict[str, int] = field(default_factory=dict)


def find_predictions(
    folder: Path,
    places: Iterable[str],
    known: Iterable[str] = (),
    *,
    elsewhere: Mapping[str, Collection[str]] = MappingProxyType({}),
    allow_missing: bool = False,
    because: str = "",
) -> FoundPredictions:
    """Match the files of a folder with where predictions may lie, but for their extension.

    Parameters
    ----------
    folder
        The folder of predictions.
    places
        Where those that are to be scored may lie, relative to it: the paths of noisy frames, whose extension does not
        matter.
    known
        The same of all noisy frames of the manifest.
    elsewhere
        The same of other datasets, by their names.
    allow_missing
        Whether noisy frames may lack a prediction.
    because
        Why a prediction is wanted that somebody may not expect to be, in words that go on a sentence.

    Raises
    ------
    EldataError
        If the folder is not there.
    """
    by_stem: dict[str, list[str]] = {}
    unread: dict[str, str] = {}
    for name in _files(folder):
        if is_read(name):
            by_stem.setdefault(stem_of(name), []).append(name)
        else:
            unread.setdefault(stem_of(name), name)
    files: dict[str, Path] = {}
    problems, missing = [], []
    place_of_stem: dict[str, str] = {}
    for place in places:
        stem = stem_of(place)
        names = by_stem.pop(stem, [])
        if place_of_stem.setdefault(stem, place) != place:
            reason = f"its prediction would lie where that of {place_of_stem[stem]} does; give the frames other names"
            problems.append(EvaluationProblem(place, reason))
        elif len(names) == 1:
            files[place] = folder / names[0]
        elif names:
            reason = f"expected one prediction, found {len(names)}: {', '.join(names[:_MOST_SHOWN])}; keep one"
            problems.append(EvaluationProblem(place, reason))
        elif not allow_missing:
            there = add = ""
            if stem in unread:
                there, add = f", only a {Path(unread[stem]).suffix} file, which is not read", f" as {READ}"
            reason = f"has no prediction{there}{because}; add it{add}, or score the rest with --allow-missing"
            missing.append(EvaluationProblem(place, reason))

    def count_others(paths: Iterable[str]) -> int:
        return sum(len(by_stem.pop(stem, ())) for stem in set(map(stem_of, paths)))

    unscored = count_others(known)
    counts = {name: count for name, paths in elsewhere.items() if (count := count_others(paths))}
    problems += _strangers(
        folder, [name for names in by_stem.values() for name in names], [one.path for one in missing]
    )
    return FoundPredictions(files, (*problems, *missing), unscored, counts)


def misplaced(folder: Path, expected: Expected, known: Iterable[str]) -> EvaluationProblem | None:
    """Return the one problem of a folder in which nothing lies where a prediction may, or ``None``.

    Parameters
    ----------
    folder
        The folder of predictions.
    expected
        What is to be scored, and what may be there in its stead.
    known
        The paths of all noisy frames of the manifest.

    Raises
    ------
    EldataError
        If the folder is not there.
    """
    names = _files(folder)
    stems = {stem_of(path) for path in (*expected.places, *known)}
    if not expected.places or any(is_read(name) and stem_of(name) in stems for name in names):
        return None
    return EvaluationProblem(str(folder), layout_in_words(folder, names, expected))


def dataset_itself(folder: Path, dataset: Path, paths: Sequence[str]) -> EvaluationProblem | None:
    """Return the one problem of a folder that is the dataset's, the one above it, or a camera's or scene's in it.

    Predictions beside raw files of other kinds than predictions have are let through.

    Parameters
    ----------
    folder
        The folder of predictions.
    dataset
        The dataset's.
    paths
        Those of the manifest.
    """
    place, own = folder.resolve(), dataset.resolve()
    above = place == own.parent
    if not folder.is_dir() or not (above or place.is_relative_to(own)):
        return None
    parts = {parent.as_posix() for path in paths for parent in PurePosixPath(path).parents}
    if not above and place.relative_to(own).as_posix() not in parts:
        return None
    # Beside raw files that are not read as predictions, and beside the dataset's folder, there may be some.
    may_be = any((place / part).is_dir() for part in parts - {"."}) if above else any(map(is_read, _files(folder)))
    if may_be and not any(map(is_read, paths)):
        return None
    what = "holds" if above else "is" if place == own else "is a part of"
    return EvaluationProblem(
        str(folder),
        f"{what} the dataset itself, {dataset}; give a folder of predictions alone, such as eldata predict, eldata "
        "baseline or code of yours writes, or --baseline input to score the noisy frames as they are",
    )


def _files(folder: Path) -> list[str]:
    """Return the files of a folder of predictions, relative to it, sorted.

    Hidden files and folders, and linked folders, are left out; a folder that is named like a prediction is there.
    """
    problem = folder_problem(folder)
    if problem is not None:
        raise EldataError(f"{folder}: {problem}; give the one that holds the predictions, a file for each noisy frame")
    files = (path.relative_to(folder) for path in visible_below(folder) if is_read(path.name) or not path.is_dir())
    return sorted(map(Path.as_posix, files))


def _strangers(folder: Path, names: list[str], missing: list[str]) -> list[EvaluationProblem]:
    """Name the predictions of no noisy frame; of very many only the first."""
    nearest = nearest_in_words(names, missing)
    hint = "" if nearest is None else f": {nearest}"
    reason = f"is the prediction of no noisy frame in the manifest; rename it or move it away{hint}"
    problems = [EvaluationProblem(name, reason) for name in names[:_MOST_EXTRA]]
    if len(names) > _MOST_EXTRA:
        more = f"{len(names) - _MOST_EXTRA} more files are predictions of no noisy frame; is it the right folder?"
        problems.append(EvaluationProblem(str(folder), more))
    return problems
