"""The process that reads: ``python -m tests.fuzz.child``, started by ``running.py``, which survives it.

It answers with one line of JSON per trial, on what was its standard output: the decoders write to the terminal.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import json
import os
import resource
import shutil
import signal
import sys
import traceback
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from tests.fuzz.outcomes import READ, REFUSED, Outcome, of_error
from tests.fuzz.targets import KINDS
from tests.fuzz.trials import Trial, load_seeds, put, trial

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.fuzz.seeds import Seed

READY = b"ready"
DEFECT = "the harness itself failed"
_ABOVE_LIMIT = 4 << 30
# What archives with names such as ../../outside must not make.
_OUTSIDE = (Path("/etc/outside"), Path("/outside"))


@dataclass(frozen=True)
class Task:
    """What a child process is told, as JSON in its one argument.

    ``work`` is a folder of its own; ``last`` is the number after its last trial.
    """

    kind: str
    seed: int
    first: int
    last: int
    seeds: str
    work: str
    failures: str
    most_bytes: int


def main(argument: str) -> None:
    """Run trials and answer."""
    task = Task(**json.loads(argument))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    _be_silent(Path(task.work))
    _end_with_parent()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    seeds = load_seeds(Path(task.seeds))
    _warm_up(task, seeds)
    used = _status("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (used + task.most_bytes + _ABOVE_LIMIT,) * 2)
    answers.write(READY.decode() + "\n")
    answers.flush()
    for number in range(task.first, task.last):
        answers.write(json.dumps(_run(task, seeds, number)) + "\n")
        answers.flush()


def _be_silent(work: Path) -> None:
    """What decoders print goes nowhere; what Python says as it dies goes into a file."""
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)
    faulthandler.enable(_dump(work))
    warnings.simplefilter("ignore")


def _end_with_parent() -> None:
    """Nothing that hangs may outlive a run that was killed (prctl(2), PR_SET_PDEATHSIG)."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)


@cache
def _dump(work: Path) -> IO[str]:
    return (work / "dump.txt").open("w", encoding="utf-8")  # open for as long as the process lives


def folder_of(work: Path) -> Path:
    """Where a trial's file lies: deep enough for ``../..`` to stay in the child's own folder."""
    return work / "a" / "b" / "c"


def _warm_up(task: Task, seeds: list[Seed]) -> None:
    """Read the good files: what loads lazily is loaded, and its memory is not any trial's."""
    for seed in {seed.reader: seed for seed in seeds}.values() if task.kind != "drill" else ():
        folder = _empty(Path(task.work))
        (folder / seed.name).write_bytes(seed.content)
        with contextlib.suppress(Exception):  # some are files that are refused whole
            KINDS[task.kind].readers[seed.reader](folder / seed.name)


def _empty(work: Path) -> Path:
    folder = folder_of(work)
    shutil.rmtree(work / "a", ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _run(task: Task, seeds: list[Seed], number: int) -> dict[str, Any]:
    """Run one trial and say what came of it."""
    made = trial(task.kind, seeds, task.seed, number)
    work = Path(task.work)
    folder = _empty(work)
    path = folder / f"input{Path(made.seed.name).suffix}"
    (work / "trial.json").write_text(json.dumps(description(task, number, made)), encoding="utf-8")
    put(made, path)
    _forget_peak()
    before, started = _status("VmRSS"), resource.getrusage(resource.RUSAGE_SELF)
    outcome = outcome_of(task, made, path)
    used = resource.getrusage(resource.RUSAGE_SELF)
    peak = max(0, _status("VmHWM") - before)
    if peak > task.most_bytes:
        outcome = Outcome("memory", f"took it, then {outcome.word} {outcome.sort}".strip(), outcome.text)
    if outside(work) and outcome.word in (READ, REFUSED):
        outcome = Outcome("escaped", ", ".join(outside(work)))
    if outcome.word not in (READ, REFUSED):
        keep(Path(task.failures), work, outcome, number)
    seconds = used.ru_utime + used.ru_stime - started.ru_utime - started.ru_stime
    return {"number": number, "word": outcome.word, "sort": outcome.sort, "peak": peak, "seconds": seconds}


def outcome_of(task: Task, made: Trial, path: Path) -> Outcome:
    kind = KINDS[task.kind]
    reader = made.seed.reader
    try:
        result = kind.readers[reader](path)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # noqa: BLE001 # what any of it is, is what is asked
        return of_error(error, path.parent, names_file=reader not in kind.nameless)
    if made.detectable and kind.truth is not None:
        truth, found = _truth(task.kind, task.work, made.seed), kind.truth(result)
        if truth.shape != found.shape or not np.array_equal(truth, found):
            return Outcome("silent", f"{made.changes[0]} in {made.seed.name}", f"{int((truth != found).sum())} pixels")
    return Outcome(READ)


_TRUTHS: dict[str, NDArray[Any]] = {}


def _truth(kind: str, work: str, seed: Seed) -> NDArray[Any]:
    if seed.name not in _TRUTHS:
        path = Path(work) / f"whole{Path(seed.name).suffix}"
        path.write_bytes(seed.content)
        truth = KINDS[kind].truth
        if truth is None:
            raise TypeError(kind)
        _TRUTHS[seed.name] = truth(KINDS[kind].readers[seed.reader](path))
        path.unlink()
    return _TRUTHS[seed.name]


def description(task: Task, number: int, made: Trial) -> dict[str, Any]:
    """What is kept beside a failing file."""
    return {
        "kind": task.kind,
        "seed": task.seed,
        "number": number,
        "file": made.seed.name,
        "reader": made.seed.reader,
        "changes": made.changes,
        "place": made.place,
        "detectable": made.detectable,
    }


def keep(failures: Path, work: Path, outcome: Outcome, number: int) -> None:
    """Keep a failing trial's file, what was done to it, and what was said."""
    held = json.loads((work / "trial.json").read_text(encoding="utf-8"))
    folder = failures / f"{held['kind']}-{outcome.word}-{held['seed']}-{number}"
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder_of(work).glob("input*"):
        if path.is_file() and not path.is_symlink():
            shutil.copy(path, folder / path.name)
    (folder / "trial.json").write_text(json.dumps(held, indent=1) + "\n", encoding="utf-8")
    text = f"{outcome.word}: {outcome.sort}\n\n{outcome.text}\n"
    (folder / "what.txt").write_text(text, encoding="utf-8", errors="backslashreplace")


def outside(work: Path) -> list[str]:
    """Names of what lies where no reader was asked to write."""
    allowed = {work: {"a", "dump.txt", "trial.json"}, work / "a": {"b"}, work / "a" / "b": {"c"}}
    found = [str(path) for folder, names in allowed.items() for path in folder.iterdir() if path.name not in names]
    return [*found, *(str(path) for path in _OUTSIDE if path.exists())]


def _status(field: str) -> int:
    """A figure of this process's memory, in bytes."""
    for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith(f"{field}:"):
            return int(line.split()[1]) << 10
    return 0


def _forget_peak() -> None:
    """Let the largest memory be counted from here (proc(5), clear_refs)."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except Exception:  # noqa: BLE001 # a defect of this package, which must not pass for one of a reader
        _dump(Path(json.loads(sys.argv[1])["work"])).write(f"{DEFECT}\n{traceback.format_exc()}")
        sys.exit(1)
