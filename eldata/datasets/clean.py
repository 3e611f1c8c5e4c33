"""Clean frames for synthetic pairs: from raw files or from arrays."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from eldata.errors import ArgumentError, DatasetError
from eldata.raw.cfa import XTRANS_CFA, unpack
from eldata.raw.extensions import RAW_EXTENSIONS
from eldata.raw.levels import Levels, white_level_dn

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from eldata.raw.cfa import CfaRows

_BAYER: CfaRows = ((0, 1), (3, 2))


@dataclass(frozen=True, slots=True, eq=False)
class CleanFrame:
    """A clean mosaic in DN with its levels.

    Attributes
    ----------
    mosaic
        (H, W), uint16 or floating, DN.
    cfa, black_level_dn
        As in :class:`eldata.records.Sensor`.
    white_level_dn
        The level that is 1 after normalisation.
    name
        Where it comes from.
    """

    mosaic: NDArray[Any] = field(repr=False)
    cfa: CfaRows
    black_level_dn: tuple[float, ...]
    white_level_dn: float
    name: str

    @property
    def range_dn(self) -> float:
        """White level minus the channels' mean black level."""
        return self.white_level_dn - sum(self.black_level_dn) / len(self.black_level_dn)


class CleanSource(Protocol):
    """What :class:`~eldata.datasets.synthetic.SyntheticPairs` draws its clean crops from."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def frame(self, index: int) -> CleanFrame:
        """Return one frame."""


class RawFiles:
    """Clean frames decoded from raw files, such as the long exposures of SID.

    Parameters
    ----------
    files
        A folder, searched through for camera raws, or the files themselves.
    levels
        White level: the file's (``"metadata"``) or 16383 (``"published"``).
    keep
        Number of decoded frames to keep in memory, per worker.

    Raises
    ------
    DatasetError
        If there is no raw file.
    """

    def __init__(self, files: Path | str | Iterable[Path | str], *, levels: Levels = "metadata", keep: int = 0) -> None:
        if isinstance(files, (str, Path)):
            folder = Path(files)
            found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in RAW_EXTENSIONS)
            if not found:
                raise DatasetError(f"{folder}: holds no camera raw file")
        else:
            found = [Path(path) for path in files]
            if not found:
                raise DatasetError("no raw file was given")
        if keep < 0:
            raise ArgumentError(f"keep must be 0 or more; found {keep}")
        self.paths: tuple[Path, ...] = tuple(found)
        self.levels: Levels = levels
        self.keep = keep
        self._kept: OrderedDict[int, CleanFrame] = OrderedDict()

    def __len__(self) -> int:
        return len(self.paths)

    def frame(self, index: int) -> CleanFrame:
        """Decode one file."""
        from eldata.raw.reading import read_raw

        if index in self._kept:
            self._kept.move_to_end(index)
            return self._kept[index]
        raw = read_raw(self.paths[index])
        white = white_level_dn(raw.sensor, self.levels)
        frame = CleanFrame(raw.mosaic, raw.sensor.cfa, raw.sensor.black_level_dn, white, str(self.paths[index]))
        if self.keep:
            self._kept[index] = frame
            while len(self._kept) > self.keep:
                self._kept.popitem(last=False)
        return frame

    def __repr__(self) -> str:
        return f"RawFiles({len(self)} files, first {self.paths[0].name}, levels={self.levels!r}, keep={self.keep})"


class Arrays:
    """Clean frames from packed, normalised arrays (C, h, w) in memory (or memory-mapped).

    Parameters
    ----------
    arrays
        One array a frame, or one array (N, C, h, w).
    range_dn
        White minus black level of the camera that is simulated, DN.
    cfa
        Their CFA; by default RGGB.
    """

    def __init__(
        self, arrays: Sequence[NDArray[Any]] | NDArray[Any], *, range_dn: float, cfa: CfaRows = _BAYER
    ) -> None:
        if len(arrays) == 0:
            raise ArgumentError("no array was given")
        if not range_dn > 0:
            raise ArgumentError(f"range_dn must be above 0; found {range_dn}")
        self.arrays = arrays
        self.range_dn = range_dn
        self.cfa = cfa

    def __len__(self) -> int:
        return len(self.arrays)

    def frame(self, index: int) -> CleanFrame:
        """Return one array as a mosaic."""
        packed = np.asarray(self.arrays[index], dtype=np.float32)
        mosaic = unpack(packed, self.cfa) * np.float32(self.range_dn)
        # Packed X-Trans data starts where the pattern does, whatever the offset of the sensor that it came from.
        cfa, channels = (self.cfa, 4) if len(self.cfa) == 2 else (XTRANS_CFA, 3)
        return CleanFrame(mosaic, cfa, (0.0,) * channels, self.range_dn, f"array {index}")

    def __repr__(self) -> str:
        return f"Arrays({len(self)} frames of shape {self.arrays[0].shape}, range_dn={self.range_dn:g})"
