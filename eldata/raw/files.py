"""Raw files by their names, and whether one decodes and is whole, without its pixels.

Light: numpy and the decoder are loaded only where a file is looked into.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from eldata.base.files import folder_problem, sha256_of, visible_below
from eldata.base.workers import AnyWorkers, Workers
from eldata.errors import DatasetError
from eldata.raw.stated import ARRAY_EXTENSIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from datetime import datetime
    from fractions import Fraction


# Lower case, with the dot.
RAW_EXTENSIONS = frozenset((
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".gpr", ".iiq", ".k25", ".kdc", ".mef", ".mos",
    ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
))  # fmt: skip

# Rendered pictures that cameras and phones write instead of a raw file, or with it.
PICTURES = frozenset((".jpg", ".jpeg", ".png", ".heic", ".heif", ".hif", ".webp", ".avif"))


def raws_below(folder: Path) -> list[Path]:
    """List the camera raws of a folder at any depth, sorted; hidden files are passed over.

    Raises
    ------
    DatasetError
        If there is none, or no such folder.
    """
    paths = visible_below(folder)
    raws = [path for path in paths if is_raw(path)]
    if not raws:
        raise no_raws(folder, (path.name for path in paths if path.is_file()))
    return raws


def is_raw(path: Path | str) -> bool:
    """Whether a file's extension is a camera raw's."""
    return Path(path).suffix.lower() in RAW_EXTENSIONS


_COPY = re.compile(r"[ _-]*(copy[ _-]*)?(\(\d+\))?$", re.IGNORECASE)  # what browsers and file managers add


class ShotFacts(NamedTuple):
    """What a raw file states of its shot; ``None``: it does not."""

    model: str
    iso: Fraction | None
    exposure_s: Fraction | None
    taken: datetime | None


def find_doubles(files: Mapping[Path, ShotFacts], workers: AnyWorkers, *, across: bool) -> dict[Path, Path]:
    """Find files that repeat a shot, and for each the file that counts.

    Of copies, equal byte for byte, the one of the shortest name counts: ``IMG_1.dng`` of ``IMG_1 (1).dng`` beside it,
    or if ``across``, of files of any name and folder. Of files in one folder whose names differ in capitals and
    extension alone, and that state the same shot to the second, the camera's own counts, not the DNG made of it. Of
    several, the first.
    """
    bare = {path: None if across else (path.parent, _COPY.sub("", path.stem).casefold()) for path in files}
    alike: dict[object, list[Path]] = defaultdict(list)
    for path, facts in files.items():
        alike[facts, path.stat().st_size, bare[path]].append(path)
    paths = [path for group in alike.values() if len(group) > 1 for path in group]
    paths.sort(key=lambda path: len(path.name))
    digests = Workers.of(workers).run(sha256_of, paths, label="looking for copies")
    first: dict[object, Path] = {}
    doubles: dict[Path, Path] = {}
    for path, digest in zip(paths, digests, strict=True):
        if first.setdefault((digest, bare[path]), path) != path:
            doubles[path] = first[digest, bare[path]]
    single = [(path, facts) for path, facts in files.items() if path not in doubles]
    for path, facts in sorted(single, key=lambda file: file[0].suffix.lower() == ".dng"):
        second = facts.taken and facts.taken.replace(microsecond=0)
        shot = path.parent, path.stem.casefold(), facts._replace(taken=second)
        if first.setdefault(shot, path) != path:
            doubles[path] = first[shot]
    return doubles


def no_raws(folder: Path, names: Iterable[str]) -> DatasetError:
    """Make the error that a folder is not there, or has files of these names, none of them a camera raw."""
    problem = folder_problem(folder)
    if problem is not None:
        return DatasetError(f"{folder}: {problem}; give a folder of camera raws")
    suffixes = Counter(Path(name).suffix.lower() for name in names if not name.startswith("."))
    (suffix, count), *_ = suffixes.most_common(1) or [("", 0)]
    counted = f", but {count} {suffix or 'without extension'}" if count else ", and nothing else"
    if suffix in PICTURES:
        pictures = {name: n for name, n in suffixes.items() if name in PICTURES}
        count = sum(pictures.values())
        counted = (
            f", but {count} picture{'s' if count > 1 else ''} ({', '.join(pictures)}), rendered by the camera or a "
            "phone, so no longer linear: use the raw files (DNG, ARW, CR3, NEF and the like), or as clean frames "
            "arrays of your own inverse ISP (eldata.datasets.Arrays)"
        )
    return DatasetError(f"{folder}: holds no camera raw file{counted}{of_arrays(suffix)}")


def of_arrays(suffix: str) -> str:
    """Advise on arrays, by a file's extension; empty for other files."""
    if suffix.lower() not in ARRAY_EXTENSIONS:
        return ""
    return (
        "; arrays state no levels: give a manifest (.csv) of them, whose card states those in mosaics "
        "(docs/manifests.md)"
    )
