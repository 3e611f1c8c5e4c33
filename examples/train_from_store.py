"""Train a small network on the pairs of a packed store.

    eldata pack sid-sony --root data --split train -o sid-train.h5
    python examples/train_from_store.py sid-train.h5 --crop 512 --batch-size 4 --epochs 10

    eldata shard sid-train.h5 -o shards          # or from shards, on a disk or anywhere: s3://bucket/shards
    python examples/train_from_store.py shards --crop 512 --batch-size 4 --epochs 10

On several GPUs: torchrun --nproc-per-node 4 examples/train_from_store.py ...
The network here is two convolutions; put yours in its place.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import torch

from eldata import PackedStore, StreamedPairs
from eldata.datasets.loading import describe, set_epoch, training_loader


def main() -> None:
    """Train, and print the mean absolute error of each epoch."""
    options = arguments()
    rank, device = start_ranks()
    path, crop = options.data, options.crop
    is_store = Path(path).is_file()
    dataset = PackedStore(path, crop=crop, seed=options.seed) if is_store else StreamedPairs(path, crop=crop)
    loader = training_loader(dataset, options.batch_size, seed=options.seed, device=device, workers=options.workers)
    if rank == 0:
        print(dataset, describe(loader), sep="\n")

    generator = torch.Generator().manual_seed(options.seed)
    network = small_network(next(iter(loader))["input"].shape[1], generator).to(device)
    parallel = torch.nn.parallel.DistributedDataParallel(network) if torch.distributed.is_initialized() else network
    optimiser = torch.optim.Adam(parallel.parameters(), lr=1e-3)
    for epoch in range(options.epochs):
        set_epoch(loader, epoch)  # new order, new crops; after a restart, go on with the epoch that is next
        total = torch.zeros((), device=device)
        for batch in loader:
            noisy, clean = (batch[name].to(device, non_blocking=True) for name in ("input", "target"))
            loss = (noisy + parallel(noisy) - clean).abs().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            total += loss.detach()
        if rank == 0:
            print(f"epoch {epoch}: mean absolute error {total.item() / len(loader):.5f}")
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


def start_ranks() -> tuple[int, torch.device]:
    """Join the processes that torchrun started, if it did; each takes a GPU of its own where there are any."""
    cuda = torch.cuda.is_available()
    if "WORLD_SIZE" in os.environ:
        torch.distributed.init_process_group("nccl" if cuda else "gloo")
    rank = torch.distributed.get_rank() if torch.distributed.is_initialized() else 0
    return rank, torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0"))) if cuda else torch.device("cpu")


def small_network(channels: int, generator: torch.Generator) -> torch.nn.Module:
    """Two convolutions that predict what is to be added; the last one starts at 0."""
    first = torch.nn.Conv2d(channels, 16, 3, padding=1)
    last = torch.nn.Conv2d(16, channels, 3, padding=1)
    with torch.no_grad():
        for parameter in (*first.parameters(), *last.parameters()):
            parameter.zero_()
        first.weight.normal_(0, 0.1, generator=generator)
    return torch.nn.Sequential(first, torch.nn.ReLU(), last)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", help="a packed store, or the address of a folder of shards")
    parser.add_argument("--crop", type=int, default=256, help="side in packed pixels (default: %(default)s)")
    parser.add_argument("--batch-size", type=int, default=4, help="per process (default: %(default)s)")
    parser.add_argument("--epochs", type=int, default=5, help="(default: %(default)s)")
    parser.add_argument("--workers", type=int, help="default: by CPUs and memory")
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    return parser.parse_args()


if __name__ == "__main__":  # workers import this file: the guard is needed
    main()
