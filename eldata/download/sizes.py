"""Numbers of bytes: in words, as a progress bar, and compared with the room on a disk."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from eldata.errors import DownloadError

if TYPE_CHECKING:
    from pathlib import Path


def size_text(size_bytes: int) -> str:
    """Return a size in decimal units, as publishers and disks state it: ``25.1 GB``."""
    size = float(size_bytes)
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size_bytes} bytes" if unit == "bytes" else f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"


def progress_bar(name: str, total_bytes: int | None = None) -> tqdm[Any]:
    """Return a bar that counts bytes, seen only in a terminal."""
    return tqdm(desc=name, total=total_bytes, unit="B", unit_scale=True, unit_divisor=1000, disable=None, leave=False)


def check_room(folder: Path, missing_bytes: int, purpose: str) -> None:
    """Raise :class:`~eldata.errors.DownloadError` if this many bytes do not fit on the folder's disk."""
    free = shutil.disk_usage(folder).free
    if missing_bytes > free:
        raise DownloadError(
            f"{folder}: {size_text(missing_bytes)} are {purpose}, {size_text(free)} are free; make room, or choose "
            "another disk with --root"
        )
