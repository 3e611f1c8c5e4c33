"""What is drawn for a synthetic item: its seed by epoch, its camera and noise, its crop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
import torch

from eldata.datasets.augmentation import ORIENTATIONS, Orientation, copy_oriented, oriented
from eldata.datasets.batches import Field, new_arrays
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.profile import CameraProfile
from eldata.raw.cfa import normalise, pack, pack_normalised, packed_area, packed_shape

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from eldata.datasets.clean import CleanFrame
    from eldata.noise.parameters import NoiseParameters
    from eldata.noise.profile import RowChoice
    from eldata.raw.cfa import CfaRows


class SharedEpoch:
    """The current epoch, in shared memory so that persistent workers see the next one."""

    def __init__(self) -> None:
        self._value = torch.zeros((), dtype=torch.int64)
        self._share()

    def _share(self) -> None:
        self._value.share_memory_()  # type: ignore[no-untyped-call]

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._share()  # a copy has an epoch of its own, which its workers share again

    @property
    def value(self) -> int:
        """The current epoch."""
        return int(self._value)

    def set(self, epoch: int) -> None:
        """Choose the epoch.

        Raises
        ------
        ArgumentError
            If it is negative.
        """
        if epoch < 0:
            raise ArgumentError(f"epoch must be 0 or more; found {epoch}")
        self._value.fill_(epoch)


class NoiseFacts(TypedDict):
    """The parameters that an item's noise was made with (:class:`eldata.noise.NoiseParameters`) and its exposure ratio.

    ``colour_bias_dn`` is (4,) float64.
    """

    ratio: float
    camera: str
    gain_dn_per_e: float
    tukey_lambda: float
    sigma_tl_dn: float
    sigma_gauss_dn: float
    sigma_row_dn: float
    colour_bias_dn: torch.Tensor


@dataclass(frozen=True, slots=True)
class NoiseDraw:
    """One draw: camera, noise parameters, exposure ratio."""

    camera: str
    parameters: NoiseParameters
    ratio: float

    def facts(self) -> NoiseFacts:
        """Return the draw as fields of a sample."""
        drawn = self.parameters
        return NoiseFacts(
            ratio=self.ratio,
            camera=self.camera,
            gain_dn_per_e=drawn.gain_dn_per_e,
            tukey_lambda=drawn.tukey_lambda,
            sigma_tl_dn=drawn.sigma_tl_dn,
            sigma_gauss_dn=drawn.sigma_gauss_dn,
            sigma_row_dn=drawn.sigma_row_dn,
            colour_bias_dn=torch.tensor(drawn.colour_bias_dn, dtype=torch.float64),
        )


@dataclass(frozen=True, slots=True)
class NoiseChoice:
    """What a draw is made from: profiles, (lowest, highest) ratio, and how a profile is sampled."""

    profiles: tuple[CameraProfile, ...]
    ratio: tuple[float, float]
    iso: float | None
    row: RowChoice

    @classmethod
    def of(
        cls,
        profiles: CameraProfile | str | Sequence[CameraProfile | str],
        ratio: float | tuple[float, float],
        iso: float | None,
        row: RowChoice,
    ) -> NoiseChoice:
        """Load profiles by name or path and check the ratio.

        Raises
        ------
        ArgumentError
            If the ratio makes no sense, or there is no profile.
        ProfileError
            If a profile is unknown or malformed.
        """
        low, high = ratio if isinstance(ratio, tuple) else (ratio, ratio)
        if not 0 < low <= high < math.inf:
            raise ArgumentError(f"ratio must be finite and above 0, the lower first; found {ratio}")
        given = [profiles] if isinstance(profiles, (str, CameraProfile)) else list(profiles)
        if not given:
            raise ArgumentError("give at least one camera profile")
        loaded = tuple(CameraProfile.load(item) if isinstance(item, str) else item for item in given)
        return cls(loaded, (float(low), float(high)), iso, row)

    def draw(self, generator: np.random.Generator) -> NoiseDraw:
        """Draw a profile, parameters from it, and a ratio, in this order."""
        profile = self.profiles[int(generator.integers(len(self.profiles)))]
        parameters = profile.sample(generator, iso=self.iso, row=self.row)
        return NoiseDraw(profile.camera, parameters, float(generator.uniform(*self.ratio)))


@dataclass(frozen=True, slots=True)
class CleanCrop:
    """A part of a clean frame and the way that it is turned; it fits every frame of the same size and CFA.

    Attributes
    ----------
    slices
        The part of the mosaic, with the margin that turning costs.
    cfa
        Of that part.
    orientation
        Applied to it.
    height, width
        Of the turned part, without the margin.
    """

    slices: tuple[slice, slice]
    cfa: CfaRows
    orientation: Orientation
    height: int
    width: int

    @classmethod
    def draw(cls, frame: CleanFrame, generator: np.random.Generator, *, crop: int | None, augment: bool) -> CleanCrop:
        """Draw a place, and with ``augment`` one of the eight orientations.

        Parameters
        ----------
        frame
            The frame, or one like it.
        generator
            Decides orientation, top and left, in this order.
        crop
            Side in packed pixels; ``None`` takes the whole frame.

        Raises
        ------
        ArgumentError
            If ``crop`` is odd for X-Trans.
        DatasetError
            If the frame is too small.
        """
        orientation = ORIENTATIONS[int(generator.integers(len(ORIENTATIONS)))] if augment else Orientation()
        period = len(frame.cfa)
        area = packed_area((frame.mosaic.shape[0], frame.mosaic.shape[1]), frame.cfa)
        # From here on the pattern starts as packing wants it.
        cfa = tuple(
            tuple(frame.cfa[(y + area.top) % period][(x + area.left) % period] for x in range(period))
            for y in range(period)
        )
        margin = period if augment else 0
        scale = 2 if period == 2 else 3
        height = area.height - margin if crop is None else crop * scale
        width = area.width - margin if crop is None else crop * scale
        if orientation.transpose and crop is None:
            height, width = width, height
        if height % period or width % period:
            raise ArgumentError(f"crop must be even for X-Trans; found {crop}")
        rows, columns = (width, height) if orientation.transpose else (height, width)
        if rows + margin > area.height or columns + margin > area.width or min(rows, columns) <= 0:
            raise DatasetError(
                f"{frame.name}: {area.height} x {area.width} pixels are too few for a crop of {rows + margin} x "
                f"{columns + margin} (crop={crop}, augment={augment}); take a smaller crop"
            )
        top = area.top + period * int(generator.integers((area.height - rows - margin) // period + 1))
        left = area.left + period * int(generator.integers((area.width - columns - margin) // period + 1))
        place = slice(top, top + rows + margin), slice(left, left + columns + margin)
        return cls(place, cfa, orientation, height, width)

    def turned(self, part: NDArray[Any]) -> NDArray[Any]:
        """Return the crop, turned, from the part of the mosaic that :attr:`slices` name; its CFA is :attr:`cfa`."""
        if part.dtype == np.uint16 and self.orientation != Orientation():
            return _turned(part, self.cfa, self.orientation, self.height, self.width)
        return oriented(part, self.cfa, self.orientation)[: self.height, : self.width]

    @property
    def packed_shape(self) -> tuple[int, int, int]:
        """That of the packed crop, (C, h, w)."""
        return packed_shape((self.height, self.width), self.cfa)

    def packed(self, frame: CleanFrame, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the crop of a frame, packed and normalised, (C, h, w), in ``out`` if that is given."""
        crop = self.turned(frame.mosaic[self.slices])
        if crop.dtype == np.uint16:
            return pack_normalised(crop, self.cfa, frame.black_level_dn, frame.white_level_dn, out=out)
        normalised = normalise(pack(crop, self.cfa), self.cfa, frame.black_level_dn, frame.white_level_dn)
        if out is None:
            return normalised
        out[...] = normalised
        return out


