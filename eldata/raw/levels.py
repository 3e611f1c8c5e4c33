"""Levels and packing: the mosaic split by CFA position, and its DN divided by the range of its levels.

Packed form
-----------
Bayer (2x2, any phase)
    (4, H/2, W/2) in the order R, G1, B, G2; G1 shares R's rows. No phase is cropped: each channel holds its
    colour's site of every 2x2 cell.
X-Trans (6x6, any offset)
    (9, H/3, W/3) in the order of the SID code [1]_: R, G, B, R, B, G, G, G, G.
Quad-Bayer (4x4: Bayer of 2x2 blocks, any offset)
    (16, H/4, W/4): the sites of R's block row by row (R.00, R.01, R.10, R.11), then of G1's, of B's, of G2's.
Nona-Bayer (6x6: Bayer of 3x3 blocks, any offset)
    (36, H/6, W/6): likewise, nine sites a block.

Each site of a block has a channel of its own, so that every channel is one regular grid, as Bayer's are: nothing in
it alternates from pixel to pixel, and a network may shift it. Android's calibration of quad-Bayer noise has the same 16
channels [2]_. It also leaves no doubt: 4, 9, 16 or 36 channels name the CFA. The order makes the two other forms in use
one step away, in the order R, G1, B, G2: with n = 2 or 3, ``torch.nn.functional.pixel_shuffle(packed, n)`` is
(4, H/2, W/2) with the sites of a block side by side, as published remosaicing code has it, and
``packed.reshape(4, n * n, h, w).mean(1)`` what the sensor gives when it bins.

The packed area
---------------
A mosaic is cropped before packing (:func:`packed_area`): X-Trans first loses the rows at the top and the columns at
the left (0 to 5 each, the fewest in all, and then the fewer rows) up to where its pattern starts as it does in the SID
code, so that every X-Trans camera packs to the same geometry; quad and nona lose those up to the first whole block (0
to 1, 0 to 2), so that the sites of a block stay together. Then each CFA loses the rows at the bottom and the columns at
the right that do not fill a whole period. Within that area packing is a permutation: ``unpack(pack(x)) == x`` exactly.

References
----------
.. [1] C. Chen, Q. Chen, J. Xu and V. Koltun, "Learning to See in the Dark", CVPR 2018, test_Fuji.py.
.. [2] Android Open Source Project, CameraITS, noise_model_utils.py (QUAD_BAYER_COLORS); there G2 stands before B.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, get_args

import numpy as np

from eldata.errors import ArgumentError, DatasetError, check_choice

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.records import RawFrame, Sensor

    Cfa: TypeAlias = Sequence[Sequence[int]] | NDArray[np.integer[Any]]

CfaRows = tuple[tuple[int, ...], ...]
Scalar = TypeVar("Scalar", bound=np.generic)

BAYER_CHANNELS = ("R", "G1", "B", "G2")
XTRANS_CHANNELS = ("R", "G", "B", "R", "B", "G", "G", "G", "G")

_BLOCK_NAMES = {1: "Bayer", 2: "quad-Bayer", 3: "nona-Bayer"}  # by sites along each side of a block

BAYER_PHASES: dict[str, CfaRows] = {
    "RGGB": ((0, 1), (3, 2)),
    "GRBG": ((1, 0), (2, 3)),
    "GBRG": ((3, 2), (0, 1)),
    "BGGR": ((2, 3), (1, 0)),
}
XTRANS_CFA: CfaRows = (
    (0, 2, 1, 2, 0, 1),
    (1, 1, 0, 1, 1, 2),
    (1, 1, 2, 1, 1, 0),
    (2, 0, 1, 0, 2, 1),
    (1, 1, 2, 1, 1, 0),
    (1, 1, 0, 1, 1, 2),
)

# The SID code's order: the packed channel of each site of the 6x6 period above; its packed row is row // 3 and
# its packed column is column // 3, so that a packed pixel holds just the nine sites of one 3x3 block.
_XTRANS_CHANNEL: CfaRows = (
    (0, 2, 1, 2, 0, 1),
    (5, 6, 3, 5, 6, 4),
    (7, 8, 4, 7, 8, 3),
    (2, 0, 1, 0, 2, 1),
    (5, 6, 4, 5, 6, 3),
    (7, 8, 3, 7, 8, 4),
)


@dataclass(frozen=True, slots=True)
class PackedArea:
    """The part of a mosaic that packing keeps, in mosaic pixels."""

    top: int
    left: int
    height: int
    width: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index of the area: ``mosaic[area.slices]``."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


@dataclass(frozen=True, slots=True, eq=False)
class Sites:
    """Where packing puts each site of one CFA period.

    Attributes
    ----------
    name
        ``"Bayer"``, ``"X-Trans"``, ``"quad-Bayer"`` or ``"nona-Bayer"``.
    cfa
        As it is where packing begins.
    period, sub
        Side of the period in the mosaic, and in the packed image.
    top, left
        Rows and columns that packing drops first.
    names
        Of the packed channels, each beginning with its colour's letter.
    table
        (sites, 5) int64, read-only: mosaic row and column, packed channel, packed row and column, the last two below
        ``sub``.
    colours
        Channel index in the CFA, and so in ``black_level_dn``, of each packed channel.
    """

    name: str
    cfa: CfaRows
    period: int
    sub: int
    top: int
    left: int
    names: tuple[str, ...]
    table: NDArray[np.int64]
    colours: tuple[int, ...]

    @property
    def channels(self) -> int:
        """Number of packed channels."""
        return len(self.colours)

    @property
    def scale(self) -> int:
        """Mosaic pixels along each side of a packed pixel."""
        return self.period // self.sub

    @property
    def block(self) -> int:
        """Sites along each side of a block of one colour: 1 for Bayer, 2 for quad, 3 for nona; 1 for X-Trans."""
        return self.period // 2 if self.sub == 1 else 1

    @property
    def levels(self) -> int:
        """Number of the CFA's channels, and so of black levels."""
        return max(self.colours) + 1

    @property
    def channel_of(self) -> NDArray[np.int64]:
        """The packed channel of each site, by its row and column in a period."""
        return self.table[:, 2].reshape(self.period, self.period)

    @property
    def slices(self) -> Iterator[tuple[tuple[Any, ...], tuple[Any, ...]]]:
        """Index of each site's pixels in a mosaic (..., H, W), and where packing puts them in (..., C, h, w)."""
        for row, column, channel, y, x in self.table.tolist():
            in_mosaic = ..., slice(row, None, self.period), slice(column, None, self.period)
            yield in_mosaic, (..., channel, slice(y, None, self.sub), slice(x, None, self.sub))


