"""The part of a frame that becomes an item: drawn or named, read, turned, normalised."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eldata.base.compiled import scratch
from eldata.errors import ArgumentError, DatasetError
from eldata.raw.levels import PackedArea, cfa_from, pack_normalised, packed_area, packed_shape, packing_sites, with_rows
from eldata.sources.frames import RGB_WHITE, Frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.raw.levels import CfaRows, Clip


# --- flips and transposes of mosaics that keep the CFA in order -------------------------------------------------------

# Flipping packed channels would put each colour where another stood, as in no sensor. Here the mosaic itself is flipped
# or transposed, and then cropped by the few rows and columns after which its CFA starts as it did. Bayer and X-Trans
# patterns allow all eight orientations.

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Orientation:
    """One of the eight orientations: first the transpose, then the flips."""

    transpose: bool = False
    flip_rows: bool = False
    flip_columns: bool = False


ORIENTATIONS = tuple(Orientation(*flags) for flags in product((False, True), repeat=3))


def turn_mosaic(mosaic: NDArray[Scalar], cfa: CfaRows, orientation: Orientation) -> NDArray[Scalar]:
    """Return a view of a mosaic (H, W) in an orientation, its CFA as before.

    The view has lost up to one period less one of rows at the top and of columns at the left; the caller crops it.

    Raises
    ------
    ArgumentError
        If the mosaic's sides are not multiples of the CFA's period, which the flips need.
    """
    period = len(cfa)
    if mosaic.ndim != 2 or any(side % period for side in mosaic.shape):
        raise ArgumentError(f"expected a mosaic whose sides are multiples of {period}; found shape {mosaic.shape}")
    top, left = _find_offset(cfa, orientation)
    return _orient(mosaic, orientation)[top:, left:]


def copy_turned(mosaic: NDArray[Scalar], cfa: CfaRows, orientation: Orientation, copy: NDArray[Scalar]) -> None:
    """Fill ``copy`` (height, width) with ``turn_mosaic(mosaic, cfa, orientation)[:height, :width]``.

    Packing reads rows: from a transposed view it takes ten times as long as this copy and the packing of it.

    Raises
    ------
    ArgumentError
        As :func:`turn_mosaic`; or if the turned mosaic is smaller than that.
    """
    from eldata.raw._kernels import mirror, transpose

    view = turn_mosaic(mosaic, cfa, orientation)
    if copy.shape[0] > view.shape[0] or copy.shape[1] > view.shape[1]:
        raise ArgumentError(f"a turned mosaic of {view.shape} pixels does not fill {copy.shape}")
    # What the view lost at the top and left, it lost at these ends of the mosaic.
    top, left = _find_offset(cfa, orientation)
    rows, columns = (left, top) if orientation.transpose else (top, left)
    flips = orientation.flip_rows, orientation.flip_columns
    flip_mosaic_rows, flip_mosaic_columns = reversed(flips) if orientation.transpose else flips
    part = mosaic[
        slice(None, mosaic.shape[0] - rows) if flip_mosaic_rows else slice(rows, None),
        slice(None, mosaic.shape[1] - columns) if flip_mosaic_columns else slice(columns, None),
    ]
    turn = transpose if orientation.transpose else mirror
    turn(with_rows(part), copy, orientation.flip_rows, orientation.flip_columns)


def turn_levels(levels: tuple[float, ...], orientation: Orientation) -> tuple[float, ...]:
    """Reorder the levels of a CFA's channels, 3 for X-Trans and else 4, for the channels of the turned mosaic.

    The first green is the one in red's rows. A flip leaves it there; a transpose swaps the two greens and their black
    levels, which may differ by a few DN.
    """
    if not orientation.transpose or len(levels) != 4:
        return levels
    red, first, blue, second = levels
    return red, second, blue, first


def _orient(array: NDArray[Scalar], orientation: Orientation) -> NDArray[Scalar]:
    """View an array (H, W) transposed and flipped as an orientation says."""
    turned = array.T if orientation.transpose else array
    return turned[:: -1 if orientation.flip_rows else 1, :: -1 if orientation.flip_columns else 1]


@cache
def _find_offset(cfa: CfaRows, orientation: Orientation) -> tuple[int, int]:
    """Find the rows and columns to cut off a turned mosaic, so that it begins with its CFA's first site."""
    pattern = np.asarray(cfa)
    # Which of the two greens is which follows from the place: they are told apart again after the turn.
    colours = np.where(pattern == 3, 1, pattern)
    turned = _orient(colours, orientation)
    period = len(cfa)
    for top, left in sorted(product(range(period), repeat=2), key=sum):
        if np.array_equal(np.roll(turned, (-top, -left), axis=(0, 1)), colours):
            return top, left
    raise ArgumentError(f"the CFA {cfa} has no orientation {orientation}")


