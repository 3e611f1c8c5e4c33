"""`python -m eldata.examples.train_denoiser`: train the paper's U-Net and export it for `eldata predict`.

Train on clean frames with a camera's noise made on the fly, on real pairs, or on both; the defaults are those of the
paper's section 4.1.1. RUN gets checkpoint.pt, from which the same command goes on to the bit, and at the end model.pt2
and weights.pt; then the commands are shown that predict with it and score that. With --validate, the score is printed
in between.

    python -m eldata.examples.train_denoiser --clean data/SID/Sony/long --camera SonyA7S2
    python -m eldata.examples.train_denoiser --clean clean.h5 --camera SonyA7S2 --noise P+G --iso 800 1600 3200
    python -m eldata.examples.train_denoiser --pairs sid-train.h5 -o runs/paired --validate eld --root data
    python -m eldata.examples.train_denoiser --pairs sid-train.h5 --noise2noise --input-clip none
    python -m eldata.examples.train_denoiser --pairs sid-train.h5 --clean clean.h5 --camera SonyA7S2
    python -m eldata.examples.train_denoiser --pairs sid-train.h5 --task raw2rgb
    torchrun --nproc-per-node 4 -m eldata.examples.train_denoiser --pairs sid-train.h5 --device cuda

Stores are made by `eldata pack`, so that no crop decodes its file again. For a network of your own, copy the file and
put yours in the place of UNet, your loss in that of absolute_error: it gets (N, C, h, w) float32, packed, black 0,
white 1 as --levels has it, amplified by the ratio and clipped as --input-clip says, in training and in validation
alike; of rgb2rgb, (N, 3, h, w), that rendered in 8 bits.
"""

from __future__ import annotations

import math
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import distributed
from torch.utils.data import ConcatDataset, Dataset

from eldata import ELDDataset, PackedStore, SyntheticClips, SyntheticPairs
from eldata.base import console
from eldata.base.fields import named_object
from eldata.base.files import atomic_write
from eldata.baselines import Training, UNet, absolute_error, save_network, tiled
from eldata.datasets import CleanClips, CleanFrames, CleanSource, DarkFrames, Noise2Noise
from eldata.datasets.loading import describe, evaluation_loader, training_loader
from eldata.datasets.rgb import raw2rgb, rgb2rgb
from eldata.errors import ArgumentError
from eldata.integrations.protocol_scores import protocol_of_tensors, protocol_score
from eldata.manifest.catalogue import find_manifests
from eldata.noise import NoiseModel
from eldata.protocols import get_protocol

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping, Sequence

    from eldata.baselines.training import EpochReport
    from eldata.raw.levels import Clip


SAVE_EVERY = 500  # steps: a checkpoint inside of long epochs too


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    return console.run(parser(), None if argv is None else list(argv))


def run(options: argparse.Namespace) -> int:
    """Train, or go on with a training; print each epoch's loss and, if asked for, the protocol's score."""
    device = start_ranks(options.device)
    data = training_data(options)
    sample = next(iter(data))
    channels, made = sample["input"].shape[0], sample["target"].shape[0]
    network = UNet(made, inputs=channels, width=options.width, depth=options.depth, seed=options.seed)

    def score_epoch(report: EpochReport, steps: int) -> dict[str, float]:
        """Gather an epoch's speed and, when it is due, its validation scores."""
        is_due = options.validate and ((report.epoch + 1) % options.validate_every == 0 or report.step == steps)
        return {"items/s": report.items_per_s} | (validate(network, options, device) if is_due else {})

    train(options, device, data, network, absolute_error, {"depth": options.depth}, score_epoch)
    return save_and_show(options, network, channels, choose_set(options))


