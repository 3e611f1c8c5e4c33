"""The camera's raw files, with what EXIF says of them, in the order in which they were taken."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from math import log2
from pathlib import Path
from typing import TYPE_CHECKING

from capture.camera import STOPS_TOLERANCE
from capture.capture_errors import CaptureError
from eldata.base.files import sha256_of, visible_below
from eldata.base.numbers import natural
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.errors import RawFileError
from eldata.manifest.table import number_text
from eldata.raw.files import ShotFacts, find_doubles, is_raw

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from datetime import datetime

    from eldata.records import FrameRecord as Original


@dataclass(frozen=True, slots=True)
class ObservedFrame:
    """A raw file that can be matched: ``taken`` and ``f_number`` are ``None`` if EXIF does not state them."""

    path: Path
    iso: Fraction
    exposure_s: Fraction
    taken: datetime | None
    model: str
    f_number: Fraction | None = None

    @property
    def settings(self) -> str:
        """ISO and exposure time, to read."""
        return f"ISO {number_text(self.iso)}, {format_exposure(self.exposure_s)}"


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
        Whether all files say when they were taken; if not, their names order them.
    copies
        Files that show the shot of another one, and what that is: they are not among the frames.
    """

    frames: tuple[ObservedFrame, ...]
    unusable: tuple[RawFileError, ...]
    by_time: bool
    copies: tuple[tuple[Path, str], ...] = ()

    def without_copies(self, of: Iterable[Original], workers: Workers = IN_THIS_PROCESS) -> Observed:
        """Leave out the frames that are byte for byte one of these files."""
        originals: dict[object, dict[str | None, str]] = {}
        for row in of:
            originals.setdefault((row.iso, row.exposure_s, row.size_bytes), {})[row.sha256] = row.path
        # A file is hashed only if one with its settings and its size is known.
        sizes = {frame.path: (frame.iso, frame.exposure_s, frame.path.stat().st_size) for frame in self.frames}
        alike = [path for path, settings in sizes.items() if settings in originals]
        hashes = zip(alike, workers.run(sha256_of, alike, label="looking for copies"), strict=True)
        copies = {path: known[digest] for path, digest in hashes if digest in (known := originals[sizes[path]])}
        frames = tuple(frame for frame in self.frames if frame.path not in copies)
        return replace(self, frames=frames, copies=(*self.copies, *copies.items()))


def format_exposure(seconds: Fraction) -> str:
    """Return an exposure time to read: ``1/200 s``, ``0.5 s``, ``4 s``."""
    if seconds.numerator == 1 and seconds.denominator > 2:
        return f"1/{seconds.denominator} s"
    return f"{number_text(seconds) if seconds >= Fraction(1, 4) else f'1/{float(1 / seconds):.4g}'} s"


def format_f_number(f_number: Fraction) -> str:
    """Return an f-number to read: ``f/5.6``."""
    return f"f/{float(f_number):.4g}"


def same_aperture(one: Fraction, other: Fraction) -> bool:
    """Check that two f-numbers are one setting: names are rounded (f/22 is f/22.6), steps are a third of a stop."""
    return abs(2 * log2(one / other)) <= STOPS_TOLERANCE


def find_raw_files(given: Iterable[Path | str], extension: str, outside: Path | None = None) -> tuple[Path, ...]:
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
    CaptureError
        If a name is neither a file nor a folder, or none of the files is raw.
    """
    files: dict[Path, Path] = {}
    for name in map(Path, given):
        if not name.exists():
            raise CaptureError(f"{name}: no such file or folder")
        paths = [name] if is_raw(name) else []
        if name.is_dir():
            suffix = extension.lower()
            paths = [path for path in visible_below(name) if path.suffix.lower() == suffix and path.is_file()]
        for path in paths:
            resolved = path.resolve()
            if outside is None or not resolved.is_relative_to(outside.resolve()):
                files.setdefault(resolved, path)
    if not files:
        raise CaptureError(f"no raw file ({extension}) was given; give the camera's files, or their folder")
    return tuple(files.values())


def observe(paths: Sequence[Path], models: Sequence[str], workers: Workers = IN_THIS_PROCESS) -> Observed:
    """Read what EXIF says of each file, and put the files into the order in which they were taken.

    DateTimeOriginal orders them, with its fraction of a second; frames of the same second without a fraction are in the
    order of their names. If a file has no time, all are ordered by folder and name, as cameras number
    them. Of files that show one shot, such as copies
    on a backup card, one counts (:func:`eldata.raw.files.find_doubles`).

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
    for frame in workers.run(_observe, paths, label="reading EXIF"):
        if isinstance(frame, RawFileError):
            unusable.append(frame)
        elif frame.model.casefold() not in known:
            reason = (
                f"was taken by {frame.model or 'a camera that it does not name'}; the plan's is {' or '.join(models)}"
            )
            unusable.append(RawFileError(frame.path, reason))
        else:
            frames.append(frame)
    facts = {frame.path: ShotFacts(frame.model, frame.iso, frame.exposure_s, frame.taken) for frame in frames}
    doubles = find_doubles(facts, workers, across=True)
    frames = [frame for frame in frames if frame.path not in doubles]
    by_time = all(frame.taken is not None for frame in frames)
    frames.sort(key=lambda frame: (frame.taken if by_time else None, natural(str(frame.path))))
    copies = tuple((path, str(other)) for path, other in doubles.items())
    return Observed(tuple(frames), tuple(unusable), by_time, copies)


def _observe(path: Path) -> ObservedFrame | RawFileError:
    """Read the EXIF of a file; return the problem if it is damaged, or states no ISO or exposure time."""
    from eldata.raw.reading import read_header

    try:
        header = read_header(path)
    except RawFileError as error:
        return error
    iso, exposure_s = header.exposure.iso, header.exposure.exposure_s
    if iso is None or exposure_s is None:
        return RawFileError(path, f"states no {'ISO' if iso is None else 'exposure time'}: copy the original file")
    return ObservedFrame(path, iso, exposure_s, header.taken, header.model, header.exposure.f_number)
