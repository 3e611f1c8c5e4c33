"""Is a store whole? Finds and lists every problem; never writes."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

from tqdm import tqdm

from eldata.base.workers import AnyWorkers, Workers, require_files
from eldata.manifest.verify_report import DatasetReport, Problem, VerifyReport
from eldata.sources.store.build import pixels_digest
from eldata.sources.store.format import StoreError
from eldata.sources.store.read import PixelReader, open_store, opened

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from eldata.manifest.verify_report import Level
    from eldata.sources.store.format import AnyStored, Store

_ADVICE = "copy or pack the store again"


def verify_store(path: Path | str, *, level: Level = "quick", workers: AnyWorkers = 1) -> VerifyReport:
    """Check a store.

    Parameters
    ----------
    path
        The store.
    level
        ``"quick"`` and ``"metadata"``: it opens, is complete, holds as many frames as were packed, each of its stated
        size, and both frames of each pair are there. ``"full"``: also the
        checksum of each frame's pixels.
    workers
        Number of threads, or an executor that reads the pixels (:mod:`eldata.base.workers`).

    Raises
    ------
    StoreError
        If it is not a store, truncated, not complete, or of another version.
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
    """Yield where frames are not of their stated size in whole pixels of uint16, and which pairs lack a reference."""
    with opened(store.path) as file:
        for frame in store.every:
            if frame.key not in file["frames"]:
                yield Problem(store.dataset, frame.path, "pixels", f"a frame {frame.key}", "nothing", _ADVICE)
                continue
            dataset, shape = file["frames"][frame.key], frame.shape
            found, expected = f"{dataset.dtype} {dataset.shape}", f"uint16 {shape}"
            if found != expected:
                yield Problem(store.dataset, frame.path, "pixels", expected, found, _ADVICE)
                continue
            if dataset.chunks is None:
                expected, found = "one piece", "nothing" if dataset.id.get_offset() is None else "one piece"
            else:
                chunks = math.prod(-(-side // of_chunk) for side, of_chunk in zip(shape, dataset.chunks, strict=True))
                expected, found = f"{chunks} chunks", f"{dataset.id.get_num_chunks()} chunks"
            if found != expected:
                yield Problem(store.dataset, frame.path, "pixels", expected, found, _ADVICE)
    if store.manifest is not None:
        held = {frame.path for frame in store.every}
        for record in store.manifest.records:
            if record.path in held and record.reference is not None and record.reference not in held:
                yield Problem(store.dataset, record.path, "reference", record.reference, "nothing", _ADVICE)


def _pixels(dataset: str, reader: PixelReader, frame: AnyStored) -> list[Problem]:
    require_files(reader.path)
    try:
        found = pixels_digest(reader.read(frame.key, slice(None), slice(None)))
    except StoreError as error:
        found = error.reason
    if found == frame.sha256:
        return []
    return [Problem(dataset, frame.path, "sha256 of the pixels", frame.sha256, found, _ADVICE)]
