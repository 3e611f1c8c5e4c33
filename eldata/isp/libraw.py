"""LibRaw's own rendering of a raw file, as the published SID code makes its reference pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.files import read_file
from eldata.errors import RawFileError
from eldata.raw.levels import packing_sites

if TYPE_CHECKING:
    from numpy.typing import NDArray

# The tile of LibRaw's Markesteijn demosaicing, which refuses a smaller picture as an input/output error.
_LEAST_XTRANS_SIDE = 512


def render_libraw(path: Path | str) -> NDArray[np.uint8]:
    """Render a raw file to sRGB with LibRaw: demosaiced, as-shot white balance, no automatic brightening.

    The SID code's ``postprocess(use_camera_wb=True, half_size=False, no_auto_bright=True, output_bps=16)``
    (cchen156/Learning-to-See-in-the-Dark, test_Sony.py and test_Fuji.py), but never turned, as predictions are not. The
    rest is LibRaw's default: AHD demosaicing (Markesteijn's for X-Trans), sRGB primaries, BT.709's tone curve, and the
    brightest pixel taken as the level of saturation where it lies above three quarters of the file's white level.

    Parameters
    ----------
    path
        A raw file, Bayer or X-Trans, that :func:`eldata.raw.read_raw` accepts.

    Returns
    -------
    ndarray
        (H, W, 3) uint8, R, G, B: the 16-bit values v as ``round(255 v / 65535)``, as that code saves its PNG files.

    Raises
    ------
    RawFileError
        Like :func:`eldata.raw.read_raw`; or if the file has no as-shot white balance or no colour matrix, for
        which LibRaw would substitute its own; or is quad-Bayer, nona-Bayer, or X-Trans with a side under 512 pixels,
        which LibRaw does not demosaic.
    """
    return read_file(_check_and_render, Path(path), RawFileError)


def _check_and_render(path: Path) -> NDArray[np.uint8]:
    """Decode a raw file for its checks, then render it with LibRaw: (H, W, 3) uint8."""
    from eldata.raw.container import read_container
    from eldata.raw.reading import open_raw, read_raw

    # Decoded first for its checks, which LibRaw lacks. It also leaves this thread's OpenMP at one thread: a pool, which
    # demosaicing would start, makes workers forked later hang (eldata.raw.reading).
    frame = read_raw(path)
    if frame.sensor.white_balance is None:
        raise RawFileError(path, "states no as-shot white balance; LibRaw would put one of its own in its place")
    if frame.sensor.xyz_to_camera is None:
        raise RawFileError(
            path, "has no colour matrix, and LibRaw has none for its camera; LibRaw would show the camera's own colours"
        )
    kind = packing_sites(frame.sensor.cfa)
    if kind.block > 1:
        raise RawFileError(
            path, f"LibRaw does not demosaic {kind.name}; pack it and use eldata.isp.Rendering, which bins its colours"
        )
    if kind.name == "X-Trans" and min(frame.mosaic.shape) < _LEAST_XTRANS_SIDE:
        raise RawFileError(
            path,
            f"{frame.sensor.height} x {frame.sensor.width} pixels: LibRaw does not demosaic X-Trans pictures with a "
            f"side under {_LEAST_XTRANS_SIDE}",
        )
    balance = frame.sensor.white_balance
    del frame  # its pixels
    with open_raw(read_container(path), "render") as raw:
        has_balance = min(raw.camera_whitebalance[:3]) > 0  # LibRaw knows no AsShotWhiteXY
        rendered: NDArray[Any] = raw.postprocess(
            use_camera_wb=has_balance,
            user_wb=None if has_balance else [*balance],
            half_size=False,
            no_auto_bright=True,
            output_bps=16,
            user_flip=0,
        )
    return sixteen_to_eight_bits(rendered)


def sixteen_to_eight_bits(values: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Round to ``255 v / 65535``, exactly: 65535 = 255 * 257, so v / 257 is never half-way."""
    codes: NDArray[np.uint8] = ((values.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return codes
