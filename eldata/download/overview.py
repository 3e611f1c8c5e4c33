"""The content of `eldata info`: the facts about a dataset, and how much of it is on the disk."""

from __future__ import annotations

import shlex
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.files import inside
from eldata.base.tables import wrapped
from eldata.download.archives import STAGING, size_text
from eldata.manifest.catalogue import carded_names, data_root, find_manifest, known_names, shipped_card, shipped_names
from eldata.manifest.patterns import is_pattern, matching

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from eldata.manifest.card import Card, Download
    from eldata.manifest.catalogue import Manifest
    from eldata.records import FrameRecord


@dataclass(frozen=True, slots=True)
class Presence:
    """How many of the manifest's rows have a file that is not empty.

    A row that stands for a whole clip (a pattern) counts as soon as one of its files is there; ``patterns`` is the
    number of such rows. ``unfinished``: there are such rows, and an unpacking ended early, so that more of their files
    may be missing.
    """

    files_listed: int
    files_present: int
    unfinished: bool
    patterns: int = 0

    @property
    def complete(self) -> bool:
        """Whether every listed file is there."""
        return self.files_present == self.files_listed > 0 and not self.unfinished

    @property
    def count_text(self) -> str:
        """The number of files, as far as it is known."""
        return f"{self.files_listed}{'+' if self.patterns else ''}"

    def __str__(self) -> str:
        if self.unfinished:
            return "unpacked in part"
        if not self.files_present:
            return "absent"
        counted = "rows" if self.patterns else "files"
        return "present" if self.complete else f"{self.files_present} of {self.files_listed} {counted}"


@dataclass(frozen=True, slots=True)
class Overview:
    """The facts about a dataset, and how much of it is on the disk below ``root``.

    A dataset whose files no public text lists has its ``card`` alone: no ``manifest`` and no ``presence``.
    """

    card: Card
    root: Path
    manifest: Manifest | None = None
    presence: Presence | None = None

    @property
    def folder(self) -> Path:
        """Where the dataset's files lie, or should."""
        return self.root / self.card.folder

    @property
    def verify_command(self) -> str:
        """The command that checks the files."""
        own = self.manifest is not None and self.card.name not in known_names()
        name = shlex.quote(str(self.manifest.path)) if own and self.manifest else self.card.name
        return f"eldata verify {name} --root {shlex.quote(str(self.root))} --level metadata"

    @property
    def download_command(self) -> str:
        """The command that says where to get the files."""
        return f"eldata download {self.card.name} --root {shlex.quote(str(self.root))}"

    @property
    def next_step(self) -> str:
        """The next step: get the files, check them, or list one's own."""
        if self.presence is None:
            return "list your copy: eldata manifest FOLDER -o mine.csv, or arrays by hand (docs/adding-a-dataset.md)"
        own = self.card.name not in known_names()
        return self.verify_command if self.presence.complete or own else self.download_command

    @property
    def row(self) -> tuple[str, ...]:
        """The dataset's line in the table of all: name, files, size, state, title."""
        card, there = self.card, self.presence
        files, state = ("not listed", "card alone") if there is None else (there.count_text, str(there))
        return card.name, files, _size(card), state, card.title

    def as_dict(self) -> dict[str, Any]:
        """Return the facts as plain JSON types; without a manifest, its facts are ``None``."""
        card, there = asdict(self.card), self.presence
        return card | {
            "manifest": self.manifest and str(self.manifest.path),
            "folder_on_disk": self.manifest and str(self.folder),
            "presence": there and asdict(there) | {"complete": there.complete},
            "verify": self.manifest and self.verify_command,
        }

    def format_text(self) -> str:
        """Return all facts as text."""
        card, listed = self.card, "card" if self.manifest is None else "manifest"
        lines = [f"{card.name}: {card.title} ({listed} version {card.version})", ""]
        lines += [*_list_facts(card), *self._list_files(), "", "where to get it", *format_downloads(card.downloads)]
        if card.subsets:
            lines += ["", "subsets (eldata evaluate --subset)"]
            noisy = (row for row in (self.manifest.records if self.manifest else ()) if row.role == "noisy")
            counted = "clips" if any(is_pattern(row.path) for row in noisy) else "pairs"
            for subset in card.subsets:
                size = "" if subset.pairs is None else f" ({subset.pairs} {counted})"
                lines += wrapped(f"    {subset.name}: {subset.title}{size}", " " * 8)
        return "\n".join([*lines, *_list_remarks(card), "", "next", f"    {self.next_step}"])

    def _list_files(self) -> list[str]:
        """Format lines on the dataset's files: number, folder and an example."""
        if self.manifest is None or self.presence is None:
            return ["files      eldata has no list of them, only this card"]
        counts = ", ".join(f"{count} {role}" for role, count in sorted(self.card.counts.items()))
        patterns = f" ({self.presence.patterns} of them stand for a folder of files)" if self.presence.patterns else ""
        return [
            f"files      {self.presence.count_text}: {counts}{patterns}",
            f"folder     {self.folder} ({self.presence})",
            f"such as    {self.folder / self.manifest.records[0].path}",
        ]


