"""Frozen records that every part of the package speaks in. Units stand in the field names.

Numbers that EXIF states as fractions stay :class:`fractions.Fraction`; "not known" is ``None``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from datetime import datetime
    from fractions import Fraction
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

Role = Literal["reference", "noisy", "bias", "flat"]
Matrix3 = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a raw file says about the sensor that took it.

    Attributes
    ----------
    make, model
        Camera maker and model as EXIF has them; empty if the file does not say.
    cfa
        Colour filter array: rows of channel indices of its smallest period, 2x2 (Bayer) or 6x6 (X-Trans), for
        the visible area. Bayer: 0 = R, 1 = G1 (in R's rows), 2 = B, 3 = G2. X-Trans: 0 = R, 1 = G, 2 = B.
    black_level_dn
        Black level in DN per channel index: four values for Bayer, three for X-Trans.
    white_level_dn
        White level in DN.
    height, width
        Size of the visible area in pixels.
    white_balance
        Camera white balance: multipliers of R, G1, B, G2, with G1 = 1.
    xyz_to_camera
        Matrix from CIE XYZ (D65) to the camera's R, G, B, as a DNG's ColorMatrix
        (:func:`eldata.raw.colour.camera_to_srgb` turns it into one to sRGB).
    """

    make: str
    model: str
    cfa: tuple[tuple[int, ...], ...]
    black_level_dn: tuple[float, ...]
    white_level_dn: float
    height: int
    width: int
    white_balance: tuple[float, float, float, float] | None = None
    xyz_to_camera: Matrix3 | None = None

    @property
    def cfa_pattern(self) -> NDArray[np.uint8]:
        """The CFA's channel indices as an array, (2, 2) or (6, 6)."""
        import numpy as np

        return np.asarray(self.cfa, dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class Exposure:
    """How a frame was exposed, as exact fractions.

    Attributes
    ----------
    iso
        ISO speed, dimensionless.
    exposure_s
        Exposure time in seconds.
    f_number
        Relative aperture, dimensionless.
    """

    iso: Fraction | None = None
    exposure_s: Fraction | None = None
    f_number: Fraction | None = None


@dataclass(frozen=True, slots=True)
class RawHeader:
    """What a raw file says about itself, before its pixels are decoded.

    ``taken``: by the camera's clock, which knows no time zone, with a fraction of a second where the file has one.
    """

    path: Path
    make: str
    model: str
    exposure: Exposure
    taken: datetime | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One decoded raw frame: ``mosaic`` is (H, W) uint16 in DN, the visible area, black level not subtracted.

    ``channel_white_levels_dn``: LibRaw's own white level per CFA channel, where it has one; protocols may ask for it.
    """

    path: Path
    mosaic: NDArray[np.uint16] = field(repr=False)
    sensor: Sensor
    exposure: Exposure
    channel_white_levels_dn: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One row of a manifest: one file of a dataset. ``path`` and ``reference`` are relative POSIX paths.

    The fields, in this order, are the columns of a manifest's file: others read them, so none changes.
    """

    path: str
    role: Role
    camera: str
    scene: str = ""
    split: str = ""
    iso: Fraction | None = None
    exposure_s: Fraction | None = None
    ratio: Fraction | None = None
    reference: str | None = None
    width: int | None = None
    height: int | None = None
    size_bytes: int | None = None
    sha256: str | None = None
    flags: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PairRecord:
    """A noisy frame and its reference, from the manifest alone.

    Attributes
    ----------
    path, reference
        The noisy file and its reference, POSIX paths relative to the dataset's folder.
    ratio
        Nominal exposure ratio: the low-light factor f.
    """

    path: str
    reference: str
    camera: str
    scene: str
    split: str
    iso: Fraction | None
    exposure_s: Fraction | None
    ratio: Fraction
    flags: tuple[str, ...] = ()