@dataclass(frozen=True, slots=True)
class RgbCrop:
    """A part of an RGB frame and the way that it is turned: as :class:`CleanCrop`, but no CFA asks for a margin."""

    slices: tuple[slice, slice]
    orientation: Orientation
    height: int
    width: int

    @classmethod
    def draw(
        cls,
        name: str,
        shape: tuple[int, int],
        generator: np.random.Generator,
        *,
        crop: int | None,
        augment: bool,
    ) -> RgbCrop:
        """Draw a place, and with ``augment`` one of the eight orientations: orientation, top and left, in this order.

        Raises
        ------
        DatasetError
            If the frame, of which ``name`` tells, is too small.
        """
        orientation = ORIENTATIONS[int(generator.integers(len(ORIENTATIONS)))] if augment else Orientation()
        rows, columns = shape if crop is None else (crop, crop)
        if rows > shape[0] or columns > shape[1]:
            raise DatasetError(
                f"{name}: {shape[0]} x {shape[1]} pixels are too few for a crop of {rows} x {columns}; take a smaller "
                "crop"
            )
        top, left = (
            int(generator.integers(whole - part + 1)) for whole, part in zip(shape, (rows, columns), strict=True)
        )
        height, width = (columns, rows) if orientation.transpose else (rows, columns)
        return cls((slice(top, top + rows), slice(left, left + columns)), orientation, height, width)

    def turned(self, plane: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return the crop, turned, from the part of one plane that :attr:`slices` name."""
        if self.orientation == Orientation():
            return plane
        return _turned(plane, _NO_CFA, self.orientation, self.height, self.width)


def _turned(
    part: NDArray[np.uint16], cfa: CfaRows, orientation: Orientation, height: int, width: int
) -> NDArray[np.uint16]:
    copy: NDArray[np.uint16] = new_arrays([Field("turned", (height, width), "<u2")])["turned"]
    copy_oriented(part, cfa, orientation, copy)
    return copy


_NO_CFA: CfaRows = ((0,),)