def _list_facts(card: Card) -> list[str]:
    """Format a card's facts as lines: licence, citation, cameras and others."""
    worded = {"cameras": ", ".join(card.cameras), "CFA": "bayer and xtrans" if card.cfa == "both" else card.cfa}
    names = ("licence", "citation", "homepage", "cameras", "CFA", "levels", "protocol", "contents")
    facts = [(name, worded[name] if name in worded else getattr(card, name)) for name in names]
    return [line for name, text in facts if text for line in wrapped(f"{name:<11}{text}", " " * 11)]


def _list_remarks(card: Card) -> list[str]:
    """Format a card's remarks as lists under headings: scoring, defects, unknowns, sources."""
    lines = []
    remarks = {"how it is scored": card.scored, "known defects": card.known_defects, "not known": card.unknown}
    for title, texts in (remarks | {"sources": card.sources}).items():
        lines += ["", title] * bool(texts)
        for text in texts:
            lines += wrapped(f"    - {text}", " " * 6)
    return lines


def _archive_size(download: Download) -> str:
    """Format an archive's size; a card may describe a size that is not known."""
    return download.about if download.size_bytes is None else size_text(download.size_bytes)


def _size(card: Card) -> str:
    """Return the size of the archives, as far as it is known."""
    sizes = {download.part: size for download in reversed(card.downloads) if (size := _archive_size(download))}
    parts = dict.fromkeys(download.part for download in card.downloads if download.part in sizes)
    named = [sizes[part] for part in parts if part] or [sizes[part] for part in parts]  # no mirrors beside them
    return " + ".join(named) or "not known"


def format_downloads(downloads: Iterable[Download]) -> list[str]:
    """Return lines that say where archives are available."""
    lines = []
    for download in downloads:
        how = "direct" if download.direct else "by hand, in a browser"
        part = f"part {download.part}" if download.part else ""
        facts = ", ".join(filter(None, (how, part, _archive_size(download))))
        lines += [f"    {download.address}", f"        {facts}{': ' if download.notes else ''}{download.notes}"]
    return lines or ["    see the homepage"]


def presence_of(folder: Path, records: Iterable[FrameRecord]) -> Presence:
    """Count the listed files that are in a folder, by names and sizes alone."""
    paths = [record.path for record in records]
    present = 0
    for path in paths:
        files = [inside(folder, file) for file in (matching(folder, path) if is_pattern(path) else (path,))]
        present += any(file.is_file() and file.stat().st_size > 0 for file in files)
    patterns = sum(map(is_pattern, paths))
    return Presence(len(paths), present, patterns > 0 and (folder / STAGING).exists(), patterns)


def overview(manifest: Manifest, root: Path | str | None = None) -> Overview:
    """Describe a dataset, and how much of it lies below ``root``."""
    presence = presence_of(manifest.folder(root), manifest.records)
    return Overview(manifest.card, data_root(root), manifest, presence)


def overview_of(name: str, root: Path | str | None = None) -> Overview:
    """Describe a dataset by its name.

    Raises
    ------
    ManifestError
        If the name is unknown; the message lists the known ones.
    """
    if name in carded_names() and name not in shipped_names():
        return Overview(shipped_card(name), data_root(root))
    return overview(find_manifest(name, root), root)
