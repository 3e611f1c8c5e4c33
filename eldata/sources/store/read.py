"""Opening a store, and reading parts of its frames."""

from __future__ import annotations

import math
import mmap
import os
import threading
import weakref
import zlib
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from eldata.base.compiled import scratch
from eldata.base.fields import no_search_for_cycles
from eldata.base.files import file_problem
from eldata.errors import DatasetError, EldataError
from eldata.manifest.catalogue import load_manifest
from eldata.manifest.pairs import Choice
from eldata.protocols.named import default_protocol
from eldata.records import FrameRecord, Records
from eldata.sources.frames import Frame, Pixels, part_shape
from eldata.sources.store.format import (
    COMPRESSIONS,
    FORMAT,
    VERSION,
    Store,
    StoreError,
    frames_in,
    layout,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.manifest.catalogue import Manifest
    from eldata.raw.levels import FrameLevels
    from eldata.records import PairRecord

# A finished store is never written again, so readers need no lock, which some network disks do not have. But HDF5 opens
# a file twice in one process only if both ask for the same: h5py's own default, or what the user's code says.
_LOCKING = (False, None, True, "best-effort")
# Enough for the chunks of a few rows of a crop; a read visits each chunk once. HDF5 frees it with the frame.
_CHUNK_CACHE_BYTES = 1 << 20
# Frames that a process keeps open: to look one up takes HDF5 a tenth of a millisecond.
_MOST_OPEN = 4096
_BEGIN_AGAIN = "; replace a store by renaming the new one, and begin again"


def open_store(path: Path | str) -> Store:
    """Read what a store holds, without pixels.

    Raises
    ------
    StoreError
        If the file is missing, truncated, damaged, not a store, or of another version.
    ArgumentError
        If it is compressed and hdf5plugin is not installed.
    """
    path = Path(path)
    with opened(path) as file, no_search_for_cycles():
        try:
            manifest = _manifest(path, file)
            frames = frames_in(_facts(file))
            listed, there = int(file.attrs["files"]), len(file["frames"])
            header = texts_of(file.attrs)
            told = header["dataset"], header["compression"], int(header["facts_crc32"])
        except (OSError, RuntimeError, ValueError, LookupError, TypeError, EldataError) as error:
            raise _damaged(path, error) from error
    if not len(frames) == listed == there:
        raise _damaged(path, f"expected {listed} frames, found {min(len(frames), there)}")
    return Store(path, *told, manifest, Records(frames))


def opened(path: Path) -> h5py.File:
    """Open a store's HDF5 file for reading; raises like :func:`open_store`."""
    problem = file_problem(path)
    if problem is not None:
        raise StoreError(path, problem)
    if not h5py.is_hdf5(path):
        raise StoreError(path, "is not an HDF5 file; eldata pack makes stores")
    file = _open(path)
    try:
        _check_header(path, texts_of(file.attrs))
    except BaseException as error:  # Ctrl-C too: the caller gets no file that it could close
        file.close()
        if isinstance(error, EldataError) or not isinstance(error, Exception):
            raise
        # HDF5 looks at what it reads while it reads it, and h5py raises many kinds.
        raise _damaged(path, error) from error
    return file


def texts_of(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a store's attributes, whose texts lie in them as bytes: texts of any length HDF5 keeps in a heap.

    That is searched by what it says of itself, where it is damaged for ever.
    """
    return {name: value.decode() if isinstance(value, bytes) else value for name, value in attributes.items()}


def _open(path: Path, lockings: Sequence[Any] = _LOCKING) -> h5py.File:
    try:
        return h5py.File(path, "r", locking=lockings[0], rdcc_nbytes=_CHUNK_CACHE_BYTES)
    except OSError as error:
        if "flag values don't match" in str(error) and len(lockings) > 1:
            return _open(path, lockings[1:])
        reason = "is truncated" if "truncated" in str(error) else "is damaged"
        raise StoreError(path, f"{reason} ({error}); copy or pack it again") from error


def _check_header(path: Path, header: Mapping[str, Any]) -> None:
    if header.get("format") != FORMAT:
        raise StoreError(path, "is an HDF5 file, but not a store of eldata; eldata pack makes stores")
    version = int(header["version"])
    if version != VERSION:
        advice = "install a newer one" if version > VERSION else "pack it again"
        raise StoreError(
            path,
            f"is a store of version {version}, written by {header.get('written_by')}; this eldata reads version "
            f"{VERSION}: {advice}",
        )
    compression = next((name for name in COMPRESSIONS if name == header.get("compression")), None)
    if compression is None:
        raise StoreError(path, f"has the unknown compression {header.get('compression')!r}; is it damaged?")
    layout((), compression)  # HDF5 must know it before it reads, in each process


def _damaged(path: Path, what: object) -> StoreError:
    return StoreError(path, f"is damaged ({what}); copy or pack it again")


def _facts(file: h5py.File) -> bytes:
    facts: bytes = file["facts"][:].tobytes()
    if zlib.crc32(facts) != file.attrs["facts_crc32"]:
        raise ValueError("what it states of its frames is not what was written")
    return facts


def _manifest(path: Path, file: h5py.File) -> Manifest | None:
    if "manifest" not in file:
        return None
    rows, card = (file[f"manifest/{name}"][:].tobytes() for name in ("csv", "json"))
    return replace(load_manifest(path / "manifest.csv", (rows, card)), path=path)


# --- pixels -------------------------------------------------------------------------------------------------------


# Held while frames are looked up, while HDF5 reads, and over a fork: a child has no thread that would let it go.
_LOCK = threading.RLock()
_READERS: weakref.WeakSet[PixelReader] = weakref.WeakSet()


class PixelReader:
    """Reads parts of a store's frames, in any process and in several threads at once.

    An uncompressed store is mapped. HDF5 reads a compressed one, one thread at a time. Either way the file is opened in
    each process that reads, on its first read: a fork closes HDF5's, and a pickled reader opens it again. Memory does
    not grow with the store.
    """

    def __init__(self, path: Path, facts_crc32: int) -> None:
        self.path, self._identity = path, facts_crc32
        self._opened: _Opened | None = None
        with _LOCK:
            _READERS.add(self)

    def read(self, key: str, rows: slice, columns: slice) -> NDArray[np.uint16]:
        """Return a part of a frame, (..., rows, columns) in DN, not to be written to.

        Of a compressed store it lies in memory that the thread's next read overwrites: the pages of new memory cost as
        much as the reading.

        Raises
        ------
        StoreError
            If the store cannot be read, lacks some of the frame's pixels, or is not the one that was opened any more.
        """
        try:
            with _LOCK:
                self._opened = self._opened or _Opened(self.path, self._identity)
                self._opened.check_size()
                frame = self._opened.frame(key)
                if isinstance(frame, np.ndarray):
                    return frame[..., rows, columns]
                pixels = scratch("stored", (*frame.shape[:-2], *part_shape(frame.shape, rows, columns)), frame.dtype)
                if pixels.size:
                    frame.read_direct(pixels, (..., rows, columns))
                return pixels
        except EldataError:
            raise
        except (OSError, RuntimeError, KeyError, IndexError, ValueError, TypeError) as error:
            raise StoreError(self.path, f"frame {key} is damaged ({error}); copy or pack it again") from error

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        with _LOCK:
            if self._opened is not None:
                self._opened.file.close()
            self._opened = None

    def __reduce__(self) -> tuple[Any, ...]:
        return PixelReader, (self.path, self._identity)  # opened again where it is unpickled


class _Opened:
    """A store's file, and its mapping, which lives as long as arrays on it."""

    def __init__(self, path: Path, identity: int) -> None:
        self.file = file = opened(path)
        if file.attrs["facts_crc32"] != identity:
            file.close()
            raise StoreError(path, f"is another store than the one that was opened{_BEGIN_AGAIN}")
        with path.open("rb") as descriptor:
            self._content = content = mmap.mmap(descriptor.fileno(), 0, access=mmap.ACCESS_READ)
        self._path, self._size = path, content.size()

        def frame(key: str) -> NDArray[np.uint16] | h5py.Dataset:
            dataset = file["frames"][key]
            expected, found = stored_parts(dataset)
            if found != expected:
                raise ValueError(f"expected {expected}, found {found}")
            if dataset.chunks is not None:
                return dataset
            return np.ndarray(dataset.shape, dataset.dtype, content, dataset.id.get_offset())

        self.frame = lru_cache(_MOST_OPEN)(frame)

    def check_size(self) -> None:
        """Refuse a file whose size is another now: to touch what a mapping has lost ends the process by SIGBUS."""
        now = self._content.size()
        if now != self._size:
            raise StoreError(self._path, f"had {self._size} bytes when it was opened and has {now} now{_BEGIN_AGAIN}")


def stored_parts(dataset: h5py.Dataset) -> tuple[str, str]:
    """Return in how many parts a frame's pixels lie, and how many are there: HDF5 reads zeros for what is not.

    A chunk of no bytes is not there; HDF5 would look for its checksum before its beginning.
    """
    if dataset.chunks is None:
        return "one piece", "nothing" if dataset.id.get_offset() is None else "one piece"
    expected = math.prod(-(-side // of_chunk) for side, of_chunk in zip(dataset.shape, dataset.chunks, strict=True))
    sizes: list[int] = []
    dataset.id.chunk_iter(lambda chunk: sizes.append(chunk.size))
    return f"{expected} chunks", f"{sum(map(bool, sizes))} chunks"


def _before_fork() -> None:
    _LOCK.acquire()
    for reader in list(_READERS):
        reader.close()


def _in_parent() -> None:
    _LOCK.release()


def _in_child() -> None:
    global _LOCK  # noqa: PLW0603 # it is this process's
    _LOCK = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before_fork, after_in_parent=_in_parent, after_in_child=_in_child)


# --- the source of frames -----------------------------------------------------------------------------------------


class StoreFrames:
    """The frames of a store: a :class:`~eldata.sources.frames.FrameSource` that reads only the parts it is asked for.

    Raises
    ------
    StoreError
        If the file is not a store, truncated, or of another version.
    """

    reads_parts = True

    def __init__(self, path: Path | str) -> None:
        self.store = open_store(path)
        self.path = self.store.path
        self._reader = PixelReader(self.path, self.store.facts_crc32)
        self._held = {frame.path: frame for frame in self.store.frames}
        self._before = f"{self.path.as_posix()}/"

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_held": {}}  # of this process's objects

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _held={frame.path: frame for frame in state["store"].frames})

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """The rows of the manifest whose files are held; of clean frames those that they would have."""
        if self.store.manifest is None:
            return tuple(FrameRecord(frame.path, frame.role, frame.sensor.model) for frame in self.store.frames)
        return tuple(record for record in self.store.manifest.records if record.path in self._held)

    def frame(self, path: str) -> Frame:
        """Open a frame by its path, with or without the store's before it.

        Raises
        ------
        DatasetError
            If the store does not hold it.
        """
        held = self._held.get(path.removeprefix(self._before))
        if held is None:
            raise DatasetError(f"{self.path}: holds no frame {path!r}; pack the dataset again")
        name = f"{self._before}{held.path}"
        pixels = Pixels(held.shape, np.dtype(np.uint16), partial(self._reader.read, held.key))
        if not held.sensor.cfa:
            return Frame.of_rgb(pixels, name)
        return Frame.of_raw(pixels, held.sensor, name, held.exposure, held.channel_white_levels_dn)

    @property
    def levels(self) -> FrameLevels:
        """The levels of its frames unless others are asked for: those of the protocol that its set's card names."""
        manifest = self.store.manifest
        return "metadata" if manifest is None else default_protocol(manifest.card).frame_levels

    def pairs(self, choice: Choice) -> tuple[PairRecord, ...]:
        """Return the pairs that are held and chosen.

        Raises
        ------
        DatasetError
            If the store holds clean frames or clips, or only a part of the chosen subset.
        ArgumentError
            If a value is unknown, or no pair is left.
        """
        manifest = self.store.manifest
        if manifest is None:
            raise DatasetError(f"{self.path}: holds clean frames, not pairs; read it with CleanFrames")
        if choice.subset is not None:  # counted on the whole manifest: a store of a part may lack some
            every = Choice(subset=choice.subset).pairs(manifest.records, manifest.card.subsets)
            wanted = {pair.path for pair in every}
            lacking = sorted(wanted - set(self._held))
            if lacking:
                raise DatasetError(
                    f"{self.path}: lacks {len(lacking)} of the {len(wanted)} pairs of the subset {choice.subset!r}, "
                    f"such as {lacking[0]}; pack the whole dataset, or that subset"
                )
            held = [record for record in self.records if record.role != "noisy" or record.path in wanted]
        else:
            held = list(self.records)
        return replace(choice, subset=None).pairs(held)  # it is chosen
