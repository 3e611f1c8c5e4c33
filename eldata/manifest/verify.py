"""Are the files on the disk what the manifest says? Finds and lists every problem; never writes.

Levels, each with those before it:

quick
    Every listed file is there, of the recorded size and not empty; no unlisted raw file lies beside them.
metadata
    Every file opens as a raw file and is not truncated; camera model, ISO and exposure time are the manifest's, and
    the exposure ratio of each noisy frame to its reference is within a tenth of the nominal one. What should be known
    of files that are well is remarked on, each thing once.
full
    Every recorded hash matches. Files without one are decoded instead and searched for damage that shows
    (:mod:`eldata.raw.damage`), which finds less.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from eldata.base.files import file_problem, inside, sha256_of, visible_below
from eldata.base.workers import AnyWorkers, Failed, Workers, require_files
from eldata.errors import ArgumentError, ManifestError, RawFileError, UnusableRawError, did_you_mean
from eldata.manifest.catalogue import FrameFiles, Manifest, find_manifests
from eldata.manifest.clip_checks import (
    exposure_findings,
    png_decode_findings,
    png_findings,
    png_size_findings,
    size_findings,
)
from eldata.manifest.pair_checks import RATIO_TOLERANCE, ratio_findings, white_remarks
from eldata.manifest.patterns import expand, find_elsewhere, is_png, pattern_findings
from eldata.manifest.table import number_text
from eldata.manifest.verify_report import LEVELS, DatasetReport, VerifyReport, distinct, row_fault
from eldata.raw.files import RAW_EXTENSIONS
from eldata.raw.stated import StatedFile

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from fractions import Fraction

    from eldata.manifest.card import CameraCard
    from eldata.manifest.verify_report import FileRemark, Level, Problem
    from eldata.raw.levels import MeanLevels
    from eldata.records import FrameRecord, RawHeader, Sensor

_AGAIN = "copy or download it again"
_PACK_AGAIN = "copy or make it again"
_NO_EXIF = "the file has lost its EXIF: copy the original"


def verify(
    manifests: Path | str | Iterable[Manifest],
    root: Path | str | None = None,
    *,
    cameras: Collection[str] | None = None,
    level: Level = "quick",
    workers: AnyWorkers = 1,
) -> VerifyReport:
    """Check the files below ``root`` against manifests.

    Parameters
    ----------
    manifests
        A manifest's CSV file, a folder of them, a known set's name (its manifest is then as ``eldata lock NAME`` has
        filled it in, if it has), or loaded manifests. Sets that are not there are named as absent; one
        at least must be.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    cameras
        Check just these cameras' files, if you have only part of a dataset.
    level
        See the module's text.
    workers
        Number of worker processes, or an executor that looks into the files (:mod:`eldata.base.workers`).

    Raises
    ------
    ManifestError
        If a manifest is malformed, or none has such a camera.

    Examples
    --------
    >>> from eldata import verify
    >>> report = verify("eldata-demo/manifests", "eldata-demo/data", level="metadata")
    >>> len(report.problems)
    0
    """
    workers = Workers.of(workers)
    if level not in LEVELS:
        raise ArgumentError(f"level must be one of {', '.join(LEVELS)}; found {level!r}")
    chosen = list(find_manifests(manifests, root) if isinstance(manifests, (str, Path)) else manifests)
    known = sorted({camera for manifest in chosen for camera in manifest.card.cameras})
    for camera in cameras or ():
        if camera not in known:
            hint = did_you_mean(camera, known)
            raise ManifestError(f"no manifest has a camera called {camera!r}; known are {', '.join(known)}{hint}")
    if cameras:
        chosen = [manifest for manifest in chosen if set(cameras) & set(manifest.card.cameras)]
    reports = [_verify_dataset(manifest, manifest.folder(root), cameras, level, workers) for manifest in chosen]
    return VerifyReport(level, tuple(reports))


def _verify_dataset(
    manifest: Manifest,
    folder: Path,
    cameras: Collection[str] | None,
    level: Level,
    workers: Workers,
) -> DatasetReport:
    records = [record for record in manifest.records if not cameras or record.camera in cameras]
    # Two datasets may share a folder and have one each in it (SID/Sony, SID/Fuji): a copy of one may lack the other.
    tops = {record.path.partition("/")[0] for record in manifest.records}
    needed = folder / tops.pop() if len(tops) == 1 else folder
    if not needed.is_dir():
        return DatasetReport(manifest.name, needed, True, manifest.card.homepage, len(records), 0, 0, ())
    found, present, remarks, levels_dn = check_files(manifest, folder, records, level=level, workers=workers)
    if level != "quick":
        files = FrameFiles.of(folder.absolute(), manifest.card, present)
        remarks += white_remarks(present, levels_dn, files, workers)
    listed = expand(records, folder)
    hashed = sum(record.sha256 is not None for record in present) if level == "full" else 0
    counts = len(listed), len(present), hashed
    return DatasetReport(manifest.name, folder, False, manifest.card.homepage, *counts, found, remarks)


def check_files(
    manifest: Manifest,
    folder: Path,
    records: Sequence[FrameRecord],
    *,
    level: Level,
    workers: Workers,
) -> tuple[tuple[Problem, ...], tuple[FrameRecord, ...], tuple[FileRemark, ...], dict[str, MeanLevels | None]]:
    """Check some of a manifest's files; return the problems, the records of files that are there, remarks, levels.

    The problems are in the order of paths. Levels are known of some files, and of none at level ``quick``.
    """
    listed = expand(records, folder)
    present, findings = _check_presence(manifest, folder, listed)
    findings += _check_unlisted(manifest, folder, listed)
    of_clips = pattern_findings(records, folder)
    remarks: tuple[FileRemark, ...] = ()
    levels_dn: dict[str, MeanLevels | None] = {}
    if level != "quick":
        files = FrameFiles.of(folder.absolute(), manifest.card, present)
        work = partial(check_file, files, manifest.card.cameras, level)
        outcomes = [
            _unchecked(outcome) if isinstance(outcome, Failed) else outcome
            for outcome in workers.attempt(work, present, label=f"{manifest.name} ({level})")
        ]
        findings += [finding for outcome in outcomes for finding in outcome.findings]
        product_of = {record.path: one.product for record, one in zip(present, outcomes, strict=True)}
        remarks = distinct((record.path, one.remarks) for record, one in zip(present, outcomes, strict=True))
        levels_dn = {record.path: one.levels_dn for record, one in zip(present, outcomes, strict=True)}
        findings += ratio_findings(present, product_of)
        of_clips += png_size_findings(folder, present)
        of_clips += exposure_findings(present, product_of, RATIO_TOLERANCE)
    findings = sorted([*findings, *of_clips], key=lambda finding: finding.path)
    return tuple(finding.of(manifest.name) for finding in findings), tuple(present), remarks, levels_dn


# --- quick ----------------------------------------------------------------------------------------------------


def _check_presence(
    manifest: Manifest, folder: Path, records: Sequence[FrameRecord]
) -> tuple[list[FrameRecord], list[Problem]]:
    """Return the records whose files can be looked into, and what is wrong with the rest."""
    present: list[FrameRecord] = []
    findings: list[Problem] = []
    missing: dict[str, list[FrameRecord]] = defaultdict(list)
    for record in records:
        try:
            path = inside(folder, record.path)
            size = path.stat().st_size if path.is_file() else None
        except ManifestError as error:
            expected = "a file below the dataset's folder"
            findings.append(row_fault(record.path, "path", expected, "a link outside", str(error)))
            continue
        if size is None:
            # One line for a whole missing folder, the topmost one that is missing.
            parents = (*reversed(Path(record.path).parents), Path(record.path))
            top = next((part.as_posix() for part in parents if not (folder / part).exists()), record.path)
            missing[top].append(record)
            continue
        if size == 0 or size != (record.size_bytes or size):
            expected = "more than 0 bytes" if record.size_bytes is None else f"{record.size_bytes} bytes"
            findings.append(row_fault(record.path, "size_bytes", expected, f"{size} bytes", _AGAIN))
        if size > 0:
            present.append(record)
    elsewhere = find_elsewhere(folder, (lost[0].path for top, lost in missing.items() if top != lost[0].path))
    findings += [_missing(manifest, folder, top, lost, elsewhere) for top, lost in missing.items()]
    return present, findings


def _missing(
    manifest: Manifest, folder: Path, top: str, lost: list[FrameRecord], elsewhere: Mapping[str, str]
) -> Problem:
    path = folder / top
    if top == lost[0].path:
        like = [
            other.name
            for other in visible_below(path.parent, deep=False)
            if other.name.casefold() == path.name.casefold()
        ]
        found, advice = "nothing", _AGAIN
        if path.is_dir():
            found, advice = "a folder", "move it away and copy the file"
        elif like:
            found, advice = f"only {like[0]}", f"rename it to {path.name}"
        return row_fault(top, "file", "a file", found, advice)
    other = elsewhere.get(lost[0].path)
    if other is not None:
        found, advice = f"{lost[0].path} in another place, {other}", "move it, and the others, to where they are listed"
        return row_fault(f"{top}/", "folder", f"{len(lost)} files", found, advice)
    advice = "unpack it there"
    if len(manifest.card.cameras) > 1 and len({record.camera for record in lost}) == 1:
        advice += f", or check the cameras you have with --camera (this is {lost[0].camera})"
    return row_fault(f"{top}/", "folder", f"{len(lost)} files", "no such folder", advice)


def _check_unlisted(manifest: Manifest, folder: Path, records: Sequence[FrameRecord]) -> list[Problem]:
    """Name files of the listed kind that the manifest does not list, in the folders of these records.

    Another form of a listed shot, such as the DNG made of a raw file, is no sign of other frames.
    """
    every = expand(manifest.records, folder)
    listed = {record.path for record in every}
    # There may be other pictures of the scene beside references (DRV), but not beside noisy PNG frames.
    pictured = {
        Path(record.path).parent.as_posix() for record in every if record.role == "noisy" and is_png(record.path)
    }
    raw = {Path(path).parent.as_posix() for path in listed if Path(path).suffix.lower() in RAW_EXTENSIONS}
    shots, spelled = {_shot(path) for path in listed}, {path.casefold(): path for path in listed}
    findings = []
    count_in = Counter(Path(path).parent.as_posix() for path in listed)
    for parent in sorted({Path(record.path).parent.as_posix() for record in records}):
        kinds = (RAW_EXTENSIONS if parent in raw else frozenset()) | ({".png"} if parent in pictured else frozenset())
        files = visible_below(folder / parent, deep=False)
        raws = [path.relative_to(folder).as_posix() for path in files if path.suffix.lower() in kinds]
        for path in raws:
            like = spelled.get(path.casefold())  # if that is missing, so it is reported, with what to do
            if path != like and (_shot(path) not in shots if like is None else (folder / like).exists()):
                expected = f"the {count_in[parent]} listed raw files in this folder"
                advice = "move it away, and make sure that the others were not renumbered"
                findings.append(row_fault(path, "file", expected, f"{len(raws)} raw files, this one unlisted", advice))
    return findings


def _shot(path: str) -> str:
    return Path(path).with_suffix("").as_posix().casefold()


# --- metadata and full ----------------------------------------------------------------------------------------


class CheckedFile(NamedTuple):
    """What is wrong with a file, its ISO times its exposure time, if it states both, remarks on it, its levels."""

    findings: list[Problem]
    product: Fraction | None = None
    remarks: tuple[str, ...] = ()
    levels_dn: MeanLevels | None = None


# With a finding in one of these fields the whole file is wrong: its bytes are not checked further.
_OF_CONTENT = ("content", "width", "height")


def _unchecked(failed: Failed[FrameRecord]) -> CheckedFile:
    advice = "make it readable where the check runs, and check again"
    return CheckedFile([row_fault(failed.unit.path, "check", "a finished check", failed.reason, advice)])


def check_file(files: FrameFiles, cameras: Mapping[str, CameraCard], level: Level, record: FrameRecord) -> CheckedFile:
    """Look into one file of a set whose cameras these are."""
    folder, file = files.folder, files.at(record.path)
    path = folder / record.path
    require_files(path)
    if isinstance(file, StatedFile):
        outcome = _stated_findings(file, record, decode=level == "full")  # no hash is of what the card states
    elif path.suffix == ".npy":
        outcome = CheckedFile(_packed_findings(path, record))
    elif is_png(record.path):
        outcome = CheckedFile(png_findings(folder, record))
    else:
        decode = level == "full" and record.sha256 is None
        outcome = _raw_findings(path, record, cameras[record.camera].models, decode=decode)
    findings = outcome.findings
    if level == "full" and not any(finding.field in _OF_CONTENT for finding in findings):
        if record.sha256 is not None:
            findings += _hash_findings(path, record)
        elif is_png(record.path):
            findings += png_decode_findings(folder, record)
    return outcome


def _unreadable(record: FrameRecord, error: RawFileError, expected: str = "a whole raw file") -> Problem:
    if isinstance(error, UnusableRawError):
        return row_fault(record.path, "content", "a raw file that can be used", error.found, error.advice)
    return row_fault(record.path, "content", expected, error.reason.removesuffix(f"; {_AGAIN}"), _AGAIN)


def _decoded_findings(record: FrameRecord, decoded: Sensor | RawFileError | None) -> list[Problem]:
    if isinstance(decoded, RawFileError):
        return [_unreadable(record, decoded, "a raw file that decodes")]
    if decoded is None:
        return []
    advice = "this file was taken in another mode or by another camera"
    return size_findings(record, decoded.width, decoded.height, advice)


def _raw_findings(path: Path, record: FrameRecord, models: Sequence[str], *, decode: bool) -> CheckedFile:
    """Compare a raw file with its row and, if its hash is not known, decode it."""
    from eldata.raw.reading import raw_facts

    try:
        header, decoded = raw_facts(path, decode=decode)
    except RawFileError as error:
        return CheckedFile([_unreadable(record, error)])
    findings, product = header_findings(header, record, models)
    return CheckedFile([*findings, *_decoded_findings(record, decoded)], product, header.remarks, header.levels_dn)


def _stated_findings(file: StatedFile, record: FrameRecord, *, decode: bool) -> CheckedFile:
    """Look into a mosaic without levels of its own; of its exposure no more is known than its row states."""
    iso, exposure_s = record.iso, record.exposure_s
    product = None if iso is None or exposure_s is None else iso * exposure_s
    try:
        file.check()
        frame = file.read() if decode else None
    except RawFileError as error:
        return CheckedFile([_unreadable(record, error, "a mosaic as its card states it")])
    findings = _decoded_findings(record, None if frame is None else frame.sensor)
    return CheckedFile(findings, product, () if frame is None else frame.remarks, file.header.levels_dn)


def header_findings(
    header: RawHeader, record: FrameRecord, models: Sequence[str]
) -> tuple[list[Problem], Fraction | None]:
    """Compare a raw file's camera, ISO and exposure time with its row; return their product too, if it states both."""
    findings = []
    if not models:
        pass  # no public text says how the camera names itself
    elif not header.model and "" not in models:  # which a card lists for files whose camera does not name itself
        findings.append(row_fault(record.path, "camera", " or ".join(models), "no camera model", _NO_EXIF))
    elif header.model.casefold() not in {model.casefold() for model in models}:
        advice = "this file was taken by another camera"
        findings.append(row_fault(record.path, "camera", " or ".join(models), header.model, advice))
    iso, exposure_s = header.exposure.iso, header.exposure.exposure_s
    if iso is None or exposure_s is None:
        lost = "ISO" if iso is None else "exposure time"
        return [*findings, row_fault(record.path, "exposure", "ISO and exposure time", f"no {lost}", _NO_EXIF)], None
    advice = "is this the frame that its name says? look for shifted numbering and swapped files"
    findings += [
        row_fault(record.path, field, number_text(expected), number_text(found), advice)
        for field, expected, found in (("iso", record.iso, iso), ("exposure_s", record.exposure_s, exposure_s))
        if expected is not None and abs(found - expected) > RATIO_TOLERANCE * expected
    ]
    return findings, iso * exposure_s


