"""Is a store whole? Finds and lists every problem; never writes."""

from __future__ import annotations

import math
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING

from tqdm import tqdm

from eldata.base.workers import AnyWorkers, Workers, require_files
from eldata.manifest.verify_report import DatasetReport, Problem, VerifyReport
from eldata.sources.store.build import pixels_digest
from eldata.sources.store.format import StoreError, chunk_shape
from eldata.sources.store.read import PixelReader, open_store, opened

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from eldata.manifest.verify_report import Level
    from eldata.sources.store.format import Store, StoredFrame, StoredRgb

_ADVICE = "copy or pack the store again"


def verify_store(path: Path | str, *, level: Level = "quick", workers: AnyWorkers = 1) -> VerifyReport:
    """Check a store.

    Parameters
    ----------
    path
        The store.
    level
        ``"quick"`` and ``"metadata"``: it opens, is complete, holds as many frames as were packed, each of its stated
        size, its table says what their attributes do, and both frames of each pair are there. ``"full"``: also the
        checksum of each frame's pixels.
    workers
        Number of threads, or an executor that reads the pixels (:mod:`eldata.base.workers`).

    Raises
    ------
    StoreError
        If it is not a store, truncated, not complete, or of a newer version.
    ArgumentError
        If it is compressed and hdf5plugin is not installed.
    """
    workers = Workers.of(workers)
    store = open_store(path)
    problems = list(structure_problems(store))
    count = len(store.every)
    if level == "full":
        work = partial(_pixels, store.dataset, PixelReader(store.path.absolute()))
        bar = tqdm(total=count, desc=f"{store.dataset} (full)", unit="frame", disable=None, leave=False)
        with bar:
            for found in workers.read_ahead(work, store.every):
                bar.update()
                problems += found
    problems.sort(key=lambda problem: problem.path)
    homepage = "" if store.manifest is None else store.manifest.card.homepage
    hashed = count if level == "full" else 0
    report = DatasetReport(store.dataset, store.path, False, homepage, count, count, hashed, tuple(problems))
    return VerifyReport(level, (report,))


def structure_problems(store: Store) -> Iterator[Problem]:
    """Yield where frames are not of their stated size in whole chunks of uint16, and which pairs lack a reference."""
    stated = {frame.key: frame for frame in open_store(store.path, by_table=False).every}
    with opened(store.path) as file:
        for frame in store.every:
            if frame.key not in stated:
                yield Problem(store.dataset, frame.path, "table", "nothing", f"a frame {frame.key}", _ADVICE)
                continue
            for name, expected, found in _differences(stated[frame.key], frame):
                yield Problem(store.dataset, frame.path, f"{name} in the table", expected, found, _ADVICE)
            dataset, shape = file["frames"][frame.key], frame.shape
            found, expected = f"{dataset.dtype} {dataset.shape}", f"uint16 {shape}"
            if found != expected:
                yield Problem(store.dataset, frame.path, "pixels", expected, found, _ADVICE)
                continue
            chunks = math.prod(-(-side // of_chunk) for side, of_chunk in zip(shape, chunk_shape(shape), strict=True))
            written = dataset.id.get_num_chunks()
            if written != chunks:
                yield Problem(store.dataset, frame.path, "pixels", f"{chunks} chunks", str(written), _ADVICE)
    if store.manifest is not None:
        held = {frame.path for frame in store.every}
        for record in store.manifest.records:
            if record.path in held and record.reference is not None and record.reference not in held:
                yield Problem(store.dataset, record.path, "reference", record.reference, "nothing", _ADVICE)


def _differences(one: StoredFrame | StoredRgb, other: StoredFrame | StoredRgb) -> Iterator[tuple[str, str, str]]:
    """Yield name and both values of the fields in which two records of a frame differ."""
    for name in (field.name for field in fields(other)):
        values = getattr(one, name, None), getattr(other, name)
        if values[0] != values[1]:
            yield name, str(values[0]), str(values[1])


def _pixels(dataset: str, reader: PixelReader, frame: StoredFrame | StoredRgb) -> list[Problem]:
    require_files(reader.path)
    try:
        *planes, height, width = frame.shape
        found = pixels_digest(reader.borrow(frame.key, range(height), range(width), tuple(planes)))
    except StoreError as error:
        found = error.reason
    if found == frame.sha256:
        return []
    return [Problem(dataset, frame.path, "sha256 of the pixels", frame.sha256, found, _ADVICE)]
