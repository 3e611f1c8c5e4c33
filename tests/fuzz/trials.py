"""Trial ``n`` of a kind: which good file, and what was done to it; the same for the same seed, in every process."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from random import Random
from typing import TYPE_CHECKING, Any

from tests.fuzz import bytewise
from tests.fuzz.seeds import Seed
from tests.fuzz.targets import KINDS, changes_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_LARGEST = 4 << 20  # changes may double a file, again and again
# Places that are no regular file, which a reader must not wait for or read without end.
PLACES = ("fifo", "zeros", "itself", "folder", "nowhere", "empty")
_PLACE_SHARE = 0.002
_HOLE_SHARE = 0.1


@dataclass(frozen=True)
class Trial:
    """One changed file.

    Attributes
    ----------
    seed
        The good file.
    content
        The changed bytes; empty where the file is a place.
    changes
        What was done, in words.
    place
        What lies there instead of a file, one of :data:`PLACES`, or nothing.
    detectable
        Whether the pixels hold a page of zeros that can be told from an image.
    """

    seed: Seed
    content: bytes
    changes: tuple[str, ...]
    place: str = ""
    detectable: bool = False


def trial(kind: str, seeds: Sequence[Seed], seed: int, number: int) -> Trial:
    """Return trial ``number`` of a kind."""
    random = Random(f"{kind} {seed} {number}")  # noqa: S311 # not for secrets
    if kind == "drill":
        return Trial(seeds[number % len(seeds)], seeds[number % len(seeds)].content, ())
    chosen, other = random.choice(seeds), random.choice(seeds)
    if random.random() < _PLACE_SHARE and chosen.reader not in KINDS[kind].nameless:
        place = random.choice(PLACES)
        return Trial(chosen, b"", (place,), place)
    if chosen.pixels is not None and random.random() < _HOLE_SHARE:
        start, stop = chosen.pixels
        if stop - start > bytewise.PAGE:
            change = random.choice((bytewise.hole, bytewise.tail))
            content = change(chosen.content, random, start, stop)
            return Trial(chosen, content, (change.__name__,), detectable=True)
    changes = changes_of(KINDS[kind], chosen.name)
    content, done = chosen.content, []
    for _ in range(random.choice((1, 1, 1, 1, 2, 2, 3, 6))):
        one = random.choice(changes)
        if 0 < len(content) < _LARGEST:
            content = one(content, random, other.content)
            done.append(f"{one.__module__.rpartition('.')[2]}.{one.__name__}")
    return Trial(chosen, content, tuple(done))


def put(made: Trial, path: Path) -> None:
    """Lay a trial's file down."""
    if made.place == "fifo":
        os.mkfifo(path)
    elif made.place == "zeros":
        path.symlink_to("/dev/zero")
    elif made.place == "itself":
        path.symlink_to(path.name)
    elif made.place == "folder":
        path.mkdir()
    elif made.place != "nowhere":
        path.write_bytes(made.content)


# --- seeds for the child processes ------------------------------------------------------------------------------------


def save_seeds(folder: Path, seeds: Sequence[Seed]) -> None:
    """Write the good files of a kind once, for every child process."""
    folder.mkdir(parents=True)
    index: list[dict[str, Any]] = []
    for number, seed in enumerate(seeds):
        (folder / str(number)).write_bytes(seed.content)
        index.append(asdict(seed) | {"content": str(number)})
    (folder / "index.json").write_text(json.dumps(index), encoding="utf-8")


def load_seeds(folder: Path) -> list[Seed]:
    """Read what :func:`save_seeds` wrote."""
    index = json.loads((folder / "index.json").read_text(encoding="utf-8"))
    return [
        Seed(
            entry["name"],
            entry["reader"],
            (folder / entry["content"]).read_bytes(),
            None if entry["pixels"] is None else (entry["pixels"][0], entry["pixels"][1]),
        )
        for entry in index
    ]
