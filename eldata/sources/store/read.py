"""A store of frames for training, one HDF5 file: what it holds, reading parts of its pixels, whether it is whole.

::

    /                   attributes format, version, written_by, dataset, compression, files, facts_crc32
    /manifest/csv       the manifest's bytes, uint8 (not in a store of clean frames)
    /manifest/json      the dataset card's bytes, uint8
    /facts              what the files state, one JSON document, uint8 (:func:`encode_facts`)
    /frames/<n>         one file's visible mosaic, (H, W) uint16 in DN, or a 16-bit RGB frame, (3, H, W) uint16: in one
                        piece, which readers map; compressed, in chunks of 256 x 256 with a checksum each

Frames of clips stand in the order of the clip, its reference before them; the manifest is then the list of these files,
patterns expanded.

Mosaics, not packed planes: the one packer cuts, turns, packs and normalises a crop in one pass, which a packed crop
would need two for, and nothing of the visible area is lost. The facts stand in one place because HDF5 takes a
millisecond for the attributes of each frame.
"""

from __future__ import annotations

import json
import math
import mmap
import zlib
from dataclasses import astuple, dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import h5py
import numpy as np

from eldata.base.compiled import scratch
from eldata.base.fields import TextFile, no_search_for_cycles
from eldata.base.files import file_problem
from eldata.errors import ArgumentError, DatasetError, EldataError, FileError, check_choice
from eldata.manifest.catalogue import Manifest, load_manifest
from eldata.protocols.named import default_protocol
from eldata.records import Exposure, FrameRecord, PairRecord, Records, Role, Sensor
from eldata.sources.frames import Frame, Pixels, part_shape

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from eldata.manifest.pairs import Choice
    from eldata.raw.levels import FrameLevels

FORMAT = "eldata-store"
VERSION = 5
SUFFIXES = (".h5", ".hdf5")

Compression = Literal["none", "lz4", "zstd"]
COMPRESSIONS: tuple[Compression, ...] = get_args(Compression)

_CHUNK = 256
_CHUNK_CACHE_BYTES = 1 << 20  # for the chunks of a few rows of a crop: a read visits each chunk once
_MOST_OPEN = 4096  # frames that a process keeps open: to look one up takes HDF5 a tenth of a millisecond
_BEGIN_AGAIN = "; replace a store by renaming the new one, and begin again"


class StoreError(FileError):
    """A file is not a store, or one that cannot be used."""


