"""A rank of a training that notes which items it got, dies by SIGKILL in an epoch, and goes on where its notes end.

Under torchrun (``python -m torch.distributed.run ... -m tests.sources.shards.steps``) and as a task of a Dask cluster.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata import PackedStore, StreamedPairs
from eldata.datasets import set_epoch, training_loader
from eldata.datasets.ranks import Rank, current_rank
from tests.sources.shards.helpers import unbatched

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from torch.utils.data import DataLoader

BATCH, EPOCHS = 7, 2


def loaders(store: str, shards: str, rank: Rank, workers: int) -> list[DataLoader[Any]]:
    """Of as many items each, so that both take their steps together."""
    both = PackedStore(store, crop=8, crops_per_frame=6), StreamedPairs(shards, crop=8, shuffle_buffer=20)
    return [training_loader(one, BATCH, rank=rank, workers=workers) for one in both]


def steps(both: list[DataLoader[Any]], begun: int = 0) -> Iterator[list[list[str]]]:
    """Yield what each loader gives, batch by batch, after those that were given before."""
    first_epoch, first_batch = divmod(begun, len(both[0]))
    for epoch in range(first_epoch, EPOCHS):
        for loader in both:
            set_epoch(loader, epoch, first_batch=first_batch)
        first_batch = 0
        for batches in zip(*both, strict=True):
            yield [unbatched([batch]) for batch in batches]


def noted(folder: Path, rank: int) -> list[str]:
    """Return the lines that a rank has noted, whole ones."""
    path = folder / f"{rank}.jsonl"
    return [line for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")] if path.exists() else []


def train(
    rank: Rank, folder: Path, store: str, shards: str, workers: int, die_at: int, together: Callable[[], object]
) -> int:
    """Go on with a training; the first rank dies once before it has noted the step ``die_at``, as a checkpoint."""
    begun = len(noted(folder, 0 if together is not int else rank.number))
    own = noted(folder, rank.number)[:begun]
    together()  # all have read how far the first one was
    with (folder / f"{rank.number}.jsonl").open("w") as notes:
        notes.writelines(own)
        notes.flush()
        for step, got in enumerate(steps(loaders(store, shards, rank, workers), begun), begun):
            together()  # as gradients are exchanged
            if step == die_at and begun == 0 and rank.number == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            notes.write(json.dumps(got) + "\n")
            notes.flush()
    return begun


def main(folder: str, store: str, shards: str, workers: str, die_at: str) -> None:
    import torch.distributed

    torch.distributed.init_process_group("gloo")
    train(current_rank(), Path(folder), store, shards, int(workers), int(die_at), torch.distributed.barrier)
    torch.distributed.destroy_process_group()


if __name__ == "__main__":
    main(*sys.argv[1:])
