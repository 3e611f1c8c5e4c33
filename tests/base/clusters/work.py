"""Units of work that a test holds, lets go, or has die: importable where workers run."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eldata.base.workers import require_files
from eldata.errors import RawFileError
from tests.waiting import until


@dataclass(frozen=True, slots=True)
class Task:
    """A number in a file's clothes."""

    number: int
    path: str = ""


def double(number: int) -> int:
    return 2 * number


def fail_at_threes(number: int) -> int:
    if number % 3 == 0:
        raise RawFileError(Path(f"{number}.dng"), "is not whole")
    return number


def fail_in_the_program(number: int) -> int:
    return number // (number - 2)


class UnpicklableError(Exception):
    """Cannot be made again from its arguments, as some libraries' errors cannot."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


def fail_oddly(number: int) -> int:
    raise UnpicklableError(number, number)


def look_at(path: Path) -> int:
    require_files(path)
    return path.stat().st_size


def end_the_process(task: Task) -> int:
    """Die whenever it is run; the other tasks are well."""
    if task.number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return task.number


def held(folder: Path, call: Callable[[], Any]) -> Any:
    """Say where this runs, then wait until the test makes the file ``go``."""
    (folder / f"in-{os.getpid()}").touch()
    until((folder / "go").exists, "the test's word to go on")
    return call()
