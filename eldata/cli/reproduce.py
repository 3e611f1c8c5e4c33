"""`eldata reproduce`: evaluate again as a saved result states, and say what differs.

Evaluate again as a result that eldata evaluate --json wrote states, on the data at hand: its protocol field by field,
its pairs, its task. Every value is held against the saved one to the last digit, and so is what the numbers depend on:
versions, manifest, protocol. Exit code 1 if a value differs.

    eldata reproduce results/ours.json --root data
    eldata reproduce paper.json --predictions preds/ours --root data --json again.json
"""

from __future__ import annotations

from eldata.base import console


def add_options(parser: console.Parser) -> None:
    """Add its options."""
    parser.add_argument("result", metavar="RESULT", help="JSON of eldata evaluate, with one protocol or several")
    parser.add_argument(
        "--predictions", metavar="FOLDER", help="where the predictions lie now (default: where they lay)"
    )
    parser.add_argument("--manifest", metavar="FILE", help="manifest of the set of your own that the result is of")
    parser.add_argument("--dark-shading", metavar="FILE", help="the dark shading that the result states, if any")
    parser.add_argument(
        "--task", metavar="MODULE:NAME", help="the task of the result, if it is not the function that the result names"
    )
    parser.add_argument("--store", metavar="FILE", help="take the dataset's frames from this store (eldata pack)")
    console.add_shared(parser, run, "root", "workers", json=True)


def run(arguments: console.Arguments) -> int:
    """Run this command."""
    from eldata.evaluation.reproduction import reproduce
    from eldata.evaluation.saved import load_results

    names = ("predictions", "root", "manifest", "dark_shading", "task", "store")
    with console.chosen_workers(arguments) as workers:
        given = console.chosen(arguments, names)
        found = [reproduce(result, **given, workers=workers) for result in load_results(arguments.result)]
    console.show_and_write(
        arguments,
        lambda: "\n\n".join(one.format_text() for one in found),
        lambda: {"results": [one.as_dict() for one in found]},
    )
    return console.OK if all(one.same for one in found) else console.PROBLEMS
