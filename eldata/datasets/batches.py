"""Whole batches in memory that is used again: what a DataLoader's worker writes, the main process reads where it lies.

torch's default way costs more than the reading: each sample is made, copied into a batch in new shared memory, whose
pages the system must clear, and each small tensor is sent through a socket of its own. Here ``dataset.__getitems__``,
which DataLoaders call with all indices of a batch, writes every sample into its place in one piece of shared memory;
torch's default collate finds the batch ready (:func:`_collate`, by torch's documented ``default_collate_fn_map``). The
main process's tensors lie in the same memory. When the last of them is gone, the worker uses it for another batch.

With a collate function of one's own, or where the system has no ``memfd_create``, all works as with any dataset. Single
samples and batches that no worker makes lie in memory that is used again too: new pages cost as much as the reading.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import os
import threading
import weakref
from functools import cache
from multiprocessing.reduction import ForkingPickler
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch.utils.data import default_collate, get_worker_info
from torch.utils.data._utils.collate import default_collate_fn_map

from eldata.base.numbers import available_cpus

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

# Free pieces of memory that a process keeps for its next batches: those that come back while it reads ahead.
_MOST_FREE = 4
# Pieces that may be held at once, two descriptors each: who keeps more batches than that gets torch's own memory.
_MOST_HELD = 64
_ALIGNED = 64
_FEW_VALUES = 1 << 16  # of a sample, below which its reading is mostly Python
_HEADER_BYTES = 4096  # how often the piece came back, int64; a page, so that the rest begins on one


class Field(NamedTuple):
    """A tensor of a batch: its name, its shape with the number of samples first, its dtype as numpy calls it."""

    name: str
    shape: tuple[int, ...]
    dtype: str

    @property
    def nbytes(self) -> int:
        """Bytes, without those that align the next one."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


def threads_here() -> int | None:
    """Choose the number of threads that make a batch, as :func:`eldata.base.compiled.in_threads` takes them.

    One in a worker: the workers share the CPUs already.
    """
    return None if get_worker_info() is None else 1


def reading_threads(samples: int, values: int) -> int:
    """Choose the number of threads that read samples of a store, as :func:`eldata.base.compiled.in_threads` takes them.

    More of them wait for Python's lock, and of a compressed store for HDF5's: measured on four cores, one is the
    fastest for a sample and two for a batch of eight. Where a sample has few ``values``, there is little else than that
    lock.
    """
    if values < _FEW_VALUES:
        return 1
    return 1 if samples == 1 or get_worker_info() is not None else min(2, available_cpus())


def new_batch(fields: Sequence[Field]) -> Batch | None:
    """Return a batch to be filled; ``None`` if there is no such memory, so that samples must be made one by one.

    In a DataLoader's worker it can be sent without a copy.
    """
    taken = _own_pieces(_Piece if get_worker_info() is None else _SharedPiece).take(_count_bytes(fields))
    return None if taken is None else Batch(fields, *taken)


def new_arrays(fields: Sequence[Field]) -> dict[str, NDArray[Any]]:
    """Return arrays to be filled, by name: memory that is used again if there is some free, for one sample."""
    taken = _own_pieces(_Piece).take(_count_bytes(fields))
    if taken is None:
        return {field.name: np.empty(field.shape, field.dtype) for field in fields}
    return _lay_out_arrays(fields, taken[1])


