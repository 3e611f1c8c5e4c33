"""`capture manifest`: match the camera's files to a plan, and make the dataset and its manifest.

Match raw files to the shots of a plan by ISO, exposure time and the order in which they were taken; name everything
missing, repeated, out of order or not in the plan; write the manifest (CSV) and its card (JSON). With --copy-to or
--link-to, place the files in the dataset's layout. Originals stay as they are.

    capture manifest plan.json card -o manifests/mine.csv --copy-to data/mine
    capture manifest night-2.json card -o manifests/mine.csv --copy-to data/mine --append

Where something had to be decided, you are asked; without a terminal the mapping is written to a file, to be looked at,
edited and passed back with --mapping.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from capture.cli.values import add_only
from capture.observed import ORDERS
from eldata.base.console import OK, PROBLEMS, add_shared
from eldata.base.files import write_json
from eldata.base.numbers import counted
from eldata.base.outputs import add_output
from eldata.base.visible import in_line
from eldata.base.workers import Workers
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from capture.manifest import Begun, Dataset
    from capture.matching import Match
    from capture.observed import Observed
    from capture.plan import Plan


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument("plan", metavar="PLAN", help="the plan (JSON) that was shot")
    parser.add_argument("files", metavar="FILES", nargs="+", help="the camera's raw files, or folders of them")
    add_output(
        parser,
        "-o",
        "--output",
        beside=[".json"],
        makes_folder=True,
        type=_table_name,
        required=True,
        help="the manifest, such as manifests/mine.csv",
    )
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--copy-to", metavar="DIR", help="copy the files to DIR/<camera>/scene-<n>/IMG_<nnnn>.<ext>")
    place.add_argument("--link-to", metavar="DIR", help="the same with hard links, which take no space")
    parser.add_argument("--mapping", metavar="FILE", help="use this mapping of files to shots (JSON)")
    add_only(parser)
    parser.add_argument(
        "--repeated",
        choices=("last", "first"),
        default="last",
        help="which of the frames of a shot that was taken several times in a row (default: %(default)s)",
    )
    parser.add_argument(
        "--order",
        choices=ORDERS,
        help="what to believe where the files' numbers contradict the camera's clock; without it, both readings are "
        "shown and nothing is written",
    )
    parser.add_argument("--allow-gaps", action="store_true", help="write the manifest even if shots are missing")
    parser.add_argument("--yes", action="store_true", help="accept what was decided, without asking")
    older = parser.add_mutually_exclusive_group()
    older.add_argument("--replace", action="store_true", help="replace an older manifest of this name")
    older.add_argument(
        "--append",
        action="store_true",
        help="join the set that this manifest lists: another card, night or camera; with --copy-to or --link-to",
    )
    add_shared(parser, run, "jobs", json=True)


def _table_name(text: str) -> str:
    if not text.endswith(".csv"):
        raise argparse.ArgumentTypeError(f"expected a name that ends in .csv, found {text!r}")
    return text


def run(arguments: argparse.Namespace) -> int:
    """Run this command."""
    from capture.mapping import aperture_remarks, explain_metering, load_mapping, mapping_as_dict
    from capture.matching import match, other_reading
    from capture.observed import observe, raw_files
    from capture.plan import Plan

    output = Path(arguments.output)
    place = arguments.copy_to or arguments.link_to
    plan = Plan.load(arguments.plan)
    if arguments.only:
        plan = plan.only(arguments.only)
    begun = _begun(arguments, output)
    wanted = plan if begun is None else begun.lacking(plan)
    files = raw_files(arguments.files, plan.camera.raw_extension, outside=None if place is None else Path(place))
    workers = Workers(arguments.jobs)
    observed = observe(files, plan.camera.models, workers)
    if begun is not None:
        observed = observed.without_copies(begun.records, workers)
        if wanted is None or not observed.frames:
            return _nothing_to_add(observed, output, complete=wanted is None)
        there = len(plan.shots) - len(wanted.shots)
        if there:
            print(f"{output}: has {there} of the plan's {len(plan.shots)} shots; the others are:\n")
    whole, plan = plan, wanted or plan
    if arguments.order == "numbers":
        if observed.numbered is None:
            raise ArgumentError(
                "--order numbers: the files' names are not one series of numbers, each once; use --order clock"
            )
        observed = observed.numbered
    other = None
    if arguments.mapping is None:
        found = explain_metering(plan, observed, match(plan, observed, repeated=arguments.repeated))
        if arguments.order is None:
            other = other_reading(plan, observed, found, repeated=arguments.repeated)
    else:
        found = load_mapping(arguments.mapping, plan, observed)
    found = replace(found, remarks=(*found.remarks, *aperture_remarks(plan, found.frames)))
    if other is not None:
        print("by the camera's clock:")
    print(format_match(plan, observed, found))
    if arguments.json:
        second = {} if other is None else {"by_numbers": mapping_as_dict(plan, observed, other)}
        write_json(arguments.json, mapping_as_dict(plan, observed, found) | second)
    if not found.frames:
        print("\nno file is a shot of this plan; nothing was written. Is it the right plan, with the right camera?")
        return PROBLEMS
    if other is not None:
        print(f"\nby the numbers of the files:\n{format_match(plan, observed, other)}")
        print("\nThe files' numbers contradict the camera's clock, and both readings are possible: was the clock put")
        print("back, or were the files renamed? No manifest was written. Choose with --order clock or --order numbers")
        return PROBLEMS
    if found.missing and not arguments.allow_gaps:
        print(
            f"\n{len(found.missing)} of {len(plan.shots)} shots have no file. Take them again, or accept the gaps with"
        )
        print("--allow-gaps; --only names the scenes to begin with.")
        return _leave_mapping(output, plan, observed, found, "--allow-gaps" if arguments.yes else "--allow-gaps --yes")
    if found.doubtful and arguments.mapping is None and not arguments.yes and not _confirmed():
        return _leave_mapping(output, plan, observed, found, "--yes")
    _write(whole, found, begun, output, arguments, workers)
    return OK


def _begun(arguments: argparse.Namespace, output: Path) -> Begun | None:
    """Return the set that the files are to join, if ``--append`` says so."""
    from capture.manifest import Begun

    if not arguments.append:
        return None
    place = arguments.copy_to or arguments.link_to
    if place is None:
        raise ArgumentError("--append goes with --copy-to DIR or --link-to DIR, the folder that holds the set's files")
    return Begun.load(output, Path(place).absolute())


def _nothing_to_add(observed: Observed, output: Path, *, complete: bool) -> int:
    """Say why no file joins the set: the files are there already, or the plan's shots are."""
    new = len(observed.frames)
    print(f"{output}: {len(observed.copies)} of the files given are in the set already, or copies; {new} are not")
    for problem in observed.unusable:
        print(f"    {in_line(str(problem))}")
    if new and complete:
        print("and every shot of the plan is. Another night's scenes need other names: capture plan --scenes 11-15")
    return PROBLEMS if new or observed.unusable else OK


