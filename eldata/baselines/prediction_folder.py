"""The folder that predictions are written to: begun by one work, and refused to another; and how to tell them apart."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.fields import TextFile
from eldata.base.files import check_same_work, hold_lock, remove_leftovers, try_lock, visible_below, write_json
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.request import SETTINGS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray


@contextmanager
def begin_folder(folder: Path, settings: dict[str, Any]) -> Iterator[None]:
    """Make the folder, or check that it is the same work's, and hold it as long as the block runs.

    Several processes may do the same work in it, such as one for each camera: they share the lock of its settings'
    file, and who has other settings begins again only where nobody has it and there is no prediction. The folder
    itself is locked while that is decided, so that of two that begin at once one comes second. Where there are no
    locks (Windows, some network disks), nothing is begun again.

    Raises
    ------
    ArgumentError
        If the folder is another work's, or holds files of another origin.
    """
    file = folder / SETTINGS
    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(str(folder)):
        remove_leftovers(folder)  # of work that was killed, perhaps before it had said what it is
        if not file.exists():
            if visible_below(folder, deep=False):
                raise ArgumentError(
                    f"{folder}: holds files, and none is {SETTINGS}, so they are of another origin; give a new folder"
                )
            write_json(file, settings)
        elif _is_other_work(file, settings):
            # Without a prediction nothing is lost if the work starts over, as with a network that is corrected.
            write_json(file, settings)
        held = file.open("rb")
        try_lock(held.fileno(), shared=True)
    with held:
        yield


def _is_other_work(file: Path, settings: dict[str, Any]) -> bool:
    """Check whether other work, abandoned without a prediction, began the folder; refuse if it has predictions."""
    stated = dict(TextFile(file, EldataError, "remove the folder to start again").json().data)
    given = settings.get(ANSWERS)
    is_same = is_alike(stated.get(ANSWERS), given, settings.get("precision"))
    if is_same and stated | {ANSWERS: given} == settings | {ANSWERS: given}:
        return False
    with file.open("rb") as settled:
        if try_lock(settled.fileno()) and not any(file.parent.rglob("*.npy")):
            return True
    check_same_work(file.parent, stated | {ANSWERS: given}, dict.fromkeys(stated) | settings)
    raise ArgumentError(
        f"{file.parent}: was begun with a network of this name and these weights that gave something else for a fixed "
        "input: its code or a file that it reads has changed, or it gives something else at each call; give a new "
        "folder, or remove this one to start again"
    )


# --- what a network gives for a fixed input ---------------------------------------------------------------------------

ANSWERS = "answers"
"""In a folder's settings: what code, which no hash names, gives for a fixed input, by the input's channels."""
_EACH_TIME, _NOT_TAKEN = "another at each call", "cannot take it"
_NUMBERS = 8
_TOLERANCE = {"bfloat16": 1e-2, "float16": 1e-2}  # of the largest number; float32 differs by less between processors
_TOLERANCE_FLOAT32 = 1e-4


def probe_network(
    run: Callable[[NDArray[np.float32]], NDArray[Any]], shape: tuple[int, ...], precision: str
) -> list[float] | str:
    """Run a network on a fixed input; return weighted sums over its output.

    The input, of the ``shape`` (..., h, w), grows from 0 to 1 over its columns, and has noise that goes below 0.
    """
    generator = np.random.default_rng(0)
    noise = 0.05 * generator.standard_normal(shape)
    image = (np.linspace(0.0, 1.0, shape[-1]) ** 2 + noise).astype(np.float32)
    try:
        made = [np.asarray(run(image.copy()), np.float64).ravel() for _ in range(2)]
    except EldataError:  # a set of several sensors has channels that are not for it; else no frame will be predicted
        return _NOT_TAKEN
    if len({one.size for one in made}) > 1:
        return _EACH_TIME
    weights = generator.standard_normal((_NUMBERS, made[0].size)) / math.sqrt(made[0].size)
    first, second = ([float(value) for value in weights @ np.nan_to_num(one, posinf=0.0, neginf=0.0)] for one in made)
    return first if is_alike(first, second, precision) else _EACH_TIME


def is_alike(found: Any, expected: Any, precision: str | None) -> bool:
    """Check whether two answers, or all answers of two folders, come from one network."""
    if isinstance(found, dict) and isinstance(expected, dict):
        keys = found.keys() | expected.keys()
        return all(is_alike(found.get(key), expected.get(key), precision) for key in keys)
    if isinstance(found, list) and isinstance(expected, list) and len(found) == len(expected):
        limit = _TOLERANCE.get(precision or "", _TOLERANCE_FLOAT32) * max(map(abs, expected), default=0.0)
        return all(abs(one - other) <= limit for one, other in zip(found, expected, strict=True))
    return bool(found == expected != _EACH_TIME)


def describe_answers(answers: dict[str, list[float] | str]) -> tuple[str, ...]:
    """Describe a network's answers where readers of its scores should know."""
    kinds = set(map(str, answers.values()))
    if _EACH_TIME in kinds:
        return ("the network gives something else for the same input at each call: interrupted work cannot go on",)
    if kinds == {_NOT_TAKEN}:
        return ("the network cannot take a small fixed input, so a change of its code would not be noticed here",)
    return ()
