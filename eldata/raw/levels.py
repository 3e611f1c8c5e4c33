"""DN to shares of white: normalising while packing, and by which levels: a file's own or those of published results."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from eldata.errors import ArgumentError, DatasetError, check_choice
from eldata.raw.cfa import kept_area, packing_sites

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.raw.cfa import Cfa, Sites
    from eldata.records import RawFrame, Sensor

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
# from the file, and that of X-Trans from here.
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
    """Return a sensor's mean black level and its white level, DN."""
    return sum(sensor.black_level_dn) / len(sensor.black_level_dn), sensor.white_level_dn


def differ_in_white(levels: MeanLevels, reference: MeanLevels) -> bool:
    """Return whether two files of a pair state two white levels of one DN scale, as Canon's do from ISO to ISO.

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
    """Return what there is to say of a noisy file whose white level is not its reference's; ``None`` if it is."""
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
    """Return a sensor with the chosen black and white level.

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
    """Refuse a file that holds shares of white, for what is in DN.

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
    """Return a frame packed and normalised, (C, h, w) float32.

    Arguments are those of :func:`pack_normalised`, and levels and reference as :func:`with_levels` has them.

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
    """Return the black level of each packed channel, (C,) float32 in DN, from those of the CFA's channels.

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
def _levels(sites: Sites, black_level_dn: tuple[float, ...], white_level_dn: float) -> tuple[Any, np.float32]:
    """Return each packed channel's black level, read-only, and the white level: frames share few of them."""
    black = packed_black_level_dn(sites.cfa, black_level_dn)
    black.flags.writeable = False
    return black, _checked_levels(black, white_level_dn)


def _checked_levels(black: NDArray[np.float32], white_level_dn: float) -> np.float32:
    white = np.float32(white_level_dn)
    if not np.all(np.isfinite(black)) or not np.isfinite(white) or not white > black.max():
        raise ArgumentError(
            f"the white level ({white_level_dn} DN) must lie above every black level ({black.tolist()} DN)"
        )
    return white


def _clip_range(clip: Clip) -> tuple[np.float32, np.float32]:
    if clip not in _CLIP_RANGES:
        check_choice("clip", clip, CLIP_RANGES)
    return _CLIP_RANGES[clip]


def pack_normalised(
    mosaic: NDArray[np.uint16] | NDArray[np.float32],
    cfa: Cfa,
    black_level_dn: Sequence[float],
    white_level_dn: float,
    *,
    clip: Clip = "both",
    gain: float = 1.0,
    corrected: bool = False,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
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
    black, white = _levels(sites, tuple(black_level_dn), white_level_dn)
    low, high = _clip_range(clip)
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
    """Return packed DN as (DN - black) / (white - black), (C, h, w) float32, clipped as named.

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
    black = _black_of(packed, cfa, black_level_dn)
    white = _checked_levels(black, white_level_dn)
    return np.clip((packed.astype(np.float32) - black) / (white - black), *_clip_range(clip))


def denormalise(
    packed: NDArray[np.floating[Any]], cfa: Cfa, black_level_dn: Sequence[float], white_level_dn: float
) -> NDArray[np.uint16]:
    """Return normalised packed data as DN: uint16, rounded to the nearest, limited to [0, 65535].

    The inverse of :func:`normalise` for DN that it did not clip.

    Raises
    ------
    ArgumentError
        Like :func:`normalise`.
    """
    black = _black_of(packed, cfa, black_level_dn).astype(np.float64)
    white = float(_checked_levels(black.astype(np.float32), white_level_dn))
    return np.clip(np.rint(packed * (white - black) + black), 0, 65535).astype(np.uint16)


def _black_of(packed: NDArray[Any], cfa: Cfa, black_level_dn: Sequence[float]) -> NDArray[np.float32]:
    black = packed_black_level_dn(cfa, black_level_dn)
    if packed.ndim != 3 or packed.shape[0] != len(black):
        raise ArgumentError(f"expected packed data ({len(black)}, h, w); found shape {packed.shape}")
    return black[:, None, None]