def _hash_findings(path: Path, record: FrameRecord) -> list[Problem]:
    try:
        digest = sha256_of(path)
    except OSError as error:
        digest = f"unreadable: {error.strerror}"
    if digest == record.sha256:
        return []
    advice = _PACK_AGAIN if path.suffix == ".npy" else f"the file is damaged or another: {_AGAIN}"
    return [row_fault(record.path, "sha256", record.sha256 or "", digest, advice)]


def _packed_findings(path: Path, record: FrameRecord) -> list[Problem]:
    """Check a packed array (a synthetic noisy frame): it has no EXIF to compare, but a header that says its shape."""
    from eldata.base.arrays import NpyError, read_npy_header

    problem = file_problem(path)
    if problem is not None:
        return [row_fault(record.path, "content", "packed float32 (C, h, w)", problem, _PACK_AGAIN)]
    try:
        with path.open("rb") as file:
            header = read_npy_header(file)
            held = path.stat().st_size - file.tell()
        found = f"{header.values} {header.shape}"
        good = len(header.shape) == 3 and header.values == "float32"
        if good and held != header.value_bytes:
            found, good = f"{found} of {header.value_bytes} bytes, and {held} are there", False
    except (OSError, NpyError) as error:
        found, good = str(error), False
    return [] if good else [row_fault(record.path, "content", "packed float32 (C, h, w)", found, _PACK_AGAIN)]
