"""Where frames come from: the one small interface of raw files, arrays, stores, and sources of your own.

A :class:`FrameSource` says which frames it holds (``records``) and opens them by path; a :class:`Frame` says what its
file states of the sensor, and reads parts of the pixels (``read(rows, columns)``). What is cut, turned, normalised and
multiplied is one matter, for all sources (:mod:`eldata.datasets.items`); where the pixels lie is another.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, get_args, runtime_checkable

import numpy as np

from eldata.base.arrays import read_rgb16
from eldata.base.compiled import scratch
from eldata.base.files import split_member
from eldata.errors import ArgumentError, DatasetError, FileError, check_choice
from eldata.manifest.catalogue import FrameFiles, known_names
from eldata.manifest.patterns import find_elsewhere, is_png
from eldata.raw.container import version_of
from eldata.raw.levels import (
    CLIP_RANGES,
    check_in_dn,
    check_white_in_dn,
    pack,
    pack_normalised,
    packed_black_level_dn,
    with_levels,
)
from eldata.records import Exposure, FrameRecord, PairRecord, RawFrame, Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.manifest.card import Card
    from eldata.manifest.clips import ClipRecord
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Levels
    from eldata.raw.levels import CfaRows, Clip
    from eldata.raw.mapped import Layout
    from eldata.raw.stated import StatedFile

RGB_WHITE = 65535.0
KEPT_BYTES = 512 * 10**6
"""Of decoded frames that are kept for the next crops of them, in all workers of a DataLoader together."""


class Pixels(NamedTuple):
    """Pixels that do not lie in an array: of a store, of packed arrays, or less a dark shading.

    Attributes
    ----------
    shape
        (H, W), of RGB (3, H, W).
    dtype
        Uint16, or floating.
    read
        Of rows and columns: that part, (..., rows, columns), in memory that the thread's next read may overwrite.
    are_light
        Whether no pixels are held in memory, so that the frame may stay open.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[slice, slice], NDArray[Any]]
    are_light: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame: pixels that are read part by part, and the levels that normalise them.

    Attributes
    ----------
    mosaic
        (H, W) in DN, uint16 or floating; of an RGB frame (3, H, W) uint16. An array, or other :class:`Pixels`.
    cfa, black_level_dn
        As in :class:`eldata.records.Sensor`; the CFA of an RGB frame is empty.
    white_level_dn
        The level that is 1 after normalisation.
    name
        Where it comes from, for messages.
    sensor, exposure
        As the file states them; ``None`` and nothing if no file does.
    channel_white_levels_dn
        As in :class:`eldata.records.RawFrame`.
    whites_dn
        The level that is 1 in each CFA channel, where these differ (levels ``metadata-per-channel``); else empty.
    """

    mosaic: NDArray[Any] | Pixels = field(repr=False)
    cfa: CfaRows
    black_level_dn: tuple[float, ...]
    white_level_dn: float
    name: str
    sensor: Sensor | None = None
    exposure: Exposure = Exposure()  # noqa: RUF009 # frozen
    channel_white_levels_dn: tuple[float, ...] | None = None
    whites_dn: tuple[float, ...] = ()

    @classmethod
    def of_decoded(cls, raw: RawFrame) -> Frame:
        """Return the frame of a decoded raw file, with the levels that the file states."""
        return cls.of_raw(raw.mosaic, raw.sensor, str(raw.path), raw.exposure, raw.channel_white_levels_dn)

    @classmethod
    def of_raw(
        cls,
        mosaic: NDArray[Any] | Pixels,
        sensor: Sensor,
        name: str,
        exposure: Exposure,
        channel_white_levels_dn: tuple[float, ...] | None = None,
    ) -> Frame:
        """Return the frame of a raw file, with the levels that the file states."""
        black, white = sensor.black_level_dn, sensor.white_level_dn
        return cls(mosaic, sensor.cfa, black, white, name, sensor, exposure, channel_white_levels_dn)

    @classmethod
    def of_rgb(cls, planes: NDArray[Any] | Pixels, name: str) -> Frame:
        """Return a 16-bit RGB frame, (3, H, W)."""
        return cls(planes, (), (0.0,), RGB_WHITE, name)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.mosaic.shape[-2:]
        return height, width

    @property
    def reads_parts(self) -> bool:
        """Whether no pixels are in memory yet: those that are asked for are read, and the frame may stay open."""
        return isinstance(self.mosaic, Pixels) and self.mosaic.are_light

    @property
    def kind(self) -> str:
        """Size and CFA in words: frames of a pair or clip have them in common."""
        height, width = self.shape
        return f"{height} x {width} pixels of {f'the CFA {self.cfa}' if self.cfa else 'RGB'}"

    @property
    def range_dn(self) -> float:
        """White level minus the channels' mean black level."""
        return self.white_level_dn - sum(self.black_level_dn) / len(self.black_level_dn)

    def levels_dn(self, levels: Levels, reference: Frame | None = None) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return black and white level of each CFA channel, DN, by a choice of levels: :meth:`with_levels`."""
        count = len(self.black_level_dn)
        if self.sensor is None:
            return self.black_level_dn, (self.white_level_dn,) * count
        if levels == "metadata-per-channel":
            whites = self.channel_white_levels_dn or (self.sensor.white_level_dn,)
            return self.sensor.black_level_dn, whites if len(set(whites)) > 1 else whites[:1] * count
        chosen = with_levels(self.sensor, levels, None if reference is None else reference.sensor)
        return chosen.black_level_dn, (chosen.white_level_dn,) * count

    def with_levels(self, levels: Levels, reference: Frame | None = None) -> Frame:
        """Return the frame with the chosen levels; RGB and arrays keep theirs.

        Parameters
        ----------
        levels
            As :func:`eldata.raw.levels.with_levels` has them; or ``metadata-per-channel``: LibRaw's white level of each
            channel, where it has none the file's one.
        reference
            Of a noisy frame: its reference, whose range counts where the white levels of both differ.

        Raises
        ------
        ArgumentError
            If the levels are unknown.
        DatasetError
            If the white level is a constant and the file holds shares of white.
        """
        if self.sensor is None:
            return self
        blacks, whites = self.levels_dn(levels, reference)
        if levels != "metadata-per-channel":
            check_white_in_dn(self.name, self.sensor, whites[0])
        own = whites if len(set(whites)) > 1 else ()
        return replace(self, black_level_dn=blacks, white_level_dn=whites[0], whites_dn=own)

    def normalise(self, clip: Clip = "both", gain: float = 1.0) -> NDArray[np.float32]:
        """Return all of the frame by its levels: (C, h, w) float32, packed, clipped, amplified and clipped again.

        RGB is divided by 65535, and neither amplified nor clipped. Raises as
        :func:`eldata.raw.levels.pack_normalised` does.
        """
        pixels = self.read(slice(None), slice(None))
        if not self.cfa:
            image = np.empty(pixels.shape, np.float32)
            np.divide(pixels, np.float32(RGB_WHITE), out=image, dtype=np.float32)
            return image
        black, in_floats = self.black_level_dn, pixels.dtype.kind == "f"
        if not self.whites_dn:
            return pack_normalised(
                pixels, self.cfa, black, self.white_level_dn, clip=clip, gain=gain, corrected=in_floats
            )
        blacks, whites = (packed_black_level_dn(self.cfa, levels)[:, None, None] for levels in (black, self.whites_dn))
        if not np.all(whites > blacks):
            raise ArgumentError(f"{self.name}: a white level of {self.whites_dn} DN is not above its black level")
        low, high = (np.float32(limit) for limit in CLIP_RANGES[clip])
        packed = (pack(pixels, self.cfa).astype(np.float32) - blacks) / (whites - blacks)
        np.clip(packed, low, high, out=packed)
        return packed if gain == 1.0 else np.clip(packed * np.float32(gain), low, high)

    def subtract(self, shading: DarkShading) -> Frame:
        """Return the frame without a dark shading, in float32 DN: fractions of a DN, and no clip.

        Raises
        ------
        DatasetError
            If the frame is not a raw file's, or of another model, size or CFA, states no ISO, or one that the shading
            was not measured at.
        """
        if self.sensor is None:
            raise DatasetError(
                f"{self.name}: is not a raw frame in DN, so the dark shading of {shading.camera} does not belong to it"
            )
        check_in_dn(self.name, self.sensor, f"the dark shading of {shading.camera}")
        shading.check_sensor(self.name, self.shape, self.cfa, self.sensor.model)
        if self.exposure.iso is None:
            raise DatasetError(f"{self.name}: states no ISO, and the dark shading of {shading.camera} differs by ISO")
        iso = float(self.exposure.iso)
        try:
            shading.measured(iso)
        except ArgumentError as error:
            raise DatasetError(f"{self.name}: {error}") from error
        reads = partial(_read_without, self, shading, iso)
        return replace(self, mosaic=Pixels(self.shape, np.dtype(np.float32), reads, self.reads_parts))

    def without_pixels(self) -> Frame:
        """Copy the frame without its pixels; one that reads parts holds none."""
        return self if self.reads_parts else replace(self, mosaic=np.broadcast_to(np.uint16(0), self.mosaic.shape))

    def read(self, rows: slice, columns: slice) -> NDArray[Any]:
        """Return a part, (rows, columns) in DN or (3, rows, columns), to be used before the thread reads the next."""
        if isinstance(self.mosaic, np.ndarray):
            return self.mosaic[..., rows, columns]
        return self.mosaic.read(rows, columns)

    def whole(self) -> NDArray[Any]:
        """Return all of the pixels, in memory of their own."""
        return self.read(slice(None), slice(None)).copy()


class KeptFrames:
    """The frames that were used last, in memory; not in what is pickled. Threads may ask side by side.

    Parameters
    ----------
    most
        How many, or how many bytes of them if ``in_bytes``.
    in_bytes
        Which of both.

    Attributes
    ----------
    hits, misses
        How often a frame was there, and how often it was opened.
    """

    def __init__(self, most: int, *, in_bytes: bool = False) -> None:
        self.most, self.in_bytes = most, in_bytes
        self.hits = self.misses = 0
        self._frames: OrderedDict[Hashable, Frame] = OrderedDict()
        self._lock = Lock()

    def frame(self, key: Hashable, open_frame: Callable[[], Frame], sharers: int = 1) -> Frame:
        """Return the frame of a key, opened if it is not there; processes that share the memory keep less each."""
        with self._lock:
            frame = self._frames.pop(key, None)
        self.hits, self.misses = self.hits + (frame is not None), self.misses + (frame is None)
        frame = open_frame() if frame is None else frame
        with self._lock:
            self._frames[key] = frame
            while sum(map(self._weigh, self._frames.values())) > self.most // sharers:
                self._frames.popitem(last=False)
        return frame

    def _weigh(self, frame: Frame) -> int:
        """Return what a frame counts as: its bytes, or one."""
        return getattr(frame.mosaic, "nbytes", 0) if self.in_bytes else 1

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(KeptFrames, in_bytes=self.in_bytes), (self.most,)


def _read_mapped(layout: Layout, sensor: Sensor, rows: slice, columns: slice) -> NDArray[np.uint16]:
    """Read a part of a raw file's frame; of a whole frame, refuse one that shows damage."""
    from eldata.raw.damage import check_damage

    if part_shape((layout.height, layout.width), rows, columns) != (layout.height, layout.width):
        return layout.read(rows, columns)
    pixels = layout.read_whole()
    check_damage(layout.path, (layout.stated,), pixels, sensor.black_level_dn, sensor.white_level_dn)
    return pixels


