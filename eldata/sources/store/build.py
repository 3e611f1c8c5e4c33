"""Packing: each file decoded once, by threads, into a store that is whole or not there; and whether one is whole."""

from __future__ import annotations

import hashlib
import io
import signal
import threading
import zlib
from contextlib import closing, contextmanager
from dataclasses import dataclass
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
from eldata.errors import EldataError
from eldata.manifest.patterns import is_png
from eldata.manifest.verify_report import DatasetReport, Problem, VerifyReport
from eldata.records import Exposure
from eldata.sources.store.format import (
    FORMAT,
    VERSION,
    PackedFile,
    StoredFrame,
    StoreError,
    facts_line,
    frame_key,
    layout,
    rgb_sensor,
)
from eldata.sources.store.read import PixelReader, open_store, opened, stored_parts

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from eldata.manifest.catalogue import FrameFiles
    from eldata.manifest.verify_report import Level
    from eldata.records import Role
    from eldata.sources.store.format import Compression, Store
    from eldata.sources.store.sources import Source


# HDF5's earliest format: later ones mark a file as open, and refuse it after a kill. Pixels begin where a mapping's
# numbers do.
_OPTIONS: dict[str, Any] = {"libver": "earliest", "alignment_threshold": 4096, "alignment_interval": 64}


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What was packed: how many ``frames``; bytes of the pixels and of the store."""

    path: Path
    frames: int
    pixel_bytes: int
    store_bytes: int


def build_store(
    source: Source,
    path: Path | str,
    *,
    compression: Compression = "none",
    workers: AnyWorkers = 1,
) -> BuildReport:
    """Pack a source into an HDF5 store, which is there whole or not at all.

    Parameters
    ----------
    source
        From :func:`~eldata.sources.store.source_of_dataset` or :func:`~eldata.sources.store.source_of_folder`.
    path
        The store, which must not be there yet.
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
        If the store is there already, or cannot be written, such as on a full disk.
    """
    path = Path(path)
    workers = Workers.of(workers)
    layout((), compression)  # refuses what is not there
    if path.exists():
        raise EldataError(f"{path}: is there already; remove it, or name another file")
    decoded = workers.read_ahead(partial(_decoded, source.frame_files.absolute()), [*enumerate(source.files)])
    bar = tqdm(decoded, total=len(source.files), desc="packing", unit="file", disable=None, leave=False)
    with closing(decoded), bar, atomic_write(path) as new:  # type: ignore[type-var]
        pixel_bytes = write_frames(Path(new.name), source, compression, bar)
    return BuildReport(path, len(source.files), pixel_bytes, path.stat().st_size)


class _Disk(io.FileIO):
    """The file that HDF5 writes to; of a write that fails HDF5 hears nothing, and its caller after the step.

    Told of one, or of a signal, HDF5 leaves chunks out without a word, or ends the process by SIGSEGV as it closes.
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

    @contextmanager
    def step(self) -> Iterator[None]:
        """Let signals wait while HDF5 writes in a block, and raise what was wrong with the disk."""
        try:
            with hold_signals():
                yield
        finally:
            if self.failure is not None:
                raise self.failure