def cfa_from(cfa: CfaRows, top: int, left: int) -> CfaRows:
    """CFA of a mosaic without its first rows and columns."""
    period = len(cfa)
    return tuple(tuple(cfa[(y + top) % period][(x + left) % period] for x in range(period)) for y in range(period))


def bayer_cfa(first: str = "RGGB", block: int = 1) -> CfaRows:
    """Make a Bayer CFA, or one whose sites are blocks of one colour.

    Parameters
    ----------
    first
        The colours of its first 2 x 2 sites or blocks, row by row: ``"RGGB"``, ``"BGGR"``, ``"GRBG"`` or ``"GBRG"``.
    block
        Sites along each side of a block: 1 for Bayer, 2 for quad-Bayer, 3 for nona-Bayer.

    Returns
    -------
    tuple of tuples
        Channel indices by row, as :attr:`eldata.records.Sensor.cfa` has them.

    Raises
    ------
    ArgumentError
        If the colours are no Bayer pattern, or the block is of another size.
    """
    if block not in _BLOCK_NAMES:
        raise ArgumentError(f"block must be 1 (Bayer), 2 (quad-Bayer) or 3 (nona-Bayer); found {block!r}")
    check_choice("first", first, BAYER_PHASES)
    return _repeat_in_blocks(BAYER_PHASES[first], block)