def _read_without(frame: Frame, shading: DarkShading, iso: float, rows: slice, columns: slice) -> NDArray[np.float32]:
    """Read a part, and subtract the dark shading, which is worked out for it."""
    taken = scratch("subtracted_shading", part_shape(frame.shape, rows, columns), np.dtype(np.float32))
    shading.at(iso, rows, columns, out=taken)
    np.subtract(frame.read(rows, columns), taken, out=taken)
    return taken


def part_shape(shape: tuple[int, ...], rows: slice, columns: slice) -> tuple[int, int]:
    """Return the height and width of a part of pixels (..., H, W)."""
    height, width = (len(range(*part.indices(side))) for part, side in zip((rows, columns), shape[-2:], strict=True))
    return height, width


FileCheck = Literal["exists", "never"]
"""When it is looked whether a dataset's files are there."""


@runtime_checkable
class FrameSource(Protocol):
    """Frames by path."""

    reads_parts: bool
    """Whether opening any frame costs nothing and reads only the parts that are asked for, by several threads at once.
    Otherwise one is opened at a time, which may decode it whole: :attr:`Frame.reads_parts` says so of each."""

    @property
    def records(self) -> Sequence[FrameRecord]:
        """Records of all frames that it holds."""

    def frame(self, path: str) -> Frame:
        """Open the frame of a record."""


