"""Opening a store, and reading parts of its frames."""

from __future__ import annotations

import os
import tempfile
import threading
import weakref
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from eldata.errors import ArgumentError, EldataError
from eldata.manifest.catalogue import load_manifest
from eldata.store.layout import COMPRESSIONS, FORMAT, VERSION, Store, StoreError, filters, stored_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.manifest.catalogue import Manifest

# Enough for the chunks of a few rows of a crop; a read visits each chunk once. HDF5 frees it with the frame.
_CHUNK_CACHE_BYTES = 1 << 20


def open_store(path: Path | str) -> Store:
    """Read what a store holds, without pixels.

    Raises
    ------
    StoreError
        If the file is missing, truncated, damaged, no store, not complete, or of a newer version.
    ArgumentError
        If it is compressed and hdf5plugin is not installed.
    """
    path = Path(path)
    with opened(path) as file:
        try:
            manifest = _manifest(path, file)
            frames = tuple(stored_frame(key, frame.attrs) for key, frame in sorted(file["frames"].items()))
            dataset, listed = str(file.attrs["dataset"]), int(file.attrs["files"])
            compression = next(name for name in COMPRESSIONS if name == file.attrs["compression"])
        except (OSError, RuntimeError, ValueError, LookupError, TypeError, StopIteration, EldataError) as error:
            raise StoreError(path, f"is damaged ({error}); copy or pack it again") from error
    if len(frames) != listed:
        raise StoreError(path, f"is damaged: expected {listed} frames, found {len(frames)}; copy or pack it again")
    return Store(path, dataset, compression, manifest, frames)


def opened(path: Path) -> h5py.File:
    """Open a store's HDF5 file for reading; errors as of :func:`open_store`."""
    try:
        path.open("rb").close()
    except OSError as error:
        raise StoreError(path, f"cannot be read: {error.strerror}") from error
    if not h5py.is_hdf5(path):
        raise StoreError(path, "is not an HDF5 file; eldata pack makes stores")
    try:
        # A finished store is never written again, so readers need no lock, which some network disks do not have.
        file = h5py.File(path, "r", locking=False, rdcc_nbytes=_CHUNK_CACHE_BYTES)
    except OSError as error:
        reason = "is truncated" if "truncated" in str(error) else "is damaged"
        raise StoreError(path, f"{reason} ({error}); copy or pack it again") from error
    try:
        _check_header(path, dict(file.attrs))
    except BaseException:
        file.close()
        raise
    return file


def _check_header(path: Path, attributes: dict[str, Any]) -> None:
    if attributes.get("format") != FORMAT:
        raise StoreError(path, "is an HDF5 file, but not a store of eldata; eldata pack makes stores")
    version = int(attributes["version"])
    if version > VERSION:
        raise StoreError(
            path,
            f"is a store of version {version}, written by {attributes.get('written_by')}; this eldata reads up to "
            f"version {VERSION}: install a newer one",
        )
    if not attributes.get("complete"):
        raise StoreError(path, "is not complete; the eldata pack command that began it goes on with it")
    compression = next((name for name in COMPRESSIONS if name == attributes.get("compression")), None)
    if compression is None:
        raise StoreError(path, f"has the unknown compression {attributes.get('compression')!r}; is it damaged?")
    filters(compression)  # HDF5 must know it before it reads, in each process


def _manifest(path: Path, file: h5py.File) -> Manifest | None:
    if "manifest" not in file:
        return None
    with tempfile.TemporaryDirectory(prefix="eldata-") as folder:  # the one loader reads files
        csv = Path(folder) / "manifest.csv"
        for suffix in ("csv", "json"):
            csv.with_suffix(f".{suffix}").write_bytes(file[f"manifest/{suffix}"][:].tobytes())
        return replace(load_manifest(csv), path=path)


class PixelReader:
    """Reads parts of a store's frames, in any process and thread.

    The file is opened in each process that reads, on its first read. It is never shared: a fork closes it first, and a
    pickled reader opens it anew. Memory does not grow with the store: HDF5 keeps at most one megabyte of chunks, of the
    frame being read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: h5py.File | None = None
        self._lock = threading.Lock()
        self._scratch = threading.local()
        _READERS.add(self)

    def read(self, key: str, rows: range, columns: range) -> NDArray[np.uint16]:
        """Return a part of a frame's mosaic, uint16 in DN.

        Raises
        ------
        StoreError
            If the store cannot be read.
        """
        pixels = np.empty((len(rows), len(columns)), np.uint16)
        self._fill(pixels, key, rows, columns)
        return pixels

    def borrow(self, key: str, rows: range, columns: range) -> NDArray[np.uint16]:
        """Return a part as :meth:`read` does, in memory that this thread's next call overwrites.

        The pages of new memory cost as much as the reading.
        """
        size = len(rows) * len(columns)
        scratch = getattr(self._scratch, "pixels", None)
        if scratch is None or scratch.size < size:
            scratch = self._scratch.pixels = np.empty(size, np.uint16)
        pixels: NDArray[np.uint16] = scratch[:size].reshape(len(rows), len(columns))
        self._fill(pixels, key, rows, columns)
        return pixels

    def _fill(self, pixels: NDArray[np.uint16], key: str, rows: range, columns: range) -> None:
        with self._lock:
            if self._file is None:
                self._file = opened(self.path)
            try:
                # Opened for this read alone: with the dataset HDF5 frees its chunks. h5py's low level, for its indexing
                # takes a third of the time of a crop.
                dataset = h5py.h5d.open(self._file.id, f"frames/{key}".encode())
                there = dataset.get_space()
                there.select_hyperslab((rows.start, columns.start), pixels.shape)
                dataset.read(h5py.h5s.create_simple(pixels.shape), there, pixels)
            except (OSError, RuntimeError, KeyError, ValueError) as error:
                raise StoreError(self.path, f"frame {key} is damaged ({error}); copy or pack it again") from error

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        with self._lock:
            if self._file is not None:
                self._file.close()
                self._file = None

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["path"])  # type: ignore[misc] # a pickled reader is a path


_READERS: weakref.WeakSet[PixelReader] = weakref.WeakSet()


def _before_fork() -> None:
    for reader in list(_READERS):
        reader.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork)


class StoredMosaic:
    """A frame's mosaic, (H, W) uint16 in DN; ``mosaic[rows, columns]`` reads just that part of it."""

    dtype = np.dtype(np.uint16)

    def __init__(self, reader: PixelReader, key: str, shape: tuple[int, int]) -> None:
        self._reader = reader
        self._key = key
        self.shape = shape

    def __getitem__(self, part: tuple[slice, slice]) -> NDArray[np.uint16]:
        rows, columns = self._ranges(part)
        return self._reader.read(self._key, rows, columns)

    def borrow(self, part: tuple[slice, slice]) -> NDArray[np.uint16]:
        """Read a part into memory that the next call of this thread overwrites."""
        rows, columns = self._ranges(part)
        return self._reader.borrow(self._key, rows, columns)

    def _ranges(self, part: tuple[slice, slice]) -> tuple[range, range]:
        rows, columns = (range(*wanted.indices(side)) for wanted, side in zip(part, self.shape, strict=True))
        if rows.step != 1 or columns.step != 1:
            raise ArgumentError("a stored mosaic is read without steps")
        return rows, columns

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("a stored mosaic cannot be had without reading it into new memory")
        return self[:, :].astype(dtype or self.dtype, copy=False)
