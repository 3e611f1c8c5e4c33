"""Trainings that are killed in the middle of an epoch, under torchrun and on Dask: what they get before and after."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from eldata import PackedStore, StreamedPairs
from eldata.datasets.ranks import Rank
from tests.base.clusters.conftest import client, cluster, dask, importable  # noqa: F401 # fixtures
from tests.sources.shards.helpers import identities
from tests.sources.shards.steps import BATCH, EPOCHS, loaders, noted, steps, train
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from concurrent.futures import Executor

ROOT = Path(__file__).parents[3]


def check(folder: Path, store: Path, shards: Path, ranks: int, workers: int) -> None:
    """Both runs together: the batches of an epoch that nothing ended, to the bit, and so each item at most once."""
    together: list[list[Counter[str]]] = [[Counter() for _ in range(EPOCHS)] for _ in range(2)]
    for number in range(ranks):
        got = [json.loads(line) for line in noted(folder, number)]
        alone = loaders(str(store), str(shards), Rank(number, ranks), workers)
        assert got == list(steps(alone))
        batches = len(alone[0])
        assert len(got) == EPOCHS * batches == EPOCHS * (144 // ranks // BATCH)
        for step, pair in enumerate(got):
            for kind, items in enumerate(pair):
                together[kind][step // batches].update(items)
    for epoch in range(EPOCHS):
        both: tuple[Any, ...] = PackedStore(store, crop=8, crops_per_frame=6), StreamedPairs(str(shards), crop=8)
        for kind, dataset in enumerate(both):
            dataset.set_epoch(epoch)
            whole = Counter(identities(dataset))
            assert not together[kind][epoch] - whole
            assert together[kind][epoch].total() == 144 // ranks // BATCH * BATCH * ranks


@pytest.mark.kill
def test_a_killed_torchrun_goes_on_in_the_middle_of_an_epoch(eld: Path, tiles: Path, tmp_path: Path) -> None:
    """Rank 0 of two, with two workers each, dies in the second epoch, after it had its fourth batch; torchrun ends the
    other. (Of three without workers: on Dask, below.)"""
    ranks, workers = 2, 2
    die_at = 144 // ranks // BATCH + 3
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(ranks)]
    module = ["-m", "tests.sources.shards.steps"]
    command = [*torchrun, *module, *map(str, (tmp_path, eld, tiles, workers, die_at))]
    killed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert killed.returncode != 0
    assert "Signal 9 (SIGKILL)" in killed.stderr
    assert len(noted(tmp_path, 0)) == die_at
    again = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert again.returncode == 0, again.stderr
    check(tmp_path, eld, tiles, ranks, workers)


@pytest.mark.dask
@pytest.mark.kill
def test_ranks_on_dask_go_on_in_the_middle_of_an_epoch(
    dask: Executor,  # noqa: F811 # the fixture
    eld: Path,
    tiles: Path,
    tmp_path: Path,
) -> None:
    """Three ranks as tasks of two processes; that of rank 0 dies, and Dask runs its task again in another one."""
    running = [dask.submit(train, Rank(number, 3), tmp_path, str(eld), str(tiles), 0, 9, int) for number in range(3)]
    begun = [task.result(PATIENCE_S) for task in running]
    assert begun[0] == 9  # it went on
    check(tmp_path, eld, tiles, 3, 0)
