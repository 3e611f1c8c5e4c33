"""One file against its row: a camera raw, a mosaic that its card states, a packed array, a PNG frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from eldata.base.arrays import NpyError, read_npy_header, read_png_header, read_rgb16
from eldata.base.files import file_problem, inside, sha256_of
from eldata.base.workers import require_files
from eldata.errors import FileError, RawFileError, UnusableRawError
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.manifest.patterns import is_png
from eldata.manifest.table import number_text
from eldata.manifest.verify_report import COPY_AGAIN, Level, Problem, row_fault
from eldata.raw.stated import StatedFile

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path

    from eldata.manifest.card import CameraCard
    from eldata.manifest.catalogue import FrameFiles
    from eldata.raw.levels import MeanLevels
    from eldata.records import FrameRecord, RawHeader, Sensor

_NO_EXIF = "the file has lost its EXIF: copy the original"
# With a problem in one of these fields the whole file is wrong: its bytes are not checked further.
_OF_CONTENT = ("content", "width", "height")


class CheckedFile(NamedTuple):
    """Problems of a file, its ISO times its exposure time where it states both, remarks on it, its levels."""

    problems: list[Problem]
    product: Fraction | None = None
    remarks: tuple[str, ...] = ()
    levels_dn: MeanLevels | None = None


def check_file(files: FrameFiles, cameras: Mapping[str, CameraCard], level: Level, record: FrameRecord) -> CheckedFile:
    """Check one file of a set whose cameras these are."""
    file, path = files.at(record.path), inside(files.folder, record.path)
    require_files(path)
    full, unhashed = level == "full", level == "full" and record.sha256 is None
    if isinstance(file, StatedFile):
        checked = _check_stated(file, record, decode=full)  # no hash is of what the card states
    elif path.suffix == ".npy" and not (record.reference or ".npy").endswith(".npy"):  # synthetic, of a raw
        checked = CheckedFile(_check_packed(path, record))
    elif is_png(record.path):
        checked = CheckedFile(_check_png(path, record, decode=unhashed))
    else:
        checked = _check_raw(path, record, cameras[record.camera].models, decode=unhashed)
    if full and record.sha256 is not None and not any(problem.field in _OF_CONTENT for problem in checked.problems):
        checked.problems.extend(_check_hash(path, record.path, record.sha256))
    return checked


def _check_raw(path: Path, record: FrameRecord, models: Sequence[str], *, decode: bool) -> CheckedFile:
    """Check a raw file's header and, if it is decoded, its pixels and size."""
    from eldata.raw.reading import raw_facts

    try:
        header, decoded = raw_facts(path, decode=decode)
    except RawFileError as error:
        return CheckedFile([_describe_unreadable(record, error)])
    problems, product = _check_header(header, record, models)
    return CheckedFile([*problems, *_check_decoded(record, decoded)], product, header.remarks, header.levels_dn)


def _check_stated(file: StatedFile, record: FrameRecord, *, decode: bool) -> CheckedFile:
    """Check a mosaic without levels of its own; of its exposure no more is known than its row states."""
    product = None if record.iso is None or record.exposure_s is None else record.iso * record.exposure_s
    try:
        file.check()
        frame = file.read() if decode else None
    except RawFileError as error:
        return CheckedFile([_describe_unreadable(record, error, "a mosaic as its card states it")])
    problems = _check_decoded(record, None if frame is None else frame.sensor)
    return CheckedFile(problems, product, () if frame is None else frame.remarks, file.header.levels_dn)


def _check_packed(path: Path, record: FrameRecord) -> list[Problem]:
    """Check a packed array (a synthetic noisy frame): it has no EXIF to compare, but a header that says its shape."""
    found = file_problem(path)
    try:
        if found is None:
            with path.open("rb") as file:
                header = read_npy_header(file)
                held = path.stat().st_size - file.tell()
            if len(header.shape) == 3 and header.values == "float32" and held == header.value_bytes:
                return []
            found = f"{header.values} {header.shape} of {header.value_bytes} bytes, and {held} are there"
    except (OSError, NpyError) as error:
        found = str(error)
    return [row_fault(record.path, "content", "packed float32 (C, h, w)", found, "copy or make it again")]


