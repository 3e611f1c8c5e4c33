"""A second pass with the same noise is said once; looking at items, choosing an epoch and evaluating are not."""

from __future__ import annotations

import copy
import pickle
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from torch.utils.data import DataLoader, Subset

from eldata.datasets import Arrays, CleanClips, SyntheticClips, SyntheticPairs, evaluation_loader, training_loader
from tests.datasets.methods import METHODS, workers
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Iterable

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")

COUNT = 24


def pairs(**options: Any) -> SyntheticPairs:
    source = Arrays(np.full((4, 4, 16, 16), 0.3, np.float32), range_dn=15871.0)
    return SyntheticPairs(source, "SonyA7S2", **{"crop": 4, "crops_per_frame": COUNT // 4} | options)


def warned(*passes: Iterable[Any]) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        for one in passes:
            for _ in one:
                pass
    return [str(warning.message) for warning in found]


def test_a_second_pass_is_said_once() -> None:
    dataset = pairs()
    assert warned(dataset) == []
    (text,) = warned(dataset, dataset, dataset)
    assert text.startswith("SyntheticPairs: items of epoch 0 come again")
    assert "call dataset.set_epoch(epoch) before each pass" in text
    assert "as for validation, call dataset.set_epoch(0) once" in text
    frames = Arrays(np.full((5, 4, 16, 16), 0.3), range_dn=1000.0)
    clips = SyntheticClips(CleanClips([frames] * COUNT), "SonyA7S2", crop=4)
    (text,) = warned(clips, clips)
    assert text.startswith("SyntheticClips: ")


def test_a_pass_of_batches_or_of_a_part_is_a_pass() -> None:
    dataset = pairs()
    assert len(warned(*[DataLoader(dataset, batch_size=5, shuffle=True)] * 2)) == 1
    dataset = pairs(crops_per_frame=100)
    part: Any = Subset(dataset, range(0, 400, 8))
    assert warned(part, part) == []
    assert len(warned(part, part, part)) == 1


@pytest.mark.parametrize("is_shuffled", [False, True])
def test_looking_at_items_is_not_a_pass(is_shuffled: bool) -> None:
    """A fifth of the items one by one, then a batch of them, then all: of 520 draws, 120 are of items that had come."""
    dataset = pairs(crops_per_frame=100)
    looks = [dataset[index] for index in range(80)], next(iter(DataLoader(dataset, batch_size=40)))
    assert looks[0][39]["ratio"] == looks[1]["ratio"][39]
    assert warned(DataLoader(dataset, batch_size=5, shuffle=is_shuffled)) == []


@pytest.mark.parametrize("epoch", [0, 3])
def test_who_chose_the_epoch_is_not_told(epoch: int) -> None:
    dataset = pairs()
    dataset.set_epoch(epoch)
    assert warned(dataset, dataset, dataset) == []
    dataset = pairs()
    for number in range(3):
        dataset.set_epoch(number)
        assert warned(dataset) == []


def test_evaluation_is_meant_to_repeat_and_training_is_not() -> None:
    assert warned(*[evaluation_loader(pairs(), 4, workers=0)] * 3) == []
    assert len(warned(*[training_loader(pairs(), 4, workers=0)] * 3)) == 1


def test_a_copy_has_noted_what_the_original_had() -> None:
    original = pairs()
    assert warned(original) == []
    for dataset in (copy.deepcopy(original), pickle.loads(pickle.dumps(original))):
        assert len(warned(dataset)) == 1
    assert len(warned(original)) == 1


@pytest.mark.parametrize("method", METHODS)
def test_what_workers_draw_counts(method: str) -> None:
    """They end with their pass; the main process knows of it all the same."""
    dataset = pairs()
    options: dict[str, Any] = {"num_workers": workers(method), "multiprocessing_context": method, "timeout": PATIENCE_S}
    assert warned(DataLoader(dataset, batch_size=4, **options)) == []
    assert len(warned(dataset)) == 1


def test_workers_say_it_too(capfd: pytest.CaptureFixture[str]) -> None:
    dataset = pairs()
    loader = DataLoader(
        dataset,
        batch_size=4,
        num_workers=1,
        persistent_workers=True,
        multiprocessing_context="spawn",
        timeout=PATIENCE_S,
    )
    said = []
    for _ in range(3):
        assert warned(loader) == []
        said.append(capfd.readouterr().err.count("SyntheticPairs: items of epoch 0"))
    assert said == [0, 1, 0]
