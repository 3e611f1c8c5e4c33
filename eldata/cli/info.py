"""`eldata info`: datasets known: where to get them, size, licence, citation.

List the datasets that eldata knows, or all that is known about one: where to get it, size, licence, citation, known
defects, where its files belong and whether they are there. It looks at names, not at contents: eldata verify checks
those.

    eldata info
    eldata info eld --root data
    eldata info eld --croissant eld.croissant.json
"""

from __future__ import annotations

import sys
from functools import partial

from eldata.base import console
from eldata.base.files import write_json
from eldata.base.outputs import add_output
from eldata.errors import ArgumentError, EldataError


def add_options(parser: console.Parser) -> None:
    """Add its options."""
    parser.add_argument("dataset", metavar="DATASET", nargs="?", help="a dataset's name, such as eld")
    add_output(
        parser,
        "--croissant",
        nargs="?",
        const="",
        help="describe DATASET, or the set of a manifest's CSV file, in Croissant 1.1 (JSON-LD): in FILE, or printed",
    )
    console.add_shared(parser, run, "root", json=True)


def run(arguments: console.Arguments) -> int:
    """Run this command."""
    if arguments.croissant is not None:
        return _describe(arguments)
    from eldata.base.tables import text_table
    from eldata.download.overview import overview_of
    from eldata.manifest.catalogue import data_root, known_names

    found, problems = [], []
    for name in known_names() if arguments.dataset is None else (arguments.dataset,):
        try:
            found.append(overview_of(name, arguments.root))
        except EldataError as error:  # what another package registers must not keep the rest from being shown
            if arguments.dataset is not None:
                raise
            problems.append(str(error))

    def told() -> str:
        if arguments.dataset is not None:
            return found[0].format_text()
        header = ("name", "title", "files", "size", f"in {data_root(arguments.root)}", "licence")
        table = text_table(header, [one.row for one in found], left=(0, 1, 4, 5), columns=console.terminal_columns())
        return f"{table}\n\neldata info NAME shows one: addresses, citation, known defects"

    said = [partial(print, f"eldata info: {problem}", file=sys.stderr) for problem in problems]
    console.show_and_write(arguments, told, lambda: {"datasets": [one.as_dict() for one in found]}, *said)
    return console.PROBLEMS if problems else console.OK


def _describe(arguments: console.Arguments) -> int:
    """Print or write one set's card and manifest as Croissant."""
    from eldata.base.files import json_text
    from eldata.manifest.catalogue import carded_names, known_manifest, load_manifest, shipped_card, shipped_names
    from eldata.manifest.croissant import to_croissant

    name = arguments.dataset
    if name is None or arguments.json:
        raise ArgumentError(
            "--croissant describes one set, and is JSON already: eldata info eld --croissant eld.croissant.json"
        )
    if name in carded_names() and name not in shipped_names():
        described, table = to_croissant(shipped_card(name)), None
    else:
        manifest = load_manifest(name) if name.endswith(".csv") else known_manifest(name)
        described, table = to_croissant(manifest), manifest.path
    if not arguments.croissant:
        print(json_text(described), end="")
        return console.OK
    write_json(arguments.croissant, described)
    beside = f"; it reads {table.name}: put {table} beside it" if table is not None else ""
    print(f"{name} in Croissant: {arguments.croissant}{beside}")
    return console.OK
