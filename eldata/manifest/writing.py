"""The files of a set, written together: its table and its card."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import encoded, write_text
from eldata.errors import ManifestError
from eldata.manifest.card import Card, card_text, load_card
from eldata.manifest.catalogue import Manifest, load_manifest
from eldata.manifest.table import table_text

if TYPE_CHECKING:
    from collections.abc import Iterable

    from eldata.records import FrameRecord


def save_manifest(path: Path | str, card: Card, records: Iterable[FrameRecord]) -> Manifest:
    """Write a manifest's CSV file and, beside it, its card; return it as it loads.

    Each is written whole or not at all, and the CSV file last: where it is the new one, so is the card. A card that
    says the same stays as it is.

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
    if _card_of(path) != card:
        write_text(path.with_suffix(".json"), card_text(card))
    write_text(path, table)
    return manifest


def _card_of(path: Path) -> Card | None:
    with suppress(ManifestError):
        return load_card(path.with_suffix(".json"))
    return None
