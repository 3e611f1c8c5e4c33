"""`eldata protocols`: list evaluation protocols: what each fixes, and its source.

List the protocols under which images and clips are scored, or show all that one of them fixes: pairs, region, levels,
clips, rescaling, metrics, source and digest. A protocol of your own is a TOML file: see docs/evaluation.md.

    eldata protocols
    eldata protocols eld
    eldata protocols --dataset sid-sony
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base import console
from eldata.base.tables import text_table, wrapped

if TYPE_CHECKING:
    from eldata.protocols.protocol import Protocol

_DIGEST = "sha256:"


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata protocols`."""
    parser.add_argument(
        "protocol",
        metavar="NAME",
        nargs="*",
        help=(
            "show this one (also: show NAME); a family such as pmn shows its protocols; or a TOML file; or a digest "
            "such as sha256:092725f8"
        ),
    )
    parser.add_argument("--dataset", metavar="N", help="only those for this dataset")
    console.add_shared(parser, run, json=True)


def run(arguments: console.Arguments) -> int:
    """List the protocols, or show some (`eldata protocols`)."""
    from eldata.protocols.named import PROTOCOLS
    from eldata.protocols.words import HEADER, summary

    names = arguments.protocol[1:] if arguments.protocol[:1] == ["show"] else arguments.protocol
    chosen = _choose_protocols(names, arguments.dataset)

    def format_text() -> str:
        if names:
            return "\n\n".join(_format_protocol(protocol) for protocol in chosen)
        rows = [summary(protocol, PROTOCOLS["eld"]) for protocol in chosen]
        table = text_table(HEADER, rows, left=range(len(HEADER)))
        return (
            f"{table}\n\neld: full frame of packed raw, white 16383, one factor per image, SSIM 7x7\n"
            "eldata protocols NAME shows one: all that it fixes, its source and digest"
        )

    data = {"protocols": [protocol.as_dict() | {"digest": protocol.digest} for protocol in chosen]}
    console.show_and_write(arguments, format_text, lambda: data)
    return console.OK


def _choose_protocols(names: list[str], dataset: str | None) -> list[Protocol]:
    """Find protocols by name, family or digest, and keep those for a dataset."""
    from eldata.errors import ArgumentError, did_you_mean
    from eldata.manifest.catalogue import known_names
    from eldata.protocols.named import FAMILIES, PROTOCOLS, get_protocol, members_of, of_digest
    from eldata.protocols.protocol import ANY_DATASET

    chosen: list[Protocol] = []
    for name in names or PROTOCOLS:
        if name in FAMILIES:
            chosen += members_of(name)
        elif name.startswith(_DIGEST):
            chosen += of_digest(name)
        else:
            chosen.append(get_protocol(name))
    if dataset is not None:
        known = known_names()
        chosen = [protocol for protocol in chosen if protocol.covers(dataset)]
        of = {protocol.dataset for protocol in chosen} - {ANY_DATASET}
        if not of or dataset not in (*known, *of):
            raise ArgumentError(
                f"no protocol is for dataset {dataset!r}; eldata info lists the datasets{did_you_mean(dataset, known)}"
            )
    return chosen


def _format_protocol(protocol: Protocol) -> str:
    """List a protocol's rules, source and digest, a line each."""
    from eldata.protocols.words import described

    rows = [*described(protocol), ("source", protocol.source), ("digest", protocol.digest)]
    width = max(len(name) for name, _ in rows) + 2
    return "\n".join(line for name, text in rows for line in wrapped(f"{name:<{width}}{text}", " " * width))