def train(
    options: argparse.Namespace,
    device: torch.device,
    data: Dataset[Any],
    network: torch.nn.Module,
    loss: Callable[..., torch.Tensor],
    settings: Mapping[str, str | int | float],
    more: Callable[[EpochReport, int], Mapping[str, float]],
) -> None:
    """Train a network, or go on with a training; print each epoch's loss, and ``more`` of the epoch and all steps."""
    options.output.mkdir(parents=True, exist_ok=True)
    loader = training_loader(data, options.batch_size, seed=options.seed, device=device, num_workers=options.workers)
    training = Training(
        network,
        loader,
        steps=options.epochs * len(loader),
        learning_rate=options.learning_rate,
        loss=loss,
        device=device,
        precision=options.precision,
        settings={
            "data": repr(getattr(data, "datasets", data)),
            "width": options.width,
            "seed": options.seed,
            **settings,
        },
    )
    checkpoint = options.output / "checkpoint.pt"
    if options.finish:
        return training.load(checkpoint, any_steps=True)
    is_first = not distributed.is_initialized() or distributed.get_rank() == 0
    if is_first:
        curve = open_curves(options.output)
        print(data, describe(loader), f"{sum(map(torch.numel, network.parameters())):,} parameters", sep="\n")
    try:
        for report in training.epochs(checkpoint, save_every=SAVE_EVERY):
            shown = {"loss": report.loss, **more(report, training.steps)}
            if is_first:
                print(report, *(f"{name} {shown[name]:.4f}" for name in ("psnr_db", "ssim") if name in shown), sep=", ")
                for name, value in shown.items():
                    curve(name, value, report.step)
    finally:
        if training.saved:
            there = f"{training.saved} of {training.steps} steps ({training.saved / len(loader):.4g} epochs) are saved"
            options.interrupted = f"{there} in {{output}}/checkpoint.pt, and the same command goes on from there; "
            options.interrupted += "with --finish it makes model.pt2 of them"


def save_and_show(options: argparse.Namespace, network: torch.nn.Module, channels: int, chosen: Sequence[str]) -> int:
    """Keep a trained network, and show the commands that predict with it and score that on the ``chosen`` set."""
    if not distributed.is_initialized() or distributed.get_rank() == 0:
        save_trained(network, options.output, channels, options.input_clip)
        show_next(options.output, *chosen)
    if distributed.is_initialized():
        distributed.destroy_process_group()
    return console.OK


# --- data -------------------------------------------------------------------------------------------------------------


def training_data(options: argparse.Namespace) -> Dataset[Any]:
    """Return real pairs, synthetic ones, or both."""
    if options.task != "raw2raw" and options.noise2noise:
        raise ArgumentError(f"--task {options.task} has clean targets: leave --noise2noise out")
    count = options.crops_per_frame
    crops = {"crop": options.crop, "seed": options.seed}
    crops |= {"crops": "grid"} if count is None else {"crops_per_frame": count}
    representation = {"clip": options.input_clip, "levels": options.levels, "augment": True}
    parts: list[Dataset[Any]] = []
    if options.pairs:
        pairs = PackedStore(options.pairs, **crops, **representation)
        parts.append(Noise2Noise(pairs) if options.noise2noise else pairs)
    if options.clean:
        parts.append(synthetic_pairs(options, crops))
    if not parts:
        raise ArgumentError("give --clean with --camera, --pairs, or both")
    parts = [as_task(part, options) for part in parts]
    return parts[0] if len(parts) == 1 else ConcatDataset(parts)


def as_task(pairs: Dataset[Any], options: argparse.Namespace) -> Dataset[Any]:
    """Convert pairs of packed raw to the task's: raw, or rendered with the protocol's response."""
    if options.task == "raw2raw":
        return pairs
    render = {"raw2rgb": raw2rgb, "rgb2rgb": rgb2rgb}[options.task]
    return render(pairs, response=get_protocol(scored_protocol(options)).curve)


def scored_protocol(options: argparse.Namespace) -> str:
    """Return the protocol that was asked for, or the task's own."""
    return options.protocol or ("eld" if options.task == "raw2raw" else f"eld-{options.task}")


def synthetic_pairs(options: argparse.Namespace, crops: dict[str, Any]) -> Dataset[Any]:
    """Return clean crops with noise made on the fly; for Noise2Noise, two noisy exposures of each."""
    if not options.camera:
        raise ArgumentError("--clean needs a camera's noise: --camera")
    source = CleanFrames(options.clean if len(options.clean) > 1 else options.clean[0], levels=options.levels)
    noise = {"model": make_noise(options), "ratio": tuple(options.ratio), "clip": options.input_clip}
    noise |= {"iso": options.iso, "range_dn": options.range_dn}
    if not options.noise2noise:
        return SyntheticPairs(source, options.camera, **crops, **noise)
    count = crops.pop("crops_per_frame", 1)
    windows = {"frames": 2, "windows_per_clip": count, "transform": as_two_exposures}
    return SyntheticClips(still_clips(source, 2), options.camera, **windows, **crops, **noise)


def make_noise(options: argparse.Namespace) -> Any:
    """Return the noise model of a spec, or a callable `package.module:name` of your own (docs/noise.md)."""
    if ":" in options.noise:
        return named_object(options.noise)
    return NoiseModel(
        options.noise,
        dark_frames=DarkFrames(options.dark_frames, levels=options.levels) if options.dark_frames else None,
    )


