"""The frames of one unit of work, decoded one after another and reduced at once to cells; small pictures of these.

Cells are means over black of 4 x 4 packed pixels, per channel. Averaging takes the pixels' noise off (a quarter of it
is left) and makes a frame of 12 megapixels 3 MB, so that a whole scene fits into the memory of a frame or two. Only
shift and focus need more.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check.result import CheckedGroup, SheetPicture
from capture.observed import format_exposure
from eldata.base.files import inside
from eldata.errors import EldataError, UnusableRawError
from eldata.isp.rendering import srgb_encode
from eldata.raw.levels import differ_in_white, mean_levels, packed_black_level_dn, packing_sites

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.base.workers import Workers
    from eldata.records import Exposure, FrameRecord, Sensor

    Mosaic = NDArray[np.uint16]

CELL: Final = 4  # packed pixels along each side

_NEAR: Final = 8  # values on either side, whose mean says how often one should occur
_LEAST_EACH: Final = 30  # pixels a value: chance leaves one empty once in 1e13
_TAILS: Final = (0.05, 0.95)

# Pixels in the last thousandth of the range below the highest value, if these are more than thrice those in the
# thousandth below: a sensor that saturates below its white level. The upper tail of shot noise is several thousandths
# wide and falls, so it holds fewer.
_PILE_BAND: Final = 0.001
_PILE_FACTOR: Final = 3
_PILE_LEAST: Final = 100
_PILE_FROM: Final = 0.5  # of the range: real cameras saturate above 0.8 of it (Canon 70D at ISO 100)

_WIDEST: Final = 480  # pixels: thumbnails are shown at a third of it, and enlarge
_CHANGE_SHOWN: Final = 0.05  # the strongest colour of a difference map, as a share
_QUALITY: Final = 85


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A frame reduced to cells.

    Attributes
    ----------
    mean_dn
        Mean of each cell over the recorded black level, (C, rows, columns) float32, DN.
    clipped
        Whether a pixel of the cell is saturated, (C, rows, columns).
    range_dn
        White level less black level, DN.
    clipped_share, zero_share
        Share of the frame's pixels that are saturated, and that are 0 DN.
    spread_dn
        Half the distance of the 16th and the 84th percentile of the pixels: of a bias frame, its noise. DN.
    colours
        Colour of each channel: ``"R"``, ``"G"`` or ``"B"``.
    """

    mean_dn: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    range_dn: float
    clipped_share: float
    zero_share: float
    spread_dn: float
    colours: tuple[str, ...]

    @property
    def greens(self) -> list[int]:
        """The indices of the green channels."""
        return [index for index, colour in enumerate(self.colours) if colour == "G"]

    def pooled(self, rows: int, columns: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Average groups of cells; return also the mask of groups without saturated pixels."""
        channels, height, width = self.mean_dn.shape
        height, width = height // rows, width // columns
        shape = (channels, height, rows, width, columns)
        crop = np.s_[:, : height * rows, : width * columns]
        mean: NDArray[np.float32] = self.mean_dn[crop].reshape(shape).mean(axis=(2, 4))
        clipped: NDArray[np.bool_] = np.any(self.clipped[crop].reshape(shape), axis=(2, 4))
        return mean, ~clipped


def reduce_to_cells(mosaic: Mosaic, sensor: Sensor, packed: NDArray[np.uint16]) -> Cells:
    """Return a frame's cells, from its mosaic and the same packed; a frame smaller than a cell has none."""
    black = packed_black_level_dn(sensor.cfa, sensor.black_level_dn)
    range_dn = sensor.white_level_dn - float(black.max())
    saturated = find_saturation_dn(mosaic, sensor)
    counts = _sum_cells(packed >= saturated) if int(mosaic.max()) >= saturated else None
    mean: NDArray[np.float32] = _sum_cells(packed).astype(np.float32)
    mean /= CELL**2
    mean -= black[:, None, None]
    clipped = np.zeros(mean.shape, dtype=np.bool_) if counts is None else counts > 0
    step = max(1, math.isqrt(mosaic.size // 100_000)) | 1  # odd: every site of the CFA takes part
    low, high = np.quantile(mosaic[::step, ::step], (0.159, 0.841))
    return Cells(
        mean_dn=mean,
        clipped=clipped,
        range_dn=range_dn,
        clipped_share=0.0 if counts is None else float(np.count_nonzero(mosaic >= saturated)) / mosaic.size,
        zero_share=1 - float(np.count_nonzero(mosaic)) / mosaic.size,
        spread_dn=float(high - low) / 2,
        colours=tuple(name[0] for name in packing_sites(sensor.cfa).names),
    )


def luminance(packed: NDArray[np.uint16], cells: Cells) -> NDArray[np.float32]:
    """Return the sum of the packed channels, (h, w), each scaled to the same mean: what a grey scene has.

    The sum of all sites of a CFA cell is a low-pass filter: detail finer than the packed pixels, which a single channel
    would show as coarser detail (aliasing) that moves differently from the scene, cancels for the most part.
    """
    mean = np.maximum(cells.mean_dn.mean(axis=(1, 2), dtype=np.float64), 1.0)
    total = np.zeros(packed.shape[1:], dtype=np.float32)
    for channel, scale in zip(packed, (mean.max() / mean).astype(np.float32), strict=True):
        total += channel * scale
    return total


def find_saturation_dn(mosaic: Mosaic, sensor: Sensor) -> float:
    """Find the level from which on pixels are saturated: the recorded white level, or a pile's below it.

    Some cameras saturate below the white level that their files state, by some DN more or less from pixel to pixel.
    """
    black, white = max(sensor.black_level_dn), sensor.white_level_dn
    top = float(mosaic.max())
    band = max(2.0, math.ceil(_PILE_BAND * (white - black)))
    if top - band <= black + _PILE_FROM * (white - black):
        return white
    inside = int(np.count_nonzero(mosaic > top - band))
    below = int(np.count_nonzero(mosaic > top - 2 * band)) - inside
    piled = inside >= _PILE_LEAST and inside > _PILE_FACTOR * below
    return min(white, top - band + 1) if piled else white


def _sum_cells(packed: NDArray[np.uint16] | NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Return sums over cells; slices are added, since numpy sums short axes slowly."""
    height, width = (size // CELL * CELL for size in packed.shape[1:])
    crop = packed[:, :height, :width]
    rows = np.zeros((len(crop), height // CELL, width), dtype=np.uint32)
    for offset in range(CELL):
        rows += crop[:, offset::CELL]
    sums = np.zeros((len(crop), height // CELL, width // CELL), dtype=np.uint32)
    for offset in range(CELL):
        sums += rows[:, :, offset::CELL]
    return sums


def empty_share(mosaic: NDArray[np.uint16]) -> float:
    """Return the share of values that never occur, of those whose neighbours are frequent; 0 if none is.

    A file of 14 bits that holds 12 lacks 3 of 4. Neighbours on both sides: beside a saturated area or a peak of black,
    values that do not occur are not a gap.
    """
    counts = np.bincount(mosaic.ravel())
    below = np.cumsum(counts)
    low, high = (int(np.searchsorted(below, share * mosaic.size)) for share in _TAILS)
    inner = counts[low : high + 1]
    if len(inner) < _NEAR:
        return 0.0
    sums = np.convolve(inner, np.ones(_NEAR, np.int64))
    before, after = np.concatenate([[0], sums])[: len(inner)], np.append(sums, 0)[_NEAR : _NEAR + len(inner)]
    frequent = np.minimum(before, after) >= _NEAR * _LEAST_EACH
    return float(np.mean(inner[frequent] == 0)) if frequent.any() else 0.0


# --- the frames of a scene -------------------------------------------------------------------------------------------


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
        """First file, which an error of a worker names."""
        return self.folder / self.records[0].path


@dataclass(frozen=True, slots=True, eq=False)
class ReducedFrame:
    """The cells of a decoded frame, and its luminance, which is meant for use at once.

    ``empty_share``: of its values (:func:`capture.check.frames.empty_share`).
    """

    record: FrameRecord
    exposure: Exposure
    sensor: Sensor
    cells: Cells
    luminance: NDArray[np.float32]
    empty_share: float

    def scale_cells_to(self, reference: Sensor) -> Cells:
        """Return the cells in a reference's DN: as large a share of white, whatever the bits of either file."""
        levels, of_reference = mean_levels(self.sensor), mean_levels(reference)
        if levels[1] == of_reference[1] or differ_in_white(levels, of_reference):
            return self.cells  # one DN scale, also where a file states a wrong black
        scale = (of_reference[1] - of_reference[0]) / (levels[1] - levels[0])
        return replace(self.cells, mean_dn=self.cells.mean_dn * np.float32(scale), range_dn=self.cells.range_dn * scale)


def reduce_frames(unit: Unit, group: CheckedGroup) -> Iterator[ReducedFrame]:
    """Yield each frame reduced; at most ``unit.workers.jobs`` + 1 are in memory.

    A frame that cannot be read, or compared with the first one, is left out with a remark in ``group``.
    """

    def reduce(record: FrameRecord) -> ReducedFrame | EldataError:
        """Read a frame and reduce it to cells; return the error if it cannot be read."""
        from eldata.raw.levels import pack
        from eldata.raw.reading import read_raw

        try:
            frame = read_raw(inside(unit.folder, record.path))
            mosaic = frame.whole_dn("the check of a set")
        except EldataError as error:
            return error
        packed = pack(mosaic, frame.sensor.cfa)
        cells = reduce_to_cells(mosaic, frame.sensor, packed)
        return ReducedFrame(record, frame.exposure, frame.sensor, cells, luminance(packed, cells), empty_share(mosaic))

    first: tuple[str, Sensor] | None = None
    for record, frame in zip(unit.records, unit.workers.read_ahead(reduce, unit.records), strict=True):
        if isinstance(frame, EldataError):
            text = f"cannot be read ({getattr(frame, 'reason', '') or frame}); copy it again from the card"
            if isinstance(frame, UnusableRawError):
                text = f"{frame.found}; {frame.advice}"
            group.remark(record.path, text, "shoot again")
            continue
        first = first or (record.path, frame.sensor)
        (path, ours), theirs = first, frame.sensor
        kinds = {
            "camera": (theirs.model, ours.model),
            "size": ((theirs.width, theirs.height), (ours.width, ours.height)),
            "colour filter array": (theirs.cfa, ours.cfa),
        }
        problems = [f"{kind} {new}, where {path} has {old}" for kind, (new, old) in kinds.items() if new != old]
        if problems:
            group.remark(record.path, f"{problems[0]}; take all frames with one camera and raw format", "shoot again")
        else:
            yield frame


def file_name(path: str) -> str:
    """Return the last part of a manifest's path."""
    return path.rpartition("/")[2]


# --- small pictures for the contact sheet ----------------------------------------------------------------------------


def draw_scene(frame: ReducedFrame, gain: float) -> SheetPicture:
    """Return a frame as a picture, amplified."""
    iso, time = frame.exposure.iso, frame.exposure.exposure_s
    settings = f"ISO {float(iso):g}" if iso is not None else "ISO ?"
    settings += f", {format_exposure(time)}" if time is not None else ""
    amplified = f", x{gain:g}" if gain != 1 else ""
    caption = f"{file_name(frame.record.path)}: {settings}{amplified}"
    light = _mean_colours(frame.cells) * gain / frame.cells.range_dn
    balance = frame.sensor.white_balance
    if balance is not None:
        light *= np.array(balance[:3], dtype=np.float32)
    return SheetPicture(caption, frame.record.path, _encode_jpeg(255 * srgb_encode(np.clip(light, 0, 1))))


def draw_change(first: ReducedFrame, last: ReducedFrame) -> SheetPicture:
    """Draw where the last reference is brighter (red) or darker (blue) than the first."""
    before, after = (_mean_colours(frame.cells)[..., 1] for frame in (first, last))
    floor = 0.01 * first.cells.range_dn
    change = (after - before) / np.maximum(before, floor)
    caption = f"{file_name(last.record.path)} over {file_name(first.record.path)}, ±{100 * _CHANGE_SHOWN:g} %"
    return SheetPicture(caption, last.record.path, _encode_jpeg(_colour_signed(change / _CHANGE_SHOWN)))


def draw_map(caption: str, path: str, values: NDArray[np.floating], full: float) -> SheetPicture:
    """Return a map of values, blue at ``-full``, red at ``+full``."""
    scale = max(1, _WIDEST // (2 * values.shape[1]))
    larger = np.kron(values, np.ones((scale, scale)))
    return SheetPicture(caption, path, _encode_jpeg(_colour_signed(larger / full)))


def _mean_colours(cells: Cells) -> NDArray[np.float32]:
    """Return the means of R, G and B, (rows, columns, 3), in as many cells as a small picture has pixels."""
    group = max(1, -(-cells.mean_dn.shape[2] // _WIDEST))
    mean, _ = cells.pooled(group, group)
    colours = np.array(cells.colours)
    return np.stack([mean[colours == colour].mean(axis=0) for colour in "RGB"], axis=-1)


def _colour_signed(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return -1 as blue, 0 as light grey and 1 as red, 0 to 255."""
    strength = np.clip(values, -1, 1)[..., None]
    grey, red, blue = (np.array(colour) for colour in ((235, 235, 235), (190, 20, 30), (20, 70, 190)))
    colours: NDArray[np.floating] = np.where(
        strength >= 0, grey + strength * (red - grey), grey - strength * (blue - grey)
    )
    return colours


def _encode_jpeg(colours: NDArray[np.floating]) -> bytes:
    """Encode colours (h, w, 3), 0 to 255, as a JPEG."""
    from PIL import Image

    image = Image.fromarray(np.rint(colours).astype(np.uint8))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=_QUALITY)
    return file.getvalue()