@dataclass(frozen=True, slots=True)
class StoredFrame:
    """One frame of a store, without its pixels.

    Attributes
    ----------
    key
        Name of its HDF5 dataset.
    path, role
        The file that it comes from, relative to the dataset's folder, and its role there.
    sha256
        ``sha256:<hex>`` of its pixels, row by row, little-endian.
    sensor, exposure, channel_white_levels_dn
        As the file states them (:class:`eldata.records.RawFrame`); the CFA of RGB is empty.
    """

    key: str
    path: str
    role: Role
    sha256: str
    sensor: Sensor
    exposure: Exposure
    channel_white_levels_dn: tuple[float, ...] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W), of RGB (3, H, W)."""
        size = self.sensor.height, self.sensor.width
        return size if self.sensor.cfa else (3, *size)


class Store:
    """The frames of a store, which ``eldata pack`` made: a :class:`~eldata.sources.frames.FrameSource`.

    Threads and processes, forked ones too, may read at once; a process opens the file on its first read, so memory does
    not grow with the store.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    dataset
        Name of the dataset, or of the folder.
    compression
        ``"none"``, ``"lz4"`` or ``"zstd"``.
    manifest
        The dataset's; ``None`` for a store of clean frames.
    frames
        A :class:`StoredFrame` each.

    Raises
    ------
    StoreError
        If the file is missing, truncated, damaged, not a store, or of another version.
    ArgumentError
        If it is compressed and hdf5plugin is not installed.
    """

    reads_parts = True

    def __init__(self, path: Path | str) -> None:
        self.path = path = Path(path)
        with open_hdf5(path) as file, no_search_for_cycles():
            try:
                header = _texts_of(file.attrs)
                self.dataset: str = header["dataset"]
                self.compression: Compression = header["compression"]
                self.manifest = _read_manifest(path, file)
                crc32, listed, there = int(header["facts_crc32"]), int(header["files"]), len(file["frames"])
                self.frames: tuple[StoredFrame, ...] = Records(decode_facts(file["facts"][:].tobytes(), crc32))
            except (OSError, RuntimeError, ValueError, LookupError, TypeError, EldataError) as error:
                raise _make_damage_error(path, error) from error
        if not len(self.frames) == listed == there:
            raise _make_damage_error(path, f"expected {listed} frames, found {min(len(self.frames), there)}")
        self.reader = PixelReader(path, crc32)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}

    @cached_property
    def _by_path(self) -> dict[str, StoredFrame]:
        """The frames by path."""
        return {frame.path: frame for frame in self.frames}

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """The rows of the manifest whose files are held; of clean frames those that they would have."""
        if self.manifest is None:
            return tuple(FrameRecord(frame.path, frame.role, frame.sensor.model) for frame in self.frames)
        return tuple(record for record in self.manifest.records if record.path in self._by_path)

    def frame(self, path: str) -> Frame:
        """Open a frame by its path, with or without the store's before it.

        Raises
        ------
        DatasetError
            If the store does not hold it.
        """
        prefix = f"{self.path.as_posix()}/"
        held = self._by_path.get(path.removeprefix(prefix))
        if held is None:
            raise DatasetError(f"{self.path}: holds no frame {path!r}; pack the dataset again")
        name = f"{prefix}{held.path}"
        pixels = Pixels(held.shape, np.dtype(np.uint16), partial(self.reader.read, held.key))
        if not held.sensor.cfa:
            return Frame.of_rgb(pixels, name)
        return Frame.of_raw(pixels, held.sensor, name, held.exposure, held.channel_white_levels_dn)

    @property
    def levels(self) -> FrameLevels:
        """The default levels of its frames: of the protocol that its set's card names."""
        return "metadata" if self.manifest is None else default_protocol(self.manifest.card).frame_levels

    def pairs(self, choice: Choice) -> tuple[PairRecord, ...]:
        """Return the pairs that are held and chosen.

        Raises
        ------
        DatasetError
            If the store holds clean frames, none of the chosen pairs, or only a part of the chosen subset.
        ArgumentError
            If a value is unknown, or no pair is left.
        """
        if self.manifest is None:
            raise DatasetError(f"{self.path}: holds clean frames, not pairs; read it with CleanFrames")
        chosen = choice.pairs(self.manifest.records, self.manifest.card.subsets)
        lacking = [pair.path for pair in chosen if pair.path not in self._by_path]
        if lacking and (choice.subset is not None or len(lacking) == len(chosen)):
            raise DatasetError(
                f"{self.path}: lacks {len(lacking)} of the {len(chosen)} chosen pairs, such as {lacking[0]}; pack the "
                "whole dataset, or that part"
            )
        return tuple(pair for pair in chosen if pair.path in self._by_path)


def open_hdf5(path: Path) -> h5py.File:
    """Open a store's HDF5 file for reading; raises like :class:`Store`."""
    problem = file_problem(path)
    if problem is None and not h5py.is_hdf5(path):
        problem = "is not an HDF5 file; eldata pack makes stores"
    if problem is not None:
        raise StoreError(path, problem)
    options = {"mode": "r", "rdcc_nbytes": _CHUNK_CACHE_BYTES}
    try:
        try:  # without a lock, which some network disks do not have: a finished store is never written again
            file = h5py.File(path, locking=False, **options)
        except OSError as error:
            if "flag values don't match" not in str(error):
                raise
            file = h5py.File(path, **options)  # the caller's own h5py holds it open, with a lock
        _check_header(path, _texts_of(file.attrs))
    except EldataError:
        raise
    except Exception as error:  # HDF5 looks at what it reads while it reads it, and h5py raises many kinds
        raise _make_damage_error(path, error) from error
    return file


