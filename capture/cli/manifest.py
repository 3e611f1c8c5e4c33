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
from typing import TYPE_CHECKING, Any

from capture.cli.values import add_plan, load_plan
from eldata.base.console import OK, PROBLEMS, add_output, add_shared
from eldata.base.files import json_text, write_json, write_text
from eldata.base.visible import in_line
from eldata.base.workers import Workers
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from capture.manifest import ExistingSet
    from capture.matching import Match
    from capture.observed import Observed
    from capture.plan import Plan


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `capture manifest`."""
    add_plan(parser)
    parser.add_argument("files", metavar="FILES", nargs="+", help="the camera's raw files, or folders of them")
    table: dict[str, Any] = {"type": _read_table_name, "help": "the manifest, such as manifests/mine.csv"}
    add_output(parser, "-o", "--output", beside=[".json"], makes_folder=True, required=True, **table)
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--copy-to", metavar="DIR", help="copy the files to DIR/<camera>/scene-<n>/IMG_<nnnn>.<ext>")
    place.add_argument("--link-to", metavar="DIR", help="the same with hard links, which take no space")
    parser.add_argument("--mapping", metavar="FILE", help="use this mapping of files to shots (JSON)")
    repeated = "which of the frames of a shot that was taken several times in a row (default: %(default)s)"
    parser.add_argument("--repeated", choices=("last", "first"), default="last", help=repeated)
    parser.add_argument("--allow-gaps", action="store_true", help="write the manifest even if shots are missing")
    parser.add_argument("--yes", action="store_true", help="accept what was decided, without asking")
    older = parser.add_mutually_exclusive_group()
    older.add_argument("--replace", action="store_true", help="replace an older manifest of this name")
    joins = "join the set that this manifest lists: another card, night or camera; with --copy-to or --link-to"
    older.add_argument("--append", action="store_true", help=joins)
    add_shared(parser, run, "jobs", json=True)


def _read_table_name(text: str) -> str:
    """Read a name that ends in ``.csv``."""
    if not text.endswith(".csv"):
        raise argparse.ArgumentTypeError(f"expected a name that ends in .csv, found {text!r}")
    return text


def run(arguments: argparse.Namespace) -> int:
    """Match files to a plan, and write the dataset and its manifest (`capture manifest`)."""
    from capture.mapping import compare_apertures, explain_metering, load_mapping, mapping_as_dict
    from capture.matching import match
    from capture.observed import find_raw_files, observe

    output, place = Path(arguments.output), arguments.copy_to or arguments.link_to
    plan = load_plan(arguments)
    existing = _load_existing(arguments)
    lacking = plan if existing is None else existing.lacking(plan)
    files = find_raw_files(arguments.files, plan.camera.raw_extension, outside=None if place is None else Path(place))
    workers = Workers(arguments.jobs)
    observed = observe(files, plan.camera.models, workers)
    if existing is not None:
        observed = observed.without_copies(existing.records, workers)
        if lacking is None or not observed.frames:
            return _explain_no_addition(observed, output, complete=lacking is None)
        there = len(plan.shots) - len(lacking.shots)
        if there:
            print(f"{output}: has {there} of the plan's {len(plan.shots)} shots; the others are:\n")
    part = lacking or plan
    if arguments.mapping is not None:
        matched = load_mapping(arguments.mapping, part, observed)
    else:
        matched = explain_metering(part, observed, match(part, observed, repeated=arguments.repeated))
    matched = replace(matched, remarks=(*matched.remarks, *compare_apertures(part, matched.frames)))
    print(format_match(part, observed, matched))
    if arguments.json:
        write_json(arguments.json, mapping_as_dict(part, observed, matched))
    if not matched.frames:
        print("\nno file is a shot of this plan; nothing was written. Is it the right plan, with the right camera?")
        return PROBLEMS
    if matched.missing and not arguments.allow_gaps:
        print(f"\n{len(matched.missing)} of {len(part.shots)} shots have no file. Take them again, or accept the gaps")
        print("with --allow-gaps; --only names the scenes to begin with.")
        accepting = "--allow-gaps" if arguments.yes else "--allow-gaps --yes"
        return _write_mapping(output, mapping_as_dict(part, observed, matched), accepting)
    if matched.doubtful and arguments.mapping is None and not arguments.yes and not _confirm():
        return _write_mapping(output, mapping_as_dict(part, observed, matched), "--yes")
    _write_set(plan, matched, existing, arguments, workers)
    return OK


def _load_existing(arguments: argparse.Namespace) -> ExistingSet | None:
    """Load the set that the files are to join, if ``--append`` says so."""
    from capture.manifest import ExistingSet

    if not arguments.append:
        return None
    place = arguments.copy_to or arguments.link_to
    if place is None:
        raise ArgumentError("--append goes with --copy-to DIR or --link-to DIR, the folder that holds the set's files")
    return ExistingSet.load(Path(arguments.output), Path(place).absolute())


def _explain_no_addition(observed: Observed, output: Path, *, complete: bool) -> int:
    """Say why no file joins the set: the files are there already, or the plan's shots are."""
    new = len(observed.frames)
    print(f"{output}: {len(observed.copies)} of the files given are in the set already, or copies; {new} are not")
    for problem in observed.unusable:
        print(f"    {in_line(str(problem))}")
    if new and complete:
        print("and every shot of the plan is. Another night's scenes need other names: capture plan --scenes 11-15")
    return PROBLEMS if new or observed.unusable else OK


