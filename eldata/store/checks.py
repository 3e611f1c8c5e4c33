"""Is a store whole? Finds and lists every problem; never writes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from tqdm import tqdm

from eldata.manifest.verify import DatasetReport, Problem, VerifyReport
from eldata.parallel import check_jobs, read_ahead
from eldata.store.build import pixels_digest
from eldata.store.layout import CHUNK, StoreError
from eldata.store.read import PixelReader, open_store, opened

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from eldata.manifest.verify import Level
    from eldata.store.layout import Store, StoredFrame

_ADVICE = "copy or pack the store again"


def verify_store(path: Path | str, *, level: Level = "quick", jobs: int = 1) -> VerifyReport:
    """Check a store.

    Parameters
    ----------
    path
        The store.
    level
        ``"quick"`` and ``"metadata"``: it opens, is complete, holds as many frames as were packed, each of its stated
        size, and both frames of each pair. ``"full"``: also the checksum of each frame's pixels.
    jobs
        Number of threads.

    Raises
    ------
    StoreError
        If it is no store, truncated, not complete, or of a newer version.
    ArgumentError
        If it is compressed and hdf5plugin is not installed.
    """
    check_jobs(jobs)
    store = open_store(path)
    problems = list(_structure(store))
    if level == "full":
        work = partial(_pixels, store, PixelReader(store.path))
        bar = tqdm(total=len(store.frames), desc=f"{store.dataset} (full)", unit="frame", disable=None, leave=False)
        with bar:
            for found in read_ahead(work, store.frames, threads=jobs):
                bar.update()
                problems += found
    problems.sort(key=lambda problem: problem.path)
    count = len(store.frames)
    homepage = "" if store.manifest is None else store.manifest.card.homepage
    hashed = count if level == "full" else 0
    report = DatasetReport(store.dataset, store.path, False, homepage, count, count, hashed, tuple(problems))
    return VerifyReport(level, (report,))


def _structure(store: Store) -> Iterator[Problem]:
    with opened(store.path) as file:
        for frame in store.frames:
            dataset = file["frames"][frame.key]
            found = f"{dataset.dtype} {dataset.shape}"
            expected = f"uint16 {(frame.sensor.height, frame.sensor.width)}"
            if found != expected:
                yield Problem(store.dataset, frame.path, "pixels", expected, found, _ADVICE)
                continue
            chunks = -(-frame.sensor.height // CHUNK) * -(-frame.sensor.width // CHUNK)
            written = dataset.id.get_num_chunks()
            if written != chunks:
                yield Problem(store.dataset, frame.path, "pixels", f"{chunks} chunks", str(written), _ADVICE)
    if store.manifest is not None:
        held = {frame.path for frame in store.frames}
        for record in store.manifest.records:
            if record.path in held and record.reference is not None and record.reference not in held:
                yield Problem(store.dataset, record.path, "reference", record.reference, "nothing", _ADVICE)


def _pixels(store: Store, reader: PixelReader, frame: StoredFrame) -> list[Problem]:
    try:
        found = pixels_digest(reader.borrow(frame.key, range(frame.sensor.height), range(frame.sensor.width)))
    except StoreError as error:
        found = error.reason
    if found == frame.sha256:
        return []
    return [Problem(store.dataset, frame.path, "sha256 of the pixels", frame.sha256, found, _ADVICE)]