def cfa_of_letters(rows: Sequence[str]) -> CfaRows | None:
    """Find the CFA that has these colours (R, G, B), one period by row; None if it is unsupported."""
    # A pattern that tells its greens apart has G1 in R's rows.
    two_greens = tuple(tuple({"R": 0, "B": 2}.get(c, 1 if "R" in row else 3) for c in row) for row in rows)
    one_green = tuple(tuple({"R": 0, "B": 2}.get(c, 1) for c in row) for row in rows)
    if set("".join(rows)) == set("RGB"):
        for cfa in (two_greens, one_green):
            if _find_sites(cfa) is not None:
                return cfa
    return None


def _repeat_in_blocks(cfa: CfaRows, block: int) -> CfaRows:
    """Repeat each site of a CFA as ``block`` x ``block`` sites."""
    return tuple(tuple(index for index in row for _ in range(block)) for row in cfa for _ in range(block))


def _list_sites(sub: int, channel_of: CfaRows) -> NDArray[np.int64]:
    """List a period's sites for kernels, (sites, 5): row, column, packed channel, packed row and column."""
    period = len(channel_of)
    scale = period // sub
    sites = [
        (row, column, channel_of[row][column], row // scale, column // scale)
        for row, column in np.ndindex(period, period)
    ]
    table = np.array(sites, dtype=np.int64)
    table.flags.writeable = False
    return table


def _block_sites(cfa: CfaRows, block: int, top: int, left: int) -> Sites:
    """Sites of a pattern of blocks that begins with a whole one after ``top`` rows and ``left`` columns."""
    count = block * block
    names = tuple(f"{name}.{y}{x}" for name in BAYER_CHANNELS for y, x in np.ndindex(block, block))
    channel_of = tuple(
        tuple(count * index + block * (y % block) + x % block for x, index in enumerate(row))
        for y, row in enumerate(cfa)
    )
    colours = tuple(index for index in range(len(BAYER_CHANNELS)) for _ in range(count))
    names = BAYER_CHANNELS if block == 1 else names
    return Sites(_BLOCK_NAMES[block], cfa, 2 * block, 1, top, left, names, _list_sites(1, channel_of), colours)


@cache
def _find_sites(cfa: CfaRows) -> Sites | None:
    """Find how a CFA is packed, as blocks (Bayer, quad, nona) or X-Trans; None if it is neither."""
    period, block = len(cfa), len(cfa) // 2
    if block not in _BLOCK_NAMES or any(len(row) != period for row in cfa):
        return None
    in_blocks = {_repeat_in_blocks(bayer, block) for bayer in BAYER_PHASES.values()}
    for top, left in sorted(np.ndindex(period, period), key=sum):
        here = cfa_from(cfa, top, left)
        if here in in_blocks:
            return _block_sites(here, block, top, left)
        if here == XTRANS_CFA:
            colours = tuple("RGB".index(name) for name in XTRANS_CHANNELS)
            return Sites("X-Trans", here, 6, 2, top, left, XTRANS_CHANNELS, _list_sites(2, _XTRANS_CHANNEL), colours)
    return None


@cache
def packed_layouts() -> dict[int, Sites]:
    """Find the sites of a CFA of each kind, by its number of packed channels, which tells them apart.

    Each in the phase that begins with R: the phase changes no channel's meaning.
    """
    each = (bayer_cfa(), XTRANS_CFA, bayer_cfa(block=2), bayer_cfa(block=3))
    return {sites.channels: sites for sites in map(packing_sites, each)}


def packed_forms(form: str = "{channels} ({name})") -> str:
    """Name the numbers of packed channels that there are: ``"4 (Bayer), ... or 36 (nona-Bayer)"``."""
    *others, last = (form.format(channels=sites.channels, name=sites.name) for sites in packed_layouts().values())
    return f"{', '.join(others)} or {last}"


def packing_sites(cfa: Cfa) -> Sites:
    """Find where packing puts the sites of a CFA.

    Raises
    ------
    ArgumentError
        If the CFA is unsupported.
    """
    try:
        return _cached_sites(cfa)  # type: ignore[arg-type] # it is seen whether it has a hash
    except TypeError:  # lists and arrays have no hash
        return _cached_sites(tuple(tuple(map(int, row)) for row in cfa))


@lru_cache(maxsize=256)
def _cached_sites(cfa: Any) -> Sites:
    """Find the sites of a CFA as it was given: to go through its numbers takes longer than to pack a small crop."""
    sites = _find_sites(tuple(tuple(map(int, row)) for row in cfa))
    if sites is None:
        raise ArgumentError(
            f"unsupported CFA {cfa}: expected a 2x2 Bayer pattern (0 = R, 1 = G1 in R's row, 2 = B, 3 = G2), one of "
            "2x2 or 3x3 blocks of these (quad-Bayer, nona-Bayer) or a 6x6 X-Trans pattern (0 = R, 1 = G, 2 = B), the "
            "last three at any offset"
        )
    return sites


def packed_channels(cfa: Cfa) -> int:
    """Count the channels of the packed form: 4 for Bayer, 9 for X-Trans, 16 for quad, 36 for nona."""
    return packing_sites(cfa).channels


def packed_area(shape: tuple[int, int], cfa: Cfa) -> PackedArea:
    """Find the area of a mosaic of ``shape`` (H, W) that packing keeps (see the module's text).

    Raises
    ------
    ArgumentError
        If the CFA is unsupported, or the mosaic does not hold one whole period.
    """
    return _cached_area(shape, packing_sites(cfa))


@lru_cache(maxsize=256)
def _cached_area(shape: tuple[int, int], sites: Sites) -> PackedArea:
    """Find the part of a mosaic (H, W) that whole periods of its CFA cover; refuse a mosaic without one."""
    height = (shape[0] - sites.top) // sites.period * sites.period
    width = (shape[1] - sites.left) // sites.period * sites.period
    if height <= 0 or width <= 0:
        raise ArgumentError(
            f"a mosaic of {shape[0]} x {shape[1]} pixels does not hold one whole {sites.period} x "
            f"{sites.period} period of its CFA"
        )
    return PackedArea(sites.top, sites.left, height, width)


def packed_shape(shape: tuple[int, int], cfa: Cfa) -> tuple[int, int, int]:
    """Compute the packed shape (C, h, w) of a mosaic of ``shape`` (H, W)."""
    sites = packing_sites(cfa)
    area = _cached_area(shape, sites)
    return sites.channels, area.height // sites.scale, area.width // sites.scale


def kept_area(mosaic: NDArray[Scalar], sites: Sites) -> NDArray[Scalar]:
    """Crop a mosaic (H, W) to what packing keeps, with rows that are contiguous in memory."""
    if mosaic.ndim != 2:
        raise ArgumentError(f"a mosaic has two dimensions (H, W); found shape {mosaic.shape}")
    return with_rows(mosaic[_cached_area(mosaic.shape, sites).slices])


def with_rows(values: NDArray[Scalar]) -> NDArray[Scalar]:
    """Make rows contiguous in memory, as kernels read them; copy only if they are not."""
    return values if values.strides[-1] == values.itemsize else np.ascontiguousarray(values)


def pack(mosaic: NDArray[Scalar], cfa: Cfa) -> NDArray[Scalar]:
    """Split a mosaic by CFA position.

    Parameters
    ----------
    mosaic
        (H, W), any dtype of 1, 2, 4 or 8 bytes.
    cfa
        The CFA of its pixel (0, 0), as :attr:`eldata.records.Sensor.cfa`.

    Returns
    -------
    ndarray
        (C, h, w), the same dtype and values; C, order and crop as in the module's text.

    Raises
    ------
    ArgumentError
        If the CFA is unsupported, or the mosaic smaller than one period.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.raw import bayer_cfa, pack
    >>> mosaic = np.arange(16, dtype=np.uint16).reshape(4, 4)
    >>> pack(mosaic, bayer_cfa("RGGB"))[:, 0]
    array([[0, 2],
           [1, 3],
           [5, 7],
           [4, 6]], dtype=uint16)
    """
    from eldata.raw._kernels import gather_bayer

    sites = packing_sites(cfa)
    area = kept_area(mosaic, sites)
    packed: NDArray[Scalar] = np.empty(packed_shape(mosaic.shape, cfa), dtype=mosaic.dtype)
    if sites.period == 2:
        gather_bayer(_as_bits(area), _as_bits(packed), sites.channel_of)
    else:
        for in_mosaic, in_packed in sites.slices:
            packed[in_packed] = area[in_mosaic]
    return packed


def unpack(packed: NDArray[Scalar], cfa: Cfa) -> NDArray[Scalar]:
    """Put packed channels back in their places: the exact inverse of :func:`pack` on its packed area.

    Parameters
    ----------
    packed
        (C, h, w) with C = 4 for Bayer, 9 for X-Trans (then h and w are even), 16 for quad-Bayer or 36 for nona-Bayer;
        any dtype of 1, 2, 4 or 8 bytes.
    cfa
        The CFA that ``pack`` was given.

    Returns
    -------
    ndarray
        (H, W), the same dtype: ``mosaic[packed_area(mosaic.shape, cfa).slices]``.

    Raises
    ------
    ArgumentError
        If the shape does not fit the CFA.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.raw import bayer_cfa, pack, unpack
    >>> mosaic = np.arange(24, dtype=np.uint16).reshape(4, 6)
    >>> np.array_equal(unpack(pack(mosaic, bayer_cfa("GBRG")), bayer_cfa("GBRG")), mosaic)
    True
    """
    sites = packing_sites(cfa)
    if packed.ndim != 3 or packed.shape[0] != sites.channels or any(n % sites.sub for n in packed.shape[1:]):
        even = "" if sites.sub == 1 else " with even h and w"
        raise ArgumentError(f"expected packed data ({sites.channels}, h, w){even}; found shape {packed.shape}")
    mosaic = np.empty((packed.shape[1] * sites.scale, packed.shape[2] * sites.scale), dtype=packed.dtype)
    for in_mosaic, in_packed in sites.slices:
        mosaic[in_mosaic] = packed[in_packed]
    return mosaic


def _as_bits(values: NDArray[Any]) -> NDArray[np.unsignedinteger[Any]]:
    """View the same memory as unsigned integers: packing moves values, whatever they are."""
    if values.dtype.hasobject or values.dtype.itemsize not in (1, 2, 4, 8):
        raise ArgumentError(f"values of 1, 2, 4 or 8 bytes can be packed, not {values.dtype}")
    return values.view(f"u{values.dtype.itemsize}")


# --- levels -----------------------------------------------------------------------------------------------------------

Clip = Literal["both", "upper", "none"]
_LARGEST = float(np.finfo(np.float32).max)

CLIP_RANGES: dict[Clip, tuple[float, float]] = {
    "both": (0.0, 1.0),
    "upper": (-np.inf, 1.0),
    "none": (-np.inf, np.inf),
}

_CLIP_RANGES = {clip: (np.float32(low), np.float32(high)) for clip, (low, high) in CLIP_RANGES.items()}

# Choices of the white level, with the file's black level.
Levels = Literal["metadata", "published"]
LEVELS: tuple[Levels, ...] = get_args(Levels)

# Choices of both levels: those above, and the constants of one camera.
FrameLevels = Literal[Levels, "sid-sony", "sid-fuji", "lrid"]
FRAME_LEVELS: tuple[FrameLevels, ...] = get_args(FrameLevels)

# The ELD and SID code divide by this white level for every camera, whatever its real one (ELD repository,
# sid_dataset.py; SID repository, test_Sony.py and test_Fuji.py).
PUBLISHED_WHITE_LEVEL_DN = 16383.0

# Black and white level that published code has for every file of a camera: the SID code (the same places), and for the
# phone of LRID PMN's (branch TPAMI, data_process/phone_datasets.py). The ELD code takes the black level of a Bayer file
# from the file, and for X-Trans from here.
CAMERA_LEVELS_DN: dict[str, tuple[float, float]] = {
    "sid-sony": (512.0, PUBLISHED_WHITE_LEVEL_DN),
    "sid-fuji": (1024.0, PUBLISHED_WHITE_LEVEL_DN),
    "lrid": (64.0, 1023.0),
}


# Ranges about a power of two apart are of files of so many bits more: 12 beside 14 are 3.5 to 4.6 times apart, by what
# white level makers state. White levels of one DN scale differ by less than that, Canon's from ISO to ISO 1.15 times.
_POWER_TOLERANCE = 1 / 6

MeanLevels = tuple[float, float]
"""Mean black level of the channels and white level of a file, DN."""


def mean_levels(sensor: Sensor) -> MeanLevels:
    """Compute a sensor's mean black level and its white level, DN."""
    return sum(sensor.black_level_dn) / len(sensor.black_level_dn), sensor.white_level_dn


def differ_in_white(levels: MeanLevels, reference: MeanLevels) -> bool:
    """Whether two files of a pair state different white levels on one DN scale, as Canon's do from ISO to ISO.

    Not so of shares of white, nor where the ranges are a power of two apart, as of files of 12 bits beside 14.
    """
    (black, white), (reference_black, reference_white) = levels, reference
    ranges = white - black, reference_white - reference_black
    if white == reference_white or min(white, reference_white) <= 1 or min(ranges) <= 0:  # which reading refuses
        return False
    ratio = max(ranges) / min(ranges)
    power = 2.0 ** round(math.log2(ratio))
    return power == 1 or abs(ratio / power - 1) > _POWER_TOLERANCE


def white_remark(levels: MeanLevels, reference: MeanLevels) -> str | None:
    """Remark on a noisy file whose white level is not its reference's; ``None`` if it is."""
    if levels[1] == reference[1]:
        return None
    why, taken = "ranges a power of two apart", "each is divided by its own range"
    if differ_in_white(levels, reference):
        why, taken = "on one DN scale", "both are divided by the reference's range, each after its own black"
    elif min(levels[1], reference[1]) <= 1:
        why = "one of them of shares of white"
    return (
        f"its white level is {levels[1]:g}, that of its reference {reference[1]:g}, {why}: by the files' levels {taken}"
    )


def with_levels(sensor: Sensor, levels: FrameLevels, reference: Sensor | None = None) -> Sensor:
    """Give a sensor the chosen black and white level.

    ``"metadata"``: the file's own; beside a ``reference`` whose white level is another on the same DN scale
    (:func:`differ_in_white`), white is where the range is the reference's. ``"published"``: white is 16383, black is
    the file's, per CFA channel. ``"sid-sony"`` (512 and 16383), ``"sid-fuji"`` (1024 and 16383) and ``"lrid"`` (64 and
    1023): the constants of the SID code and of PMN's for LRID, for comparison with numbers that were made with them.

    Raises
    ------
    ArgumentError
        If ``levels`` is unknown.
    """
    check_choice("levels", levels, FRAME_LEVELS)
    if levels == "metadata":
        if reference is None or not differ_in_white(mean_levels(sensor), mean_levels(reference)):
            return sensor
        black, white = mean_levels(reference)
        return replace(sensor, white_level_dn=mean_levels(sensor)[0] + (white - black))
    if levels == "published":
        return replace(sensor, white_level_dn=PUBLISHED_WHITE_LEVEL_DN)
    black, white = CAMERA_LEVELS_DN[levels]
    return replace(sensor, black_level_dn=(black,) * len(sensor.black_level_dn), white_level_dn=white)


def check_in_dn(name: str, sensor: Sensor, what: str) -> None:
    """Refuse a file that holds shares of white where DN are needed.

    Raises
    ------
    DatasetError
        If its white level is 1 or less.
    """
    if sensor.white_level_dn <= 1:
        raise DatasetError(
            f"{name}: its white level is {sensor.white_level_dn:g}, so it holds shares of white and no DN, and {what} "
            "is in DN; use files that hold the sensor's numbers"
        )


def check_white_in_dn(name: str, sensor: Sensor, white_level_dn: float) -> None:
    """Refuse such a file for a white level that is not its own; raises like :func:`check_in_dn`."""
    if white_level_dn != sensor.white_level_dn:
        check_in_dn(name, sensor, f'a white level of {white_level_dn:g} (not the file\'s own, "metadata")')


def packed_frame(
    frame: RawFrame, *, levels: FrameLevels, clip: Clip, gain: float = 1.0, reference: Sensor | None = None
) -> NDArray[np.float32]:
    """Pack and normalise a frame, (C, h, w) float32.

    Arguments as for :func:`pack_normalised`, and levels and reference as for :func:`with_levels`.

    Raises
    ------
    ArgumentError
        If ``levels``, ``clip`` or ``gain`` is invalid.
    DatasetError
        If the white level is a constant and the file holds shares of white.
    """
    sensor = with_levels(frame.sensor, levels, reference)
    check_white_in_dn(str(frame.path), frame.sensor, sensor.white_level_dn)
    black, white = sensor.black_level_dn, sensor.white_level_dn
    in_floats = frame.mosaic.dtype.kind == "f"
    return pack_normalised(frame.mosaic, sensor.cfa, black, white, clip=clip, gain=gain, corrected=in_floats)


# --- normalising ------------------------------------------------------------------------------------------------------


def packed_black_level_dn(cfa: Cfa, black_level_dn: Sequence[float]) -> NDArray[np.float32]:
    """Black level of each packed channel, (C,) float32 in DN, from the levels of the CFA's channels.

    Raises
    ------
    ArgumentError
        If there are not as many levels as the CFA has channels (3 for X-Trans, else 4).
    """
    sites = packing_sites(cfa)
    if len(black_level_dn) != sites.levels:
        raise ArgumentError(f"expected {sites.levels} black levels for this CFA, found {len(black_level_dn)}")
    return np.array([black_level_dn[colour] for colour in sites.colours], dtype=np.float32)


@lru_cache(maxsize=256)
def _check_levels(sites: Sites, black_level_dn: tuple[float, ...], white_level_dn: float) -> tuple[Any, np.float32]:
    """Black level of each packed channel, read-only, and white level: frames share few of them."""
    black, white = packed_black_level_dn(sites.cfa, black_level_dn), np.float32(white_level_dn)
    if not np.all(np.isfinite(black)) or not np.isfinite(white) or not white > black.max():
        raise ArgumentError(
            f"the white level ({white_level_dn} DN) must lie above every black level ({black.tolist()} DN)"
        )
    black.flags.writeable = False
    return black, white


def pack_normalised(
    mosaic: NDArray[np.uint16] | NDArray[np.float32], cfa: Cfa, black_level_dn: Sequence[float],
    white_level_dn: float, *,
    clip: Clip = "both", gain: float = 1.0, corrected: bool = False, out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:  # fmt: skip
    """Pack, normalise, clip, amplify and clip again, in one pass. NaN stays.

    ``out = clip(gain * clip((DN - black) / (white - black)))``, in float32 with one division per pixel: bit for
    bit what the same operations give in numpy.

    Parameters
    ----------
    mosaic
        (H, W) in DN: uint16, or float32 if it is said.
    cfa, black_level_dn
        As in :class:`eldata.records.Sensor`.
    white_level_dn
        The level that becomes 1.
    clip
        ``"both"``: to [0, 1], as the published ELD loader does (negative read noise is lost); ``"upper"``: at 1
        only; ``"none"``.
    gain
        Non-negative factor after the first clip, such as the exposure ratio.
    corrected
        The mosaic is float32: less a dark shading, simulated, or of an array of floats. To be said, since other
        floats are mostly normalised.
    out
        Where to write, C-contiguous float32 of the packed shape. A new array's pages cost more than the packing
        itself, so a loop that can reuse one should.

    Returns
    -------
    ndarray
        (C, h, w) float32, normalised.

    Raises
    ------
    ArgumentError
        If the mosaic is not uint16, or not float32 where it is ``corrected``, the levels or the gain are invalid, or
        the CFA is unsupported.
    """
    from eldata.raw._kernels import pack_bayer_normalised, pack_sites_normalised

    expected = np.float32 if corrected else np.uint16
    if mosaic.dtype != expected:
        what = "a mosaic less a dark shading" if corrected else "a mosaic in DN"
        hint = "; of floats in DN say corrected=True" if mosaic.dtype == np.float32 else ""
        raise ArgumentError(f"{what} is {np.dtype(expected)}; found {mosaic.dtype}{hint}")
    if not 0 <= gain <= _LARGEST:
        raise ArgumentError(f"the gain must be finite and not negative; found {gain}")
    sites = packing_sites(cfa)
    black, white = _check_levels(sites, tuple(black_level_dn), white_level_dn)
    if clip not in _CLIP_RANGES:
        check_choice("clip", clip, CLIP_RANGES)
    low, high = _CLIP_RANGES[clip]
    area = kept_area(mosaic, sites)
    shape = sites.channels, area.shape[0] // sites.scale, area.shape[1] // sites.scale
    if out is None:
        out = np.empty(shape, dtype=np.float32)
    elif out.shape != shape or out.dtype != np.float32 or not out.flags.c_contiguous or not out.flags.writeable:
        raise ArgumentError(
            f"out must be a writeable C-contiguous float32 array of shape {shape}; found {out.dtype} {out.shape}"
        )
    factor = np.float32(gain)
    if sites.period == 2:
        pack_bayer_normalised(area, out, sites.channel_of, black, white, low, high, factor)
    else:
        pack_sites_normalised(area, out, sites.table, sites.period, sites.sub, black, white, low, high, factor)
    return out


def normalise(
    packed: NDArray[Any], cfa: Cfa, black_level_dn: Sequence[float], white_level_dn: float, *, clip: Clip = "both"
) -> NDArray[np.float32]:
    """Normalise packed DN: (DN - black) / (white - black), (C, h, w) float32, clipped as named.

    Raises
    ------
    ArgumentError
        If the shape does not fit the CFA, or the levels are invalid.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.raw import bayer_cfa, normalise
    >>> packed = np.full((4, 2, 2), 8447.5, np.float32)
    >>> normalise(packed, bayer_cfa(), [512.0] * 4, 16383.0)[0]
    array([[0.5, 0.5],
           [0.5, 0.5]], dtype=float32)
    """
    check_choice("clip", clip, CLIP_RANGES)
    sites = packing_sites(cfa)
    if packed.ndim != 3 or packed.shape[0] != sites.channels:
        raise ArgumentError(f"expected packed data ({sites.channels}, h, w); found shape {packed.shape}")
    levels, white = _check_levels(sites, tuple(black_level_dn), white_level_dn)
    black = levels[:, None, None]
    normalised: NDArray[np.float32] = (packed.astype(np.float32) - black) / (white - black)
    return np.clip(normalised, *_CLIP_RANGES[clip])