class Batch:
    """A batch to be filled: ``arrays`` by name, in the memory that its samples and its tensors share."""

    def __init__(self, fields: Sequence[Field], piece: _Piece, lease: _Lease) -> None:
        self.fields = tuple(fields)
        self.count = self.fields[0].shape[0]
        self.shapes = {field.name: field.shape[1:] for field in self.fields}
        self.piece = piece
        self.arrays = _lay_out_arrays(self.fields, lease)
        self.tensors = {name: torch.from_numpy(array) for name, array in self.arrays.items()}

    def parts(self, samples: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Return the samples with views of the batch as their large tensors, whatever ``samples`` hold of these."""
        views = {name: tensor.unbind() for name, tensor in self.tensors.items()}
        return [
            _Part(self, place, sample, {name: views[name][place] for name in sample if name in views})
            for place, sample in enumerate(samples)
        ]


class _Part(dict[str, Any]):
    """A sample of a batch, with its place there; or all of it, collated, in a worker. Copied, it is a plain dict."""

    def __init__(
        self, batch: Batch, place: int | None, content: Mapping[str, Any], views: Mapping[str, torch.Tensor]
    ) -> None:
        super().__init__(content)
        self.update(views)
        self.batch, self.place, self.views = batch, place, views

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)

    def is_whole(self) -> bool:
        """Check that every view is still the batch's own tensor."""
        return all(self.get(name) is view for name, view in self.views.items())


def _collate(parts: Sequence[_Part], *, collate_fn_map: Any = None) -> dict[str, Any]:
    """Collate as torch does; the parts of one batch, in order, are collated already."""
    del collate_fn_map
    batch = parts[0].batch
    places = [part.place for part in parts if type(part) is _Part and part.batch is batch and part.is_whole()]
    if len(places) != len(parts) or places != list(range(batch.count)):
        collated: dict[str, Any] = default_collate([dict(part) for part in parts])
        return collated
    content = {
        name: batch.tensors[name] if name in batch.tensors else _collate_values([part[name] for part in parts])
        for name in parts[0]
    }
    return _Part(batch, None, content, batch.tensors) if isinstance(batch.piece, _SharedPiece) else content


def _collate_values(values: list[Any]) -> Any:
    """Collate the samples' small values of one name as torch does, but without its slow search for the right way."""
    kinds = set(map(type, values))
    if kinds == {str}:
        return values
    return torch.from_numpy(np.array(values)) if kinds in ({float}, {int}) else default_collate(values)


def _reduce_batch(whole: _Part) -> tuple[Any, ...]:
    """Pickle a collated batch as its place in memory and its small values, so that the queue sends no copy."""
    batch = whole.batch
    if whole.place is not None or not whole.is_whole() or not isinstance(batch.piece, _SharedPiece):
        return whole.__reduce__()
    others = {
        name: value.numpy() if isinstance(value, torch.Tensor) else value
        for name, value in whole.items()
        if name not in batch.tensors
    }
    return _receive_batch, (batch.piece.duplicate_descriptor(), batch.piece.size, batch.fields, others, tuple(whole))


default_collate_fn_map[_Part] = _collate
ForkingPickler.register(_Part, _reduce_batch)


def _receive_batch(
    descriptor: Any, size: int, fields: tuple[Field, ...], others: Mapping[str, Any], order: tuple[str, ...]
) -> dict[str, Any]:
    """Rebuild a batch that another process wrote, when it is unpickled in the process that reads it."""
    number = descriptor.detach()
    try:
        memory = mmap.mmap(number, size)
    finally:
        os.close(number)
    lease = _Lease(memory)
    weakref.finalize(lease, _give_back, os.getpid(), memory).atexit = False
    content = dict(others) | _lay_out_arrays(fields, lease)
    tensors = {name: torch.from_numpy(value) for name, value in content.items() if isinstance(value, np.ndarray)}
    return {name: tensors.get(name, content[name]) for name in order}


# --- memory -----------------------------------------------------------------------------------------------------------


class _Lease:
    """What arrays on a piece of memory hold on to, and torch's tensors by them: when it goes, nobody reads any more."""

    def __init__(self, memory: mmap.mmap) -> None:
        self.memory = memory
        self.__array_interface__ = {
            "data": (ctypes.addressof(ctypes.c_char.from_buffer(memory)), False),
            "shape": (len(memory),),
            "typestr": "|u1",
            "version": 3,
        }


def _give_back(process: int, memory: mmap.mmap) -> None:
    """Count one more return, for the process that the memory comes from. Only this process ever counts."""
    if os.getpid() == process:  # a fork has copies of the arrays, whose end says nothing about the first ones
        counter = np.frombuffer(memory, np.int64, 1)
        counter += 1


class _Piece:
    """Memory of this process: free, or held by arrays on it."""

    is_supported = True

    def __init__(self, size: int) -> None:
        self.size = size
        self._memory = self._map_memory()
        self._lease: weakref.ref[_Lease] | None = None

    def _map_memory(self) -> mmap.mmap:
        """Map memory of the piece's size for this process."""
        private = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_PRIVATE") else {}
        return mmap.mmap(-1, self.size, **private)

    def lease(self) -> _Lease:
        """Lease this piece, which must be free: it is not used again while the lease lives."""
        lease = _Lease(self._memory)
        self._lease = weakref.ref(lease)
        return lease

    def is_free(self) -> bool:
        """Tell whether no array on it is left."""
        return self._lease is None or self._lease() is None


class _SharedPiece(_Piece):
    """Memory that the process that it was sent to may hold as well."""

    is_supported = hasattr(os, "memfd_create")

    def __init__(self, size: int) -> None:
        self._descriptor = -1
        self._times_sent = 0
        super().__init__(size)

    def _map_memory(self) -> mmap.mmap:
        """Map memory behind a file descriptor, which other processes can be sent."""
        self._descriptor = os.memfd_create("eldata-batch", os.MFD_CLOEXEC)
        weakref.finalize(self, os.close, self._descriptor).atexit = False
        os.ftruncate(self._descriptor, self.size)
        return mmap.mmap(self._descriptor, self.size)

    def duplicate_descriptor(self) -> Any:
        """Return the piece's descriptor for another process, which will hold it."""
        from multiprocessing.reduction import DupFd  # only where there is memfd_create, so not on Windows

        self._times_sent += 1
        return DupFd(self._descriptor)

    def is_free(self) -> bool:
        """Tell whether no array on it is left, here or there."""
        times_returned = int(np.frombuffer(self._memory, np.int64, 1)[0])
        return super().is_free() and times_returned == self._times_sent


class _Pieces:
    """The pieces of one kind that this process has."""

    def __init__(self, kind: type[_Piece]) -> None:
        self._kind = kind
        self._lock = threading.Lock()
        self.all: list[_Piece] = []

    def take(self, size: int) -> tuple[_Piece, _Lease] | None:
        """Return a free piece that is large enough but not far too large; or a new one, unless many are held."""
        if not self._kind.is_supported:
            return None
        with self._lock:
            free = [piece for piece in self.all if piece.is_free()]
            taken = next((piece for piece in reversed(free) if size <= piece.size <= 2 * size), None)
            idle = [piece for piece in free if piece is not taken]
            dropped = {*idle[: max(0, len(idle) - _MOST_FREE)], taken}  # those that were not used for longest
            self.all = [piece for piece in self.all if piece not in dropped]
            if taken is None:
                if len(self.all) >= _MOST_HELD:
                    return None
                taken = self._kind(-(-size // mmap.PAGESIZE) * mmap.PAGESIZE)
            self.all.append(taken)
            return taken, taken.lease()


@cache
def _own_pieces(kind: type[_Piece]) -> _Pieces:
    """Make this process's only collection of pieces of a kind."""
    return _Pieces(kind)


if hasattr(os, "register_at_fork"):  # those are the parent's
    os.register_at_fork(after_in_child=_own_pieces.cache_clear)


def _count_bytes(fields: Sequence[Field]) -> int:
    """Count the bytes of a piece for these arrays: header and aligned contents."""
    return _HEADER_BYTES + sum(-(-field.nbytes // _ALIGNED) * _ALIGNED for field in fields)


def _lay_out_arrays(fields: Sequence[Field], lease: _Lease) -> dict[str, NDArray[Any]]:
    """Lay out arrays one after the other behind the header; each holds the lease."""
    content = np.asarray(lease)
    arrays: dict[str, NDArray[Any]] = {}
    start = _HEADER_BYTES
    for field in fields:
        arrays[field.name] = content[start : start + field.nbytes].view(field.dtype).reshape(field.shape)
        start += -(-field.nbytes // _ALIGNED) * _ALIGNED
    return arrays
