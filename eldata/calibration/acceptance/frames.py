"""Both sides' frames: a camera's that were kept from a noise model, and the model's, digitised as the camera digitises.

What is wrong with the camera's frames is collected; values of a model that are not what they should be are refused by
name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.calibration.acceptance.reproduction import compared_place
from eldata.calibration.audit.frame_checks import FrameFigures, clipped_black
from eldata.calibration.audit.frames import FrameReader
from eldata.calibration.core._frames import by_pixel, pattern_of
from eldata.errors import ArgumentError
from eldata.noise.makers import made_exposure, maker_name
from eldata.noise.model import NoiseModel
from eldata.noise.mosaic import pack_whole, unpack_whole

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.calibration.acceptance.pairs import PairScale
    from eldata.datasets.calibration_frames import FlatPair
    from eldata.noise.makers import NoiseMaker
    from eldata.noise.parameters import NoiseParameters
    from eldata.records import FrameRecord, Sensor

    Mosaic = NDArray[np.uint16]
    Plane = NDArray[np.float32]

_UNITS_APART = 64.0  # a model whose noise is so many times too strong or weak is taken to be in other units
_CLIPPED = 0.01  # of the values


class HeldOutFrames(FrameReader):
    """Reads the frames of one ISO, a pair at a time and no copies, and collects what is wrong with them."""

    def _mosaics(self, records: Sequence[FrameRecord]) -> Iterator[tuple[FrameRecord, Mosaic]]:
        for record, frame in self.read(records):
            if self.copies.original(record, frame.mosaic) is None:
                yield record, frame.mosaic
            del frame  # before the next one is decoded

    def bias_pairs(self, records: Sequence[FrameRecord]) -> Iterator[tuple[Mosaic, Mosaic]]:
        """Yield pairs of pieces of bias frames that share no frame."""
        first: Mosaic | None = None
        for record, mosaic in self._mosaics(records):
            self.problems += clipped_black(record, mosaic)
            self.figures.append(FrameFigures.of(record, mosaic))
            piece = self.cut(mosaic)
            if first is None:
                first = piece
            else:
                yield first, piece
                first = None

    def flats(self, pair: FlatPair) -> tuple[Mosaic, Mosaic] | None:
        """Return a pair of whole flats."""
        found = [mosaic for _, mosaic in self._mosaics((pair.first, pair.second))]
        return (found[0], found[1]) if len(found) == 2 else None

    def cut(self, mosaic: NDArray[np.generic]) -> Mosaic:
        """Return a copy of the piece that is compared."""
        return mosaic[compared_place(mosaic.shape, len(self.sensor.cfa))].copy()  # type: ignore[return-value]


@dataclass(frozen=True, slots=True)
class MadeFrames:
    """Makes the model's frames of one ISO, as the camera's converter gives them."""

    model: NoiseMaker
    parameters: NoiseParameters
    sensor: Sensor
    seed: tuple[int, ...]
    whole_frames: bool
    exposure_s: float | None = None

    @property
    def range_dn(self) -> float:
        """White level minus black level, DN."""
        return self.sensor.white_level_dn - float(np.mean(self.sensor.black_level_dn))

    def values_dn(self, light_dn: Plane, *stream: int) -> Plane:
        """Return an exposure of light (H, W), DN over black, of the piece that is compared, before it is digitised."""
        generator = np.random.default_rng([*self.seed, *stream])
        options: dict[str, Any] = {}
        if isinstance(self.model, NoiseModel) and self.model.dark_shading is not None:
            options["exposure_s"] = self.exposure_s
        made = made_exposure(
            self.model,
            pack_whole(light_dn / np.float32(self.range_dn), self.sensor.cfa),
            parameters=self.parameters,
            ratio=1.0,
            range_dn=self.range_dn,
            generator=generator,
            **options,
        )
        values = unpack_whole(made, self.sensor.cfa, light_dn.shape)
        if self.whole_frames:
            values = values[compared_place(values.shape, len(self.sensor.cfa))]
        if not np.isfinite(values).all():
            raise ArgumentError(
                f"{maker_name(self.model)} returned values that are not finite numbers (NaN or infinite)"
            )
        result: Plane = values * np.float32(self.range_dn)
        return result

    def frame(self, light_dn: Plane, *stream: int) -> Mosaic:
        """Return a whole DN of each pixel."""
        values = self.values_dn(light_dn, *stream)
        black = np.asarray(self.sensor.black_level_dn, dtype=np.float32)
        values += by_pixel(black, pattern_of(self.sensor.cfa), values.shape)
        np.rint(values, out=values)
        return np.clip(values, 0, self.sensor.white_level_dn, out=values).astype(np.uint16)

    def pair(self, light_dn: Plane, stream: int, index: int) -> tuple[Mosaic, Mosaic]:
        """Return two frames; stream and index number the pair."""
        return self.frame(light_dn, stream, index, 0), self.frame(light_dn, stream, index, 1)

    def check(self, dark_dn: Plane, frame: Mosaic, scale: PairScale) -> None:
        """Refuse a model that clips at 0, or whose values are in other units than the frames'."""
        values, name = self.values_dn(dark_dn, 0), maker_name(self.model)
        low, middle, high = (float(value) for value in np.quantile(values, (0.159, 0.5, 0.841)))
        ratio = (high - low) / 2 / scale.sigma_dn
        if ratio > _UNITS_APART:
            as_dn = (high - low) / 2 / self.range_dn
            raise ArgumentError(
                f"{name} makes dark frames whose noise is {ratio:.0f} times that of the held-out frames "
                f"({scale.sigma_dn:.2f} DN). If its values are DN (they are about {middle / self.range_dn:.5g}, with a "
                f"spread of {as_dn:.3g}), divide them: expected is normalised data, (value - black) / (white - black), "
                f"here over {self.range_dn:g} DN"
            )
        if 0 < ratio < 1 / _UNITS_APART:
            raise ArgumentError(
                f"{name} makes dark frames whose noise is {1 / ratio:.0f} times weaker than the held-out frames' "
                f"({scale.sigma_dn:.2f} DN). Are its values divided by the range ({self.range_dn:g} DN) twice? "
                "expected is (value - black) / (white - black)"
            )
        at_zero = float(np.mean(values == 0))
        black = np.asarray(self.sensor.black_level_dn)[pattern_of(self.sensor.cfa)].min()
        below = float(np.mean(frame < black))
        if high > low and values.min() >= 0 and at_zero > _CLIPPED and below > _CLIPPED:
            raise ArgumentError(
                f"{name} clips at black: {at_zero:.0%} of its values in the dark are exactly 0 and none is below, "
                f"while {below:.0%} of the held-out frames' are below black. Let the model keep negative values "
                "(clip='none' of a NoiseModel); a dataset clips afterwards, the frames and the model alike"
            )
