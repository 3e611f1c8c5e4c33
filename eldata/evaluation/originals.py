"""A dataset's own frames, for scoring: decoded from its raw files, or read from a store that holds the same pixels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.files import inside
from eldata.base.pixels import rgb_frame
from eldata.base.workers import require_files
from eldata.errors import ArgumentError, DatasetError, RawFileError
from eldata.manifest.catalogue import FrameFiles
from eldata.manifest.clip_checks import size_findings
from eldata.manifest.verify import header_findings, ratio_findings
from eldata.manifest.verify_report import Problem, row_fault
from eldata.raw.cfa import pack
from eldata.raw.levels import CLIP_RANGES, packed_black_level_dn, packed_frame, with_levels
from eldata.records import RawFrame, RawHeader
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.isp.rendering import Response
    from eldata.manifest.catalogue import Manifest
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Clip, Levels
    from eldata.raw.stated import StatedFile
    from eldata.records import FrameRecord
    from eldata.sources.store.format import StoredFrame
    from eldata.sources.store.read import PixelReader

_AGAIN = "pack the dataset again (eldata pack)"


@dataclass(frozen=True, slots=True)
class Originals:
    """Where a dataset's frames come from.

    Attributes
    ----------
    files
        The dataset's, below an absolute folder.
    store
        The store that is read in place of its files, absolute; ``None``: the files are decoded.
    held
        What the store holds of the frames that are asked for, by their paths.
    stated
        What a result says of the store; empty of files.
    """

    files: FrameFiles
    store: Path | None = None
    held: Mapping[str, StoredFrame] = field(default_factory=dict)
    stated: dict[str, str] = field(default_factory=dict)

    @classmethod
    def opened(cls, files: FrameFiles | Path, store: Path | None) -> Originals:
        """Return all frames of a dataset whose files, or store, an evaluation has checked."""
        from eldata.sources.store.read import open_store

        held = {} if store is None else {frame.path: frame for frame in open_store(store).frames}
        files = FrameFiles(files) if isinstance(files, Path) else files
        return cls(files.absolute(), None if store is None else store.absolute(), held)

    def of(self, paths: Collection[str]) -> Originals:
        """Return the same for these frames alone: what a worker gets."""
        if self.store is None:
            return replace(self, files=self.files.only(paths))
        return replace(self, held={path: self.held[path] for path in paths})

    def place(self, path: str) -> Path:
        """Return what messages call a frame.

        Raises
        ------
        ManifestError
            If a file's path leads out of the folder.
        """
        return inside(self.files.folder, path) if self.store is None else self.store / path

    def _file(self, path: str) -> Path | StatedFile:
        return self.files.at(path) if path in self.files.stated else self.place(path)

    def require(self, path: str) -> None:
        """Raise :class:`~eldata.base.workers.UnseenFileError` unless this machine sees where a frame is read from."""
        require_files(self.place(path) if self.store is None else self.store)

    def raw(self, path: str) -> RawFrame:
        """Return a decoded frame.

        Raises
        ------
        RawFileError
            If it cannot be decoded; or if the store's pixels are not those that were packed.
        """
        from eldata.raw.reading import read_raw

        if self.store is None:
            return read_raw(self._file(path))
        return _stored_frame(self.store, self.held[path])

    def header(self, path: str) -> RawHeader:
        """Return what a frame's file says of itself."""
        from eldata.raw.reading import read_header

        return read_header(self._file(path)) if self.store is None else _header(self.store, self.held[path])

    def rgb(self, path: str) -> NDArray[np.float32]:
        """Return a frame of preprocessed RGB, (3, h, w) in [0, 1]; of files alone."""
        return rgb_frame(self.place(path))

    def rendered(self, path: str) -> NDArray[np.float32]:
        """Return LibRaw's rendering of a raw file, (3, H, W) in [0, 1] of 256 levels; of files alone.

        Raises
        ------
        RawFileError
            If the file cannot be rendered (:func:`eldata.isp.libraw.render_libraw`).
        """
        from eldata.isp.libraw import render_libraw

        pixels = np.ascontiguousarray(render_libraw(self.place(path)).transpose(2, 0, 1)).astype(np.float32)
        pixels /= np.float32(255)
        return pixels


