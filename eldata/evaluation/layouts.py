"""Folders of predictions: which files lie in one, and which noisy frame a file is meant for, by the words in its name.

Where nothing lies as expected, one message names the nearest layout.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from eldata.base.files import folder_problem, visible_below
from eldata.base.numbers import counted
from eldata.errors import EldataError
from eldata.evaluation.scores import EvaluationProblem

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

EXTENSIONS = (".npy", ".npz", ".h5", ".tif", ".tiff", ".png", ".dng")
"""The kinds of file that a prediction may be, by the ends of their names."""

_WORD = re.compile(r"[^\W\d_]+|\d+")
_EXTENSION = re.compile(r"\.[a-z][a-z0-9]{0,8}")  # not the end of 00001_00_0.1s
_MOST_EXAMINED = 20  # files whose names are compared with all noisy frames'
_MOST_WORDS = 40  # of a path, at its end
_MOST_NAMED = 3
_FOLDERS_ABOVE = 3
_MOST_SHOWN = 8  # predictions of one frame
READ = f"{', '.join(EXTENSIONS[:-1])} or {EXTENSIONS[-1]}"


def stem_of(path: str) -> str:
    """Return a path without its extension."""
    return Path(path).with_suffix("").as_posix()


def is_read(name: str) -> bool:
    """Tell whether predictions may have a file's extension."""
    return Path(name).suffix.lower() in EXTENSIONS


def describe_misplaced(
    folder: Path,
    names: Sequence[str],
    places: Collection[str],
    references: Mapping[str, str] = MappingProxyType({}),
    elsewhere: Mapping[str, int] = MappingProxyType({}),
) -> str:
    """Describe a folder in which no prediction lies where it is looked for, and the nearest layout.

    Parameters
    ----------
    folder
        The folder of predictions; those above it may be the right one.
    names
        The files in it, POSIX paths relative to it.
    places, references
        Paths of the noisy frames, and of the references, each with that of a noisy frame that it belongs to.
    elsewhere
        Numbers of predictions of other datasets, by their names.
    """
    rule = f"the prediction of {(place := next(iter(places)))} is {_target(place)}"
    if not names:
        return f"found no file, but for hidden ones and links to folders; expected one for each noisy frame: {rule}"
    wrong, likely = f"none of them where expected ({rule})", [name for name in names if is_read(name)]
    if not likely:
        likely = list(names)
        wrong = f"none of them read; expected {READ} ({rule}, and eldata.evaluation.save_prediction writes it)"
    others = [f"{count} of them of {name} (--dataset {name})" for name, count in elsewhere.items()]
    advice = f"it holds predictions of other data, {_listed(others, 'and')}" if others else None
    advice = advice or _other_folder(folder, likely, places) or _nearest(likely, places, references)
    return (
        f"found {counted(len(likely), 'file')}, {wrong}; {advice or 'is it the right folder, and the right dataset?'}"
    )


# --- the nearest layout -----------------------------------------------------------------------------------------------


def _other_folder(folder: Path, names: Sequence[str], places: Collection[str]) -> str | None:
    """Name the folder with the expected layout: one below, several below, or one above this."""
    stems = {stem_of(place) for place in places}
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


