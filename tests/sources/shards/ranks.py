"""Real processes of torch.distributed (gloo), each writing which items it got; started by test_distributed."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import torch.distributed
from torch.utils.data import DataLoader

from eldata import StreamedPairs
from eldata.datasets import PackedStore
from eldata.datasets.loading import evaluation_loader, set_epoch, training_loader
from tests.sources.shards.helpers import unbatched


def epochs(loader: DataLoader[Any]) -> list[list[str]]:
    found = []
    for epoch in range(2):
        set_epoch(loader, epoch)
        found.append(unbatched(loader))
    return found


def loaders(store: str, shards: str, workers: int) -> dict[str, DataLoader[Any]]:
    """Every kind of loader; the datasets are made before, as a script may do it."""
    packed = PackedStore(store, crop=8, crops_per_frame=3)
    streamed = StreamedPairs(shards, crop=8)
    context: dict[str, Any] = {"multiprocessing_context": "forkserver"} if workers else {}
    return {
        "packed training": training_loader(packed, 5, workers=workers),
        "packed evaluation": evaluation_loader(packed, 5, workers=workers),
        "streamed training": training_loader(streamed, 5, workers=workers),
        "streamed evaluation": evaluation_loader(streamed, 5, workers=workers),
        "own loader": DataLoader(StreamedPairs(shards, crop=8), batch_size=5, num_workers=workers, **context),
    }


def main(rank: str, of: str, folder: str, store: str, shards: str) -> None:
    torch.distributed.init_process_group("gloo", f"file://{folder}/meeting", rank=int(rank), world_size=int(of))
    found: dict[str, Any] = {}
    for workers in (0, 2):
        for name, loader in loaders(store, shards, workers).items():
            if name == "own loader":
                found[f"{name} {workers}"] = [unbatched(loader)]
            else:
                found[f"{name} {workers}"] = epochs(loader)
            torch.distributed.barrier()  # as training does: unequal batches would not be seen here
    (Path(folder) / f"{rank}.json").write_text(json.dumps(found))
    torch.distributed.destroy_process_group()


if __name__ == "__main__":
    main(*sys.argv[1:])