def _stored_frame(store: Path, held: StoredFrame) -> RawFrame:
    from eldata.sources.store.build import pixels_digest
    from eldata.sources.store.format import StoreError

    place = store / held.path
    try:
        mosaic = _reader(store).read(held.key, slice(None), slice(None)).copy()
    except StoreError as error:
        raise RawFileError(place, f"cannot be read from the store: {error.reason}") from error
    if pixels_digest(mosaic) != held.sha256:
        raise RawFileError(place, "the store's pixels are not those that were packed; copy or pack it again")
    return RawFrame(place, mosaic, held.sensor, held.exposure, held.channel_white_levels_dn)


def _header(store: Path, held: StoredFrame) -> RawHeader:
    return RawHeader(store / held.path, held.sensor.make, held.sensor.model, held.exposure)


@lru_cache(maxsize=4)
def _reader(store: Path) -> PixelReader:
    """Return the reader of a store, which keeps it open; pixels of one that was replaced have another digest."""
    from eldata.sources.store.read import PixelReader

    return PixelReader(store)


# --- as protocols take them ----------------------------------------------------------------------------------------


def normalised_frame(frame: RawFrame, levels: Levels, *, clip: Clip, gain: float = 1.0) -> NDArray[np.float32]:
    """Return a frame packed, normalised with a protocol's levels, clipped, amplified and clipped again.

    Parameters
    ----------
    frame
        A decoded frame.
    levels
        As :attr:`eldata.protocols.Protocol.levels` has them; ``metadata-per-channel`` means the frame's one white level
        where LibRaw states none for each channel.
    clip, gain
        As :func:`eldata.raw.levels.pack_normalised` has them.

    Returns
    -------
    ndarray
        (C, h, w) float32.

    Raises
    ------
    ArgumentError
        If the levels or the gain are invalid.
    """
    if levels != "metadata-per-channel":
        return packed_frame(frame, levels=levels, clip=clip, gain=gain)
    whites = frame.channel_white_levels_dn
    if whites is None or len(set(whites)) == 1:
        white = frame.sensor.white_level_dn if whites is None else whites[0]
        leveled = replace(frame, sensor=replace(frame.sensor, white_level_dn=white))
        return packed_frame(leveled, levels="metadata", clip=clip, gain=gain)
    cfa = frame.sensor.cfa
    black = packed_black_level_dn(cfa, frame.sensor.black_level_dn)[:, None, None]
    white_of = packed_black_level_dn(cfa, whites)[:, None, None]  # one level per CFA channel, like black
    if not np.all(white_of > black):
        raise ArgumentError(f"a white level of {whites} DN is not above its black level")
    low, high = (np.float32(limit) for limit in CLIP_RANGES[clip])
    packed = pack(frame.mosaic, cfa).astype(np.float32)
    packed -= black
    packed /= white_of - black
    np.clip(packed, low, high, out=packed)
    if gain != 1.0:
        packed *= np.float32(gain)
        np.clip(packed, low, high, out=packed)
    return packed


def rendered_frame(packed: NDArray[np.floating[Any]], frame: RawFrame, response: Response) -> NDArray[np.float64]:
    """Return a frame's packed image in sRGB by the ELD paper's pipeline, with the colours that its file states.

    (3, h, w) in [0, 1], of 256 levels, which float32 would move by more than scores are told apart.
    Raises :class:`ArgumentError` as :func:`eldata.isp.rendering.render_to_8_bits` does.
    """
    from eldata.isp.rendering import render_to_8_bits

    return render_to_8_bits(packed, frame.sensor, response=response) / 255.0


