"""Manifests by file or by name: the table, its card and its digest together."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.errors import ManifestError
from eldata.manifest.card import Card, load_card, save_card
from eldata.manifest.patterns import is_pattern
from eldata.manifest.table import load_table, save_records

if TYPE_CHECKING:
    from collections.abc import Iterable

    from eldata.records import FrameRecord

ROOT_VARIABLE = "ELDATA_ROOT"


@dataclass(frozen=True, slots=True)
class Manifest:
    """A manifest as loaded: ``path`` of the CSV, its ``card``, its ``records`` by path, ``digest`` of the CSV."""

    path: Path
    card: Card
    records: tuple[FrameRecord, ...]
    digest: str

    @property
    def name(self) -> str:
        """The dataset's short name."""
        return self.card.name

    def folder(self, root: Path | str | None = None) -> Path:
        """Return the dataset's folder below a data root (see :func:`data_root`)."""
        return data_root(root) / self.card.folder


def data_root(root: Path | str | None = None) -> Path:
    """Return the folder that holds the datasets: ``root``, else ``$ELDATA_ROOT``, else ``./data``."""
    if root is not None:
        return Path(root)
    return Path(os.environ.get(ROOT_VARIABLE) or "data")


def load_manifest(path: Path | str, contents: tuple[bytes, bytes] | None = None) -> Manifest:
    """Load a manifest: ``<name>.csv`` and the card ``<name>.json`` beside it; or their ``contents``, if given.

    Raises
    ------
    ManifestError
        If either is malformed, a row's camera is not on the card, or the card expects another number of rows.
    """
    path = Path(path)
    rows, facts = contents or (None, None)
    records, digest = load_table(path, rows)
    card = load_card(path.with_suffix(".json"), facts)
    unknown = {record.camera for record in records} - card.cameras.keys()
    for record in records if unknown else ():
        if record.camera in unknown:
            raise ManifestError(
                f"{path}, {record.path}: camera {record.camera!r} is not on the card, which has "
                f"{', '.join(card.cameras)}"
            )
    found = Counter(record.role for record in records)
    if dict(found) != card.counts:
        cut_off = (
            "; was eldata lock killed here? lock again" if any(is_pattern(record.path) for record in records) else ""
        )
        raise ManifestError(f"{path}: the card expects {card.counts} rows per role, found {dict(found)}{cut_off}")
    return Manifest(path, card, records, digest)


def save_manifest(path: Path | str, card: Card, records: Iterable[FrameRecord]) -> Manifest:
    """Write a manifest's CSV file and, beside it, its card, each whole or not at all; return it as it loads.

    Raises
    ------
    ManifestError
        If rows and card contradict each other.
    EldataError
        If a file cannot be written.
    """
    path = Path(path)
    save_card(path.with_suffix(".json"), card)
    save_records(path, records)
    return load_manifest(path)


def shipped_folder() -> Path:
    """Return the folder of the manifests that come with the package."""
    installed = Path(__file__).parent / "shipped"  # a wheel has them here (pyproject.toml)
    return installed if installed.is_dir() else Path(__file__).parents[2] / "manifests"


def shipped_names() -> tuple[str, ...]:
    """Return the names of the shipped manifests."""
    return tuple(sorted(path.stem for path in shipped_folder().glob("*.csv")))


def carded_names() -> tuple[str, ...]:
    """Return the names of the sets with a shipped card: those of the manifests, and some whose files no text lists."""
    return tuple(sorted(path.stem for path in shipped_folder().glob("*.json")))


def shipped_card(name: str) -> Card:
    """Load a shipped card by its dataset's name.

    Raises
    ------
    ManifestError
        If the name is unknown; the message lists the known ones.
    """
    if name not in carded_names():
        raise ManifestError(f"no dataset is called {name!r}; known are {', '.join(carded_names())}")
    return load_card(shipped_folder() / f"{name}.json")


def shipped_manifest(name: str) -> Manifest:
    """Load a shipped manifest by its dataset's name.

    Raises
    ------
    ManifestError
        If the name is unknown; the message lists the known ones. If the set has a card alone, the message says so.
    """
    if name in carded_names() and name not in shipped_names():
        raise ManifestError(
            f"eldata knows {name!r} by its card alone, since no public text lists its files: eldata info {name} says "
            "what is known; list your copy in a manifest of your own (docs/adding-a-dataset.md)"
        )
    if name not in shipped_names():
        parts = [one for one in shipped_names() if name and one.startswith(f"{name}-")]
        meant = f"it is {' and '.join(parts)}: name one" if parts else f"known are {', '.join(shipped_names())}"
        raise ManifestError(f"no dataset is called {name!r}; {meant}")
    return load_manifest(shipped_folder() / f"{name}.csv")


def find_manifests(path: Path | str) -> tuple[Manifest, ...]:
    """Load one manifest (a CSV file) or all of a folder.

    Raises
    ------
    ManifestError
        If there is none, or one is malformed.
    """
    path = Path(path)
    if path.is_dir():
        found = sorted(path.glob("*.csv"))
        if not found:
            raise ManifestError(f"{path}: holds no manifest (*.csv)")
        return tuple(load_manifest(file) for file in found)
    return (load_manifest(path),)
