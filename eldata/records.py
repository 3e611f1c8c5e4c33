"""Frozen records that every part of the package speaks in. Units stand in the field names.

Numbers that EXIF states as fractions stay :class:`fractions.Fraction`, those that arrays are computed with are floats;
"not known" is ``None``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, is_dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from eldata.errors import RawFileError, UnusableRawError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from datetime import datetime
    from fractions import Fraction
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

_Record = TypeVar("_Record")

Role = Literal["reference", "noisy", "bias", "flat"]
Matrix3 = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

D65 = 21  # as EXIF numbers sources of light


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a raw file says about the sensor that took it.

    Attributes
    ----------
    make, model
        Camera maker and model as EXIF has them; empty if the file does not say.
    cfa
        Colour filter array: rows of channel indices of its smallest period, 2x2 (Bayer), 4x4 (quad-Bayer) or 6x6
        (nona-Bayer, X-Trans), for the visible area. Bayer, quad and nona: 0 = R, 1 = G1 (in R's rows), 2 = B, 3 = G2
        (:func:`eldata.raw.bayer_cfa`). X-Trans: 0 = R, 1 = G, 2 = B.
    black_level_dn
        Black level in DN per channel index: three values for X-Trans, else four.
    white_level_dn
        White level in DN.
    height, width
        Size of the visible area in pixels.
    white_balance
        Camera white balance: multipliers of R, G1, B, G2, with G1 = 1.
    xyz_to_camera
        Matrix from CIE XYZ to the camera's R, G, B, as a DNG's ColorMatrix
        (:func:`eldata.raw.colour.camera_to_srgb` turns it into one to sRGB).
    matrix_illuminant
        The light that the matrix was made for, as EXIF numbers it (LightSource): 21 is D65, 0 not stated.
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
    matrix_illuminant: int = D65

    @property
    def cfa_pattern(self) -> NDArray[np.uint8]:
        """The CFA's channel indices as an array, (2, 2), (4, 4) or (6, 6)."""
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

    def product(self, file: Path | str) -> Fraction:
        """Multiply ISO by exposure time in seconds; raise RawFileError if the file does not state both."""
        if self.iso is None or self.exposure_s is None:
            missing = "ISO" if self.iso is None else "exposure time"
            raise RawFileError(file, f"states no {missing}, and an exposure ratio needs it: use the original file")
        return self.iso * self.exposure_s


@dataclass(frozen=True, slots=True)
class RawHeader:
    """What a raw file says about itself, before its pixels are decoded.

    ``taken``: by the camera's clock, which knows no time zone, with a fraction of a second where the file has one.
    ``remarks``: those of :class:`RawFrame` that take no pixels. ``levels_dn``: mean black level and white level, where
    the file has them in plain words, as a DNG. ``orientation``: EXIF's, 1 to 8.
    """

    path: Path
    make: str
    model: str
    exposure: Exposure
    taken: datetime | None = None
    remarks: tuple[str, ...] = ()
    levels_dn: tuple[float, float] | None = None
    orientation: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One decoded raw frame.

    Attributes
    ----------
    path
        The file.
    mosaic
        (H, W) in DN, the visible area, black level not subtracted: uint16; float32 of an array of floats whose levels a
        card states, whose white level is often 1 (:meth:`whole_dn` refuses them by name).
    sensor, exposure
        As the file states them.
    channel_white_levels_dn
        LibRaw's own white level per CFA channel, where it has one; protocols may ask for it.
    remarks
        What is right about the file but should be known, a sentence each (:mod:`eldata.raw.reading`).
    orientation
        EXIF's, 1 to 8: how to turn the picture for viewing. The mosaic is never turned.
    noise_profile
        Slope and offset of the noise's variance over the signal, of shares of white, by a DNG's NoiseProfile: the mean
        of its planes. ``None``: none is stated.
    """

    path: Path
    mosaic: NDArray[Any] = field(repr=False)
    sensor: Sensor
    exposure: Exposure
    channel_white_levels_dn: tuple[float, ...] | None = None
    remarks: tuple[str, ...] = ()
    orientation: int = 1
    noise_profile: tuple[float, float] | None = None

    def whole_dn(self, purpose: str) -> NDArray[np.uint16]:
        """Return the mosaic, for a purpose that only whole DN serve.

        Raises
        ------
        UnusableRawError
            If it holds fractions of a DN; the message has the purpose.
        """
        if self.mosaic.dtype.kind != "u":
            raise UnusableRawError(
                self.path,
                "its pixels are no whole DN, as of an average or of shares of white",
                f"{purpose} needs whole DN: use the raw files as the camera wrote them",
            )
        return self.mosaic


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


def from_columns(kind: type[_Record], columns: Mapping[str, Sequence[object]]) -> list[_Record]:
    """Return frozen records with slots, given all values of each field, which are not checked.

    A million records take seconds by their own ``__init__``, which has to get each value past a frozen class's guard.
    """
    records = [object.__new__(kind) for _ in next(iter(columns.values()))]
    for name in kind.__slots__:  # type: ignore[attr-defined] # dataclass(slots=True) makes them
        deque(map(getattr(kind, name).__set__, records, columns[name]), maxlen=0)
    return records


class Records(tuple[_Record, ...]):
    """A tuple of frozen records of one kind, with slots, that goes to other processes by columns, in less time.

    Records that several others hold, as frames hold their sensor, are shared there too.
    """

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, ...]:
        if not self:
            return Records, ((),)
        kind = type(self[0])
        columns = {name: [getattr(record, name) for record in self] for name in kind.__slots__}  # type: ignore[attr-defined]
        own = {name for name, values in columns.items() if _are_own_records(values)}
        return _of_columns, (
            kind,
            {name: Records(values) if name in own else values for name, values in columns.items()},
        )


def _are_own_records(values: Sequence[object]) -> bool:
    """Return whether all are records of one kind, and none of them twice."""
    kinds = {*map(type, values)}
    return len(kinds) == 1 and is_dataclass(values[0]) and len({*map(id, values)}) == len(values)


def _of_columns(kind: type[_Record], columns: Mapping[str, Sequence[object]]) -> Records[_Record]:
    return Records(from_columns(kind, columns))


@dataclass(frozen=True, slots=True)
class PairRecord:
    """A noisy frame and its reference, from the manifest alone.

    A :class:`~eldata.manifest.clips.ClipRecord` answers to the same names.

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

    @property
    def frames(self) -> tuple[str, ...]:
        """The noisy frame."""
        return (self.path,)

    @property
    def files(self) -> tuple[str, ...]:
        """The noisy frame, and its reference if it has one."""
        return (self.path, self.reference) if self.reference else (self.path,)

    @property
    def name(self) -> str:
        """What messages call it: the path of the noisy frame."""
        return self.path

    @property
    def nominal_ratio(self) -> float:
        """The ratio as a float."""
        return float(self.ratio)

    def reference_of(self, frame: str) -> str:  # noqa: ARG002 # there is one
        """Return what the noisy frame is compared with."""
        return self.reference

    def place(self, frame: str) -> str:
        """Return where the prediction of the noisy frame lies, without its extension."""
        return frame
