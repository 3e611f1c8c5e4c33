"""The camera's raw files, with what EXIF says of them, in the order in which they were taken."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from math import log2
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from capture.capture_errors import MappingError
from capture.shutter import STOPS_TOLERANCE
from eldata.base.files import sha256_of, visible_below
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.errors import RawFileError
from eldata.manifest.table import number_text
from eldata.raw.files import ShotFacts, find_doubles, is_raw

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from datetime import datetime

    from eldata.records import FrameRecord as Original

Order = Literal["clock", "numbers"]
"""What tells the order in which files were taken: the camera's clock in EXIF, or the numbers in their names."""
ORDERS: tuple[Order, ...] = get_args(Order)

_DIGITS = re.compile(r"(\d+)")
_NUMBERED = re.compile(r"(.*?)(\d{1,12})", re.ASCII)
_DCF_DIGITS = 4


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
        Whether all files say when they were taken: if not, the order is that of the names.
    copies
        Files that show the shot of another one, and what that is: they are not among the frames.
    order
        ``"numbers"``: the order is that of :meth:`numbered`, and the clock is not believed.
    """

    frames: tuple[ObservedFrame, ...]
    unusable: tuple[RawFileError, ...]
    by_time: bool
    copies: tuple[tuple[Path, str], ...] = ()
    order: Order = "clock"

    def without_copies(self, of: Iterable[Original], workers: Workers = IN_THIS_PROCESS) -> Observed:
        """Return what is left without the frames that are byte for byte one of these files."""
        originals: dict[tuple[Fraction | None, Fraction | None, int | None], dict[str | None, str]] = {}
        for one in of:
            originals.setdefault((one.iso, one.exposure_s, one.size_bytes), {})[one.sha256] = one.path
        # A file is hashed only if one with its settings and its size is known.
        alike = [frame for frame in self.frames if _settings_and_size(frame) in originals]
        hashes = workers.run(sha256_of, [frame.path for frame in alike], label="looking for copies")
        found = [
            (frame.path, originals[_settings_and_size(frame)][digest])
            for frame, digest in zip(alike, hashes, strict=True)
            if digest in originals[_settings_and_size(frame)]
        ]
        gone = {path for path, _ in found}
        frames = tuple(frame for frame in self.frames if frame.path not in gone)
        return replace(self, frames=frames, copies=(*self.copies, *found))

    @property
    def numbered(self) -> Observed | None:
        """The same files in the order of the camera's counter, which may have turned over.

        ``None`` if they are not numbered alike (``DSC`` and as many digits each), or a number occurs twice.
        """
        found = [_NUMBERED.fullmatch(frame.path.stem) for frame in self.frames]
        if not found or not all(found) or len({(one[1], len(one[2])) for one in found if one}) > 1:
            return None
        numbers = [int(one[2]) for one in found if one]
        if len(set(numbers)) < len(numbers):
            return None
        # A counter of the DCF standard has four digits, also where a fifth stands before them: Sony's DSC09999 is
        # followed by DSC00001. One that counts on beyond them changes what stands before.
        digits = len(found[0][2]) if found[0] else 0
        if len({number // 10**_DCF_DIGITS for number in numbers}) == 1:
            digits = min(digits, _DCF_DIGITS)
        # It began after the widest gap, counted around its end: 9998, 9999, 1, 2.
        ordered, turn = sorted(numbers), 10**digits
        gaps = [after - before for before, after in pairwise([ordered[-1] - turn, *ordered])]
        start = ordered[gaps.index(max(gaps))]
        by_number = sorted(zip(numbers, self.frames, strict=True), key=lambda one: (one[0] - start) % turn)
        return replace(self, frames=tuple(frame for _, frame in by_number), order="numbers")


def _settings_and_size(frame: ObservedFrame) -> tuple[Fraction, Fraction, int]:
    return frame.iso, frame.exposure_s, frame.path.stat().st_size


def exposure_text(seconds: Fraction) -> str:
    """Return an exposure time to read: ``1/200 s``, ``0.5 s``, ``4 s``."""
    if seconds.numerator == 1 and seconds.denominator > 2:
        return f"1/{seconds.denominator} s"
    return f"{number_text(seconds) if seconds >= Fraction(1, 4) else f'1/{float(1 / seconds):.4g}'} s"


def f_text(f_number: Fraction) -> str:
    """Return an f-number to read: ``f/5.6``."""
    return f"f/{float(f_number):.4g}"


def same_aperture(one: Fraction, other: Fraction) -> bool:
    """Return whether two f-numbers are one setting: names are rounded (f/22 is f/22.6), steps are a third of a stop."""
    return abs(2 * log2(one / other)) <= STOPS_TOLERANCE


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
            suffix = extension.lower()
            paths = [path for path in visible_below(name) if path.suffix.lower() == suffix and path.is_file()]
        elif name.is_file():
            paths = [name] if is_raw(name) else []
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
    them, or within one folder by the counter, which may have turned over. Of files that show one shot, such as copies
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
    facts = {frame.path: ShotFacts(frame.model, frame.iso, frame.exposure_s, frame.taken) for frame in frames}
    doubles = find_doubles(facts, workers, across=True)
    frames = [frame for frame in frames if frame.path not in doubles]
    by_time = all(frame.taken is not None for frame in frames)
    frames.sort(key=lambda frame: (frame.taken if by_time else None, _natural(frame.path)))
    copies = tuple((path, str(other)) for path, other in doubles.items())
    observed = Observed(tuple(frames), tuple(unusable), by_time, copies)
    if not by_time and len({frame.path.parent for frame in frames}) == 1 and observed.numbered is not None:
        return replace(observed, frames=observed.numbered.frames)  # the counter may have turned over in this folder
    return observed


def _observe(path: Path) -> ObservedFrame | RawFileError:
    """Return what EXIF says of a file; or what is wrong with it: damaged, or without ISO or exposure time."""
    from eldata.raw.reading import read_header

    try:
        header = read_header(path)
    except RawFileError as error:
        return error
    iso, exposure_s = header.exposure.iso, header.exposure.exposure_s
    if iso is None or exposure_s is None:
        return RawFileError(path, f"states no {'ISO' if iso is None else 'exposure time'}: copy the original file")
    return ObservedFrame(path, iso, exposure_s, header.taken, header.model, header.exposure.f_number)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Order by folder and name with numbers as numbers: ``DSC9.ARW`` before ``DSC10.ARW``."""
    return [(int(part.isdecimal()), int(part) if part.isdecimal() else 0, part) for part in _DIGITS.split(str(path))]
