"""Is what lies on the disk what the manifest says? Finds and lists every problem; never writes.

Levels, each with those before it:

quick
    Every listed file is there, of the recorded size and not empty; no unlisted raw file lies beside them.
metadata
    Every file opens as a raw file and is not truncated; camera model, ISO and exposure time are the manifest's, and
    the exposure ratio of each noisy frame to its reference is within a tenth of the nominal one.
full
    Every recorded hash matches. Files without one are decoded instead, which finds less.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from eldata.base.files import inside, sha256_of
from eldata.base.workers import AnyWorkers, Failed, Workers, accepts_jobs, require_files
from eldata.errors import ArgumentError, ManifestError, RawFileError
from eldata.manifest.catalogue import Manifest, find_manifests
from eldata.manifest.clip_checks import (
    exposure_findings,
    is_png,
    png_decode_findings,
    png_findings,
    png_size_findings,
)
from eldata.manifest.pairs import UNCERTAIN_ISO
from eldata.manifest.patterns import expand, pattern_findings
from eldata.manifest.table import number_text

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from eldata.manifest.patterns import Finding
    from eldata.records import FrameRecord

Level = Literal["quick", "metadata", "full"]
LEVELS: tuple[Level, ...] = get_args(Level)

# Shutters step by thirds of a stop (a factor of 1.26) and EXIF rounds them (1/13 for 1/12.5), so a true ratio may be
# some percent off the nominal one: 213 for 200 occurs in the published set. Shifted numbering and swapped references
# are off by a factor of two at least.
RATIO_TOLERANCE = Fraction(1, 10)


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong: where, what was expected, what was found, what to do."""

    dataset: str
    path: str
    field: str
    expected: str
    found: str
    advice: str

    def __str__(self) -> str:
        return f"{self.path}: {self.field}: expected {self.expected}, found {self.found}; {self.advice}"

    def format_text(self) -> str:
        """Return the problem as four lines."""
        return (
            f"{self.path}: {self.field}\n    expected  {self.expected}\n    found     {self.found}\n"
            f"    to do     {self.advice}"
        )


@dataclass(frozen=True, slots=True)
class DatasetReport:
    """What was found of one dataset. ``absent``: its folder is not there, and nothing was checked."""

    dataset: str
    folder: Path
    absent: bool
    homepage: str
    files_listed: int
    files_checked: int
    files_hashed: int
    problems: tuple[Problem, ...]