def levels_dn(frame: RawFrame, levels: Levels) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the black and the white levels in DN, one per CFA channel, that :func:`normalised_frame` takes."""
    sensor = frame.sensor
    if levels != "metadata-per-channel":
        sensor = with_levels(sensor, levels)
    white = (sensor.white_level_dn,) * len(sensor.black_level_dn)
    whites = frame.channel_white_levels_dn if levels == "metadata-per-channel" else None
    if whites is None or len(set(whites)) == 1:
        return sensor.black_level_dn, white if whites is None else whites[:1] * len(white)
    return sensor.black_level_dn, whites


def less_shading(frame: RawFrame, shading: DarkShading, name: str) -> RawFrame:
    """Return a frame less a dark shading, its mosaic in float32 DN; ``name`` is for messages.

    Raises
    ------
    DatasetError
        As :meth:`eldata.sources.frames.Frame.less` does.
    """
    less = Frame.of_raw(frame.mosaic, frame.sensor, name, frame.exposure).less(shading)
    return replace(frame, mosaic=less.read(slice(None), slice(None)).copy())


# --- is a store one of these files? -----------------------------------------------------------------------------------


def store_of(manifest: Manifest, folder: Path, store: Path, records: Sequence[FrameRecord]) -> Originals:
    """Return a store in place of the raw files of these rows.

    What ``eldata verify --level metadata`` compares of files is compared of what the store kept of them: their size,
    camera, ISO, exposure and ratio; and their digest, where the manifest states it. A raw file that lies in the
    dataset's folder has to have the size of the one that was packed.

    Raises
    ------
    StoreError, ArgumentError
        If it is not a store that can be read.
    DatasetError
        If it lacks a frame, holds other than whole mosaics in DN, or was packed from other files.
    """
    from eldata.sources.store.build import structure_problems
    from eldata.sources.store.read import open_store

    opened = open_store(store)
    held = {frame.path: frame for frame in opened.frames}
    wanted = {record.path: record for record in records}
    lacking = [path for path in wanted if path not in held]
    if lacking:
        raise DatasetError(
            f"{store}: holds {opened.dataset}, and lacks {len(lacking)} of the {len(wanted)} frames that are to be "
            f"scored, such as {lacking[0]}; pack them all, or score the files (without --store)"
        )
    taken = {path: held[path] for path in wanted}
    _refuse(store, (problem for problem in structure_problems(opened) if problem.path in taken))
    findings = [finding for path, record in wanted.items() for finding in _file_findings(folder, record, taken[path])]
    products = {}
    for path, record in wanted.items():
        found, products[path] = header_findings(
            _header(store, taken[path]), record, manifest.card.cameras[record.camera].models
        )
        findings += found
    findings += ratio_findings(tuple(wanted.values()), products)
    _refuse(store, (finding.of(manifest.name) for finding in findings))
    decoders = sorted({frame.file.decoder for frame in taken.values()})
    stated = {"file": str(store), "digest": opened.digest, "decoded_by": ", ".join(decoders)}
    return Originals(FrameFiles(folder.absolute()), store.absolute(), taken, stated)


def _refuse(store: Path, problems: Iterable[Problem]) -> None:
    listed = list(problems)
    if listed:
        more = f" (and {len(listed) - 1} more)" if len(listed) > 1 else ""
        raise DatasetError(f"{store}: is not of the files that the manifest lists: {listed[0]}{more}")


def _file_findings(folder: Path, record: FrameRecord, held: StoredFrame) -> Iterator[Problem]:
    """Compare the file that a frame was packed from with its row, and with the one that lies in the folder, if any."""
    file = held.file
    if record.sha256 not in (None, file.sha256):
        yield row_fault(record.path, "sha256", record.sha256 or "", file.sha256, f"another file was packed: {_AGAIN}")
    elif record.size_bytes not in (None, file.size_bytes):
        sizes = f"{record.size_bytes} bytes", f"{file.size_bytes} bytes"
        yield row_fault(record.path, "size_bytes", *sizes, f"another file was packed: {_AGAIN}")
    yield from size_findings(record, held.sensor.width, held.sensor.height, _AGAIN)
    there = folder / record.path
    if there.is_file() and there.stat().st_size != file.size_bytes:
        sizes = f"the packed file's {file.size_bytes} bytes", f"{there.stat().st_size} bytes in {folder}"
        yield row_fault(record.path, "size_bytes", *sizes, f"the file is another since it was packed: {_AGAIN}")
