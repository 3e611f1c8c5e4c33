"""File extensions of camera raws, without importing a decoder."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import folder_problem
from eldata.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Iterable

# Lower case, with the dot.
RAW_EXTENSIONS = frozenset(
    (
        *(
            ".3fr",
            ".arw",
            ".cr2",
            ".cr3",
            ".crw",
            ".dcr",
            ".dng",
            ".erf",
            ".gpr",
            ".iiq",
            ".k25",
            ".kdc",
            ".mef",
            ".mos",
        ),
        *(".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
    )
)

# Rendered pictures that cameras and phones write in place of a raw file, or beside it.
PICTURES = frozenset((".jpg", ".jpeg", ".heic", ".heif", ".hif", ".webp", ".avif"))


def raws_below(folder: Path) -> list[Path]:
    """Return the camera raws of a folder at any depth, sorted.

    Raises
    ------
    DatasetError
        If there is none, or no such folder.
    """
    paths = list(folder.rglob("*")) if folder.is_dir() else []
    found = sorted(path for path in paths if path.suffix.lower() in RAW_EXTENSIONS)
    if not found:
        raise no_raws(folder, (path.name for path in paths if path.is_file()))
    return found


def no_raws(folder: Path, names: Iterable[str]) -> DatasetError:
    """Return the error that a folder is not there, or has files of these names, none of them a camera raw."""
    problem = folder_problem(folder)
    if problem is not None:
        return DatasetError(f"{folder}: {problem}; give a folder of camera raws")
    found = Counter(Path(name).suffix.lower() for name in names if not name.startswith("."))
    (suffix, count), *_ = found.most_common(1) or [("", 0)]
    if suffix in PICTURES:
        counted = f"but {count} picture{'s' if count > 1 else ''} ({suffix})"
        return DatasetError(
            f"{folder}: holds no camera raw file, {counted}, which the camera or a phone has rendered and which are no "
            "longer linear: use the raw files that it writes beside them (DNG, ARW, CR3, NEF and the like)"
        )
    others = f", but {count} {suffix or 'without extension'}" if count else ", and nothing else"
    return DatasetError(f"{folder}: holds no camera raw file{others}")