@dataclass(frozen=True, slots=True)
class VerifyReport:
    """The result of :func:`verify`."""

    level: Level
    datasets: tuple[DatasetReport, ...]

    @property
    def problems(self) -> tuple[Problem, ...]:
        """All problems of all datasets."""
        return tuple(problem for report in self.datasets for problem in report.problems)

    @property
    def ok(self) -> bool:
        """Whether something was verified and no problem was found."""
        return not self.problems and any(report.files_checked for report in self.datasets)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain JSON types."""
        datasets = [asdict(report) | {"folder": str(report.folder)} for report in self.datasets]
        return {"level": self.level, "ok": self.ok, "datasets": datasets}

    def format_text(self) -> str:
        """Return the report as text: each problem by file, then a line a dataset."""
        lines = [problem.format_text() for problem in self.problems]
        for dataset in self.datasets:
            if dataset.absent:
                lines.append(
                    f"{dataset.dataset}: absent (no folder {dataset.folder}); where to get it: {dataset.homepage}"
                )
                continue
            count = len(dataset.problems)
            verdict = "all well" if not count else f"{count} problem{'s' if count > 1 else ''}"
            lines.append(
                f"{dataset.dataset}: {dataset.files_checked} of {dataset.files_listed} files checked ({self.level}) in "
                f"{dataset.folder}: {verdict}"
            )
            if self.level == "full" and dataset.files_hashed < dataset.files_checked:
                lines.append(
                    f"    {dataset.files_checked - dataset.files_hashed} files have no recorded hash and were decoded "
                    "instead; eldata lock records hashes from a copy that you trust"
                )
        if all(dataset.absent for dataset in self.datasets):
            lines.append("nothing was verified; --root names the folder that holds the datasets")
        return "\n".join(lines)


@accepts_jobs
def verify(
    manifests: Path | str | Iterable[Manifest],
    root: Path | str | None = None,
    *,
    dataset: str | None = None,
    cameras: Collection[str] | None = None,
    level: Level = "quick",
    workers: AnyWorkers = 1,
) -> VerifyReport:
    """Check the files below ``root`` against manifests.

    Parameters
    ----------
    manifests
        A manifest's CSV file, a folder of them, or loaded manifests.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    dataset
        Name of the one dataset to check; it must then be there.
    cameras
        Check just these cameras' files, if you hold a part of a dataset.
    level
        See the module's text.
    workers
        Number of worker processes, or an executor that looks into the files (:mod:`eldata.base.workers`).

    Raises
    ------
    ManifestError
        If a manifest is malformed or has no such dataset or camera.
    """
    workers = Workers.of(workers)
    if level not in LEVELS:
        raise ArgumentError(f"level must be one of {', '.join(LEVELS)}; found {level!r}")
    chosen = list(find_manifests(manifests) if isinstance(manifests, (str, Path)) else manifests)
    if dataset is not None:
        names = [manifest.name for manifest in chosen]
        chosen = [manifest for manifest in chosen if manifest.name == dataset]
        if not chosen:
            raise ManifestError(f"no manifest of a dataset called {dataset!r}; found {', '.join(names)}")
    known = sorted({camera for manifest in chosen for camera in manifest.card.cameras})
    for camera in cameras or ():
        if camera not in known:
            raise ManifestError(f"no manifest has a camera called {camera!r}; known are {', '.join(known)}")
    if cameras:
        chosen = [manifest for manifest in chosen if set(cameras) & set(manifest.card.cameras)]
    reports = [
        _verify_dataset(manifest, manifest.folder(root), cameras, level, workers, required=dataset is not None)
        for manifest in chosen
    ]
    return VerifyReport(level, tuple(reports))


def _verify_dataset(
    manifest: Manifest,
    folder: Path,
    cameras: Collection[str] | None,
    level: Level,
    workers: Workers,
    *,
    required: bool,
) -> DatasetReport:
    records = [record for record in manifest.records if not cameras or record.camera in cameras]
    # Two datasets may share a folder and have one each in it (SID/Sony, SID/Fuji): who has one lacks the other whole.
    tops = {record.path.partition("/")[0] for record in manifest.records}
    needed = folder / tops.pop() if len(tops) == 1 and not required else folder
    if not needed.is_dir():
        problems = []
        if required:
            advice = f"see {manifest.card.homepage}, or name the folder above it with --root"
            problems.append(Problem(manifest.name, str(folder), "folder", "the dataset's files", "nothing", advice))
        return DatasetReport(manifest.name, needed, True, manifest.card.homepage, len(records), 0, 0, tuple(problems))
    found, present = check_files(manifest, folder, records, level=level, workers=workers)
    listed = expand(records, folder)
    hashed = sum(record.sha256 is not None for record in present) if level == "full" else 0
    return DatasetReport(manifest.name, folder, False, manifest.card.homepage, len(listed), len(present), hashed, found)


def check_files(
    manifest: Manifest,
    folder: Path,
    records: Sequence[FrameRecord],
    *,
    level: Level,
    workers: Workers,
) -> tuple[tuple[Problem, ...], tuple[FrameRecord, ...]]:
    """Check some of a manifest's files; return the problems, by path, and the records whose files are there."""
    listed = expand(records, folder)
    present, problems = _check_presence(manifest, folder, listed)
    problems += _check_unlisted(manifest, folder, listed)
    findings = pattern_findings(records, folder)
    if level != "quick":
        work = partial(_check_file, manifest.name, folder.absolute(), manifest.card.cameras, level)
        label = f"{manifest.name} ({level})"
        outcomes = [
            _unchecked(manifest.name, outcome) if isinstance(outcome, Failed) else outcome
            for outcome in workers.attempt(work, present, label=label)
        ]
        problems += [problem for outcome in outcomes for problem in outcome.problems]
        products = [outcome.exposure_product for outcome in outcomes]
        problems += _check_ratios(manifest.name, present, products)
        product_of = {record.path: product for record, product in zip(present, products, strict=True)}
        findings += png_size_findings(folder, present)
        findings += exposure_findings(present, product_of, RATIO_TOLERANCE)
    problems += [_problem(manifest.name, finding) for finding in findings]
    problems.sort(key=lambda problem: problem.path)
    return tuple(problems), tuple(present)


def _problem(dataset: str, finding: Finding) -> Problem:
    return Problem(dataset, finding.path, finding.field, finding.expected, finding.found, finding.advice)


# --- quick ----------------------------------------------------------------------------------------------------


