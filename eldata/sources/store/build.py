"""Packing: each file decoded once, by threads, into a store that is whole or not there; and whether one is whole."""

from __future__ import annotations

import hashlib
import math
import zlib
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from tqdm import tqdm

from eldata import __version__
from eldata.base.files import check_same_work, inside
from eldata.base.pixels import read_rgb16
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
    frames_in,
    layout,
    rgb_sensor,
)
from eldata.sources.store.journal import journaled, remove_stale_journal
from eldata.sources.store.read import PixelReader, open_store, opened, texts_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from eldata.manifest.catalogue import FrameFiles
    from eldata.manifest.verify_report import Level
    from eldata.records import Role
    from eldata.sources.store.format import Compression, Store
    from eldata.sources.store.journal import JournaledFile
    from eldata.sources.store.sources import Source


# HDF5's earliest format: later ones mark a file as open, and refuse it after a kill. Pixels begin where a mapping's
# numbers do.
_OPTIONS: dict[str, Any] = {"libver": "earliest", "alignment_threshold": 4096, "alignment_interval": 64}
_FACTS_CHUNK = 1 << 14  # of which the journal keeps the last one, frame by frame


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What was packed: ``frames`` in all, ``resumed`` of them before; bytes of the pixels and of the store."""

    path: Path
    frames: int
    resumed: int
    pixel_bytes: int
    store_bytes: int


def build_store(
    source: Source,
    path: Path | str,
    *,
    compression: Compression = "none",
    workers: AnyWorkers = 1,
) -> BuildReport:
    """Pack a source into an HDF5 store.

    The store grows as ``<path>.part``, frame by frame; whatever ends the work (an error, a full disk, Ctrl-C, kill -9)
    leaves the finished frames there, and the same call goes on. At the end it is renamed.

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
        If the store is there already, another process writes it, its part was begun otherwise, or the disk is full.
    """
    path = Path(path)
    workers = Workers.of(workers)
    layout((), compression)  # refuses what is not there
    part = path.with_name(f"{path.name}.part")
    if path.exists():
        remove_stale_journal(part)
        raise EldataError(f"{path}: is there already; remove it, or name another file")
    with journaled(part) as file:
        try:
            resumed, pixel_bytes = _fill(file, source, compression, workers)
            file.finish(path)
        except OSError as error:
            if error.filename not in (None, str(part)):
                raise  # of a file that is packed
            raise EldataError(
                f"cannot write {part}: {error.strerror or error}; what is finished is kept there: make room and the "
                "same command goes on"
            ) from error
    return BuildReport(path, len(source.files), resumed, pixel_bytes, path.stat().st_size)


def _fill(
    file: JournaledFile,
    source: Source,
    compression: Compression,
    workers: Workers,
) -> tuple[int, int]:
    """Bring the part to its end; return how many frames were there before, and the bytes of all pixels."""
    is_new, header = file.is_new, _header(source, compression)
    store: h5py.File | None = None
    try:
        store = h5py.File(file.path, "w" if is_new else "r+", driver="fileobj", fileobj=file, **_OPTIONS)
        if is_new:
            _begin(store, source, header)
            _commit(store, file)
        else:
            same = ("format", "version", "files_digest", "compression")
            check_same_work(file.path, texts_of(store.attrs), {name: header[name] for name in same})
        facts = FactsWriter(store)
        resumed = facts.count
        waiting = enumerate(source.files[resumed:], resumed)  # frames are written in order
        decoded = workers.read_ahead(partial(_decoded, source.frame_files.absolute()), [*waiting])
        bar = tqdm(total=len(source.files), initial=resumed, desc="packing", unit="file", disable=None, leave=False)
        with bar, closing(decoded):  # type: ignore[type-var] # a generator, declared as an iterator
            for pixels, frame in decoded:
                write_frame(store, pixels, frame, facts, compression)
                _commit(store, file)
                bar.update()
        pixel_bytes = sum(frame.size * frame.dtype.itemsize for frame in store["frames"].values())
        finish(store)
        _commit(store, file)
        store.close()
    except BaseException as error:
        # What HDF5 makes of an error in our file is another error, or none; ours is the cause.
        cause = file.failure
        file.failure = cause or error  # from here on nothing is written
        if store is not None:
            with suppress(OSError, RuntimeError, ValueError):  # its last tables are not to be written any more
                store.close()
        if cause is not None and cause is not error:
            raise cause from None
        raise
    return resumed, pixel_bytes


class FactsWriter:
    """Appends what a store states of its frames beside their pixels; ``count`` frames are there."""

    def __init__(self, store: h5py.File) -> None:
        self._facts = store["facts"]
        self._known: dict[str, int] = {}
        frames = frames_in(self._facts[:].tobytes())
        for frame in frames:
            facts_line(frame, self._known)
        self.count = len(frames)

    def add(self, frame: StoredFrame) -> None:
        """Append a line."""
        line, end = np.frombuffer(facts_line(frame, self._known), np.uint8), len(self._facts)
        self._facts.resize((end + len(line),))
        self._facts[end:] = line
        self.count += 1


def write_frame(
    store: h5py.File, pixels: NDArray[np.uint16], frame: StoredFrame, facts: FactsWriter, compression: Compression
) -> None:
    """Write the next frame."""
    store["frames"].create_dataset(frame.key, data=pixels, **layout(pixels.shape, compression))
    facts.add(frame)


def finish(store: h5py.File) -> None:
    """Write that a store is complete."""
    store.attrs["facts_crc32"] = zlib.crc32(store["facts"][:].tobytes())
    store.attrs["complete"] = True


def _header(source: Source, compression: Compression) -> dict[str, Any]:
    """Return the attributes of a store that is not complete yet."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "written_by": f"eldata {__version__}",
        "dataset": source.dataset,
        "compression": compression,
        "files_digest": source.digest,
        "files": len(source.files),
        "complete": False,
    }


def _begin(store: h5py.File, source: Source, header: Mapping[str, Any]) -> None:
    store.attrs.update({name: np.bytes_(value) if isinstance(value, str) else value for name, value in header.items()})
    store.create_group("frames")
    store.create_dataset("facts", (0,), np.uint8, maxshape=(None,), chunks=(_FACTS_CHUNK,))
    if source.listing is not None:
        for name, content in zip(("csv", "json"), source.listing, strict=True):
            store.create_dataset(f"manifest/{name}", data=np.frombuffer(content, np.uint8))


def _commit(store: h5py.File, file: JournaledFile) -> None:
    store.flush()
    file.commit()


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
        ``"quick"`` and ``"metadata"``: it opens, is complete, holds as many frames as were packed, each of its stated
        size, and both frames of each pair are there. ``"full"``: also the
        checksum of each frame's pixels.
    workers
        Number of threads, or an executor that reads the pixels (:mod:`eldata.base.workers`).

    Raises
    ------
    StoreError
        If it is not a store, truncated, not complete, or of another version.
    ArgumentError
        If it is compressed and hdf5plugin is not installed.
    """
    workers = Workers.of(workers)
    store = open_store(path)
    problems = list(structure_problems(store))
    count = len(store.frames)
    if level == "full":
        work = partial(_pixels, store.dataset, PixelReader(store.path.absolute()))
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
            if dataset.chunks is None:
                expected, found = "one piece", "nothing" if dataset.id.get_offset() is None else "one piece"
            else:
                chunks = math.prod(-(-side // of_chunk) for side, of_chunk in zip(shape, dataset.chunks, strict=True))
                expected, found = f"{chunks} chunks", f"{dataset.id.get_num_chunks()} chunks"
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
