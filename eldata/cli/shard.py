"""`eldata shard`: write a store's pairs as tar shards, to be streamed from slow disks or over a network.

Write the pairs of a store as tar files of the WebDataset convention, shuffled over all of them, with an index that
StreamedPairs reads: the pixels in DN with levels, CFA, exposure and record, lossless. Work that was interrupted, even
by kill -9, goes on if the command is repeated. Copy the folder to where it is to be read from.

    eldata shard sid-train.h5 -o shards
"""

from __future__ import annotations

from eldata.base import console
from eldata.base.numbers import counted
from eldata.cli.baseline import add_part


def add_options(parser: console.Parser) -> None:
    """Add its options."""
    parser.add_argument("store", metavar="STORE", help="a store of pairs, from eldata pack")
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="a new folder")
    parser.add_argument(
        "--tile",
        type=_tile,
        default=512,
        metavar="N",
        help="side of the samples in packed pixels, or 'whole' for whole frames (default: %(default)s)",
    )
    for name, default, letter, text in (
        ("--overlap", 0, "N", "packed pixels that neighbouring samples share at least"),
        ("--samples-per-shard", 64, "N", "samples per file"),
        ("--seed", 0, "S", "of the order"),
    ):
        parser.add_argument(
            name, type=console.whole_number(0), default=default, metavar=letter, help=f"{text} (default: %(default)s)"
        )
    add_part(parser)
    kept = "the finished shards are kept in {output}, and the same command goes on"
    console.add_shared(parser, run, "cameras", interrupted=kept)


def run(arguments: console.Arguments) -> int:
    """Run this command."""
    from eldata.sources.shards.writing import write_shards

    report = write_shards(
        arguments.store,
        arguments.output,
        **console.chosen(arguments, ("tile", "overlap", "samples_per_shard", "seed", "cameras", "split", "subset")),
    )
    resumed = f" ({report.resumed} of them before)" if report.resumed else ""
    print(
        f"{counted(report.samples, 'sample')} in {counted(report.shards, 'shard')}{resumed}: {report.folder}, "
        f"{report.bytes / 1e6:.1f} MB; index.json came last"
    )
    return console.OK


def _tile(text: str) -> int | None:
    return None if text == "whole" else console.whole_number(0)(text)
