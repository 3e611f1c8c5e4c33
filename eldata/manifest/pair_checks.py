"""Files of a set against each other: ratios and white levels of pairs, exposures, sizes and names of clips."""

from __future__ import annotations

from collections import Counter, defaultdict
from contextlib import suppress
from fractions import Fraction
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from eldata.base.arrays import read_png_header
from eldata.base.workers import Failed, Workers
from eldata.errors import FileError
from eldata.manifest.pairs import NOMINAL_RATIO, UNCERTAIN_ISO
from eldata.manifest.patterns import FrameSequence, has_fields, is_pattern, is_png, matching, sequence_of
from eldata.manifest.table import number_text
from eldata.manifest.verify_report import FileRemark, Problem, distinct, row_fault
from eldata.raw.files import RAW_EXTENSIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from eldata.manifest.card import CameraCard
    from eldata.manifest.catalogue import FrameFiles
    from eldata.raw.levels import MeanLevels
    from eldata.records import FrameRecord

# Shutters step by thirds of a stop (a factor of 1.26) and EXIF rounds them (1/13 for 1/12.5), so a true ratio may be
# some percent off the nominal one: 213 for 200 occurs in the published set. Shifted numbering and swapped references
# are off by a factor of two at least.
RATIO_TOLERANCE = Fraction(1, 10)


def ratio_faults(records: Sequence[FrameRecord], product_of: Mapping[str, Fraction | None]) -> list[Problem]:
    """Compare the ratios of pairs with their rows'; ``product_of``: ISO times exposure time of each file, by path."""
    advice = "are both the frames that their names say? look for shifted numbering and swapped references"
    problems = []
    for record in records:
        if record.reference is None or record.ratio is None or {UNCERTAIN_ISO, NOMINAL_RATIO} & {*record.flags}:
            continue
        reference, noisy = product_of.get(record.reference), product_of[record.path]
        if reference is None or noisy is None:
            continue  # reported already: missing, unreadable or without exposure
        ratio = reference / noisy
        if abs(ratio - record.ratio) > RATIO_TOLERANCE * record.ratio:
            expected = f"{number_text(record.ratio)} to {record.reference}"
            problems.append(row_fault(record.path, "ratio", expected, f"{float(ratio):.6g}", advice))
    return problems


def clip_faults(records: Sequence[FrameRecord], product_of: Mapping[str, Fraction | None]) -> list[Problem]:
    """Compare ISO times exposure time of the raw frames of each clip with each other and with their reference's.

    For rows without a nominal ratio, where nothing else can be checked: a frame of another clip or a swapped reference
    is found if its exposure differs.
    """
    clips: dict[str, list[tuple[FrameRecord, Fraction]]] = defaultdict(list)
    for record in records:
        product = product_of.get(record.path)
        if record.role == "noisy" and record.ratio is None and product is not None:
            clips[record.scene].append((record, product))
    problems = []
    for frames in clips.values():
        usual = Counter(product for _, product in frames).most_common(1)[0][0]
        expected = f"{float(usual):.6g} (ISO times seconds), like most frames of the clip"
        advice = "is this a frame of another clip, or the reference?"
        problems += [
            row_fault(frame.path, "exposure", expected, f"{float(product):.6g}", advice)
            for frame, product in frames
            if abs(product - usual) > RATIO_TOLERANCE * usual
        ]
        reference = frames[0][0].reference or ""
        bright = product_of.get(reference)
        if bright is not None and bright <= usual:
            expected = f"more than {float(usual):.6g} (ISO times seconds), its clip's"
            advice = "is this the reference? look for swapped files"
            problems.append(row_fault(reference, "exposure", expected, f"{float(bright):.6g}", advice))
    return problems


def png_size_faults(folder: Path, records: Iterable[FrameRecord]) -> list[Problem]:
    """Compare the sizes of the PNG files of each clip, its reference among them, with the most frequent one."""
    clips: dict[str, dict[str, str]] = defaultdict(dict)
    for record in records:
        if is_png(record.path):
            with suppress(FileError):  # reported already
                clips[record.scene][record.path] = read_png_header(folder / record.path).size
    problems = []
    for sizes in clips.values():
        usual = Counter(sizes.values()).most_common(1)[0][0] if sizes else ""
        expected, advice = f"{usual}, like the clip's other files", "is this file of another clip?"
        problems += [row_fault(path, "size", expected, size, advice) for path, size in sizes.items() if size != usual]
    return problems


