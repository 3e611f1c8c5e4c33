"""What must not grow with the number of frames: what is read and opened before the first batch."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Any

from benchmarks.many_frames import write_small_store
from eldata import PackedStore
from eldata.datasets import base, training_loader
from eldata.records import Records
from eldata.sources.store import verify_store

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_opening_a_store_opens_one_pair_of_each_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """500 frames of 50 scenes, each with a white balance of its own: pairs of one kind. A batch opens its own four."""
    path = write_small_store(tmp_path / "small.h5", 500)
    assert verify_store(path).ok
    opened: list[str] = []
    open_pair = base.SourcePairs._open_pair

    def counted(pairs: Any, record: Any) -> Any:
        opened.append(record.path)
        return open_pair(pairs, record)

    monkeypatch.setattr(base.SourcePairs, "_open_pair", counted)
    pairs = PackedStore(path, crop=16)
    assert (len(pairs), len(opened)) == (450, 1)
    loader = training_loader(pairs, 4, workers=0)
    next(iter(loader))
    assert len(opened) == 5
    monkeypatch.setattr(base, "_MOST_OPEN", 10)
    for _ in zip(range(20), loader, strict=False):
        assert len(pairs._pairs) <= 10


def test_a_dataset_goes_to_workers_by_columns(tmp_path: Path) -> None:
    """It is the same there; frames share their sensors, and what one process has opened the others have not."""
    pairs = PackedStore(write_small_store(tmp_path / "small.h5", 200), crop=16)
    pairs.set_epoch(0)
    first = pairs[3]
    sent = pickle.loads(pickle.dumps(pairs))
    assert sent.records == pairs.records
    assert sent.source.frames == pairs.source.frames
    assert sent.source.records == pairs.source.records
    assert len({*map(id, (frame.sensor for frame in sent.source.frames))}) == 20
    assert sent._pairs == {}
    assert sent[3]["path"] == first["path"]
    assert (sent[3]["input"] == first["input"]).all()
    assert pickle.loads(pickle.dumps(Records())) == ()
    assert isinstance(sent.records, tuple)
