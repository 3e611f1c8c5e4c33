"""Are two frames a pair? What is asked of them, whatever source they come from, and by what they are amplified."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.errors import DatasetError
from eldata.manifest.pairs import UNCERTAIN_ISO
from eldata.manifest.verify import RATIO_TOLERANCE

if TYPE_CHECKING:
    from fractions import Fraction

    from eldata.protocols.protocol import Amplification
    from eldata.records import FrameRecord, PairRecord
    from eldata.sources.frames import Frame


def checked_ratio(record: PairRecord, reference: Frame, noisy: Frame) -> Fraction:
    """Return the exposure ratio that a pair's files state; the manifest's if the noisy one is not a raw file.

    Raises
    ------
    DatasetError
        If it is more than a tenth off the manifest's, or the frames differ in size or CFA.
    RawFileError
        If a raw file states no ISO or exposure time.
    """
    from eldata.raw.reading import exposure_ratio

    ratio = record.ratio if noisy.sensor is None else exposure_ratio(reference.header, noisy.header)
    differs = abs(ratio - record.ratio) > RATIO_TOLERANCE * record.ratio
    if differs and UNCERTAIN_ISO not in record.flags:
        raise DatasetError(
            f"{noisy.name}: expected an exposure ratio of {float(record.ratio):g} to {record.reference}, found "
            f"{float(ratio):g}; are both the frames that their names say? (eldata verify finds all such files)"
        )
    if (noisy.shape, noisy.cfa) != (reference.shape, reference.cfa):
        raise DatasetError(
            f"{noisy.name}: {noisy.shape} pixels, CFA {noisy.cfa}, but its reference {record.reference} has "
            f"{reference.shape}, {reference.cfa}"
        )
    return ratio


def stated_ratio(record: PairRecord | FrameRecord, amplification: Amplification) -> Fraction | None:
    """Return the ratio that the manifest has for a way to amplify; ``None`` for ``"metadata"``, or if none is stated.

    Raises
    ------
    DatasetError
        If it is to be the measured one, and none was measured.
    """
    if amplification == "measured" and record.measured_ratio is None:
        raise DatasetError(
            f"{record.path}: the manifest has no measured ratio for amplification 'measured'; capture check --write "
            "measures it, 'nominal' and 'metadata' need none"
        )
    return {"metadata": None, "nominal": record.ratio, "measured": record.measured_ratio}[amplification]
