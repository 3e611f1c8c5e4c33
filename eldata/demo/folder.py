"""The folder that a demo writes into, its own and nobody else's, and the card of what it makes there."""

from __future__ import annotations

import shutil
from collections import Counter
from typing import TYPE_CHECKING

from eldata.base.files import remove_leftovers, write_text
from eldata.errors import EldataError
from eldata.manifest.card import CameraCard, Card

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from eldata.records import FrameRecord, Sensor

_MARKER = ".eldata-demo"
_MADE = ("data", "manifests", "profiles", "predictions")


def demo_card(
    name: str,
    title: str,
    folder: str,
    sensors: Mapping[str, Sensor],
    records: Iterable[FrameRecord],
    source: str,
) -> Card:
    """Return the card of simulated files, taken by cameras with these sensors."""
    return Card(
        name=name,
        title=title,
        version="1.0",
        folder=folder,
        citation="none: made by eldata demo",
        licence="CC0-1.0",
        homepage="made by eldata demo",
        cfa="bayer" if all(len(sensor.cfa) == 2 for sensor in sensors.values()) else "xtrans",
        cameras={camera: CameraCard((sensor.model,)) for camera, sensor in sensors.items()},
        counts=dict(sorted(Counter(str(record.role) for record in records).items())),
        protocol="eld",
        sources=(source,),
    )


def prepare_folder(folder: Path) -> None:
    """Make the folder, or empty it of what an earlier demo, finished or not, has left.

    Raises
    ------
    EldataError
        If it holds something that no demo made, or cannot be written.
    """
    marker = folder / _MARKER
    if folder.is_dir():
        remove_leftovers(folder)  # of a demo that was killed before it had marked the folder
    if folder.exists() and (not folder.is_dir() or (any(folder.iterdir()) and not marker.is_file())):
        raise EldataError(f"{folder}: holds something else; give a new folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(marker, "Made by eldata demo, which may empty its folders {}.\n".format(", ".join(_MADE)))
        for name in _MADE:
            if (folder / name).is_dir():
                shutil.rmtree(folder / name)
    except OSError as error:
        raise EldataError(f"{error.filename or folder}: {error.strerror}") from error