def still_clips(source: CleanSource, frames: int) -> CleanClips:
    """Make a clip of each clean frame: a window has exposures of one scene, each with noise of its own."""
    return CleanClips(Still(source, index, frames) for index in range(len(source)))


class Still:
    """One clean frame, several times."""

    def __init__(self, source: CleanSource, index: int, frames: int) -> None:
        self.source, self.index, self.frames = source, index, frames
        self.reads_parts = getattr(source, "reads_parts", False)

    def __len__(self) -> int:
        return self.frames

    def frame(self, _: int) -> Any:
        """Return the frame."""
        return self.source.frame(self.index)

    def __repr__(self) -> str:
        return f"Still({self.source!r})"


def as_two_exposures(sample: dict[str, Any]) -> dict[str, Any]:
    """Make a pair of a window of two frames: one is the input, the other the target."""
    first, second = sample["input"]
    return sample | {"input": first, "target": second}


# --- validation -------------------------------------------------------------------------------------------------------


def validate(network: UNet, options: argparse.Namespace, device: torch.device) -> dict[str, float]:
    """Return the protocol's PSNR and SSIM over the validation pairs: the numbers of `eldata evaluate`."""
    (manifest,) = find_manifests(options.validate, options.root)
    folder = manifest.folder(options.root)
    raw = ELDDataset(folder, manifest=manifest.path, clip=options.input_clip, levels=options.levels)
    pairs = as_task(raw, options)
    protocol, scores = protocol_of_tensors(scored_protocol(options)), []
    network.eval()  # torch's: batch statistics stand still

    def predict(image: Any) -> Any:
        """Denoise an image (C, h, w) by the network."""
        return network(torch.from_numpy(image)[None].to(device))[0].float().cpu().numpy()

    with torch.inference_mode():
        for batch in evaluation_loader(pairs, num_workers=options.workers):
            image = batch["input"][0].numpy()
            prediction = tiled(predict, image, tile=1024, overlap=128, multiple=network.multiple)
            scores.append(protocol_score(protocol, torch.from_numpy(prediction), batch["target"][0]))
    values = {"psnr_db": [score.psnr_db for score in scores], "ssim": [score.ssim for score in scores]}
    return {name: math.fsum(column) / len(scores) for name, column in values.items()}


def save_trained(network: Any, folder: Path, channels: int, clip: Clip) -> None:
    """Write a trained network for `eldata predict`, and its weights."""
    traits = {"multiple": network.multiple, "window": network.window}
    save_network(network, folder / "model.pt2", channels=channels, clip=clip, **traits)
    with atomic_write(folder / "weights.pt") as file:  # torch.load(..., weights_only=True)
        torch.save(network.state_dict(), file)


def choose_set(options: argparse.Namespace) -> list[str]:
    """Return the options that name the set to score on: the validation's, else ELD."""
    name = options.validate or "eld"
    chosen = ["--manifest" if Path(name).suffix == ".csv" else "--dataset", name]
    chosen += ["--root", options.root] if options.root else []
    is_named = options.protocol or options.task != "raw2raw"
    return [*chosen, "--protocol", scored_protocol(options)] if is_named else chosen


def show_next(folder: Path, *chosen: str) -> None:
    """Print the commands that predict with the network of a training's folder, and score that."""
    made = str(folder / "predictions")
    print("\nNext, to predict and score:")
    print("$", shlex.join(["eldata", "predict", str(folder / "model.pt2"), *chosen, "-o", made]))
    print("$", shlex.join(["eldata", "evaluate", made, *chosen]))