def _check_presence(
    manifest: Manifest, folder: Path, records: Sequence[FrameRecord]
) -> tuple[list[FrameRecord], list[Problem]]:
    """Return the records whose files can be looked into, and what is wrong with the rest."""
    dataset = manifest.name
    present: list[FrameRecord] = []
    problems: list[Problem] = []
    missing: dict[str, list[FrameRecord]] = defaultdict(list)
    for record in records:
        try:
            path = inside(folder, record.path)
            size = path.stat().st_size if path.is_file() else None
        except ManifestError as error:
            problems.append(
                Problem(
                    dataset,
                    record.path,
                    "path",
                    "a file below the dataset's folder",
                    "a link outside",
                    str(error),
                )
            )
            continue
        if size is None:
            # One line for a whole folder that is not there, at the highest level that is not.
            parents = (*reversed(Path(record.path).parents), Path(record.path))
            top = next((part.as_posix() for part in parents if not (folder / part).exists()), record.path)
            missing[top].append(record)
            continue
        if size == 0 or size != (record.size_bytes or size):
            expected = "more than 0 bytes" if record.size_bytes is None else f"{record.size_bytes} bytes"
            advice = "copy or download it again"
            problems.append(Problem(dataset, record.path, "size_bytes", expected, f"{size} bytes", advice))
        if size > 0:
            present.append(record)
    for top, lost in missing.items():
        problems.append(_missing(manifest, folder, top, lost))
    return present, problems


def _missing(manifest: Manifest, folder: Path, top: str, lost: list[FrameRecord]) -> Problem:
    path = folder / top
    if top == lost[0].path:
        like = [name for name in _names(path.parent) if name.casefold() == path.name.casefold()]
        found, advice = "nothing", "copy or download it again"
        if path.is_dir():
            found, advice = "a folder", "move it away and copy the file"
        elif like:
            found, advice = f"only {like[0]}", f"rename it to {path.name}"
        return Problem(manifest.name, top, "file", "a file", found, advice)
    advice = "unpack it there"
    if len(manifest.card.cameras) > 1 and len({record.camera for record in lost}) == 1:
        advice += f", or check the cameras you have with --camera (this is {lost[0].camera})"
    return Problem(manifest.name, f"{top}/", "folder", f"{len(lost)} files", "no such folder", advice)


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


def _check_unlisted(manifest: Manifest, folder: Path, records: Sequence[FrameRecord]) -> list[Problem]:
    """Name files of the listed kind that the manifest does not list, in the folders of these records."""
    from eldata.raw.extensions import RAW_EXTENSIONS

    every = expand(manifest.records, folder)
    listed = {record.path for record in every}
    # Beside references there may be other pictures of the scene (DRV); beside noisy PNG frames none.
    pictured = {
        Path(record.path).parent.as_posix() for record in every if record.role == "noisy" and is_png(record.path)
    }
    raw = {Path(path).parent.as_posix() for path in listed if Path(path).suffix.lower() in RAW_EXTENSIONS}
    # A missing file's name in another case is reported there, with what to do.
    respelled = {path.casefold() for path in listed if not (folder / path).exists()}
    problems = []
    count_in = Counter(Path(path).parent.as_posix() for path in listed)
    for parent in sorted({Path(record.path).parent.as_posix() for record in records}):
        kinds = (RAW_EXTENSIONS if parent in raw else frozenset()) | ({".png"} if parent in pictured else frozenset())
        raws = [name for name in _names(folder / parent) if Path(name).suffix.lower() in kinds]
        for name in raws:
            path = name if parent == "." else f"{parent}/{name}"
            if path not in listed and path.casefold() not in respelled:
                problems.append(
                    Problem(
                        manifest.name,
                        path,
                        "file",
                        f"the {count_in[parent]} listed raw files in this folder",
                        f"{len(raws)} raw files, this one unlisted",
                        "move it away, and make sure that the others were not numbered anew",
                    )
                )
    return problems


# --- metadata and full ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Outcome:
    problems: tuple[Problem, ...]
    exposure_product: Fraction | None = None


def _unchecked(dataset: str, failed: Failed[FrameRecord]) -> _Outcome:
    advice = "make it readable where the check runs, and check again"
    return _Outcome((Problem(dataset, failed.unit.path, "check", "a finished check", failed.reason, advice),))


