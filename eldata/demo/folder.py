"""The folder that a demo writes into: its own, and nobody else's."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from eldata.base.files import write_text
from eldata.errors import EldataError

if TYPE_CHECKING:
    from pathlib import Path

_MARKER = ".eldata-demo"
_MADE = ("data", "manifests", "predictions")


def prepare_folder(folder: Path) -> None:
    """Make the folder, or empty it of what an earlier demo, finished or not, has left.

    Raises
    ------
    EldataError
        If it holds something that no demo made, or cannot be written.
    """
    marker = folder / _MARKER
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not marker.is_file())):
        raise EldataError(f"{folder}: holds something else; give a new folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(marker, "Made by eldata demo, which may empty this folder's data, manifests and predictions.\n")
        for name in _MADE:
            if (folder / name).is_dir():
                shutil.rmtree(folder / name)
    except OSError as error:
        raise EldataError(f"{error.filename or folder}: {error.strerror}") from error