def open_curves(folder: Path) -> Callable[[str, float, int], object]:
    """Open TensorBoard's writer, if it is installed; return a function of a curve's name, value and step."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        print("TensorBoard is not installed, so no curves are written: pip install tensorboard")
        return lambda *_: None
    return SummaryWriter(folder / "tensorboard").add_scalar


# --- processes and options --------------------------------------------------------------------------------------------


def start_ranks(kind: str) -> torch.device:
    """Join the processes that torchrun started, if it did; each takes a GPU of its own."""
    is_cuda = kind == "cuda" or (kind == "auto" and torch.cuda.is_available())
    if "WORLD_SIZE" in os.environ:
        distributed.init_process_group("nccl" if is_cuda else "gloo")
    return torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0"))) if is_cuda else torch.device("cpu")


def parser() -> console.Parser:
    """Make the command line's parser."""
    parser, data = program(__doc__, run)
    data.add_argument("--clean", nargs="+", metavar="CLEAN", help="folders of clean raws, manifests, or packed stores")
    add_training_options(parser, data)
    data.add_argument("--pairs", metavar="STORE", help="a packed store of pairs")
    data.add_argument("--noise2noise", action="store_true", help="a second noisy frame instead of the clean one")
    text = "so many at random in an epoch (default: the paper's, each of a grid once)"
    data.add_argument("--crops-per-frame", type=int, metavar="N", help=text)
    text, tasks = "from what to what (default: %(default)s)", ("raw2raw", "raw2rgb", "rgb2rgb")
    data.add_argument("--task", choices=tasks, default="raw2raw", help=text)
    check = parser.add_argument_group("validation")
    check.add_argument("--validate", metavar="SET", help="eld, or the manifest (*.csv) of a set in its layout")
    check.add_argument("--root", metavar="R", help="folder that holds that set (default: $ELDATA_ROOT, else ./data)")
    text = "and at the end (default: %(default)s)"
    check.add_argument("--validate-every", type=int, default=10, metavar="EPOCHS", help=text)
    check.add_argument("--protocol", metavar="P", help="default: eld; of a task to sRGB eld-raw2rgb or eld-rgb2rgb")
    return parser


def program(
    documented: str, run: Callable[[argparse.Namespace], int]
) -> tuple[console.Parser, argparse._ArgumentGroup]:
    """Make a training's parser, its help from a docstring, and the group of its data options."""
    prog = documented.split("`")[1]
    parser = console.document(console.Parser(prog=prog, usage=f"{prog} [options]"), documented)
    text = "folder of this training (default: %(default)s); the same command goes on with it"
    parser.add_argument("-o", "--output", type=Path, default="run", metavar="RUN", help=text)
    interrupted = "nothing was saved; the same command begins again, or goes on with what {output} had before"
    parser.set_defaults(run=run, command=parser.prog, interrupted=interrupted, running=["debug"])
    return parser, parser.add_argument_group("data")


def add_training_options(parser: argparse.ArgumentParser, data: argparse._ArgumentGroup) -> argparse._ArgumentGroup:
    """Add the options of both trainings: noise, crops and training; return the group of the last."""
    default = "(default: %(default)s)"
    data.add_argument("--camera", nargs="+", metavar="NAME", help="whose noise is made: shipped profiles, or files")
    text = f"a spec, or package.module:name of yours {default}"
    data.add_argument("--noise", default="P*+G*+B+R+U", metavar="MODEL", help=text)
    text = "the noise's camera: white minus black, for --clean of others"
    data.add_argument("--range-dn", type=float, metavar="DN", help=text)
    data.add_argument("--dark-frames", metavar="STORE", help="packed bias frames, for the specs with D")
    data.add_argument("--iso", type=float, nargs="+", help="these alone, drawn alike (default: the gain is drawn)")
    text = "low-light factors, from A to B (default: 100 300)"
    data.add_argument("--ratio", type=float, nargs=2, default=(100.0, 300.0), metavar=("A", "B"), help=text)
    text = f"where the input is cut {default}"
    data.add_argument("--input-clip", choices=("both", "upper", "none"), default="both", help=text)
    text = f"white 16383, or the file's {default}"
    data.add_argument("--levels", choices=("published", "metadata"), default="published", help=text)
    data.add_argument("--crop", type=int, default=512, metavar="PX", help=f"side in packed pixels {default}")
    how = parser.add_argument_group("training")
    how.add_argument("--epochs", type=int, default=200, metavar="N", help=f"the schedule is scaled to them {default}")
    how.add_argument("--finish", action="store_true", help="train no further: make model.pt2 of what checkpoint.pt has")
    how.add_argument("--batch-size", type=int, default=1, metavar="N", help=f"per process {default}")
    how.add_argument("--learning-rate", type=float, default=1e-4, metavar="RATE", help=f"of Adam, at first {default}")
    how.add_argument("--width", type=int, default=32, metavar="N", help=f"channels of the first level {default}")
    how.add_argument("--depth", type=int, default=4, metavar="D", help=f"how often it halves the image {default}")
    text = f"of the steps {default}"
    how.add_argument("--precision", choices=("float32", "bfloat16", "float16"), default="float32", help=text)
    how.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help=f"where it trains {default}")
    how.add_argument("--workers", type=int, metavar="N", help="processes that load data (default: by CPUs and memory)")
    how.add_argument("--seed", type=int, default=0, metavar="S", help=f"of weights, order and noise {default}")
    return how


if __name__ == "__main__":  # workers import this file: the guard is needed
    sys.exit(main())
