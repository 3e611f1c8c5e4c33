"""What tests of all rooms share: folders that a run makes once, whichever process asks first, and nobody may change."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import pytest
from filelock import FileLock

T = TypeVar("T")


def there(value: T | None) -> T:
    """Assert that a value is not None, and pass it on."""
    assert value is not None
    return value


@contextmanager
def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Iterator[Path]:
    """Give the run's folder ``name``, which ``make`` fills in the first process that asks; fail if a test changes it.

    ``make`` is handed a folder that does not exist yet. What it returns is dropped: other processes see the files only.
    """
    base = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent  # that of the run; a worker has a folder of its own in it
    folder, made = base / f"shared-{name}", base / f"shared-{name}.made"
    with FileLock(base / f"shared-{name}.lock"):
        if not made.exists():
            make(folder)
            made.touch()
    before = _listing(folder)
    yield folder
    changed = sorted({path for path, _, _ in before ^ _listing(folder)})
    if changed:
        pytest.fail(f"a test changed {folder}, which is shared: {', '.join(changed[:5])}; let it change a copy")


def _listing(folder: Path) -> set[tuple[str, int, int]]:
    """Path, size and time of change of each file."""
    files = ((path, path.stat()) for path in folder.rglob("*") if path.is_file())
    return {(path.relative_to(folder).as_posix(), stat.st_size, stat.st_mtime_ns) for path, stat in files}
