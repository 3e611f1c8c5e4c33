"""File extensions of camera raws, without importing a decoder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.errors import DatasetError

if TYPE_CHECKING:
    from pathlib import Path

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


def raws_below(folder: Path) -> list[Path]:
    """Return the camera raws of a folder at any depth, sorted.

    Raises
    ------
    DatasetError
        If there is none.
    """
    found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in RAW_EXTENSIONS)
    if not found:
        raise DatasetError(f"{folder}: holds no camera raw file")
    return found
