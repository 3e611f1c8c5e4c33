"""The camera's raw files, with what EXIF says of them, in the order in which they were taken."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from capture.capture_errors import MappingError
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.errors import RawFileError
from eldata.manifest.table import number_text
from eldata.raw.extensions import RAW_EXTENSIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from datetime import datetime

_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True, slots=True)
class ObservedFrame:
    """A raw file that can be matched: ``taken`` is ``None`` if EXIF does not say when."""

    path: Path
    iso: Fraction
    exposure_s: Fraction
    taken: datetime | None
    model: str

    @property
    def settings(self) -> str:
        """ISO and exposure time, to read."""
        return f"ISO {number_text(self.iso)}, {exposure_text(self.exposure_s)}"


@dataclass(frozen=True, slots=True)
class Observed:
    """All files that were given.

    Attributes
    ----------
    frames
        In the order in which they were taken.
    unusable
        Why files cannot be matched: damaged, without ISO or exposure time, of another camera.
    by_time
        Whether the order is that of EXIF; if not, it is that of the names.
    """

    frames: tuple[ObservedFrame, ...]
    unusable: tuple[RawFileError, ...]
    by_time: bool


def exposure_text(seconds: Fraction) -> str:
    """Return an exposure time to read: ``1/200 s``, ``0.5 s``, ``4 s``."""
    if seconds.numerator == 1 and seconds.denominator > 2:
        return f"1/{seconds.denominator} s"
    return f"{number_text(seconds) if seconds >= Fraction(1, 4) else f'1/{float(1 / seconds):.4g}'} s"


def raw_files(given: Iterable[Path | str], extension: str, outside: Path | None = None) -> tuple[Path, ...]:
    """Return the raw files of an extension among files and folders, each once; folders are searched.

    Parameters
    ----------
    given
        Files and folders. In folders, hidden files are ignored.
    extension
        The camera's, with the dot; upper and lower case are the same. A file given by name may have any raw
        extension, so that a wrong one is noticed.
    outside
        A folder whose files are not taken: where copies go.

    Raises
    ------
    MappingError
        If a name is neither a file nor a folder, or none of the files is raw.
    """
    found: dict[Path, Path] = {}
    away = None if outside is None else outside.resolve()
    for name in map(Path, given):
        if name.is_dir():
            paths = [
                path
                for path in sorted(name.rglob("*"))
                if path.suffix.lower() == extension.lower()
                and path.is_file()
                and not any(part.startswith(".") for part in path.relative_to(name).parts)
            ]
        elif name.is_file():
            paths = [name] if name.suffix.lower() in RAW_EXTENSIONS else []
        else:
            raise MappingError(f"{name}: no such file or folder")
        for path in paths:
            resolved = path.resolve()
            if away is None or not resolved.is_relative_to(away):
                found.setdefault(resolved, path)
    if not found:
        raise MappingError(
            f"no raw file ({extension}) was given; give the camera's files, or the folder that holds them"
        )
    return tuple(found.values())


def observe(paths: Sequence[Path], models: Sequence[str], workers: Workers = IN_THIS_PROCESS) -> Observed:
    """Read what EXIF says of each file, and put the files into the order in which they were taken.

    The order is that of DateTimeOriginal with its fraction of a second; frames of the same second that have no fraction
    are in the order of their names. If a file has no time, all are ordered by folder and name, as cameras number
    them.

    Parameters
    ----------
    paths
        Raw files.
    models
        The camera's names in EXIF: files of another camera are unusable.
    workers
        The workers that read the files.
    """
    frames: list[ObservedFrame] = []
    unusable: list[RawFileError] = []
    known = {model.casefold() for model in models}
    for found in workers.run(_observe, paths, label="reading EXIF"):
        if isinstance(found, RawFileError):
            unusable.append(found)
        elif found.model.casefold() not in known:
            reason = (
                f"was taken by {found.model or 'a camera that it does not name'}; the plan's is {' or '.join(models)}"
            )
            unusable.append(RawFileError(found.path, reason))
        else:
            frames.append(found)
    by_time = all(frame.taken is not None for frame in frames)
    frames.sort(key=lambda frame: (frame.taken if by_time else None, _natural(frame.path)))
    return Observed(tuple(frames), tuple(unusable), by_time)


def _observe(path: Path) -> ObservedFrame | RawFileError:
    try:
        return observe_one(path)
    except RawFileError as error:
        return error


def observe_one(path: Path) -> ObservedFrame:
    """Read what EXIF says of a file.

    Raises
    ------
    RawFileError
        If it is damaged, or states no ISO or exposure time.
    """
    from eldata.raw.reading import read_header

    header = read_header(path)
    iso, exposure_s = header.exposure.iso, header.exposure.exposure_s
    if iso is None or exposure_s is None:
        raise RawFileError(path, f"states no {'ISO' if iso is None else 'exposure time'}: copy the original file")
    return ObservedFrame(path, iso, exposure_s, header.taken, header.model)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Order by folder and name with numbers as numbers: ``DSC9.ARW`` before ``DSC10.ARW``."""
    return [(int(part.isdecimal()), int(part) if part.isdecimal() else 0, part) for part in _DIGITS.split(str(path))]
