"""Mosaics in files that hold pixels and nothing else: NumPy, MATLAB and TIFF arrays, and numbers without a header.

What a raw file states of itself, a dataset's card and the rows of its manifest state of them (:class:`MosaicFacts`).
Nothing is guessed: a file of which nothing is stated is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from eldata.base.files import file_problem
from eldata.errors import RawFileError, UnusableRawError
from eldata.records import Exposure, RawFrame, RawHeader, Sensor

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.base.pixels import Declared

ARRAY_EXTENSIONS = frozenset((".npy", ".npz", ".mat", ".h5", ".tif", ".tiff"))
"""Lower case, with the dot: files whose header says the shape; those of any other name have none."""

MOSAIC_CFAS = ("RGGB", "GRBG", "GBRG", "BGGR")

_AGAIN = "copy or download it again"
_LARGEST_DN = (1 << 16) - 1
_VALUES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float16", "float32", "float64")


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

        black = self.facts.black_level_dn
        mosaic = self._checked(self._array() if self._has_header else self._numbers())
        levels = black * 4 if len(black) == 1 else black
        cfa, white = bayer_cfa(self.facts.cfa), self.facts.white_level_dn
        return RawFrame(self.path, mosaic, Sensor("", "", cfa, levels, white, *mosaic.shape), self.exposure)

    def check(self) -> None:
        """Look at what the file declares, without its pixels; raises like :meth:`read`."""
        from eldata.base.array_files import declared_array

        if self._has_header:
            declared = declared_array(self.path, name=self.facts.array, error=RawFileError, advice=_AGAIN)
            _check_declared(self.path, declared)
        else:
            self._held()

    @property
    def _has_header(self) -> bool:
        return self.path.suffix.lower() in ARRAY_EXTENSIONS

    def _array(self) -> NDArray[Any]:
        from eldata.base.array_files import read_array

        check = partial(_check_declared, self.path)
        return read_array(self.path, check, name=self.facts.array, error=RawFileError, advice=_AGAIN)

    def _checked(self, array: NDArray[Any]) -> NDArray[Any]:
        import numpy as np

        from eldata.raw.damage import mosaic_fault

        if array.dtype.kind == "f":
            mosaic = np.ascontiguousarray(array, np.float32)
            if not np.isfinite(mosaic).all():
                raise RawFileError(self.path, f"damaged: holds values that are not finite; {_AGAIN}")
            return mosaic
        low, high = int(array.min()), int(array.max())
        if low < 0 or high > _LARGEST_DN:
            raise RawFileError(self.path, f"expected DN from 0 to {_LARGEST_DN}, found {low} to {high}")
        mosaic = np.ascontiguousarray(array, np.uint16)
        fault = mosaic_fault(mosaic, self.facts.black_level_dn, self.facts.white_level_dn)
        if fault is not None:
            raise RawFileError(self.path, f"damaged, or its black level is another: {fault}")
        return mosaic

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


def _check_declared(path: Path, declared: Declared) -> None:
    if len(declared.shape) != 2 or 0 in declared.shape or declared.values not in _VALUES:
        raise RawFileError(
            path, f"expected a mosaic of numbers, (H, W); found {declared.values} of shape {declared.shape}"
        )
