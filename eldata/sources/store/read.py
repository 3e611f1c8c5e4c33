"""Opening a store, and reading parts of its frames."""

from __future__ import annotations

import math
import os
import threading
import weakref
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from eldata.base.files import file_problem
from eldata.base.isolation import Limits, guarded_file, isolating
from eldata.base.memory import no_search_for_cycles, scratch
from eldata.errors import ArgumentError, EldataError
from eldata.manifest.catalogue import load_manifest
from eldata.raw._kernels import gather
from eldata.raw.cfa import pack, packing_sites
from eldata.records import Records
from eldata.sources.store.chunks import chunk_table, read_part, read_parts
from eldata.sources.store.format import (
    COMPRESSIONS,
    FORMAT,
    VERSION,
    Store,
    StoredFrame,
    StoredRgb,
    StoreError,
    filters,
    stored,
)
from eldata.sources.store.table import TABLE, frames_in_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.manifest.catalogue import Manifest
    from eldata.raw.cfa import CfaRows
    from eldata.sources.store.chunks import ChunkTable

# A finished store is never written again, so readers need no lock, which some network disks do not have. But HDF5 opens
# a file twice in one process only if both ask for the same: h5py's own default, or what the user's code says.
_LOCKING = (False, None, True, "best-effort")
# Enough for the chunks of a few rows of a crop; a read visits each chunk once. HDF5 frees it with the frame.
_CHUNK_CACHE_BYTES = 1 << 20
# Frames whose chunks' places are kept: 3 kB each at 12 megapixels. To look them up takes a millisecond.
_MOST_TABLES = 4096
_MOST_MANIFEST_BYTES = 256 << 20  # what the reader of text files takes
_MOST_CHUNK_PIXELS = 1 << 22  # ours have 256 x 256
_MOST_PIXELS = 1 << 29  # of a frame; RGB counts three times
_TRIAL_LIMITS = Limits(seconds=20.0)  # and a second a MiB: to read a frame's attributes takes up to a millisecond


def open_store(path: Path | str, *, by_table: bool = True) -> Store:
    """Read what a store holds, without pixels: from its table, if it has one and ``by_table`` is not switched off.

    There are damaged files in whose attributes HDF5 runs for ever; where isolation is on
    (:func:`eldata.isolation`), as it is in commands, they are an error too.

    Raises
    ------
    StoreError
        If the file is missing, truncated, damaged, not a store, not complete, or of a newer version.
    ArgumentError
        If it is compressed and hdf5plugin is not installed.
    """
    path = Path(path)
    if isolating():
        seconds = _TRIAL_LIMITS.seconds + (path.stat().st_size >> 20 if path.is_file() else 0)
        limits = replace(_TRIAL_LIMITS, seconds=seconds)
        guarded_file(_try if by_table else _try_attributes, path, StoreError, limits=limits)
    return _held(path, by_table=by_table)


def _try(path: Path) -> None:
    """Read what a store holds, to see that it can be read."""
    _held(path, by_table=True)


def _try_attributes(path: Path) -> None:
    """Read the same from the attributes of its frames."""
    _held(path, by_table=False)


def _held(path: Path, *, by_table: bool) -> Store:
    with opened(path) as file, no_search_for_cycles():
        try:
            _check_outline(file)
            manifest = _manifest(path, file)
            frames_group = file["frames"]
            held: list[StoredFrame | StoredRgb] = (
                [*_listed(file)]
                if by_table and TABLE in file
                else [_stored(key, frames_group) for key in sorted(frames_group)]
            )
            dataset, listed = str(file.attrs["dataset"]), int(file.attrs["files"])
        except (OSError, RuntimeError, ValueError, LookupError, TypeError, EldataError) as error:
            raise StoreError(path, f"is damaged ({error}); copy or pack it again") from error
        compression = file.attrs["compression"]  # known: it was opened with it
    if len(held) != listed:
        raise StoreError(path, f"is damaged: expected {listed} frames, found {len(held)}; copy or pack it again")
    frames = Records(frame for frame in held if isinstance(frame, StoredFrame))
    rgb = tuple(frame for frame in held if isinstance(frame, StoredRgb))
    return Store(path, dataset, compression, manifest, frames, rgb)


def opened(path: Path) -> h5py.File:
    """Open a store's HDF5 file for reading; raises like :func:`open_store`."""
    problem = file_problem(path)
    if problem is not None:
        raise StoreError(path, problem)
    if not h5py.is_hdf5(path):
        raise StoreError(path, "is not an HDF5 file; eldata pack makes stores")
    file = _open(path)
    try:
        _check_header(path, dict(file.attrs))
    except BaseException as error:  # Ctrl-C too: the caller gets no file that it could close
        file.close()
        if isinstance(error, EldataError) or not isinstance(error, Exception):
            raise
        # HDF5 looks at what it reads while it reads it, and h5py raises many kinds.
        raise StoreError(path, f"is damaged ({error}); copy or pack it again") from error
    return file


