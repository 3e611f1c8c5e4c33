"""`eldata download`: fetch a dataset, or unpack archives that you saved.

Say where a dataset is available, how large it is and under which licence; with --yes, fetch the archives that the
publisher lets programs fetch, resume after broken connections, check their structure and unpack them into the dataset's
folder. With --from, do the same with an archive that you saved by hand, or a file of SIDD's blocks. Nothing that is
there is fetched again or replaced.

    eldata download eld
    eldata download eld --root data --from ELD.7z

Exit codes: 0 the listed files are there; 1 some are missing or differ, and what to do was printed; 2 a download or an
archive failed. docs/downloads.md says more.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base import console

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.download.installing import Installed
    from eldata.download.overview import Overview, Presence
    from eldata.manifest.card import Download
    from eldata.manifest.catalogue import Manifest


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata download`."""
    parser.add_argument("dataset", metavar="DATASET", help="a dataset's name; eldata info lists them")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--yes", action="store_true", help="fetch: you have read the addresses, sizes and licence")
    text = "unpack this archive, saved by hand; may be repeated"
    source.add_argument("--from", action="append", default=[], type=Path, dest="archives", metavar="FILE", help=text)
    text = "only this archive of a dataset that comes in several; may be repeated"
    parser.add_argument("--part", action="append", default=[], dest="parts", metavar="NAME", help=text)
    kept = "what has arrived is kept, and the same command goes on from there"
    console.add_shared(parser, run, "root", json=True, interrupted=kept)


def run(arguments: console.Arguments) -> int:
    """Show the terms of a dataset, and fetch or unpack it (`eldata download`)."""
    from eldata.download.fetching import choose_parts
    from eldata.download.installing import unpack_dataset
    from eldata.download.overview import overview, presence_of
    from eldata.manifest.catalogue import known_manifest

    manifest = known_manifest(arguments.dataset)
    details = overview(manifest, arguments.root)
    downloads = manifest.card.downloads
    parts = choose_parts(downloads, arguments.parts) if arguments.yes or arguments.parts else ()
    wanted = [
        record for record in manifest.records if not arguments.parts or any(part.holds(record.path) for part in parts)
    ]
    installed: list[Installed] = []
    if arguments.archives:
        installed = [unpack_dataset(path, manifest, details.folder) for path in arguments.archives]
    elif not presence_of(details.folder, wanted).complete:
        print(_format_terms(details, parts or downloads))
        if arguments.yes:
            installed = _fetch_parts(manifest, details.root, parts)
    for archive in installed:
        print(archive.format_text())
    presence = presence_of(details.folder, wanted)
    differing = sum(len(archive.differing) for archive in installed)
    data = {
        "dataset": manifest.name,
        "folder": str(details.folder),
        "presence": asdict(presence) | {"complete": presence.complete},
        "archives": [archive.as_dict() for archive in installed],
    }
    console.show_and_write(arguments, lambda: _format_conclusion(details, presence, differing), lambda: data)
    return console.OK if presence.complete and not differing else console.PROBLEMS


def _format_terms(details: Overview, downloads: Sequence[Download]) -> str:
    """Describe licence, citation, downloads and the next commands of a dataset."""
    from eldata.download.overview import format_downloads

    card = details.card
    lines = [
        f"{card.name}: {card.title}",
        f"    licence: {card.licence}",
        f"    cite: {card.citation}",
        f"    homepage: {card.homepage}",
        "",
        *format_downloads(downloads),
        "",
        "Each download costs its publisher money: fetch an archive once, keep it, and copy it between your machines.",
    ]
    if any(download.direct for download in downloads):
        lines.append(f"To fetch what is marked direct: {details.download_command} --yes")
    lines.append(f"What is marked by hand, open in a browser and save; then: {details.download_command} --from FILE")
    return "\n".join(lines) + "\n"


def _fetch_parts(manifest: Manifest, root: Path, parts: Sequence[Download]) -> list[Installed]:
    """Download and unpack the parts that are not complete on disk."""
    from eldata.download.fetching import RangeDownloader, fetch_archive
    from eldata.download.installing import unpack_dataset
    from eldata.download.overview import presence_of

    installed = []
    for part in parts:
        listed = [record for record in manifest.records if part.holds(record.path)]
        folder = manifest.stated_folder(root)
        if not presence_of(folder, listed).complete:
            installed.append(unpack_dataset(fetch_archive(part, root, RangeDownloader()), manifest, folder))
    return installed


def _format_conclusion(details: Overview, presence: Presence, differing: int) -> str:
    """Say how many of the dataset's files are there, and what to do next."""
    name = details.card.name
    counted = "rows have files" if presence.patterns else "files are"
    if not presence.complete:
        unfinished = ", and an unpacking ended early: run it again" if presence.unfinished else ""
        return f"{name}: {presence.files_present} of {presence.files_listed} {counted} in {details.folder}{unfinished}"
    done = f"{name}: all {presence.files_listed} {counted} in {details.folder}"
    if differing:
        return f"{done}, but some differ from the archive; move those away and run this again, or check them"
    return f"{done}; check them: {details.verify_command}"
