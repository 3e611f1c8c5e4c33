"""Power spectra of bias frames: of a whole one, in which row noise shows as a line (figure "fft_bf"), and of lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.errors import DatasetError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.calibration.core.defects import FixedPattern

TILE = 256
_MOST_TILES = 64
_FREQUENCIES = 80
_FREQUENCIES_TOGETHER = 4  # at least: a single one scatters by all of itself


def power_spectrum(mosaic: NDArray[np.uint16], fixed: FixedPattern) -> NDArray[np.float32]:
    """Return the centred power spectrum of a bias frame less its channels' means, DN^2 per pixel.

    The average over tiles of 256 x 256 pixels (up to 64 of them, evenly spread): white noise of variance s^2 gives s^2
    throughout. Noise that a row shares lies on the column of horizontal frequency 0, that of a column on the row of
    vertical frequency 0. Defects count as their channel's mean; fixed patterns stay in.

    Raises
    ------
    DatasetError
        If the frame is smaller than a tile.
    """
    height, width = mosaic.shape
    if height < TILE or width < TILE:
        raise DatasetError(f"the spectrum needs a frame of {TILE} x {TILE} pixels or more; found {height} x {width}")
    period = len(fixed.pattern)
    down, across = height // TILE, width // TILE
    step = max(1, round((down * across / _MOST_TILES) ** 0.5))
    power = np.zeros((TILE, TILE))
    tiles = 0
    for y in range(0, down, step):
        for x in range(0, across, step):
            place = slice(y * TILE, (y + 1) * TILE), slice(x * TILE, (x + 1) * TILE)
            tile = mosaic[place].astype(np.float64)
            tile[fixed.defects[place]] = np.nan
            for row in range(period):
                for column in range(period):
                    # By site, not by channel: the two greens of Bayer may differ.
                    site = tile[row::period, column::period]
                    site -= np.nanmean(site)
            power += np.abs(np.fft.fft2(np.nan_to_num(tile))) ** 2
            tiles += 1
    spectrum: NDArray[np.float32] = np.fft.fftshift(power / (tiles * TILE * TILE)).astype(np.float32)
    return spectrum


@dataclass(frozen=True, slots=True)
class SpectrumLines:
    """The lines in a centred power spectrum, DN^2: its ground, and the means of the rows' and of the columns' line."""

    ground_dn2: float
    rows_dn2: float
    columns_dn2: float

    @classmethod
    def of(cls, spectrum: NDArray[np.floating]) -> SpectrumLines:
        """Measure them, without the frequencies next to 0, which are shading and drift in both directions."""
        height, width = spectrum.shape
        wide = np.asarray(spectrum, dtype=np.float64)
        far = np.abs(np.arange(height) - height // 2) > 4
        return cls(
            ground_dn2=float(np.median(wide)),
            rows_dn2=float(wide[far, width // 2].mean()),
            columns_dn2=float(wide[height // 2, far].mean()),
        )


def smoothed_power(
    frequency: NDArray[np.float64], power: NDArray[np.float64], period: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return means of neighbouring frequencies, without those that taking off the channels' means has emptied.

    These are 0 and the multiples of one over the CFA's period.
    """
    places = frequency * period
    kept = np.flatnonzero(np.abs(places - np.rint(places)) > period * frequency[1] / 2)
    groups = np.array_split(kept, max(1, min(_FREQUENCIES, kept.size // _FREQUENCIES_TOGETHER)))
    return np.array([frequency[g].mean() for g in groups]), np.array([power[g].mean() for g in groups])
