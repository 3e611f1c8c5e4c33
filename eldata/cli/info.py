"""`eldata info`: list datasets: where to get them, size, licence, citation.

List the datasets that eldata knows, or all that is known about one: where to get it, size, licence, citation, known
defects, where its files belong and whether they are there. It looks at names, not at contents: eldata verify checks
those.

    eldata info
    eldata info eld --root data
"""

from __future__ import annotations

import shutil
import sys
from functools import partial

from eldata.base import console
from eldata.errors import EldataError


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata info`."""
    parser.add_argument("dataset", metavar="DATASET", nargs="?", help="a dataset's name, such as eld, or its manifest")
    console.add_shared(parser, run, "root", json=True)


def run(arguments: console.Arguments) -> int:
    """List the datasets, or show one (`eldata info`)."""
    from eldata.base.tables import text_table
    from eldata.download.overview import overview_of
    from eldata.manifest.catalogue import data_root, known_names

    overviews, problems = [], []
    for name in known_names() if arguments.dataset is None else (arguments.dataset,):
        try:
            overviews.append(overview_of(name, arguments.root))
        except EldataError as error:  # what another package registers must not keep the rest from being shown
            if arguments.dataset is not None:
                raise
            problems.append(str(error))

    def format_text() -> str:
        if arguments.dataset is not None:
            return overviews[0].format_text()
        header = ("name", "files", "size", f"in {data_root(arguments.root)}", "title")
        lines = text_table(header, [overview.row for overview in overviews], left=(0, 3, 4)).splitlines()
        columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
        table = "\n".join(line[:columns] for line in lines)
        return f"{table}\n\neldata info NAME shows one: addresses, licence, citation, known defects"

    warnings = [partial(print, f"eldata info: {problem}", file=sys.stderr) for problem in problems]
    data = {"datasets": [overview.as_dict() for overview in overviews]}
    console.show_and_write(arguments, format_text, lambda: data, *warnings)
    return console.PROBLEMS if problems else console.OK
