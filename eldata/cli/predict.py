"""`eldata predict`: run a network over a dataset, in tiles.

Run a network over each noisy frame that a protocol scores, of photographs or of clips, and write the predictions that
eldata evaluate reads. The network takes (1, C, h, w) float32, packed, normalised and amplified, and returns the same
shape, or (1, 3, h, w) under a protocol of Raw2RGB; one of RGB2RGB takes and returns (1, 3, h, w) in sRGB; one of clips
takes a window (1, T, C, h, w) and returns its middle frame, and at a clip's ends the frames inside are mirrored.
Predictions that are there are kept, so that interrupted work goes on. A model, whatever its format, is a program that
runs with all your rights: give your own, or one that you trust as such.

    eldata predict model.pt --dataset eld --root data -o preds/mine
"""

from __future__ import annotations

from eldata.base import console
from eldata.cli.baseline import add_choice, chosen_options, show_report


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata predict`."""
    text = "TorchScript (.pt), torch.export (.pt2) or ONNX file, or package.module:name of a torch.nn.Module"
    parser.add_argument("model", metavar="MODEL", help=text)
    add_choice(parser)
    text = "state dict for package.module:name: safetensors, or a torch checkpoint"
    parser.add_argument("--weights", metavar="FILE", help=text)
    text = (
        "of the input, before and after it is amplified: as the protocol has it, or none, which keeps negative values "
        "of read noise; take what the network was trained with (default: what its file records, else protocol)"
    )
    parser.add_argument("--input-clip", choices=("protocol", "none", "upper", "both"), help=text)
    text = "frames of a clip that the network takes, an odd number (default: what the network states, else 1)"
    parser.add_argument("--window", type=console.whole_number(1), metavar="T", help=text)
    text = "packed pixels; 0: whole frames (default: 1024)"
    parser.add_argument("--tile", type=console.whole_number(0), default=1024, metavar="PX", help=text)
    text = "of tiles; four times the network's reach makes them equal to the whole frame (default: 128)"
    parser.add_argument("--overlap", type=console.whole_number(0), default=128, metavar="PX", help=text)
    text = "sides and places of tiles are multiples of it (default: what the network states, else 16)"
    parser.add_argument("--multiple", type=console.whole_number(1), metavar="M", help=text)
    text = "cpu, cuda, or auto (default: a GPU if there is one)"
    parser.add_argument("--device", default="auto", metavar="D", help=text)
    precisions = ("float32", "bfloat16", "float16")
    text = "mixed precision by torch's autocast (default: %(default)s)"
    parser.add_argument("--precision", choices=precisions, default="float32", help=text)
    kept = "{output} keeps the finished predictions, and the same command goes on"
    console.add_shared(parser, run, "root", interrupted=kept)


def run(arguments: console.Arguments) -> int:
    """Predict a set with a network (`eldata predict`)."""
    from eldata.baselines.networks import load_network
    from eldata.baselines.predicting import write_predictions

    names = ("weights", "device", "precision", "tile", "overlap", "multiple", "window")
    network = load_network(arguments.model, **console.chosen(arguments, names))
    clip = arguments.input_clip or network.clip or "protocol"
    options = chosen_options(arguments)
    report = write_predictions(network, arguments.dataset or "", arguments.output, clip=clip, **options)
    return show_report(report, arguments)
