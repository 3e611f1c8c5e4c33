"""Mosaics in files that hold pixels and nothing else: NumPy, MATLAB and TIFF arrays, and numbers without a header.

What a raw file states of itself, a dataset's card and the rows of its manifest state of them (:class:`MosaicFacts`).
Nothing is guessed: a file of which nothing is stated is refused, and so is one whose values cannot be of the stated
levels (:func:`level_misfit`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from eldata.base.files import file_problem
from eldata.errors import RawFileError, UnusableRawError
from eldata.records import Exposure, RawFrame, RawHeader, Sensor

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.base.arrays import Declared

ARRAY_EXTENSIONS = frozenset((".npy", ".npz", ".mat", ".h5", ".tif", ".tiff"))
"""Lower case, with the dot: files whose header says the shape; those of any other name have none."""

MOSAIC_CFAS = ("RGGB", "GRBG", "GBRG", "BGGR")

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
    shape
        (H, W) of a file without a header: one pixel after the other in 16 bits, the lower byte first.
    """

    paths: str
    cfa: str
    black_level_dn: tuple[float, ...]
    white_level_dn: float
    cameras: tuple[str, ...] = ()
    array: str = ""
    shape: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class StatedFile:
    """A mosaic's file, and what is stated of it by the card (``facts``) and by its row (``exposure``)."""

    path: Path
    facts: MosaicFacts
    exposure: Exposure = Exposure()  # noqa: RUF009 # frozen

    @property
    def header(self) -> RawHeader:
        """What a raw file's header would say."""
        black = self.facts.black_level_dn
        levels_dn = sum(black) / len(black), self.facts.white_level_dn
        return RawHeader(self.path, "", "", self.exposure, levels_dn=levels_dn)

    def read(self) -> RawFrame:
        """Return the mosaic: uint16; float32 of floating-point numbers, rounded to it.

        Raises
        ------
        RawFileError
            If the file is missing, damaged, or not one mosaic of numbers in [0, 65535]; or if what is stated does not
            fit it.
        """
        from eldata.raw.cfa import bayer_cfa
        from eldata.raw.damage import border_remarks

        black = self.facts.black_level_dn
        mosaic = self._checked(self._array() if self._has_header else self._numbers())
        levels = black * 4 if len(black) == 1 else black
        cfa, white = bayer_cfa(self.facts.cfa), self.facts.white_level_dn
        sensor = Sensor("", "", cfa, levels, white, *mosaic.shape)
        return RawFrame(self.path, mosaic, sensor, self.exposure, remarks=border_remarks(mosaic))

    def check(self) -> None:
        """Look at what the file declares, without its pixels; raises like :meth:`read`."""
        from eldata.base.arrays import declared_array

        if self._has_header:
            declared = declared_array(self.path, name=self.facts.array, error=RawFileError, advice=_AGAIN)
            _check_declared(self, declared)
        else:
            self._held()

    @property
    def _has_header(self) -> bool:
        return self.path.suffix.lower() in ARRAY_EXTENSIONS

    def _array(self) -> NDArray[Any]:
        from eldata.base.arrays import read_array

        check = partial(_check_declared, self)
        return read_array(self.path, check, name=self.facts.array, error=RawFileError, advice=_AGAIN)

    def _checked(self, array: NDArray[Any]) -> NDArray[Any]:
        import numpy as np

        from eldata.raw.damage import mosaic_fault

        if array.dtype.kind == "f":
            mosaic = np.ascontiguousarray(array, np.float32)
            if not np.isfinite(mosaic).all():
                raise RawFileError(self.path, f"damaged: holds values that are not finite; {_AGAIN}")
            self._check_levels(mosaic)
            return mosaic
        low, high = int(array.min()), int(array.max())
        if low < 0 or high > _LARGEST_DN:
            raise RawFileError(self.path, f"expected DN from 0 to {_LARGEST_DN}, found {low} to {high}")
        mosaic = np.ascontiguousarray(array, np.uint16)
        fault = mosaic_fault(mosaic, self.facts.black_level_dn, self.facts.white_level_dn)
        if fault is not None:
            raise RawFileError(self.path, f"damaged, or its black level is another: {fault}")
        self._check_levels(mosaic)
        return mosaic

    def _check_levels(self, mosaic: NDArray[Any]) -> None:
        misfit = level_misfit(mosaic, self.facts.black_level_dn, self.facts.white_level_dn)
        if misfit is not None:
            raise _misfit_error(self, *misfit)

    def _numbers(self) -> NDArray[Any]:
        """Return the pixels of a file without a header."""
        import numpy as np

        shape = self._held()
        try:
            return np.fromfile(self.path, "<u2").reshape(shape)
        except (OSError, ValueError) as error:  # it changed meanwhile
            raise RawFileError(self.path, f"cannot be read: {error}") from error

    def _held(self) -> tuple[int, int]:
        """Return the shape that the card states of a file without a header, once the file's size is that of it."""
        shape = self.facts.shape
        if shape is None:
            advice = "state its shape in the card's mosaics, or convert it to .npy if it is packed or padded"
            raise UnusableRawError(self.path, "is numbers without a header", advice)
        expected = 2 * shape[0] * shape[1]
        problem = file_problem(self.path)
        if problem is not None:
            raise RawFileError(self.path, problem)
        found = self.path.stat().st_size
        if found != expected:
            raise RawFileError(
                self.path,
                f"expected {expected} bytes for {shape[0]} x {shape[1]} pixels of 16 bits, found {found}; {_AGAIN}, or "
                "convert it to .npy if it is packed or padded",
            )
        return shape