def _check_file(dataset: str, folder: Path, cameras: dict[str, Any], level: Level, record: FrameRecord) -> _Outcome:
    from eldata.raw.reading import read_header, read_raw

    path = folder / record.path
    require_files(path)
    if path.suffix == ".npy":
        return _check_packed(dataset, path, record, level)
    if is_png(record.path):
        return _check_png(dataset, folder, record, level)
    problems: list[Problem] = []

    def add(field: str, expected: str, found: str, advice: str) -> None:
        problems.append(Problem(dataset, record.path, field, expected, found, advice))

    wrong_frame = "is this the frame that its name says? look for shifted numbering and swapped files"
    try:
        header = read_header(path)
    except RawFileError as error:
        add("content", "a whole raw file", error.reason, "copy or download it again")
        return _Outcome(tuple(problems))
    models = cameras[record.camera].models
    if not header.model:
        add("camera", " or ".join(models), "no camera model", "the file has lost its EXIF: copy the original")
    elif header.model.casefold() not in {model.casefold() for model in models}:
        add("camera", " or ".join(models), header.model, "this file was taken by another camera")
    product = None
    exposure = header.exposure
    if exposure.iso is None or exposure.exposure_s is None:
        lost = "ISO" if exposure.iso is None else "exposure time"
        add("exposure", "ISO and exposure time", f"no {lost}", "the file has lost its EXIF: copy the original")
    else:
        product = exposure.iso * exposure.exposure_s
        for field, expected, found in (
            ("iso", record.iso, exposure.iso),
            ("exposure_s", record.exposure_s, exposure.exposure_s),
        ):
            if expected is not None and abs(found - expected) > RATIO_TOLERANCE * expected:
                add(field, number_text(expected), number_text(found), wrong_frame)
    if level == "full":
        if record.sha256 is not None:
            try:
                digest = sha256_of(path)
            except OSError as error:
                digest = f"unreadable: {error.strerror}"
            if digest != record.sha256:
                add(
                    "sha256",
                    record.sha256,
                    digest,
                    "the file is damaged or another: copy or download it again",
                )
        else:
            try:
                frame = read_raw(path)
            except RawFileError as error:
                add("content", "a raw file that decodes", error.reason, "copy or download it again")
            else:
                for field, size, found_size in (
                    ("width", record.width, frame.sensor.width),
                    ("height", record.height, frame.sensor.height),
                ):
                    if size is not None and size != found_size:
                        add(
                            field,
                            str(size),
                            str(found_size),
                            "this file was taken in another mode or by another camera",
                        )
    return _Outcome(tuple(problems), product)


def _check_png(dataset: str, folder: Path, record: FrameRecord, level: Level) -> _Outcome:
    problems = [_problem(dataset, finding) for finding in png_findings(folder, record)]
    if level == "full" and not problems:
        if record.sha256 is None:
            problems = [_problem(dataset, finding) for finding in png_decode_findings(folder, record)]
        elif (digest := sha256_of(folder / record.path)) != record.sha256:
            advice = "the file is damaged or another: copy or download it again"
            problems = [Problem(dataset, record.path, "sha256", record.sha256, digest, advice)]
    return _Outcome(tuple(problems))


def _check_packed(dataset: str, path: Path, record: FrameRecord, level: Level) -> _Outcome:
    """Check a packed array (a synthetic noisy frame): it has no EXIF to compare, but a header that says its shape."""
    import numpy as np

    try:
        array = np.lib.format.open_memmap(path, mode="r")  # never unpickles; fails if the file is too short
        found = f"{array.dtype} {array.shape}"
        good = array.ndim == 3 and array.dtype == np.float32
    except (OSError, ValueError) as error:
        found, good = str(error), False
    advice = "copy or make it again"
    if not good:
        return _Outcome((Problem(dataset, record.path, "content", "packed float32 (C, h, w)", found, advice),))
    if level == "full" and record.sha256 is not None and (digest := sha256_of(path)) != record.sha256:
        return _Outcome((Problem(dataset, record.path, "sha256", record.sha256, digest, advice),))
    return _Outcome(())


def _check_ratios(dataset: str, records: Sequence[FrameRecord], products: Sequence[Fraction | None]) -> list[Problem]:
    product_of = {record.path: product for record, product in zip(records, products, strict=True)}
    problems = []
    for record in records:
        if record.reference is None or record.ratio is None or UNCERTAIN_ISO in record.flags:
            continue
        reference, noisy = product_of.get(record.reference), product_of[record.path]
        if reference is None or noisy is None:
            continue  # named already: missing, unreadable or without exposure
        ratio = reference / noisy
        if abs(ratio - record.ratio) > RATIO_TOLERANCE * record.ratio:
            problems.append(
                Problem(
                    dataset,
                    record.path,
                    "ratio",
                    f"{number_text(record.ratio)} to {record.reference}",
                    f"{float(ratio):.6g}",
                    "are both the frames that their names say? look for shifted numbering and swapped references",
                )
            )
    return problems
