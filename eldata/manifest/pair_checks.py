"""What verifying looks at in both files of a pair: their exposure ratio, and their white levels."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.workers import Failed
from eldata.manifest.pairs import NOMINAL_RATIO, UNCERTAIN_ISO
from eldata.manifest.table import number_text
from eldata.manifest.verify_report import distinct, row_fault
from eldata.raw.files import RAW_EXTENSIONS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from eldata.base.workers import Workers
    from eldata.manifest.catalogue import FrameFiles
    from eldata.manifest.verify_report import FileRemark, Problem
    from eldata.raw.levels import MeanLevels
    from eldata.records import FrameRecord

# Shutters step by thirds of a stop (a factor of 1.26) and EXIF rounds them (1/13 for 1/12.5), so a true ratio may be
# some percent off the nominal one: 213 for 200 occurs in the published set. Shifted numbering and swapped references
# are off by a factor of two at least.
RATIO_TOLERANCE = Fraction(1, 10)


def ratio_findings(records: Sequence[FrameRecord], product_of: Mapping[str, Fraction | None]) -> list[Problem]:
    """Compare the ratios of pairs with their rows'; ``product_of``: ISO times exposure time of each file, by path."""
    advice = "are both the frames that their names say? look for shifted numbering and swapped references"
    findings = []
    for record in records:
        if record.reference is None or record.ratio is None or {UNCERTAIN_ISO, NOMINAL_RATIO} & {*record.flags}:
            continue
        reference, noisy = product_of.get(record.reference), product_of[record.path]
        if reference is None or noisy is None:
            continue  # reported already: missing, unreadable or without exposure
        ratio = reference / noisy
        if abs(ratio - record.ratio) > RATIO_TOLERANCE * record.ratio:
            expected = f"{number_text(record.ratio)} to {record.reference}"
            findings.append(row_fault(record.path, "ratio", expected, f"{float(ratio):.6g}", advice))
    return findings


def white_remarks(
    records: Sequence[FrameRecord], levels_dn: Mapping[str, MeanLevels | None], files: FrameFiles, workers: Workers
) -> tuple[FileRemark, ...]:
    """Return what there is to say of noisy files whose white level is not their reference's, of each kind once.

    Files that do not state theirs in plain words have those of the first one of their camera and ISO, which is decoded.
    """
    from eldata.raw.levels import white_remark

    rows = {record.path: record for record in records}
    pairs = [(rows[record.reference], record) for record in records if record.reference in rows]
    first = {(one.camera, one.iso): one for pair in reversed(pairs) for one in pair}
    unknown = [one for one in first.values() if levels_dn[one.path] is None]
    unknown = [one for one in unknown if Path(one.path).suffix.lower() in RAW_EXTENSIONS]
    decoded = workers.attempt(partial(_decoded_levels, files), unknown, label="white levels")
    found = {
        (one.camera, one.iso): levels
        for one, levels in zip(unknown, decoded, strict=True)
        if not isinstance(levels, Failed)  # who scores it says why
    }
    said = []
    for pair in pairs:
        clean, noisy = (levels_dn[one.path] or found.get((one.camera, one.iso)) for one in pair)
        text = white_remark(noisy, clean) if noisy and clean else None
        said.append((pair[1].path, (text,) if text else ()))
    return distinct(said)


def _decoded_levels(files: FrameFiles, record: FrameRecord) -> MeanLevels:
    from eldata.raw.levels import mean_levels
    from eldata.raw.reading import read_raw

    return mean_levels(read_raw(files.at(record.path)).sensor)
