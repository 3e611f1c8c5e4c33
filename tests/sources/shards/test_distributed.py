"""Three processes of torch.distributed: what they get together, from a store and from shards."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from eldata import StreamedPairs
from eldata.datasets import PackedStore
from eldata.sources.shards import write_shards
from tests.sources.shards.helpers import identities
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.study

RANKS = 3
ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def shards(eld: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Whole frames in two shards, of 20 and 4 samples: fewer than ranks, and uneven."""
    folder = tmp_path_factory.mktemp("distributed") / "shards"
    write_shards(eld, folder, tile=None, samples_per_shard=20)
    return folder


@pytest.fixture(scope="module")
def got(eld: Path, shards: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What each rank got: by loader, by epoch, the items in their order."""
    folder = tmp_path_factory.mktemp("ranks")
    running = [
        subprocess.Popen(
            [sys.executable, "-m", "tests.sources.shards.ranks", str(rank), str(RANKS), folder, eld, shards],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for rank in range(RANKS)
    ]
    try:
        for process in running:
            out, _ = process.communicate(timeout=PATIENCE_S)
            assert process.returncode == 0, out
    finally:
        for process in running:
            process.kill()
            process.communicate()
    return [json.loads((folder / f"{rank}.json").read_text()) for rank in range(RANKS)]


@pytest.fixture(scope="module")
def items(eld: Path, shards: Path) -> Callable[[str, int], Counter[str]]:
    """All items of an epoch, read by one process."""

    def of(kind: str, epoch: int) -> Counter[str]:
        dataset: Any = (
            PackedStore(eld, crop=8, crops_per_frame=3) if kind == "packed" else StreamedPairs(str(shards), crop=8)
        )
        dataset.set_epoch(epoch)
        return Counter(identities(dataset))

    return of


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("kind", ["packed", "streamed"])
def test_evaluation_has_each_item_exactly_once(
    kind: str, workers: int, got: list[dict[str, Any]], items: Callable[[str, int], Counter[str]]
) -> None:
    """72 items of the store, 24 of the shards, in batches of 5 on 3 ranks of 0 or 2 workers."""
    for epoch in range(2):
        parts = [rank[f"{kind} evaluation {workers}"][epoch] for rank in got]
        assert Counter(one for part in parts for one in part) == items(kind, epoch)
        assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize("workers", [0, 2])
def test_a_loader_of_ones_own_has_each_item_exactly_once(
    workers: int, got: list[dict[str, Any]], items: Callable[[str, int], Counter[str]]
) -> None:
    assert Counter(one for rank in got for one in rank[f"own loader {workers}"][0]) == items("streamed", 0)


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("kind", ["packed", "streamed"])
def test_training_has_as_many_on_each_rank_and_none_twice(
    kind: str, workers: int, got: list[dict[str, Any]], items: Callable[[str, int], Counter[str]]
) -> None:
    orders = []
    for epoch in range(2):
        parts = [rank[f"{kind} training {workers}"][epoch] for rank in got]
        together = Counter(one for part in parts for one in part)
        whole = items(kind, epoch)
        assert not together - whole
        assert {len(part) for part in parts} == {whole.total() // RANKS // 5 * 5}
        orders.append([one.split()[0] for one in parts[0]])
    assert orders[0] != orders[1]


def test_workers_change_nothing_of_a_stores_batches(got: list[dict[str, Any]]) -> None:
    for rank in got:
        assert rank["packed training 0"] == rank["packed training 2"]
        assert rank["packed evaluation 0"] == rank["packed evaluation 2"]
        assert rank["streamed evaluation 0"] != rank["streamed training 0"]
