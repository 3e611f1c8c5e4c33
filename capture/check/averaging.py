"""Means of references: the frames of a block become one file, with which noisy frames are compared."""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.capture_errors import MappingError
from capture.check.checking import check_unit
from capture.check.frames import Unit
from capture.placing import write_new
from eldata.base.files import inside
from eldata.base.workers import AnyWorkers, Workers
from eldata.errors import ArgumentError
from eldata.manifest.card import counts_of, load_card
from eldata.manifest.catalogue import data_root
from eldata.manifest.table import load_records
from eldata.manifest.writing import save_manifest

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from eldata.records import FrameRecord, RawFrame

SOURCE: Final = "capture average: IMG_a-b.dng is the mean of the references IMG_a to IMG_b"
_NUMBERED: Final = re.compile(r"IMG_(\d+)")


@dataclass(frozen=True, slots=True)
class Averaged:
    """What became of the references that stand together in one scene.

    Attributes
    ----------
    name
        Camera and scene.
    files
        The manifest's paths of the single frames.
    mean
        That of their mean; ``None`` if they were left as they are.
    noisy
        How many noisy frames are compared with the mean.
    reasons
        Why they were left: what ``capture check`` says of them.
    """

    name: str
    files: tuple[str, ...]
    mean: str | None
    noisy: int = 0
    reasons: tuple[str, ...] = ()


def average_references(
    manifest: Path | str, root: Path | str | None = None, *, workers: AnyWorkers = 1
) -> tuple[Averaged, ...]:
    """Write the mean of each block of references, and compare its noisy frames with that.

    A mean of n frames has 1/n of the variance of one. It is a DNG in DN, with the frames' black and white level, ISO
    and exposure time; rounding to whole DN adds a variance of 1/12 DN². A pixel that is saturated in one of the frames
    is saturated in the mean. The single frames stay in the manifest. What was measured of a pair against another
    reference is removed. Doing it again changes nothing.

    Parameters
    ----------
    manifest
        CSV file of a set in the dataset's layout (``capture manifest --copy-to``), its card beside it.
    root
        The folder that holds the dataset; default ``$ELDATA_ROOT``, else ``./data``.
    workers
        Number of worker processes.

    Returns
    -------
    tuple of Averaged
        One for each block of two or more. Frames of which :func:`~capture.check.check` says ``"shoot again"``, because
        light or camera changed among them, are not averaged.

    Raises
    ------
    ArgumentError
        If no references stand together: the plan took one at a time.
    ManifestError
        If the manifest is malformed.
    RawFileError
        If a file cannot be read.
    MappingError
        If other content has the place of a mean, or the frames of a block have different sensors.
    EldataError
        If a file cannot be written.
    """
    path = Path(manifest)
    records, card = load_records(path), load_card(path.with_suffix(".json"))
    folder = data_root(root) / card.folder
    blocks = list(_blocks(records, folder))
    if not blocks:
        raise ArgumentError(
            f"{path}: has no scene in which two references IMG_<nnnn> follow each other; capture plan --references 10 "
            "takes ten in a row, and capture manifest --copy-to names them so"
        )
    rows = {record.path: record for record in records}
    found = []
    for block, made in zip(blocks, Workers.of(workers).run(_averaged, blocks, label="averaging"), strict=True):
        singles = tuple(one.path for one in block.records)
        if isinstance(made, tuple):
            found.append(Averaged(block.name, singles, None, 0, made))
            continue
        known = {*singles, made.path}
        noisy = [one for one in rows.values() if one.reference in known]
        rows[made.path] = made
        for one in noisy:
            if one.reference != made.path:  # what was measured was measured against another one
                rows[one.path] = replace(one, reference=made.path, measured_ratio=None, measured_shift_px=None)
        found.append(Averaged(block.name, singles, made.path, len(noisy)))
    if any(one.mean for one in found):
        sources = tuple(dict.fromkeys((*card.sources, SOURCE)))
        save_manifest(path, replace(card, counts=counts_of(rows.values()), sources=sources), rows.values())
    return tuple(found)


def _blocks(records: Iterable[FrameRecord], folder: Path) -> Iterator[Unit]:
    """Yield references that follow each other."""
    scenes: dict[tuple[str, str], list[tuple[int, FrameRecord]]] = defaultdict(list)
    for record in records:
        number = _NUMBERED.fullmatch(PurePosixPath(record.path).stem)
        if number is not None and record.role in ("reference", "noisy"):
            scenes[record.camera, record.scene].append((int(number[1]), record))
    for (camera, scene), frames in scenes.items():
        frames.sort(key=lambda one: one[0])
        for (role, *_), group in groupby(frames, key=lambda one: (one[1].role, one[1].iso, one[1].exposure_s)):
            together = [record for _, record in group]
            if role == "reference" and len(together) > 1:
                yield Unit(f"{camera} {scene}", folder, tuple(together), Workers(1))


def _averaged(block: Unit) -> FrameRecord | tuple[str, ...]:
    """Write a block's mean and return its row; or why its frames cannot be averaged."""
    from eldata.raw.dng import encode_dng

    records = block.records
    group = check_unit(block)
    if group.verdict == "shoot again":
        return tuple(str(one) for one in group.reasons if one.verdict == "shoot again")
    frame = _mean_frame([inside(block.folder, record.path) for record in records])
    first, last = (PurePosixPath(records[index].path) for index in (0, -1))
    mean = first.with_name(f"{first.stem}-{last.stem.removeprefix('IMG_')}.dng").as_posix()
    target = block.folder / mean
    try:
        content = encode_dng(frame.mosaic, frame.sensor, frame.exposure).getbuffer()
    except ArgumentError as error:
        raise ArgumentError(f"{target}: {error}") from error
    write_new(target, content)
    digest = f"sha256:{hashlib.sha256(content).hexdigest()}"
    return replace(records[0], path=mean, size_bytes=len(content), sha256=digest)


def _mean_frame(paths: Sequence[Path]) -> RawFrame:
    from eldata.raw.reading import read_raw

    first = read_raw(paths[0])
    white = first.sensor.white_level_dn
    total = np.zeros(first.mosaic.shape, dtype=np.uint32)
    saturated = np.zeros(first.mosaic.shape, dtype=bool)
    black = np.zeros(len(first.sensor.black_level_dn))
    for path in paths:
        frame = read_raw(path)
        for name, one, other in (
            ("white level", frame.sensor.white_level_dn, white),
            ("colour filter array", frame.sensor.cfa, first.sensor.cfa),
            ("size", frame.mosaic.shape, first.mosaic.shape),
        ):
            if one != other:
                raise MappingError(f"{path}: {name} {one}, expected {other} as in {paths[0]}")
        total += frame.whole_dn("the mean of a set's references")
        saturated |= frame.mosaic >= white
        black += frame.sensor.black_level_dn
    mosaic = np.rint(total / len(paths)).astype(np.uint16)
    mosaic[saturated] = np.maximum(mosaic[saturated], int(white))
    sensor = replace(first.sensor, black_level_dn=tuple(map(float, black / len(paths))))
    return replace(first, mosaic=mosaic, sensor=sensor)
