"""Packing: each file decoded once, by threads, into a store that is whole or not there."""

from __future__ import annotations

import hashlib
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
from eldata.base.png import read_rgb16
from eldata.base.workers import AnyWorkers, Workers, require_files
from eldata.errors import EldataError
from eldata.manifest.patterns import is_png
from eldata.sources.store.format import (
    FORMAT,
    VERSION,
    PackedFile,
    chunk_shape,
    filters,
    frame_attributes,
    rgb_attributes,
)
from eldata.sources.store.journal import journaled, remove_stale_journal
from eldata.sources.store.table import TABLE, frame_key, store_table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from eldata.records import Role
    from eldata.sources.store.format import Compression
    from eldata.sources.store.journal import JournaledFile
    from eldata.sources.store.sources import Source


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
    options = filters(compression)
    part = path.with_name(f"{path.name}.part")
    if path.exists():
        remove_stale_journal(part)
        raise EldataError(f"{path}: is there already; remove it, or name another file")
    with journaled(part) as file:
        try:
            resumed, pixel_bytes = _fill(file, source, compression, options, workers)
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
    options: Mapping[str, Any],
    workers: Workers,
) -> tuple[int, int]:
    """Bring the part to its end; return how many frames were there before, and the bytes of all pixels."""
    is_new, header = file.is_new, _header(source, compression)
    store: h5py.File | None = None
    try:
        # HDF5's earliest format: later ones mark a file as open, and refuse it after a kill.
        store = h5py.File(file.path, "w" if is_new else "r+", driver="fileobj", fileobj=file, libver="earliest")
        if is_new:
            _begin(store, source, header)
            _commit(store, file)
        else:
            same = ("format", "version", "files_digest", "compression")
            check_same_work(file.path, store.attrs, {name: header[name] for name in same})
        frames = store["frames"]
        resumed = len(frames)
        waiting = source.files[resumed:]  # frames are written in order
        decoded = workers.read_ahead(partial(_decoded, source.folder.absolute()), waiting)
        bar = tqdm(total=len(source.files), initial=resumed, desc="packing", unit="file", disable=None, leave=False)
        with bar, closing(decoded):  # type: ignore[type-var] # a generator, declared as an iterator
            for number, (pixels, attributes) in enumerate(decoded, resumed):
                shape = chunk_shape(pixels.shape)
                dataset = frames.create_dataset(frame_key(number), data=pixels, chunks=shape, **options)
                dataset.attrs.update(attributes)
                _commit(store, file)
                bar.update()
        pixel_bytes = sum(frame.size * frame.dtype.itemsize for frame in frames.values())
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


def finish(store: h5py.File) -> None:
    """Write the table of a store's frames, and that it is complete."""
    frames = store["frames"]
    if TABLE in store:  # whoever was ended here begins again
        del store[TABLE]
    table = store_table([dict(frames[frame_key(number)].attrs) for number in range(len(frames))])
    if table is not None:
        store.create_dataset(TABLE, data=table)
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
    store.attrs.update(header)
    store.create_group("frames")
    if source.listing is not None:
        for name, content in zip(("csv", "json"), source.listing, strict=True):
            store.create_dataset(f"manifest/{name}", data=np.frombuffer(content, np.uint8))


def _commit(store: h5py.File, file: JournaledFile) -> None:
    store.flush()
    file.commit()


def _decoded(folder: Path, listed: tuple[str, Role]) -> tuple[NDArray[np.uint16], dict[str, str]]:
    from eldata.raw.reading import read_raw

    path, role = listed
    file = inside(folder, path)
    require_files(file)
    if is_png(path):
        planes = np.ascontiguousarray(read_rgb16(file).transpose(2, 0, 1))
        return planes, rgb_attributes(path, role, pixels_digest(planes), PackedFile.of(file))
    frame = read_raw(file)
    pixels = frame.whole_dn("a store")
    return pixels, frame_attributes(path, role, frame, pixels_digest(pixels), PackedFile.of(file))


def pixels_digest(frame: NDArray[np.uint16]) -> str:
    """Return ``sha256:<hex>`` of a frame's pixels, plane by plane, row by row, little-endian."""
    pixels = np.ascontiguousarray(frame, dtype="<u2")
    return f"sha256:{hashlib.sha256(pixels.data).hexdigest()}"
