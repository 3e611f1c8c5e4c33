"""Train a network of clips, or one of frames that is not to flicker; `eldata predict` runs the file that it leaves.

    python examples/train_video_denoiser.py run --clean moving/ --profile SonyA7S2      # clean clips, noise on the fly
    python examples/train_video_denoiser.py run --clean clean.h5 --still --profile SonyA7S2 --network unet
    python examples/train_video_denoiser.py run --clips drv-train.h5 --network unet     # real static clips, packed
    python examples/train_video_denoiser.py run --clips data/DRV --split train --rgb    # or from DRV's folder

The loss is the published one, recovery of two predictions of one scene and 0.05 times their difference
(eldata.baselines.clip_error); --consistency has the weight. `unet` takes frame by frame; `fastdvdnet` takes five frames
and predicts the middle one. A network that saw only static clips averages frames and blurs what moves: train it on
clips that move. Everything else is as in train_denoiser.py, from which this takes options, noise and curves; keep both
files together.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import distributed
from train_denoiser import Stills, add_shared, curves_in, keep, noise_of, start_ranks

from eldata import DRVDataset, SyntheticClips
from eldata.baselines import FastDVDnet, Training, UNet, clip_error
from eldata.datasets import CleanClips, CleanFrames, describe, training_loader
from eldata.datasets.packed import PackedClips

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch.utils.data import Dataset

NETWORKS: dict[str, tuple[Any, int]] = {"fastdvdnet": (FastDVDnet, 2), "unet": (UNet, 4)}  # and their depth


def main(argv: Sequence[str] | None = None) -> None:
    """Train, or go on with a training; print each epoch's loss."""
    options = arguments().parse_args(argv)
    rank, device = start_ranks(options.device)
    options.run.mkdir(parents=True, exist_ok=True)
    kind, depth = NETWORKS[options.network]
    data = training_clips(options, frames=kind.window + 1)  # two windows: one more frame
    loader = training_loader(data, options.batch_size, seed=options.seed, device=device, workers=options.workers)
    channels = next(iter(data))["input"].shape[1]
    depth = depth if options.depth is None else options.depth
    network = kind(channels, width=options.width, depth=depth, seed=options.seed)
    training = Training(
        network,
        loader,
        steps=options.epochs * len(loader),
        learning_rate=options.learning_rate,
        loss=partial(clip_error, window=network.window, weight=options.consistency),
        device=device,
        precision=options.precision,
        settings={
            "data": repr(data),
            "consistency": options.consistency,
            **{name: getattr(options, name) for name in ("network", "width", "seed")},
            "depth": depth,
        },
    )
    if rank == 0:
        curve = curves_in(options.run)
        print(data, describe(loader), f"{sum(map(torch.numel, network.parameters())):,} parameters", sep="\n")
    for report in training.epochs(options.run / "checkpoint.pt", save_every=options.save_every):
        if rank == 0:
            print(report)
            curve("loss", report.loss, report.step)
    if rank == 0:
        keep(network, options.run, channels, options.input_clip)
    if distributed.is_initialized():
        distributed.destroy_process_group()


def training_clips(options: argparse.Namespace, frames: int) -> Dataset[Any]:
    """Return windows of so many frames: of real static clips and their still, or of clean ones with noise made."""
    crops = {"crop": options.crop, "seed": options.seed, "clip": options.input_clip}
    if options.clips:
        place = Path(options.clips)
        kind: Any = partial(DRVDataset, form="preprocessed" if options.rgb else "raw")
        kind = PackedClips if place.is_file() else kind
        windows: dict[str, Any] = {"window": frames, "crops_per_window": options.crops_per_clip}
        windows |= {"split": options.split, "ids": options.ids}
        real: Dataset[Any] = kind(place, levels=options.levels, augment=True, **crops, **windows)
        return real
    if not (options.clean and options.profile):
        arguments().error("give --clips, or --clean with --profile")
    if options.still:
        source: Any = Stills(CleanFrames(options.clean, levels=options.levels), frames)
    else:
        source = CleanClips(options.clean, levels=options.levels)
    noise = {"model": noise_of(options), "iso": options.iso, "ratio": tuple(options.ratio)}
    windows = {"frames": frames, "windows_per_clip": options.crops_per_clip}
    return SyntheticClips(source, options.profile, **windows, **crops, **noise)


def arguments() -> argparse.ArgumentParser:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of this training; the same command goes on with it")
    data = parser.add_argument_group("data")
    data.add_argument("--clips", help="static clips with a reference: a packed store, or a folder of DRV's raws")
    data.add_argument("--rgb", action="store_true", help="the folder is DRV as its authors preprocessed it")
    data.add_argument("--split", help="of --clips, such as train (default: all)")
    data.add_argument("--ids", nargs="+", help="of --clips, such as 0001 0004 (default: all)")
    data.add_argument("--clean", help="clean clips: a folder with a folder of raws for each, or the store of such")
    data.add_argument("--still", action="store_true", help="--clean has single frames: clips in which nothing moves")
    data.add_argument("--crops-per-clip", type=int, default=1, help="in an epoch (default: %(default)s)")
    how = add_shared(parser, data)
    how.add_argument("--network", choices=NETWORKS, default="fastdvdnet", help="(default: %(default)s)")
    how.add_argument("--depth", type=int, help="how often it halves the image (default: 2; 4 for unet)")
    how.add_argument("--consistency", type=float, default=0.05, help="its weight in the loss (default: %(default)s)")
    parser.set_defaults(levels="metadata")  # as the protocols of clips have it
    return parser


if __name__ == "__main__":  # workers import this file: the guard is needed
    main()