def _confirmed() -> bool:
    """Ask on a terminal; elsewhere nobody can confirm."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        return False
    try:
        return input("\nuse this mapping? [y/N] ").strip().casefold() in ("y", "yes")
    except EOFError:
        return False


def _leave_mapping(output: Path, plan: Plan, observed: Observed, found: Match, accepting: str) -> int:
    """Write the mapping for a person to edit, unless one that may be edited is there.

    ``accepting`` are the options with which this command would take it as it is.
    """
    from capture.mapping import mapping_as_dict
    from eldata.base.files import json_text, write_text

    path = output.with_suffix(".mapping.json")
    text = json_text(mapping_as_dict(plan, observed, found), indent=1)
    if path.exists() and path.read_bytes() != text.encode():
        print(f"no manifest was written. {path} is there already, perhaps edited, and was left as it is:")
        print(f"use it with --mapping {path}, or delete it to get a new one")
        return PROBLEMS
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
    print(f"no manifest was written. The mapping is in {path}: look at it, edit it and pass it back with")
    print(f"--mapping {path}, or accept it as it is with {accepting}")
    return PROBLEMS


def _write(
    plan: Plan, found: Match, begun: Begun | None, output: Path, arguments: argparse.Namespace, workers: Workers
) -> None:
    from capture.manifest import card_of, in_place, into_layout, with_hashes
    from capture.placing import check_free, copy, link, make_folders
    from eldata.manifest.catalogue import refuse_others, save_manifest

    place = arguments.copy_to or arguments.link_to
    dataset = in_place(plan, found) if place is None else into_layout(plan, found, Path(place).absolute(), begun)
    dataset = with_hashes(dataset, workers)
    records = dataset.records
    name, folder = output.stem, dataset.folder.name
    card = card_of(plan, name, folder, records) if begun is None else begun.joined(plan, records)
    if not arguments.replace and begun is None:
        refuse_others(output, card, records, "--replace it")
    if place is not None:
        check_free(dataset.rows)
        make_folders(dataset.rows)
        work = copy if arguments.copy_to else link
        for _ in workers.run(work, dataset.rows, label="copying" if arguments.copy_to else "linking"):
            pass
    output.parent.mkdir(parents=True, exist_ok=True)
    save_manifest(output, card, records)
    print()
    for remark in dataset.remarks:
        print(remark)
    new = f", {len(dataset.rows)} of them new" if begun is not None else ""
    print(f"manifest: {output}, {len(records)} files below {dataset.folder}{new}")
    print(f"card: {output.with_suffix('.json')}; fill in its licence and homepage before you give the set to others")
    where = f"{shlex.quote(str(output))} --root {shlex.quote(str(dataset.folder.parent))}"
    print(f"check it with: eldata verify {where} --level full")
    _warn_of_unlisted(dataset, place)


def _warn_of_unlisted(dataset: Dataset, place: str | None) -> None:
    if place is not None:
        return
    from eldata.base.files import visible_below
    from eldata.raw.files import is_raw

    listed = {row.target.resolve() for row in dataset.rows}
    beside = [
        path
        for folder in sorted({path.parent for path in listed})
        for path in visible_below(folder, deep=False)
        if is_raw(path) and path.resolve() not in listed
    ]
    if beside:
        print(
            f"beside them: {counted(len(beside), 'other raw file')}, such as {in_line(beside[0].name)}, which eldata "
            "verify will name. --copy-to and --link-to make a folder without them"
        )


def format_match(plan: Plan, observed: Observed, found: Match) -> str:
    """Return what was matched, one line per scene, and everything that did not go as planned."""
    from capture.matching import blocks_of
    from eldata.base.tables import text_table

    rows = []
    for block in blocks_of(plan):
        frames = [found.frames.get((block.scene, shot.number)) for shot in block.shots]
        there = [frame for frame in frames if frame is not None]
        names = "-" if not there else f"{there[0].path.name} to {there[-1].path.name}"
        times = [frame.taken for frame in there if frame.taken is not None]
        when = "-" if not times else f"{min(times):%Y-%m-%d %H:%M:%S} to {max(times):%H:%M:%S}"
        rows.append((block.title, f"{len(there)} of {len(frames)}", names, when))
    lines = [text_table(("scene", "frames", "files", "taken"), rows, left=(0, 2, 3))]
    kinds = list(dict.fromkeys(remark.kind for remark in found.remarks))
    for kind in kinds:
        # A scene without any frame is one line, not sixteen.
        texts = list(dict.fromkeys(remark.text for remark in found.remarks if remark.kind == kind))
        lines.append(f"{kind}:")
        lines += [f"    {in_line(text)}" for text in texts]
    total = len(observed.frames) + len(observed.unusable) + len(observed.copies)
    lines.append(f"{len(found.frames)} of {len(plan.shots)} shots have a file; {total} files were given")
    return "\n".join(lines)