def _check_png(path: Path, record: FrameRecord, *, decode: bool) -> list[Problem]:
    """Check that a PNG frame is whole, 16-bit RGB, of its row's size; decoding it compares every checksum."""
    try:
        header = read_png_header(path)
        if (header.bit_depth, header.colour) != (16, "RGB"):
            advice = "this file was converted: take the original"
            return [row_fault(record.path, "content", "a 16-bit RGB PNG", str(header), advice)]
        height, width = header.shape[:2]
        problems = _check_size(record, width, height, "this file is of another clip or was scaled")
        if decode and not problems:
            read_rgb16(path)
    except FileError as error:
        return [row_fault(record.path, "content", "a whole PNG file that decodes", error.reason, COPY_AGAIN)]
    return problems


def _describe_unreadable(record: FrameRecord, error: RawFileError, expected: str = "a whole raw file") -> Problem:
    """Make the problem of a raw file that is damaged or cannot be used."""
    if isinstance(error, UnusableRawError):
        return row_fault(record.path, "content", "a raw file that can be used", error.found, error.advice)
    return row_fault(record.path, "content", expected, error.reason.removesuffix(f"; {COPY_AGAIN}"), COPY_AGAIN)


def _check_header(
    header: RawHeader, record: FrameRecord, models: Sequence[str]
) -> tuple[list[Problem], Fraction | None]:
    """Compare a raw file's camera, ISO and exposure time with its row; return their product too, if it states both."""
    problems = []
    # A card lists "" for files whose camera does not name itself, and no model where no public text says.
    if models and header.model.casefold() not in {model.casefold() for model in models}:
        advice = "this file was taken by another camera" if header.model else _NO_EXIF
        found = header.model or "no camera model"
        problems.append(row_fault(record.path, "camera", " or ".join(models), found, advice))
    iso, exposure_s = header.exposure.iso, header.exposure.exposure_s
    if iso is None or exposure_s is None:
        lost = "ISO" if iso is None else "exposure time"
        return [*problems, row_fault(record.path, "exposure", "ISO and exposure time", f"no {lost}", _NO_EXIF)], None
    advice = "is this the frame that its name says? look for shifted numbering and swapped files"
    problems += [
        row_fault(record.path, field, number_text(expected), number_text(value), advice)
        for field, expected, value in (("iso", record.iso, iso), ("exposure_s", record.exposure_s, exposure_s))
        if expected is not None and abs(value - expected) > RATIO_TOLERANCE * expected
    ]
    return problems, iso * exposure_s


def _check_decoded(record: FrameRecord, decoded: Sensor | RawFileError | None) -> list[Problem]:
    """Check what decoding gave: an error, or a sensor of the row's size; ``None`` if nothing was decoded."""
    if isinstance(decoded, RawFileError):
        return [_describe_unreadable(record, decoded, "a raw file that decodes")]
    advice = "this file was taken in another mode or by another camera"
    return [] if decoded is None else _check_size(record, decoded.width, decoded.height, advice)


def _check_size(record: FrameRecord, width: int, height: int, advice: str) -> list[Problem]:
    """Compare a file's size in pixels with its row's, if that has one."""
    return [
        row_fault(record.path, field, str(expected), str(value), advice)
        for field, expected, value in (("width", record.width, width), ("height", record.height, height))
        if expected is not None and expected != value
    ]


def _check_hash(path: Path, place: str, expected: str) -> list[Problem]:
    """Compare a file's ``sha256:<hex>`` with the expected one."""
    try:
        digest = sha256_of(path)
    except OSError as error:
        digest = f"unreadable: {error.strerror}"
    advice = f"the file is damaged or another: {COPY_AGAIN}"
    return [] if digest == expected else [row_fault(place, "sha256", expected, digest, advice)]
