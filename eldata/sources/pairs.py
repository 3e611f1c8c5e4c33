"""A noisy frame and its reference, opened in one way for datasets, predictions and scores, from files and stores."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from eldata.base.arrays import Declared, read_array
from eldata.errors import ArgumentError, DatasetError, FileError
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.manifest.pairs import NOMINAL_RATIO, UNCERTAIN_ISO
from eldata.raw.levels import packed_area, packed_shape, unpack
from eldata.records import Exposure, FrameRecord, PairRecord
from eldata.sources.frames import Files, Frame, FrameSource

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.manifest.clips import ClipRecord
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Amplification, Levels

    Record: TypeAlias = PairRecord | ClipRecord | FrameRecord


@dataclass(frozen=True, slots=True, eq=False)
class OpenedPair:
    """An open noisy frame and its reference.

    Attributes
    ----------
    target
        The reference; of clips without one the noisy frame itself.
    input
        The noisy frame, without the dark shading if one is subtracted.
    ratio
        What the input is multiplied by; ``None``: not known, as of RGB frames that their authors amplified.
    """

    target: Frame
    input: Frame
    ratio: Fraction | None

    @property
    def gain(self) -> float:
        """The factor of the input's values; 1 where they are amplified already, as in RGB and packed arrays."""
        return 1.0 if self.ratio is None or self.input.sensor is None else float(self.ratio)


@dataclass(frozen=True, slots=True)
class PairOpener:
    """Opens pairs: what their values are depends on this and on the record alone.

    Attributes
    ----------
    source
        Where the frames come from.
    levels
        As :meth:`eldata.sources.frames.Frame.with_levels` has them.
    amplification
        ``"metadata"``: the ratio of ISO times exposure time that both files state; ``"nominal"``: the record's.
    dark_shading
        Subtracted from inputs, if any.
    """

    source: FrameSource
    levels: Levels
    amplification: Amplification
    dark_shading: DarkShading | None = None

    def open_target(self, path: str) -> Frame:
        """Open a reference."""
        return self.source.frame(path).with_levels(self.levels)

    def open_pair(
        self, record: Record, target: Frame | None, path: str | None = None, noisy: Frame | None = None
    ) -> OpenedPair:
        """Open a noisy frame, whose reference is open already.

        Parameters
        ----------
        record
            The pair, clip or row: its ratio and flags count.
        target
            The reference, whose pixels are not needed; ``None``: none, and the ratio is the nominal one, else 1.
        path
            The noisy frame; by default the record's.
        noisy
            The frame itself, if it is open already.

        Raises
        ------
        FileError
            If the file is missing or damaged, or states no ISO or exposure time, which the ratio needs.
        DatasetError
            If the frames differ in size or CFA, or in their ratio from the record's by more than a tenth; or the dark
            shading is not the frame's.
        ArgumentError
            If the record has no ratio, and the nominal one is asked for.
        """
        noisy = noisy or self._open_noisy(record, target, path or record.path)
        noisy = noisy.with_levels(self.levels, target)
        if target is not None and (noisy.shape, noisy.cfa) != (target.shape, target.cfa):
            raise DatasetError(f"{noisy.name}: has {noisy.kind}, but its reference {target.name} has {target.kind}")
        ratio = find_ratio(record, target, noisy, self.amplification)
        shown = noisy if self.dark_shading is None else noisy.subtract(self.dark_shading)
        return OpenedPair(target or noisy, shown, ratio)

    def _open_noisy(self, record: Record, target: Frame | None, path: str) -> Frame:
        """Open a noisy frame; one in a packed array becomes a mosaic like its reference."""
        packed = self.source.packed_file(path) if isinstance(self.source, Files) else None
        if packed is None or target is None:
            return self.source.frame(path)
        return _read_packed(packed, target, Exposure(record.iso, getattr(record, "exposure_s", None)))


def find_ratio(record: Record, target: Frame | None, noisy: Frame, amplification: Amplification) -> Fraction | None:
    """Find the factor of an input; raises as :meth:`PairOpener.open_pair` does."""
    nominal, flags, is_nominal = record.ratio, record.flags, amplification == "nominal"
    if target is None:
        return None if not noisy.cfa else nominal or Fraction(1)
    if noisy.sensor is None or target.sensor is None or NOMINAL_RATIO in flags:
        return nominal
    if is_nominal and nominal is None:
        raise ArgumentError(f"{noisy.name}: the manifest states no ratio, so amplification must be 'metadata'")
    if is_nominal and any(None in (frame.exposure.iso, frame.exposure.exposure_s) for frame in (target, noisy)):
        return nominal
    ratio = target.exposure.product(target.name) / noisy.exposure.product(noisy.name)
    if nominal is None and ratio < 1:
        raise DatasetError(
            f"{noisy.name}: is exposed {float(1 / ratio):g} times as much as its reference {target.name}; are they "
            "swapped?"
        )
    if nominal is not None and UNCERTAIN_ISO not in flags and abs(ratio - nominal) > RATIO_TOLERANCE * nominal:
        raise DatasetError(
            f"{noisy.name}: expected an exposure ratio of {float(nominal):g} to {target.name}, found "
            f"{float(ratio):g}; are both the frames that their names say? (eldata verify finds all such files)"
        )
    return nominal if is_nominal else ratio


def _read_packed(path: Path, target: Frame, exposure: Exposure) -> Frame:
    """Read a packed, amplified noisy frame, as a mosaic like its reference's."""
    shape = packed_shape(target.shape, target.cfa)

    def check_header(declared: Declared) -> None:
        """Refuse another type or shape, before anything is loaded."""
        if declared.shape != shape or declared.values != "float32":
            found = f"{declared.values} {declared.shape}"
            raise FileError(path, f"expected float32 {shape} like its reference, found {found}")

    packed = read_array(path, check_header, error=FileError)
    mosaic = np.zeros(target.shape, np.float32)
    mosaic[packed_area(target.shape, target.cfa).slices] = unpack(packed, target.cfa)
    return Frame(mosaic, target.cfa, (0.0,) * len(target.black_level_dn), 1.0, str(path), exposure=exposure)