@contextmanager
def hold_signals() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of a block: a library in C loses what is raised where it calls Python."""
    held: list[int] = []
    handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # no other is sent any
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        handlers = {number: handler for number, handler in handlers.items() if handler is not None}
    try:
        for number in handlers:
            signal.signal(number, lambda number, _: held.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in held[:1]:
            signal.raise_signal(number)


def write_frames(
    path: Path,
    source: Source,
    compression: Compression,
    frames: Iterable[tuple[NDArray[np.uint16], StoredFrame]],
) -> int:
    """Fill a file with decoded frames, in the order of the source's files; return the bytes of their pixels.

    Raises
    ------
    OSError
        If it cannot be written.
    StoreError
        If not all that was written is there: the file is not to be used.
    """
    known: dict[str, int] = {}
    lines, pixel_bytes, store = [], 0, None
    with _Disk(path, "w+") as disk:
        try:
            with disk.step():
                store = h5py.File(disk, "w", **_OPTIONS)
            for pixels, frame in frames:
                with disk.step():
                    store.create_dataset(f"frames/{frame.key}", data=pixels, **layout(pixels.shape, compression))
                lines.append(facts_line(frame, known))
                pixel_bytes += pixels.nbytes
            with disk.step():
                _write_facts(store, source, compression, b"".join(lines))
                store.close()  # before a signal may come
        finally:
            if store is not None:
                with disk.step():
                    store.close()
    with hold_signals():  # one that h5py is told of while it reads is another error
        lacking = [one for one in structure_problems(open_store(path)) if one.field == "pixels"]
    if lacking:
        raise StoreError(path, f"{lacking[0].path}: expected {lacking[0].expected}, found {lacking[0].found}")
    return pixel_bytes


def _write_facts(store: h5py.File, source: Source, compression: Compression, facts: bytes) -> None:
    arrays = {"facts": facts}
    if source.listing is not None:
        arrays |= zip(("manifest/csv", "manifest/json"), source.listing, strict=True)
    for name, content in arrays.items():
        store.create_dataset(name, data=np.frombuffer(content, np.uint8))
    header = {
        "format": FORMAT,
        "version": VERSION,
        "written_by": f"eldata {__version__}",
        "dataset": source.dataset,
        "compression": compression,
        "files": len(source.files),
        "facts_crc32": zlib.crc32(facts),
    }
    store.attrs.update({name: np.bytes_(value) if isinstance(value, str) else value for name, value in header.items()})


def _decoded(files: FrameFiles, unit: tuple[int, tuple[str, Role]]) -> tuple[NDArray[np.uint16], StoredFrame]:
    from eldata.raw.reading import read_raw

    number, (path, role) = unit
    key, file = frame_key(number), inside(files.folder, path)
    require_files(file)
    if is_png(path):
        planes = np.ascontiguousarray(read_rgb16(file).transpose(2, 0, 1))
        kept = pixels_digest(planes), PackedFile.of(file)
        return planes, StoredFrame(key, path, role, rgb_sensor(*planes.shape[1:]), Exposure(), *kept)
    raw = read_raw(files.at(path))
    pixels = raw.whole_dn("a store")
    stated = raw.sensor, raw.exposure, pixels_digest(pixels), PackedFile.of(file), raw.channel_white_levels_dn
    return pixels, StoredFrame(key, path, role, *stated)


def pixels_digest(frame: NDArray[np.uint16]) -> str:
    """Return ``sha256:<hex>`` of a frame's pixels, plane by plane, row by row, little-endian."""
    pixels = np.ascontiguousarray(frame, dtype="<u2")
    return f"sha256:{hashlib.sha256(pixels.data).hexdigest()}"


# --- is a store whole? Every problem is found and listed; nothing is written ------------------------------------------

_ADVICE = "copy or pack the store again"


def verify_store(path: Path | str, *, level: Level = "quick", workers: AnyWorkers = 1) -> VerifyReport:
    """Check a store.

    Parameters
    ----------
    path
        The store.
    level
        ``"quick"`` and ``"metadata"``: it opens, holds as many frames as were packed, each of its stated
        size, and both frames of each pair are there. ``"full"``: also the
        checksum of each frame's pixels.
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
    store = open_store(path)
    problems = list(structure_problems(store))
    count = len(store.frames)
    if level == "full":
        work = partial(_pixels, store.dataset, PixelReader(store.path.absolute(), store.facts_crc32))
        bar = tqdm(total=count, desc=f"{store.dataset} (full)", unit="frame", disable=None, leave=False)
        with bar:
            for found in workers.read_ahead(work, store.frames):
                bar.update()
                problems += found
    problems.sort(key=lambda problem: problem.path)
    homepage = "" if store.manifest is None else store.manifest.card.homepage
    hashed = count if level == "full" else 0
    report = DatasetReport(store.dataset, store.path, False, homepage, count, count, hashed, tuple(problems))
    return VerifyReport(level, (report,))


def structure_problems(store: Store) -> Iterator[Problem]:
    """Yield where frames are not of their stated size in whole pixels of uint16, and which pairs lack a reference."""
    with opened(store.path) as file:
        for frame in store.frames:
            if frame.key not in file["frames"]:
                yield Problem(store.dataset, frame.path, "pixels", f"a frame {frame.key}", "nothing", _ADVICE)
                continue
            dataset, shape = file["frames"][frame.key], frame.shape
            found, expected = f"{dataset.dtype} {dataset.shape}", f"uint16 {shape}"
            if found != expected:
                yield Problem(store.dataset, frame.path, "pixels", expected, found, _ADVICE)
                continue
            expected, found = stored_parts(dataset)
            if found != expected:
                yield Problem(store.dataset, frame.path, "pixels", expected, found, _ADVICE)
    if store.manifest is not None:
        held = {frame.path for frame in store.frames}
        for record in store.manifest.records:
            if record.path in held and record.reference is not None and record.reference not in held:
                yield Problem(store.dataset, record.path, "reference", record.reference, "nothing", _ADVICE)


def _pixels(dataset: str, reader: PixelReader, frame: StoredFrame) -> list[Problem]:
    require_files(reader.path)
    try:
        found = pixels_digest(reader.read(frame.key, slice(None), slice(None)))
    except StoreError as error:
        found = error.reason
    if found == frame.sha256:
        return []
    return [Problem(dataset, frame.path, "sha256 of the pixels", frame.sha256, found, _ADVICE)]