def _open(path: Path, lockings: Sequence[Any] = _LOCKING) -> h5py.File:
    try:
        return h5py.File(path, "r", locking=lockings[0], rdcc_nbytes=_CHUNK_CACHE_BYTES)
    except OSError as error:
        if "flag values don't match" in str(error) and len(lockings) > 1:
            return _open(path, lockings[1:])
        reason = "is truncated" if "truncated" in str(error) else "is damaged"
        raise StoreError(path, f"{reason} ({error}); copy or pack it again") from error


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


def _check_outline(file: h5py.File) -> None:
    """Refuse a file whose groups or texts are links, which could lead to other files, or too large."""
    for name in ("frames", "manifest", TABLE):
        _check_held(file, name)
    if TABLE in file and file[TABLE].size > _MOST_MANIFEST_BYTES:
        raise ValueError(f"{TABLE} declares {file[TABLE].size} bytes")
    if "manifest" in file:
        for name in file["manifest"]:
            _check_held(file["manifest"], name)
            if file["manifest"][name].size > _MOST_MANIFEST_BYTES:
                raise ValueError(f"manifest/{name} declares {file['manifest'][name].size} bytes")


def _listed(file: h5py.File) -> list[StoredFrame]:
    """Return the frames that the table lists; each is looked at as it is read (:func:`_frame`)."""
    frames = frames_in_table(file[TABLE][:].tobytes())
    if len(frames) != len(file["frames"]):
        raise ValueError(f"{TABLE} lists {len(frames)} frames, and there are {len(file['frames'])}")
    for shape in {frame.shape for frame in frames}:
        _check_pixels(TABLE, shape)
    return frames


def _check_held(group: h5py.Group, name: str) -> None:
    """Refuse what is not in this file itself: links, and data sets whose pixels lie in other files."""
    if name in group and group.get(name, getclass=True, getlink=True) is not h5py.HardLink:
        raise ValueError(f"{name!r} is a link")
    if group.get(name, getclass=True) is not h5py.Dataset:
        return
    properties = group[name].id.get_create_plist()
    if properties.get_layout() == h5py.h5d.VIRTUAL or properties.get_external_count():
        raise ValueError(f"the pixels of {name!r} lie in other files")


def _stored(key: str, frames: h5py.Group) -> StoredFrame | StoredRgb:
    """Return a frame, of a size that a camera has: its pixels are read into memory of that size."""
    frame = _frame(frames, key)
    held = stored(key, frame.attrs, frame.shape)
    _check_pixels(f"frame {key}", held.shape)
    return held


def _frame(frames: h5py.Group, key: str) -> h5py.Dataset:
    """Return a frame's HDF5 dataset, which lies in this file, in chunks of a size that is read at once."""
    _check_held(frames, key)
    frame = frames[key]
    if frame.chunks is not None and math.prod(frame.chunks) > _MOST_CHUNK_PIXELS:
        raise ValueError(f"frame {key} has chunks of {frame.chunks} pixels")
    return frame


def _check_pixels(name: str, shape: tuple[int, ...]) -> None:
    if not 0 < math.prod(shape) <= _MOST_PIXELS:
        raise ValueError(f"{name} declares {shape} pixels")


def _manifest(path: Path, file: h5py.File) -> Manifest | None:
    if "manifest" not in file:
        return None
    rows, card = (file[f"manifest/{name}"][:].tobytes() for name in ("csv", "json"))
    return replace(load_manifest(path / "manifest.csv", (rows, card)), path=path)


