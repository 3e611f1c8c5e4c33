"""The files of a set, written together: its table, its card, and its description in Croissant."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import encoded, json_text, write_text
from eldata.errors import ManifestError
from eldata.manifest.card import Card, card_text, load_card
from eldata.manifest.catalogue import Manifest, load_manifest
from eldata.manifest.croissant import to_croissant
from eldata.manifest.table import table_text

if TYPE_CHECKING:
    from collections.abc import Iterable

    from eldata.records import FrameRecord


def save_manifest(path: Path | str, card: Card, records: Iterable[FrameRecord]) -> Manifest:
    """Write a manifest's CSV file and, beside it, its card and its Croissant; return it as it loads.

    Each is written whole or not at all, and the CSV file last: where it is the new one, so are the others. A card that
    says the same stays as it is. A Croissant beside them (``mine.croissant.json`` beside ``mine.csv``) that describes
    the set as it was is written again, since it states the hash of the CSV file; a changed one is left alone.

    Raises
    ------
    ManifestError
        If rows and card contradict each other; nothing is written then.
    EldataError
        If a file cannot be written.
    """
    path = Path(path)
    table = table_text(path, records)
    manifest = load_manifest(path, (encoded(table), encoded(card_text(card))))
    described = path.with_suffix(".croissant.json")
    # It comes first: whatever interrupts this, the same call again finds it written or still of the set as it was.
    files = {described: json_text(to_croissant(manifest))} if _describes(described, path) else {}
    if _card_of(path) != card:
        files[path.with_suffix(".json")] = card_text(card)
    for file, text in (files | {path: table}).items():
        write_text(file, text)
    return manifest


def _card_of(path: Path) -> Card | None:
    with suppress(ManifestError):
        return load_card(path.with_suffix(".json"))
    return None


def _describes(described: Path, path: Path) -> bool:
    """Return whether a Croissant is what would be written of the set as it is."""
    with suppress(ManifestError, OSError):
        return described.read_bytes() == json_text(to_croissant(load_manifest(path))).encode()
    return False