def pattern_faults(records: Iterable[FrameRecord], folder: Path) -> list[Problem]:
    """Name problems of the files that patterns match: several references, odd names, gaps in the numbers."""
    problems = []
    for record in records:
        files = matching(folder, record.path) if is_pattern(record.path) else {}
        names = [PurePosixPath(path).name for path in files]
        if has_fields(record.path):
            clips: dict[tuple[str, ...], list[str]] = defaultdict(list)
            for path, fields in files.items():
                others = (text for name, text in fields.items() if name != "frame")
                clips[str(PurePosixPath(path).parent), *others].append(fields.get("frame", ""))
            for (place, *_), numbers in clips.items():
                problems += _name_faults(PurePosixPath(place), sequence_of(numbers))
        elif record.role != "reference":
            problems += _name_faults(PurePosixPath(record.path).parent, sequence_of(names))
        elif len(files) > 1:
            advice = "which one is the reference is not known: move the others away"
            problems.append(row_fault(record.path, "file", "one file", ", ".join(names), advice))
    return problems


def _name_faults(folder: PurePosixPath, frames: FrameSequence) -> list[Problem]:
    """Name odd names, doubles and gaps among a clip's frames in a folder."""
    problems = []
    for name in frames.odd:
        advice = "move it away: it shifts the frames"
        problems.append(row_fault(f"{folder}/{name}", "name", "a name like the clip's others", name, advice))
    for number in frames.doubles:
        expected = f"each frame once, and so one frame {number}"
        problems.append(row_fault(f"{folder}", "number", expected, "two", "move one away"))
    for first, last in frames.gaps:
        low, *_, high = frames.numbers or (first, last)
        found = f"no frame {first}" if first == last else f"no frames {first} to {last}"
        expected, advice = f"frames {low} to {high} without a gap", "copy or download the folder again"
        problems.append(row_fault(f"{folder}", "number", expected, found, advice))
    return problems


def white_remarks(
    records: Sequence[FrameRecord],
    levels_dn: Mapping[str, MeanLevels | None],
    cameras: Mapping[str, CameraCard],
    files: FrameFiles,
    workers: Workers,
) -> tuple[FileRemark, ...]:
    """Remark on noisy files whose white level is not their reference's, on each kind once.

    Files that do not state theirs in plain words have those of the first one of their camera and ISO, which is decoded;
    where ``cameras`` have no model, several may share the name, and it is the first of their scene.
    """
    from eldata.raw.levels import white_remark

    rows = {record.path: record for record in records}
    like = {row.path: (row.camera, row.iso, "" if cameras[row.camera].models else row.scene) for row in records}
    pairs = [(rows[record.reference], record) for record in records if record.reference in rows]
    first = {like[record.path]: record for pair in reversed(pairs) for record in pair}
    unknown = [record for record in first.values() if levels_dn[record.path] is None]
    unknown = [record for record in unknown if Path(record.path).suffix.lower() in RAW_EXTENSIONS]
    decoded = workers.attempt(partial(_decode_levels, files), unknown, label="white levels")
    levels_of = {
        like[record.path]: levels
        for record, levels in zip(unknown, decoded, strict=True)
        if not isinstance(levels, Failed)  # who scores it says why
    }
    remarks = []
    for pair in pairs:
        clean, noisy = (levels_dn[record.path] or levels_of.get(like[record.path]) for record in pair)
        text = white_remark(noisy, clean) if noisy and clean else None
        remarks.append((pair[1].path, (text,) if text else ()))
    return distinct(remarks)


def _decode_levels(files: FrameFiles, record: FrameRecord) -> MeanLevels:
    """Decode a row's raw file for its mean black level and its white level, DN."""
    from eldata.raw.levels import mean_levels
    from eldata.raw.reading import read_raw

    return mean_levels(read_raw(files.at(record.path)).sensor)
