"""The frames of one unit of work, decoded one after another and reduced at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture.check.cells import Cells, luminance, reduce_to_cells
from capture.check.noise_structure import empty_share
from eldata.base.files import inside
from eldata.errors import EldataError, UnusableRawError
from eldata.records import FrameRecord, RawHeader, Sensor

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from capture.check.result import CheckedGroup
    from eldata.base.workers import Workers


@dataclass(frozen=True, slots=True)
class Unit:
    """The files of one scene, or the bias frames or flats of one camera and ISO: small, for worker processes.

    Records stand in the order in which they are checked: by path, references before noisy frames. ``before`` is, of a
    moment of a sequence, the last reference of the moment before.
    """

    name: str
    folder: Path
    records: tuple[FrameRecord, ...]
    workers: Workers
    before: FrameRecord | None = None

    @property
    def path(self) -> Path:
        """The first file: what an error of a worker names."""
        return self.folder / self.records[0].path


@dataclass(frozen=True, slots=True, eq=False)
class ReducedFrame:
    """What is kept of a decoded frame, and its luminance, which is meant for use at once.

    ``empty_share``: of its values (:func:`capture.check.noise_structure.empty_share`).
    """

    record: FrameRecord
    header: RawHeader
    sensor: Sensor
    cells: Cells
    luminance: NDArray[np.float32]
    empty_share: float

    @property
    def scale(self) -> int:
        """Mosaic pixels along each side of a packed pixel."""
        from eldata.raw.cfa import packing_sites

        return packing_sites(self.sensor.cfa).scale


def reduced_frames(unit: Unit, group: CheckedGroup) -> Iterator[ReducedFrame]:
    """Yield each frame reduced; at most ``unit.workers.jobs`` + 1 are in memory.

    A frame that cannot be read, or compared with the first one, is left out with a remark in ``group``.
    """

    def reduce(record: FrameRecord) -> ReducedFrame | EldataError:
        from eldata.raw.cfa import pack
        from eldata.raw.reading import read_raw

        try:
            frame = read_raw(inside(unit.folder, record.path))
            mosaic = frame.whole_dn("the check of a set")
        except EldataError as error:
            return error
        packed = pack(mosaic, frame.sensor.cfa)
        cells = reduce_to_cells(mosaic, frame.sensor, packed)
        header = RawHeader(frame.path, frame.sensor.make, frame.sensor.model, frame.exposure)
        return ReducedFrame(record, header, frame.sensor, cells, luminance(packed, cells), empty_share(mosaic))

    first: tuple[str, Sensor] | None = None
    for record, frame in zip(unit.records, unit.workers.read_ahead(reduce, unit.records), strict=True):
        if isinstance(frame, EldataError):
            text = f"cannot be read ({getattr(frame, 'reason', '') or frame}); copy it again from the card"
            if isinstance(frame, UnusableRawError):
                text = f"{frame.found}; {frame.advice}"
            group.remark(record.path, text, "shoot again")
            continue
        first = first or (record.path, frame.sensor)
        problem = _other_kind(*first, frame.sensor)
        if problem is None:
            yield frame
        else:
            group.remark(record.path, problem, "shoot again")


def _other_kind(path: str, ours: Sensor, theirs: Sensor) -> str | None:
    """Return why a frame cannot be compared with that of ``path``, or ``None``."""
    for name, one, two in (
        ("camera", ours.model, theirs.model),
        ("size", (ours.width, ours.height), (theirs.width, theirs.height)),
        ("colour filter array", ours.cfa, theirs.cfa),
    ):
        if one != two:
            return f"{name} {two}, where {path} has {one}; take all frames with one camera and raw format"
    return None


def file_name(path: str) -> str:
    """Return the last part of a manifest's path."""
    return path.rpartition("/")[2]
