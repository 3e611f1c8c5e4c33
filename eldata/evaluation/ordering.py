"""The order in which people read: a set's cameras as its paper lists them, scene 2 before scene 10."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from eldata.manifest.catalogue import shipped_manifest, shipped_names

if TYPE_CHECKING:
    from collections.abc import Iterable


def natural(text: str) -> tuple[tuple[int, int, str], ...]:
    """Return a key that sorts texts with the numbers in them as numbers: ``scene-2`` before ``scene-10``."""
    parts = re.split(r"([0-9]+)", text)
    return tuple((0, int(part), part) if index % 2 else (1, 0, part) for index, part in enumerate(parts) if part)


def cameras_in_order(cameras: Iterable[str], dataset: str) -> list[str]:
    """Return names of cameras once each: in the order of the card, and of its paper, of a set that comes with eldata.

    Others, and those of a set of the user's own, follow by their names.
    """
    known = list(shipped_manifest(dataset).card.cameras) if dataset in shipped_names() else []
    found = set(cameras)
    return [name for name in known if name in found] + sorted(found.difference(known), key=natural)
