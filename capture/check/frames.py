"""The frames of one unit of work, decoded one after the other and reduced at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture.check.cells import Cells, luminance, reduce_to_cells
from capture.check.measures import Remark
from eldata.base.files import inside
from eldata.errors import EldataError
from eldata.records import FrameRecord, RawHeader, Sensor

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from eldata.base.workers import Workers


@dataclass(frozen=True, slots=True)
class Unit:
    """The files of one scene, or the bias frames or flats of one camera and ISO: small, for worker processes."""

    path: str
    name: str
    folder: Path
    records: tuple[FrameRecord, ...]
    workers: Workers


@dataclass(frozen=True, slots=True, eq=False)
class ReducedFrame:
    """What is kept of a decoded frame, and its luminance, which is not meant to be."""

    record: FrameRecord
    header: RawHeader
    sensor: Sensor
    cells: Cells
    luminance: NDArray[np.float32]

    @property
    def scale(self) -> int:
        """Mosaic pixels a side of a packed pixel."""
        return 2 if len(self.sensor.cfa) == 2 else 3


def reduced_frames(unit: Unit, records: Sequence[FrameRecord]) -> Iterator[tuple[FrameRecord, ReducedFrame | Remark]]:
    """Yield each frame reduced, or what is wrong with its file; at most ``unit.workers.jobs`` + 1 are in memory."""

    def reduce(record: FrameRecord) -> tuple[FrameRecord, ReducedFrame | Remark]:
        from eldata.raw.cfa import pack
        from eldata.raw.reading import read_raw

        try:
            frame = read_raw(inside(unit.folder, record.path))
        except EldataError as error:
            text = f"cannot be read ({getattr(error, 'reason', '') or error}); copy it again from the card"
            return record, Remark(record.path, text, "shoot again")
        packed = pack(frame.mosaic, frame.sensor.cfa)
        cells = reduce_to_cells(frame.mosaic, frame.sensor, packed)
        header = RawHeader(frame.path, frame.sensor.make, frame.sensor.model, frame.exposure)
        return record, ReducedFrame(record, header, frame.sensor, cells, luminance(packed, cells))

    yield from unit.workers.read_ahead(reduce, records)


def other_kind(first: ReducedFrame, frame: ReducedFrame) -> Remark | None:
    """Return a remark if a frame cannot be compared with the first of its unit."""
    ours, theirs = first.sensor, frame.sensor
    for name, one, two in (
        ("camera", ours.model, theirs.model),
        ("size", (ours.width, ours.height), (theirs.width, theirs.height)),
        ("colour filter array", ours.cfa, theirs.cfa),
    ):
        if one != two:
            text = f"{name} {two}, where {first.record.path} has {one}; take all frames with one camera and raw format"
            return Remark(frame.record.path, text, "shoot again")
    return None


def file_name(path: str) -> str:
    """Return the last part of a manifest's path."""
    return path.rpartition("/")[2]
