"""Checks of ``eldata verify`` on files of clips: PNG frames, and whether the frames of a clip belong together."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from eldata.base.arrays import read_png_header, read_rgb16
from eldata.errors import FileError
from eldata.manifest.patterns import is_png
from eldata.manifest.verify_report import Problem, row_fault

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path

    from eldata.records import FrameRecord

_AGAIN = "copy or download it again"


def size_findings(record: FrameRecord, width: int, height: int, advice: str) -> list[Problem]:
    """Compare a file's size in pixels with the row's, if that has one."""
    return [
        row_fault(record.path, name, str(size), str(found), advice)
        for name, size, found in (("width", record.width, width), ("height", record.height, height))
        if size is not None and size != found
    ]


def png_findings(folder: Path, record: FrameRecord) -> list[Problem]:
    """Check one PNG frame's header and end: that it is whole, 16-bit RGB, of the recorded size."""
    try:
        header = read_png_header(folder / record.path)
    except FileError as error:
        return [row_fault(record.path, "content", "a whole PNG file", error.reason, _AGAIN)]
    if (header.bit_depth, header.colour) != (16, "RGB"):
        advice = "this file was converted: take the original"
        return [row_fault(record.path, "content", "a 16-bit RGB PNG", str(header), advice)]
    height, width = header.shape[:2]
    return size_findings(record, width, height, "this file is of another clip or was scaled")


def png_decode_findings(folder: Path, record: FrameRecord) -> list[Problem]:
    """Decode one PNG frame, which verifies the checksum of every part."""
    try:
        read_rgb16(folder / record.path)
    except FileError as error:
        return [row_fault(record.path, "content", "a PNG file that decodes", error.reason, _AGAIN)]
    return []


def png_size_findings(folder: Path, records: Iterable[FrameRecord]) -> list[Problem]:
    """Compare the sizes of the PNG files of each clip, its reference among them, with the most frequent one."""
    sizes: dict[str, dict[str, str]] = defaultdict(dict)
    for record in records:
        if is_png(record.path):
            try:
                sizes[record.scene][record.path] = read_png_header(folder / record.path).size
            except FileError:
                continue  # reported already
    findings = []
    for of_path in sizes.values():
        usual = Counter(of_path.values()).most_common(1)[0][0]
        findings += [
            row_fault(path, "size", f"{usual}, like the clip's other files", size, "is this file of another clip?")
            for path, size in of_path.items()
            if size != usual
        ]
    return findings


def exposure_findings(
    records: Sequence[FrameRecord], products: Mapping[str, Fraction | None], tolerance: Fraction
) -> list[Problem]:
    """Compare ISO times exposure time of the raw frames of each clip with each other and with their reference's.

    For rows without a nominal ratio, where nothing else can be checked: a frame of another clip or a swapped reference
    is found if its exposure differs.
    """
    clips: dict[str, list[FrameRecord]] = defaultdict(list)
    for record in records:
        if record.role == "noisy" and record.ratio is None and products.get(record.path) is not None:
            clips[record.scene].append(record)
    findings = []
    for frames in clips.values():
        exposures = [products[frame.path] for frame in frames]
        usual = Counter(exposures).most_common(1)[0][0] or 0
        for frame, product in zip(frames, exposures, strict=True):
            if product is not None and abs(product - usual) > tolerance * usual:
                expected = f"{float(usual):.6g} (ISO times seconds), like most frames of the clip"
                advice = "is this a frame of another clip, or the reference?"
                findings.append(row_fault(frame.path, "exposure", expected, f"{float(product):.6g}", advice))
        reference = frames[0].reference
        bright = None if reference is None else products.get(reference)
        if reference is not None and bright is not None and bright <= usual:
            expected = f"more than {float(usual):.6g} (ISO times seconds), its clip's"
            advice = "is this the reference? look for swapped files"
            findings.append(row_fault(reference, "exposure", expected, f"{float(bright):.6g}", advice))
    return findings
