"""Mosaics in files that hold pixels and nothing else: NumPy, MATLAB, HDF5 and TIFF arrays.

What a raw file states of itself, a dataset's card and the rows of its manifest state of them (:class:`MosaicFacts`).
Nothing is guessed: a file of which nothing is stated is refused, and so is one whose values cannot be of the stated
levels (:func:`level_misfit`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from eldata.errors import RawFileError, UnusableRawError
from eldata.records import Exposure, RawFrame, RawHeader, Sensor

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.base.arrays import Declared

ARRAY_EXTENSIONS = frozenset((".npy", ".npz", ".mat", ".h5", ".tif", ".tiff"))
"""Lower case, with the dot."""

MOSAIC_CFAS = ("RGGB", "GRBG", "GBRG", "BGGR")
PLANES = ("R", "G1", "B", "G2")
"""Of packed arrays, in the order of this package; G1 lies in the rows of R."""

_AGAIN = "copy or download it again"
_LARGEST_DN = (1 << 16) - 1
_VALUES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float16", "float32", "float64")

# When values cannot be of the stated levels. Darkness and glare must pass. Noise lies on both sides of black: however
# strong it is and however little the light, hardly more than half of a frame is below black. A quiet sensor's dark
# frame may be all at it, and a stated black a little off.
_BLACK_ERROR = 0.01  # of the range: as much as makes a wrong black a finding of capture's check
_MOSTLY = 0.75  # of a frame: more than noise, padding and corners without picture put below black
# (how many ranges from black, what part of the values.) A blown-out frame lies where its converter ends, by what makers
# state up to a quarter of the range above white; fractions may be fused of several exposures and go on behind that.
_FAR_WHOLE, _FAR_FRACTIONS = ((1.5, 0.01),), ((2.0, 0.25), (64.0, 0.01))
# Fractions that are all within this are shares of white: what else could be so small, a mean of dark frames less their
# black, has noise below it.
_SHARES, _LEAST_WHITE_DN = (-0.1, 1.1), 64.0
_LOOKED_AT = 1 << 17  # pixels, in whole rows of both parities


@dataclass(frozen=True, slots=True)
class MosaicFacts:
    """What a card states of mosaics.

    Attributes
    ----------
    paths, cameras
        Which rows of the manifest it is of: a pattern of paths with ``*`` and ``?`` as in a shell, and names of
        cameras; none means all.
    cfa
        The colours of its first 2 x 2 sites, row by row, such as ``"GBRG"``.
    black_level_dn
        One level, or one for each of R, G1, B and G2, as the file's numbers are.
    white_level_dn
        The number that is 1 after normalisation: 1 of a file of shares of white.
    array
        Which array of a file that holds several.
    level_arrays
        In place of these two: names of the file's own arrays of black and of white level.
    planes
        Of packed arrays, (4, h, w) or (h, w, 4): which plane is which of R, G1 (beside R), B and G2.
    shape
        Of a file without a header: rows and columns of two bytes a pixel, the lower first.
    """

    paths: str
    cfa: str
    black_level_dn: tuple[float, ...] = ()
    white_level_dn: float = 0.0
    cameras: tuple[str, ...] = ()
    array: str = ""
    level_arrays: tuple[str, ...] = ()
    planes: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class StatedFile:
    """A mosaic's file, with the card's facts and the exposure in the manifest's row.

    ``member`` is what is meant in it, as :func:`eldata.base.files.split_member` has it.
    """

    path: Path
    facts: MosaicFacts
    exposure: Exposure = Exposure()  # noqa: RUF009 # frozen
    member: str = ""

    @property
    def header(self) -> RawHeader:
        """What a raw file's header would say; raises like :meth:`read` if levels in the file cannot be read."""
        facts = self.with_own_levels().facts
        levels_dn = sum(facts.black_level_dn) / len(facts.black_level_dn), facts.white_level_dn
        return RawHeader(self.path, "", "", self.exposure, levels_dn=levels_dn)

    def read(self) -> RawFrame:
        """Read the mosaic: uint16; float32 of floating-point numbers, rounded to it.

        Raises
        ------
        RawFileError
            If the file is missing, damaged, or not one mosaic of numbers in [0, 65535]; or if what is stated does not
            fit it.
        """
        from eldata.raw.damage import border_remarks
        from eldata.raw.levels import bayer_cfa

        if self.facts.level_arrays:
            return self.with_own_levels().read()
        black, white = self.facts.black_level_dn, self.facts.white_level_dn
        mosaic = self._to_mosaic(self._read_array())
        misfit = level_misfit(mosaic, black, white)
        if misfit is not None:
            raise _make_misfit_error(self, misfit, float(mosaic.max()))
        black = black * 4 if len(black) == 1 else black
        sensor = Sensor("", "", bayer_cfa(self.facts.cfa), black, white, *mosaic.shape)
        return RawFrame(self.path, mosaic, sensor, self.exposure, remarks=border_remarks(mosaic))

    def check(self) -> None:
        """Check the array that the file declares, without reading pixels; raises like :meth:`read`."""
        from eldata.base.arrays import declared_array

        if self.facts.shape:
            self._check_size()
        elif self.facts.level_arrays:
            self.with_own_levels().check()
        else:
            _check_declared(self, declared_array(self.path, **self._options()))

    def _options(self) -> dict[str, Any]:
        """Say which array of the file is read, and how to speak of it; refuse a file without a header."""
        if self.path.suffix.lower() not in ARRAY_EXTENSIONS:
            advice = "state its shape in the card's mosaics, or convert it to .npy"
            raise UnusableRawError(self.path, "is numbers without a header", advice)
        name, _, index = self.member.rpartition(":")
        if not index.isdecimal():
            name, index = self.member, ""
        part = int(index) if index else None
        return {"name": name or self.facts.array, "index": part, "error": RawFileError, "advice": _AGAIN}

    def _read_array(self) -> NDArray[Any]:
        """Read the array; of a file without a header, as many numbers as are stated."""
        import numpy as np

        from eldata.base.arrays import read_array

        if not self.facts.shape:
            return read_array(self.path, partial(_check_declared, self), **self._options())
        self._check_size()
        return np.fromfile(self.path, "<u2").reshape(self.facts.shape)

    def _check_size(self) -> None:
        """Refuse a file without a header that has not the stated size."""
        from eldata.base.files import file_problem

        (height, width), problem = self.facts.shape, file_problem(self.path)
        if problem is None and (held := self.path.stat().st_size) != 2 * height * width:
            problem = f"expected {2 * height * width} bytes ({height} x {width} pixels), found {held}; {_AGAIN}"
        if problem is not None:
            raise RawFileError(self.path, problem)

    def with_own_levels(self) -> StatedFile:
        """Return it with the levels that stand in the file, if the card says that they do; raises like :meth:`read`."""
        import numpy as np

        from eldata.base.arrays import read_array

        if not self.facts.level_arrays:
            return self
        options = self._options()
        blacks, whites = (
            np.ravel(read_array(self.path, partial(_check_levels, self), **options | {"name": name, "index": None}))
            for name in self.facts.level_arrays
        )
        black = dict(zip(self.facts.planes or PLANES, blacks.tolist() * (4 // blacks.size), strict=True))
        white = float(whites.min())
        if not max(black.values()) < white == whites.max():
            stated = f"black {blacks.tolist()} and white {whites.tolist()}"
            raise RawFileError(self.path, f"expected one white level above black, found {stated}")
        black_dn = tuple(float(black[plane]) for plane in PLANES)
        return replace(self, facts=replace(self.facts, black_level_dn=black_dn, white_level_dn=white, level_arrays=()))

    def _to_mosaic(self, array: NDArray[Any]) -> NDArray[Any]:
        """Convert an array to a mosaic, uint16 or float32; refuse values that no undamaged file has."""
        import numpy as np

        from eldata.raw.damage import mosaic_fault
        from eldata.raw.levels import bayer_cfa, unpack

        if planes := self.facts.planes:
            channels = array if array.shape[0] == len(planes) else np.moveaxis(array, -1, 0)
            array = unpack(channels[[planes.index(plane) for plane in PLANES]], bayer_cfa(self.facts.cfa))
        if array.dtype.kind == "f":
            mosaic = np.ascontiguousarray(array, np.float32)
            if not np.isfinite(mosaic).all():
                raise RawFileError(self.path, f"damaged: holds values that are not finite; {_AGAIN}")
            return mosaic
        low, high = int(array.min()), int(array.max())
        if low < 0 or high > _LARGEST_DN:
            raise RawFileError(self.path, f"expected DN from 0 to {_LARGEST_DN}, found {low} to {high}")
        whole = np.ascontiguousarray(array, np.uint16)
        fault = mosaic_fault(whole, self.facts.black_level_dn, self.facts.white_level_dn)
        if fault is not None:
            raise RawFileError(self.path, f"damaged, or its black level is another: {fault}")
        return whole


def _check_declared(file: StatedFile, declared: Declared) -> None:
    """Refuse an array that is not a mosaic (H, W) of numbers, or whose type ends below the stated white level."""
    import numpy as np

    shape, wanted, fits = declared.shape, "a mosaic of numbers, (H, W)", len(declared.shape) == 2
    if file.facts.planes:
        wanted, fits = "packed numbers, (4, h, w) or (h, w, 4)", len(shape) == 3 and (shape[0] == 4) != (shape[2] == 4)
    if not fits or 0 in shape or declared.values not in _VALUES:
        raise RawFileError(file.path, f"expected {wanted}; found {declared.values} of shape {shape}")
    if "int" in declared.values and np.iinfo(declared.values).max < (1 - _BLACK_ERROR) * file.facts.white_level_dn:
        largest = int(np.iinfo(declared.values).max)
        raise _make_misfit_error(file, f"{declared.values}, which ends at {largest}", largest)


def _check_levels(file: StatedFile, declared: Declared) -> None:
    """Refuse levels in a file that are not one number, or four."""
    if math.prod(declared.shape) not in (1, 4) or declared.values not in _VALUES:
        raise RawFileError(file.path, f"expected levels, one number or four; found {declared.values} {declared.shape}")


def _make_misfit_error(file: StatedFile, misfit: str, largest: float) -> UnusableRawError:
    """Make the error that values do not fit the card's levels, with levels that would."""
    black = " ".join(f"{level:.4g}" for level in dict.fromkeys(file.facts.black_level_dn))
    return UnusableRawError(
        file.path,
        f"{misfit}, where its card states black {black} and white {file.facts.white_level_dn:g}",
        f"{_propose_levels(file.facts, largest)}put right what the card's mosaics state of it",
    )


def _propose_levels(facts: MosaicFacts, largest: float) -> str:
    """Name levels that would fit values up to ``largest``: shares of white, or the stated ones in as many bits."""
    if largest <= _FAR_FRACTIONS[0][0]:
        return "black 0 and white 1 would fit: "
    white, stated = 2 ** int(largest).bit_length() - 1, facts.white_level_dn
    if white // 2 < stated <= white:  # the range is right, and only black is off
        return ""
    black = f"black {facts.black_level_dn[0] * white / stated:.4g} and " if stated > 1 else ""
    return f"{black}white {white} (values of {int(largest).bit_length()} bits) would fit: "


def level_misfit(mosaic: NDArray[Any], black_dn: tuple[float, ...], white_dn: float) -> str | None:
    """Describe why a mosaic (H, W) cannot have these levels; ``None`` if it can."""
    import numpy as np

    sample = mosaic[:: mosaic.size // _LOOKED_AT | 1].astype(np.float32)
    black, range_dn = min(black_dn), white_dn - min(black_dn)
    whole = bool((sample == np.rint(sample)).all())
    distances, far = np.abs(sample - black), _FAR_WHOLE if whole else _FAR_FRACTIONS
    if not whole and white_dn >= _LEAST_WHITE_DN and _SHARES[0] <= mosaic.min() and mosaic.max() <= _SHARES[1]:
        why = "which are shares of white"
    elif np.mean(sample < black - _BLACK_ERROR * range_dn) >= _MOSTLY:
        why = "most of them below black"
    elif any(np.mean(distances > ranges * range_dn) >= part for ranges, part in far):
        why = "many of them far outside"
    else:
        return None
    return f"values from {mosaic.min():.4g} to {mosaic.max():.4g}, {why}"