def _nearest(
    names: Sequence[str], places: Iterable[str], references: Mapping[str, str], *, ambiguous: bool = True
) -> str | None:
    """Return an example: a file, and what its name would have to be, or else, if wanted, what it could be."""
    words = {place: _words(stem_of(place)) for place in (*references, *places)}
    beginnings = {place: _beginning(place) for place in words}
    unclear = None
    for name in names[:_MOST_EXAMINED]:
        its = _words(stem_of(name) if _extension(name) else name)
        alike = {place: _likeness(words[place], its) for place in words if beginnings[place].issubset(its)}
        most = max(alike.values(), default=None)
        best = [place for place, likeness in alike.items() if likeness == most]
        meant = [place for place in best if place not in references]
        if best and not meant:
            return (
                f"{name} has the name of a reference; predictions have that of their noisy frame, such as "
                f"{_target(references[best[0]], name)}"
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
    places: Collection[str],
    known: Collection[str] = (),
    *,
    references: Mapping[str, str] = MappingProxyType({}),
    elsewhere: Callable[[], Mapping[str, Iterable[str]]] = dict,
    dataset: tuple[Path, Iterable[str]] | None = None,
    allow_missing: bool = False,
    because: str = "",
) -> FoundPredictions:
    """Match the files of a folder with where predictions may lie, but for their extension.

    Of a folder in which nothing lies where a prediction may, that is the one problem.

    Parameters
    ----------
    folder
        The folder of predictions.
    places, known
        Paths of the noisy frames to score, and of all in the manifest: where predictions may lie.
    references
        Paths of references, each with that of a noisy frame that it belongs to.
    elsewhere
        Returns the noisy frames' paths in other datasets, by their names; called if files are left over.
    dataset
        The dataset's folder and its files' paths there: these are no predictions.
    allow_missing
        Whether noisy frames may lack a prediction.
    because
        Why a prediction is wanted that somebody may not expect to be, in words that go on a sentence.

    Raises
    ------
    EldataError
        If the folder is not there.
    """
    names = _files(folder)
    if dataset is not None:
        raws = _raws_among(folder, names, *dataset)
        names = [name for name in names if name not in raws]
        if raws and not any(map(is_read, names)):
            return FoundPredictions({}, (EvaluationProblem(str(folder), OF_DATASET.format(dataset[0])),), 0)
    by_stem: dict[str, list[str]] = {}
    unread: dict[str, str] = {}
    for name in names:
        if is_read(name):
            by_stem.setdefault(stem_of(name), []).append(name)
        else:
            unread.setdefault(stem_of(name), name)
    is_elsewhere = by_stem.keys().isdisjoint(map(stem_of, (*places, *known)))
    files: dict[str, Path] = {}
    problems, missing = [], []
    place_of_stem: dict[str, str] = {}
    for place in places:
        stem = stem_of(place)
        alike = by_stem.pop(stem, [])
        if place_of_stem.setdefault(stem, place) != place:
            reason = f"its prediction would lie where that of {place_of_stem[stem]} does; give the frames other names"
            problems.append(EvaluationProblem(place, reason))
        elif len(alike) == 1:
            files[place] = folder / alike[0]
        elif alike:
            reason = f"expected one prediction, found {len(alike)}: {', '.join(alike[:_MOST_SHOWN])}; keep one"
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
    counts = {name: count for name, paths in elsewhere().items() if (count := count_others(paths))} if by_stem else {}
    if places and is_elsewhere:
        layout = describe_misplaced(folder, names, places, references, counts)
        return FoundPredictions({}, (EvaluationProblem(str(folder), layout),), 0)
    extra = [name for alike in by_stem.values() for name in alike]
    nearest = _nearest(extra, [problem.path for problem in missing], {}, ambiguous=False)
    reason = "is the prediction of no noisy frame in the manifest; rename it or move it away"
    reason += "" if nearest is None else f": {nearest}"
    problems += [EvaluationProblem(name, reason) for name in extra]
    return FoundPredictions(files, (*problems, *missing), unscored, counts)


OF_DATASET: Final = (
    "holds the dataset itself, {}; give a folder of predictions alone, such as eldata predict, eldata baseline or code "
    "of yours writes, or --baseline input to score the noisy frames as they are"
)


def _raws_among(folder: Path, names: Iterable[str], dataset: Path, paths: Iterable[str]) -> set[str]:
    """Return the names of the dataset's own files in a folder, which is the dataset's, one above it or one in it."""
    place, own = folder.resolve().as_posix(), dataset.resolve().as_posix()
    if not (f"{own}/".startswith(f"{place}/") or place.startswith(f"{own}/")):
        return set()
    raws = {f"{own}/{path}" for path in paths}
    return {name for name in names if f"{place}/{name}" in raws}


def _files(folder: Path) -> list[str]:
    """Return the files of a folder of predictions, relative to it, sorted.

    Hidden files and folders, and linked folders, are left out; a folder that is named like a prediction is there.
    """
    problem = folder_problem(folder)
    if problem is not None:
        raise EldataError(f"{folder}: {problem}; give the one that holds the predictions, a file for each noisy frame")
    files = (path.relative_to(folder) for path in visible_below(folder) if is_read(path.name) or not path.is_dir())
    return sorted(map(Path.as_posix, files))