def _check_header(path: Path, header: Mapping[str, Any]) -> None:
    """Refuse a file that is not a store, or has another version or an unknown compression."""
    if header.get("format") != FORMAT:
        raise StoreError(path, "is an HDF5 file, but not a store of eldata; eldata pack makes stores")
    version = int(header["version"])
    if version != VERSION:
        writer, advice = header.get("written_by"), "install a newer one" if version > VERSION else "pack it again"
        raise StoreError(
            path, f"is a store of version {version}, written by {writer}; this eldata reads version {VERSION}: {advice}"
        )
    if header["compression"] not in COMPRESSIONS:
        raise StoreError(path, f"has the unknown compression {header['compression']!r}; is it damaged?")
    hdf5_layout((), header["compression"])  # HDF5 must know it before it reads, in each process


def _texts_of(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a store's attributes. Texts are bytes there: HDF5's own lie in a heap that damage makes endless."""
    return {name: value.decode() if isinstance(value, bytes) else value for name, value in attributes.items()}


def _read_manifest(path: Path, file: h5py.File) -> Manifest | None:
    """Read the manifest in a store; ``None`` if the store holds clean frames."""
    if "manifest" not in file:
        return None
    rows, card = (file[f"manifest/{name}"][:].tobytes() for name in ("csv", "json"))
    return replace(load_manifest(path / "manifest.csv", (rows, card)), path=path)


def _make_damage_error(path: Path, what: object) -> StoreError:
    """Make the error that reports a damaged store."""
    return StoreError(path, f"is damaged ({what}); copy or pack it again")


def hdf5_layout(shape: tuple[int, ...], compression: Compression) -> Mapping[str, Any]:
    """Return h5py's options for the layout of a frame, (H, W) or (3, H, W), once HDF5 knows the compression.

    HDF5's checksums find damage before the compression's filter, which believes what a chunk says of itself, sees it.

    Raises
    ------
    ArgumentError
        If the name is unknown, or hdf5plugin is not installed.
    """
    check_choice("compression", compression, COMPRESSIONS)
    if compression == "none":
        return {}
    try:
        import hdf5plugin  # registers its filters with HDF5 as it is imported
    except ImportError as error:
        raise ArgumentError(
            f"compression {compression!r} needs the package hdf5plugin: pip install 'eldata[compression]'"
        ) from error
    chunks = (1,) * (len(shape) - 2) + tuple(min(_CHUNK, side) for side in shape[-2:])
    return {"chunks": chunks, "fletcher32": True, **hdf5plugin.Bitshuffle(cname=compression)}


# --- facts --------------------------------------------------------------------------------------------------------


def encode_facts(frames: Iterable[StoredFrame]) -> bytes:
    """Write all facts of frames but their pixels as JSON; what several state alike stands there once.

    ``{"sensors": [[fields, whites], ...], "exposures": [fields, ...], "frames": [[path, role, sha256, sensor's number,
    exposure's number], ...]}``. An exposure's numbers are fractions' texts.
    """
    sensors: dict[str, int] = {}
    exposures: dict[str, int] = {}
    rows = []
    for frame in frames:
        sensor = json.dumps((astuple(frame.sensor), frame.channel_white_levels_dn))
        exposure = json.dumps(astuple(frame.exposure), default=str)
        numbers = sensors.setdefault(sensor, len(sensors)), exposures.setdefault(exposure, len(exposures))
        rows.append([frame.path, frame.role, frame.sha256, *numbers])
    lists = ",".join(sensors), ",".join(exposures), json.dumps(rows)
    return '{{"sensors":[{}],"exposures":[{}],"frames":{}}}'.format(*lists).encode()


def decode_facts(facts: bytes, crc32: int) -> list[StoredFrame]:
    """Return the frames that :func:`encode_facts` wrote; ValueError, LookupError or TypeError for anything else."""
    if zlib.crc32(facts) != crc32:
        raise ValueError("what it states of its frames is not what was written")
    data = TextFile("facts", ArgumentError, content=facts).json().data
    sensors = [(Sensor(*map(_to_tuples, fields)), _to_tuples(whites)) for fields, whites in data["sensors"]]
    exposures = [Exposure(*(text and Fraction(text) for text in texts)) for texts in data["exposures"]]
    frames = []
    for number, (path, role, sha256, sensor, exposure) in enumerate(data["frames"]):
        key, stated = frame_key(number), (sensors[sensor][0], exposures[exposure], sensors[sensor][1])
        frames.append(StoredFrame(key, path, role, sha256, *stated))
    return frames


def frame_key(number: int) -> str:
    """Return the name of a frame's HDF5 dataset, by its place in the order in which frames were packed."""
    return f"{number:06d}"


def _to_tuples(value: Any) -> Any:
    """Convert JSON's lists to tuples, as records have them."""
    return tuple(map(_to_tuples, value)) if isinstance(value, list) else value


# --- pixels -------------------------------------------------------------------------------------------------------


class PixelReader:
    """Reads parts of a store's frames: of a mapping, or of a compressed store by HDF5, one thread at a time.

    Parameters
    ----------
    path
        The store.
    facts_crc32
        That of the store that was opened: another one under its name is refused.
    """

    def __init__(self, path: Path, facts_crc32: int) -> None:
        self.path, self.facts_crc32 = path, facts_crc32
        self._file: h5py.File | None = None
        self._content: mmap.mmap | None = None  # lives as long as arrays on it
        self._opened: dict[str, NDArray[np.uint16] | h5py.Dataset] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return PixelReader, (self.path, self.facts_crc32)  # opened again where it is unpickled

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
            return self._read_part(key, rows, columns)
        except EldataError:
            raise
        except (OSError, RuntimeError, KeyError, IndexError, ValueError, TypeError) as error:
            raise StoreError(self.path, f"frame {key} is damaged ({error}); copy or pack it again") from error

    def _read_part(self, key: str, rows: slice, columns: slice) -> NDArray[np.uint16]:
        """Read rows and columns of a frame; refuse a file whose size has changed since it was opened."""
        content = self._content or self._open()
        now = content.size()
        if now != len(content):  # to touch what a mapping has lost ends the process by SIGBUS
            reason = f"had {len(content)} bytes when it was opened and has {now} now{_BEGIN_AGAIN}"
            raise StoreError(self.path, reason)
        frame = self._opened.get(key)
        if frame is None:
            frame = self._open_pixels(key)
        if isinstance(frame, np.ndarray):
            return frame[..., rows, columns]
        pixels = scratch("stored", (*frame.shape[:-2], *part_shape(frame.shape, rows, columns)), frame.dtype)
        if pixels.size:
            frame.read_direct(pixels, (..., rows, columns))
        return pixels

    def _open(self) -> mmap.mmap:
        """Open the file. A forked process reads it on: h5py forks when none of its calls is under way."""
        file = open_hdf5(self.path)
        if file.attrs["facts_crc32"] != self.facts_crc32:
            raise StoreError(self.path, f"is another store than the one that was opened{_BEGIN_AGAIN}")
        content = mmap.mmap(file.id.get_vfd_handle(), 0, access=mmap.ACCESS_READ)
        self._file, self._content = file, content
        return content

    def _open_pixels(self, key: str) -> NDArray[np.uint16] | h5py.Dataset:
        """Open a frame's pixels: as mapped memory if they are not compressed, else as an HDF5 dataset."""
        dataset = self._file["frames"][key]  # type: ignore[index] # it is open
        expected, found = count_parts(dataset)
        if found != expected:
            raise ValueError(f"expected {expected}, found {found}")
        if dataset.chunks is None:
            dataset = np.ndarray(dataset.shape, dataset.dtype, self._content, dataset.id.get_offset())
        if len(self._opened) >= _MOST_OPEN:
            self._opened.clear()
        self._opened[key] = dataset
        return dataset


def count_parts(dataset: h5py.Dataset) -> tuple[str, str]:
    """Count the parts that a frame's pixels should have, and those in the file: HDF5 reads a missing one as zeros.

    A chunk of no bytes is missing; HDF5 would look for its checksum before its beginning.
    """
    if dataset.chunks is None:
        return "one piece", "nothing" if dataset.id.get_offset() is None else "one piece"
    expected = math.prod(-(-side // of_chunk) for side, of_chunk in zip(dataset.shape, dataset.chunks, strict=True))
    sizes: list[int] = []
    dataset.id.chunk_iter(lambda chunk: sizes.append(chunk.size))
    return f"{expected} chunks", f"{sum(map(bool, sizes))} chunks"
