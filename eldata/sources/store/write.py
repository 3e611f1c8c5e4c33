"""Packing: which files, and each decoded once, by threads, into a store that is whole or missing; and verification."""

from __future__ import annotations

import hashlib
import io
import re
import zlib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from tqdm import tqdm

from eldata import __version__
from eldata.base.arrays import read_rgb16
from eldata.base.files import atomic_write, inside
from eldata.base.workers import AnyWorkers, Workers, require_files
from eldata.errors import ArgumentError, DatasetError, EldataError
from eldata.manifest.card import Card, card_text
from eldata.manifest.catalogue import FrameFiles, Manifest, find_manifest, known_manifest, load_manifest
from eldata.manifest.clips import choose_clips, clips_of
from eldata.manifest.layouts import scan_raw
from eldata.manifest.own import clean_raws
from eldata.manifest.pairs import Choice
from eldata.manifest.patterns import expand, has_fields, is_pattern, is_png
from eldata.manifest.table import table_text
from eldata.manifest.verify_report import DatasetReport, Level, Problem, VerifyReport
from eldata.raw.files import raws_below
from eldata.records import Exposure, FrameRecord, Role, Sensor
from eldata.sources.frames import RGB_WHITE
from eldata.sources.store.read import (
    FORMAT,
    VERSION,
    PixelReader,
    Store,
    StoredFrame,
    StoreError,
    count_parts,
    encode_facts,
    frame_key,
    hdf5_layout,
    open_hdf5,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from fractions import Fraction

    from numpy.typing import NDArray

    from eldata.sources.store.read import Compression

# --- which files --------------------------------------------------------------------------------------------------

# How calibration frames lie: <camera>/{bias,flat}/ISO<iso>/...
_CALIBRATION = re.compile(r"(?:(?P<camera>[^/]+)/)?(?P<role>bias|flat)/ISO(?P<iso>[1-9][0-9]{0,8})/.+")


def calibration_place(path: str) -> tuple[str, Role, int] | None:
    """Return camera (or nothing), role and ISO that the path of a calibration frame says; ``None`` of another file."""
    found = _CALIBRATION.fullmatch(path)
    return found and (found["camera"] or "", "bias" if found["role"] == "bias" else "flat", int(found["iso"]))


@dataclass(frozen=True, slots=True)
class Source:
    """Files to pack.

    Attributes
    ----------
    dataset
        Name of the dataset, or of the folder.
    folder
        Where the paths start.
    files
        Path and role of each, in the order in which they are packed.
    manifest
        ``None`` for a folder of clean frames.
    listing
        The manifest's CSV and card, as bytes, for the store; of clips with patterns expanded.
    """

    dataset: str
    folder: Path
    files: tuple[tuple[str, Role], ...]
    manifest: Manifest | None = None
    listing: tuple[bytes, bytes] | None = None


def source_of_dataset(
    name: str,
    *,
    root: Path | str | None = None, manifest: Path | str | None = None, ids: Collection[str] | None = None,
    cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
    isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
    split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
) -> Source:  # fmt: skip
    """Return the files of a dataset's pairs or clips: references first come, each once, then their noisy frames.

    Parameters
    ----------
    name
        The dataset's name, that of its manifest; ``drv-raw`` is the camera raws of DRV, found below its folder.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    manifest
        A manifest's CSV file instead of the shipped one.
    ids
        Which clips, such as ``["0007", "M0003"]``: their scenes.
    cameras, scenes, isos, ratios, split, subset, exclude_flags
        Which pairs or clips: see :class:`~eldata.manifest.pairs.Choice`.

    Raises
    ------
    ManifestError
        If there is no such dataset, or the manifest is malformed.
    ArgumentError
        If a camera, split or subset is unknown, or no pair is left; or if the manifest is of another dataset.
    DatasetError
        If the folder or files of a clip are missing, a clip's frames do not follow one numbering, or the pairs are not
        raw files.
    """
    choice = Choice(cameras, scenes, isos, ratios, split, subset, exclude_flags)
    if name == "drv-raw" and manifest is None:
        folder = _require_folder(known_manifest("drv"), root)
        scan = scan_raw(folder)
        return _source_of_clips(scan.card, scan.records, folder, choice, ids)
    loaded = find_manifest(name if manifest is None else manifest, root)
    if manifest is not None and loaded.name != name:
        raise ArgumentError(f"{manifest}: is the manifest of {loaded.name!r}, not of {name!r}")
    folder = _require_folder(loaded, root)
    listing = loaded.path.read_bytes(), loaded.path.with_suffix(".json").read_bytes()
    if (of_copy := loaded.of_copy(folder)) is not loaded:
        listing = table_text(loaded.path, of_copy.records).encode(), card_text(of_copy.card).encode()
        loaded = load_manifest(loaded.path, listing)
    if _holds_clips(loaded.records):
        return _source_of_clips(loaded.card, loaded.records, folder, choice, ids)
    if ids is not None:
        raise ArgumentError(f"{name}: holds pairs, not clips; choose them by cameras, splits or a subset")
    files: dict[str, Role] = {}
    for pair in choice.pairs(loaded.records, loaded.card.subsets):
        files.setdefault(pair.reference, "reference")
        files[pair.path] = "noisy"
    stated = FrameFiles.of(folder, loaded.card, loaded.records).stated
    packed = [path for path in files if path.endswith(".npy") and path not in stated]
    if packed:
        raise DatasetError(
            f"{packed[0]}: is a packed array, not a raw file in DN, as are {len(packed)} in all; a store holds raw "
            "files (eldata synthesize --format dng makes them)"
        )
    return Source(name, folder, tuple(files.items()), loaded, listing)


def _require_folder(manifest: Manifest, root: Path | str | None) -> Path:
    """Find a dataset's folder; refuse a missing one."""
    folder = manifest.folder(root)
    if not folder.is_dir():
        raise DatasetError(
            f"{folder}: there is no such folder; --root names the folder that holds {manifest.card.folder} (where to "
            f"get it: {manifest.card.homepage})"
        )
    return folder


def _holds_clips(rows: Sequence[FrameRecord]) -> bool:
    """Tell whether rows are clips: patterns, PNG frames, or noisy frames none of which has a nominal ratio."""
    ratios = [row.ratio for row in rows if row.role == "noisy"]
    patterns = any(is_pattern(row.path) and not has_fields(row.path) for row in rows if row.role == "noisy")
    return patterns or any(is_png(row.path) for row in rows) or (bool(ratios) and not any(ratios))


def _source_of_clips(
    card: Card, records: Sequence[FrameRecord], folder: Path, choice: Choice, ids: Collection[str] | None
) -> Source:
    """List the files of chosen clips, each reference before its frames, with a manifest of them alone."""
    rows = expand(choose_clips(records, card.subsets, choice, ids=ids), folder)
    files: dict[str, Role] = {}
    for clip in clips_of(rows):
        if clip.reference is not None:
            files.setdefault(clip.reference, "reference")
        files |= dict.fromkeys(clip.frames, "noisy")
    kept = tuple(row for row in rows if row.path in files)
    counts = Counter(str(row.role) for row in kept)
    card_of_files = replace(card, counts=dict(sorted(counts.items())), subsets=())
    path = Path(f"{card.name}.csv")  # what messages call it
    listing = table_text(path, kept).encode(), card_text(card_of_files).encode()
    return Source(card.name, folder, tuple(files.items()), load_manifest(path, listing), listing)


def source_of_folder(folder: Path | str, reference: str | None = None) -> Source:
    """Return the clean frames of a folder, such as the long exposures of SID: :func:`eldata.manifest.own.clean_raws`.

    A folder of bias and flat-field frames, ``bias/ISO<iso>`` or ``flat/ISO<iso>``, gives them as what they are.

    Raises
    ------
    DatasetError
        If it holds none, or it is not certain which are clean.
    """
    folder = Path(folder)
    places = {path: calibration_place(path.relative_to(folder).as_posix()) for path in raws_below(folder)}
    files: dict[Path, Role] = {}
    if None in places.values():
        files = dict.fromkeys(clean_raws(folder, reference), "reference")
    files |= {path: place[1] for path, place in places.items() if place is not None}
    named = sorted((path.relative_to(folder).as_posix(), role) for path, role in files.items())
    return Source(folder.resolve().name, folder, tuple(named))


# --- packing ------------------------------------------------------------------------------------------------------

# HDF5's earliest format: later ones mark a file as open, and refuse it after a kill. Pixels begin where a mapping's
# numbers do.
_OPTIONS: dict[str, Any] = {"libver": "earliest", "alignment_threshold": 4096, "alignment_interval": 64}


def build_store(
    source: Source, path: Path | str, *, compression: Compression = "none", workers: AnyWorkers = 1
) -> Store:
    """Pack a source into an HDF5 store, which gets its name once it is whole.

    Parameters
    ----------
    source
        From :func:`~eldata.sources.store.source_of_dataset` or :func:`~eldata.sources.store.source_of_folder`.
    path
        The store, which must not exist.
    compression
        Lossless: ``"lz4"`` or ``"zstd"`` behind a bitshuffle (needs hdf5plugin, the extra ``compression``), or
        ``"none"``.
    workers
        Number of threads that decode, so many frames and one are in memory; or an executor that decodes
        (:meth:`eldata.base.workers.Workers.read_ahead`). The store is written here.

    Raises
    ------
    ArgumentError
        If the compression is unknown or its package missing, or ``workers`` not positive.
    FileError
        If a file cannot be decoded.
    EldataError
        If the store exists, or cannot be written, such as on a full disk.
    """
    path = Path(path)
    workers = Workers.of(workers)
    hdf5_layout((), compression)  # refuses an unknown one
    if path.exists():
        raise EldataError(f"{path}: is there already; remove it, or name another file")
    files = FrameFiles(source.folder)
    if source.manifest is not None:
        files = FrameFiles.of(source.folder, source.manifest.card, source.manifest.records)
    decoded = workers.read_ahead(partial(_decode_file, files.absolute()), [*enumerate(source.files)])
    bar = tqdm(decoded, total=len(source.files), desc="packing", unit="file", disable=None, leave=False)
    with closing(decoded), bar, atomic_write(path) as new:  # type: ignore[type-var]
        write_frames(Path(new.name), source, compression, bar)
    return Store(path)


def _decode_file(files: FrameFiles, unit: tuple[int, tuple[str, Role]]) -> tuple[NDArray[np.uint16], StoredFrame]:
    """Decode a numbered file, a raw or a 16-bit PNG, to its pixels and facts."""
    from eldata.raw.reading import read_raw

    number, (path, role) = unit
    key, file = frame_key(number), inside(files.folder, path)
    require_files(file)
    if is_png(path):
        planes = np.ascontiguousarray(read_rgb16(file).transpose(2, 0, 1))
        sensor = Sensor("", "", (), (0.0,), RGB_WHITE, *planes.shape[1:])
        return planes, StoredFrame(key, path, role, pixels_digest(planes), sensor, Exposure())
    raw = read_raw(files.at(path))
    pixels = raw.whole_dn("a store")
    digest = pixels_digest(pixels)
    return pixels, StoredFrame(key, path, role, digest, raw.sensor, raw.exposure, raw.channel_white_levels_dn)


class _Disk(io.FileIO):
    """The file that HDF5 writes to; HDF5 hears nothing of a failure, and its caller raises it after the call.

    Told of one, HDF5 leaves chunks out without a word, or ends the process by SIGSEGV as it closes.
    """

    failure: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Write all of the bytes, unless writing has failed."""
        rest = memoryview(data)
        try:
            while rest and self.failure is None:
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.failure = error
        return len(data)

    def truncate(self, size: int | None = None, /) -> int:
        """Set the file's size, unless writing has failed."""
        try:
            return super().truncate(size) if self.failure is None else 0
        except OSError as error:
            self.failure = error
            return 0

    def check(self) -> None:
        """Raise what went wrong."""
        if self.failure is not None:
            raise self.failure


def write_frames(
    path: Path, source: Source, compression: Compression, frames: Iterable[tuple[NDArray[np.uint16], StoredFrame]]
) -> None:
    """Write a store's HDF5 file with decoded frames, in the order of the source's files; OSError if it cannot be."""
    kept: list[StoredFrame] = []
    store = None
    with _Disk(path, "w+") as disk, ThreadPoolExecutor(1) as thread:  # where no signal's handler breaks into HDF5
        try:
            store = thread.submit(h5py.File, disk, "w", **_OPTIONS).result()
            for pixels, frame in frames:
                options = hdf5_layout(pixels.shape, compression)
                thread.submit(store.create_dataset, f"frames/{frame.key}", data=pixels, **options).result()
                disk.check()
                kept.append(frame)
            thread.submit(_write_facts, store, source, compression, encode_facts(kept)).result()
        finally:
            if store is not None:
                thread.submit(store.close).result()
            disk.check()


def _write_facts(file: h5py.File, source: Source, compression: Compression, facts: bytes) -> None:
    """Write everything but the frames: their facts, the manifest, the version."""
    arrays = {"facts": facts}
    if source.listing is not None:
        arrays |= zip(("manifest/csv", "manifest/json"), source.listing, strict=True)
    for name, content in arrays.items():
        file.create_dataset(name, data=np.frombuffer(content, np.uint8))
    file.attrs["version"], file.attrs["files"] = VERSION, len(source.files)
    file.attrs["facts_crc32"] = zlib.crc32(facts)
    texts = {"format": FORMAT, "written_by": f"eldata {__version__}", "dataset": source.dataset}
    for name, text in (texts | {"compression": compression}).items():
        file.attrs[name] = np.bytes_(text)


def pixels_digest(frame: NDArray[np.uint16]) -> str:
    """Return ``sha256:<hex>`` of a frame's pixels, plane by plane, row by row, little-endian."""
    pixels = np.ascontiguousarray(frame, dtype="<u2")
    return f"sha256:{hashlib.sha256(pixels.data).hexdigest()}"


# --- verification -------------------------------------------------------------------------------------------------

_ADVICE = "copy or pack the store again"


def verify_store(path: Path | str, *, level: Level = "quick", workers: AnyWorkers = 1) -> VerifyReport:
    """Check a store; every problem is listed.

    Parameters
    ----------
    path
        The store.
    level
        ``"quick"`` and ``"metadata"``: it opens, holds as many frames as were packed, each of its stated size, and both
        frames of each pair. ``"full"``: also the checksum of each frame's pixels.
    workers
        Number of threads, or an executor that reads the pixels (:mod:`eldata.base.workers`).

    Raises
    ------
    StoreError
        If it is not a store, truncated, or of another version.
    ArgumentError
        If it is compressed and hdf5plugin is not installed.
    """
    workers = Workers.of(workers)
    store = Store(path)
    count = len(store.frames)
    problems = [Problem(store.dataset, *problem, _ADVICE) for problem in _structure_problems(store)]
    if level == "full":
        work = partial(_find_pixel_problem, PixelReader(store.path.absolute(), store.reader.facts_crc32))
        checked = workers.read_ahead(work, store.frames)
        bar = tqdm(checked, total=count, desc=f"{store.dataset} (full)", unit="frame", disable=None, leave=False)
        problems += [Problem(store.dataset, *problem, _ADVICE) for problem in bar if problem]
    problems.sort(key=lambda problem: problem.path)
    homepage = "" if store.manifest is None else store.manifest.card.homepage
    hashed = count if level == "full" else 0
    report = DatasetReport(store.dataset, store.path, False, homepage, count, count, hashed, tuple(problems))
    return VerifyReport(level, (report,))


def _structure_problems(store: Store) -> Iterator[tuple[str, str, str, str]]:
    """Yield path, field, expectation and finding of frames not of their size, incomplete, or without a reference."""
    with open_hdf5(store.path) as file:
        for frame in store.frames:
            dataset = file["frames"].get(frame.key)
            expected, found = f"a frame {frame.key}", "nothing"
            if dataset is not None:
                expected, found = f"uint16 {frame.shape}", f"{dataset.dtype} {dataset.shape}"
            if found == expected:
                expected, found = count_parts(dataset)
            if found != expected:
                yield frame.path, "pixels", expected, found
    held = {frame.path for frame in store.frames}
    for record in () if store.manifest is None else store.manifest.records:
        if record.path in held and record.reference is not None and record.reference not in held:
            yield record.path, "reference", record.reference, "nothing"


def _find_pixel_problem(reader: PixelReader, frame: StoredFrame) -> tuple[str, str, str, str] | None:
    """Compare a frame's pixels with their digest; ``None`` if they agree."""
    require_files(reader.path)
    try:
        found = pixels_digest(reader.read(frame.key, slice(None), slice(None)))
    except StoreError as error:
        found = error.reason
    return None if found == frame.sha256 else (frame.path, "sha256 of the pixels", frame.sha256, found)