def _confirm() -> bool:
    """Ask on a terminal; elsewhere nobody can confirm."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        return False
    try:
        return input("\nuse this mapping? [y/N] ").strip().casefold() in ("y", "yes")
    except EOFError:
        return False


def _write_mapping(output: Path, mapping: dict[str, Any], accepting: str) -> int:
    """Write the mapping for a person to edit, unless one that may be edited is there.

    ``accepting`` are the options with which this command would take it as it is.
    """
    path = output.with_suffix(".mapping.json")
    text = json_text(mapping, indent=1)
    if path.exists() and path.read_bytes() != text.encode():
        print(f"no manifest was written. {path} is there already, perhaps edited, and was left as it is:")
        print(f"use it with --mapping {path}, or delete it to get a new one")
        return PROBLEMS
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
    print(f"no manifest was written. The mapping is in {path}: look at it, edit it and pass it back with")
    print(f"--mapping {path}, or accept it as it is with {accepting}")
    return PROBLEMS


def _write_set(
    plan: Plan, matched: Match, existing: ExistingSet | None, arguments: argparse.Namespace, workers: Workers
) -> None:
    """Place the matched files, write manifest and card, and print the next command."""
    from capture.manifest import make_card, make_dataset, place_files
    from eldata.manifest.catalogue import refuse_others, save_manifest

    output, place = Path(arguments.output), arguments.copy_to or arguments.link_to
    dataset = make_dataset(plan, matched, None if place is None else Path(place).absolute(), existing, workers)
    records = dataset.records
    if existing is not None:
        card = existing.join(plan, records)
    else:
        card = make_card(plan, output.stem, dataset.folder.name, records)
        if not arguments.replace:
            refuse_others(output, card, records, "--replace it")
    if place is not None:
        place_files(dataset.rows, "copy" if arguments.copy_to else "link", workers)
    output.parent.mkdir(parents=True, exist_ok=True)
    save_manifest(output, card, records)
    print("", *dataset.remarks, sep="\n")
    new = f", {len(dataset.rows)} of them new" if existing is not None else ""
    print(f"manifest: {output}, {len(records)} files below {dataset.folder}{new}")
    print(f"card: {output.with_suffix('.json')}; fill in its licence and homepage before you give the set to others")
    where = f"{shlex.quote(str(output))} --root {shlex.quote(str(dataset.folder.parent))}"
    print(f"check it with: eldata verify {where} --level full")


def format_match(plan: Plan, observed: Observed, matched: Match) -> str:
    """Format a match: one line per scene, and everything that did not go as planned."""
    from capture.matching import list_blocks
    from eldata.base.tables import text_table

    rows = []
    for block in list_blocks(plan):
        frames = [matched.frames.get((block.scene, shot.number)) for shot in block.shots]
        there = [frame for frame in frames if frame is not None]
        names = "-" if not there else f"{there[0].path.name} to {there[-1].path.name}"
        times = [frame.taken for frame in there if frame.taken is not None]
        when = "-" if not times else f"{min(times):%Y-%m-%d %H:%M:%S} to {max(times):%H:%M:%S}"
        rows.append((block.title, f"{len(there)} of {len(frames)}", names, when))
    lines = [text_table(("scene", "frames", "files", "taken"), rows, left=(0, 2, 3))]
    kinds = list(dict.fromkeys(remark.kind for remark in matched.remarks))
    for kind in kinds:
        # A scene without any frame is one line, not sixteen.
        texts = list(dict.fromkeys(remark.text for remark in matched.remarks if remark.kind == kind))
        lines.append(f"{kind}:")
        lines += [f"    {in_line(text)}" for text in texts]
    total = len(observed.frames) + len(observed.unusable) + len(observed.copies)
    lines.append(f"{len(matched.frames)} of {len(plan.shots)} shots have a file; {total} files were given")
    return "\n".join(lines)