def _check_declared(file: StatedFile, declared: Declared) -> None:
    import numpy as np

    if len(declared.shape) != 2 or 0 in declared.shape or declared.values not in _VALUES:
        raise RawFileError(
            file.path, f"expected a mosaic of numbers, (H, W); found {declared.values} of shape {declared.shape}"
        )
    white = file.facts.white_level_dn
    if "int" in declared.values and np.iinfo(declared.values).max < (1 - _BLACK_ERROR) * white:
        largest = int(np.iinfo(declared.values).max)
        fitting = _scaled(file.facts.black_level_dn, white, largest / white, f"values to {largest}")
        raise _misfit_error(file, f"{declared.values}, which ends at {largest}", fitting)


def _misfit_error(file: StatedFile, found: str, fitting: str) -> UnusableRawError:
    black = _in_words(file.facts.black_level_dn)
    found += f", where its card states black {black} and white {file.facts.white_level_dn:g}"
    return UnusableRawError(file.path, found, f"{fitting} would fit: put right what the card's mosaics state of it")


def level_misfit(mosaic: NDArray[Any], black_dn: tuple[float, ...], white_dn: float) -> tuple[str, str] | None:
    """Return what of a mosaic (H, W) cannot be of these levels, and which would fit; ``None`` if it may be of them."""
    import numpy as np

    seen = mosaic[:: mosaic.size // _LOOKED_AT | 1].astype(np.float32)
    black, range_dn = min(black_dn), white_dn - min(black_dn)
    whole = bool((seen == np.rint(seen)).all())
    shares = not whole and white_dn >= _LEAST_WHITE_DN and _within(seen, *_SHARES) and _within(mosaic, *_SHARES)
    far = any(
        np.mean(np.abs(seen - black) > ranges * range_dn) >= part
        for ranges, part in (_FAR_WHOLE if whole else _FAR_FRACTIONS)
    )
    if shares:
        why = "which are shares of white"
    elif np.mean(seen < black - _BLACK_ERROR * range_dn) >= _MOSTLY:
        why = "most of them below black"
    elif far:
        why = "many of them far outside"
    else:
        return None
    low, high = float(mosaic.min()), float(mosaic.max())
    return f"values from {low:.4g} to {high:.4g}, {why}", _fitting(mosaic if whole else None, high, black_dn, white_dn)


def _within(values: NDArray[Any], low: float, high: float) -> bool:
    return bool(low <= values.min() and values.max() <= high)


def _fitting(whole: NDArray[Any] | None, high: float, black_dn: tuple[float, ...], white_dn: float) -> str:
    """Return the levels that would fit, in words, of values up to ``high`` that do not; ``whole`` if they are that."""
    import numpy as np

    if high <= 1 or (whole is None and high <= _FAR_FRACTIONS[0][0]):  # with their noise
        return "black 0 and white 1 (shares of white)"
    if high > white_dn:
        bits = 0 if whole is None else int(np.bitwise_or.reduce(np.clip(whole, 0, 1 << 30).astype(np.int64), axis=None))
        step = bits & -bits
        if step > 1 and high <= step * (white_dn + 1):
            return _scaled(black_dn, white_dn, step, f"all are multiples of {step}")
        depth = max(8, 2 * math.ceil(math.log2(high + 1) / 2))
        return f"white {(1 << depth) - 1} (values of {depth} bits), with the black level in DN,"
    fitting = f"black 0 and white {white_dn - min(black_dn):g} (values less their black)"
    if high < 1 << 8 < white_dn:
        fitting += f", or {_scaled(black_dn, white_dn, 256 / (white_dn + 1), 'values of 8 bits')},"
    return fitting


def _scaled(black_dn: tuple[float, ...], white_dn: float, scale: float, why: str) -> str:
    return f"black {_in_words(tuple(level * scale for level in black_dn))} and white {white_dn * scale:g} ({why})"


def _in_words(levels: tuple[float, ...]) -> str:
    return " ".join(f"{level:.4g}" for level in dict.fromkeys(levels))