Region = tuple[int, int, int, int]

_NO_CFA: CfaRows = ((0,),)
_TURNED = (np.dtype(np.uint16), np.dtype(np.float32))  # DN; simulated, or less a dark shading
_AS_IT_IS = Orientation()


@dataclass(frozen=True, slots=True)
class Crop:
    """A part of a frame and the way that it is turned; it fits every frame of the same size and CFA.

    Attributes
    ----------
    slices
        The part of the frame, with the margin that turning a mosaic costs.
    cfa
        Of that part; empty for RGB.
    orientation
        Applied to it.
    height, width
        Of the turned part, without the margin.
    """

    slices: tuple[slice, slice]
    cfa: CfaRows
    orientation: Orientation
    height: int
    width: int

    @classmethod
    def draw(
        cls, frame: Frame, generator: np.random.Generator, *, crop: int | None, augment: bool, tile: int | None = None
    ) -> Crop:
        """Draw a place, unless a tile names it, and with ``augment`` one of the eight orientations.

        Parameters
        ----------
        frame
            The frame, or one like it.
        generator
            Decides orientation, top and left, in this order.
        crop
            Side in pixels of the packed or RGB frame; ``None`` takes all of it.
        tile
            Which one of the grid (:meth:`count_tiles`), row by row from 0.

        Raises
        ------
        ArgumentError
            If ``crop`` is odd for X-Trans.
        DatasetError
            If the frame is too small.
        """
        orientation = ORIENTATIONS[int(generator.integers(len(ORIENTATIONS)))] if augment else _AS_IT_IS
        area, period, scale, cfa = _grid(frame.shape, frame.cfa)
        margin = period if augment and frame.cfa else 0
        rows, columns = (area.height - margin, area.width - margin) if crop is None else (crop * scale, crop * scale)
        if rows % period or columns % period:
            raise ArgumentError(f"crop must be even for X-Trans; found {crop}")
        height, width = (columns, rows) if orientation.transpose else (rows, columns)
        if rows + margin > area.height or columns + margin > area.width or min(rows, columns) <= 0:
            raise DatasetError(
                f"{frame.name}: {area.height} x {area.width} pixels are too few for a crop of {rows + margin} x "
                f"{columns + margin} (crop={crop}, augment={augment}); take a smaller crop"
            )
        if tile is None:
            top = period * int(generator.integers((area.height - rows - margin) // period + 1))
            left = period * int(generator.integers((area.width - columns - margin) // period + 1))
        else:
            row, column = divmod(tile, (area.width - margin) // columns)
            top, left = row * rows, column * columns
        top, left = area.top + top, area.left + left
        place = slice(top, top + rows + margin), slice(left, left + columns + margin)
        return cls(place, cfa, orientation, height, width)

    @classmethod
    def count_tiles(cls, frame: Frame, *, crop: int, augment: bool) -> int:
        """Count the crops that lie side by side in a frame, from its first row and column on.

        What is left over at the bottom and at the right, less than a crop and with ``augment`` one period of the CFA,
        is in none. Raises like :meth:`draw`.
        """
        first = cls.draw(frame, np.random.default_rng(0), crop=crop, augment=augment, tile=0)  # refuses what has none
        area, period, _, _ = _grid(frame.shape, frame.cfa)
        margin = period if augment and frame.cfa else 0
        return ((area.height - margin) // first.height) * ((area.width - margin) // first.width)

    @classmethod
    def region(cls, frame: Frame, region: Region) -> Crop:
        """Return the part (top, left, height, width), in pixels of the packed or RGB frame.

        Raises
        ------
        ArgumentError
            If a number is odd for X-Trans.
        DatasetError
            If it is not inside of the frame.
        """
        area, period, scale, cfa = _grid(frame.shape, frame.cfa)
        top, left, height, width = (side * scale for side in region)
        if any(side % period for side in (top, left, height, width)):
            raise ArgumentError(f"region must be of even numbers for X-Trans; found {region}")
        if top + height > area.height or left + width > area.width:
            inside = area.height // scale, area.width // scale
            raise DatasetError(f"{frame.name}: region {region} is not inside of {inside} pixels")
        place = slice(area.top + top, area.top + top + height), slice(area.left + left, area.left + left + width)
        return cls(place, cfa, _AS_IT_IS, height, width)

    def place(self, frame: Frame, what: str) -> tuple[int, int]:
        """Find the (top, left) in the packed mosaic of a part that is not turned and as large as the turned crop.

        Raises
        ------
        DatasetError
            If it ends outside of the sensor; the message has ``what`` is not turned, such as "dark frames are".
        """
        area, _, scale, _ = _grid(frame.shape, frame.cfa)
        top, left = (part.start - start for part, start in zip(self.slices, (area.top, area.left), strict=True))
        if top + self.height > area.height or left + self.width > area.width:
            raise DatasetError(
                f"{frame.name}: {what} not turned, and its turned crop, {self.height} x {self.width} pixels, is not "
                "within the sensor; give a square crop=, or augment=False for whole frames"
            )
        return top // scale, left // scale

    @property
    def packed_shape(self) -> tuple[int, int, int]:
        """Shape of the packed crop, (C, h, w)."""
        return packed_shape((self.height, self.width), self.cfa) if self.cfa else (3, self.height, self.width)

    def turn(self, part: NDArray[Any]) -> NDArray[Any]:
        """Return the crop, turned, from the part of the mosaic (or of one plane) that :attr:`slices` name.

        It lies in memory that the thread's next call may overwrite.
        """
        cfa = self.cfa or _NO_CFA
        if part.dtype not in _TURNED or self.orientation == _AS_IT_IS:
            return turn_mosaic(part, cfa, self.orientation)[: self.height, : self.width]
        copy = scratch("turned", (self.height, self.width), part.dtype)
        copy_turned(part, cfa, self.orientation, copy)
        return copy

    def cut(self, frame: Frame) -> NDArray[Any]:
        """Return the crop of a mosaic in DN, turned, to be used before the thread reads the next frame."""
        return self.turn(frame.read(*self.slices))

    def levels(self, levels_dn: tuple[float, ...]) -> tuple[float, ...]:
        """Return the levels of the turned crop's channels, given the frame's."""
        return turn_levels(levels_dn, self.orientation)

    def fill(self, frame: Frame, out: NDArray[np.float32], *, clip: Clip = "both", gain: float = 1.0) -> None:
        """Write the crop of a frame into ``out`` (C, h, w): packed, normalised, amplified; RGB divided by 65535."""
        if not self.cfa:
            for plane, target in zip(frame.read(*self.slices), out, strict=True):
                np.divide(self.turn(plane), np.float32(RGB_WHITE), out=target)
            return
        cut, black, white = self.cut(frame), self.levels(frame.black_level_dn), frame.white_level_dn
        corrected = cut.dtype != np.uint16
        if corrected:
            cut = cut.astype(np.float32, copy=False)
        pack_normalised(cut, self.cfa, black, white, clip=clip, gain=gain, corrected=corrected, out=out)


@lru_cache(maxsize=256)
def _grid(shape: tuple[int, int], cfa: CfaRows) -> tuple[PackedArea, int, int, CfaRows]:
    """Find the area that packing keeps, the CFA's period, mosaic pixels per packed one, and the CFA of the area."""
    if not cfa:
        return PackedArea(0, 0, *shape), 1, 1, ()
    sites, area = packing_sites(cfa), packed_area(shape, cfa)
    # From the area's corner the pattern starts as packing wants it.
    return area, len(cfa), sites.scale, cfa_from(cfa, area.top, area.left)
