"""Where frames come from: the one small interface of raw files, arrays, stores, shards, and sources of your own.

A :class:`FrameSource` says which frames it holds (``records``) and opens them by path; a :class:`Frame` says what its
file states of the sensor, and reads parts of the pixels (``read(rows, columns)``). What is cut, turned, normalised and
multiplied is one matter, for all sources (:mod:`eldata.datasets.items`); where the pixels lie is another.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from eldata.base.files import inside
from eldata.base.png import read_rgb16
from eldata.manifest.clip_checks import is_png
from eldata.raw.levels import with_levels
from eldata.records import Exposure, RawHeader

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.raw.cfa import CfaRows
    from eldata.raw.levels import FrameLevels
    from eldata.records import FrameRecord, Sensor

RGB_WHITE = 65535.0


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame: pixels that are read part by part, and how they are normalised.

    Attributes
    ----------
    mosaic
        (H, W) in DN, uint16 or floating; of an RGB frame (3, H, W) uint16. An array, or anything that is indexed like
        one; with a method ``borrow``, parts come in memory that the thread's next part overwrites.
    cfa, black_level_dn
        As in :class:`eldata.records.Sensor`; the CFA of an RGB frame is empty.
    white_level_dn
        The level that is 1 after normalisation.
    name
        Where it comes from, for messages.
    sensor, exposure
        As the file states them; ``None`` and nothing if no file does.
    """

    mosaic: Any = field(repr=False)
    cfa: CfaRows
    black_level_dn: tuple[float, ...]
    white_level_dn: float
    name: str
    sensor: Sensor | None = None
    exposure: Exposure = Exposure()  # noqa: RUF009 # frozen

    @classmethod
    def of_raw(cls, mosaic: Any, sensor: Sensor, name: str, exposure: Exposure) -> Frame:
        """Return the frame of a raw file, with the levels that the file states."""
        return cls(mosaic, sensor.cfa, sensor.black_level_dn, sensor.white_level_dn, name, sensor, exposure)

    @classmethod
    def of_rgb(cls, planes: Any, name: str) -> Frame:
        """Return a 16-bit RGB frame, (3, H, W)."""
        return cls(planes, (), (0.0,), RGB_WHITE, name)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.mosaic.shape[-2:]
        return height, width

    @property
    def kind(self) -> str:
        """Size and CFA in words: frames of a pair or clip have them in common."""
        height, width = self.shape
        return f"{height} x {width} pixels of {f'the CFA {self.cfa}' if self.cfa else 'RGB'}"

    @property
    def range_dn(self) -> float:
        """White level minus the channels' mean black level."""
        return self.white_level_dn - sum(self.black_level_dn) / len(self.black_level_dn)

    @property
    def header(self) -> RawHeader:
        """What the file says of itself."""
        make, model = ("", "") if self.sensor is None else (self.sensor.make, self.sensor.model)
        return RawHeader(Path(self.name), make, model, self.exposure)

    def with_levels(self, levels: FrameLevels) -> Frame:
        """Return the frame with the chosen levels (:func:`eldata.raw.levels.with_levels`); RGB and arrays as it is."""
        if self.sensor is None:
            return self
        chosen = with_levels(self.sensor, levels)
        return replace(self, black_level_dn=chosen.black_level_dn, white_level_dn=chosen.white_level_dn)

    def without_pixels(self) -> Frame:
        """Return the frame, its pixels forgotten."""
        return replace(self, mosaic=np.broadcast_to(np.uint16(0), self.mosaic.shape))

    def read(self, rows: slice, columns: slice) -> NDArray[np.generic]:
        """Return a part, (rows, columns) in DN or (3, rows, columns), to be used before the thread reads the next."""
        part: NDArray[np.generic] = getattr(self.mosaic, "borrow", self.mosaic.__getitem__)((..., rows, columns))
        return part


@runtime_checkable
class FrameSource(Protocol):
    """Frames by path."""

    reads_parts: bool
    """Whether opening a frame costs nothing and reads only the parts that are asked for, by several threads at once.
    Otherwise it decodes the whole frame, so one is opened at a time."""

    @property
    def records(self) -> Sequence[FrameRecord]:
        """What it holds."""

    def frame(self, path: str) -> Frame:
        """Open the frame of a record."""


class Files:
    """Frames decoded from files: camera raws, and 16-bit RGB in PNG.

    Parameters
    ----------
    root
        The folder that paths are relative to, and that they may not leave; ``None``: they are paths by themselves.
    records
        Rows of the manifest that lists the files.
    """

    reads_parts = False

    def __init__(self, root: Path | None = None, records: Sequence[FrameRecord] = ()) -> None:
        self.root = root
        self.records = tuple(records)

    def frame(self, path: str) -> Frame:
        """Decode a file.

        Raises
        ------
        FileError
            If it is missing or damaged.
        """
        from eldata.raw.reading import read_raw

        file = Path(path) if self.root is None else inside(self.root, path)
        if is_png(path):
            return Frame.of_rgb(read_rgb16(file).transpose(2, 0, 1), str(file))
        raw = read_raw(file)
        return Frame.of_raw(raw.mosaic, raw.sensor, str(raw.path), raw.exposure)
