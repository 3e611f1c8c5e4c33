"""The files of a set, written together: its table and its card."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import atomic_write, encoded
from eldata.errors import ArgumentError, ManifestError
from eldata.manifest.card import Card, card_text, load_card
from eldata.manifest.catalogue import Manifest, load_manifest
from eldata.manifest.table import table_text

if TYPE_CHECKING:
    from collections.abc import Iterable

    from eldata.records import FrameRecord


def save_manifest(path: Path | str, card: Card, records: Iterable[FrameRecord]) -> Manifest:
    """Write a manifest's CSV file and, beside it, its card; return it as it loads.

    Both are on the disk under temporary names before either is renamed, the CSV file last: where it is the new one, so
    is the card. A card that says the same stays as it is.

    Raises
    ------
    ManifestError
        If rows and card contradict each other; nothing is written then.
    EldataError
        If a file cannot be written.
    """
    path = Path(path)
    table, facts = encoded(table_text(path, records)), encoded(card_text(card))
    manifest = load_manifest(path, (table, facts))
    with atomic_write(path) as rows:
        rows.write(table)
        rows.flush()
        os.fsync(rows.fileno())
        if _card_of(path) != card:
            with atomic_write(path.with_suffix(".json")) as file:
                file.write(facts)
    return manifest


def refuse_others(path: Path, card: Card, records: Iterable[FrameRecord], advice: str) -> None:
    """Refuse to replace a CSV file or card that says something else: people fill in the card.

    What says the same may be there: the same command wrote it before, or one that ended between the two files.

    Raises
    ------
    ArgumentError
        If so, with what to do instead.
    """
    same = {path: path.is_file() and path.read_bytes() == encoded(table_text(path, records))}
    same[path.with_suffix(".json")] = _card_of(path) == card
    for file, is_same in same.items():
        if file.exists() and not is_same:
            raise ArgumentError(f"{file} is there already, with other content: give another name, or {advice}")


def _card_of(path: Path) -> Card | None:
    with suppress(ManifestError):
        return load_card(path.with_suffix(".json"))
    return None
