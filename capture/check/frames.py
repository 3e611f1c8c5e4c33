"""The frames of one unit of work, decoded one after another and reduced at once; small pictures from their cells."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.cells import Cells, empty_share, luminance, reduce_to_cells
from capture.check.result import CheckedGroup, SheetPicture
from capture.observed import exposure_text
from eldata.base.files import inside
from eldata.errors import EldataError, UnusableRawError
from eldata.isp.preview import srgb_encode
from eldata.records import FrameRecord, RawHeader, Sensor

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.base.workers import Workers

_WIDEST: Final = 480  # pixels: thumbnails are shown at a third of it, and enlarge
_CHANGE_SHOWN: Final = 0.05  # the strongest colour of a difference map, as a share
_QUALITY: Final = 85


@dataclass(frozen=True, slots=True)
class Unit:
    """The files of one scene, or the bias frames or flats of one camera and ISO: small, for worker processes.

    Records stand in the order in which they are checked: by path, references before noisy frames.
    """

    name: str
    folder: Path
    records: tuple[FrameRecord, ...]
    workers: Workers

    @property
    def path(self) -> Path:
        """The first file: what an error of a worker names."""
        return self.folder / self.records[0].path


@dataclass(frozen=True, slots=True, eq=False)
class ReducedFrame:
    """What is kept of a decoded frame, and its luminance, which is meant for use at once.

    ``empty_share``: of its values (:func:`capture.check.cells.empty_share`).
    """

    record: FrameRecord
    header: RawHeader
    sensor: Sensor
    cells: Cells
    luminance: NDArray[np.float32]
    empty_share: float

    def cells_beside(self, reference: Sensor) -> Cells:
        """Return the cells in a reference's DN: as large a share of white, whatever the bits of either file."""
        from eldata.raw.levels import differ_in_white, mean_levels

        levels, of_reference = mean_levels(self.sensor), mean_levels(reference)
        if levels[1] == of_reference[1] or differ_in_white(levels, of_reference):
            return self.cells  # one DN scale, also where a file states a wrong black
        scale = (of_reference[1] - of_reference[0]) / (levels[1] - levels[0])
        return replace(self.cells, mean_dn=self.cells.mean_dn * np.float32(scale), range_dn=self.cells.range_dn * scale)

    @property
    def scale(self) -> int:
        """Mosaic pixels along each side of a packed pixel."""
        from eldata.raw.levels import packing_sites

        return packing_sites(self.sensor.cfa).scale


def reduced_frames(unit: Unit, group: CheckedGroup) -> Iterator[ReducedFrame]:
    """Yield each frame reduced; at most ``unit.workers.jobs`` + 1 are in memory.

    A frame that cannot be read, or compared with the first one, is left out with a remark in ``group``.
    """

    def reduce(record: FrameRecord) -> ReducedFrame | EldataError:
        from eldata.raw.levels import pack
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


# --- small pictures for the contact sheet ----------------------------------------------------------------------------


def scene_picture(frame: ReducedFrame, gain: float) -> SheetPicture:
    """Return a frame as a picture, amplified."""
    iso, time = frame.header.exposure.iso, frame.header.exposure.exposure_s
    settings = f"ISO {float(iso):g}" if iso is not None else "ISO ?"
    settings += f", {exposure_text(time)}" if time is not None else ""
    amplified = f", x{gain:g}" if gain != 1 else ""
    caption = f"{file_name(frame.record.path)}: {settings}{amplified}"
    light = _three_colours(frame.cells) * gain / frame.cells.range_dn
    balance = frame.sensor.white_balance
    if balance is not None:
        light *= np.array(balance[:3], dtype=np.float32)
    return SheetPicture(caption, frame.record.path, _jpeg(255 * srgb_encode(np.clip(light, 0, 1))))


def change_picture(first: ReducedFrame, last: ReducedFrame) -> SheetPicture:
    """Return where the last reference is brighter (red) or darker (blue) than the first."""
    before, after = (_three_colours(frame.cells)[..., 1] for frame in (first, last))
    floor = 0.01 * first.cells.range_dn
    change = (after - before) / np.maximum(before, floor)
    caption = f"{file_name(last.record.path)} over {file_name(first.record.path)}, ±{100 * _CHANGE_SHOWN:g} %"
    return SheetPicture(caption, last.record.path, _jpeg(_diverging(change / _CHANGE_SHOWN)))


def map_picture(caption: str, path: str, values: NDArray[np.floating], full: float) -> SheetPicture:
    """Return a map of values, blue at ``-full``, red at ``+full``."""
    scale = max(1, _WIDEST // (2 * values.shape[1]))
    larger = np.kron(values, np.ones((scale, scale)))
    return SheetPicture(caption, path, _jpeg(_diverging(larger / full)))


def _three_colours(cells: Cells) -> NDArray[np.float32]:
    """Return the means of R, G and B, (rows, columns, 3), in as many cells as a small picture has pixels."""
    group = max(1, -(-cells.mean_dn.shape[2] // _WIDEST))
    mean, _ = cells.pooled(group, group)
    colours = np.array(cells.colours)
    return np.stack([mean[colours == colour].mean(axis=0) for colour in "RGB"], axis=-1)


def _diverging(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return -1 as blue, 0 as light grey and 1 as red, 0 to 255."""
    strength = np.clip(values, -1, 1)[..., None]
    grey, red, blue = (np.array(colour) for colour in ((235, 235, 235), (190, 20, 30), (20, 70, 190)))
    colours: NDArray[np.floating] = np.where(
        strength >= 0, grey + strength * (red - grey), grey - strength * (blue - grey)
    )
    return colours


def _jpeg(colours: NDArray[np.floating]) -> bytes:
    from PIL import Image

    image = Image.fromarray(np.rint(colours).astype(np.uint8))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=_QUALITY)
    return file.getvalue()