class Files:
    """Frames of files: camera raws, and 16-bit RGB in PNG.

    Of uncompressed raws that are mapped (:mod:`eldata.raw.mapped`) only the parts that are asked for are read; of a
    whole frame the damage that shows is looked for, of a part it is not: ``eldata verify`` does it. What LibRaw has
    confirmed of them goes to other processes with this.

    Parameters
    ----------
    files
        Where they lie; a folder alone: nothing is stated of them; ``None``: they are paths by themselves, and so with
        what is stated of some of these paths.
    records
        Rows of the manifest that lists the files.
    card
        That of the set: what it says where to get is named where the folder is missing.
    """

    reads_parts = False

    def __init__(
        self,
        files: FrameFiles | Path | Mapping[str, StatedFile] | None = None,
        records: Sequence[FrameRecord] = (),
        card: Card | None = None,
    ) -> None:
        self._files = FrameFiles(files) if isinstance(files, Path) else files or {}
        self.records = tuple(records)
        self._card = card
        self.kept = KeptFrames(0, in_bytes=True)

    def frame(self, path: str) -> Frame:
        """Open a file, which decodes it unless it is mapped, or is kept and still the same.

        Raises
        ------
        FileError
            If it is missing or damaged.
        DatasetError
            If the set's folder, or that of its camera, is missing, or the file lies elsewhere in it.
        """
        file = self._find_file(path)
        if not self.kept.most or not isinstance(file, Path) or not file.exists():
            return self._open(path, file)
        from torch.utils.data import get_worker_info

        key, info = (path, version_of(file.stat())), get_worker_info()
        return self.kept.frame(key, partial(self._open, path, file), 1 if info is None else info.num_workers)

    def _open(self, path: str, file: Path | StatedFile) -> Frame:
        """Open a file; raises like :meth:`frame`."""
        from eldata.raw.reading import open_frame

        try:
            if is_png(path) and isinstance(file, Path):
                return Frame.of_rgb(read_rgb16(file).transpose(2, 0, 1), str(file))
            raw, layout = open_frame(file)
        except FileError:
            if self._card is not None and isinstance(self._files, FrameFiles):
                self._require_folders(self._files.folder, self._card, path)
            raise
        frame = Frame.of_decoded(raw)
        if layout is None:
            return frame
        return replace(frame, mosaic=Pixels(frame.shape, raw.mosaic.dtype, partial(_read_mapped, layout, raw.sensor)))

    def __getstate__(self) -> dict[str, Any]:
        from eldata.raw.mapped import verdicts

        return vars(self) | {"_verdicts": dict(verdicts)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        from eldata.raw.mapped import verdicts

        verdicts.update(state.pop("_verdicts"))
        vars(self).update(state)

    def _find_file(self, path: str) -> Path | StatedFile:
        """Find a frame's file, with its card's facts if they are known."""
        return self._files.at(path) if isinstance(self._files, FrameFiles) else self._files.get(path, Path(path))

    def packed_file(self, path: str) -> Path | None:
        """Return the file of a packed array, such as synthetic noise is saved in; ``None`` of other frames."""
        file = self._find_file(path) if path.endswith(".npy") else None
        return file if isinstance(file, Path) else None

    def outline(self, path: str, like: Frame, levels: Levels) -> Frame:
        """Return a reference without pixels: from its header where that decides the values of the noisy frame ``like``.

        Else, where its white level may be another one, it is decoded.
        """
        from eldata.raw.reading import read_header

        header = read_header(self._find_file(path))
        is_alike = header.levels_dn is not None and header.levels_dn[1] == like.white_level_dn
        if levels == "metadata" and not is_alike:
            return self.frame(path).without_pixels()
        return replace(like.without_pixels(), name=str(header.path), exposure=header.exposure)

    def require(self, records: Iterable[PairRecord | ClipRecord], check: FileCheck) -> None:
        """Look whether every file of a set's records is there, unless ``check`` is ``"never"``.

        Raises
        ------
        DatasetError
            If one is missing: how many are, and the first.
        """
        check_choice("check", check, get_args(FileCheck))
        if check == "never" or not isinstance(self._files, FrameFiles):
            return
        folder, paths = self._files.folder, dict.fromkeys(path for record in records for path in record.files)
        if missing := [path for path in paths if not os.path.exists(f"{folder}/{split_member(path)[0]}")]:  # noqa: PTH110 # 10 times faster
            if self._card is not None:
                self._require_folders(folder, self._card, missing[0])
            name = "" if self._card is None else f" {self._card.name}"
            raise DatasetError(
                f"{folder}: lacks {len(missing)} of the {len(paths)} files of these records, first {missing[0]}; "
                f'eldata verify{name} names all; check="never" makes the dataset all the same'
            )

    def _require_folders(self, folder: Path, card: Card, path: str) -> None:
        """Raise if the set's folder is missing, a file lies elsewhere in it, or the folder of its camera is missing."""
        camera_in = {row.path.partition("/")[0]: row.camera for row in self.records}
        if not folder.is_dir():
            raise no_folder(folder, card, camera_in)
        is_there = (folder / split_member(path)[0]).exists()
        if path in (elsewhere := {} if is_there else find_elsewhere(folder, [path], self.records)):
            found = f"expected {path}, found it in another place, {elsewhere[path]}"
            raise DatasetError(f"{folder}: {found}; move it, and the others, to where the manifest lists them")
        top, slash, _ = path.partition("/")
        if slash and not (folder / top).is_dir():
            present = [camera for name, camera in camera_in.items() if (folder / name).is_dir()]
            hint = f"choose those you have with cameras={present!r}" if present else "is this the right folder?"
            raise DatasetError(f"{folder}: has no folder {top!r} for camera {camera_in[top]}; {hint}")


def no_folder(folder: Path, card: Card, holds: Iterable[str]) -> DatasetError:
    """Make the error for a dataset's missing folder: its expected content, and where to get it."""
    known = card.name in known_names()  # the commands do not know a set of the user's own
    commands = f"; eldata info {card.name} says more, eldata download {card.name} fetches or unpacks it"
    return DatasetError(
        f"{folder}: there is no such folder; give the folder of {card.title}, which holds {', '.join(holds)} "
        f"(where to get it: {card.homepage}{commands if known else ''})"
    )