class PixelReader:
    """Reads parts of a store's frames, in any process and in several threads at once.

    The file is opened in each process that reads, on its first read. It is never shared: a fork closes it first, and a
    pickled reader opens it again. Memory does not grow with the store: a thread keeps one chunk, a process the places
    of the chunks of the frames that it read last.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._opened: _Opened | None = None
        self._lock = threading.Lock()
        _READERS.add(self)

    def read(self, key: str, rows: range, columns: range, planes: tuple[int, ...] = ()) -> NDArray[np.uint16]:
        """Return a part of a frame, (rows, columns) uint16 in DN; of several ``planes``, (planes, rows, columns).

        Raises
        ------
        StoreError
            If the store cannot be read.
        """
        pixels = np.empty((*planes, len(rows), len(columns)), np.uint16)
        self._fill(pixels, key, rows, columns)
        return pixels

    def borrow(self, key: str, rows: range, columns: range, planes: tuple[int, ...] = ()) -> NDArray[np.uint16]:
        """Return a part as :meth:`read` does, in memory that this thread's next call overwrites.

        The pages of new memory cost as much as the reading.
        """
        shape = *planes, len(rows), len(columns)
        size = math.prod(shape)
        pixels: NDArray[np.uint16] = scratch("borrowed", 2 * size).bytes.view(np.uint16)[:size].reshape(shape)
        self._fill(pixels, key, rows, columns)
        return pixels

    def pack(self, key: str, rows: range, columns: range, cfa: CfaRows, out: NDArray[np.uint16]) -> None:
        """Write a part of a mosaic, whose CFA it is, into ``out`` (C, h, w), packed: chunk by chunk from the cache.

        Raises
        ------
        StoreError
            If the store cannot be read.
        """
        sites = packing_sites(cfa)
        scale, period = sites.scale, sites.period
        with self._problems(key):
            held, table = self._chunks(key)
            borders = (rows.start, columns.start, sites.top, sites.left)
            if table is None or any(border % period for border in (*borders, table.height, table.width)):
                # Chunks cut through periods, or only HDF5 can read them: the part is put together first.
                pack(self.borrow(key, rows, columns), cfa, out=out)
                return
            for top, left, part in read_parts(held.number, table, 0, rows, columns):
                height, width = part.shape
                target = out[:, top // scale : (top + height) // scale, left // scale : (left + width) // scale]
                gather(part, target, sites.table, period, sites.sub)

    def _fill(self, pixels: NDArray[np.uint16], key: str, rows: range, columns: range) -> None:
        with self._problems(key):
            held, table = self._chunks(key)
            if table is None:
                part = ..., slice(rows.start, rows.stop), slice(columns.start, columns.stop)
                with self._lock:
                    _frame(held.file["frames"], key).read_direct(pixels, part)
                return
            for number, plane in enumerate(pixels[None] if pixels.ndim == 2 else pixels):
                read_part(held.number, table, number, rows, columns, plane)

    def _chunks(self, key: str) -> tuple[_Opened, ChunkTable | None]:
        with self._lock:
            self._opened = self._opened or _Opened(self.path)
            return self._opened, self._opened.table(key)

    @contextmanager
    def _problems(self, key: str) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError, KeyError, IndexError, ValueError) as error:
            if isinstance(error, EldataError):
                raise
            raise StoreError(self.path, f"frame {key} is damaged ({error}); copy or pack it again") from error

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        with self._lock:
            if self._opened is not None:
                self._opened.file.close()
            self._opened = None  # a thread that is reading holds its descriptor until it is done

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["path"])  # type: ignore[misc] # a pickled reader is a path


class _Opened:
    """A store's file, and a descriptor of it, which is closed when nobody holds it any more."""

    def __init__(self, path: Path) -> None:
        self.file = file = opened(path)
        self.table = lru_cache(_MOST_TABLES)(lambda key: chunk_table(_frame(file["frames"], key).id))
        self.number = os.open(path, os.O_RDONLY)

    def __del__(self) -> None:
        with suppress(AttributeError, OSError):  # it was not opened
            os.close(self.number)


_READERS: weakref.WeakSet[PixelReader] = weakref.WeakSet()


def _before_fork() -> None:
    for reader in list(_READERS):
        reader.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork)


class StoredMosaic:
    """A frame's pixels, (H, W) uint16 in DN or (3, H, W); ``mosaic[rows, columns]`` reads just that part of them."""

    dtype = np.dtype(np.uint16)

    def __init__(self, reader: PixelReader, key: str, shape: tuple[int, ...]) -> None:
        self._reader = reader
        self._key = key
        self.shape = shape

    def __getitem__(self, part: tuple[Any, ...]) -> NDArray[np.uint16]:
        return self._reader.read(self._key, *self._ranges(part), self.shape[:-2])

    def borrow(self, part: tuple[Any, ...]) -> NDArray[np.uint16]:
        """Read a part into memory that the next call of this thread overwrites."""
        return self._reader.borrow(self._key, *self._ranges(part), self.shape[:-2])

    def pack(self, part: tuple[slice, slice], cfa: CfaRows, out: NDArray[np.uint16]) -> None:
        """Write a part of a mosaic, whose CFA it is, into ``out`` (C, h, w), packed, in DN."""
        self._reader.pack(self._key, *self._ranges(part), cfa, out)

    def _ranges(self, part: tuple[Any, ...]) -> tuple[range, range]:
        rows, columns = (range(*wanted.indices(side)) for wanted, side in zip(part[-2:], self.shape[-2:], strict=True))
        if rows.step != 1 or columns.step != 1:
            raise ArgumentError("a stored mosaic is read without steps")
        return rows, columns

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("a stored mosaic cannot be read without new memory")
        return self[:, :].astype(dtype or self.dtype, copy=False)
