"""`eldata synthesize`: make noisy raw files from clean ones, with a manifest.

Make noisy exposures of folders of clean raw files, or of the references that a manifest lists, with a camera's
calibrated noise. OUT gets the clean and noisy frames, a manifest that eldata verify and the datasets read, and every
parameter drawn. Work that was interrupted, even by kill -9, goes on if the command is repeated.

    eldata synthesize data/SID/Sony/long -o noisy --camera SonyA7S2 --ratio 100:300 --seed 1
"""

from __future__ import annotations

import argparse
import shlex

from eldata.base import console
from eldata.cli.pack import REFERENCE_HELP

_RECIPE_OPTIONS = (
    *("ratio", "seed", "iso", "row", "extrapolate", "per_image", "clips", "split", "format"),
    "dark_frames",
)


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata synthesize`."""
    parser.add_argument("clean", metavar="CLEAN", nargs="+", help="folder of clean raw files, a manifest, or several")
    parser.add_argument("-o", "--output", metavar="OUT", required=True, help="a new folder")
    parser.add_argument("--reference", metavar="PATTERN", help=REFERENCE_HELP)
    parser.add_argument("--camera", metavar="NAME", required=True, help="a shipped profile (SonyA7S2) or a JSON file")
    text = "components of the noise (default: %(default)s)"
    parser.add_argument("--model", default="P*+G*+B+R+U", metavar="SPEC", help=text)
    text = (
        "of component D, as in 'P*+D': real dark frames at --iso, of the camera that took CLEAN, each used once "
        "before any is used twice; or eldata pack's store, or a manifest (.csv)"
    )
    parser.add_argument("--dark-frames", metavar="FOLDER|STORE", help=text)
    text = "low-light factors (default: 100:300)"
    parser.add_argument("--ratio", metavar="A:B", type=_read_ratio, default=(100.0, 300.0), help=text)
    text = "simulate this ISO, which noisy files then state, instead of drawing K"
    parser.add_argument("--iso", type=float, help=text)
    text = "take --iso beyond the range that the profile was calibrated over"
    parser.add_argument("--extrapolate", action="store_true", help=text)
    text = (
        "which rows lambda and colour bias come from: any, as in the paper, or those of the nearest gain, which "
        "--iso is best given with; measured: all figures as they were measured at --iso (default: any)"
    )
    parser.add_argument("--row", choices=("any", "nearest-gain", "measured"), default="any", help=text)
    text = "of noisy frames (default: %(default)s)"
    parser.add_argument("--format", choices=("dng", "npy"), default="dng", help=text)
    text = (
        "each folder of raws is a clip: draw parameters and ratio once for it, keep its frames together, and score "
        "it under the protocol sequences; --no-clips draws them for each frame. To be said where it is not certain"
    )
    parser.add_argument("--clips", action=argparse.BooleanOptionalAction, help=text)
    text = "shares of train and test, such as 95:5, drawn by --seed: whole clips, or else scenes (default: none)"
    parser.add_argument("--split", metavar="A:B", type=_read_split, help=text)
    parser.add_argument("--per-image", type=int, default=1, metavar="N", help="noisy frames per clean one (default: 1)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="default: %(default)s")
    kept = "{output} is an unfinished run: the finished frames are kept, and the same command goes on"
    console.add_shared(parser, run, "workers", interrupted=kept)


def _read_ratio(text: str) -> tuple[float, float]:
    """Read one exposure ratio, or the lowest and highest such as ``100:300``."""
    low, _, high = text.partition(":")
    try:
        return float(low), float(high or low)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number or two such as 100:300, found {text!r}") from None


def _read_split(text: str) -> tuple[float, float]:
    """Read two shares such as ``95:5``."""
    if ":" not in text:
        raise argparse.ArgumentTypeError(f"expected two shares such as 95:5, found {text!r}")
    return _read_ratio(text)


def run(arguments: console.Arguments) -> int:
    """Make noisy raw files from clean ones, with a manifest (`eldata synthesize`)."""
    from pathlib import Path

    from eldata.datasets.synthetic.synthesis import Recipe, synthesize
    from eldata.errors import ArgumentError
    from eldata.noise.components import parse_components
    from eldata.noise.profile import CameraProfile

    has_dark, dark_frames = "D" in parse_components(arguments.model), arguments.dark_frames
    if has_dark and dark_frames is None:
        raise ArgumentError(
            f"--model {arguments.model!r}: component D takes real dark frames; give --dark-frames FOLDER|STORE"
        )
    if dark_frames is not None and not has_dark:
        raise ArgumentError("--dark-frames is for component D; name it in --model, as in 'P*+D'")
    recipe = Recipe(CameraProfile.load(arguments.camera), arguments.model, **console.chosen(arguments, _RECIPE_OPTIONS))
    out = Path(arguments.output)
    with console.chosen_workers(arguments) as workers:
        clean = list(map(Path, arguments.clean))
        manifest = synthesize(clean, out, recipe, reference=arguments.reference, workers=workers)
    noisy = manifest.card.counts.get("noisy", 0)
    print(
        f"{noisy} noisy frames of {manifest.card.counts['reference']} clean ones: {out / 'data' / manifest.card.folder}"
    )
    print(f"manifest {manifest.path}, parameters {out / 'parameters.json'}")
    where = f"{shlex.quote(str(manifest.path))} --root {shlex.quote(str(out / 'data'))}"
    print(f"to check: eldata verify {where} --level metadata")
    return console.OK
