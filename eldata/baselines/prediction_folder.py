"""The folder that predictions are written to: begun by one work, and refused to another."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile
from eldata.base.files import can_lock, check_same_work, remove_leftovers, wait_for_lock, write_json
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.request import SETTINGS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def begun(folder: Path, settings: dict[str, Any]) -> Iterator[None]:
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
    with _alone_in(folder):
        remove_leftovers(folder)  # of work that was killed, perhaps before it had said what it is
        if not file.exists():
            if any(folder.iterdir()):
                raise ArgumentError(
                    f"{folder}: holds files, and none is {SETTINGS}, so they are of another origin; give a new folder"
                )
            write_json(file, settings)
        elif _is_other(file, settings):
            # Without a prediction nothing is lost if the work starts over, as with a network that is corrected.
            write_json(file, settings)
        held = file.open("rb")
        can_lock(held.fileno(), shared=True)
    with held:
        yield


def _is_other(file: Path, settings: dict[str, Any]) -> bool:
    """Return whether the folder was begun by other work that nobody does; raise if it has come to something."""
    stated = TextFile(file, EldataError, "remove the folder to start again").json().data
    if stated == settings:
        return False
    with file.open("rb") as settled:
        if can_lock(settled.fileno()) and not any(file.parent.rglob("*.npy")):
            return True
    check_same_work(file.parent, stated, settings)
    return False


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Wait until no other process decides here; at once where folders cannot be locked."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except PermissionError:  # Windows does not open folders
        yield
        return
    try:
        wait_for_lock(descriptor)
        yield
    finally:
        os.close(descriptor)
