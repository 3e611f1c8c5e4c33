"""Is this file the frame that was to be taken? Names of frames, and what EXIF and pixels say of them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any, Final

from capture.capture_errors import TetherError
from capture.matching import can_be
from capture.observed import observe_one
from eldata.errors import RawFileError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime
    from pathlib import Path

    from capture.camera import CameraDescription
    from capture.matching import Slot
    from capture.observed import ObservedFrame
    from capture.shots import Shot
    from capture.tether.levels import Levels

_LEAST_FREE_BYTES: Final = 200 << 20  # a raw of the largest sensors; gphoto2 does not notice a full disk


def frame_name(slot: Slot, camera: CameraDescription) -> str:
    """Return a frame's name: ``scene-1_0004.ARW``, ``calibration_0012.ARW``."""
    scene, number = slot
    return f"{scene}_{number:04d}{camera.raw_extension}"


def aside_path(folder: Path, slot: Slot, observed: ObservedFrame | None, suffix: str) -> Path:
    """Return a free name for a frame that is not the plan's: it says why, and is not a raw file's name.

    Such as ``scene-1_0004.wrong-ISO800-1_60s.1.ARW.aside``.
    """
    scene, number = slot
    why = "unusable" if observed is None else f"wrong-{observed.settings}"
    plain = why.replace(", ", "-").replace(" ", "").replace("/", "_")
    names = (folder / f"{scene}_{number:04d}.{plain}.{attempt}{suffix}.aside" for attempt in count(1))
    return next(path for path in names if not path.exists())


@dataclass(frozen=True, slots=True)
class Look:
    """What a file turned out to be.

    ``problem`` is ``None`` if it is the frame, ``observed`` and ``levels`` if it is unreadable.
    """

    path: Path
    observed: ObservedFrame | None
    problem: str | None
    levels: Levels | None = None

    @property
    def exif(self) -> dict[str, Any]:
        """What EXIF says, in plain types."""
        if self.observed is None:
            return {}
        taken = self.observed.taken
        return {
            "iso": str(self.observed.iso),
            "exposure_s": str(self.observed.exposure_s),
            "taken": None if taken is None else taken.isoformat(),
            "model": self.observed.model,
        }


def look(path: Path, shot: Shot, camera: CameraDescription) -> Look:
    """Decode a downloaded file, and compare its EXIF with a shot.

    Decoded, since gphoto2 ends well after a download that the disk had no room for, and not every format's header
    states how long the file should be.
    """
    from capture.tether.levels import levels_of
    from eldata.raw.reading import read_raw

    if path.suffix.lower() != camera.raw_extension.lower():
        sent = f"the camera sent a {path.suffix or 'nameless'} file, not {camera.raw_extension}"
        return Look(path, None, f"{sent}: set its image format to raw alone")
    try:
        levels = levels_of(read_raw(path))
        observed = observe_one(path)
    except RawFileError as error:
        return Look(path, None, f"the file that came cannot be used: {error.reason}")
    problem = None
    if observed.model.casefold() not in {model.casefold() for model in camera.models}:
        taker = observed.model or "a camera that it does not name"
        problem = f"the frame was taken by {taker}; the plan is for {' or '.join(camera.models)}"
    elif not can_be(shot, observed):
        wanted = shot.settings
        problem = f"the frame was taken at {observed.settings}, and the plan asks for {wanted}"
    return Look(path, observed, problem, levels)


def downloaded(folder: Path, shot: Shot, camera: CameraDescription) -> Look | None:
    """Return the best of the files that came into a folder; raw files before others."""
    if not folder.is_dir():
        return None
    paths = [path for path in sorted(folder.iterdir()) if path.name.startswith("frame.") and path.is_file()]
    paths.sort(key=lambda path: path.suffix.lower() != camera.raw_extension.lower())
    looks = [look(path, shot, camera) for path in paths]
    return min(looks, key=lambda one: one.problem is not None, default=None)


def check_free_space(folder: Path, sizes: Sequence[int]) -> None:
    """Refuse to release if the frame would not fit: gphoto2 would cut it short without a word.

    Raises
    ------
    TetherError
        If twice the largest of the frames' ``sizes``, in bytes, is not free.
    """
    needed = 2 * max(sizes) if sizes else _LEAST_FREE_BYTES
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise TetherError(
            f"{folder}: {free >> 20} MiB are free, and a frame may need {needed >> 20}; make room, then run "
            "the same command again"
        )


def taken_of(exif: dict[str, Any]) -> datetime | None:
    """Return when a journal's frame was taken, by the camera's clock."""
    from datetime import datetime

    text = exif.get("taken")
    return datetime.fromisoformat(text) if isinstance(text, str) else None
