"""`python -m eldata.examples.train_video_denoiser`: train a network of clips, and export it for `eldata predict`.

Train on windows of clean clips with a camera's noise made on the fly, or of real static clips with their reference.
The loss is the published one, recovery of two predictions of one scene and --consistency times their difference
(eldata.baselines.clip_error). RUN gets checkpoint.pt, from which the same command goes on, model.pt2 and weights.pt.

    python -m eldata.examples.train_video_denoiser --clean moving --camera SonyA7S2
    python -m eldata.examples.train_video_denoiser --clean clean.h5 --still --camera SonyA7S2 --frames 1
    python -m eldata.examples.train_video_denoiser --clips drv-train.h5 --frames 1
    python -m eldata.examples.train_video_denoiser --clips data/DRV --split train --rgb

The commands at the end name DRV; for a network of raw, drv-raw.csv is the manifest of its raws (docs/manifests.md). A
network that saw only static clips averages frames and blurs what moves: train it on clips that move. All else is as
in eldata.examples.train_denoiser.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata import DRVDataset, SyntheticClips
from eldata.base import console
from eldata.baselines import UNet, clip_error
from eldata.datasets import CleanClips, CleanFrames
from eldata.datasets.packed import PackedClips
from eldata.errors import ArgumentError
from eldata.examples.train_denoiser import (
    add_training_options,
    make_noise,
    program,
    save_and_show,
    start_ranks,
    still_clips,
    train,
)

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from torch.utils.data import Dataset


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    return console.run(parser(), None if argv is None else list(argv))


def run(options: argparse.Namespace) -> int:
    """Train, or go on with a training; print each epoch's loss."""
    device = start_ranks(options.device)
    data = training_clips(options, frames=options.frames + 1)  # two windows: one more frame
    channels = next(iter(data))["input"].shape[1]
    shape = {"width": options.width, "depth": options.depth, "frames": options.frames}
    network = UNet(channels, **shape, seed=options.seed)
    loss = partial(clip_error, window=network.window, weight=options.consistency)
    settings = {"consistency": options.consistency, "frames": options.frames, "depth": options.depth}
    train(options, device, data, network, loss, settings, lambda *_: {})
    scored = ("--dataset", "drv") if channels == 3 else ("--manifest", "drv-raw.csv")
    return save_and_show(options, network, channels, scored)


def training_clips(options: argparse.Namespace, frames: int) -> Dataset[Any]:
    """Open clips in windows of so many frames: real static ones and their still, or clean ones with made noise."""
    crops = {"crop": options.crop, "seed": options.seed, "clip": options.input_clip}
    if options.clips:
        place = Path(options.clips)
        kind: Any = partial(DRVDataset, form="preprocessed" if options.rgb else "raw")
        kind = PackedClips if place.is_file() else kind
        windows: dict[str, Any] = {"window": frames, "crops_per_window": options.crops_per_clip}
        windows |= {"split": options.split, "ids": options.ids}
        real: Dataset[Any] = kind(place, levels=options.levels, augment=True, **crops, **windows)
        return real
    if not (options.clean and options.camera):
        raise ArgumentError("give --clean with --camera, or --clips")
    if options.still:
        source = still_clips(CleanFrames(options.clean, levels=options.levels), frames)
    else:
        source = CleanClips(options.clean, levels=options.levels)
    noise = {"model": make_noise(options), "iso": options.iso, "ratio": tuple(options.ratio)}
    noise["range_dn"] = options.range_dn
    windows = {"frames": frames, "windows_per_clip": options.crops_per_clip}
    return SyntheticClips(source, options.camera, **windows, **crops, **noise)


def parser() -> console.Parser:
    """Make the command line's parser."""
    parser, data = program(__doc__, run)
    text = "clean clips: a folder with a folder of raws for each, or the store of such"
    data.add_argument("--clean", metavar="CLEAN", help=text)
    data.add_argument("--still", action="store_true", help="--clean has single frames: clips in which nothing moves")
    how = add_training_options(parser, data)
    text = "static clips with a reference: a packed store, or a folder of DRV's raws"
    data.add_argument("--clips", metavar="CLIPS", help=text)
    data.add_argument("--rgb", action="store_true", help="the folder is DRV as its authors preprocessed it")
    data.add_argument("--split", metavar="NAME", help="of --clips, such as train (default: all)")
    data.add_argument("--ids", nargs="+", metavar="ID", help="of --clips, such as 0001 0004 (default: all)")
    data.add_argument("--crops-per-clip", type=int, default=1, metavar="N", help="in an epoch (default: %(default)s)")
    text = "that the network takes for the middle one, an odd number (default: %(default)s)"
    how.add_argument("--frames", type=int, default=5, metavar="T", help=text)
    text = "its weight in the loss (default: %(default)s)"
    how.add_argument("--consistency", type=float, default=0.05, metavar="W", help=text)
    parser.set_defaults(levels="metadata")  # as the protocols of clips have it
    return parser


if __name__ == "__main__":  # workers import this file: the guard is needed
    sys.exit(main())
