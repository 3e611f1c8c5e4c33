"""What does harm where pickles are run."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class Bait:
    """A pickle that makes a folder when it is loaded."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.mkdir, (self.marker,)
