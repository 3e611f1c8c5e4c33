"""What verifying looks at in both files of a pair: their exposure ratio, and their white levels."""

from __future__ import annotations

from collections import Counter
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

    noisy = [record for record in records if record.reference in levels_dn]
    paired = {record.path for record in noisy} | {record.reference for record in noisy}
    setting = {record.path: (record.camera, record.iso) for record in records if record.path in paired}
    first = {setting[record.path]: record for record in reversed(records) if record.path in paired}
    several = Counter(camera for camera, _ in first)
    unknown = [one for one in first.values() if levels_dn[one.path] is None and several[one.camera] > 1]
    unknown = [one for one in unknown if Path(one.path).suffix.lower() in RAW_EXTENSIONS]
    decoded = workers.attempt(partial(_decoded_levels, files), unknown, label="white levels")
    of_setting = {
        setting[one.path]: found
        for one, found in zip(unknown, decoded, strict=True)
        if not isinstance(found, Failed)  # found by those who decode it
    }
    said = []
    for record in noisy:
        levels, clean = (
            levels_dn[path] or of_setting.get(setting[path]) for path in (record.path, record.reference or "")
        )
        text = white_remark(levels, clean) if levels and clean else None
        said.append((record.path, (text,) if text else ()))
    return distinct(said)


def _decoded_levels(files: FrameFiles, record: FrameRecord) -> MeanLevels:
    from eldata.raw.levels import mean_levels
    from eldata.raw.reading import read_raw

    return mean_levels(read_raw(files.at(record.path)).sensor)
