"""Whether files are on the disk when they get their names: a rename that outlives a power cut, over nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def not_synced(fd: object) -> None:
    """Stand for ``os.fsync``: what it is for is a power cut, and no test makes one; files outlive a killed process.

    A disk takes 5 to 70 ms for each of the many thousand files of a run. :class:`OnDisk` sees that it is called.
    """


class OnDisk:
    """Notes which files and folders are synced, and of each that is renamed or linked how much of it was by then."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._named: dict[Path, int | None] = {}
        self._synced: dict[tuple[int, int], int] = {}
        sync = os.fsync

        def noted(descriptor: int) -> None:
            sync(descriptor)
            found = os.fstat(descriptor)
            self._synced[found.st_dev, found.st_ino] = found.st_size

        monkeypatch.setattr(os, "fsync", noted)
        for name in ("rename", "replace", "link"):
            monkeypatch.setattr(os, name, self._naming(getattr(os, name)))

    def _naming(self, call: Callable[..., None]) -> Callable[..., None]:
        def named(source: Any, target: Any, **options: Any) -> None:
            self._named[Path(target)] = self._of(source)
            call(source, target, **options)

        return named

    def _of(self, path: Path | str) -> int | None:
        found = os.stat(path)  # noqa: PTH116 # of what os.rename is given
        return self._synced.get((found.st_dev, found.st_ino))

    @property
    def named(self) -> dict[str, bool]:
        """Of each file that was renamed or linked and is there: whether it was all on the disk before that."""
        return {path.name: size == path.stat().st_size for path, size in self._named.items() if path.exists()}

    def has(self, path: Path) -> bool:
        """Whether all of a file, or a folder as it is, has been synced."""
        return self._of(path) == path.stat().st_size
